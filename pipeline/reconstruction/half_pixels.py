"""Compiled loops over a lattice of half HR pixels: samples of a spline there, and their adjoint.

Four places of the lattice belong to each HR pixel, in this order: the pixel itself, half a pixel
right of it, half a pixel below it, and both. A quadratic B-spline weighs its coefficients 1/8 6/8
1/8 at a pixel and 1/2 1/2 between two. Coefficients lie reflected about the edge of the image; of
its last column and row there is nothing half a pixel beyond.

Rows stream by: *rings* hold the last ones, of coefficients four, row r in line r mod 4, of all else
three, row r in line r mod 3. All rings are lines of one array, named by the number of their first;
what is made on the way is made for so many columns at once that it stays in the first cache.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import INLINED, LEAN
from pipeline.reconstruction.rows import whole
from pipeline.reconstruction.simd import WIDE, collect_wide, join_wide, vertical_wide, weigh_wide

LATTICE = 4
"""Places of the lattice that belong to an HR pixel."""

LEAD = WIDE
"""Numbers before the first pixel of a line, and behind its last sixteen: more than are read beside
a pixel, and as many as begin on a line of the processor's cache where the array does."""

COEFFICIENTS, OWN, BETWEEN = 0, 4, 7
"""Rings of spline coefficients, and of what adds to those of the same row, and to those of this row
and of the next."""

NUM_LINES = 10

MIDDLE, SIDE, HALF = np.float32(0.75), np.float32(0.125), np.float32(0.5)
"""The taps of the spline: at a pixel, beside it, and half-way to the next one."""

STRIP = 512
"""Columns that are worked on at once, at most."""

STRIP_LEAD = 2 * LEAD
"""Numbers before the first pixel of a line of a strip: sixteen of the strip before, and as many."""

STRIP_PITCH = STRIP_LEAD + STRIP + STRIP_LEAD
"""Length of a line of a strip."""

NUM_STRIP_LINES = 2 + LATTICE
"""Samples along y at a row and half-way to the next one; what is at each place of the lattice."""


@njit(**INLINED)
def pitch_of(width):
    """Return the length of a line."""
    return LEAD + whole(width) + LEAD


@njit(**INLINED)
def start_of(line, width):
    """Return where the first pixel of a line lies."""
    return line * pitch_of(width) + LEAD


@njit(**LEAN)
def sample_row(work, strip, y, height, width, masses, unit):
    """Write what the weighted samples of row y of the lattice add to coefficients, along x.

    Parameters
    ----------
    work : (NUM_LINES · pitch,) float32
        With the rows y − 1 to y + 1, as far as there are any, of ``COEFFICIENTS``; gets row y of
        ``OWN`` and ``BETWEEN``.
    strip : (NUM_STRIP_LINES · STRIP_PITCH,) float32
        To work in.
    masses : (4, whole(KW)) uint8 or uint16
        Weights of row y, zero behind the last pixel.
    unit : float32
        What one of them is worth.
    """
    above, below = max(y - 1, 0) % 4, min(y + 1, height - 1) % 4
    first = start_of(COEFFICIENTS + above, width)
    own = start_of(COEFFICIENTS + y % 4, width)
    last = start_of(COEFFICIENTS + below, width)
    flat, plane, places = masses.reshape(-1), masses.shape[1], 2 * STRIP_PITCH
    for left in range(0, width, STRIP):
        right, to = min(left + STRIP, width), STRIP_LEAD - left
        # by whole sixteens, of which but one or two are needed at either end
        for x in range(max(left - WIDE, 0), min(right + 2, width), WIDE):
            vertical_wide(
                work, first + x, own + x, last + x, MIDDLE, SIDE, HALF, strip, to + x,
                STRIP_PITCH + to + x,
            )  # fmt: skip
        for line in range(2):
            _repeat_edges(strip, line * STRIP_PITCH + to, left, right, width)
        for x in range(max(left - WIDE, 0), min(right + 1, width), WIDE):
            weigh_wide(
                strip, to + x, STRIP_PITCH + to + x, MIDDLE, SIDE, HALF, flat, x, plane,
                places + to + x, STRIP_PITCH,
            )  # fmt: skip
        for number in range(0, LATTICE, 2):
            _repeat_edges(strip, places + number * STRIP_PITCH + to, left, right, width)
            if left == 0:
                strip[places + (number + 1) * STRIP_PITCH + STRIP_LEAD - 1] = np.float32(0.0)
        for x in range(left, right, WIDE):
            collect_wide(
                strip, places + to + x, STRIP_PITCH, MIDDLE * unit, SIDE * unit, HALF * unit,
                work, start_of(OWN + y % 3, width) + x, start_of(BETWEEN + y % 3, width) + x,
            )  # fmt: skip


@njit(**LEAN)
def _repeat_edges(strip, start, left, right, width):
    """Let a line of a strip go on as it is where the image ends; its column x is start + x."""
    if left == 0:
        strip[start - 1] = strip[start]
    if right == width:
        strip[start + width] = strip[start + width - 1]


@njit(**LEAN)
def join_row(work, y, height, width, out):
    """Write what the lattice adds to the coefficients of row y.

    Parameters
    ----------
    work : (NUM_LINES · pitch,) float32
        With the rows y − 1 to y + 1, as far as there are any, of ``OWN``, and y − 1 and y of
        ``BETWEEN``.
    out : (≥ whole(KW),) float32
    """
    above, below = max(y - 1, 0) % 3, min(y + 1, height - 1) % 3
    first, last = start_of(OWN + above, width), start_of(OWN + below, width)
    own, here = start_of(OWN + y % 3, width), start_of(BETWEEN + y % 3, width)
    before = start_of(BETWEEN + (y + 2) % 3, width)
    # nothing lies between the first row and one before it
    of_before = HALF if y > 0 else np.float32(0.0)
    for x in range(0, width, WIDE):
        join_wide(
            work, first + x, own + x, last + x, here + x, before + x, MIDDLE, SIDE, HALF,
            of_before, out, x,
        )  # fmt: skip
