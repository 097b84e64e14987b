"""The votes of one display as a matrix: presentations down, assessors across."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dscqs.votes import PresentationKey, Vote


@dataclass(frozen=True, kw_only=True)
class Matrix:
    """Votes by presentation and assessor, both in the order of their first appearance.

    Parameters
    ----------
    presentations : tuple of PresentationKey
        One for each repetition of a stimulus.
    assessors : tuple of str
    values : array [presentations × assessors]
        NaN where there is no vote.
    """

    presentations: tuple[PresentationKey, ...]
    assessors: tuple[str, ...]
    values: NDArray[np.float64]

    def rows(self, content: str | None = None, condition: str | None = None) -> NDArray[np.bool_]:
        """Tell which presentations are of a content and a condition; None: of any."""
        return np.array(
            [content in (None, one) and condition in (None, two) for one, two, _ in
             self.presentations],
            dtype=bool,
        )  # fmt: skip

    @property
    def stimuli(self) -> tuple[tuple[str, str], ...]:
        """Content and condition of every stimulus, in order."""
        return tuple(dict.fromkeys((one, two) for one, two, _ in self.presentations))

    @property
    def stimulus_of_row(self) -> NDArray[np.intp]:
        """Index into :attr:`stimuli` of every presentation."""
        index = {stimulus: at for at, stimulus in enumerate(self.stimuli)}
        return np.array([index[one, two] for one, two, _ in self.presentations], dtype=np.intp)

    @property
    def contents(self) -> tuple[str, ...]:
        """Every content, in order."""
        return tuple(dict.fromkeys(content for content, _, _ in self.presentations))

    @property
    def conditions(self) -> tuple[str, ...]:
        """Every condition, in order."""
        return tuple(dict.fromkeys(condition for _, condition, _ in self.presentations))


def primary(vote: Vote) -> float | None:
    """Return the figure that is analysed (see :attr:`dscqs.votes.Vote.primary`)."""
    return vote.primary


def make_matrix(
    votes: Sequence[Vote], value: Callable[[Vote], float | None] = primary
) -> Matrix:  # fmt: skip
    """Return the matrix of votes of one display and one dimension."""
    presentations = {
        key: row
        for row, key in enumerate(
            dict.fromkeys((vote.content, vote.condition, vote.repetition) for vote in votes)
        )
    }
    assessors = {
        name: column for column, name in enumerate(dict.fromkeys(vote.assessor for vote in votes))
    }
    values = np.full((len(presentations), len(assessors)), np.nan)
    for vote in votes:
        found = value(vote)
        if found is not None:
            row = presentations[(vote.content, vote.condition, vote.repetition)]
            values[row, assessors[vote.assessor]] = found
    return Matrix(
        presentations=tuple(presentations), assessors=tuple(assessors), values=values
    )  # fmt: skip
