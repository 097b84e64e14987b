"""How many of the sub-pixel phases the observations fill (thesis §3.2: K² samples a pixel)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import OPTIONS
from pipeline.frames import Mask, Positions
from pipeline.grid import Grid


def phase_coverage(
    positions: Sequence[Positions],
    trusted: Sequence[Mask],
    grid: Grid,
    lr_shape: tuple[int, ...],
    *,
    filled: npt.NDArray[np.bool_] | None = None,
) -> float:
    """Return the share of HR pixels on which at least one trusted observation lands, 0..1.

    K_x · K_y HR pixels belong to each LR pixel of the reference, one for each phase; a
    single view fills one of them. Full resolution without a prior needs all.

    Parameters
    ----------
    positions : sequence of (H, W, 2) float32
        Landing points, LR pixels of the reference; NaN where none.
    trusted : sequence of (H, W) bool
    lr_shape : (int, int)
        Of the reference view.
    filled : (K·H · K·W + 1,) bool, optional
        HR pixels on which others have landed, which count as well, see :func:`nothing_filled`;
        these are added.
    """
    height, width = grid.hr_shape((lr_shape[0], lr_shape[1]))
    if filled is None:
        filled = nothing_filled(grid, lr_shape)
    for position, mask in zip(positions, trusted, strict=True):
        _fill(
            np.ascontiguousarray(position, np.float32).reshape(len(position), -1),
            np.ascontiguousarray(mask, np.bool_).view(np.uint8),
            np.float32(grid.magnification_x), np.float32(grid.offset_x),
            np.float32(grid.magnification_y), np.float32(grid.offset_y), height, width, filled,
        )  # fmt: skip
    return np.count_nonzero(filled[:-1]) / (filled.size - 1) if filled.size > 1 else 0.0


def nothing_filled(grid: Grid, lr_shape: tuple[int, ...]) -> npt.NDArray[np.bool_]:
    """Return where nothing has landed yet: row by row, and a place for what lands nowhere."""
    return np.zeros(math.prod(grid.hr_shape((lr_shape[0], lr_shape[1]))) + 1, np.bool_)


@njit(**OPTIONS)
def _fill(
    points, trusted, magnification_x, offset_x, magnification_y, offset_y, height, width, filled
):  # fmt: skip
    """Mark the HR pixels on which trusted pixels land, in place.

    Parameters
    ----------
    points : (H, 2·W) float32
        x and y in turn.
    trusted : (H, W) uint8
    filled : (height · width + 1,) bool
    """
    places = np.empty(trusted.shape[1], np.int32)
    for row in range(trusted.shape[0]):
        _find_places(
            points[row], trusted[row], magnification_x, offset_x, magnification_y, offset_y,
            height, width, places,
        )  # fmt: skip
        for column in range(places.size):
            filled[places[column]] = True


@njit(**OPTIONS)
def _find_places(
    points, trusted, magnification_x, offset_x, magnification_y, offset_y, height, width, places
):  # fmt: skip
    """Write on which HR pixel each pixel of a row lands, counted by rows; behind all if on none.

    Without a branch, so that eight are worked on at once.
    """
    half, nothing = np.float32(0.5), np.float32(0.0)
    right, under = np.float32(width) - half, np.float32(height) - half
    pitch, nowhere = np.int32(width), np.int32(height * width)
    for column in range(places.size):
        x = points[2 * column] * magnification_x + offset_x
        y = points[2 * column + 1] * magnification_y + offset_y
        is_in = (x > -half) & (y > -half) & (x < right) & (y < under) & (trusted[column] != 0)
        # a point half-way between two pixels always goes to the right and down; what is not
        # negative is cut off to the pixel below
        across = np.int32((x if is_in else nothing) + half)
        down = np.int32((y if is_in else nothing) + half)
        places[column] = down * pitch + across if is_in else nowhere
