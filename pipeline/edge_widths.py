"""How wide the edges of a picture are, in the samples of all its views at once.

Across a clean edge the picture is a step, blurred: a cumulative Gaussian between two levels,
each with a slope of its own. The pixels of all registered views around the edge sample that
profile at many distances (as the slanted edge of ISO 12233 does for one picture), so that its
width is found without reconstructing anything. Not in the thesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
import scipy  # what it has loads when it is named: few jobs come here

from pipeline.frames import GreyImage, RegisteredView
from pipeline.grid import Grid

Values = npt.NDArray[np.float64]

ACROSS, ALONG = 3.0, 1.5
"""Reach of the samples of an edge, across and along it, in units of K: HR pixels over K. Where K
differs, that of the axes that are enlarged counts across, that of the edge's direction along."""

SMOOTHING = 0.8
"""σ of the low-pass with which edges are looked for, LR pixels."""

APART = 2
"""LR pixels around an edge within which no other is taken."""

BORDER = 5
"""LR pixels along the border of the picture where none is taken."""

MOST_EDGES = 2500
"""The steepest so many are measured."""

LEAST_STEEPNESS = 1.5
"""Of an edge that is measured, grey levels per LR pixel; or the noise, if that is more."""

LEAST_BLURRED = 0.8
"""Share of an edge's normal, squared, along axes that are enlarged: the PSF blurs no other."""

LEAST_CONTRAST = (12.0, 6.0)
"""Height of the step, at least: grey levels, and multiples of the noise."""

LARGEST_MISFIT = 0.03
"""RMS of what neither a step nor noise explains, as a share of the step's height, at most."""

LARGEST_SLOPE = 0.5
"""Rise or fall of either side over the reach of the samples, as a share of the step's height, at
most: what falls again behind the step is a line, and narrower than a step."""

LARGEST_ERROR = 0.1
"""Standard error of a width that is believed, in units of K, at most."""

WIDTHS = (0.1, 2.5)
"""Widths that a fit can have, in units of K; one at a bound is not believed."""

SMALLEST_NOISE = 0.5
"""Noise that is assumed at least, grey levels: rounding, and what a model leaves."""

ITERATIONS = 14
"""Of Levenberg and Marquardt."""

AT_ONCE = 128
"""Edges fitted together, so that they stay in the processor's cache."""

PLACE, WIDTH, TILT, LEVEL, STEP, SLOPE_BEFORE, SLOPE_BEHIND = range(7)
"""Columns of the parameters; the width as its logarithm."""

EXPECTED = np.array([1.5, np.inf, 0.3, np.inf, np.inf, 3.0, 3.0])
"""Standard deviations expected of the parameters: HR pixels, 1, grey levels per HR pixel."""

