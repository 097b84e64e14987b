"""Compiled loops over single rows: the separable blur, as rows stream by.

A *ring* holds the last rows of an image, row r in line r mod its size. Half taps are those
of a symmetric kernel from its middle outwards. All loops release the global lock.
"""

from __future__ import annotations

import numpy as np
from numba import njit

OPTIONS = {
    "nogil": True,
    "cache": True,
    "error_model": "numpy",
    # not the flags that assume finite numbers: NaN marks what has no value
    "fastmath": {"contract", "reassoc", "nsz", "arcp"},
}


@njit(**OPTIONS)
def mirror(index, size):
    """Return the index reflected about the edges of the outermost pixels, as often as need be."""
    index %= 2 * size
    return index if index < size else 2 * size - 1 - index


@njit(**OPTIONS)
def _two(out, middle, tap, a1, b1, a2, b2, tap1, tap2):
    for x in range(middle.size):
        out[x] = tap * middle[x] + (tap1 * (a1[x] + b1[x]) + tap2 * (a2[x] + b2[x]))


@njit(**OPTIONS)
def _more(out, a1, b1, tap1, size):
    for x in range(size):
        out[x] += tap1 * (a1[x] + b1[x])


@njit(**OPTIONS)
def blur_row(row, taps, room, out):
    """Write a row blurred along x.

    Parameters
    ----------
    row : (W,) float32
    taps : (reach + 1,) float32
        Half taps.
    room : (W + 2·reach,) float32
        Scratch.
    out : (≥ W,) float32
    """
    reach, size = taps.size - 1, row.size
    room[reach : reach + size] = row
    for k in range(1, reach + 1):
        room[reach - k] = row[mirror(-k, size)]
        room[reach + size - 1 + k] = row[mirror(size - 1 + k, size)]
    middle = room[reach : reach + size]
    k = 1
    if reach >= 2:
        _two(
            out, middle, taps[0], room[reach - 1 :], room[reach + 1 :],
            room[reach - 2 :], room[reach + 2 :], taps[1], taps[2],
        )  # fmt: skip
        k = 3
    else:
        for x in range(size):
            out[x] = taps[0] * middle[x]
    while k <= reach:
        _more(out, room[reach - k :], room[reach + k :], taps[k], size)
        k += 1


@njit(**OPTIONS)
def blur_ring(ring, y, taps, height, width, out):
    """Write row y of an image blurred along y, from a ring that holds the rows it needs.

    Parameters
    ----------
    ring : (≥ 2·reach + 1, ≥ W) float32
    out : (≥ W,) float32
    """
    reach, lines = taps.size - 1, ring.shape[0]
    middle = ring[y % lines][:width]
    k = 1
    if reach >= 2:
        _two(
            out, middle, taps[0],
            ring[mirror(y - 1, height) % lines], ring[mirror(y + 1, height) % lines],
            ring[mirror(y - 2, height) % lines], ring[mirror(y + 2, height) % lines],
            taps[1], taps[2],
        )  # fmt: skip
        k = 3
    else:
        for x in range(width):
            out[x] = taps[0] * middle[x]
    while k <= reach:
        up, down = mirror(y - k, height) % lines, mirror(y + k, height) % lines
        _more(out, ring[up], ring[down], taps[k], width)
        k += 1


@njit(**OPTIONS)
def dot_row(first, second):
    """Return the sum of products of two rows, float32."""
    total = np.float32(0.0)
    for x in range(first.size):
        total += first[x] * second[x]
    return total
