"""Compiled loops of the parallax motion: where points land, how well matches agree on a motion.

A motion is the matrix (3, 4) of the homography's columns and the epipole, which acts on
(x, y, 1, nearness).
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import EXACT, INLINED, LEAN
from pipeline.registration.kernels import copy, solve

NUM_TERMS = 11
"""Numbers that a motion is fitted by: four each of x and y, and three of the denominator."""

_PAIRS = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])
"""Where the sum over products of two of 1, x, y and nearness stands among their ten."""


@njit(**EXACT)
def land_one(motion, x, y, nearness):
    """Return where a point lands, u and v, and how fast either grows with its nearness."""
    depth = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2] + motion[2, 3] * nearness
    u = motion[0, 0] * x + motion[0, 1] * y + motion[0, 2] + motion[0, 3] * nearness
    v = motion[1, 0] * x + motion[1, 1] * y + motion[1, 2] + motion[1, 3] * nearness
    u /= depth
    v /= depth
    return (
        u,
        v,
        (motion[0, 3] - u * motion[2, 3]) / depth,
        (motion[1, 3] - v * motion[2, 3]) / depth,
    )


@njit(**EXACT)
def land_all(motion, x, y, nearness, landed, speed):
    """Write where points (N,) land and how fast that moves with nearness, (N, 2) each."""
    for k in range(x.size):
        u, v, along_u, along_v = land_one(motion, x[k], y[k], nearness[k])
        landed[k, 0], landed[k, 1] = u, v
        speed[k, 0], speed[k, 1] = along_u, along_v


@njit(**EXACT)
def nearness_one(motion, x, y, landed_x, landed_y, nearness):
    """Return the nearness at which a point comes closest to where it has landed, by one step."""
    u, v, along_u, along_v = land_one(motion, x, y, nearness)
    length = max(along_u * along_u + along_v * along_v, 1e-12)
    return nearness + ((landed_x - u) * along_u + (landed_y - v) * along_v) / length


@njit(**EXACT)
def nearness_all(motion, points, landed, nearness, out):
    """Write the nearness of points (N, 2) that have landed, by one step from a nearness."""
    for k in range(out.size):
        out[k] = nearness_one(
            motion, points[k, 0], points[k, 1], landed[k, 0], landed[k, 1], nearness[k]
        )


@njit(**EXACT)
def directions_all(motion, x, y, nearness, out):
    """Write unit vectors (N, 2) in which a wrong nearness moves points; x where it moves none."""
    for k in range(x.size):
        _, _, along_u, along_v = land_one(motion, x[k], y[k], nearness[k])
        length = np.sqrt(along_u * along_u + along_v * along_v)
        if length > 1e-12:
            out[k, 0], out[k, 1] = along_u / length, along_v / length
        else:
            out[k, 0], out[k, 1] = 1.0, 0.0


@njit(**EXACT)
def across_all(motion, points, landed, nearness, directions, out):
    """Write how far across the directions points have landed from where the motion sends them."""
    for k in range(out.size):
        u, v, _, _ = land_one(motion, points[k, 0], points[k, 1], nearness[k])
        u, v = landed[k, 0] - u, landed[k, 1] - v
        out[k] = -directions[k, 1] * u + directions[k, 0] * v


@njit(**EXACT)
def centres_all(windows, x, y, size):
    """Write the middles of windows (P, 4) and half their larger sides, (P,) each."""
    for p in range(windows.shape[0]):
        x0, y0, x1, y1 = windows[p, 0], windows[p, 1], windows[p, 2], windows[p, 3]
        x[p] = 0.5 * (x0 + x1 - 1)
        y[p] = 0.5 * (y0 + y1 - 1)
        size[p] = max(0.5 * max(x1 - x0, y1 - y0), 1.0)


@njit(**EXACT)
def _displacement(motion, x, y, size, plane, right, down):
    """Return (u, v) at a place of a window, from -1 to 1 across it, at the depth of its plane."""
    px, py = x + size * right, y + size * down
    u, v, _, _ = land_one(motion, px, py, plane[0] + plane[1] * right + plane[2] * down)
    return u - px, v - py


@njit(**EXACT)
def start_all(motion, x, y, size, planes, affine, out):
    """Write the motions (P, 13) of windows, in the middle and, if affine, between their sides."""
    for p in range(x.size):
        plane = planes[p]
        out[p, 0], out[p, 6] = _displacement(motion, x[p], y[p], size[p], plane, 0.0, 0.0)
        if not affine:
            continue
        for m in range(2):
            right, down = (0.5, 0.0) if m == 0 else (0.0, 0.5)
            u, v = _displacement(motion, x[p], y[p], size[p], plane, right, down)
            u0, v0 = _displacement(motion, x[p], y[p], size[p], plane, -right, -down)
            out[p, 1 + m], out[p, 7 + m] = u - u0, v - v0


# --- fitting ---------------------------------------------------------------------------------


@njit(**LEAN)
def of_rank(values, count, rank):
    """Return the number of a rank, 0 the smallest, of the first so many; puts them in order there.

    All before it are no larger afterwards, all behind it no smaller.
    """
    low, high = 0, count - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if rank <= j:
            high = j
        elif rank >= i:
            low = i
        else:
            break
    return values[rank]


@njit(**LEAN)
def middle_of(values, count):
    """Return the median of the first so many numbers, whose order it changes."""
    half = count // 2
    upper = of_rank(values, count, half)
    if count % 2 == 1:
        return upper
    lower = values[0]
    for k in range(half):
        lower = max(lower, values[k])
    return 0.5 * (lower + upper)


@njit(**EXACT)
def agree(motion, points, landed, nearness, tolerance, weights):
    """Write 1 for matches (N, 2) that a motion explains but for a distance, pixels; else 0."""
    for k in range(weights.size):
        u, v, _, _ = land_one(motion, points[k, 0], points[k, 1], nearness[k])
        u -= landed[k, 0]
        v -= landed[k, 1]
        weights[k] = 1.0 if u * u + v * v < tolerance * tolerance else 0.0


@njit(**INLINED)
def _sum_products(weights, x, y, nearness, sums):
    """Write the weighted sums of 1, x, y, nearness and of the products of two of the latter."""
    s0 = sx = sy = sn = xx = xy = xn = yy = yn = nn = 0.0
    for k in range(weights.size):
        w = weights[k]
        wx = w * x[k]
        wy = w * y[k]
        wn = w * nearness[k]
        s0 += w
        sx += wx
        sy += wy
        sn += wn
        xx += wx * x[k]
        xy += wx * y[k]
        xn += wx * nearness[k]
        yy += wy * y[k]
        yn += wy * nearness[k]
        nn += wn * nearness[k]
    sums[0], sums[1], sums[2], sums[3], sums[4] = s0, sx, sy, sn, xx
    sums[5], sums[6], sums[7], sums[8], sums[9] = xy, xn, yy, yn, nn


@njit(**INLINED)
def _weigh_terms(basis, target, directions, along, weights, solution, terms):
    """Write the weights of what :func:`refit` sums up, (6, M); see there.

    Of x by x, x by y and y by y, then of what they are by the target, and of that by itself.
    """
    c0, c1, c2 = solution[8], solution[9], solution[10]
    square = along * along
    for k in range(weights.size):
        denominator = 1 + c0 * basis[0, k] + c1 * basis[1, k] + c2 * basis[2, k]
        s = weights[k] / (denominator * denominator) if weights[k] > 0 else 0.0
        dx, dy = directions[0, k], directions[1, k]
        xx = s * (square * dx * dx + dy * dy)
        xy = s * (square - 1) * dx * dy
        yy = s * (square * dy * dy + dx * dx)
        u, v = target[0, k], target[1, k]
        terms[0, k], terms[1, k], terms[2, k] = xx, xy, yy
        terms[3, k] = xx * u + xy * v
        terms[4, k] = xy * u + yy * v
        terms[5, k] = terms[3, k] * u + terms[4, k] * v


@njit(**INLINED)
def _distances(basis, target, directions, along, size, solution, distance):
    """Write how far the matches are from where a solution sends them, pixels."""
    a, b, c = solution[:4], solution[4:8], solution[8:]
    for k in range(distance.size):
        x, y, n = basis[0, k], basis[1, k], basis[2, k]
        denominator = 1 + c[0] * x + c[1] * y + c[2] * n
        u = (a[0] + a[1] * x + a[2] * y + a[3] * n) / denominator - target[0, k]
        v = (b[0] + b[1] * x + b[2] * y + b[3] * n) / denominator - target[1, k]
        dx, dy = directions[0, k], directions[1, k]
        far = along * (dx * u + dy * v)
        wide = dx * v - dy * u
        distance[k] = size * np.sqrt(far * far + wide * wide)


@njit(**LEAN)
def refit(
    basis, target, directions, along, size, hold, weights, distance, solution, terms, sums, matrix,
    step,
):  # fmt: skip
    """Fit the eleven-parameter model by weighted least squares; False where that is degenerate.

    Parameters
    ----------
    basis, target : (3, M), (2, M) float64
        x, y, nearness of the points, and where they land, all of order one.
    directions : (2, M) float64
        Unit vectors; distances along them are multiplied by ``along``.
    size : float
        Pixels of one unit.
    hold : (11,) float64
        Ridge.
    weights : (M,) float64
    distance, solution : (M,), (11,) float64
        Modified: the matches' distances in pixels, the model.
    terms, sums, matrix, step : (6, M), (6, 10), (11, 11), (11,) float64
        Scratch.
    """
    _weigh_terms(basis, target, directions, along, weights, solution, terms)
    for m in range(6):
        _sum_products(terms[m], basis[0], basis[1], basis[2], sums[m])
    for i in range(4):
        for j in range(4):
            pair = _PAIRS[i, j]
            matrix[i, j] = sums[0, pair]
            matrix[4 + i, j] = sums[1, pair]
            matrix[4 + i, 4 + j] = sums[2, pair]
            if i > 0:
                matrix[7 + i, j] = -sums[3, pair]
                matrix[7 + i, 4 + j] = -sums[4, pair]
            if i > 0 and j > 0:
                matrix[7 + i, 7 + j] = sums[5, pair]
        step[i], step[4 + i] = sums[3, i], sums[4, i]
        if i > 0:
            step[7 + i] = -sums[5, i]
    for m in range(NUM_TERMS):
        matrix[m, m] += hold[m]
    if not solve(matrix, step):
        return False
    copy(step, solution)
    _distances(basis, target, directions, along, size, solution, distance)
    return True


@njit(**LEAN)
def weigh_again(distance, weights, first, floor, scratch):
    """Write the weights that matches have by their distances; return how many have any.

    Parameters
    ----------
    weights : (M,) float64
        Modified: Tukey's biweight.
    first : bool
        Whether the cut-off is still twice as far.
    floor : float
        The smallest cut-off, pixels.
    scratch : (M,) float64
    """
    count = np.int64(0)  # typed: a literal has what it goes to compiled twice
    for k in range(weights.size):
        if weights[k] > 0:
            scratch[count] = distance[k]
            count += 1
    sigma = max(1.4826 * middle_of(scratch, count), 0.01)
    cut = max(4 * sigma, floor) * (2.0 if first else 1.0)
    count = np.int64(0)
    for k in range(weights.size):
        ratio = distance[k] / cut
        near = 1 - ratio * ratio
        weights[k] = near * near if near > 0 else 0.0  # NaN has none
        count += 1 if near > 0 else 0
    return count


@njit(**LEAN)
def vote(basis, shift, chosen, voters, ridge, tolerance, steepest, found, scratch):
    """Find what most matches agree on among fits to a few, affine in place and nearness.

    Parameters
    ----------
    basis, shift : (3, M), (2, M) float64
        x, y, nearness of the points and by how much they move.
    chosen : (N, 5) int64
        Matches of each fit.
    voters : (V,) int64
        Matches that vote.
    ridge : (4,) float64
        Of the terms of 1, x, y and nearness.
    tolerance : float
        Distance from which a match has no vote.
    steepest : float
        Largest change of the shift by x or y that is believed.
    found : (2, 4) float64
        Written: the terms of x and of y.
    scratch : (4, 4), (4,), (2, 4), (3, V), (2, V) float64
    """
    matrix, step, terms, places, moves = scratch
    for k in range(voters.size):
        for m in range(3):
            places[m, k] = basis[m, voters[k]]
        for m in range(2):
            moves[m, k] = shift[m, voters[k]]
    most = -2.0
    for number in range(chosen.shape[0]):
        for side in range(2):
            matrix[:] = 0
            step[:] = 0
            for k in range(chosen.shape[1]):
                match = chosen[number, k]
                for i in range(4):
                    here = 1.0 if i == 0 else basis[i - 1, match]
                    step[i] += here * shift[side, match]
                    for j in range(i + 1):
                        matrix[i, j] += here * (1.0 if j == 0 else basis[j - 1, match])
            for i in range(4):
                matrix[i, i] += ridge[i]
            solve(matrix, step)
            copy(step, terms[side])
        votes = _votes(places, moves, terms, 1 / (tolerance * tolerance))
        for m in range(1, 3):
            if abs(terms[0, m]) > steepest or abs(terms[1, m]) > steepest:
                votes = -1.0
        if votes > most:
            most = votes
            copy(terms[0], found[0])
            copy(terms[1], found[1])


@njit(**INLINED)
def _votes(places, moves, terms, precision):
    """Return the votes that a fit has, at most one of each match."""
    u, v = terms[0], terms[1]
    votes = 0.0
    for k in range(places.shape[1]):
        x, y, n = places[0, k], places[1, k], places[2, k]
        away_u = u[0] + u[1] * x + u[2] * y + u[3] * n - moves[0, k]
        away_v = v[0] + v[1] * x + v[2] * y + v[3] * n - moves[1, k]
        votes += max(1 - (away_u * away_u + away_v * away_v) * precision, 0.0)
    return votes
