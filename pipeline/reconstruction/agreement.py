"""How well pixels agree with what is predicted of them: weights, and what is left over.

Compiled loops over one view, in row after row of LR pixels.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.reconstruction.rows import blur_ring, blur_row


@njit(**OPTIONS)
def weigh(
    predicted, observed, threshold, mark, impossible, largest, low_pass, box, expected, tolerated,
    severity, flags, weights,
):  # fmt: skip
    """Write the weights of a view's pixels from the prediction error around them.

    Parameters
    ----------
    predicted, observed : (H, W) float32
        Grey levels; what is predicted is NaN where there is nothing to compare.
    threshold : float
        Pixels predicted worse get the flags of ``mark``, grey levels.
    impossible : uint8
        Pixels of any of these flags have no weight.
    largest : float
        Errors are cut off here, grey levels.
    low_pass, box : float32
        Half taps of what smooths the error, and of what averages its square.
    expected : float
        What is taken off the average: the share of the noise.
    tolerated, severity : float
        Weight (t / (t + c · excess))².
    flags : (H, W) uint8
        Changed in place.
    weights : (H, W) float32
    """
    width, lines, lines_box = predicted.shape[1], 2 * low_pass.size - 1, 2 * box.size - 1
    _weigh(
        predicted, observed, threshold, mark, impossible, largest, low_pass, box, expected,
        tolerated, severity, flags, weights,
        np.empty((lines, width), np.float32), np.empty((lines_box, width), np.float32),
        np.empty(width + max(lines, lines_box), np.float32), np.empty(width, np.float32),
    )  # fmt: skip


@njit(**LEAN)
def _weigh(
    predicted, observed, threshold, mark, impossible, largest, low_pass, box, expected, tolerated,
    severity, flags, weights, passed, squares, room, line,
):  # fmt: skip
    height, width = predicted.shape
    reach, reach_box = low_pass.size - 1, box.size - 1
    lines, lines_box = passed.shape[0], squares.shape[0]
    t, c, floor = np.float32(tolerated), np.float32(severity), np.float32(expected)
    next_passed = next_square = np.int64(0)  # typed: a literal has what it goes to compiled twice
    for y in range(height):
        while next_square < min(height, y + reach_box + 1):
            v = next_square
            while next_passed < min(height, v + reach + 1):
                _bounded(
                    predicted[next_passed], observed[next_passed], np.float32(largest),
                    np.float32(threshold), mark, flags[next_passed], line,
                )  # fmt: skip
                blur_row(line, low_pass, room, passed[next_passed % lines])
                next_passed += 1
            blur_ring(passed, v, low_pass, height, width, line)
            _square(line)
            blur_row(line, box, room, squares[v % lines_box])
            next_square += 1
        blur_ring(squares, y, box, height, width, line)
        _weight(line, predicted[y], flags[y], impossible, floor, t, c, weights[y])


@njit(**LEAN)
def _bounded(predicted, observed, largest, threshold, mark, flags, out):
    for x in range(out.size):
        error = predicted[x] - observed[x]
        if abs(error) > threshold:
            flags[x] |= mark
        if error != error:
            error = np.float32(0.0)
        out[x] = min(max(error, -largest), largest)


@njit(**LEAN)
def _square(line):
    for x in range(line.size):
        line[x] *= line[x]


@njit(**LEAN)
def _weight(local, predicted, flags, impossible, expected, tolerated, severity, out):
    nothing = np.float32(0.0)
    for x in range(out.size):
        excess = max(local[x] - expected, nothing)
        weight = tolerated / (tolerated + severity * excess)
        known = predicted[x] == predicted[x] and flags[x] & impossible == 0
        out[x] = weight * weight if known else nothing


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
