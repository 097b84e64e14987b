"""Compiled loops of the fused solver: observations gathered and sampled, edges weighed.

All loops release the global lock and work on a range of rows, so that ranges can run on
several threads and the result does not depend on how many. Arrays are C-contiguous float32
if not said otherwise; the caller guarantees shapes.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.reconstruction.rows import LINE, copy_row, make_lines, whole
from pipeline.reconstruction.simd import (
    LANES,
    TOGETHER,
    WIDE,
    gather_wide,
    part_wide,
    sample_eight,
)
from pipeline.reconstruction.tables import floats_at

SMALLEST_WEIGHT = 0.01
"""Observations of no more weight are not worth their time."""

MOST = (255.0, 65535.0)
"""Masses are kept as shares of the largest one in their row, of one byte or of two: this is all."""

KEPT = 2
"""HR rows of sums that one tile hands on to the next."""

LANDED = 8
"""LR rows that are landed and sampled before they are weighed: they stay in the second cache."""


X, Y, VALUE, WEIGHT = range(4)
"""Of the images of an observation's row of a table: its landing points, HR pixels, what is observed
there, grey levels, and its weight; one up to ``SMALLEST_WEIGHT`` leaves the pixel out."""

OBSERVED, FLAGS = WEIGHT + 1, WEIGHT + 2
"""Beside those, where values are not yet what is observed: that, grey levels, and the flags, uint8.
"""


@njit(**LEAN)
def landing_rows(observations, starts, lo, hi, height, landing):
    """Write the first and the last HR row on which pixels of each LR row land, and its stretches'.

    Parameters
    ----------
    observations : Table
        See :data:`WEIGHT`.
    starts : (N,) int64
        Where those of each observation begin in ``landing``.
    lo, hi : int
        Observations that are looked at, half-open.
    height : int
        KH.
    landing : (2, ≥ Σ H · (1 + ⌈W / TOGETHER⌉)) int32
        Of each row, then of each of its stretches; overwritten. First > last where none lands
        inside.
    """
    smallest, half, nothing = np.float32(SMALLEST_WEIGHT), np.float32(0.5), np.float32(0.0)
    below, top = np.float32(height) - half, np.int32(height)
    for number in range(lo, hi):
        position_y = floats_at(observations, number, Y)
        weight = floats_at(observations, number, WEIGHT)
        at = starts[number]
        for row in range(weight.shape[0]):
            of_row, lowest, highest = at, top, np.int32(-1)
            at += 1
            for start in range(0, weight.shape[1], TOGETHER):
                points = position_y[row, start : start + TOGETHER]
                weights = weight[row, start : start + TOGETHER]
                low, high = top, np.int32(-1)
                for k in range(points.size):
                    y = points[k]
                    is_in = (weights[k] > smallest) & (y >= -half) & (y < below)
                    nearest = np.int32((y if is_in else nothing) + half)
                    low = min(low, nearest if is_in else top)
                    high = max(high, nearest if is_in else np.int32(-1))
                landing[0, at], landing[1, at] = low, high
                lowest, highest = min(lowest, low), max(highest, high)
                at += 1
            landing[0, of_row], landing[1, of_row] = lowest, highest


@njit(**LEAN)
def _spline(t):
    """Return the three taps of a quadratic B-spline at an offset from the middle one."""
    half = np.float32(0.5)
    return (
        half * (half - t) * (half - t), np.float32(0.75) - t * t, half * (half + t) * (half + t)
    )  # fmt: skip


@njit(**OPTIONS)
def gather_band(
    observations, starts, landing, regular, grid, level, first, end, tile, height, width, masses,
    units, rhs,
):  # fmt: skip
    """Gather what lands on some HR rows, and write it as the sweeps read it.

    Each observation, its weight w and w·y, is shared by the four places of the half-pixel lattice
    around it, linearly. b is what has come to these times the samples there: quadratic B-splines.

    Parameters
    ----------
    observations, starts, landing
        Of :func:`landing_rows`.
    regular : int64
        The one whose pixels lie where those of the LR grid do, and all count one; −1 if none is
        known to.
    grid : (float32, float32, float32, float32)
        What LR coordinates are multiplied by on the HR grid and what is added, x and y.
    level : float32
        Subtracted from what is observed, grey levels.
    first, end : int
        The rows, half-open.
    tile : int
        Rows whose sums are kept at once.
    height, width : int
        KH, KW.
    masses : (KH, 4, whole(KW)) uint8 or uint16
        Weight at each place of the half-pixel lattice; zero behind the last pixel. These rows are
        overwritten.
    units : (KH,) float32
        What one is worth in each row.
    rhs : (KH, KW) float32
        b.
    """
    sums = make_lines(2 * (tile + KEPT), 4 * whole(width) + LINE)
    places, rest = np.empty(WIDE, np.int32), make_lines(4, TOGETHER)
    lines = make_lines(2, whole(width) + 2 * LINE)
    done, kept = first, np.int64(KEPT)  # typed: a literal has what it goes to compiled twice
    for lo in range(first - 1, end + 1, tile):
        hi = min(lo + tile, end + 1)
        for number in range(observations.shape[0]):
            if number == regular:
                _gather_regular(floats_at(observations, number, VALUE), grid, level, lo, hi, sums)
                continue
            _gather(
                observations, number, starts[number], landing, level, lo, hi, height, width, sums,
                places, rest,
            )  # fmt: skip
        # what lands on later rows adds nothing to these
        end_of_whole = max(hi - 1, done)
        _spread_sums(sums, lo - kept, done, end_of_whole, masses, units, rhs, lines)
        _pass_on(sums, 2 * (hi - lo + kept), 2 * kept)
        done = end_of_whole


@njit(**LEAN)
def _gather(
    observations, number, first, landing, level, lo, hi, height, width, sums, places, rest
):  # fmt: skip
    """Add one view's observations that are nearest to HR rows ``lo`` to ``hi``, in place.

    Parameters
    ----------
    first : int
        Where the view begins in ``landing``.
    sums : (2 rows, 4·whole(KW)) float32
        Of weights and of what is observed times them, by turns, on the half-pixel lattice of the
        hi − lo + KEPT rows from ``lo`` − KEPT.
    places, rest
        Room for :func:`simd.gather_wide`, and for a copy of a stretch.
    """
    pitch = sums.shape[1]
    limits = (
        np.float32(level), np.float32(SMALLEST_WEIGHT), np.float32(width - 1),
        np.float32(height - 1), np.float32(max(lo, 0)), np.float32(min(hi, height) - 1),
        np.float32(2 * (lo - KEPT)), np.float32(pitch // 2),
    )  # fmt: skip
    position_x, position_y = floats_at(observations, number, X), floats_at(observations, number, Y)
    observed = floats_at(observations, number, VALUE)
    weight = floats_at(observations, number, WEIGHT)
    flat = sums.reshape(-1)
    each = 1 + (observed.shape[1] + TOGETHER - 1) // TOGETHER
    for row in range(observed.shape[0]):
        at = first + row * each
        if landing[1, at] < lo or landing[0, at] >= hi:
            continue
        for start in range(0, observed.shape[1], TOGETHER):
            at += 1
            if landing[1, at] < lo or landing[0, at] >= hi:
                continue
            size = min(TOGETHER, observed.shape[1] - start)
            end = start + size
            x, y, grey, mass = (
                position_x[row, start:end], position_y[row, start:end], observed[row, start:end],
                weight[row, start:end],
            )  # fmt: skip
            if size < TOGETHER:
                # sixteen at once may go beyond what there is
                copy_row(x, rest[0])
                copy_row(y, rest[1])
                copy_row(grey, rest[2])
                copy_row(mass, rest[3])
                rest[3, size:] = 0
                x, y, grey, mass = rest[0], rest[1], rest[2], rest[3]
            for k in range(0, size, WIDE):
                gather_wide(x, y, grey, mass, k, limits, places, flat, pitch)


@njit(**LEAN)
def _gather_regular(observed, grid, level, lo, hi, sums):
    """Do what :func:`_gather` does where pixels lie as on the LR grid, and all count one.

    Parameters
    ----------
    observed : (H, W) float32
        Grey levels.
    grid
        See :func:`gather_band`.
    """
    magnification_x, offset_x, magnification_y, offset_y = grid
    step = 4 * np.int64(magnification_x)
    column = np.int64(offset_x + offset_x)
    right = offset_x + offset_x - np.float32(column)
    for row in range(observed.shape[0]):
        y = magnification_y * np.float32(row) + offset_y
        nearest = np.int64(y + np.float32(0.5))
        if nearest < lo or nearest >= hi:
            continue
        place = np.int64(y + y)
        under, upper = y + y - np.float32(place), place - 2 * (lo - KEPT)
        rest = np.float32(1) - under
        _add_every(observed[row], level, sums[upper, 2 * column :], step, right, rest)
        if under > 0:
            _add_every(observed[row], level, sums[upper + 1, 2 * column :], step, right, under)


@njit(**LEAN)
def _add_every(observed, level, out, step, right, weight):
    """Add a weight and a row's pixels times it to sums a step apart, a share right of them."""
    left, rest = weight * (np.float32(1) - right), weight * right
    for x in range(observed.size):
        out[step * x] += left
        out[step * x + 1] += left * (observed[x] - level)
    if right > 0:
        for x in range(observed.size):
            out[step * x + 2] += rest
            out[step * x + 3] += rest * (observed[x] - level)


