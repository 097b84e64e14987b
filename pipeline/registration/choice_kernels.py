"""Compiled loops that choose a motion for each pixel among windows, and blend those that agree."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import EXACT, LEAN, OPTIONS
from pipeline.registration.kernels import value_at
from pipeline.registration.window_kernels import OUTSIDE, row_of_motion

LARGEST_ENERGY = np.float32(2500.0)
"""Squared residuals are cut off here where motions are compared, grey levels²."""


@njit(**OPTIONS)
def reach_of_windows(windows, fresh, side, reach):
    """Write, of each window, the box around what lies in fresh cells; empty where nothing does.

    Parameters
    ----------
    windows, reach : (P, 4) int32
    fresh : (rows, columns) bool
        Cells, ``side`` pixels wide.
    """
    for p in range(windows.shape[0]):
        x0, y0, x1, y1 = windows[p, 2], windows[p, 3], windows[p, 0], windows[p, 1]
        for i in range(windows[p, 1] // side, (windows[p, 3] - 1) // side + 1):
            for j in range(windows[p, 0] // side, (windows[p, 2] - 1) // side + 1):
                if fresh[i, j]:
                    x0, x1 = min(x0, j * side), max(x1, (j + 1) * side)
                    y0, y1 = min(y0, i * side), max(y1, (i + 1) * side)
        reach[p, 0], reach[p, 1] = max(x0, windows[p, 0]), max(y0, windows[p, 1])
        reach[p, 2], reach[p, 3] = min(x1, windows[p, 2]), min(y1, windows[p, 3])


@njit(**OPTIONS)
def spread(cells, side, pixels):
    """Write what is known of cells, ``side`` pixels wide, to each of their pixels."""
    for i in range(cells.shape[0]):
        for j in range(cells.shape[1]):
            pixels[i * side : (i + 1) * side, j * side : (j + 1) * side] = cells[i, j]


@njit(**OPTIONS)
def choose_windows(
    source, reference, nearness, windows, reach, ranges, motion, candidates, renewed, agreement,
    radius, mismatch, residual, gradient_x, gradient_y, move_u, move_v, best, cost,
):  # fmt: skip
    """Give pixels to windows that dissent from their owner and explain them better, in place.

    The cost of a motion is the mean squared residual in a (2·radius + 1)² box, plus
    ``mismatch`` times the squared distance (in nearness) to the patch's range. Windows that
    agree everywhere with the owners have nothing to win.

    Parameters
    ----------
    source, reference : (H, W), (H' + 4, W' + 4) float32
        Luma, and spline coefficients of the reference's.
    reach : (P, 4) int32
        The part of each window that may be given to it, see :func:`reach_of_windows`.
    candidates : (P,) bool
        Patches that may be chosen.
    renewed : (H, W) bool
        Pixels that may be given away; of the others there are no samples.
    agreement : float
        Difference of two displacements up to which they agree, LR pixels.
    residual, gradient_x, gradient_y, move_u, move_v : (H, W) float32
        At the owners' motions, see ``window_kernels.sum_cells``.
    best : (H, W) int32
        Modified: patch number; the owner to begin with.
    cost : (H, W) float32
        Modified: cost of that choice.
    """
    tallest = 0
    widest = 0
    for p in range(windows.shape[0]):
        widest = max(widest, windows[p, 2] - windows[p, 0])
        tallest = max(tallest, windows[p, 3] - windows[p, 1])
    larger = max(widest, tallest)
    scratch = (
        np.empty((widest, tallest), np.float32), np.empty((tallest, widest), np.float32),
        np.empty(larger, np.float32), np.empty(larger, np.float64),
        np.arange(source.shape[1]).astype(np.float32),
    )  # fmt: skip
    samples = residual, gradient_x, gradient_y, move_u, move_v
    _choose(
        source, reference, nearness, windows, reach, ranges, motion, candidates, renewed,
        np.float32(agreement * agreement), radius, mismatch, samples, scratch, best, cost,
    )  # fmt: skip


@njit(**LEAN)
def _choose(
    source, reference, nearness, windows, reach, ranges, motion, candidates, renewed, limit, radius,
    mismatch, samples, scratch, best, cost,
):  # fmt: skip
    """Do what :func:`choose_windows` says; ``limit`` is the square of its ``agreement``."""
    energy, smooth, sums, means, places = scratch
    zero = np.float32(0.0)
    for p in range(windows.shape[0]):
        if not candidates[p]:
            continue
        x0, y0, x1, y1 = reach[p, 0], reach[p, 1], reach[p, 2], reach[p, 3]
        left, top, right, bottom = _dissent(
            windows, motion, p, reach[p], renewed, samples[3], samples[4], places, limit
        )
        if right <= left:
            continue
        # with what the box around needs
        x0, x1 = max(x0, left - radius), min(x1, right + radius)
        y0, y1 = max(y0, top - radius), min(y1, bottom + radius)
        rows = y1 - y0
        columns = x1 - x0
        _energies(source, reference, windows, motion, p, (x0, y0, x1, y1), renewed, samples, energy)
        for y in range(rows):
            sums[y] = zero
        for x in range(min(radius, columns)):
            _add(energy[x], rows, sums)
        for x in range(columns):
            if x + radius < columns:
                _add(energy[x + radius], rows, sums)
            if x - radius - 1 >= 0:
                _subtract(energy[x - radius - 1], rows, sums)
            n = min(x + radius, columns - 1) - max(x - radius, 0) + 1
            _mean(sums, rows, n, means)
            for y in range(rows):
                smooth[np.uint64(y), np.uint64(x)] = means[y]
        for x in range(columns):
            sums[x] = zero
        for y in range(min(radius, rows)):
            _add(smooth[y], columns, sums)
        for y in range(rows):
            if y + radius < rows:
                _add(smooth[y + radius], columns, sums)
            if y - radius - 1 >= 0:
                _subtract(smooth[y - radius - 1], columns, sums)
            n = min(y + radius, rows - 1) - max(y - radius, 0) + 1
            _mean(sums, columns, n, means)
            row = np.uint64(y0 + y)
            for k in range(columns):
                column = np.uint64(x0 + k)
                d = nearness[row, column]
                away = max(ranges[p, 0] - d, d - ranges[p, 1], zero)
                value = means[k] + mismatch * away * away
                if renewed[row, column] and value < cost[row, column]:
                    cost[row, column] = value
                    best[row, column] = p


@njit(**LEAN)
def _dissent(windows, motion, p, box, renewed, move_u, move_v, places, limit):
    """Return the box (x0, y0, x1, y1) around the pixels where a window dissents; x1 ≤ x0: none.

    Parameters
    ----------
    box : (4,) int32
        Where it is looked for.
    places : (W,) float32
        The columns' numbers.
    limit : float32
        Square of the difference of displacements from which it does.
    """
    x0, y0, x1, y1 = box[0], box[1], box[2], box[3]
    left, top, right, bottom = x1, y1, x0, y0
    for y in range(y0, y1):
        row = np.uint64(y)
        au, bu, av, bv = row_of_motion(windows, motion, p, np.int64(y))
        found = False
        for k in range(x0, x1):
            x = np.uint64(k)
            du = au + bu * places[x] - move_u[row, x]
            dv = av + bv * places[x] - move_v[row, x]
            found |= (du * du + dv * dv > limit) & renewed[row, x]
        if not found:
            continue
        top = min(top, y)
        bottom = y + 1
        for k in range(x0, x1):
            x = np.uint64(k)
            du = au + bu * places[x] - move_u[row, x]
            dv = av + bv * places[x] - move_v[row, x]
            if renewed[row, x] and du * du + dv * dv > limit:
                left = min(left, k)
                right = max(right, k + 1)
    return left, top, right, bottom


@njit(**LEAN)
def _energies(source, reference, windows, motion, p, box, renewed, samples, energy):
    """Write the squared residuals in a box, (x0, y0, x1, y1), at the motion of a window.

    ``energy`` has a line for each column, so that sums along rows are taken of all rows at once.
    """
    residual, gradient_x, gradient_y, move_u, move_v = samples
    x0, y0, x1, y1 = box
    linear = np.float32(0.25)
    zeta = np.float32(motion[p, 12])
    for y in range(y0, y1):
        row, down = np.uint64(y), np.uint64(y - y0)
        au, bu, av, bv = row_of_motion(windows, motion, p, np.int64(y))
        for k in range(x0, x1):
            x = np.uint64(k)
            u = au + bu * np.float32(k)
            v = av + bv * np.float32(k)
            du = u - move_u[row, x]
            dv = v - move_v[row, x]
            if renewed[row, x] and du * du + dv * dv <= linear:
                # the residual holds ζ of the owner, which differs little
                e = residual[row, x] + gradient_x[row, x] * du + gradient_y[row, x] * dv
            else:
                value = value_at(reference, np.float32(k) + u, np.float32(y) + v)
                e = value - source[row, x] + zeta if np.isfinite(value) else OUTSIDE
            energy[np.uint64(k - x0), down] = min(e * e, LARGEST_ENERGY)


@njit(**LEAN)
def _add(row, size, sums):
    """Add as many first numbers of a row to sums."""
    for x in range(size):
        sums[x] += row[x]


@njit(**LEAN)
def _subtract(row, size, sums):
    """Take as many first numbers of a row from sums."""
    for x in range(size):
        sums[x] -= row[x]


@njit(**EXACT)
def _mean(sums, size, count, out):
    """Write sums, not below zero, divided by how many numbers they are of, not by a reciprocal."""
    for x in range(size):
        out[x] = max(sums[x], np.float32(0.0)) / count


@njit(**OPTIONS)
def blend_windows(
    windows, reach, motion, candidates, owners, best, renewed, move_u, move_v, agreement, lo, hi,
    position, offset,
):  # fmt: skip
    """Write the landing point of each pixel: its patch's motion blended with those that agree.

    Overlapping patches whose motion at the pixel lies within ``agreement`` pixels of the
    chosen one are averaged with a weight that falls off from their centre, which makes
    the piecewise motion continuous on curved surfaces.

    Parameters
    ----------
    reach : (P, 4) int32
        The part of each window that takes part, see :func:`reach_of_windows`.
    candidates : (P,) bool
        Patches that take part.
    renewed : (H, W) bool
        Pixels that are written; the others stay.
    lo, hi : int
        Rows that are written, half-open.
    move_u, move_v : (H, W) float32
        Displacement of the owners; modified: of the chosen patches.
    position : (H, W, 2) float32
        Written: x + u, y + v; NaN where no patch was chosen.
    offset : (H, W) float32
        Written: ζ blended likewise, grey levels.
    """
    width = best.shape[1]
    closeness = np.float32(1 / (agreement * agreement))
    one = np.float32(1.0)
    total = np.zeros((hi - lo, width), np.float32)
    sum_u = np.zeros((hi - lo, width), np.float32)
    sum_v = np.zeros((hi - lo, width), np.float32)
    zetas = np.zeros((hi - lo, width), np.float32)
    for y in range(lo, hi):
        for x in range(width):
            p = best[y, x]
            if renewed[y, x] and p >= 0 and p != owners[y, x]:
                au, bu, av, bv = row_of_motion(windows, motion, np.int64(p), y)
                move_u[y, x] = au + bu * np.float32(x)
                move_v[y, x] = av + bv * np.float32(x)
    sums = total, sum_u, sum_v, zetas
    _gather(windows, reach, motion, candidates, move_u, move_v, closeness, lo, hi, sums)
    for y in range(lo, hi):
        row = y - lo
        for x in range(width):
            if not renewed[y, x]:
                continue
            if best[y, x] >= 0 and total[row, x] > 0:
                inverse = one / total[row, x]
                position[y, x, 0] = np.float32(x) + (move_u[y, x] + sum_u[row, x] * inverse)
                position[y, x, 1] = np.float32(y) + (move_v[y, x] + sum_v[row, x] * inverse)
                offset[y, x] = zetas[row, x] * inverse
            else:
                position[y, x, 0] = np.nan
                position[y, x, 1] = np.nan
                offset[y, x] = 0


@njit(**LEAN)
def _gather(windows, reach, motion, candidates, move_u, move_v, closeness, lo, hi, sums):
    """Add up, for each pixel of some rows, the weights of the windows around and what they weigh.

    ``sums`` are of those rows.
    """
    one = np.float32(1.0)
    zero = np.float32(0.0)
    total, sum_u, sum_v, zetas = sums
    for p in range(windows.shape[0]):
        if not candidates[p]:
            continue
        x0, y0, x1, y1 = windows[p, 0], windows[p, 1], windows[p, 2], windows[p, 3]
        xc = np.float32(0.5 * (x0 + x1 - 1))
        yc = 0.5 * (y0 + y1 - 1)
        inverse_x = np.float32(1 / (0.5 * (x1 - x0) + 0.5))
        reach_y = 0.5 * (y1 - y0) + 0.5
        zeta = np.float32(motion[p, 12])
        for y in range(max(reach[p, 1], lo), min(reach[p, 3], hi)):
            row, place = np.uint64(y), np.uint64(y - lo)
            fall_y = np.float32(1 - abs(y - yc) / reach_y)
            au, bu, av, bv = row_of_motion(windows, motion, p, np.int64(y))
            for k in range(reach[p, 0], reach[p, 2]):
                x = np.uint64(k)
                at = np.float32(k)
                du = au + bu * at - move_u[row, x]
                dv = av + bv * at - move_v[row, x]
                near = max(one - (du * du + dv * dv) * closeness, zero)
                fall = max(fall_y * (one - abs(at - xc) * inverse_x), np.float32(1e-3))
                w = fall * near * near
                total[place, x] += w
                sum_u[place, x] += w * du
                sum_v[place, x] += w * dv
                zetas[place, x] += w * zeta
