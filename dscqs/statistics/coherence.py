"""How far assessors agree: with themselves (repeated items) and with one another.

Neither decides who is rejected; that is the screening's task alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from dscqs.statistics.matrix import Matrix

LEAST_CORRELATION = 0.7
"""Upper bound of the threshold of the correlation check, as sureal has it."""


@dataclass(frozen=True, kw_only=True)
class Repeats:
    """What the repeated items say of one assessor, or of all.

    Parameters
    ----------
    stimuli : int
        Stimuli with at least two votes of the same assessor.
    mean_change : float or None
        Mean of last − first vote: drift; positive: higher votes later.
    within_sd : float or None
        √ of the mean of the variances (n − 1) within the repetitions of a stimulus.
    repeatability : float or None
        1.96 · √2 · within_sd: two votes of the same assessor on the same stimulus differ by
        less in 95 of 100 cases (Bland and Altman 1986).
    correlation : float or None
        Pearson's, of first and last vote over the stimuli; None with fewer than three, or
        without spread.
    """

    stimuli: int
    mean_change: float | None
    within_sd: float | None
    repeatability: float | None
    correlation: float | None


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """Correlation of an assessor with the mean votes of all.

    Parameters
    ----------
    pearson, spearman : float or None
        None with fewer than three stimuli, or without spread.
    low : bool
        pearson ≤ min(0.7, mean − SD of all assessors' pearson): worth a look.
    """

    pearson: float | None
    spearman: float | None
    low: bool


@dataclass(frozen=True, kw_only=True)
class Coherence:
    """Repeated items and agreement of all assessors of one display, by name."""

    repeats: dict[str, Repeats]
    all_repeats: Repeats
    agreement: dict[str, Agreement]


def coherence(matrix: Matrix) -> Coherence:
    """Return the coherence of the votes of one display."""
    rows = matrix.stimulus_of_row
    groups = [
        [votes[~np.isnan(votes)] for votes in (column[rows == at] for at in range(rows.max() + 1))]
        for column in matrix.values.T
    ]
    return Coherence(
        repeats={
            name: _repeats(group) for name, group in zip(matrix.assessors, groups, strict=True)
        },
        all_repeats=_repeats([votes for group in groups for votes in group]),
        agreement=_agreement(matrix),
    )


def _repeats(groups: list[NDArray[np.float64]]) -> Repeats:
    repeated = [votes for votes in groups if votes.size > 1]
    if not repeated:
        return Repeats(
            stimuli=0, mean_change=None, within_sd=None, repeatability=None, correlation=None
        )
    within = float(np.sqrt(np.mean([votes.var(ddof=1) for votes in repeated])))
    first = np.array([votes[0] for votes in repeated])
    last = np.array([votes[-1] for votes in repeated])
    return Repeats(
        stimuli=len(repeated),
        mean_change=float((last - first).mean()),
        within_sd=within,
        repeatability=1.96 * 2**0.5 * within,
        correlation=_correlation(first, last),
    )


def _agreement(matrix: Matrix) -> dict[str, Agreement]:
    rows = matrix.stimulus_of_row
    counts = np.stack([np.bincount(rows, column) for column in (~np.isnan(matrix.values)).T])
    sums = np.stack([np.bincount(rows, column) for column in np.nan_to_num(matrix.values).T])
    with np.errstate(invalid="ignore"):
        own = sums / counts
        mean = sums.sum(axis=0) / counts.sum(axis=0)
    pearson = [_correlation(votes, mean) for votes in own]
    known = [value for value in pearson if value is not None]
    least = min(LEAST_CORRELATION, float(np.mean(known) - np.std(known))) if known else -np.inf
    return {
        name: Agreement(
            pearson=value,
            spearman=_correlation(votes, mean, ranks=True),
            low=value is not None and value <= least,
        )
        for name, value, votes in zip(matrix.assessors, pearson, own, strict=True)
    }


def _correlation(
    one: NDArray[np.float64], two: NDArray[np.float64], *, ranks: bool = False
) -> float | None:
    both = ~(np.isnan(one) | np.isnan(two))
    one, two = one[both], two[both]
    if ranks:
        one, two = stats.rankdata(one), stats.rankdata(two)
    if one.size < 3 or np.ptp(one) == 0 or np.ptp(two) == 0:
        return None
    return float(np.corrcoef(one, two)[0, 1])
