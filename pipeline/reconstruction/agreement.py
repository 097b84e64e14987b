"""How well pixels agree with what is predicted of them: weights, and what is left over.

Compiled loops over views, in row after row of LR pixels.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.reconstruction.kernels import (
    FLAGS,
    LANDED,
    OBSERVED,
    VALUE,
    WEIGHT,
    X,
    Y,
    land_regular,
    land_rows,
)
from pipeline.reconstruction.rows import blur_ring, blur_row, make_lines, make_room, whole
from pipeline.reconstruction.tables import bytes_at, floats_at, points_at

NO_WEIGHT = np.float32(1e38)
"""Excess of a pixel that shall have no weight: none is left of it in 32 bits, without a branch."""


@njit(**OPTIONS)
def weigh_views(
    observations, lo, hi, reference, threshold, mark, impossible, largest, low_pass, window,
    expected, tolerated, severity, doubt, agreeing,
):  # fmt: skip
    """Write the weights of views' pixels from the prediction error around them.

    Parameters
    ----------
    observations : Table
        See ``kernels.FLAGS``. Values are what is predicted, NaN where there is nothing to compare;
        in its place comes what is observed beyond it. Flags are changed in place, weights
        overwritten.
    lo, hi : int
        Views that are looked at, half-open.
    reference : int
        One among them, or elsewhere, whose weights are not written.
    threshold : float
        Pixels predicted worse get the flags of ``mark``, grey levels.
    impossible : uint8
        Pixels of any of these flags have no weight.
    largest : float
        Errors are cut off here, grey levels.
    low_pass, window : float32
        Half taps of what smooths the error, and of what averages its square.
    expected : float
        What is taken off the average, the share of the noise; what is left is the excess.
    tolerated, severity : float
        Weight (t / (t + c · excess))².
    doubt : float
        Share of the view's mean excess that is added to that of each pixel; for the mean, each is
        cut off at t.
    agreeing : (N,) float64
        What the mean of each view's weights would be without doubt; overwritten.
    """
    nowhere, unknown = np.empty((0, 0, 2), np.float32), np.empty((0, 0), np.float32)
    to_hr = (np.float32(1), np.float32(0), np.float32(1), np.float32(0))
    for number in range(lo, hi):
        if number == reference:
            _subtract_all(observations, number)
            continue
        agreeing[number] = _weigh_view(
            observations, number, threshold, mark, impossible, largest, low_pass, window, expected,
            tolerated, severity, doubt, unknown, nowhere, to_hr, np.empty(0, np.uint8), False,
        )  # fmt: skip


@njit(**OPTIONS)
def land_and_weigh(
    coefficients, positions, to_hr, regular, landed, observations, lo, hi, reference, threshold,
    mark, impossible, largest, low_pass, window, expected, tolerated, severity, doubt, agreeing,
):  # fmt: skip
    """Write where views land and what they would be, and do what :func:`weigh_views` does.

    Row after row, while what is read stays in the caches.

    Parameters
    ----------
    coefficients
        As of ``kernels.sample_spline``.
    positions : Table
        Of their points on the LR grid.
    to_hr, landed
        See ``kernels.land_rows``.
    regular
        See ``kernels.gather_band``.
    """
    for number in range(lo, hi):
        points = points_at(positions, number, 0)
        if number in (reference, regular):
            x, y = floats_at(observations, number, X), floats_at(observations, number, Y)
            out, flags = (
                floats_at(observations, number, VALUE),
                bytes_at(observations, number, FLAGS),
            )
            if number == regular:
                land_regular(coefficients, points, to_hr, x, y, out, flags, landed)
            else:
                land_rows(
                    coefficients, points, to_hr, np.int64(0), out.shape[0], x, y, out,
                    floats_at(observations, number, OBSERVED), flags, np.float32(threshold), landed,
                )  # fmt: skip
        if number == reference:
            _subtract_all(observations, number)
            continue
        agreeing[number] = _weigh_view(
            observations, number, threshold, mark, impossible, largest, low_pass, window, expected,
            tolerated, severity, doubt, coefficients, points, to_hr, landed, number != regular,
        )  # fmt: skip


@njit(**LEAN)
def _subtract_all(observations, number):
    """Write what is observed beyond what is predicted in the place of that."""
    predicted = floats_at(observations, number, VALUE)
    observed = floats_at(observations, number, OBSERVED)
    for y in range(predicted.shape[0]):
        _subtract_from(observed[y], predicted[y])


@njit(**OPTIONS)
def _weigh_view(
    observations, number, threshold, mark, impossible, largest, low_pass, window, expected,
    tolerated, severity, doubt, coefficients, points, to_hr, landed, lands,
):  # fmt: skip
    """Write a view's weights; return what their mean would be without doubt.

    Parameters
    ----------
    lands : bool
        Whether its pixels are yet to be landed, see :func:`land_and_weigh`.
    """
    predicted = floats_at(observations, number, VALUE)
    observed = floats_at(observations, number, OBSERVED)
    weights = floats_at(observations, number, WEIGHT)
    flags = bytes_at(observations, number, FLAGS)
    width, lines, around = predicted.shape[1], 2 * low_pass.size - 1, 2 * window.size - 1
    total, count = _excesses(
        predicted, observed, threshold, mark, impossible, largest, low_pass, window, expected,
        tolerated, flags, weights,
        make_lines(lines, whole(width)), make_lines(around, whole(width)),
        make_room(width, max(low_pass.size, window.size) - 1),
        make_lines(1, whole(width))[0, :width],
        coefficients, points, to_hr, floats_at(observations, number, X),
        floats_at(observations, number, Y), landed, lands,
    )  # fmt: skip
    more = np.float32(doubt * max(total, 0.0) / max(count, 1.0))
    free = 0.0
    for y in range(predicted.shape[0]):
        free += _weight(more, np.float32(tolerated), np.float32(severity), weights[y])
    return free / predicted.size


@njit(**OPTIONS)
def _excesses(
    predicted, observed, threshold, mark, impossible, largest, low_pass, window, expected,
    tolerated, flags, excesses, passed, squares, room, line, coefficients, points, to_hr, along,
    down, landed, lands,
):  # fmt: skip
    """Write each pixel's excess, or NO_WEIGHT; return what :func:`_sum_cut_off` does of all."""
    height, width = predicted.shape
    reach, reach_around = low_pass.size - 1, window.size - 1
    lines, around = passed.shape[0], squares.shape[0]
    total, count = 0.0, 0.0
    # typed: a literal has what it goes to compiled twice
    next_landed = next_passed = next_square = np.int64(0)
    for y in range(height):
        while next_square < min(height, y + reach_around + 1):
            v = next_square
            while next_passed < min(height, v + reach + 1):
                if lands and next_passed == next_landed:
                    next_landed = min(height, next_passed + LANDED)
                    land_rows(
                        coefficients, points, to_hr, next_passed, next_landed, along, down,
                        predicted, observed, flags, np.float32(threshold), landed,
                    )  # fmt: skip
                _bounded(
                    predicted[next_passed], observed[next_passed], np.float32(largest),
                    np.float32(threshold), mark, flags[next_passed], line,
                )  # fmt: skip
                blur_row(line, low_pass, room, passed[next_passed % lines])
                next_passed += 1
            blur_ring(passed, v, low_pass, height, width, line)
            _square(line)
            blur_row(line, window, room, squares[v % around])
            next_square += 1
        blur_ring(squares, y, window, height, width, line)
        _excess(line, predicted[y], flags[y], impossible, np.float32(expected), excesses[y])
        _subtract_from(observed[y], predicted[y])
        row_total, row_count = _sum_cut_off(excesses[y], np.float32(tolerated))
        total += row_total
        count += row_count
    return total, count


