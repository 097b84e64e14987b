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

from pipeline.compiled import LEAN, OPTIONS
from pipeline.frames import Mask
from pipeline.reconstruction.simd import WIDE, add_products

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

BOUNDS = LAG, LAG_OF_MOST, SLIGHT_LAG

CALM = 1 / 4
"""Share of the tiles by which noise is told: those in which what is finer than detail differs
least."""

PASSED = 1 / 3
"""Power of a camera's noise in detail, over that in what is finer."""

FADED = 3 / 4
"""What it does to the second product, over what to the first: so much of the mean is kept."""

STAYS = 0.1
"""Correlation of what is finer than detail from which a codec's noise stays for some frames: that
of a camera's is 0.06 at most."""

NUM_SUMS = 5
"""Of a tile."""

UNIT = 1 / 32
"""What is kept of differences is a multiple of this, grey levels: it is read and written once a
frame, and half as many bytes take half as long."""

Differences = npt.NDArray[np.int16]
"""In such units."""

LEAST = TILE**2 / 3
"""Pixels of a tile that are counted at least: of few, chance says more."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Away:
    """How frames that are past differed from the means before them."""

    detail: tuple[Differences, Differences]
    """Two of (H, W): the last frame's detail, and that of the one before it."""
    fine: Differences
    """(H, W): what is finer than detail, of the last frame."""

    @classmethod
    def none(cls, shape: tuple[int, ...]) -> Away:
        """Return what there is after one frame."""
        nothing = np.zeros(shape, np.int16)
        return cls(detail=(nothing, nothing), fine=nothing)


