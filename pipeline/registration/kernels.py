"""Compiled inner loops of registration: spline samples, robust patch fits.

Images enter as quadratic B-spline coefficients padded by ``PAD`` pixels on each
side, so that samples and gradients come from one set of nine taps. Loops
release the global lock; views run on several threads.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import INLINED, LEAN, OPTIONS

PAD = 2
"""Pixels of padding around spline coefficients."""

FITTED, TOO_FEW, DEGENERATE, RAN_AWAY = 1, 2, 3, 4
"""Status of a fit; in all but the first the patch keeps its start."""

HISTOGRAM_BINS = 512
"""Bins of the residual histogram behind the robust scale."""

MAD_TO_SIGMA = 1.4826
"""Median absolute deviation to standard deviation, Gaussian."""

TUKEY = 4.685
"""Tukey biweight cut-off in standard deviations (95 % efficiency)."""


@njit(**OPTIONS)
def sample(coefficients, x, y):
    """Return value, x gradient and y gradient at a point; NaN value outside the image.

    ``coefficients`` is (H + 2·PAD, W + 2·PAD) float32; the point is in image pixels.
    """
    half = np.float32(0.5)
    height = coefficients.shape[0] - 4
    width = coefficients.shape[1] - 4
    if not (x > -half and y > -half and x < width - half and y < height - half):
        return np.float32(np.nan), np.float32(0.0), np.float32(0.0)
    cx = int(np.floor(x + half))
    cy = int(np.floor(y + half))
    tx = np.float32(x - cx)
    ty = np.float32(y - cy)
    x0 = half * (half - tx) * (half - tx)
    x1 = np.float32(0.75) - tx * tx
    x2 = half * (half + tx) * (half + tx)
    dx0 = tx - half
    dx1 = -2 * tx
    dx2 = tx + half
    u = cx + 1
    v = cy + 1
    a0 = coefficients[v, u]
    a1 = coefficients[v, u + 1]
    a2 = coefficients[v, u + 2]
    b0 = coefficients[v + 1, u]
    b1 = coefficients[v + 1, u + 1]
    b2 = coefficients[v + 1, u + 2]
    c0 = coefficients[v + 2, u]
    c1 = coefficients[v + 2, u + 1]
    c2 = coefficients[v + 2, u + 2]
    ra = x0 * a0 + x1 * a1 + x2 * a2
    rb = x0 * b0 + x1 * b1 + x2 * b2
    rc = x0 * c0 + x1 * c1 + x2 * c2
    y0 = half * (half - ty) * (half - ty)
    y1 = np.float32(0.75) - ty * ty
    y2 = half * (half + ty) * (half + ty)
    value = y0 * ra + y1 * rb + y2 * rc
    grad_x = (
        y0 * (dx0 * a0 + dx1 * a1 + dx2 * a2)
        + y1 * (dx0 * b0 + dx1 * b1 + dx2 * b2)
        + y2 * (dx0 * c0 + dx1 * c1 + dx2 * c2)
    )
    grad_y = (ty - half) * ra - 2 * ty * rb + (ty + half) * rc
    return value, grad_x, grad_y


@njit(**OPTIONS)
def value_at(coefficients, x, y):
    """Return the value alone of :func:`sample`; x and y are float32."""
    half = np.float32(0.5)
    height = coefficients.shape[0] - 4
    width = coefficients.shape[1] - 4
    right, down = x + half, y + half
    if not (right > 0 and down > 0 and right < width and down < height):
        return np.float32(np.nan)
    # not negative, and unsigned numbers need no check that they are
    u, v = np.uint64(right), np.uint64(down)
    tx, ty = x - np.float32(u), y - np.float32(v)
    one = np.uint64(1)
    u1, v1 = u + one, v + one
    u2, v2, u3, v3 = u1 + one, v1 + one, u1 + one + one, v1 + one + one
    a, b, c = coefficients[v1], coefficients[v2], coefficients[v3]
    x0 = half * (half - tx) * (half - tx)
    x1 = np.float32(0.75) - tx * tx
    x2 = half * (half + tx) * (half + tx)
    y0 = half * (half - ty) * (half - ty)
    y1 = np.float32(0.75) - ty * ty
    y2 = half * (half + ty) * (half + ty)
    above = x0 * a[u1] + x1 * a[u2] + x2 * a[u3]
    own = x0 * b[u1] + x1 * b[u2] + x2 * b[u3]
    below = x0 * c[u1] + x1 * c[u2] + x2 * c[u3]
    return y0 * above + y1 * own + y2 * below


@njit(**LEAN)
def copy(source, target):
    """Write numbers into as many others; assigning to a slice takes far longer to compile."""
    for k in range(source.size):
        target[k] = source[k]


@njit(**LEAN)
def solve(matrix, rhs):
    """Solve the symmetric positive definite system in place by Cholesky; False if it is not."""
    size = rhs.size
    for i in range(size):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if total <= 1e-12:
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for i in range(size):
        total = rhs[i]
        for k in range(i):
            total -= matrix[i, k] * rhs[k]
        rhs[i] = total / matrix[i, i]
    for i in range(size - 1, -1, -1):
        total = rhs[i]
        for k in range(i + 1, size):
            total -= matrix[k, i] * rhs[k]
        rhs[i] = total / matrix[i, i]
    return True


@njit(**INLINED)
def _take_points(
    source, source_gx, source_gy, reference, nearness, destination, destination_margin, window,
    bounds, place, theta, stride, points, rows,
):  # fmt: skip
    """Sample the reference where the pixels of a patch land; see :func:`fit_patches`.

    Parameters
    ----------
    window : (x0, y0, x1, y1)
    bounds : (lo, hi)
        Of nearness.
    place : (xc, yc, s)
        Centre of the window, and half its larger side.
    theta : (13,) float64
        Motion of the patch.
    points : tuple of (N,) float32
        Written: residual without ζ, gradient along x and y, X.
    rows : ((H + 1,) int64, (H + 1,) float64)
        Written: end of each row's points, and its Y.

    Returns
    -------
    count, lines, in_support : int
        Points, rows, and pixels that belong to the patch, wherever they land.
    """
    residual, gradient_x, gradient_y, place_x = points
    row_end, row_y = rows
    x0, y0, x1, y1 = window
    lo, hi = bounds
    xc, yc, s = place
    inverse = 1 / s
    has_destination = destination.size > 0
    count = 0
    lines = 0
    in_support = 0
    for y in range(y0, y1, stride):
        Y = (y - yc) / s
        cu0 = theta[0] + theta[2] * Y + theta[5] * Y * Y
        cu1 = theta[1] + theta[4] * Y
        cv0 = theta[6] + theta[8] * Y + theta[11] * Y * Y
        cv1 = theta[7] + theta[10] * Y
        for x in range(x0, x1, stride):
            d = nearness[y, x]
            if not (d >= lo and d < hi):
                continue
            in_support += 1
            X = (x - xc) * inverse
            u = cu0 + (cu1 + theta[3] * X) * X
            v = cv0 + (cv1 + theta[9] * X) * X
            if has_destination:
                row = int(np.floor(y + v + 0.5))
                column = int(np.floor(x + u + 0.5))
                if not (0 <= row < destination.shape[0]):
                    continue
                if not (0 <= column < destination.shape[1]):
                    continue
                d = destination[row, column]
                if not (d >= lo - destination_margin and d < hi + destination_margin):
                    continue
            value, gx, gy = sample(reference, x + u, y + v)
            if not np.isfinite(value):
                continue
            residual[count] = value - source[y, x]
            gradient_x[count] = np.float32(0.5) * (gx + source_gx[y, x])
            gradient_y[count] = np.float32(0.5) * (gy + source_gy[y, x])
            place_x[count] = X
            count += 1
        row_end[lines] = count
        row_y[lines] = Y
        lines += 1
    return count, lines, in_support


@njit(**INLINED)
def _robust_scale(residual, count, zeta, histogram):
    """Return the standard deviation by the median of |r + ζ|, found in a histogram."""
    width = 0.0
    for k in range(count):
        width += abs(residual[k] + zeta)
    width = max(8.0 * width / count, 1e-3)
    histogram[:] = 0
    for k in range(count):
        b = int(abs(residual[k] + zeta) / width * HISTOGRAM_BINS)
        histogram[min(b, HISTOGRAM_BINS - 1)] += 1
    seen = 0
    b = 0
    while b < HISTOGRAM_BINS - 1 and seen + histogram[b] < (count + 1) // 2:
        seen += histogram[b]
        b += 1
    return MAD_TO_SIGMA * (b + 0.5) * width / HISTOGRAM_BINS


@njit(**INLINED)
def _sum_moments(points, rows, lines, zeta, cut2, degree, line, moments):
    """Write the weighted sums of powers of X and Y; return how many points are reliable.

    Parameters
    ----------
    cut2 : float
        Square of the residual from which a point has no weight.
    line : (9, M) float64
        Scratch: sums of a row by the power of X, of weights times gx², gx gy, gy², gx, gy, gx r,
        gy r, 1 and r.
    moments : (9, M, M) float64
        Written: the same by the powers of X and Y.
    """
    residual, gradient_x, gradient_y, place_x = points
    row_end, row_y = rows
    powers = 2 * degree + 1
    moments[:] = 0
    reliable = 0
    k = 0
    for j in range(lines):
        line[:] = 0
        while k < row_end[j]:
            r = residual[k] + zeta
            q = r * r / cut2
            if q < 1:
                w = (1 - q) * (1 - q)
                reliable += 1
                gx = gradient_x[k]
                gy = gradient_y[k]
                X = place_x[k]
                wx = w * gx
                wy = w * gy
                if degree == 1:
                    wxx = wx * gx
                    wxy = wx * gy
                    wyy = wy * gy
                    wxr = wx * r
                    wyr = wy * r
                    line[0, 0] += wxx
                    line[1, 0] += wxy
                    line[2, 0] += wyy
                    line[3, 0] += wx
                    line[4, 0] += wy
                    line[5, 0] += wxr
                    line[6, 0] += wyr
                    line[7, 0] += w
                    line[8, 0] += w * r
                    wxx *= X
                    wxy *= X
                    wyy *= X
                    line[0, 1] += wxx
                    line[1, 1] += wxy
                    line[2, 1] += wyy
                    line[3, 1] += wx * X
                    line[4, 1] += wy * X
                    line[5, 1] += wxr * X
                    line[6, 1] += wyr * X
                    line[0, 2] += wxx * X
                    line[1, 2] += wxy * X
                    line[2, 2] += wyy * X
                    k += 1
                    continue
                power = 1.0
                for m in range(powers):
                    line[0, m] += wx * gx * power
                    line[1, m] += wx * gy * power
                    line[2, m] += wy * gy * power
                    line[3, m] += wx * power
                    line[4, m] += wy * power
                    if m <= degree:
                        line[5, m] += wx * r * power
                        line[6, m] += wy * r * power
                    power *= X
                line[7, 0] += w
                line[8, 0] += w * r
            k += 1
        power = 1.0
        for n in range(powers):
            for m in range(powers - n):
                for a in range(7):
                    moments[a, m, n] += line[a, m] * power
            power *= row_y[j]
        moments[7, 0, 0] += line[7, 0]
        moments[8, 0, 0] += line[8, 0]
    return reliable


@njit(**INLINED)
def _set_up(
    moments, s2, theta, start, prior, prior_strength, offset_mean, offset_precision, exponents,
    matrix, step,
):  # fmt: skip
    """Write the system whose solution is the step from ``theta``, prior included.

    Parameters
    ----------
    s2 : float
        Variance of the residuals.
    prior : (2, 2) float64
        Of this patch.
    exponents : (3, 6) int64
        Of X, of Y, and degree, of each term of the basis.
    matrix, step : (S, S) and (S,) float64
        Written.
    """
    size = step.size
    num_basis = (size - 1) // 2
    for i in range(num_basis):
        for j in range(num_basis):
            m = exponents[0, i] + exponents[0, j]
            n = exponents[1, i] + exponents[1, j]
            matrix[i, j] = moments[0, m, n] / s2
            matrix[i, num_basis + j] = moments[1, m, n] / s2
            matrix[num_basis + i, j] = moments[1, m, n] / s2
            matrix[num_basis + i, num_basis + j] = moments[2, m, n] / s2
        m = exponents[0, i]
        n = exponents[1, i]
        matrix[i, size - 1] = moments[3, m, n] / s2
        matrix[size - 1, i] = moments[3, m, n] / s2
        matrix[num_basis + i, size - 1] = moments[4, m, n] / s2
        matrix[size - 1, num_basis + i] = moments[4, m, n] / s2
        step[i] = -moments[5, m, n] / s2
        step[num_basis + i] = -moments[6, m, n] / s2
        factor = prior_strength[exponents[2, i]]
        du = theta[i] - start[i]
        dv = theta[6 + i] - start[6 + i]
        matrix[i, i] += factor * prior[0, 0] + 1e-6
        matrix[num_basis + i, num_basis + i] += factor * prior[1, 1] + 1e-6
        matrix[i, num_basis + i] += factor * prior[0, 1]
        matrix[num_basis + i, i] += factor * prior[0, 1]
        step[i] -= factor * (prior[0, 0] * du + prior[0, 1] * dv)
        step[num_basis + i] -= factor * (prior[0, 1] * du + prior[1, 1] * dv)
    matrix[size - 1, size - 1] = moments[7, 0, 0] / s2 + offset_precision
    step[size - 1] = -moments[8, 0, 0] / s2 - offset_precision * (theta[12] - offset_mean)


@njit(**INLINED)
def _go(theta, step):
    """Take a step in place; return how far it moves a corner of the patch at most, pixels."""
    num_basis = (step.size - 1) // 2
    move_u = 0.0
    move_v = 0.0
    for i in range(num_basis):
        theta[i] += step[i]
        theta[6 + i] += step[num_basis + i]
        move_u += abs(step[i])
        move_v += abs(step[num_basis + i])
    theta[12] += step[step.size - 1]
    return max(move_u, move_v)


@njit(**OPTIONS)
def fit_patches(
    source,
    source_gx,
    source_gy,
    reference,
    nearness,
    destination,
    destination_margin,
    windows,
    ranges,
    degree,
    motion,
    prior,
    prior_strength,
    offset_mean,
    offset_precision,
    min_scale,
    min_support,
    iterations,
    tolerance,
    stride,
    status,
    quality,
):
    """Refine the motion of many patches by robust Gauss–Newton, in place.

    Minimises Σ ρ(reference(x + u) − source(x) + ζ) + ½ (θ − θ₀)ᵀ Λ (θ − θ₀) for each
    patch: ρ is Tukey's biweight with a scale from the data, the gradient is the mean of
    the source's and the warped reference's (second-order convergence), and the prior
    keeps directions that the texture does not determine at their start.

    Parameters
    ----------
    source : (H, W) float32
        Source luma, smoothed.
    source_gx, source_gy : (H, W) float32
    reference : (H' + 4, W' + 4) float32
        Spline coefficients of the reference luma, smoothed.
    nearness : (H, W) float32
        Of the source.
    destination : (H', W') float32
        Nearness of the reference, LR; of shape (0, 0) for no destination support (thesis
        Figure 4): else only points that land where it lies in the patch's range, widened
        by ``destination_margin``, take part.
    windows : (P, 4) int32
        x0, y0, x1, y1 of each patch, half-open, source pixels.
    ranges : (P, 2) float32
        A pixel of the window belongs where lo ≤ nearness < hi.
    degree : int
        0 translation, 1 affine, 2 quadratic.
    motion : (P, 13) float64
        Per patch u then v coefficients of the basis 1, X, Y, X², XY, Y², then ζ; with
        X = (x − xc) / s, Y = (y − yc) / s about the window's centre, s half its larger
        side. Modified in place.
    prior : (P, 2, 2) float64
        Precision of the mean displacement (u, v) of the patch about its start, px⁻².
    prior_strength : (3,) float64
        Factors on that precision for the terms of degree 0, 1 and 2.
    offset_mean, offset_precision : float
        Prior of the intensity term ζ, grey levels and grey levels⁻²: one exposure for the
        whole view, from which a patch may differ a little.
    min_scale : float
        Smallest residual scale, grey levels (the noise).
    min_support : int
        Pixels below which a patch is not fitted.
    iterations, tolerance
        At most so many steps; stop when no corner moves more, pixels.
    stride : int
        Use every ``stride``-th row and column of large windows.
    status : (P,) int32
        Written: FITTED, TOO_FEW, DEGENERATE or RAN_AWAY.
    quality : (P, 2) float32
        Written: robust residual scale (grey levels) and the share of reliable pixels.
    """
    size = (degree + 1) * (degree + 2) + 1
    powers = 2 * degree + 1
    area = 0
    for p in range(windows.shape[0]):
        area = max(area, (windows[p, 2] - windows[p, 0]) * (windows[p, 3] - windows[p, 1]))
    residual = np.empty(area, np.float32)
    points = (
        residual, np.empty(area, np.float32), np.empty(area, np.float32),
        np.empty(area, np.float32),
    )  # fmt: skip
    rows = (
        np.empty(nearness.shape[0] + 1, np.int64), np.empty(nearness.shape[0] + 1, np.float64)
    )  # fmt: skip
    histogram = np.empty(HISTOGRAM_BINS, np.int64)
    line = np.empty((9, powers))
    moments = np.empty((9, powers, powers))
    matrix = np.empty((size, size))
    step = np.empty(size)
    start = np.empty(13)
    exponents = np.array([[0, 1, 0, 2, 1, 0], [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]])
    for p in range(windows.shape[0]):
        x0, y0, x1, y1 = windows[p, 0], windows[p, 1], windows[p, 2], windows[p, 3]
        s = max(0.5 * max(x1 - x0, y1 - y0), 1.0)
        place = (0.5 * (x0 + x1 - 1), 0.5 * (y0 + y1 - 1), s)
        theta = motion[p]
        copy(theta, start)
        status[p] = FITTED
        quality[p, 0] = np.inf
        quality[p, 1] = 0
        for _ in range(iterations):
            count, lines, in_support = _take_points(
                source, source_gx, source_gy, reference, nearness, destination,
                destination_margin, (x0, y0, x1, y1), (ranges[p, 0], ranges[p, 1]), place, theta,
                stride, points, rows,
            )  # fmt: skip
            if count * stride * stride < min_support or 2 * count < in_support:
                status[p] = TOO_FEW
                copy(start, theta)
                break
            scale = max(_robust_scale(residual, count, theta[12], histogram), min_scale)
            reliable = _sum_moments(
                points, rows, lines, theta[12], (TUKEY * scale) ** 2, degree, line, moments
            )
            quality[p, 0] = scale
            quality[p, 1] = reliable / max(in_support, 1)
            _set_up(
                moments, scale * scale, theta, start, prior[p], prior_strength, offset_mean,
                offset_precision, exponents, matrix, step,
            )  # fmt: skip
            if not solve(matrix, step):
                status[p] = DEGENERATE
                copy(start, theta)
                break
            moved = _go(theta, step)
            if not (moved < 4 * s):
                status[p] = RAN_AWAY
                copy(start, theta)
                break
            if moved < tolerance:
                break


@njit(**OPTIONS)
def displacement_at(windows, motion, p, x, y):
    """Return (u, v) of patch ``p``'s motion at source pixel (x, y)."""
    x0, y0, x1, y1 = windows[p, 0], windows[p, 1], windows[p, 2], windows[p, 3]
    s = max(0.5 * max(x1 - x0, y1 - y0), 1.0)
    X = (x - 0.5 * (x0 + x1 - 1)) / s
    Y = (y - 0.5 * (y0 + y1 - 1)) / s
    t = motion[p]
    u = t[0] + t[1] * X + t[2] * Y + t[3] * X * X + t[4] * X * Y + t[5] * Y * Y
    v = t[6] + t[7] * X + t[8] * Y + t[9] * X * X + t[10] * X * Y + t[11] * Y * Y
    return u, v


@njit(**OPTIONS)
def follow_patches(windows, motion, usable, labels, position, offset):
    """Write the landing point of each pixel by the motion of its own patch; NaN where unusable.

    Parameters
    ----------
    labels : (H, W) int32
        Patch number of each pixel.
    position, offset : (H, W, 2) and (H, W) float32
        Written: landing points in pixels, ζ in grey levels.
    """
    for y in range(labels.shape[0]):
        for x in range(labels.shape[1]):
            p = labels[y, x]
            if p < 0 or not usable[p]:
                position[y, x, 0] = np.nan
                position[y, x, 1] = np.nan
                offset[y, x] = 0
                continue
            u, v = displacement_at(windows, motion, p, x, y)
            position[y, x, 0] = x + u
            position[y, x, 1] = y + v
            offset[y, x] = motion[p, 12]