@njit(**LEAN)
def _bounded(predicted, observed, largest, threshold, mark, flags, out):
    nothing = np.uint8(0)
    for x in range(out.size):
        error = predicted[x] - observed[x]
        # without a branch, so that many are worked on at once
        flags[x] |= mark if abs(error) > threshold else nothing
        if error != error:
            error = np.float32(0.0)
        out[x] = min(max(error, -largest), largest)


@njit(**LEAN)
def _square(line):
    for x in range(line.size):
        line[x] *= line[x]


@njit(**LEAN)
def _excess(local, predicted, flags, impossible, expected, out):
    for x in range(out.size):
        known = predicted[x] == predicted[x] and flags[x] & impossible == 0
        out[x] = max(local[x] - expected, np.float32(0.0)) if known else NO_WEIGHT


@njit(**LEAN)
def _sum_cut_off(excesses, most):
    """Return the sum of excesses cut off there, and the number of pixels that may have a weight."""
    total, unknown = np.float32(0.0), np.float32(0.0)
    for x in range(excesses.size):
        total += min(excesses[x], most)
        unknown += np.float32(excesses[x] == NO_WEIGHT)
    return total - most * unknown, excesses.size - unknown


@njit(**LEAN)
def _weight(more, tolerated, severity, excesses):
    """Write weights in the place of excesses; return the sum of those that have no more added."""
    total = np.float32(0.0)
    for x in range(excesses.size):
        excess = excesses[x]
        free = tolerated / (tolerated + severity * excess)
        weight = tolerated / (tolerated + severity * (excess + more))
        total += free * free
        excesses[x] = weight * weight
    return total


@njit(**LEAN)
def _subtract_from(row, line):
    """Write row − line into the line."""
    for x in range(line.size):
        line[x] = row[x] - line[x]


@njit(**LEAN)
def left_over(predicted, observed, flags, weights):
    """Return what a view's pixels are predicted wrong by.

    Parameters
    ----------
    predicted, observed, weights : (H, W) float32
        What is predicted is NaN where there is nothing to compare.
    flags : (H, W) uint8

    Returns
    -------
    weighted, weight, trusted, count : float
        Sum of weighted squares and of weights; sum of squares and number of trusted pixels.
    """
    weighted, weight, trusted, count = 0.0, 0.0, 0.0, 0.0
    for y in range(predicted.shape[0]):
        for x in range(predicted.shape[1]):
            error = observed[y, x] - predicted[y, x]
            weight += weights[y, x]
            if error != error:
                continue
            square = error * error
            weighted += square * weights[y, x]
            if flags[y, x] == 0:
                trusted += square
                count += 1
    return weighted, weight, trusted, count
