"""Which conditions differ: paired comparisons with Holm's correction, and Friedman's test.

The unit is the assessor: repetitions and contents are averaged first, for every assessor over
the same stimuli. Whoever lacks a vote of a comparison is left out of that comparison, by name;
nothing is imputed.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from dscqs.statistics.anova import Effect, repeated_measures
from dscqs.statistics.descriptive import t_quantile
from dscqs.statistics.matrix import Matrix

MOST_CONDITIONS = 20
"""Conditions up to which every two are compared; beyond, the family is too large to be of use."""

REFERENCE = "reference"
"""What a difference is compared with where only one condition is named: zero."""


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Comparison of two conditions over the assessors who judged both.

    Parameters
    ----------
    first, second : str
        The mean is first − second. ``reference`` as second: the difference against 0.
    n : int
        Assessors compared.
    mean, sd : float or None
        Of the paired differences; sd is the sample's (n − 1).
    ci95_t : float or None
        Half-width of the interval of the mean by Student's t; not corrected for many.
    t, df, p, p_holm : float or None
        Paired t-test, two-sided; Holm over all comparisons of the family.
    effect_size : float or None
        Cohen's d of paired data, mean / sd.
    p_wilcoxon, p_wilcoxon_holm : float or None
        Signed-rank test, for those who do not want to assume a normal distribution.
    """

    first: str
    second: str
    n: int
    mean: float | None
    sd: float | None = None
    ci95_t: float | None = None
    t: float | None = None
    df: int | None = None
    p: float | None = None
    p_holm: float | None = None
    effect_size: float | None = None
    p_wilcoxon: float | None = None
    p_wilcoxon_holm: float | None = None


@dataclass(frozen=True, kw_only=True)
class Friedman:
    """Friedman's rank test over all conditions; Kendall's W is its effect size (0 … 1)."""

    n: int
    conditions: int
    chi_squared: float
    df: int
    p: float
    kendall_w: float


@dataclass(frozen=True, kw_only=True)
class Comparisons:
    """All tests of one display.

    Parameters
    ----------
    complete : tuple of str
        Assessors with a vote of every stimulus: those of the ANOVA and of Friedman's test.
    incomplete : tuple of str
        The others, left out of these two.
    anova : tuple of Effect
        Condition, content and their interaction; empty with fewer than two complete assessors
        or an incomplete design.
    friedman : Friedman or None
        None with fewer than three conditions or two complete assessors.
    against_reference : tuple of Pair
        Every condition against 0; empty for scores of single stimuli.
    pairs : tuple of Pair
        Every two conditions; empty with more than 20 conditions.
    balanced : bool
        Every condition was shown with every content: without it, no ANOVA and no Friedman.
    """

    balanced: bool
    complete: tuple[str, ...]
    incomplete: tuple[str, ...]
    anova: tuple[Effect, ...]
    friedman: Friedman | None
    against_reference: tuple[Pair, ...]
    pairs: tuple[Pair, ...]


def compare(matrix: Matrix, *, differences: bool) -> Comparisons:
    """Return all comparisons of the votes of one display.

    Parameters
    ----------
    matrix : Matrix
    differences : bool
        The votes are differences to a reference, so that 0 means "no difference".
    """
    cube = stimulus_cube(matrix)
    means = [_means(cube, [at]) for at in range(len(matrix.conditions))]
    balanced = not np.isnan(cube).all(axis=0).any()
    full = ~np.isnan(cube).any(axis=(1, 2))
    names = np.array(matrix.assessors)
    complete = cube[full]
    few = len(matrix.conditions) <= MOST_CONDITIONS
    return Comparisons(
        balanced=balanced,
        complete=tuple(names[full].tolist()),
        incomplete=tuple(names[~full].tolist()) if balanced else (),
        anova=repeated_measures(complete, ("condition", "content")) if len(complete) > 1 else (),
        friedman=friedman(complete.mean(axis=2)),
        against_reference=_with_holm(
            _pair(condition, REFERENCE, mean)
            for condition, mean in zip(matrix.conditions, means, strict=True)
        )
        if differences
        else (),
        pairs=_with_holm(
            _pair(matrix.conditions[one], matrix.conditions[two], _contrast(cube, one, two))
            for one, two in combinations(range(len(matrix.conditions)), 2)
            if few
        ),
    )


