"""One view alone, enlarged and sharpened by a linear filter: where the default solver starts.

The regularised inverse of blur and sampling, one axis after the other: of all HR rows f the one
that minimises |S B f − y|² + ρ |D f|², S B the PSF at the LR pixels and D the first difference. It
is the Wiener filter of a signal whose differences are independent; ρ is the variance of the noise
over that of the differences, measured in the view itself. Far from the border it is the same few
taps for every LR pixel, one set for each of the K phases.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.baselines import bicubic_taps
from pipeline.compiled import LEAN, OPTIONS, PUT_IN_PLACE
from pipeline.frames import GreyImage, frozen
from pipeline.grid import Grid
from pipeline.reconstruction.psf import Psf, psf_axes
from pipeline.reconstruction.rows import mirror
from pipeline.reconstruction.simd import FAR, WIDE, weigh_place, weigh_places, weigh_places_far
from pipeline.threads import map_threads

REACH = 8
"""LR pixels to each side that the filter may reach."""

NEGLIGIBLE = 1e-3
"""Outer taps below it are left out."""

SMOOTHNESS = 0.6
"""Factor on ρ: along the other axis, too, noise is removed."""

SMALLEST_RATIO = 0.003
"""Smallest ρ: what a wide PSF has removed wholly must not be asked back."""

RATIO_STEPS = 16
"""Values of ρ from one to twice as much: between them lies no difference that shows."""

FLATTEST = 0.1
"""Smallest variance of differences that is told from none, grey levels squared."""

BAND = 64
"""LR rows that one thread filters at once."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Restoration:
    """The linear filter for a view."""

    along_x: npt.NDArray[np.float32]
    """(K, odd): taps of each phase over LR pixels."""
    along_y: npt.NDArray[np.float32]

    @property
    def reach(self) -> int:
        """LR pixels to each side that the filter reaches."""
        return max(self.along_x.shape[1], self.along_y.shape[1]) // 2

    @property
    def roughness(self) -> float:
        """Mean square of the differences of neighbours that noise of variance 1 becomes."""
        power_x, steps_x = _power_and_steps(self.along_x)
        power_y, steps_y = _power_and_steps(self.along_y)
        return (steps_x * power_y + power_x * steps_y) / 2

    def apply(
        self, view: GreyImage, grid: Grid, inner: tuple[slice, slice] | None = None
    ) -> npt.NDArray[np.float32]:
        """Return a view enlarged and sharpened, (K·H, K·W) float32.

        Parameters
        ----------
        inner : (rows, columns), optional
            Of the view, what is asked for; default: all.
        """
        # contiguous and read-only, for one compilation
        image = frozen(np.ascontiguousarray(view, np.float32))
        rows, columns = inner or tuple(slice(0, size) for size in image.shape)
        height, width = rows.stop - rows.start, columns.stop - columns.start
        out = np.empty(grid.hr_shape((height, width)), np.float32)
        map_threads(
            lambda lo: filter_phases(
                image, self.along_x, self.along_y, rows.start + lo,
                rows.start + min(lo + BAND, height), columns.start, columns.stop,
                out[lo * grid.magnification_y :],
            ),
            range(0, height, BAND),
        )  # fmt: skip
        return out


@njit(**OPTIONS)
def filter_phases(image, along_x, along_y, top, bottom, left, right, out):
    """Write the HR pixels of a part of a view, each phase filtered by taps of its own.

    Parameters
    ----------
    image : (H, W) float32
    along_x, along_y : (K, odd) float32
        Taps over LR pixels, of each phase along x and along y.
    top, bottom, left, right : int
        Rows and columns of the view, half-open.
    out : (≥ K·h, K·w) float32
    """
    reach = along_x.shape[1] // 2
    length = right - left + 2 * reach + WIDE
    _filter_rows(
        image.reshape(-1), image.shape, along_x.reshape(-1), along_x.shape, along_y.reshape(-1),
        along_y.shape, top, bottom, left, right, np.empty(along_y.shape[1], np.int64),
        np.arange(along_x.shape[1]), np.zeros(length, np.float32),
        np.empty((along_x.shape[0], length), np.float32), out,
    )  # fmt: skip


