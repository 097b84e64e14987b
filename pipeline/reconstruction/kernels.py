"""Compiled loops of the fused solver: observations gathered and sampled, edges weighed.

All loops release the global lock and work on a range of rows, so that ranges can run on
several threads and the result does not depend on how many. Arrays are C-contiguous float32
if not said otherwise; the caller guarantees shapes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.reconstruction.rows import copy_row, mirror
from pipeline.reconstruction.simd import (
    CELL,
    LANES,
    TOGETHER,
    add_nine,
    planes_of_eight,
    sample_eight,
)

NUM_TAPS = 12
"""Numbers that tell what an observation adds."""

NUM_COUPLINGS = 13
"""Unique couplings of a 5 × 5 symmetric stencil: itself, 2 to the right, 5 + 5 below."""

SMALLEST_WEIGHT = 0.01
"""Observations of no more weight are not worth their time."""

LARGEST_UNIT = 65535.0
"""Couplings are kept as 16-bit shares of the largest one in their row."""


@njit(**OPTIONS)
def landing_rows(position_y, weight, height, first, last):
    """Write the first and the last HR row on which pixels of each stretch of an LR row land.

    Parameters
    ----------
    position_y, weight : (H, W) float32
        HR pixels; a weight up to ``SMALLEST_WEIGHT`` leaves the pixel out.
    height : int
        KH.
    first, last : (H, ⌈W / TOGETHER⌉) int32
        Overwritten; first > last where none lands inside.
    """
    smallest, half = np.float32(SMALLEST_WEIGHT), np.float32(0.5)
    below, above, top = np.float32(height), np.float32(-1.0), np.int32(height)
    for row in range(first.shape[0]):
        for stretch in range(first.shape[1]):
            start = stretch * TOGETHER
            points = position_y[row, start : start + TOGETHER]
            weights = weight[row, start : start + TOGETHER]
            low, high = top, np.int32(-1)
            for k in range(points.size):
                y = points[k]
                is_in = (weights[k] > smallest) & (y > above) & (y < below)
                nearest = np.int32(np.floor((y if is_in else above) + half))
                low = min(low, nearest if is_in else top)
                high = max(high, nearest)
            first[row, stretch], last[row, stretch] = low, high


@njit(**LEAN)
def _spline(t):
    """Return the three taps of a quadratic B-spline at an offset from the middle one."""
    half = np.float32(0.5)
    return (
        half * (half - t) * (half - t), np.float32(0.75) - t * t, half * (half + t) * (half + t)
    )  # fmt: skip


@njit(**OPTIONS)
def gather_observations(
    position_x, position_y, observed, weight, first, last, level, lo, hi, height, width, cells
):
    """Add the normal equations of one view's observations to the cells of HR rows, in place.

    Each observation is a quadratic B-spline sample of the blurred estimate: nine taps s around
    the nearest HR pixel. The cells get w·s·sᵀ and w·s·y, see :func:`simd.add_nine`.

    Parameters
    ----------
    position_x, position_y : (H, W) float32
        Landing points, HR pixels.
    observed, weight : (H, W) float32
        Grey levels; a weight up to ``SMALLEST_WEIGHT`` leaves the pixel out.
    first, last : (H, ⌈W / TOGETHER⌉) int32
        From :func:`landing_rows`.
    level : float32
        Subtracted from what is observed, grey levels.
    lo, hi : int
        HR rows, half-open, to which the observations are nearest that are added.
    height, width : int
        KH, KW.
    cells : (≥ (hi − lo + 2)·(KW + 2)·CELL,) float32
        Rows ``lo`` − 1 to ``hi`` + 1, columns −1 to KW + 1.
    """
    stride = (width + 2) * CELL
    taps = np.empty(NUM_TAPS * TOGETHER, np.float32)
    places = np.empty(TOGETHER, np.int32)
    for row in range(first.shape[0]):
        for stretch in range(first.shape[1]):
            if last[row, stretch] < lo or first[row, stretch] >= hi:
                continue
            start = stretch * TOGETHER
            end = min(start + TOGETHER, observed.shape[1])
            _weigh_taps(
                position_x[row, start:end], position_y[row, start:end], observed[row, start:end],
                weight[row, start:end], level, lo, hi, height, width, places, taps,
            )  # fmt: skip
            for k in range(end - start):
                if places[k] >= 0:
                    add_nine(cells, places[k], stride, taps, k)


@njit(**LEAN)
def _weigh_taps(
    position_x, position_y, observed, weight, level, lo, hi, height, width, places, taps
):
    """Write where observations land and what they add there; see :func:`gather_observations`.

    Without a branch, and what is read or written lies at known distances, so that eight are
    worked on at once.

    Parameters
    ----------
    position_x, position_y, observed, weight : (≤ TOGETHER,) float32
    places : (TOGETHER,) int32
        The first number of the first of nine cells, negative where the observation is left out.
    taps : (NUM_TAPS · TOGETHER,) float32
        What :func:`simd.add_nine` takes.
    """
    half, nothing = np.float32(0.5), np.float32(0.0)
    smallest = np.float32(SMALLEST_WEIGHT)
    top, bottom = np.float32(max(lo, 0)), np.float32(min(hi, height) - 1)
    right, under = np.float32(width - 1), np.float32(height - 1)
    above, pitch = np.int32(lo), np.int32(width + 2)
    for k in range(weight.size):
        w = weight[k]
        px, py = position_x[k], position_y[k]
        fx, fy = np.floor(px + half), np.floor(py + half)
        is_in = (w > smallest) & (fx >= nothing) & (fx <= right) & (fy >= top) & (fy <= bottom)
        x0, x1, x2 = _spline(px - fx)
        y0, y1, y2 = _spline(py - fy)
        # at the very border taps fold onto the image: reflection about the edge
        x1 = x1 + x0 if fx == nothing else x1
        x0 = nothing if fx == nothing else x0
        x1 = x1 + x2 if fx == right else x1
        x2 = nothing if fx == right else x2
        y1 = y1 + y0 if fy == nothing else y1
        y0 = nothing if fy == nothing else y0
        y1 = y1 + y2 if fy == under else y1
        y2 = nothing if fy == under else y2
        w0, w1, w2 = w * y0, w * y1, w * y2
        value = w * (observed[k] - level)
        column, row = np.int32(fx if is_in else nothing), np.int32(fy if is_in else top)
        cell = np.int32(CELL) * ((row - above) * pitch + column)
        places[k] = cell if is_in else np.int32(-1)
        taps[k] = x0
        taps[TOGETHER + k] = x1
        taps[2 * TOGETHER + k] = x2
        taps[3 * TOGETHER + k] = w0 * y0
        taps[4 * TOGETHER + k] = w0 * y1
        taps[5 * TOGETHER + k] = w0 * y2
        taps[6 * TOGETHER + k] = w1 * y1
        taps[7 * TOGETHER + k] = w1 * y2
        taps[8 * TOGETHER + k] = w2 * y2
        taps[9 * TOGETHER + k] = value * y0
        taps[10 * TOGETHER + k] = value * y1
        taps[11 * TOGETHER + k] = value * y2


@njit(**OPTIONS)
def spread_cells(cells, top, lo, hi, width, couplings, units, rhs):
    """Write gathered cells as planes, of which the sweeps read eight pixels at once.

    Parameters
    ----------
    cells : float32
        Of :func:`gather_observations`, from HR row ``top`` to at least two rows below ``hi``.
    couplings : (13, KH + 4, ≥ KW + 12) uint16
        Padded by two in front. Plane 0: pixel with itself; 1, 2: one and two to the right;
        3…7: one row below, x −2…2; 8…12: two rows below, x −2…2. Rows ``lo`` to ``hi``
        are overwritten.
    units : (KH + 4,) float32
        Padded by two: what one is worth in each row.
    rhs : (KH, KW) float32
    """
    plane, pitch = couplings.shape[1] * couplings.shape[2], couplings.shape[2]
    flat = couplings.reshape(-1)
    line = np.empty(width + LANES, np.float32)
    bits, largest = cells.view(np.int32), np.empty(1, np.int32)
    own, below = _largest(bits, lo - top, width), _largest(bits, lo - top + 1, width)
    for y in range(lo, hi):
        # no coupling exceeds both of its pixels' couplings with themselves
        far = _largest(bits, y - top + 2, width)
        largest[0] = max(max(own, below), far)
        own, below = below, far
        unit = largest.view(np.float32)[0] / np.float32(LARGEST_UNIT)
        base = ((y - top) * (width + 2) + 1) * CELL
        units[y + 2] = unit
        inverse = np.float32(1.0) / unit if unit > 0 else np.float32(0.0)
        to = (y + 2) * pitch + 2
        for x in range(0, width, LANES):
            planes_of_eight(cells, base + x * CELL, inverse, flat, to + x, plane, line, x)
        copy_row(line[:width], rhs[y])


@njit(**OPTIONS)
def pass_on(cells, rows, width):
    """Make the last two of so many rows of cells the first two, and empty the others."""
    size = (width + 2) * CELL
    for k in range(2 * size):
        cells[k] = cells[(rows - 2) * size + k]
    cells[2 * size :] = 0


@njit(**LEAN)
def _largest(bits, row, width):
    """Return the bits of the largest coupling of a pixel with itself in a row of cells.

    They are in the order of the numbers, none of which is negative: many are compared at once.
    """
    line = bits[(row * (width + 2) + 1) * CELL :]
    largest = np.int32(0)
    for x in range(width):
        largest = max(largest, line[x * CELL])
    return largest


@njit(**OPTIONS)
def gather_regular(observed, level, column, taps_x, row, taps_y, rhs):
    """Add s·y of observations at regular places to the right-hand side, in place.

    Parameters
    ----------
    observed : (H, W) float32
    level : float32
        Subtracted from what is observed, grey levels.
    column, row : (W,), (H,) int64
        HR pixel nearest to each.
    taps_x, taps_y : (W, 3), (H, 3) float32
        Folded at the border.
    rhs : (KH, KW) float32
    """
    height, width = rhs.shape
    for i in range(observed.shape[0]):
        for a in range(3):
            y = row[i] + a - 1
            if y < 0 or y >= height:
                continue
            line, down = rhs[y], taps_y[i, a]
            for j in range(observed.shape[1]):
                value = down * (observed[i, j] - level)
                for b in range(3):
                    x = column[j] + b - 1
                    if 0 <= x < width:
                        line[x] += value * taps_x[j, b]


@njit(**OPTIONS)
def sum_gradients(coefficients, position_x, position_y, observed, scale, cell, sums):
    """Add what a least-squares shift of each pixel is found from to the cell it lies in.

    With g the gradient of the B-spline at a pixel's landing point and e the error of what it
    predicts, weighted (1 + (e / scale)²)⁻²: g_x², g_x g_y, g_y², g_x e and g_y e.

    Parameters
    ----------
    coefficients, position_x, position_y
        As of :func:`sample_spline`.
    observed : (H, W) float32
        Grey levels.
    scale : float32
        Grey levels.
    cell : int
        Side of a cell, LR pixels.
    sums : (5, ⌈H / cell⌉, ⌈W / cell⌉) float32
        Added to.
    """
    height = coefficients.shape[0] - 4
    width = coefficients.shape[1] - 4
    half, one = np.float32(0.5), np.float32(1.0)
    for row in range(observed.shape[0]):
        for column in range(observed.shape[1]):
            px = position_x[row, column]
            py = position_y[row, column]
            if not (px > -half and py > -half and px < width - half and py < height - half):
                continue
            cx = np.uint64(px + half)
            cy = np.uint64(py + half)
            tx = px - np.float32(cx)
            ty = py - np.float32(cy)
            x0, x1, x2 = _spline(tx)
            y0, y1, y2 = _spline(ty)
            a, b, c = cx + np.uint64(1), cx + np.uint64(2), cx + np.uint64(3)
            above = coefficients[cy + np.uint64(1)]
            own = coefficients[cy + np.uint64(2)]
            below = coefficients[cy + np.uint64(3)]
            u = x0 * above[a] + x1 * above[b] + x2 * above[c]
            v = x0 * own[a] + x1 * own[b] + x2 * own[c]
            w = x0 * below[a] + x1 * below[b] + x2 * below[c]
            down = (half - ty) * (v - u) + (half + ty) * (w - v)
            left = y0 * above[a] + y1 * own[a] + y2 * below[a]
            middle = y0 * above[b] + y1 * own[b] + y2 * below[b]
            right = y0 * above[c] + y1 * own[c] + y2 * below[c]
            across = (half - tx) * (middle - left) + (half + tx) * (right - middle)
            error = observed[row, column] - (y0 * u + y1 * v + y2 * w)
            share = one / (one + (error / scale) ** 2)
            share *= share
            i, j = row // cell, column // cell
            sums[0, i, j] += share * across * across
            sums[1, i, j] += share * across * down
            sums[2, i, j] += share * down * down
            sums[3, i, j] += share * across * error
            sums[4, i, j] += share * down * error


@njit(nogil=True, cache=True, error_model="numpy")
def square_steps(image, out):
    """Write the squared differences of each pixel to those right of it and below, summed."""
    height, width = image.shape
    for row in range(height):
        own, line = image[row], out[row]
        for x in range(width - 1):
            line[x] = (own[x + 1] - own[x]) * (own[x + 1] - own[x])
        line[width - 1] = np.float32(0.0)
        if row + 1 < height:
            below = image[row + 1]
            for x in range(width):
                line[x] += (below[x] - own[x]) * (below[x] - own[x])


@njit(**OPTIONS)
def split_points(position, magnification_x, offset_x, magnification_y, offset_y, x, y):
    """Write the HR coordinates of LR points (H, W, 2), (H, W) each."""
    for row in range(x.shape[0]):
        for column in range(x.shape[1]):
            x[row, column] = position[row, column, 0] * magnification_x + offset_x
            y[row, column] = position[row, column, 1] * magnification_y + offset_y


@njit(**OPTIONS)
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
    height, width = coefficients.shape[0] - 4, coefficients.shape[1] - 4
    flat, pitch = coefficients.reshape(-1), coefficients.shape[1]
    places, taps = np.zeros(TOGETHER, np.int32), np.zeros(6 * TOGETHER, np.float32)
    line = np.empty(TOGETHER, np.float32)
    nothing = np.float32(np.nan)
    for row in range(row_lo, row_hi):
        for start in range(0, columns, TOGETHER):
            end = min(start + TOGETHER, columns)
            _spline_taps(
                position_x[row, start:end], position_y[row, start:end], height, width, pitch,
                places, taps,
            )  # fmt: skip
            for k in range(0, end - start, LANES):
                sample_eight(flat, places, pitch, taps, k, line)
            seen = out[row, start:end]
            for k in range(seen.size):
                seen[k] = line[k] if places[k] > 0 else nothing


@njit(**LEAN)
def _spline_taps(position_x, position_y, height, width, pitch, places, taps):
    """Write of what coefficients the samples of a stretch are made, see :func:`sample_spline`.

    Parameters
    ----------
    position_x, position_y : (≤ TOGETHER,) float32
    places : (TOGETHER,) int32
        Of the first of nine coefficients, which is never 0; 0 outside.
    taps : (6 · TOGETHER,) float32
        What :func:`simd.sample_eight` takes.
    """
    half, nothing = np.float32(0.5), np.float32(0.0)
    right, under = np.float32(width) - half, np.float32(height) - half
    along = np.int32(pitch)
    for k in range(position_x.size):
        px, py = position_x[k], position_y[k]
        is_in = (px > -half) & (py > -half) & (px < right) & (py < under)
        px, py = px if is_in else nothing, py if is_in else nothing
        fx, fy = np.floor(px + half), np.floor(py + half)
        x0, x1, x2 = _spline(px - fx)
        y0, y1, y2 = _spline(py - fy)
        place = (np.int32(fy) + np.int32(1)) * along + np.int32(fx) + np.int32(1)
        places[k] = place if is_in else np.int32(0)
        taps[k] = x0
        taps[TOGETHER + k] = x1
        taps[2 * TOGETHER + k] = x2
        taps[3 * TOGETHER + k] = y0
        taps[4 * TOGETHER + k] = y1
        taps[5 * TOGETHER + k] = y2


@njit(**OPTIONS)
def filter_phases(image, along_x, along_y, lo, hi, out):
    """Write the HR rows of LR rows ``lo`` to ``hi``, each phase filtered by taps of its own.

    Parameters
    ----------
    image : (H, W) float32
    along_x, along_y : (K, odd) float32
        Taps over LR pixels, of each phase along x and along y.
    out : (KH, KW) float32
    """
    height, width = image.shape
    phases_x, phases_y = along_x.shape[0], along_y.shape[0]
    reach_x, reach_y = along_x.shape[1] // 2, along_y.shape[1] // 2
    room = np.empty(width + 2 * reach_x, np.float32)
    line = np.empty(width, np.float32)
    own = room[reach_x : reach_x + width]
    for row in range(lo, hi):
        for phase_y in range(phases_y):
            own[:] = 0
            for k in range(along_y.shape[1]):
                _add_scaled(image[mirror(row + k - reach_y, height)], along_y[phase_y, k], own)
            for k in range(1, reach_x + 1):
                room[reach_x - k] = own[mirror(-k, width)]
                room[reach_x + width - 1 + k] = own[mirror(width - 1 + k, width)]
            target = out[row * phases_y + phase_y]
            for phase_x in range(phases_x):
                line[:] = 0
                for k in range(along_x.shape[1]):
                    _add_scaled(room[k : k + width], along_x[phase_x, k], line)
                for x in range(width):
                    target[x * phases_x + phase_x] = line[x]


@njit(**LEAN)
def _add_scaled(row, factor, out):
    for x in range(out.size):
        out[x] += factor * row[x]
