"""Compiled loops over single rows: the separable blur, as rows stream by.

A *ring* holds the last rows of an image, row r in line r mod its size. Half taps are those
of a symmetric kernel from its middle outwards. All loops release the global lock.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import INLINED, LEAN, PUT_IN_PLACE
from pipeline.reconstruction.simd import WIDE, blur_across, blur_along, blur_wide

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


@njit(**INLINED)
def lead_of(reach):
    """Return how many numbers of a room come before its own."""
    return max(whole(reach), LINE)


@njit(**PUT_IN_PLACE)
def make_room(size, reach):
    """Return room for :func:`blur_room`: its own numbers, behind some others, begin a line."""
    return make_lines(1, lead_of(reach) + whole(size + reach) + LINE)[0]


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
    room
        Of :func:`make_room`, to work in.
    out : (≥ whole(W),) float32
    """
    copy_row(row, room[lead_of(taps.size - 1) :])
    blur_room(room, row.size, taps, out)


@njit(**LEAN)
def blur_room(room, size, taps, out):
    """Do what :func:`blur_row` does with so many numbers that are in the room already."""
    reach = taps.size - 1
    first = lead_of(reach)
    for k in range(1, reach + 1):
        room[first - k] = room[first + mirror(-k, size)]
        room[first + size - 1 + k] = room[first + mirror(size - 1 + k, size)]
    k = 1
    if reach >= 3:
        four = taps[0], taps[1], taps[2], taps[3]
        for x in range(0, size, WIDE):
            blur_along(room, first + x, four, out, x)
        k = 4
    elif reach == 2:
        three = taps[0], taps[1], taps[2]
        for x in range(0, size, WIDE):
            blur_along(room, first + x, three, out, x)
        k = 3
    else:
        _scaled(room[first : first + size], taps[0], out)
    while k <= reach:
        _more(out, room[first - k :], room[first + k :], taps[k], size)
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
def blur_two(ring, y, taps, height, width, out):
    """Write rows y and y + 1 as :func:`blur_ring` does; what both need is read once.

    Parameters
    ----------
    ring : (≥ 2·reach + 2, ≥ whole(W)) float32
    out : (2, ≥ whole(W)) float32
        Where y is the last row, anything comes into the second line.
    """
    reach, lines, pitch = taps.size - 1, ring.shape[0], ring.shape[1]
    if reach < 3:
        for row in range(2):
            blur_ring(ring, y + row, taps, height, width, out[row])
        return
    places = (
        mirror(y - 3, height) % lines * pitch, mirror(y - 2, height) % lines * pitch,
        mirror(y - 1, height) % lines * pitch, y % lines * pitch,
        mirror(y + 1, height) % lines * pitch, mirror(y + 2, height) % lines * pitch,
        mirror(y + 3, height) % lines * pitch, mirror(y + 4, height) % lines * pitch,
    )  # fmt: skip
    four = taps[0], taps[1], taps[2], taps[3]
    a, b, c, d, e, f, g, h = places
    flat, both = ring.reshape(-1), out.reshape(-1)
    for x in range(0, width, WIDE):
        at = a + x, b + x, c + x, d + x, e + x, f + x, g + x, h + x
        blur_across(flat, at, four, both, x, out.shape[1])
    for k in range(4, reach + 1):
        for row in range(2):
            up, down = mirror(y + row - k, height) % lines, mirror(y + row + k, height) % lines
            _more(out[row], ring[up], ring[down], taps[k], width)


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
