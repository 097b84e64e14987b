"""How many of the sub-pixel phases the observations fill (thesis §3.2: K² samples a pixel)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
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
    filled: Mask | None = None,
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
    filled : (K·H, K·W) bool, optional
        HR pixels on which others have landed, which count as well; these are added.
    """
    if filled is None:
        filled = np.zeros(grid.hr_shape((lr_shape[0], lr_shape[1])), np.bool_)
    for position, mask in zip(positions, trusted, strict=True):
        _fill(
            np.ascontiguousarray(position, np.float32).reshape(len(position), -1),
            np.ascontiguousarray(mask, np.bool_).view(np.uint8),
            np.float32(grid.magnification_x), np.float32(grid.offset_x),
            np.float32(grid.magnification_y), np.float32(grid.offset_y), filled,
        )  # fmt: skip
    return np.count_nonzero(filled) / filled.size if filled.size else 0.0


@njit(**OPTIONS)
def _fill(points, trusted, magnification_x, offset_x, magnification_y, offset_y, filled):
    """Mark the HR pixels on which trusted pixels land, in place.

    Parameters
    ----------
    points : (H, 2·W) float32
        x and y in turn.
    trusted : (H, W) uint8
    """
    height, width = filled.shape
    flat = filled.reshape(-1)
    places, lands = np.empty(trusted.shape[1], np.int32), np.empty(trusted.shape[1], np.bool_)
    for row in range(trusted.shape[0]):
        _find_places(
            points[row], trusted[row], magnification_x, offset_x, magnification_y, offset_y,
            height, width, places, lands,
        )  # fmt: skip
        for column in range(places.size):
            flat[places[column]] |= lands[column]


@njit(**OPTIONS)
def _find_places(
    points, trusted, magnification_x, offset_x, magnification_y, offset_y, height, width, places,
    lands,
):  # fmt: skip
    """Write on which HR pixel each pixel of a row lands, counted by rows, and whether it does.

    Without a branch, so that eight are worked on at once.
    """
    half, nothing = np.float32(0.5), np.float32(0.0)
    right, under = np.float32(width) - half, np.float32(height) - half
    pitch = np.int32(width)
    for column in range(places.size):
        x = points[2 * column] * magnification_x + offset_x
        y = points[2 * column + 1] * magnification_y + offset_y
        is_in = (x > -half) & (y > -half) & (x < right) & (y < under)
        # a point half-way between two pixels always goes to the right and down
        across = np.int32(np.floor((x if is_in else nothing) + half))
        down = np.int32(np.floor((y if is_in else nothing) + half))
        places[column] = down * pitch + across
        lands[column] = is_in & (trusted[column] != 0)