@njit(**LEAN)
def _filter_rows(
    pixels, shape, taps_x, size_x, taps_y, size_y, top, bottom, left, right, places, steps, room,
    lines, out,
):  # fmt: skip
    height, width = shape
    reach_x, reach_y, phases = size_x[1] // 2, size_y[1] // 2, size_y[0]
    # columns of the view that are filtered along y; beyond its edge it is reflected
    first, last = max(left - reach_x, 0), min(right + reach_x, width)
    begin = first - left + reach_x
    for row in range(top, bottom):
        for k in range(places.size):
            places[k] = mirror(row + k - reach_y, height) * width + first
        for phase in range(phases):
            tap = phase * size_y[1]
            weigh_row(pixels, places, last - first, taps_y, tap, room, begin)
            for k in range(begin):
                room[k] = room[mirror(left - reach_x + k, width) - left + reach_x]
            for k in range(last - left + reach_x, right - left + 2 * reach_x):
                room[k] = room[mirror(left - reach_x + k, width) - left + reach_x]
            for fine in range(size_x[0]):
                # sixteens: there is room for more than are asked for
                size = right - left + WIDE - 1
                size -= size % WIDE
                weigh_row(room, steps, size, taps_x, fine * size_x[1], lines[fine], 0)
            _interleave(lines, out[(row - top) * phases + phase])


@njit(**PUT_IN_PLACE)
def weigh_row(pixels, places, size, taps, first, out, to):
    """Write a row of sums of pixels; see :func:`simd.weigh_places`."""
    far, whole = size - size % (FAR * WIDE), size - size % WIDE
    for x in range(0, far, FAR * WIDE):
        weigh_places_far(pixels, places, x, taps, first, out, to + x)
    for x in range(far, whole, WIDE):
        weigh_places(pixels, places, x, taps, first, out, to + x)
    # the image may have no more pixels there
    for x in range(whole, size):
        weigh_place(pixels, places, x, taps, first, out, to + x)


