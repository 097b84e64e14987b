"""The exact median of magnitudes by counting: several times faster than by sorting parts.

Floats that are not negative are in the order of their bits. One pass counts the upper ones of
them; only what has those of the median is sorted, in part.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import OPTIONS

LOWER = 19
"""Bits that are not counted: sixteen numbers in each octave are told apart."""


def median_magnitude(values: npt.NDArray[np.float32]) -> float:
    """Return the median of the absolute values that are finite; NaN where there is none.

    >>> median_magnitude(np.array([[3, -1, np.nan], [np.inf, 2, -8]], np.float32))
    2.5
    """
    bits = np.ascontiguousarray(values, np.float32).view(np.int32).reshape(-1)
    upper = np.zeros(1 << (31 - LOWER), np.int64)
    count = _count_upper(bits, upper)
    if count == 0:
        return float("nan")
    ends = np.cumsum(upper)
    middle = [_number_of_rank(bits, ends, rank) for rank in {(count - 1) // 2, count // 2}]
    return float(np.array(middle, np.int32).view(np.float32).mean(dtype=np.float64))


def _number_of_rank(bits: npt.NDArray[np.int32], ends: npt.NDArray[np.int64], rank: int) -> int:
    """Return the bits of the magnitude of that rank, the smallest being 0.

    ``ends`` says how many have upper bits that are no larger.
    """
    high = int(np.searchsorted(ends, rank, side="right"))
    before = int(ends[high - 1]) if high else 0
    like = np.empty(int(ends[high]) - before, np.int32)
    _collect(bits, high, like)
    place = rank - before
    return int(np.partition(like, place)[place])


@njit(**OPTIONS)
def _count_upper(bits, upper):
    """Count the upper bits of the finite magnitudes, in place; return how many there are."""
    count = 0
    for index in range(bits.size):
        magnitude = bits[index] & 0x7FFFFFFF
        if magnitude < 0x7F800000:
            upper[magnitude >> LOWER] += 1
            count += 1
    return count


@njit(**OPTIONS)
def _collect(bits, high, out):
    """Write those magnitudes that have these upper bits."""
    count = 0
    for index in range(bits.size):
        magnitude = bits[index] & 0x7FFFFFFF
        if magnitude >> LOWER == high:
            out[count] = magnitude
            count += 1
