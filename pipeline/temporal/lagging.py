"""What seems to stand still, but changes little by little: the means kept of it lag behind.

Not in the thesis. Where a frame differs from the mean before it as the last one did, the mean is
behind, not noisy: the product of the two differences is, in the mean over many pixels, the square
of how far. Only pixels that seem to stand still are looked at, so that what moves says nothing.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.frames import GreyImage, Mask

TILE = 32
"""Side of a tile, LR pixels; the last ones of a row or column may be up to twice as large."""

LAG = (0.04, 0.035)
"""Square of the lag from which a tile begins anew, and what is added for each of the squares of the
noise, grey levels²."""

MUCH = 1 / 6
"""Share of the tiles beyond which much of a picture lags behind."""

FEW_TILES = 48
"""Tiles below which none begins anew by itself: a picture of which much lags is computed without
the frames before it. Its means go on, so that they tell for how long it changes."""

LAG_OF_MOST = (0.01, 0.01)
"""The same for the median of all others, from which they do, too."""

SLIGHT_LAG = (0.01, 0.004)
"""The same from which they should not be left alone for long."""

LEAST = TILE**2 / 3
"""Pixels of a tile that are counted at least: of few, chance says more."""


def tiles_of(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return how many rows and columns of tiles a picture has."""
    return max(1, shape[0] // TILE), max(1, shape[1] // TILE)


def has_few_tiles(shape: tuple[int, ...]) -> bool:
    """Return whether a picture is so small that it is computed anew where much of it lags."""
    rows, columns = tiles_of(shape)
    return rows * columns < FEW_TILES


def much_lags(lagging: Mask) -> bool:
    """Return whether much of a picture lags behind."""
    return bool(lagging.mean() > MUCH)


def tile_pixels(tiles: Mask, shape: tuple[int, ...]) -> Mask:
    """Return the pixels that lie in tiles, (H, W)."""
    rows, columns = (
        np.minimum(np.arange(side) // TILE, count - 1)
        for side, count in zip(shape, tiles.shape, strict=True)
    )
    return tiles[rows[:, None], columns]


def lagging_tiles(
    smooth: GreyImage,
    wide: GreyImage,
    away_before: GreyImage,
    count: npt.NDArray[np.float32],
    reached: npt.NDArray[np.uint8],
    noise: float,
) -> tuple[GreyImage, Mask, bool]:
    """Return how detail differs from the mean before, which tiles lag, and whether others begin to.

    Parameters
    ----------
    smooth, wide : (H, W) float32
        The frame less the mean, smoothed and in the mean of a wide box: how bright a picture is
        does not matter much.
    away_before : (H, W) float32
        What this function returned one frame earlier.
    count : (H, W) float32
        Frames that the mean is worth.
    reached : (H, W) uint8
        Whether the pixel has changed, or lies near what has.
    noise : float
        Standard deviation, grey levels.
    """
    away = np.empty_like(smooth)
    sums = np.zeros(tiles_of(smooth.shape))
    numbers = np.zeros_like(sums)
    _sum_tiles(smooth, wide, away_before, count, reached, away, sums, numbers)
    lags = sums / np.maximum(numbers, LEAST)
    one, most, slightly = (
        bound[0] + bound[1] * noise**2 for bound in (LAG, LAG_OF_MOST, SLIGHT_LAG)
    )
    lagging = lags > one
    rest = np.inf if lagging.all() else float(np.median(lags[~lagging]))
    if rest > most:
        lagging[:] = True
    return away, lagging, rest > slightly


@njit(nogil=True, cache=True, error_model="numpy")
def _sum_tiles(smooth, wide, before, count, reached, away, sums, numbers):
    """Write the differences of detail; add up their products with those before in each tile."""
    height, width = smooth.shape
    rows, columns = sums.shape
    totals, found = np.zeros(width, np.float32), np.zeros(width, np.float32)
    for row in range(height):
        for column in range(width):
            difference = smooth[row, column] - wide[row, column]
            away[row, column] = difference
            stands = np.float32((reached[row, column] == 0) & (count[row, column] > 1))
            totals[column] += stands * difference * before[row, column]
            found[column] += stands
        at = min(row // TILE, rows - 1)
        if row == height - 1 or min((row + 1) // TILE, rows - 1) > at:
            for column in range(width):
                tile = min(column // TILE, columns - 1)
                sums[at, tile] += totals[column]
                numbers[at, tile] += found[column]
            totals[:] = 0
            found[:] = 0
