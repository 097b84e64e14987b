"""How many of the sub-pixel phases the observations fill (METHOD §2: K² samples a pixel)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pipeline.frames import Mask, Positions
from pipeline.grid import Grid


def phase_coverage(
    positions: Sequence[Positions],
    trusted: Sequence[Mask],
    grid: Grid,
    lr_shape: tuple[int, ...],
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
    """
    height, width = grid.hr_shape((lr_shape[0], lr_shape[1]))
    filled = np.zeros((height, width), bool)
    for position, mask in zip(positions, trusted, strict=True):
        x, y = grid.to_hr(position[mask])
        inside = (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
        # a point half-way between two pixels always goes to the right and down
        filled[np.floor(y[inside] + 0.5).astype(int), np.floor(x[inside] + 0.5).astype(int)] = True
    return float(filled.mean()) if filled.size else 0.0
