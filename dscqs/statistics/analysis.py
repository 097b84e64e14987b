"""All scores of a test: by display, content and condition, and pooled; before and after screening.

====================  ====================================================================
figure                what it is
====================  ====================================================================
``primary``           the difference where there is one, else the score
``grade_reference``   grade of the reference, 100 = excellent
``grade_test``        grade of the tested condition, 100 = excellent
``test_score``        100 − ``grade_test``: 0 = excellent, lower is better
``reference_score``   100 − ``grade_reference``, likewise
====================  ====================================================================
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dscqs.statistics.descriptive import Summary, summarise
from dscqs.statistics.matrix import Matrix, make_matrix, primary
from dscqs.statistics.screening import Screening, Variant, screen
from dscqs.votes import TEST, Method, Order, Vote, VoteTable

FEWEST_ASSESSORS = 15
"""A test with fewer is to be called informal (ITU-R BT.500)."""

PRIMARY = "primary"


def _test_score(vote: Vote) -> float | None:
    return None if vote.grade_test is None else 100.0 - vote.grade_test


def _reference_score(vote: Vote) -> float | None:
    return None if vote.grade_reference is None else 100.0 - vote.grade_reference


FIGURES: dict[str, Callable[[Vote], float | None]] = {
    PRIMARY: primary,
    "grade_reference": lambda vote: vote.grade_reference,
    "grade_test": lambda vote: vote.grade_test,
    "test_score": _test_score,
    "reference_score": _reference_score,
}


@dataclass(frozen=True, kw_only=True)
class Score:
    """One figure, with all votes and without those of the rejected assessors."""

    before: Summary
    after: Summary


@dataclass(frozen=True, kw_only=True)
class Cell:
    """The scores of one stimulus, or of several pooled.

    Parameters
    ----------
    display, content, condition : str or None
        None: pooled over all of them.
    figures : mapping
        Score by figure; every vote counts once.
    by_assessor : Score
        The primary figure, of the means of every assessor: n counts people, not votes.
    """

    display: str | None
    content: str | None
    condition: str | None
    figures: Mapping[str, Score]
    by_assessor: Score

    @property
    def primary(self) -> Score:
        """The score that is analysed."""
        return self.figures[PRIMARY]


@dataclass(frozen=True, kw_only=True)
class DisplayVotes:
    """The votes on one display, as one matrix for each figure, and both screenings of them."""

    display: str
    matrices: Mapping[str, Matrix]
    screenings: Mapping[Variant, Screening]

    @property
    def matrix(self) -> Matrix:
        """The matrix of the primary figure."""
        return self.matrices[PRIMARY]


@dataclass(frozen=True, kw_only=True)
class Analysis:
    """Everything that is known of one dimension of a test."""

    name: str
    dimension: str
    method: Method
    variant: Variant
    displays: tuple[DisplayVotes, ...]
    stimuli: tuple[Cell, ...]
    pooled: tuple[Cell, ...]
    order: Order

    @property
    def assessors(self) -> tuple[str, ...]:
        """All assessors, in the order of the votes."""
        return tuple(
            dict.fromkeys(name for display in self.displays for name in display.matrix.assessors)
        )

    @property
    def conditions(self) -> tuple[str, ...]:
        """All conditions, in the order of the plan, or of the votes."""
        return self.order.arrange(
            "conditions", (name for display in self.displays for name in display.matrix.conditions)
        )

    @property
    def contents(self) -> tuple[str, ...]:
        """All contents, in the order of the plan, or of the votes."""
        return self.order.arrange(
            "contents", (name for display in self.displays for name in display.matrix.contents)
        )

    @property
    def informal(self) -> bool:
        """Whether any display was judged by fewer than 15 assessors."""
        return any(voters(display) < FEWEST_ASSESSORS for display in self.displays)


def analyse(table: VoteTable, variant: Variant = Variant.SAMPLE) -> tuple[Analysis, ...]:
    """Return one analysis for each dimension, that of picture quality first.

    Parameters
    ----------
    table : VoteTable
    variant : Variant
        The screening that decides whose votes are left out of the results "after".
    """
    votes = [vote for vote in table.votes if vote.kind == TEST]
    dimensions = sorted(
        table.order.arrange("dimensions", (vote.dimension for vote in votes)),
        key=_quality_last_not,
    )
    return tuple(
        _analyse([vote for vote in votes if vote.dimension == dimension], dimension, table, variant)
        for dimension in dimensions
    )


def _quality_last_not(dimension: str) -> bool:
    return dimension != "quality"  # sorted() keeps the order of all others


def _analyse(votes: Sequence[Vote], dimension: str, table: VoteTable, variant: Variant) -> Analysis:
    figures = {
        name: value
        for name, value in FIGURES.items()
        if name == PRIMARY or any(value(vote) is not None for vote in votes)
    }
    # All displays have one order, whatever their assessors were shown first.
    order = table.order
    seen = order.arrange_shown((vote.content, vote.condition, vote.repetition) for vote in votes)
    places = {presentation: place for place, presentation in enumerate(seen)}
    displays = []
    for display in order.arrange("displays", (vote.display for vote in votes)):
        shown = sorted(
            (vote for vote in votes if vote.display == display),
            key=lambda vote: places[vote.content, vote.condition, vote.repetition],
        )
        matrices = {name: make_matrix(shown, value) for name, value in figures.items()}
        displays.append(
            DisplayVotes(
                display=display,
                matrices=matrices,
                screenings={which: screen(matrices[PRIMARY], which) for which in Variant},
            )
        )
    stimuli = [
        _cell([display], content, condition, variant)
        for display in displays
        for content, condition in display.matrix.stimuli
    ]
    conditions = order.arrange(
        "conditions", (name for display in displays for name in display.matrix.conditions)
    )
    pooled = [
        _cell([display], None, condition, variant)
        for display in displays
        for condition in display.matrix.conditions
    ]
    if len(displays) > 1:
        pooled += [_cell(displays, None, condition, variant) for condition in conditions]
    return Analysis(
        name=table.name,
        dimension=dimension,
        method=table.method,
        variant=variant,
        displays=tuple(displays),
        stimuli=tuple(stimuli),
        pooled=tuple(pooled),
        order=order,
    )


def _cell(
    displays: Sequence[DisplayVotes],
    content: str | None,
    condition: str | None,
    variant: Variant,
) -> Cell:
    figures = {
        name: Score(
            before=summarise(_picked(displays, name, content, condition, None)),
            after=summarise(_picked(displays, name, content, condition, variant)),
        )
        for name in displays[0].matrices
    }
    return Cell(
        display=displays[0].display if len(displays) == 1 else None,
        content=content,
        condition=condition,
        figures=figures,
        by_assessor=Score(
            before=summarise(assessor_means(displays, content, condition, None).values()),
            after=summarise(assessor_means(displays, content, condition, variant).values()),
        ),
    )


def kept(display: DisplayVotes, variant: Variant | None) -> list[int]:
    """Return the columns of the assessors whose votes count; without a variant: of all."""
    rejected = display.screenings[variant].rejected if variant else ()
    return [column for column, name in enumerate(display.matrix.assessors) if name not in rejected]


def assessor_means(
    displays: Sequence[DisplayVotes],
    content: str | None,
    condition: str | None,
    variant: Variant | None,
) -> dict[str, float]:
    """Return the mean primary figure of every assessor who voted, rejected ones left out."""
    votes: dict[str, list[float]] = {}
    for display in displays:
        rows = display.matrix.rows(content, condition)
        for column in kept(display, variant):
            given = display.matrix.values[rows, column]
            votes.setdefault(display.matrix.assessors[column], []).extend(given[~np.isnan(given)])
    return {name: float(np.mean(given)) for name, given in votes.items() if given}


def _picked(
    displays: Sequence[DisplayVotes],
    figure: str,
    content: str | None,
    condition: str | None,
    variant: Variant | None,
) -> np.ndarray:
    return np.concatenate(
        [
            display.matrices[figure]
            .values[display.matrices[figure].rows(content, condition)][:, kept(display, variant)]
            .ravel()
            for display in displays
        ]
    )


def voters(display: DisplayVotes) -> int:
    """Return the number of assessors with at least one vote on this display."""
    return int((~np.isnan(display.matrix.values)).any(axis=0).sum())
