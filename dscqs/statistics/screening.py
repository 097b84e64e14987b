"""Screening of assessors after ITU-R BT.500 (section 2.3.1: all methods but SSCQE).

A vote is high when it is at least k standard deviations above the mean of its presentation, low
when at least k below; k is 2 where the votes look normal (2 ≤ β₂ ≤ 4), √20 where not. An
assessor with many such votes on *both* sides is erratic and is rejected; one who is always
harsh or always lenient is kept on purpose. To be applied once, not again to what is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dscqs.statistics.matrix import Matrix

MOST_EXTREME = 0.05
"""Largest share of extreme votes of an assessor who is kept for that alone."""

LEAST_BALANCE = 0.3
"""Smallest |P − Q| / (P + Q) of an assessor who is kept for that alone."""

FEWEST_SCREENED = 5
"""With fewer assessors no vote of a presentation can be extreme, but where all votes are equal.

Of n votes one lies √(n − 1) population standard deviations from their mean at most, which is
below 2 for n < 5. Votes that are all equal stand at both thresholds.
"""

ROUNDING = 1e-9
"""Slack of the inclusive thresholds [units of the scale]: decides equality, nothing else."""


class Variant(StrEnum):
    """Which standard deviation the thresholds are made of."""

    SAMPLE = "sample"  # n − 1: the text of the Recommendation
    POPULATION = "population"  # n: what sureal 0.9.0 computes


@dataclass(frozen=True, kw_only=True)
class AssessorScreening:
    """What the screening found of one assessor.

    Parameters
    ----------
    high, low : int
        P and Q of the Recommendation: votes far above and far below the others'.
    ratio_total : float
        (P + Q) / number of presentations.
    ratio_balance : float or None
        |P − Q| / (P + Q); None without any extreme vote.
    rejected : bool
        ``ratio_total`` > 0.05 and ``ratio_balance`` < 0.3.
    """

    high: int
    low: int
    ratio_total: float
    ratio_balance: float | None
    rejected: bool


@dataclass(frozen=True, kw_only=True)
class Screening:
    """The screening of one display: every assessor by name, rejected or not."""

    variant: Variant
    assessors: dict[str, AssessorScreening]

    @property
    def rejected(self) -> tuple[str, ...]:
        """Names of the rejected, in the order of the votes."""
        return tuple(name for name, found in self.assessors.items() if found.rejected)


def screen(matrix: Matrix, variant: Variant = Variant.SAMPLE) -> Screening:
    """Return the screening of the votes of one display."""
    high = np.zeros(len(matrix.assessors), int)
    low = np.zeros(len(matrix.assessors), int)
    for votes in matrix.values:
        above, below = _extremes(votes, ddof=1 if variant is Variant.SAMPLE else 0)
        high += above
        low += below
    presentations = len(matrix.presentations)
    return Screening(
        variant=variant,
        assessors={
            name: _judge(int(high[column]), int(low[column]), presentations)
            for column, name in enumerate(matrix.assessors)
        },
    )


def kurtosis(votes: NDArray[np.float64]) -> float:
    """Return β₂ = m₄ / m₂² of votes without NaN, of population moments; NaN without spread."""
    deviations = votes - votes.mean()
    second = float((deviations**2).mean())
    return float((deviations**4).mean()) / second**2 if second > 0 else float("nan")


def _extremes(votes: NDArray[np.float64], ddof: int) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Tell which votes of one presentation are high, and which are low; both without spread."""
    given = votes[~np.isnan(votes)]
    if given.size <= ddof:  # no standard deviation, hence no threshold
        return np.zeros(votes.shape, bool), np.zeros(votes.shape, bool)
    if np.ptp(given) == 0:  # mean and thresholds are the vote itself
        return ~np.isnan(votes), ~np.isnan(votes)
    k = 2.0 if 2 <= kurtosis(given) <= 4 else np.sqrt(20.0)
    reach = k * given.std(ddof=ddof)
    # Comparisons with NaN are false: no vote is not extreme.
    return (
        votes >= given.mean() + reach - ROUNDING,
        votes <= given.mean() - reach + ROUNDING,
    )


def _judge(high: int, low: int, presentations: int) -> AssessorScreening:
    total = (high + low) / presentations
    balance = abs(high - low) / (high + low) if high + low else None
    return AssessorScreening(
        high=high,
        low=low,
        ratio_total=total,
        ratio_balance=balance,
        rejected=total > MOST_EXTREME and balance is not None and balance < LEAST_BALANCE,
    )