@njit(**LEAN)
def _interleave(lines, out):
    """Write pixels of lines in turn."""
    count = lines.shape[0]
    if count == 2:
        even, odd = lines[0], lines[1]
        for x in range(out.size // 2):
            out[2 * x] = even[x]
            out[2 * x + 1] = odd[x]
    else:
        for line in range(count):
            own, rest = lines[line], out[line:]
            for x in range(out.size // count):
                rest[x * count] = own[x]


def _power_and_steps(taps: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Return the mean squares that noise of variance 1 becomes along an axis, and its steps."""
    response = taps[:, ::-1].T.ravel()
    steps = np.diff(np.pad(response, 1))
    return float(np.vdot(response, response)) / len(taps), float(np.vdot(steps, steps)) / len(taps)


def restoration_of(reference: GreyImage, grid: Grid, psf: Psf, noise: float) -> Restoration:
    """Return the filter for a view; parameters are those of :func:`restored`."""
    psf_x, psf_y = psf_axes(psf, grid)
    ratio_x, ratio_y = (
        _ratio(power, noise, magnification)
        for power, magnification in zip(
            _powers(frozen(reference)), (grid.magnification_x, grid.magnification_y), strict=True
        )
    )
    return Restoration(
        along_x=_taps(psf_x, grid.magnification_x, grid.offset_x, ratio_x),
        along_y=_taps(psf_y, grid.magnification_y, grid.offset_y, ratio_y),
    )


@functools.lru_cache(maxsize=8)
def bicubic_filter(grid: Grid) -> Restoration:
    """Return the filter that only enlarges, by bicubic interpolation."""
    return Restoration(
        along_x=bicubic_taps(grid.magnification_x, grid.offset_x),
        along_y=bicubic_taps(grid.magnification_y, grid.offset_y),
    )


@functools.lru_cache(maxsize=8)
def halved_bicubic_filter(grid: Grid) -> Restoration | None:
    """Return the filter that enlarges so, and then halves as 4:2:0 video does; None where K is odd.

    Its phases are those of :attr:`pipeline.grid.Grid.halved`.
    """
    if grid.magnification_x % 2 or grid.magnification_y % 2:
        return None
    whole = bicubic_filter(grid)
    return Restoration(
        along_x=_halved(whole.along_x, {-1: 0.25, 0: 0.5, 1: 0.25}),
        along_y=_halved(whole.along_y, {0: 0.5, 1: 0.5}),
    )


def _halved(taps: npt.NDArray[np.float32], shares: Mapping[int, float]) -> npt.NDArray[np.float32]:
    """Return the taps of every second phase, each the mean of those around it, by their shares."""
    phases, count = taps.shape
    found = np.zeros((phases // 2, count + 2), np.float32)
    for half, (away, share) in itertools.product(range(phases // 2), shares.items()):
        pixel, phase = divmod(2 * half + away, phases)
        found[half, 1 + pixel : 1 + pixel + count] += share * taps[phase]
    return found


def restored(reference: GreyImage, grid: Grid, psf: Psf, noise: float) -> npt.NDArray[np.float32]:
    """Return the view enlarged and sharpened, (K·H, K·W) float32.

    Parameters
    ----------
    noise : float
        Standard deviation, grey levels.
    """
    return restoration_of(reference, grid, psf, noise).apply(reference, grid)


def _ratio(power: float, noise: float, magnification: int) -> float:
    """Return ρ along an axis, by the mean square of the differences of LR pixels along it."""
    variance = power - 2 * noise**2
    ratio = SMOOTHNESS * noise**2 * magnification / max(variance, FLATTEST)
    # on steps, so that pictures much alike share their taps
    return 2 ** (round(RATIO_STEPS * math.log2(max(ratio, SMALLEST_RATIO))) / RATIO_STEPS)


@njit(**LEAN)
def _powers(image):
    """Return the mean squares of the differences of neighbours along x and y; infinite: none."""
    height, width = image.shape
    along_x = along_y = 0.0
    for row in range(height):
        own = image[row]
        along_x += _sum_squares(own[:-1], own[1:])
        along_y += _sum_squares(own, image[min(row + 1, height - 1)])
    return (
        along_x / (height * (width - 1)) if width > 1 else np.inf,
        along_y / ((height - 1) * width) if height > 1 else np.inf,
    )


@njit(**LEAN)
def _sum_squares(first, second):
    """Return the sum of the squares of what two rows differ by."""
    total = np.float32(0.0)
    for x in range(first.size):
        away = first[x] - second[x]
        total += away * away
    return total


@functools.lru_cache(maxsize=64)
def _taps(
    psf: Psf | None, magnification: int, offset: float, ratio: float
) -> npt.NDArray[np.float32]:
    """Return the taps of each phase over LR pixels, (K, odd) float32, unit sum."""
    if psf is None:
        return np.ones((1, 1), np.float32)
    blur, squares, roughness = _system(psf, magnification, offset)
    inverse = np.linalg.solve(squares + ratio * roughness, blur.T)
    middle = len(blur) // 2
    found = inverse[middle * magnification : (middle + 1) * magnification]
    found = found[:, middle - REACH : middle + REACH + 1]
    needed = np.flatnonzero((np.abs(found) > NEGLIGIBLE).any(axis=0))
    reach = int(np.abs(needed - REACH).max())
    found = found[:, REACH - reach : REACH + reach + 1]
    return (found / found.sum(axis=1, keepdims=True)).astype(np.float32)


@functools.lru_cache(maxsize=8)
def _system(
    psf: Psf, magnification: int, offset: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return S B of a few LR pixels, (S B)ᵀ S B and Dᵀ D."""
    count = 4 * REACH + 1
    size = count * magnification
    blur = np.zeros((count, size))
    for row in range(count):
        position = magnification * row + offset
        centre = int(np.floor(position + 0.5))
        taps = psf.taps_at(position - centre)
        for index, tap in enumerate(taps, centre - taps.size // 2):
            blur[row, mirror(index, size)] += tap
    steps = np.diff(np.eye(size), axis=0)
    return blur, blur.T @ blur, steps.T @ steps
