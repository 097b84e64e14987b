"""Compiled loops that choose a motion for each pixel among windows, and blend those that agree."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.registration.kernels import OPTIONS, value_at
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
    energy = np.empty((tallest, widest), np.float32)
    smooth = np.empty((tallest, widest), np.float32)
    zero = np.float32(0.0)
    limit = np.float32(agreement * agreement)
    linear = np.float32(0.25)
    for p in range(windows.shape[0]):
        if not candidates[p]:
            continue
        x0, y0, x1, y1 = reach[p, 0], reach[p, 1], reach[p, 2], reach[p, 3]
        # where it dissents, with what the box around needs
        left, top, right, bottom = x1, y1, x0, y0
        for y in range(y0, y1):
            au, bu, av, bv = row_of_motion(windows, motion, p, np.int64(y))
            farthest = zero
            for x in range(x0, x1):
                du = au + bu * np.float32(x) - move_u[y, x]
                dv = av + bv * np.float32(x) - move_v[y, x]
                farthest = max(farthest, (du * du + dv * dv) * np.float32(renewed[y, x]))
            if farthest <= limit:
                continue
            top = min(top, y)
            bottom = y + 1
            for x in range(x0, x1):
                du = au + bu * np.float32(x) - move_u[y, x]
                dv = av + bv * np.float32(x) - move_v[y, x]
                if renewed[y, x] and du * du + dv * dv > limit:
                    left = min(left, x)
                    right = max(right, x + 1)
        if right <= left:
            continue
        x0, x1 = max(x0, left - radius), min(x1, right + radius)
        y0, y1 = max(y0, top - radius), min(y1, bottom + radius)
        rows = y1 - y0
        columns = x1 - x0
        zeta = np.float32(motion[p, 12])
        for y in range(y0, y1):
            au, bu, av, bv = row_of_motion(windows, motion, p, np.int64(y))
            for x in range(x0, x1):
                u = au + bu * np.float32(x)
                v = av + bv * np.float32(x)
                du = u - move_u[y, x]
                dv = v - move_v[y, x]
                if renewed[y, x] and du * du + dv * dv <= linear:
                    # the residual holds ζ of the owner, which differs little
                    e = residual[y, x] + gradient_x[y, x] * du + gradient_y[y, x] * dv
                else:
                    value = value_at(reference, np.float32(x) + u, np.float32(y) + v)
                    e = value - source[y, x] + zeta if np.isfinite(value) else OUTSIDE
                energy[y - y0, x - x0] = min(e * e, LARGEST_ENERGY)
        for y in range(rows):
            total = zero
            for x in range(min(radius, columns)):
                total += energy[y, x]
            for x in range(columns):
                if x + radius < columns:
                    total += energy[y, x + radius]
                if x - radius - 1 >= 0:
                    total -= energy[y, x - radius - 1]
                n = min(x + radius, columns - 1) - max(x - radius, 0) + 1
                smooth[y, x] = total / n
        for x in range(columns):
            total = zero
            for y in range(min(radius, rows)):
                total += smooth[y, x]
            for y in range(rows):
                if y + radius < rows:
                    total += smooth[y + radius, x]
                if y - radius - 1 >= 0:
                    total -= smooth[y - radius - 1, x]
                n = min(y + radius, rows - 1) - max(y - radius, 0) + 1
                value = max(total, zero) / n
                d = nearness[y0 + y, x0 + x]
                away = max(ranges[p, 0] - d, d - ranges[p, 1], zero)
                value += mismatch * away * away
                if renewed[y0 + y, x0 + x] and value < cost[y0 + y, x0 + x]:
                    cost[y0 + y, x0 + x] = value
                    best[y0 + y, x0 + x] = p


@njit(**OPTIONS)
def blend_windows(
    windows, reach, motion, candidates, owners, best, renewed, move_u, move_v, agreement, position,
    offset,
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
    move_u, move_v : (H, W) float32
        Displacement of the owners; modified: of the chosen patches.
    position : (H, W, 2) float32
        Written: x + u, y + v; NaN where no patch was chosen.
    offset : (H, W) float32
        Written: ζ blended likewise, grey levels.
    """
    height, width = best.shape
    closeness = np.float32(1 / (agreement * agreement))
    one = np.float32(1.0)
    zero = np.float32(0.0)
    total = np.zeros((height, width), np.float32)
    sum_u = np.zeros((height, width), np.float32)
    sum_v = np.zeros((height, width), np.float32)
    zetas = np.zeros((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            p = best[y, x]
            if renewed[y, x] and p >= 0 and p != owners[y, x]:
                au, bu, av, bv = row_of_motion(windows, motion, np.int64(p), y)
                move_u[y, x] = au + bu * np.float32(x)
                move_v[y, x] = av + bv * np.float32(x)
    for p in range(windows.shape[0]):
        if not candidates[p]:
            continue
        x0, y0, x1, y1 = windows[p, 0], windows[p, 1], windows[p, 2], windows[p, 3]
        xc = np.float32(0.5 * (x0 + x1 - 1))
        yc = 0.5 * (y0 + y1 - 1)
        inverse_x = np.float32(1 / (0.5 * (x1 - x0) + 0.5))
        reach_y = 0.5 * (y1 - y0) + 0.5
        zeta = np.float32(motion[p, 12])
        for y in range(reach[p, 1], reach[p, 3]):
            fall_y = np.float32(1 - abs(y - yc) / reach_y)
            au, bu, av, bv = row_of_motion(windows, motion, p, np.int64(y))
            for x in range(reach[p, 0], reach[p, 2]):
                at = np.float32(x)
                du = au + bu * at - move_u[y, x]
                dv = av + bv * at - move_v[y, x]
                near = max(one - (du * du + dv * dv) * closeness, zero)
                fall = max(fall_y * (one - abs(at - xc) * inverse_x), np.float32(1e-3))
                w = fall * near * near
                total[y, x] += w
                sum_u[y, x] += w * du
                sum_v[y, x] += w * dv
                zetas[y, x] += w * zeta
    for y in range(height):
        for x in range(width):
            if not renewed[y, x]:
                continue
            if best[y, x] >= 0 and total[y, x] > 0:
                inverse = one / total[y, x]
                position[y, x, 0] = np.float32(x) + (move_u[y, x] + sum_u[y, x] * inverse)
                position[y, x, 1] = np.float32(y) + (move_v[y, x] + sum_v[y, x] * inverse)
                offset[y, x] = zetas[y, x] * inverse
            else:
                position[y, x, 0] = np.nan
                position[y, x, 1] = np.nan
                offset[y, x] = 0