def tiles_of(shape: tuple[int, ...]) -> tuple[int, int]:
    """Return how many rows and columns of tiles a picture has."""
    return max(1, shape[0] // TILE), max(1, shape[1] // TILE)


def has_few_tiles(shape: tuple[int, ...], few: int = FEW_TILES) -> bool:
    """Return whether a picture is so small that it is computed anew where much of it lags.

    Or whether it has fewer tiles than another number of them.
    """
    rows, columns = tiles_of(shape)
    return rows * columns < few


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


def no_sums(shape: tuple[int, ...]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return room for the sums of a picture's tiles, see :func:`add_tiles`."""
    sums = np.zeros((NUM_SUMS, *tiles_of(shape)))
    return sums, np.zeros_like(sums[0])


def lagging_tiles(
    sums: npt.NDArray[np.float64], numbers: npt.NDArray[np.float64], noise: float, restless: Mask
) -> tuple[Mask, bool, float | None]:
    """Return which tiles lag behind, whether the others begin to, and what noise does.

    That is the correlation of what is finer than detail, None where nothing tells it.

    Parameters
    ----------
    sums : (5, rows, columns) float64
        Of how a frame differs from the mean before, see :func:`add_row`.
    numbers : (rows, columns) float64
        Pixels that were counted.
    noise : float
        Standard deviation, grey levels.
    restless : (rows, columns) bool
        See :func:`ask_tiles`.
    """
    lagging = np.zeros(numbers.shape, np.bool_)
    bounds = np.array([constant + share * noise**2 for constant, share in BOUNDS])
    begins, share = _tell(sums.reshape(len(sums), -1), numbers.ravel(), bounds,
        restless.ravel(), lagging.ravel())  # fmt: skip
    return lagging, begins, None if np.isnan(share) else share


@njit(**OPTIONS)
def _tell(sums, numbers, bounds, restless, lagging):
    """Write which tiles lag behind, and return whether the others begin to; all flat.

    ``bounds`` are those of a tile, of the median of all others, and of the latter's beginning.
    Returned is also the correlation of what is finer than detail, where it is calm; NaN where no
    tile is seen.
    """
    means, seen = np.empty_like(sums), numbers >= LEAST
    for tile in range(numbers.size):
        counted = max(numbers[tile], LEAST)
        for kind in range(sums.shape[0]):
            means[kind, tile] = sums[kind, tile] / counted
    finest = np.sort(means[4][seen])
    if finest.size == 0:
        return False, np.nan
    limit, finer, least_power, count = _quantile(finest, CALM), 0.0, 0.0, 0
    for tile in range(numbers.size):
        if seen[tile] and means[4, tile] <= limit:
            finer += means[3, tile]
            least_power += means[4, tile]
            count += 1
    share = finer / least_power if least_power > 0 else 0.0
    least_power /= count
    rest, others = np.empty(numbers.size), 0
    for tile in range(numbers.size):
        # a codec's noise is more here than there: of a tile its own counts, of all what there is
        # least
        if share > 0:
            noisy = min(means[2, tile], means[4, tile])
            little = min(means[2, tile], least_power)
        else:
            noisy = little = PASSED * least_power * numbers[tile] / max(numbers[tile], LEAST)
        lagging[tile] = _lag(means, tile, share, noisy, restless[tile]) > bounds[0]
        if not lagging[tile]:
            rest[others] = _lag(means, tile, share, little, restless[tile])
            others += 1
    middle = _quantile(np.sort(rest[:others]), 0.5) if others else np.inf
    if middle > bounds[1]:
        lagging[:] = True
    return middle > bounds[2], share


@njit(**LEAN)
def _lag(means, tile, share, hidden, is_restless):
    """Return the square of a tile's lag, of which noise has done a share of what is hidden."""
    if is_restless:
        # of a mean of two frames noise of their own does nothing
        return means[0, tile] - max(share, 0.0) * hidden
    faded = 1.0 if share > 0 else FADED
    return min(means[0, tile] - share * hidden, means[1, tile] - faded * share * hidden)


@njit(**LEAN)
def _quantile(ascending, share):
    """Return what that share of the numbers does not exceed, between two of them linearly."""
    place = share * (ascending.size - 1)
    below = int(place)
    above = min(below + 1, ascending.size - 1)
    return ascending[below] + (place - below) * (ascending[above] - ascending[below])


@njit(**LEAN)
def tile_of(row, count):
    """Return the row of tiles, of so many, in which a row of pixels lies."""
    return min(row // TILE, count - 1)


@njit(**LEAN)
def ask_tiles(restless, asked_from):
    """Write of how many frames a mean is to be before it is asked, for each column of pixels.

    Parameters
    ----------
    restless : (columns,) bool
        Tiles that lagged, and began anew, two frames ago: they are asked a frame sooner than
        others, of the one product that there is.
    asked_from : (W,) float32
        Overwritten.
    """
    for column in range(asked_from.size):
        is_restless = restless[tile_of(column, restless.size)]
        asked_from[column] = np.float32(2) if is_restless else np.float32(3)


@njit(**LEAN)
def add_row(
    detail, fine, first, second, fine_before, frames, reached, asked_from, products
):  # fmt: skip
    """Add up, column by column, what a row has in common with the frames before.

    That is the products of detail with that of the two frames before and its mean square in this
    frame and the one before, and the same for finer things, of one frame before.

    Parameters
    ----------
    detail, fine : (W,) int16
        How the frame differs from the mean before, in units.
    first, second, fine_before : (W,) int16
        The same of one frame before, of two, and of one.
    frames, asked_from : (W,) float32
        Of how many the mean is one, and of how many it is to be.
    reached : (W,) uint8
        Whether the pixel has changed, or lies near what has.
    products : (6, ≥ W) float32
        Squares of units; in the last row, pixels.
    """
    half, zero, one = np.float32(0.5), np.float32(0.0), np.float32(1.0)
    whole = detail.size - detail.size % WIDE
    flat, pitch = products.reshape(-1), products.shape[1]
    for x in range(0, whole, WIDE):
        add_products(
            detail, fine, first, second, fine_before, frames, asked_from, reached, x, flat, pitch
        )  # fmt: skip
    for x in range(whole, detail.size):
        own, finer = np.float32(detail[x]), np.float32(fine[x])
        last, finer_last = np.float32(first[x]), np.float32(fine_before[x])
        stands = one if (reached[x] == 0) & (frames[x] >= asked_from[x]) else zero
        products[0, x] += stands * own * last
        products[1, x] += stands * own * np.float32(second[x])
        products[2, x] += stands * half * (own * own + last * last)
        products[3, x] += stands * finer * finer_last
        products[4, x] += stands * half * (finer * finer + finer_last * finer_last)
        products[5, x] += stands


@njit(**LEAN)
def add_tiles(products, width, at, sums, numbers):
    """Hand what was added up in columns over to the tiles of a row, and begin anew.

    Parameters
    ----------
    products, width
        Of :func:`add_row`; so many columns of it.
    sums, numbers : (5, rows, columns), (rows, columns) float64
        Added to, in row ``at``; grey levels², pixels.
    """
    columns, square = numbers.shape[1], UNIT * UNIT
    for x in range(width):
        tile = tile_of(x, columns)
        for kind in range(NUM_SUMS):
            sums[kind, at, tile] += square * products[kind, x]
        numbers[at, tile] += products[NUM_SUMS, x]
    products[:] = 0
