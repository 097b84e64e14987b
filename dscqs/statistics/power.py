"""How many assessors a difference needs, and what a number of assessors can show.

Of the paired t-test, two-sided: with δ the true mean difference, σ the standard deviation of
the paired differences over assessors and n assessors, t has n − 1 degrees of freedom and
noncentrality √n · δ / σ under the alternative (Cohen 1988, ch. 2).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import optimize, stats

ALPHA = 0.05
POWER = 0.8

MOST_ASSESSORS = 10_000


@dataclass(frozen=True, kw_only=True)
class Power:
    """What the test can tell, from the spread that was found.

    Parameters
    ----------
    n : int
        Assessors.
    sd : float
        Largest SD of the paired differences of any comparison: the cautious choice.
    comparisons : int
        Number of comparisons; α is divided by it (Bonferroni: never less strict than Holm).
    detectable : float
        Smallest true difference that is found with a probability of 0.8.
    needed : mapping of float to (int or None)
        Assessors for a true difference, by difference; None: more than 10 000.
    """

    n: int
    sd: float
    comparisons: int
    detectable: float
    needed: dict[float, int | None]


def paired_power(difference: float, sd: float, n: int, alpha: float = ALPHA) -> float:
    """Return the probability that a paired t-test of n assessors finds a true difference."""
    noncentrality = n**0.5 * abs(difference) / sd
    critical = stats.t.ppf(1 - alpha / 2, n - 1)
    upper = stats.nct.sf(critical, n - 1, noncentrality)
    lower = stats.nct.cdf(-critical, n - 1, noncentrality)  # NaN where it is too small to tell
    return float(upper + np.nan_to_num(lower))


def assessors_needed(
    difference: float, sd: float, *, alpha: float = ALPHA, power: float = POWER
) -> int | None:
    """Return the least number of assessors for a difference; None: more than 10 000."""
    if sd == 0:
        return 2
    low, high = 1, 2
    while paired_power(difference, sd, high, alpha) < power:
        low, high = high, 2 * high
        if high > MOST_ASSESSORS:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        if paired_power(difference, sd, middle, alpha) < power:
            low = middle
        else:
            high = middle
    return high


def detectable_difference(
    n: int, sd: float, *, alpha: float = ALPHA, power: float = POWER
) -> float:
    """Return the smallest true difference that n assessors find with this power."""
    if sd == 0:
        return 0.0

    def lack(effect: float) -> float:
        return paired_power(effect, 1.0, n, alpha) - power

    most = 1.0
    while lack(most) < 0:
        most *= 2
    return float(optimize.brentq(lack, 0.0, most, xtol=1e-10)) * sd


def plan_power(sds: list[float], n: int, differences: tuple[float, ...]) -> Power | None:
    """Return what a test can tell whose comparisons have these SDs; None without any spread."""
    sd = max(sds, default=0.0)
    if n < 2 or sd == 0:
        return None
    alpha = ALPHA / len(sds)
    return Power(
        n=n,
        sd=sd,
        comparisons=len(sds),
        detectable=detectable_difference(n, sd, alpha=alpha),
        needed={
            difference: assessors_needed(difference, sd, alpha=alpha) for difference in differences
        },
    )