LARGEST_STEP = np.array([1.0, 0.4, 0.3, np.inf, np.inf, np.inf, np.inf])
"""Of the parameters in one iteration."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeWidths:
    """The edges of a view whose profile is a clean step, (E,) each."""

    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]
    """LR pixel of the view."""
    width: Values
    """σ of the Gaussian that makes the profile of a step, HR pixels."""
    error: Values
    """Standard error of the width, HR pixels."""

    def chosen(self, which: npt.NDArray[np.bool_]) -> EdgeWidths:
        """Return some of the edges, as the mask (E,) says."""
        return EdgeWidths(
            row=self.row[which], column=self.column[which],
            width=self.width[which], error=self.error[which],
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class _Edges:
    """Where steps seem to be, (E,) each; the normals have unit length on the HR grid."""

    row: npt.NDArray[np.int64]
    column: npt.NDArray[np.int64]
    normal_x: Values
    normal_y: Values


@dataclass(frozen=True, kw_only=True, eq=False)
class _Samples:
    """The pixels around each edge, (E, n) each."""

    across: Values
    """Distance from the edge along its normal, HR pixels."""
    along: Values
    """The same along the edge."""
    observed: Values
    """Grey levels."""
    valid: Values
    """1; 0 where a row has no more samples."""
    is_own: npt.NDArray[np.bool_]
    """Whether the sample is one of the reference view itself."""


def measure_edges(views: Sequence[RegisteredView], grid: Grid, noise: float) -> EdgeWidths:
    """Return the clean edges of the reference view, and their widths.

    Parameters
    ----------
    views : sequence of RegisteredView
        The reference (``is_reference``) is among them. An edge is believed where other views
        see it, too: half as many of their pixels as of the reference's own, at least.
    grid : Grid
        Widths are in its HR pixels, along the axes that are enlarged.
    noise : float
        Standard deviation, grey levels.
    """
    unit = grid.largest
    reference = next(view for view in views if view.is_reference)
    edges = _edges(reference.observed, grid, noise)
    samples = _samples(views, edges, grid)
    noise = max(noise, SMALLEST_NOISE)
    count = edges.row.size
    fits = [
        _fit(samples, slice(first, first + AT_ONCE), noise, unit)
        for first in range(0, count, AT_ONCE)
    ]
    if not fits:
        nothing = np.zeros(0)
        return EdgeWidths(row=edges.row, column=edges.column, width=nothing, error=nothing)
    parameters, error, rms = (np.concatenate(parts) for parts in zip(*fits, strict=True))
    width = np.exp(parameters[:, WIDTH])
    error = error * width * np.maximum(1.0, rms / noise)
    height = np.abs(parameters[:, STEP])
    unexplained = np.sqrt(np.maximum(rms**2 - noise**2, 0))
    slope = np.abs(parameters[:, [SLOPE_BEFORE, SLOPE_BEHIND]]).max(axis=1)
    own = (samples.is_own * samples.valid).sum(1)
    clean = (
        (height >= max(LEAST_CONTRAST[0], LEAST_CONTRAST[1] * noise))
        & (unexplained < LARGEST_MISFIT * height)
        & (slope * ACROSS * unit < LARGEST_SLOPE * height)
        & (error < LARGEST_ERROR * unit)
        & (width > 1.01 * WIDTHS[0] * unit)
        & (width < 0.99 * WIDTHS[1] * unit)
        & (samples.valid.sum(1) >= 1.5 * own)
    )
    blurred = np.sqrt(_blurred_share(edges, grid))
    return EdgeWidths(
        row=edges.row, column=edges.column, width=width / blurred, error=error / blurred
    ).chosen(clean)


def _blurred_share(edges: _Edges, grid: Grid) -> Values:
    along_x = edges.normal_x**2 if grid.magnification_x > 1 else 0.0
    along_y = edges.normal_y**2 if grid.magnification_y > 1 else 0.0
    return np.asarray(along_x + along_y)


def _edges(reference: GreyImage, grid: Grid, noise: float) -> _Edges:
    """Return the crests of the gradient's magnitude, the steepest first, some way apart."""
    smooth = cv2.GaussianBlur(reference, (0, 0), SMOOTHING)
    gradient_x = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8)
    gradient_y = cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    steepness = np.hypot(gradient_x, gradient_y)
    safe = np.maximum(steepness, np.float32(1e-6))
    height, width = reference.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)

    def beside(step: float) -> GreyImage:
        return cv2.remap(
            steepness, columns + step * gradient_x / safe, rows + step * gradient_y / safe,
            cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip

    crest = (steepness >= beside(1)) & (steepness > beside(-1))
    crest &= steepness > max(LEAST_STEEPNESS, noise)
    inner = np.zeros_like(crest)
    inner[BORDER:-BORDER, BORDER:-BORDER] = True
    row, column = np.nonzero(crest & inner)
    steepest = np.argsort(-steepness[row, column], kind="stable")
    chosen = _apart(row[steepest], column[steepest], reference.shape)
    row, column = row[steepest][chosen], column[steepest][chosen]
    # A normal of the HR grid: distances there are K times longer, gradients K times smaller.
    normal_x = gradient_x[row, column].astype(np.float64) / grid.magnification_x
    normal_y = gradient_y[row, column].astype(np.float64) / grid.magnification_y
    length = np.hypot(normal_x, normal_y)
    edges = _Edges(row=row, column=column, normal_x=normal_x / length, normal_y=normal_y / length)
    told = _blurred_share(edges, grid) >= LEAST_BLURRED
    return _Edges(
        row=row[told], column=column[told],
        normal_x=edges.normal_x[told], normal_y=edges.normal_y[told],
    )  # fmt: skip


def _apart(
    row: npt.NDArray[np.int64], column: npt.NDArray[np.int64], shape: tuple[int, ...]
) -> list[int]:
    """Return the indices of points, in their order, that are no neighbours of earlier ones."""
    taken = np.zeros(shape, bool)
    chosen: list[int] = []
    for index, (y, x) in enumerate(zip(row.tolist(), column.tolist(), strict=True)):
        if taken[y, x]:
            continue
        taken[max(0, y - APART) : y + APART + 1, max(0, x - APART) : x + APART + 1] = True
        chosen.append(index)
        if len(chosen) == MOST_EDGES:
            break
    return chosen


def _samples(views: Sequence[RegisteredView], edges: _Edges, grid: Grid) -> _Samples:
    """Return the trusted pixels of all views around each edge."""
    height, width = next(view for view in views if view.is_reference).observed.shape
    trusted = [(view.flags == 0) & np.isfinite(view.position).all(axis=-1) for view in views]
    place = np.concatenate([view.position[good] for view, good in zip(views, trusted, strict=True)])
    observed = np.concatenate(
        [view.observed[good] for view, good in zip(views, trusted, strict=True)]
    )
    is_own = np.repeat(
        [view.is_reference for view in views], [np.count_nonzero(good) for good in trusted]
    )
    column, row = np.rint(place).astype(np.int64).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    cell = np.where(inside, row * width + column, height * width)
    order = np.argsort(cell, kind="stable")
    starts = np.searchsorted(cell[order], np.arange(height * width + 1))

    reach_x, reach_y = (
        int(np.ceil(np.hypot(ACROSS, ALONG) * grid.largest / k))
        for k in (grid.magnification_x, grid.magnification_y)
    )
    left = np.maximum(edges.column - reach_x, 0)
    right = np.minimum(edges.column + reach_x, width - 1)
    edge_parts, sample_parts = [], []
    for offset in range(-reach_y, reach_y + 1):
        line = edges.row + offset
        seen = np.flatnonzero((line >= 0) & (line < height))
        first = starts[line[seen] * width + left[seen]]
        many = starts[line[seen] * width + right[seen] + 1] - first
        edge_parts.append(np.repeat(seen, many))
        ahead = np.cumsum(many) - many
        sample_parts.append(np.arange(many.sum()) + np.repeat(first - ahead, many))
    edge, sample = np.concatenate(edge_parts), order[np.concatenate(sample_parts)]
    x = grid.magnification_x * (place[sample, 0] - edges.column[edge])
    y = grid.magnification_y * (place[sample, 1] - edges.row[edge])
    across = x * edges.normal_x[edge] + y * edges.normal_y[edge]
    along = y * edges.normal_x[edge] - x * edges.normal_y[edge]
    unit = grid.largest
    unit_along = np.hypot(
        grid.magnification_x * edges.normal_y, grid.magnification_y * edges.normal_x
    )[edge]  # fmt: skip
    near = np.flatnonzero((np.abs(across) <= ACROSS * unit) & (np.abs(along) <= ALONG * unit_along))
    near = near[np.argsort(edge[near], kind="stable")]
    edge, sample = edge[near], sample[near]
    counts = np.bincount(edge, minlength=edges.row.size)
    rank = np.arange(edge.size) - np.repeat(np.cumsum(counts) - counts, counts)

    def padded(values: npt.NDArray) -> npt.NDArray:
        out = np.zeros((edges.row.size, counts.max(initial=0)), values.dtype)
        out[edge, rank] = values
        return out

    return _Samples(
        across=padded(across[near]), along=padded(along[near]),
        observed=padded(observed[sample].astype(np.float64)),
        valid=padded(np.ones(edge.size)), is_own=padded(is_own[sample]),
    )  # fmt: skip


def _profile(parameters: Values, across: Values, along: Values) -> tuple[Values, Values]:
    """Return the profiles (E, n), and their derivatives by the parameters (E, n, 7).

    The step Φ(d/s) between two levels; the slopes before and behind it are blurred with it:
    ∫ Φ(d/s) = d Φ(d/s) + s φ(d/s) is the slope behind, d less that the one before.
    """
    place, log_width, tilt, level, step, before, behind = (
        parameters[:, column, None] for column in range(parameters.shape[1])
    )
    width = np.exp(log_width)
    distance = across - place - tilt * along
    ratio = distance / width
    share = scipy.special.ndtr(ratio)
    density = np.exp(-0.5 * ratio**2) / np.sqrt(2 * np.pi)
    rising = distance * share + width * density
    profile = level + step * share + before * (distance - rising) + behind * rising
    by_distance = step * density / width + before * (1 - share) + behind * share
    by_width = density * ((behind - before) * width - step * ratio)
    derivatives = np.stack(
        [-by_distance, by_width, -by_distance * along, np.ones_like(distance), share,
         distance - rising, rising],
        axis=-1,
    )  # fmt: skip
    return profile, derivatives


def _fit(samples: _Samples, which: slice, noise: float, unit: int) -> tuple[Values, Values, Values]:
    """Return the parameters of some edges (E, 7), standard errors of their log width, RMS.

    Damped least squares (Levenberg, Marquardt), each edge with a damping of its own.
    """
    across, along = samples.across[which], samples.along[which]
    observed, valid = samples.observed[which], samples.valid[which]
    precision = np.diag((noise / EXPECTED) ** 2)
    parameters = np.zeros((across.shape[0], EXPECTED.size))
    parameters[:, WIDTH] = np.log(0.75 * unit)
    sides = [valid * (sign * across > 0.4 * ACROSS * unit) for sign in (-1, 1)]
    low, high = ((side * observed).sum(1) / np.maximum(side.sum(1), 1) for side in sides)
    parameters[:, LEVEL], parameters[:, STEP] = low, high - low

    def state(parameters: Values) -> tuple[Values, Values, Values]:
        profile, derivatives = _profile(parameters, across, along)
        residual = (observed - profile) * valid
        cost = (residual**2).sum(1) + np.einsum("ei,ij,ej->e", parameters, precision, parameters)
        return residual, derivatives * valid[..., None], cost

    residual, derivatives, cost = state(parameters)
    damping = np.full(cost.size, 1e-2)
    for _ in range(ITERATIONS):
        matrix, right = _normal_equations(derivatives, residual, parameters, precision)
        diagonal = np.einsum("eii->ei", matrix)
        damped = matrix + np.eye(EXPECTED.size) * (damping[:, None] * diagonal + 1e-9)[:, None]
        change = np.linalg.solve(damped, right[..., None])[..., 0]
        tried = parameters + np.clip(change, -LARGEST_STEP, LARGEST_STEP)
        tried[:, WIDTH] = np.clip(tried[:, WIDTH], *np.log(np.multiply(WIDTHS, unit)))
        new_residual, new_derivatives, new_cost = state(tried)
        better = new_cost < cost
        parameters = np.where(better[:, None], tried, parameters)
        residual = np.where(better[:, None], new_residual, residual)
        derivatives = np.where(better[:, None, None], new_derivatives, derivatives)
        cost = np.where(better, new_cost, cost)
        damping = np.where(better, 0.3 * damping, 5 * damping)
    matrix, _ = _normal_equations(derivatives, residual, parameters, precision)
    covariance = noise**2 * np.linalg.inv(matrix + 1e-9 * np.eye(EXPECTED.size))
    freedom = np.maximum(valid.sum(1) - EXPECTED.size, 1)
    rms = np.sqrt((residual**2).sum(1) / freedom)
    return parameters, np.sqrt(np.abs(covariance[:, WIDTH, WIDTH])), rms


def _normal_equations(
    derivatives: Values, residual: Values, parameters: Values, precision: Values
) -> tuple[Values, Values]:
    transposed = derivatives.swapaxes(1, 2)
    matrix = transposed @ derivatives + precision
    right = (transposed @ residual[..., None])[..., 0] - parameters @ precision
    return matrix, right
