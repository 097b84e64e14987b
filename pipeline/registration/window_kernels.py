"""Compiled loops of the windows' fits: each pixel sampled once, sums of cells, steps.

Each pixel is *owned* by one patch, that of the cell it lies in. A pass samples the reference
where the owners' motions send their pixels and sums up, cell by cell, what a robust
Gauss–Newton step needs; a patch's window is put together from the sums of the cells around it,
carried over to its own motion. So no pixel is sampled twice, though windows overlap.

The samples lie on a *sampling grid*: every q-th pixel of the view, q = stride · 2^level. All
motions are in LR pixels whatever the level.

A counter that is handed to another kernel begins as a typed zero, and a number out of an array is
widened: for a literal, or for numbers of another width, that kernel would be compiled once more.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.registration.kernels import (
    DEGENERATE,
    FITTED,
    HISTOGRAM_BINS,
    MAD_TO_SIGMA,
    RAN_AWAY,
    TOO_FEW,
    TUKEY,
    copy,
    solve,
)

OUTSIDE = np.float32(1e6)
"""Residual of a pixel that lands outside the reference, grey levels."""


@njit(**LEAN)
def row_of_motion(windows, motion, p, y):
    """Return (a_u, b_u, a_v, b_v): patch p moves a pixel (x, y) by u = a_u + b_u x, v likewise."""
    xc = 0.5 * (windows[p, 0] + windows[p, 2] - 1)
    yc = 0.5 * (windows[p, 1] + windows[p, 3] - 1)
    larger = max(windows[p, 2] - windows[p, 0], windows[p, 3] - windows[p, 1])
    inverse = 1 / max(0.5 * larger, 1.0)
    slope_u = motion[p, 1] * inverse
    slope_v = motion[p, 7] * inverse
    down = (y - yc) * inverse
    return (
        np.float32(motion[p, 0] + motion[p, 2] * down - slope_u * xc),
        np.float32(slope_u),
        np.float32(motion[p, 6] + motion[p, 8] * down - slope_v * xc),
        np.float32(slope_v),
    )


@njit(**LEAN)
def _median(values, count, mean, histogram):
    """Return the median of so many magnitudes, from a histogram of eight times their mean."""
    width = max(8.0 * mean, 1e-3)
    factor = np.float32(HISTOGRAM_BINS / width)
    top = np.float32(HISTOGRAM_BINS - 1)
    histogram[:] = 0
    for k in range(count):
        histogram[int(min(abs(values[k]) * factor, top))] += 1
    seen = 0
    b = 0
    while b < HISTOGRAM_BINS - 1 and seen + histogram[b] < (count + 1) // 2:
        seen += histogram[b]
        b += 1
    return (b + 0.5) * width / HISTOGRAM_BINS


@njit(**LEAN)
def _moments(residual, gradient_x, gradient_y, place_x, place_y, count, cut, sums):
    """Write the sums over samples that a robust Gauss–Newton step is made of.

    Weighted by Tukey's biweight with cut-off 1 / √cut: gx², gx gy, gy² times 1, X, Y, X², XY,
    Y²; gx, gy, gx e, gy e times 1, X, Y; 1, e; and how many weights are above zero.
    """
    one = np.float32(1.0)
    zero = np.float32(0.0)
    a0 = a1 = a2 = a3 = a4 = a5 = zero
    b0 = b1 = b2 = b3 = b4 = b5 = zero
    c0 = c1 = c2 = c3 = c4 = c5 = zero
    for k in range(count):
        e = residual[k]
        w = max(one - e * e * cut, zero)
        w *= w
        X = place_x[k]
        Y = place_y[k]
        wx = w * gradient_x[k]
        a = wx * gradient_x[k]
        b = wx * gradient_y[k]
        c = w * gradient_y[k] * gradient_y[k]
        a0 += a
        b0 += b
        c0 += c
        aX = a * X
        bX = b * X
        cX = c * X
        a1 += aX
        b1 += bX
        c1 += cX
        a3 += aX * X
        b3 += bX * X
        c3 += cX * X
        a4 += aX * Y
        b4 += bX * Y
        c4 += cX * Y
        a2 += a * Y
        b2 += b * Y
        c2 += c * Y
        a5 += a * Y * Y
        b5 += b * Y * Y
        c5 += c * Y * Y
    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5] = a0, a1, a2, a3, a4, a5
    sums[6], sums[7], sums[8], sums[9], sums[10], sums[11] = b0, b1, b2, b3, b4, b5
    sums[12], sums[13], sums[14], sums[15], sums[16], sums[17] = c0, c1, c2, c3, c4, c5
    x0 = x1 = x2 = y0 = y1 = y2 = d0 = d1 = d2 = f0 = f1 = f2 = s0 = se = number = zero
    for k in range(count):
        e = residual[k]
        w = max(one - e * e * cut, zero)
        w *= w
        X = place_x[k]
        Y = place_y[k]
        wx = w * gradient_x[k]
        wy = w * gradient_y[k]
        x0 += wx
        x1 += wx * X
        x2 += wx * Y
        y0 += wy
        y1 += wy * X
        y2 += wy * Y
        d = wx * e
        f = wy * e
        d0 += d
        d1 += d * X
        d2 += d * Y
        f0 += f
        f1 += f * X
        f2 += f * Y
        s0 += w
        se += w * e
        number += one if w > zero else zero
    sums[18], sums[19], sums[20], sums[21], sums[22], sums[23] = x0, x1, x2, y0, y1, y2
    sums[24], sums[25], sums[26], sums[27], sums[28], sums[29] = d0, d1, d2, f0, f1, f2
    sums[30], sums[31], sums[32] = s0, se, number


@njit(**OPTIONS)
def sum_cells(
    source, source_gx, source_gy, reference, stride, finer, owners, cells, windows, motion, due,
    min_scale, scale, sums, residual, gradient_x, gradient_y, move_u, move_v,
):  # fmt: skip
    """Sample the reference at the pixels that patches own, and sum up what fits need of it.

    Parameters
    ----------
    source, source_gx, source_gy : (h, w) float32
        A pyramid level of the source and its gradient, grey levels a pixel of the level.
    reference : (h' + 4, w' + 4) float32
        Spline coefficients of the same level of the reference.
    stride, finer : int
        Every ``stride``-th pixel of the level is sampled; it is ``finer`` times coarser than LR.
    owners, cells, windows : (H, W), (P, 4), (P, 4) int32
        See :class:`Patches`.
    motion : (P, 13) float64
        Affine motions.
    due : (P,) bool
        Patches whose pixels are sampled; the sums of others stay.
    min_scale : float
        Smallest residual scale, grey levels.
    scale : (P,) float32
        Modified: robust scale of the residuals, grey levels.
    sums : (P, 35) float64
        Modified: those of :func:`_moments` times the precision of a sample, the samples inside
        the reference, and all samples.
    residual, gradient_x, gradient_y, move_u, move_v : (H, W) float32, or (0, 0)
        Written where stride and ``finer`` are one: reference − source + ζ, ``OUTSIDE`` where
        there is none; mean gradient of source and warped reference; the displacement.
    """
    half = np.float32(0.5)
    pitch = stride * finer
    line = reference.shape[1]
    # places are not negative, and unsigned numbers need no check that they are
    one, two, below = np.uint64(1), np.uint64(2), np.uint64(line)
    limit_x = np.float32(line - 4) - half
    limit_y = np.float32(reference.shape[0] - 4) - half
    coarser = np.float32(1 / finer)
    share = half * coarser
    taps = reference.ravel()
    keep = residual.size > 0
    area = 1
    for p in range(cells.shape[0]):
        area = max(area, (cells[p, 2] - cells[p, 0]) * (cells[p, 3] - cells[p, 1]))
    value = np.empty(area, np.float32)
    along = np.empty(area, np.float32)
    down = np.empty(area, np.float32)
    place_x = np.empty(area, np.float32)
    place_y = np.empty(area, np.float32)
    histogram = np.empty(HISTOGRAM_BINS, np.int64)
    for p in range(cells.shape[0]):
        if not due[p]:
            continue
        xc = np.float32(0.5 * (windows[p, 0] + windows[p, 2] - 1))
        yc = np.float32(0.5 * (windows[p, 1] + windows[p, 3] - 1))
        larger = max(windows[p, 2] - windows[p, 0], windows[p, 3] - windows[p, 1])
        inverse = np.float32(1 / max(0.5 * larger, 1.0))
        zeta = np.float32(motion[p, 12])
        count = np.int64(0)
        within = 0
        total = np.float32(0.0)
        for i in range((cells[p, 1] + pitch - 1) // pitch, (cells[p, 3] + pitch - 1) // pitch):
            row = i * pitch
            au, bu, av, bv = row_of_motion(windows, motion, p, row)
            for j in range((cells[p, 0] + pitch - 1) // pitch, (cells[p, 2] + pitch - 1) // pitch):
                column = j * pitch
                if owners[np.uint64(row), np.uint64(column)] != p:
                    continue
                within += 1
                y_at, x_at = np.uint64(i), np.uint64(j)
                y_in, x_in = np.uint64(i * stride), np.uint64(j * stride)
                u = au + bu * np.float32(column)
                v = av + bv * np.float32(column)
                x = (np.float32(column) + u) * coarser
                y = (np.float32(row) + v) * coarser
                if not (x > -half and y > -half and x < limit_x and y < limit_y):
                    if keep:
                        residual[y_at, x_at] = OUTSIDE
                        gradient_x[y_at, x_at] = 0
                        gradient_y[y_at, x_at] = 0
                        move_u[y_at, x_at] = u
                        move_v[y_at, x_at] = v
                    continue
                cx = int(x + half)
                cy = int(y + half)
                tx = x - np.float32(cx)
                ty = y - np.float32(cy)
                x0 = half * (half - tx) * (half - tx)
                x1 = np.float32(0.75) - tx * tx
                x2 = half * (half + tx) * (half + tx)
                dx0 = tx - half
                dx1 = np.float32(-2.0) * tx
                dx2 = tx + half
                a = np.uint64((cy + 1) * line + cx + 1)
                b = a + below
                c = b + below
                ra = x0 * taps[a] + x1 * taps[a + one] + x2 * taps[a + two]
                rb = x0 * taps[b] + x1 * taps[b + one] + x2 * taps[b + two]
                rc = x0 * taps[c] + x1 * taps[c + one] + x2 * taps[c + two]
                y0 = half * (half - ty) * (half - ty)
                y1 = np.float32(0.75) - ty * ty
                y2 = half * (half + ty) * (half + ty)
                gx = (
                    y0 * (dx0 * taps[a] + dx1 * taps[a + one] + dx2 * taps[a + two])
                    + y1 * (dx0 * taps[b] + dx1 * taps[b + one] + dx2 * taps[b + two])
                    + y2 * (dx0 * taps[c] + dx1 * taps[c + one] + dx2 * taps[c + two])
                )
                gy = (ty - half) * ra - np.float32(2.0) * ty * rb + (ty + half) * rc
                e = y0 * ra + y1 * rb + y2 * rc - source[y_in, x_in] + zeta
                gx = share * (gx + source_gx[y_in, x_in])
                gy = share * (gy + source_gy[y_in, x_in])
                k = np.uint64(count)
                value[k] = e
                along[k] = gx
                down[k] = gy
                place_x[k] = (np.float32(column) - xc) * inverse
                place_y[k] = (np.float32(row) - yc) * inverse
                total += abs(e)
                count += 1
                if keep:
                    residual[y_at, x_at] = e
                    gradient_x[y_at, x_at] = gx
                    gradient_y[y_at, x_at] = gy
                    move_u[y_at, x_at] = u
                    move_v[y_at, x_at] = v
        if count > 0:
            sigma = MAD_TO_SIGMA * _median(value, count, total / count, histogram)
            scale[p] = max(sigma, min_scale)
        sigma = float(scale[p])
        cut = np.float32(1 / (TUKEY * sigma) ** 2)
        _moments(value, along, down, place_x, place_y, count, cut, sums[p])
        for m in range(32):
            sums[p, m] /= sigma * sigma
        sums[p, 33] = count
        sums[p, 34] = within


@njit(**LEAN)
def _add_cell(sums, k, ratio, bx, by, du, dv, dzeta, moments, matrix, step):
    """Add k times the sums of a cell to the normal equations of a patch, in the patch's frame.

    A place X of the cell is ratio · X + bx in the patch's frame, Y likewise; ``du``, ``dv``
    (3,) and ``dzeta`` are the patch's motion less that at which the cell was sampled.
    Unknowns are u, v (1, X, Y each), then ζ; only the lower triangle is filled. ``moments``
    (3, 6) is scratch.
    """
    square = ratio * ratio
    for n in range(3):
        m = 6 * n
        m0, m1, m2 = sums[m], sums[m + 1], sums[m + 2]
        moments[n, 0] = m0
        moments[n, 1] = ratio * m1 + bx * m0
        moments[n, 2] = ratio * m2 + by * m0
        moments[n, 3] = square * sums[m + 3] + 2 * ratio * bx * m1 + bx * bx * m0
        moments[n, 4] = square * sums[m + 4] + ratio * (bx * m2 + by * m1) + bx * by * m0
        moments[n, 5] = square * sums[m + 5] + 2 * ratio * by * m2 + by * by * m0
    for n in range(3):  # gx², gx gy, gy²
        row = 0 if n == 0 else 3
        column = 3 if n == 2 else 0
        t = moments[n]
        matrix[row, column] += k * t[0]
        matrix[row + 1, column] += k * t[1]
        matrix[row + 2, column] += k * t[2]
        matrix[row + 1, column + 1] += k * t[3]
        matrix[row + 2, column + 1] += k * t[4]
        matrix[row + 2, column + 2] += k * t[5]
        if n == 1:
            matrix[row, column + 1] += k * t[1]
            matrix[row, column + 2] += k * t[2]
            matrix[row + 1, column + 2] += k * t[4]
    e0 = sums[31] + dzeta * sums[30]
    for n in range(2):
        g0 = sums[18 + 3 * n]
        g1 = ratio * sums[19 + 3 * n] + bx * g0
        g2 = ratio * sums[20 + 3 * n] + by * g0
        matrix[6, 3 * n] += k * g0
        matrix[6, 3 * n + 1] += k * g1
        matrix[6, 3 * n + 2] += k * g2
        d = du if n == 0 else dv
        e0 += d[0] * g0 + d[1] * g1 + d[2] * g2
        r0 = sums[24 + 3 * n]
        r1 = ratio * sums[25 + 3 * n] + bx * r0
        r2 = ratio * sums[26 + 3 * n] + by * r0
        p = moments[n]
        q = moments[n + 1]
        r0 += dzeta * g0 + du[0] * p[0] + du[1] * p[1] + du[2] * p[2]
        r0 += dv[0] * q[0] + dv[1] * q[1] + dv[2] * q[2]
        r1 += dzeta * g1 + du[0] * p[1] + du[1] * p[3] + du[2] * p[4]
        r1 += dv[0] * q[1] + dv[1] * q[3] + dv[2] * q[4]
        r2 += dzeta * g2 + du[0] * p[2] + du[1] * p[4] + du[2] * p[5]
        r2 += dv[0] * q[2] + dv[1] * q[4] + dv[2] * q[5]
        step[3 * n] -= k * r0
        step[3 * n + 1] -= k * r1
        step[3 * n + 2] -= k * r2
    matrix[6, 6] += k * sums[30]
    step[6] -= k * e0


@njit(**OPTIONS)
def step_windows(
    sums, first, rows, columns, windows, motion, start, prior, linear, offset_mean,
    offset_precision, min_support, beside, across, farthest, due, moved, status, reliable, out,
):  # fmt: skip
    """Take one step of the affine motion of each patch, from the sums of the cells around it.

    The window of a patch is its own cell and, less weighted, those next to it, as far as the
    motions of their patches agree with its own: the same surface.

    Parameters
    ----------
    sums : (P, 35) float64
        From :func:`sum_cells`, at ``motion``.
    first : (rows · columns + 1,) int32
        The first patch of each cell.
    windows : (P, 4) int32
    motion, start : (P, 13) float64
    prior : (P, 2, 2) float64
        Precision of the mean displacement about its start, px⁻².
    linear : float
        Factor on that precision for the linear terms.
    offset_mean, offset_precision : float
        Prior of ζ, grey levels and grey levels⁻².
    min_support : int
        Samples below which a patch is not fitted.
    beside, across : float
        Weight of the cells to the four sides, and at the four corners.
    farthest : float
        Difference of the displacements, at a neighbour's middle, from which it is of another
        surface, LR pixels.
    due : (P,) bool
        Patches to step.
    moved : (P,) float32
        Written: how far no point of the patch has moved, LR pixels.
    status : (P,) int32
        Written: FITTED, or TOO_FEW, DEGENERATE, RAN_AWAY (the start is taken).
    reliable : (P,) float32
        Written: share of the samples within the robust cut-off.
    out : (P, 13) float64
        Written: the new motions.
    """
    scratch = np.empty((7, 7)), np.empty(7), np.empty((3, 6)), np.empty(3), np.empty(3)
    _step_windows(
        sums, first, rows, columns, windows, motion, start, prior, linear, offset_mean,
        offset_precision, min_support, beside, across, farthest * farthest, due, scratch, moved,
        status, reliable, out,
    )  # fmt: skip


@njit(**LEAN)
def _step_windows(
    sums, first, rows, columns, windows, motion, start, prior, linear, offset_mean,
    offset_precision, min_support, beside, across, limit, due, scratch, moved, status, reliable,
    out,
):  # fmt: skip
    """Take the steps of :func:`step_windows`; ``limit`` is the square of its ``farthest``."""
    matrix, step, moments, du, dv = scratch
    for cell in range(rows * columns):
        row = cell // columns
        column = cell % columns
        for p in range(first[cell], first[cell + 1]):
            copy(motion[p], out[p])
            moved[p] = 0
            if not due[p]:
                continue
            xc = 0.5 * (windows[p, 0] + windows[p, 2] - 1)
            yc = 0.5 * (windows[p, 1] + windows[p, 3] - 1)
            size = max(windows[p, 2] - windows[p, 0], windows[p, 3] - windows[p, 1])
            size = max(0.5 * size, 1.0)
            theta = motion[p]
            matrix[:] = 0
            step[:] = 0
            count = within = number = 0.0
            for other in range(9):
                i = row + other // 3 - 1
                j = column + other % 3 - 1
                if i < 0 or j < 0 or i >= rows or j >= columns:
                    continue
                kernel = 1.0
                if other != 4:
                    kernel = beside if other % 2 == 1 else across
                neighbour = i * columns + j
                for q in range(first[neighbour], first[neighbour + 1]):
                    if other == 4 and q != p:
                        continue
                    qx = 0.5 * (windows[q, 0] + windows[q, 2] - 1)
                    qy = 0.5 * (windows[q, 1] + windows[q, 3] - 1)
                    q_size = max(windows[q, 2] - windows[q, 0], windows[q, 3] - windows[q, 1])
                    q_size = max(0.5 * q_size, 1.0)
                    ratio = q_size / size
                    bx = (qx - xc) / size
                    by = (qy - yc) / size
                    away_u = theta[0] + theta[1] * bx + theta[2] * by - motion[q, 0]
                    away_v = theta[6] + theta[7] * bx + theta[8] * by - motion[q, 6]
                    away = (away_u * away_u + away_v * away_v) / limit
                    if not (away < 1):
                        continue
                    k = kernel * (1 - away) * (1 - away)
                    slope = motion[q, 1] / ratio
                    du[1] = theta[1] - slope
                    du[2] = theta[2] - motion[q, 2] / ratio
                    du[0] = away_u - du[1] * bx - du[2] * by
                    dv[1] = theta[7] - motion[q, 7] / ratio
                    dv[2] = theta[8] - motion[q, 8] / ratio
                    dv[0] = away_v - dv[1] * bx - dv[2] * by
                    _add_cell(
                        sums[q], k, ratio, bx, by, du, dv, theta[12] - motion[q, 12], moments,
                        matrix, step,
                    )  # fmt: skip
                    number += k * sums[q, 32]
                    count += k * sums[q, 33]
                    within += k * sums[q, 34]
            reliable[p] = number / max(within, 1.0)
            status[p] = FITTED
            if count < min_support or 2 * count < within:
                status[p] = TOO_FEW
                copy(start[p], out[p])
                continue
            for m in range(3):
                factor = 1.0 if m == 0 else linear
                u = theta[m] - start[p, m]
                v = theta[6 + m] - start[p, 6 + m]
                matrix[m, m] += factor * prior[p, 0, 0] + 1e-6
                matrix[3 + m, 3 + m] += factor * prior[p, 1, 1] + 1e-6
                matrix[3 + m, m] += factor * prior[p, 0, 1]
                step[m] -= factor * (prior[p, 0, 0] * u + prior[p, 0, 1] * v)
                step[3 + m] -= factor * (prior[p, 0, 1] * u + prior[p, 1, 1] * v)
            matrix[6, 6] += offset_precision
            step[6] -= offset_precision * (theta[12] - offset_mean)
            if not solve(matrix, step):
                status[p] = DEGENERATE
                copy(start[p], out[p])
                continue
            for m in range(3):
                out[p, m] += step[m]
                out[p, 6 + m] += step[3 + m]
            out[p, 12] += step[6]
            moved[p] = max(
                abs(step[0]) + abs(step[1]) + abs(step[2]),
                abs(step[3]) + abs(step[4]) + abs(step[5]),
            )
            if not (moved[p] < 4 * size):
                status[p] = RAN_AWAY
                copy(start[p], out[p])


@njit(**LEAN)
def move_samples(
    cells, due, owners, windows, motion, residual, gradient_x, gradient_y, move_u, move_v
):
    """Move the samples of patches along their gradient to motions that differ a little, in place.

    Parameters are those of :func:`sum_cells`.
    """
    for p in range(cells.shape[0]):
        if not due[p]:
            continue
        for y in range(cells[p, 1], cells[p, 3]):
            au, bu, av, bv = row_of_motion(windows, motion, p, np.int64(y))
            for x in range(cells[p, 0], cells[p, 2]):
                if owners[y, x] != p:
                    continue
                u = au + bu * np.float32(x)
                v = av + bv * np.float32(x)
                residual[y, x] += gradient_x[y, x] * (u - move_u[y, x])
                residual[y, x] += gradient_y[y, x] * (v - move_v[y, x])
                move_u[y, x] = u
                move_v[y, x] = v