@njit(**OPTIONS)
def _spread_sums(sums, top, lo, hi, masses, units, rhs, lines):
    """Write rows ``lo`` to ``hi`` of what has been gathered from HR row ``top`` on."""
    height, width = rhs.shape
    of_bits, bits = sums.view(np.uint64), np.empty(1, np.uint32)
    half, eighth = np.float32(0.5), np.float32(0.125)
    flat, size = sums.reshape(-1), whole(width)
    even, odd = lines[0], lines[1]
    most = np.float32(MOST[masses.itemsize - 1])
    for y in range(lo, hi):
        row = 2 * (y - top)
        # no weight is negative: their bits are in their order, and many are compared at once
        bits[0] = max(_largest(of_bits[row]), _largest(of_bits[row + 1]))
        largest = bits.view(np.float32)[0]
        units[y] = largest / most
        inverse = most / largest if largest > 0 else np.float32(0.0)
        # beyond the border lies what is there, reflected about the edge
        own = np.float32(0.75)
        if y == 0:
            own += eighth
        if y == height - 1:
            own += eighth
        for x in range(0, size, WIDE):
            part_wide(
                flat, row * sums.shape[1] + 4 * x, sums.shape[1], own, inverse,
                masses[y].reshape(-1), x, size, even, odd, LINE + x,
            )  # fmt: skip
        even[LINE - 1], even[LINE + width] = even[LINE], even[LINE + width - 1]
        line = rhs[y]
        for x in range(width):
            line[x] = (
                np.float32(0.75) * even[LINE + x]
                + eighth * (even[LINE + x - 1] + even[LINE + x + 1])
                + half * (odd[LINE + x - 1] + odd[LINE + x])
            )


