"""The model of ITU-T P.910 Annex E: quality of stimuli, bias and inconsistency of assessors.

Every vote is quality of the stimulus + bias of the assessor + noise of the assessor::

    u_ijr = ψ_j + Δ_i + υ_i · X,    X of a standard normal distribution

ψ, Δ and υ are found by alternating projection (Li, Bampis, Krasula, Janowski, Katsavounidis:
"A simple model for subject behavior in subjective experiments", HVEI 2020), the solver that
the reference code of the two Recommendations describes and sureal implements. Written from the
equations of the paper; no assessor is rejected, a noisy one weighs less.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dscqs.statistics.matrix import Matrix
from dscqs.statistics.normalise import remove_bias, stimulus_means

MOST_STEPS = 1000
CLOSE_ENOUGH = 1e-8
"""Change of all ψ together (Euclidean norm) at which the projection ends [units of the votes]."""

SMALLEST_VARIANCE = 1e-8
"""Added to υ², so that an assessor without noise keeps a finite weight [units²]."""

NO_NOISE = 1e-3
"""Part of the median υ below which an assessor's noise counts as vanished."""


@dataclass(frozen=True, kw_only=True)
class Recovered:
    """What the model found; all in units of the votes.

    Parameters
    ----------
    stimuli : tuple of (content, condition)
    quality : array [stimuli]
        ψ, on the scale of the votes; NaN without a vote.
    se_residual : array [stimuli]
        SD of the residuals of a stimulus / √n: the "SOS" of the reference code.
    se_model : array [stimuli]
        1 / √(Σ 1/υ_i²) over the votes: what the model itself says.
    assessors : tuple of str
    bias, inconsistency : array [assessors]
        Δ (mean zero over the assessors) and υ; NaN without a vote.
    steps : int
    converged : bool
        False: stopped after 1000 steps.
    dominated : str or None
        An assessor whose noise the model puts at (almost) zero, so that the scores are that
        assessor's votes: the likelihood has no maximum there, and the result is not to be used.
        It happens to panels of less than about a dozen.
    """

    stimuli: tuple[tuple[str, str], ...]
    quality: NDArray[np.float64]
    se_residual: NDArray[np.float64]
    se_model: NDArray[np.float64]
    assessors: tuple[str, ...]
    bias: NDArray[np.float64]
    inconsistency: NDArray[np.float64]
    steps: int
    converged: bool
    dominated: str | None


def recover(matrix: Matrix) -> Recovered:
    """Return quality, bias and inconsistency by alternating projection."""
    votes = matrix.values
    rows = matrix.stimulus_of_row
    given = ~np.isnan(votes)
    stimuli = len(matrix.stimuli)
    first = np.unique(rows, return_index=True)[1]
    quality = stimulus_means(matrix)[first]
    bias = remove_bias(matrix).bias
    steps, change = 0, np.inf
    while change >= CLOSE_ENOUGH and steps < MOST_STEPS:
        residuals = votes - quality[rows, None] - bias
        inconsistency = _spread(residuals, given)
        weights = given / (inconsistency**2 + SMALLEST_VARIANCE)
        found = _by_stimulus(np.where(given, votes - bias, 0.0) * np.nan_to_num(weights), rows)
        with np.errstate(invalid="ignore"):
            found = found / _by_stimulus(np.nan_to_num(weights), rows)
            change = float(np.sqrt(np.nansum((found - quality) ** 2)))
            quality = found
            bias = np.nansum(votes - quality[rows, None], axis=0) / given.sum(axis=0)
        steps += 1
    voted = given.any(axis=0)
    mean_bias = float(bias[voted].mean()) if voted.any() else 0.0
    with np.errstate(divide="ignore"):
        se_model = 1 / np.sqrt(_by_stimulus(np.nan_to_num(weights), rows))
    noise = inconsistency[voted]
    noiseless = np.flatnonzero(inconsistency < NO_NOISE * (np.median(noise) if noise.size else 0))
    return Recovered(
        stimuli=matrix.stimuli,
        quality=quality + mean_bias,
        se_residual=np.array([_residual_error(residuals[rows == row]) for row in range(stimuli)]),
        se_model=se_model,
        assessors=matrix.assessors,
        bias=bias - mean_bias,
        inconsistency=inconsistency,
        steps=steps,
        converged=change < CLOSE_ENOUGH,
        dominated=matrix.assessors[noiseless[0]] if noiseless.size else None,
    )


def _spread(residuals: NDArray[np.float64], given: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the population SD of every column; NaN without a vote."""
    with np.errstate(invalid="ignore"):
        counts = given.sum(axis=0)
        means = np.nansum(residuals, axis=0) / counts
        return np.asarray(np.sqrt(np.nansum((residuals - means) ** 2, axis=0) / counts))


def _by_stimulus(values: NDArray[np.float64], rows: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the sums over all votes of every stimulus."""
    return np.asarray(np.bincount(rows, values.sum(axis=1)), np.float64)


def _residual_error(residuals: NDArray[np.float64]) -> float:
    known = residuals[~np.isnan(residuals)]
    return float(known.std() / np.sqrt(known.size)) if known.size else float("nan")
