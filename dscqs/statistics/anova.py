"""Repeated-measures analysis of variance with the correction of Greenhouse and Geisser.

Every assessor has judged every combination of the factors (complete data). The effect of a set
of factors is tested on orthonormal contrasts between their levels: with S the covariance of
the contrasts over the assessors, and d their number,

    F = (N Σ mean² / d) / (trace S / d)          of d and d (N − 1) degrees of freedom
    ε = (trace S)² / (d trace S²)                both degrees of freedom are multiplied by it

so that ε is exact for interactions of any factors (Greenhouse, Geisser 1959; Kirk,
"Experimental Design", ch. 10). With d = 1, ε is 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy import stats


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One line of the table of the analysis.

    Parameters
    ----------
    factors : tuple of str
        One: a main effect; several: their interaction.
    df_effect, df_error : int
        Degrees of freedom, not corrected.
    f, p : float or None
        None where there is no variation among the assessors to test against.
    epsilon : float or None
        Of Greenhouse and Geisser, 1/df_effect … 1.
    p_corrected : float or None
        With both degrees of freedom times ε: the one to report.
    partial_eta_squared : float or None
        SS of the effect / (SS of the effect + SS of its error).
    """

    factors: tuple[str, ...]
    df_effect: int
    df_error: int
    f: float | None
    p: float | None
    epsilon: float | None
    p_corrected: float | None
    partial_eta_squared: float | None


def repeated_measures(values: NDArray[np.float64], factors: Sequence[str]) -> tuple[Effect, ...]:
    """Return every main effect and interaction of a complete within-assessor design.

    Parameters
    ----------
    values : array [assessors × levels of the first factor × levels of the second × …]
        No NaN; at least two assessors. A factor of one level is left out.
    factors : sequence of str
        Names of the axes after the first.
    """
    kept = [axis for axis, size in enumerate(values.shape[1:]) if size > 1]
    return tuple(
        _effect(values, [axis for axis in axes], factors)
        for size in range(1, len(kept) + 1)
        for axes in combinations(kept, size)
    )


def _effect(values: NDArray[np.float64], axes: Sequence[int], factors: Sequence[str]) -> Effect:
    assessors, levels = values.shape[0], values.shape[1:]
    parts = [
        _contrasts(size) if axis in axes else np.full((size, 1), size**-0.5)
        for axis, size in enumerate(levels)
    ]
    contrasts = reduce(np.kron, parts)
    scores = values.reshape(assessors, -1) @ contrasts
    d = scores.shape[1]
    effect = assessors * float((scores.mean(axis=0) ** 2).sum())
    covariance = np.atleast_2d(np.cov(scores, rowvar=False))
    trace = float(np.trace(covariance))
    names = tuple(factors[axis] for axis in axes)
    df_error = d * (assessors - 1)
    if trace <= 1e-12 * max(float(np.var(values)), 1e-300):
        return Effect(
            factors=names, df_effect=d, df_error=df_error, f=None, p=None, epsilon=None,
            p_corrected=None, partial_eta_squared=None,
        )  # fmt: skip
    f = effect / trace
    epsilon = trace**2 / (d * float((covariance**2).sum()))
    return Effect(
        factors=names,
        df_effect=d,
        df_error=df_error,
        f=f,
        p=float(stats.f.sf(f, d, df_error)),
        epsilon=epsilon,
        p_corrected=float(stats.f.sf(f, epsilon * d, epsilon * df_error)),
        partial_eta_squared=effect / (effect + (assessors - 1) * trace),
    )


def _contrasts(size: int) -> NDArray[np.float64]:
    """Return size − 1 orthonormal columns, each orthogonal to the mean (Helmert)."""
    columns = np.zeros((size, size - 1))
    for column in range(size - 1):
        columns[: column + 1, column] = 1.0
        columns[column + 1, column] = -(column + 1.0)
    return columns / np.linalg.norm(columns, axis=0)