@njit(**LEAN)
def _largest(numbers):
    """Return the largest of the lower halves of numbers."""
    largest, lower = np.uint64(0), np.uint64(0xFFFFFFFF)
    for number in numbers:
        largest = max(largest, number & lower)
    return np.uint32(largest)


@njit(**LEAN)
def _pass_on(sums, rows, kept):
    """Make the last ``kept`` of so many rows the first ones; those before them are zero."""
    for row in range(kept):
        copy_row(sums[rows - kept + row], sums[row])
        sums[rows - kept + row] = 0


@njit(**OPTIONS)
def sum_places(masses, units, lo, hi, out):
    """Write the weight of the places of the lattice that belong to each HR pixel.

    Parameters
    ----------
    masses, units
        Of :func:`gather_band`.
    out : (KH, KW) float32
        Rows ``lo`` to ``hi`` are overwritten.
    """
    for y in range(lo, hi):
        line, unit = out[y], units[y]
        own, right, below, both = masses[y, 0], masses[y, 1], masses[y, 2], masses[y, 3]
        for x in range(line.size):
            whole = np.int32(own[x]) + np.int32(right[x]) + np.int32(below[x]) + np.int32(both[x])
            line[x] = unit * np.float32(whole)


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


@njit(**LEAN)
def split_points(position, magnification_x, offset_x, magnification_y, offset_y, lo, hi, x, y):
    """Write the HR coordinates of LR points (H, W, 2), (H, W) each, into rows ``lo`` to ``hi``."""
    for row in range(lo, hi):
        # flat, so that several are worked on at once
        points, along, down = position[row].reshape(-1), x[row], y[row]
        for column in range(along.size):
            along[column] = points[2 * column] * magnification_x + offset_x
            down[column] = points[2 * column + 1] * magnification_y + offset_y


