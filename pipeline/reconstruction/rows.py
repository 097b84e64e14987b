"""Compiled loops over single rows: the separable blur, as rows stream by.

A *ring* holds the last rows of an image, row r in line r mod its size. Half taps are those
of a symmetric kernel from its middle outwards. All loops release the global lock.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import INLINED, LEAN, PUT_IN_PLACE
from pipeline.reconstruction.simd import WIDE, blur_wide

LINE = 16
"""Numbers in a line of the processor's cache. Sixteen that are read or written at once cross two
lines where they do not begin with one, which takes half as long again and more."""


@njit(**INLINED)
def whole(width):
    """Return the length of a row that ends with a line of the cache."""
    return (width + LINE - 1) // LINE * LINE


@njit(**PUT_IN_PLACE)
def make_lines(count, length):
    """Return zeros (count, length) float32, the length a multiple of ``LINE``, from a line on."""
    found = np.zeros(count * length + LINE, np.float32)
    first = -(found.ctypes.data // 4) % LINE
    return found[first : first + count * length].reshape(count, length)


@njit(**PUT_IN_PLACE)
def make_room(size, reach):
    """Return room for :func:`blur_row`: its own numbers, behind so many others, begin a line."""
    first = -reach % LINE
    return make_lines(1, whole(first + size + 2 * reach))[0, first:]


@njit(**LEAN)
def mirror(index, size):
    """Return the index reflected about the edges of the outermost pixels, as often as need be."""
    index %= 2 * size
    return index if index < size else 2 * size - 1 - index


@njit(**LEAN)
def _four(flat, places, taps, size, out):
    """Write a row weighted by the middle tap and the three beside it."""
    middle, a1, b1, a2, b2, a3, b3 = places
    four = taps[0], taps[1], taps[2], taps[3]
    whole = size - size % WIDE
    for x in range(0, whole, WIDE):
        at = middle + x, a1 + x, b1 + x, a2 + x, b2 + x, a3 + x, b3 + x
        blur_wide(flat, at, four, out, x)
    for x in range(whole, size):
        out[x] = (
            four[0] * flat[middle + x]
            + four[1] * (flat[a1 + x] + flat[b1 + x])
            + four[2] * (flat[a2 + x] + flat[b2 + x])
            + four[3] * (flat[a3 + x] + flat[b3 + x])
        )


@njit(**LEAN)
def _three(flat, places, taps, size, out):
    """Write a row weighted by the middle tap and the two beside it."""
    middle, a1, b1, a2, b2 = places
    three = taps[0], taps[1], taps[2]
    whole = size - size % WIDE
    for x in range(0, whole, WIDE):
        at = middle + x, a1 + x, b1 + x, a2 + x, b2 + x
        blur_wide(flat, at, three, out, x)
    for x in range(whole, size):
        out[x] = (
            three[0] * flat[middle + x]
            + three[1] * (flat[a1 + x] + flat[b1 + x])
            + three[2] * (flat[a2 + x] + flat[b2 + x])
        )


@njit(**LEAN)
def _scaled(row, tap, out):
    for x in range(row.size):
        out[x] = tap * row[x]


@njit(**LEAN)
def _more(out, a1, b1, tap1, size):
    for x in range(size):
        out[x] += tap1 * (a1[x] + b1[x])


@njit(**LEAN)
def copy_row(row, out):
    """Write the row into the first elements of ``out``."""
    for x in range(row.size):
        out[x] = row[x]


@njit(**LEAN)
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
    copy_row(row, room[reach:])
    for k in range(1, reach + 1):
        room[reach - k] = row[mirror(-k, size)]
        room[reach + size - 1 + k] = row[mirror(size - 1 + k, size)]
    k = 1
    if reach >= 3:
        places = reach, reach - 1, reach + 1, reach - 2, reach + 2, reach - 3, reach + 3
        _four(room, places, taps, size, out)
        k = 4
    elif reach == 2:
        _three(room, (reach, reach - 1, reach + 1, reach - 2, reach + 2), taps, size, out)
        k = 3
    else:
        _scaled(row, taps[0], out)
    while k <= reach:
        _more(out, room[reach - k :], room[reach + k :], taps[k], size)
        k += 1


@njit(**LEAN)
def blur_ring(ring, y, taps, height, width, out):
    """Write row y of an image blurred along y, from a ring that holds the rows it needs.

    Parameters
    ----------
    ring : (≥ 2·reach + 1, ≥ W) float32
    out : (≥ W,) float32
    """
    reach, lines, pitch = taps.size - 1, ring.shape[0], ring.shape[1]
    k = 1
    if reach >= 3:
        places = (
            y % lines * pitch,
            mirror(y - 1, height) % lines * pitch, mirror(y + 1, height) % lines * pitch,
            mirror(y - 2, height) % lines * pitch, mirror(y + 2, height) % lines * pitch,
            mirror(y - 3, height) % lines * pitch, mirror(y + 3, height) % lines * pitch,
        )  # fmt: skip
        _four(ring.reshape(-1), places, taps, width, out)
        k = 4
    elif reach == 2:
        of_two = (
            y % lines * pitch,
            mirror(y - 1, height) % lines * pitch, mirror(y + 1, height) % lines * pitch,
            mirror(y - 2, height) % lines * pitch, mirror(y + 2, height) % lines * pitch,
        )  # fmt: skip
        _three(ring.reshape(-1), of_two, taps, width, out)
        k = 3
    else:
        _scaled(ring[y % lines, :width], taps[0], out)
    while k <= reach:
        up, down = mirror(y - k, height) % lines, mirror(y + k, height) % lines
        _more(out, ring[up], ring[down], taps[k], width)
        k += 1


@njit(**LEAN)
def dot_row(first, second):
    """Return the sum of products of two rows, float32."""
    total = np.float32(0.0)
    for x in range(first.size):
        total += first[x] * second[x]
    return total


@njit(**LEAN)
def sum_row(row):
    """Return the sum of a row, float32."""
    total = np.float32(0.0)
    for x in range(row.size):
        total += row[x]
    return total
