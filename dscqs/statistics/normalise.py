"""Votes without what is an assessor's own: z-scores, and bias removal after ITU-T P.913 12.4.

Neither is asked for by ITU-R BT.500. Both take a matrix and return one of the same shape;
a vote that is missing stays missing.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dscqs.statistics.matrix import Matrix


@dataclass(frozen=True, kw_only=True)
class BiasRemoval:
    """Votes with every assessor's mean deviation taken off.

    Parameters
    ----------
    matrix : Matrix
        Votes − bias of their assessor.
    bias : array [assessors]
        Mean of vote − mean of its stimulus; positive: higher votes than the others'. NaN
        without a vote.
    """

    matrix: Matrix
    bias: NDArray[np.float64]


def z_scores(matrix: Matrix) -> Matrix:
    """Return (vote − mean of the assessor) / sample SD of the assessor (n − 1).

    An assessor with one vote, or with votes that are all the same, has no z-scores: NaN.
    Source: van Dijk, Martens, Watson 1995; as in LIVE (Seshadrinathan et al. 2010).
    """
    values = np.full(matrix.values.shape, np.nan)
    for column, votes in enumerate(matrix.values.T):
        given = votes[~np.isnan(votes)]
        if given.size > 1 and np.ptp(given) > 0:
            values[:, column] = (votes - given.mean()) / given.std(ddof=1)
    return dataclasses.replace(matrix, values=values)


def to_percent(z: float) -> float:
    """Return a z-score on 0 … 100, as LIVE: 100 (z + 3) / 6; −3 is 0, +3 is 100."""
    return (z + 3.0) * (100.0 / 6.0)


def stimulus_means(matrix: Matrix) -> NDArray[np.float64]:
    """Return, for every presentation, the mean of all votes of its stimulus; NaN without one."""
    rows = matrix.stimulus_of_row
    sums = np.bincount(rows, np.nansum(matrix.values, axis=1))
    counts = np.bincount(rows, (~np.isnan(matrix.values)).sum(axis=1))
    with np.errstate(invalid="ignore"):
        return (sums / counts)[rows]


def remove_bias(matrix: Matrix) -> BiasRemoval:
    """Return the votes without the bias of their assessors (ITU-T P.913 12.4).

    The bias of an assessor is the mean, over that assessor's votes, of vote − mean of the
    stimulus. Repetitions of a stimulus share its mean.
    """
    deviations = matrix.values - stimulus_means(matrix)[:, None]
    counts = (~np.isnan(deviations)).sum(axis=0)
    with np.errstate(invalid="ignore"):
        bias = np.nansum(deviations, axis=0) / counts
    return BiasRemoval(matrix=dataclasses.replace(matrix, values=matrix.values - bias), bias=bias)
