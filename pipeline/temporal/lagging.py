"""What seems to stand still, but changes little by little: the means kept of it lag behind.

Not in the thesis. Where a frame differs from the mean before it as the last two did, the mean is
behind, not noisy: the product of two differences is, in the mean over many pixels, the square of
how far, and that of what noise does from frame to frame. The latter is told by what is finer than
detail, where that is calm: it is nothing at first, less than nothing once old frames fade, and much
where a codec has left noise that stays. It is taken off; the smaller of the two products counts.
Only pixels that seem to stand still are looked at, so that what moves says nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

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

CALM = 1 / 4
"""Share of the tiles by which noise is told: those in which what is finer than detail differs
least."""

PASSED = 1 / 3
"""Power of a camera's noise in detail, over that in what is finer."""

FADED = 3 / 4
"""What it does to the second product, over what to the first: so much of the mean is kept."""

LEAST = TILE**2 / 3
"""Pixels of a tile that are counted at least: of few, chance says more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Away:
    """How frames that are past differed from the means before them."""

    detail: tuple[GreyImage, GreyImage]
    """Two of (H, W): the last frame's detail, and that of the one before it, grey levels."""
    fine: GreyImage
    """(H, W): what is finer than detail, of the last frame."""

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> Away:
        """Return what there is after one frame."""
        nothing = np.zeros(shape, np.float32)
        return cls(detail=(nothing, nothing), fine=nothing)


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
    difference: GreyImage,
    smooth: GreyImage,
    wide: GreyImage,
    before: Away,
    count: npt.NDArray[np.float32],
    reached: npt.NDArray[np.uint8],
    noise: float,
    restless: Mask,
) -> tuple[Away, Mask, bool]:
    """Return how a frame differs from the mean before, which tiles lag, whether others begin to.

    Parameters
    ----------
    difference, smooth, wide : (H, W) float32
        The frame less the mean, bounded where it is more than noise; the same smoothed, unbounded,
        and the bounded one in the mean of a wide box: how bright a picture is does not matter much.
    before : Away
        What this function returned one frame earlier.
    count : (H, W) float32
        Frames that the mean is worth.
    reached : (H, W) uint8
        Whether the pixel has changed, or lies near what has.
    noise : float
        Standard deviation, grey levels.
    restless : (rows, columns) bool
        Tiles that lagged, and began anew, two frames ago: they are asked a frame sooner than
        others, of the one product that there is.
    """
    away, fine = np.empty_like(smooth), np.empty_like(smooth)
    sums = np.zeros((5, *tiles_of(smooth.shape)))
    numbers = np.zeros_like(sums[0])
    _sum_tiles(
        difference, smooth, wide, *before.detail, before.fine, count, reached, restless, away,
        fine, sums, numbers,
    )  # fmt: skip
    now = Away(detail=(away, before.detail[0]), fine=fine)
    counted = np.maximum(numbers, LEAST)
    first, second, power, finer, finer_power = sums / counted
    seen = numbers >= LEAST
    if not seen.any():
        return now, np.zeros(numbers.shape, np.bool_), False
    calm = seen & (finer_power <= np.quantile(finer_power[seen], CALM))
    least_power = float(finer_power[calm].mean())
    share = float(finer[calm].mean()) / least_power if least_power else 0.0
    if share > 0:
        noisy, little = np.minimum(power, finer_power), np.minimum(power, least_power)
    else:
        noisy = little = PASSED * least_power * numbers / counted

    def lags(hidden: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the squares of the lag, of which noise has done a share of what is hidden."""
        faded = 1.0 if share > 0 else FADED
        both = np.minimum(first - share * hidden, second - faded * share * hidden)
        # of a mean of two frames noise of their own does nothing
        return np.where(restless, first - max(share, 0.0) * hidden, both)

    one, most, slightly = (
        bound[0] + bound[1] * noise**2 for bound in (LAG, LAG_OF_MOST, SLIGHT_LAG)
    )
    # a codec's noise is more here than there: of a tile its own counts, of all what there is least
    lagging = lags(noisy) > one
    rest = np.inf if lagging.all() else float(np.median(lags(little)[~lagging]))
    if rest > most:
        lagging[:] = True
    return now, lagging, rest > slightly


@njit(nogil=True, cache=True, error_model="numpy")
def _sum_tiles(
    difference, smooth, wide, first, second, fine_before, count, reached, restless, away, fine,
    sums, numbers,
):  # fmt: skip
    """Write how detail and finer things differ, and add up by tile what they have in common.

    That is the products of detail with that of the two frames before and its mean square in this
    frame and the one before, and the same for finer things, of one frame before.
    """
    height, width = smooth.shape
    rows, columns = numbers.shape
    totals, found = np.zeros((5, width), np.float32), np.zeros(width, np.float32)
    half = np.float32(0.5)
    asked_from = np.empty(width, np.float32)
    for row in range(height):
        at = min(row // TILE, rows - 1)
        if row == 0 or min((row - 1) // TILE, rows - 1) < at:
            for column in range(width):
                is_restless = restless[at, min(column // TILE, columns - 1)]
                asked_from[column] = 2 if is_restless else 3
        for column in range(width):
            detail = smooth[row, column] - wide[row, column]
            finer = difference[row, column] - smooth[row, column]
            away[row, column] = detail
            fine[row, column] = finer
            is_asked = count[row, column] >= asked_from[column]
            stands = np.float32((reached[row, column] == 0) & is_asked)
            last, finer_last = first[row, column], fine_before[row, column]
            totals[0, column] += stands * detail * last
            totals[1, column] += stands * detail * second[row, column]
            totals[2, column] += stands * half * (detail * detail + last * last)
            totals[3, column] += stands * finer * finer_last
            totals[4, column] += stands * half * (finer * finer + finer_last * finer_last)
            found[column] += stands
        if row == height - 1 or min((row + 1) // TILE, rows - 1) > at:
            for column in range(width):
                tile = min(column // TILE, columns - 1)
                for kind in range(5):
                    sums[kind, at, tile] += totals[kind, column]
                numbers[at, tile] += found[column]
            totals[:] = 0
            found[:] = 0