@njit(**LEAN)
def lies_as_itself(position):
    """Return whether LR points (H, W, 2) are the places of the pixels themselves."""
    for row in range(position.shape[0]):
        points, y, away = position[row].reshape(-1), np.float32(row), 0
        for column in range(points.size // 2):
            away += (points[2 * column] != np.float32(column)) | (points[2 * column + 1] != y)
        if away > 0:
            return False
    return True


@njit(**OPTIONS)
def sample_regular(
    coefficients, magnification_x, offset_x, magnification_y, offset_y, out
):  # fmt: skip
    """Write samples as :func:`sample_spline` does at the places of all pixels of the LR grid."""
    half = np.float32(0.5)
    step, first = np.int64(magnification_x), np.int64(offset_x + half)
    taps = _spline(offset_x - np.float32(first))
    line = np.empty(coefficients.shape[1], np.float32)
    for row in range(out.shape[0]):
        y = magnification_y * np.float32(row) + offset_y
        nearest = np.int64(y + half)
        _weigh_rows(coefficients[nearest + 1 : nearest + 4], _spline(y - np.float32(nearest)), line)
        _weigh_every(line[first + 1 :], step, taps, out[row])


@njit(**LEAN)
def _weigh_rows(rows, taps, out):
    """Write the weighted sum of three rows."""
    above, own, below = rows[0], rows[1], rows[2]
    for x in range(out.size):
        out[x] = taps[0] * above[x] + taps[1] * own[x] + taps[2] * below[x]


@njit(**LEAN)
def _weigh_every(row, step, taps, out):
    """Write the weighted sums of three numbers of a row each, a step apart."""
    if step == 2:
        # a literal step: many are read at once
        for x in range(out.size):
            out[x] = taps[0] * row[2 * x] + taps[1] * row[2 * x + 1] + taps[2] * row[2 * x + 2]
        return
    for x in range(out.size):
        place = step * x
        out[x] = taps[0] * row[place] + taps[1] * row[place + 1] + taps[2] * row[place + 2]


@njit(**OPTIONS)
def land_rows(coefficients, points, to_hr, lo, hi, x, y, out, observed, flags, threshold, landed):
    """Write where pixels of some LR rows land, and do what :func:`sample_spline` does.

    Parameters
    ----------
    points : (H, W, 2) float32
        LR pixels of the reference.
    to_hr : (float32, float32, float32, float32)
        What their coordinates are multiplied by on the HR grid and what is added, x and y.
    lo, hi : int
        The rows, half-open.
    x, y, out : (H, W) float32
    observed : (H, W) float32
    flags : (H, W) uint8
    threshold : float32
        Pixels predicted worse are not trusted, grey levels.
    landed : (size of the coefficients,) uint8
        HR pixels, counted as those are, on which a trusted pixel lands are marked, the first of
        all with them; or empty.
    """
    split_points(points, *to_hr, lo, hi, x, y)
    _sample_and_mark(coefficients, x, y, lo, hi, out, observed, flags, threshold, landed)


@njit(**OPTIONS)
def land_regular(coefficients, points, to_hr, x, y, out, flags, landed):
    """Do what :func:`land_rows` does of all pixels where they lie as those of the LR grid do."""
    first = np.int64(0)  # typed: a literal has what it goes to compiled twice
    split_points(points, *to_hr, first, out.shape[0], x, y)
    sample_regular(coefficients, *to_hr, out)
    if landed.size > 0:
        _mark_regular(flags, *to_hr, landed.reshape(coefficients.shape))


@njit(**LEAN)
def _mark_regular(flags, magnification_x, offset_x, magnification_y, offset_y, landed):
    """Mark where trusted pixels land that lie as those of the LR grid do."""
    half = np.float32(0.5)
    step, first = np.int64(magnification_x), np.int64(offset_x + half) + 1
    for row in range(flags.shape[0]):
        line = landed[np.int64(magnification_y * np.float32(row) + offset_y + half) + 1]
        for column in range(flags.shape[1]):
            line[first + step * column] |= np.uint8(flags[row, column] == 0)


@njit(**OPTIONS)
def sample_views(coefficients, observations, lo, hi):
    """Write what observations ``lo`` to ``hi`` would be in the place of their values.

    Parameters
    ----------
    coefficients
        As of :func:`sample_spline`.
    observations : Table
        See :data:`WEIGHT`.
    """
    for number in range(lo, hi):
        out = floats_at(observations, number, VALUE)
        x, y = floats_at(observations, number, X), floats_at(observations, number, Y)
        sample_spline(coefficients, x, y, 0, out.shape[0], out)


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
    no_flags, nowhere = np.empty((0, 0), np.uint8), np.empty(0, np.uint8)
    _sample_and_mark(
        coefficients, position_x, position_y, row_lo, row_hi, out, out, no_flags, np.float32(0),
        nowhere,
    )  # fmt: skip


@njit(**OPTIONS)
def _sample_and_mark(
    coefficients, position_x, position_y, row_lo, row_hi, out, observed, flags, threshold, landed
):  # fmt: skip
    """Do what :func:`sample_spline` does, and mark where trusted pixels land.

    Parameters
    ----------
    observed : (H, W) float32
    flags : (H, W) uint8
    threshold, landed
        See :func:`land_rows`.
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
            if landed.size > 0:
                _distrust(seen, observed[row, start:end], flags[row, start:end], threshold, places)
                for k in range(seen.size):
                    landed[np.uint32(places[k])] = np.uint8(1)


@njit(**LEAN)
def _distrust(seen, observed, flags, threshold, places):
    """Make the places zero of pixels that are flagged, or predicted worse than the threshold."""
    for k in range(seen.size):
        is_trusted = (flags[k] == 0) & (not abs(seen[k] - observed[k]) > threshold)
        places[k] = places[k] if is_trusted else np.int32(0)


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
