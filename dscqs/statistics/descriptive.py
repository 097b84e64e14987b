"""Mean, spread and 95 % interval of a set of votes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy import stats

NORMAL_QUANTILE = 1.96
"""Half-width of the 95 % interval in standard errors, as ITU-R BT.500 writes it: not 1.95996."""


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What a set of votes says; None where there are too few of them.

    Parameters
    ----------
    n : int
        Number of votes.
    mean : float or None
    sd : float or None
        Sample standard deviation (n − 1).
    se : float or None
        Standard error of the mean, sd / √n.
    ci95_normal, ci95_t : float or None
        Half-widths of the 95 % interval: 1.96·se, and Student's t of n − 1 degrees of freedom.
    """

    n: int
    mean: float | None
    sd: float | None
    se: float | None
    ci95_normal: float | None
    ci95_t: float | None


@cache
def t_quantile(freedom: int) -> float:
    """Return the 0.975 quantile of Student's t."""
    return float(stats.t.ppf(0.975, freedom))


def summarise(values: Iterable[float] | NDArray[np.float64]) -> Summary:
    """Return the summary of all values that are not NaN."""
    votes = np.asarray(values if isinstance(values, np.ndarray) else list(values), np.float64)
    votes = votes[~np.isnan(votes)]
    n = int(votes.size)
    if n == 0:
        return Summary(n=0, mean=None, sd=None, se=None, ci95_normal=None, ci95_t=None)
    mean = float(votes.mean())
    if n == 1:
        return Summary(n=1, mean=mean, sd=None, se=None, ci95_normal=None, ci95_t=None)
    sd = float(votes.std(ddof=1)) if np.ptp(votes) > 0 else 0.0
    se = sd / float(np.sqrt(n))
    return Summary(
        n=n,
        mean=mean,
        sd=sd,
        se=se,
        ci95_normal=NORMAL_QUANTILE * se,
        ci95_t=t_quantile(n - 1) * se,
    )
