"""Compiled inner loops of the fused solver: gather, stencil, prior.

All loops release the global lock and work on a band of HR rows, so that
bands can run on several threads and the result does not depend on how many.
Arrays are C-contiguous float32; the caller guarantees shapes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

NUM_COUPLINGS = 13
"""Unique couplings of a 5 × 5 symmetric stencil: itself, 2 to the right, 5 + 5 below."""

SMALLEST_WEIGHT = 0.01
"""Observations of no more weight are not worth their time."""

_OPTIONS = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    # not the flags that assume finite numbers: NaN marks what has no value
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


@njit(**_OPTIONS)
def gather_observations(position_x, position_y, observed, weight, row_lo, row_hi, couplings, rhs):
    """Add the normal equations of one view's observations to a band of HR rows, in place.

    Each observation is a quadratic B-spline sample of the blurred estimate:
    nine taps around the nearest HR pixel. ``couplings`` gets w·s·sᵀ, ``rhs`` w·s·y.

    Parameters
    ----------
    position_x, position_y : (H, W) float32
        Landing points, HR pixels.
    observed, weight : (H, W) float32
        Grey levels; a weight up to ``SMALLEST_WEIGHT`` leaves the pixel out.
    row_lo, row_hi : int
        HR rows of this band, half-open; taps outside it are left to other bands.
    couplings : (13, KH, KW) float32
        Modified in place. Plane 0: pixel with itself; 1, 2: one and two to the right;
        3…7: one row below, x −2…2; 8…12: two rows below, x −2…2.
    rhs : (KH, KW) float32
        Modified in place.
    """
    rows, columns = observed.shape
    height, width = rhs.shape
    tap_x = np.empty(3, np.float32)
    tap_y = np.empty(3, np.float32)
    half = np.float32(0.5)
    for row in range(rows):
        for column in range(columns):
            w = weight[row, column]
            if not w > SMALLEST_WEIGHT:
                continue
            py = position_y[row, column]
            centre_y = int(np.floor(py + half))
            if centre_y + 1 < row_lo or centre_y - 1 >= row_hi:
                continue
            px = position_x[row, column]
            centre_x = int(np.floor(px + half))
            if centre_x < 0 or centre_x >= width or centre_y < 0 or centre_y >= height:
                continue
            tx = px - np.float32(centre_x)
            ty = py - np.float32(centre_y)
            tap_x[0] = half * (half - tx) * (half - tx)
            tap_x[1] = np.float32(0.75) - tx * tx
            tap_x[2] = half * (half + tx) * (half + tx)
            tap_y[0] = half * (half - ty) * (half - ty)
            tap_y[1] = np.float32(0.75) - ty * ty
            tap_y[2] = half * (half + ty) * (half + ty)
            # at the very border taps fold onto the image: reflection about the edge
            if centre_x == 0:
                tap_x[1] += tap_x[0]
                tap_x[0] = np.float32(0.0)
            if centre_x == width - 1:
                tap_x[1] += tap_x[2]
                tap_x[2] = np.float32(0.0)
            if centre_y == 0:
                tap_y[1] += tap_y[0]
                tap_y[0] = np.float32(0.0)
            if centre_y == height - 1:
                tap_y[1] += tap_y[2]
                tap_y[2] = np.float32(0.0)
            value = w * observed[row, column]
            if (
                row_lo < centre_y < row_hi - 1
                and 0 < centre_x < width - 1
                and 0 < centre_y < height - 1
            ):
                for a in range(3):
                    y = centre_y + a - 1
                    x = centre_x - 1
                    v0 = w * tap_y[a] * tap_x[0]
                    v1 = w * tap_y[a] * tap_x[1]
                    v2 = w * tap_y[a] * tap_x[2]
                    va = value * tap_y[a]
                    rhs[y, x] += va * tap_x[0]
                    rhs[y, x + 1] += va * tap_x[1]
                    rhs[y, x + 2] += va * tap_x[2]
                    t0 = tap_y[a] * tap_x[0]
                    t1 = tap_y[a] * tap_x[1]
                    t2 = tap_y[a] * tap_x[2]
                    couplings[0, y, x] += v0 * t0
                    couplings[0, y, x + 1] += v1 * t1
                    couplings[0, y, x + 2] += v2 * t2
                    couplings[1, y, x] += v0 * t1
                    couplings[1, y, x + 1] += v1 * t2
                    couplings[2, y, x] += v0 * t2
                    for a2 in range(a + 1, 3):
                        t0 = tap_y[a2] * tap_x[0]
                        t1 = tap_y[a2] * tap_x[1]
                        t2 = tap_y[a2] * tap_x[2]
                        plane = 5 + 5 * (a2 - a - 1)
                        couplings[plane, y, x] += v0 * t0
                        couplings[plane, y, x + 1] += v1 * t1
                        couplings[plane, y, x + 2] += v2 * t2
                        couplings[plane + 1, y, x] += v0 * t1
                        couplings[plane + 1, y, x + 1] += v1 * t2
                        couplings[plane - 1, y, x + 1] += v1 * t0
                        couplings[plane - 1, y, x + 2] += v2 * t1
                        couplings[plane + 2, y, x] += v0 * t2
                        couplings[plane - 2, y, x + 2] += v2 * t0
                continue
            for a in range(3):
                y = centre_y + a - 1
                if y < row_lo or y >= row_hi or y < 0 or y >= height:
                    continue
                wa = w * tap_y[a]
                va = value * tap_y[a]
                for b in range(3):
                    x = centre_x + b - 1
                    if x < 0 or x >= width:
                        continue
                    wab = wa * tap_x[b]
                    rhs[y, x] += va * tap_x[b]
                    for b2 in range(b, 3):
                        couplings[b2 - b, y, x] += wab * tap_y[a] * tap_x[b2]
                    for a2 in range(a + 1, 3):
                        plane = 5 + 5 * (a2 - a - 1)
                        waba = wab * tap_y[a2]
                        for b2 in range(3):
                            couplings[plane + b2 - b, y, x] += waba * tap_x[b2]


@njit(**_OPTIONS)
def apply_couplings(couplings, image, row_lo, row_hi, out):
    """Write the symmetric 5 × 5 stencil applied to the image into rows of ``out``.

    Couplings of pixels within two of the border to pixels outside are zero by
    construction, so the caller pads ``image`` by two zero pixels on each side.

    Parameters
    ----------
    couplings : (13, KH + 4, KW + 4) float32
        Padded by two zero pixels on each side.
    image : (KH + 4, KW + 4) float32
        Padded likewise.
    out : (KH, KW) float32
        Rows ``row_lo`` to ``row_hi`` are overwritten.
    """
    width = out.shape[1]
    for y in range(row_lo, row_hi):
        v = y + 2
        line = out[y]
        for x in range(width):
            u = x + 2
            total = couplings[0, v, u] * image[v, u]
            total += couplings[1, v, u] * image[v, u + 1] + couplings[1, v, u - 1] * image[v, u - 1]
            total += couplings[2, v, u] * image[v, u + 2] + couplings[2, v, u - 2] * image[v, u - 2]
            line[x] = total
        for dx in range(-2, 3):
            one = couplings[5 + dx]
            two = couplings[10 + dx]
            for x in range(width):
                u = x + 2
                line[x] += (
                    one[v, u] * image[v + 1, u + dx]
                    + one[v - 1, u - dx] * image[v - 1, u - dx]
                    + two[v, u] * image[v + 2, u + dx]
                    + two[v - 2, u - dx] * image[v - 2, u - dx]
                )


@njit(**_OPTIONS)
def edge_weights(image, scale, row_lo, row_hi, out):
    """Write the reweighting of an edge-preserving prior into rows of ``out``.

    Charbonnier penalty of the four first differences: weight 1 / √(d² + scale²)
    (times 1/√2 for the diagonals), so that flat parts are smoothed and edges are kept.

    Parameters
    ----------
    image : (KH, KW) float32
        Current estimate, grey levels.
    scale : float
        Difference below which the prior is quadratic, grey levels.
    out : (4, KH + 2, KW + 2) float32
        Padded by one; planes: right, below-left, below, below-right.
    """
    height, width = image.shape
    scale2 = np.float32(scale * scale)
    diagonal = np.float32(0.5)
    for y in range(row_lo, row_hi):
        for x in range(width - 1):
            d = image[y, x + 1] - image[y, x]
            out[0, y + 1, x + 1] = 1 / np.sqrt(d * d + scale2)
        if y + 1 < height:
            for x in range(width):
                d = image[y + 1, x] - image[y, x]
                out[2, y + 1, x + 1] = 1 / np.sqrt(d * d + scale2)
            for x in range(1, width):
                d = image[y + 1, x - 1] - image[y, x]
                out[1, y + 1, x + 1] = diagonal / np.sqrt(d * d + scale2)
            for x in range(width - 1):
                d = image[y + 1, x + 1] - image[y, x]
                out[3, y + 1, x + 1] = diagonal / np.sqrt(d * d + scale2)


@njit(**_OPTIONS)
def apply_prior(weights, image, row_lo, row_hi, strength, out):
    """Add ``strength`` times the weighted graph Laplacian of the image to rows of ``out``.

    Parameters
    ----------
    weights : (4, KH + 2, KW + 2) float32
        From :func:`edge_weights`; zero where a neighbour is outside.
    image : (KH + 4, KW + 4) float32
        Padded by two.
    """
    width = out.shape[1]
    s = np.float32(strength)
    for y in range(row_lo, row_hi):
        v = y + 2
        p = y + 1
        for x in range(width):
            u = x + 2
            q = x + 1
            c = image[v, u]
            total = weights[0, p, q] * (c - image[v, u + 1])
            total += weights[0, p, q - 1] * (c - image[v, u - 1])
            total += weights[2, p, q] * (c - image[v + 1, u])
            total += weights[2, p - 1, q] * (c - image[v - 1, u])
            total += weights[1, p, q] * (c - image[v + 1, u - 1])
            total += weights[1, p - 1, q + 1] * (c - image[v - 1, u + 1])
            total += weights[3, p, q] * (c - image[v + 1, u + 1])
            total += weights[3, p - 1, q - 1] * (c - image[v - 1, u - 1])
            out[y, x] += s * total


@njit(**_OPTIONS)
def advance(step, direction, applied, estimate, residual, row_lo, row_hi):
    """Take one step of conjugate gradients in rows of estimate and residual, in place."""
    s = np.float32(step)
    for y in range(row_lo, row_hi):
        for x in range(estimate.shape[1]):
            estimate[y, x] += s * direction[y, x]
            residual[y, x] -= s * applied[y, x]


@njit(**_OPTIONS)
def dot(first, second, row_lo, row_hi):
    """Return the sum of products of two images over a band of rows, in float64."""
    total = 0.0
    for y in range(row_lo, row_hi):
        line = np.float32(0.0)
        for x in range(first.shape[1]):
            line += first[y, x] * second[y, x]
        total += line
    return total


@njit(**_OPTIONS)
def sharpen(image, blurred, amount, row_lo, row_hi, out):
    """Write image + amount · (image − blurred) into rows of ``out``."""
    a = np.float32(amount)
    for y in range(row_lo, row_hi):
        for x in range(image.shape[1]):
            out[y, x] = image[y, x] + a * (image[y, x] - blurred[y, x])


@njit(**_OPTIONS)
def turn(factor, sharpened, direction, row_lo, row_hi):
    """Write the next conjugate direction, sharpened + factor · direction, in place."""
    f = np.float32(factor)
    for y in range(row_lo, row_hi):
        for x in range(direction.shape[1]):
            direction[y, x] = sharpened[y, x] + f * direction[y, x]


@njit(**_OPTIONS)
def sample_spline(coefficients, position_x, position_y, row_lo, row_hi, out):
    """Write quadratic B-spline samples at HR positions into rows of ``out``; NaN outside.

    Parameters
    ----------
    coefficients : (KH + 4, KW + 4) float32
        Spline coefficients (blurred and prefiltered estimate), padded by two by edge values.
    position_x, position_y : (H, W) float32
        HR pixels.
    out : (H, W) float32
        Rows ``row_lo`` to ``row_hi`` (LR rows) are overwritten.
    """
    columns = out.shape[1]
    height = coefficients.shape[0] - 4
    width = coefficients.shape[1] - 4
    half = np.float32(0.5)
    for row in range(row_lo, row_hi):
        for column in range(columns):
            px = position_x[row, column]
            py = position_y[row, column]
            if not (px > -half and py > -half and px < width - half and py < height - half):
                out[row, column] = np.nan
                continue
            cx = int(np.floor(px + half))
            cy = int(np.floor(py + half))
            tx = px - np.float32(cx)
            ty = py - np.float32(cy)
            x0 = half * (half - tx) * (half - tx)
            x1 = np.float32(0.75) - tx * tx
            x2 = half * (half + tx) * (half + tx)
            total = np.float32(0.0)
            for a in range(3):
                if a == 0:
                    wy = half * (half - ty) * (half - ty)
                elif a == 1:
                    wy = np.float32(0.75) - ty * ty
                else:
                    wy = half * (half + ty) * (half + ty)
                v = cy + a + 1
                total += wy * (
                    x0 * coefficients[v, cx + 1]
                    + x1 * coefficients[v, cx + 2]
                    + x2 * coefficients[v, cx + 3]
                )
            out[row, column] = total