def stimulus_cube(matrix: Matrix) -> NDArray[np.float64]:
    """Return mean votes [assessors × conditions × contents], repetitions averaged.

    NaN where an assessor lacks every repetition, or where there is no such stimulus.
    """
    cube = np.full(
        (len(matrix.assessors), len(matrix.conditions), len(matrix.contents)), np.nan
    )  # fmt: skip
    for column, content in enumerate(matrix.contents):
        for row, condition in enumerate(matrix.conditions):
            votes = matrix.values[matrix.rows(content, condition)]
            counts = (~np.isnan(votes)).sum(axis=0)
            with np.errstate(invalid="ignore"):
                cube[:, row, column] = np.nansum(votes, axis=0) / counts
    return cube


def _means(cube: NDArray[np.float64], conditions: list[int]) -> NDArray[np.float64]:
    """Return the mean over contents of the assessors who lack none of these conditions."""
    picked = cube[:, conditions]
    shown = ~np.isnan(picked).all(axis=(0, 1))
    if not shown.any():
        return np.full(len(cube), np.nan)
    return np.asarray(picked[:, :, shown].mean(axis=(1, 2)))


def _contrast(cube: NDArray[np.float64], one: int, two: int) -> NDArray[np.float64]:
    """Return, by assessor, the mean over the contents of both of first − second."""
    difference = cube[:, one] - cube[:, two]
    shown = ~np.isnan(difference).all(axis=0)
    if not shown.any():
        return np.full(len(cube), np.nan)
    return np.asarray(difference[:, shown].mean(axis=1))


def _pair(first: str, second: str, differences: NDArray[np.float64]) -> Pair:
    given = differences[~np.isnan(differences)]
    n = int(given.size)
    mean = float(given.mean()) if n else None
    if n < 2 or np.ptp(given) == 0:  # no spread: nothing to test against
        sd = 0.0 if n > 1 else None
        return Pair(first=first, second=second, n=n, mean=mean, sd=sd)
    sd = float(given.std(ddof=1))
    se = sd / n**0.5
    t = float(given.mean()) / se
    return Pair(
        first=first,
        second=second,
        n=n,
        mean=mean,
        sd=sd,
        ci95_t=t_quantile(n - 1) * se,
        t=t,
        df=n - 1,
        p=float(2 * stats.t.sf(abs(t), n - 1)),
        effect_size=float(given.mean()) / sd,
        p_wilcoxon=_wilcoxon(given),
    )


def _wilcoxon(differences: NDArray[np.float64]) -> float:
    """Return p of the signed-rank test, two-sided; differences of zero are left out.

    Exact up to 50 assessors without ties, else by the normal approximation.
    """
    sizes = np.abs(differences[differences != 0])
    exact = sizes.size == differences.size <= 50 and np.unique(sizes).size == sizes.size
    found = stats.wilcoxon(differences, method="exact" if exact else "asymptotic")
    return float(found.pvalue)


def _with_holm(pairs: Iterable[Pair]) -> tuple[Pair, ...]:
    kept = list(pairs)
    corrected = holm([pair.p for pair in kept])
    ranked = holm([pair.p_wilcoxon for pair in kept])
    return tuple(
        replace(pair, p_holm=one, p_wilcoxon_holm=two)
        for pair, one, two in zip(kept, corrected, ranked, strict=True)
    )


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Return p-values corrected by Holm's step-down method (Holm 1979); None stays None."""
    order = sorted(
        (index for index, p in enumerate(p_values) if p is not None),
        key=lambda index: p_values[index] or 0.0,
    )
    corrected: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, index in enumerate(order):
        largest = max(largest, min(1.0, (len(order) - rank) * (p_values[index] or 0.0)))
        corrected[index] = largest
    return corrected


def friedman(means: NDArray[np.float64]) -> Friedman | None:
    """Return Friedman's test of means [assessors × conditions], corrected for ties."""
    n, conditions = means.shape
    if n < 2 or conditions < 3 or np.all(means == means[:, :1]):
        return None
    found = stats.friedmanchisquare(*means.T)
    chi_squared = float(found.statistic)
    return Friedman(
        n=n,
        conditions=conditions,
        chi_squared=chi_squared,
        df=conditions - 1,
        p=float(found.pvalue),
        kendall_w=chi_squared / (n * (conditions - 1)),
    )
