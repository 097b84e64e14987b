"""Depth maps cleaned only where something has changed, which is what lands by them.

Stretches of sixteen pixels in a row, the unit of vectors, are looked at or left out as a whole.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT, OPTIONS
from pipeline.frames import Mask
from pipeline.registration.depth_vectors import (
    any_of_many,
    any_of_sixteen,
    median_wide,
    sort_wide,
)
from pipeline.registration.prepare import SPECK, cleaned
from pipeline.vectors import WIDE

REACH = SPECK // 2
"""Pixels to each side that tell a median."""

LINES = 8
"""Rows kept of what streams by, a power of two, ``SPECK`` or more."""


def cleaned_where(depth_map: npt.NDArray[np.float32], wanted: Mask) -> npt.NDArray[np.float32]:
    """Return what :func:`prepare.cleaned` does where it is wanted; elsewhere there is anything."""
    if min(depth_map.shape) >= SPECK:
        out = np.empty(depth_map.shape, np.float32)
        # writable, for one compilation
        if _clean(np.require(depth_map, np.float32, ["C", "W"]), wanted, out):
            return out
    return cleaned(depth_map)


@njit(**EXACT)
def is_wanted(wanted, start):
    """Return whether a pixel of a row's stretch that begins there is."""
    if start + WIDE <= wanted.size:
        return any_of_sixteen(wanted, start)
    found = False
    for column in range(start, min(start + WIDE, wanted.size)):
        found |= wanted[column]
    return found


@njit(**EXACT)
def next_run(wanted, start):
    """Return the first stretch from there on with a pixel that is wanted, and the next without one.

    The width of the row, or more, where there is none.
    """
    while start + 4 * WIDE <= wanted.size and not any_of_many(wanted, start):
        start += 4 * WIDE
    while start < wanted.size and not is_wanted(wanted, start):
        start += WIDE
    end = start
    while end < wanted.size and is_wanted(wanted, end):
        end += WIDE
    return start, end


@njit(**OPTIONS)
def _clean(depth_map, wanted, out):
    """Write medians where they are wanted, and return whether all that they are told by is known.

    Parameters
    ----------
    depth_map, out : (H, W) float32
    wanted : (H, W) bool
    """
    length = depth_map.shape[1] + 3 * WIDE
    return _clean_rows(
        depth_map, wanted, np.empty((LINES, length), np.float32),
        np.empty((SPECK, length), np.float32), np.empty(length, np.float32), np.full(LINES, -1),
        out,
    )  # fmt: skip


@njit(**EXACT)
def _clean_rows(depth_map, wanted, ring, ordered, line, held, out):
    height, width = wanted.shape
    pixels, columns, pitch = ring.reshape(-1), ordered.reshape(-1), ring.shape[1]
    for row in range(height):
        start, end = next_run(wanted[row], 0)
        if start >= width:
            continue
        for near in range(row - REACH, row + REACH + 1):
            inside = min(max(near, 0), height - 1)
            at = inside % LINES
            if held[at] != inside:
                held[at] = inside
                if not _take(depth_map[inside], ring[at]):
                    return False
        rows = (
            max(row - 2, 0) % LINES * pitch, max(row - 1, 0) % LINES * pitch, row % LINES * pitch,
            min(row + 1, height - 1) % LINES * pitch, min(row + 2, height - 1) % LINES * pitch,
        )  # fmt: skip
        while start < width:
            # of four columns more, which the last medians are told by
            for x in range(start, end + WIDE, WIDE):
                sort_wide(pixels, rows, x, columns, x, pitch)
            for x in range(start, end, WIDE):
                median_wide(columns, x, pitch, line, x)
            for x in range(start, min(end, width)):
                out[row, x] = line[x]
            start, end = next_run(wanted[row], end)
    return True


@njit(**EXACT)
def _take(row, line):
    """Write a row with what it ends with repeated beyond its ends; return whether all is known."""
    width, unknown = row.size, np.int32(0)
    inner = line[REACH : REACH + width]
    for x in range(width):
        inner[x] = row[x]
    for x in range(width):
        unknown += np.int32(not abs(row[x]) < np.float32(np.inf))
    for k in range(REACH):
        line[k] = row[0]
    for k in range(REACH + width, line.size):
        line[k] = row[width - 1]
    return unknown == 0
