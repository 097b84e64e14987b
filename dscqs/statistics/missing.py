"""Votes that are not there: counted and named, never filled in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dscqs.statistics.matrix import Matrix


@dataclass(frozen=True, kw_only=True)
class Missing:
    """Missing votes of one display.

    A vote is expected of every assessor of the display for every presentation that anybody of
    the display saw.

    Parameters
    ----------
    expected, given : int
        Votes.
    by_assessor : mapping
        Missing votes by assessor, those with none left out.
    stimuli : mapping of (content, condition) to int
        Missing votes by stimulus, those with none left out.
    """

    expected: int
    given: int
    by_assessor: dict[str, int]
    stimuli: dict[tuple[str, str], int]

    @property
    def count(self) -> int:
        """Number of missing votes."""
        return self.expected - self.given


def missing_votes(matrix: Matrix) -> Missing:
    """Return which votes are missing."""
    absent = np.isnan(matrix.values)
    by_assessor = absent.sum(axis=0)
    by_stimulus = np.bincount(matrix.stimulus_of_row, absent.sum(axis=1)).astype(int)
    return Missing(
        expected=absent.size,
        given=int((~absent).sum()),
        by_assessor={
            name: int(count)
            for name, count in zip(matrix.assessors, by_assessor, strict=True)
            if count
        },
        stimuli={
            stimulus: int(count)
            for stimulus, count in zip(matrix.stimuli, by_stimulus, strict=True)
            if count
        },
    )
