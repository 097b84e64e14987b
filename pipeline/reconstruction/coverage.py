"""How many of the sub-pixel phases the observations fill (METHOD §2: K² samples a pixel)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from pipeline.frames import Mask, Positions
from pipeline.grid import Grid
from pipeline.reconstruction.rows import OPTIONS


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
            np.ascontiguousarray(position, np.float32), np.ascontiguousarray(mask, np.bool_),
            np.float32(grid.magnification_x), np.float32(grid.offset_x),
            np.float32(grid.magnification_y), np.float32(grid.offset_y), filled,
        )  # fmt: skip
    return np.count_nonzero(filled) / filled.size if filled.size else 0.0


@njit(**OPTIONS)
def _fill(position, trusted, magnification_x, offset_x, magnification_y, offset_y, filled):
    """Mark the HR pixels on which trusted pixels land, in place."""
    height, width = filled.shape
    half = np.float32(0.5)
    for row in range(trusted.shape[0]):
        for column in range(trusted.shape[1]):
            if not trusted[row, column]:
                continue
            x = position[row, column, 0] * magnification_x + offset_x
            y = position[row, column, 1] * magnification_y + offset_y
            if x > -half and y > -half and x < width - half and y < height - half:
                # a point half-way between two pixels always goes to the right and down
                filled[int(np.floor(y + half)), int(np.floor(x + half))] = True
