"""What stands still is averaged over time: its noise falls from frame to frame.

Not in the thesis. A recursive temporal average. A pixel whose surroundings differ from the mean of
the frames before by no more than noise explains joins that mean; another begins a new one.
Differences are judged against the mean, not the frame before, so that what changes slowly is found
too.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT, LEAN, OPTIONS
from pipeline.frames import GreyImage, Mask, frozen
from pipeline.reconstruction.rows import blur_ring, blur_row, mirror
from pipeline.temporal.lagging import Away, has_few_tiles, lagging_tiles, tile_pixels, tiles_of

MOST_FRAMES = 4
"""Weight of the mean against a new frame, at most, frames: older ones fade."""

SMOOTHING = 0.7
"""σ of the Gaussian on the difference, LR pixels: it leaves ``PASSED`` of the noise's power."""

SMOOTHING_REACH = 3
"""Pixels to each side that it reaches."""

PASSED = 1 / 6

BOX = 5
"""Side of the box over which the square of the smoothed difference is averaged, LR pixels."""

TOLERATED = 1.5
"""Grey levels by which it may differ beside the noise."""

EXCESS = 2.5
"""Power of the noise in a box, over its mean, that still is noise."""

WIDE_BOX = 15
"""Side of the box over which the difference itself is averaged, LR pixels: what is too faint
for the small box, a shadow say, but wide."""

WIDE_BOUND = (1.0, 1.5)
"""What it is cut off at, constant and factor on the noise, so that a strong change does not
reach as far as the box: grey levels."""

WIDE_TOLERATED = 0.4
"""Grey levels by which that mean may differ beside four standard deviations of its noise."""

CHANGE_REACH = 2
"""How far a change reaches into what is reconstructed, LR pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Still:
    """A view's luma, averaged over the frames in which it has stood still."""

    mean: GreyImage
    """(H, W) float32, grey levels."""
    count: npt.NDArray[np.float32]
    """(H, W): frames that the mean is worth, 1 where something has changed."""
    changed: Mask
    """(H, W): whether the pixel began a new mean with the last frame."""
    touched: Mask
    """(H, W): what has changed, and what lies within ``CHANGE_REACH`` of it."""
    away: Away
    """How the last frames differed from the means before them."""
    lagging: Mask
    """(rows, columns) of tiles: whether the mean of them has lagged behind."""
    restless: Mask
    """(rows, columns): whether it did one frame before, and they began anew."""
    begins_to_lag: bool = False
    """Whether those of the others begin to."""

    @functools.cached_property
    def share_touched(self) -> float:
        """Share of the pixels that have changed, or lie near what has."""
        return np.count_nonzero(self.touched) / self.touched.size

    @functools.cached_property
    def begun(self) -> Mask:
        """(H, W): whether the pixel lies in such a tile."""
        return tile_pixels(self.lagging, self.changed.shape)


def first_seen(luma: GreyImage) -> Still:
    """Return what is known after one frame."""
    return Still(
        mean=luma,
        count=np.ones(luma.shape, np.float32),
        changed=np.ones(luma.shape, np.bool_),
        touched=np.ones(luma.shape, np.bool_),
        away=Away.none(luma.shape),
        lagging=np.zeros(tiles_of(luma.shape), np.bool_),
        restless=np.zeros(tiles_of(luma.shape), np.bool_),
    )


def seen_again(luma: GreyImage, before: Still, noise: float) -> Still:
    """Return what is known after one more frame.

    Parameters
    ----------
    luma : (H, W) float32
        Of the frame, grey levels.
    before : Still
        After the frame before it; one of another size is forgotten.
    noise : float
        Standard deviation, grey levels.
    """
    if before.mean.shape != luma.shape:
        return first_seen(luma)
    difference, smooth, wide = (np.empty(luma.shape, np.float32) for _ in range(3))
    found = np.empty(luma.shape, np.uint8)
    _compare(
        # both read-only, for one compilation
        frozen(luma), frozen(before.mean), before.count, noise,
        WIDE_BOUND[0] + WIDE_BOUND[1] * noise, *_windows(), difference, smooth, wide, found,
    )  # fmt: skip
    # what changes is wider than a pixel, what noise feigns is not
    found = cv2.morphologyEx(found, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    reached = _reached(found)
    away, lagging, begins_to_lag = lagging_tiles(
        difference, smooth, wide, before.away, before.count, reached, noise,
        before.restless,
    )  # fmt: skip
    begin_anew = not has_few_tiles(luma.shape)
    if lagging.any() and begin_anew:
        found[tile_pixels(lagging, found.shape)] = 1
        reached = _reached(found)
    mean, count = np.empty_like(before.mean), np.empty_like(before.count)
    _average(luma, found, before.mean, before.count, mean, count)
    return Still(
        mean=mean, count=count, changed=found.view(np.bool_), touched=reached.view(np.bool_),
        away=away, lagging=lagging, restless=before.lagging & begin_anew,
        begins_to_lag=begins_to_lag,
    )  # fmt: skip


def _reached(found: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return what changes reach, themselves included."""
    side = 2 * CHANGE_REACH + 1
    return cv2.dilate(found, np.ones((side, side), np.uint8))


@functools.cache
def _windows() -> tuple[npt.NDArray[np.float32], ...]:
    """Return the half taps of the Gaussian, the box and the wide box."""
    gauss = cv2.getGaussianKernel(2 * SMOOTHING_REACH + 1, SMOOTHING)[SMOOTHING_REACH:, 0]
    boxes = (np.full(side // 2 + 1, 1 / side, np.float32) for side in (BOX, WIDE_BOX))
    return gauss.astype(np.float32), *boxes


@njit(**OPTIONS)
def _compare(
    luma, means, frames, noise, bound, gauss, box, wide_box, difference, smooth, wide, changed
):
    """Write how a picture differs from the mean before it, and where that is more than noise.

    Rows stream by: nothing but what is asked for leaves the processor's cache.

    Parameters
    ----------
    luma, means, frames : (H, W) float32
        The picture, the mean, and of how many frames it is one.
    noise, bound : float
        Grey levels; the difference is cut off at the latter.
    gauss, box, wide_box : float32
        Half taps; the last ones reach farthest.
    difference, smooth, wide : (H, W) float32
        Overwritten: what is cut off; smoothed, before it is; and its mean over the wide box.
    changed : (H, W) uint8
        Overwritten: where the mean square of what is smoothed, or that mean, is more than noise.
    """
    # the row that leaves the wide box is still there when another one enters
    width, lines = luma.shape[1], 2 * wide_box.size
    _compare_rows(
        luma, means, frames, np.float32(noise), np.float32(bound), gauss, box, wide_box,
        difference, smooth, wide, changed, np.empty((3, lines, width), np.float32),
        np.empty(width + lines, np.float32), np.empty(width, np.float32),
        np.zeros(width, np.float32),
    )  # fmt: skip


@njit(**LEAN)
def _compare_rows(
    luma, means, frames, noise, bound, gauss, box, wide_box, difference, smooth, wide, changed,
    rings, room, line, total,
):  # fmt: skip
    height, width = luma.shape
    lines = rings.shape[1]
    reach, share = wide_box.size - 1, wide_box[0]
    smoothed, squares, sums = rings[0], rings[1], rings[2]
    next_row = next_smooth = np.int64(0)
    for y in range(height):
        while next_row < min(height, y + wide_box.size):
            v = next_row
            _differ(luma[v], means[v], bound, line, difference[v])
            blur_row(line, gauss, room, smoothed[v % lines])
            blur_row(difference[v], wide_box, room, sums[v % lines])
            next_row += 1
        while next_smooth < min(height, y + box.size):
            v = next_smooth
            blur_ring(smoothed, v, gauss, height, width, smooth[v])
            _square(smooth[v], line)
            blur_row(line, box, room, squares[v % lines])
            next_smooth += 1
        blur_ring(squares, y, box, height, width, line)
        # what a column holds of the wide box goes on from row to row
        if y == 0:
            for row in range(-reach, reach + 1):
                _add(sums[mirror(row, height) % lines], total)
        else:
            _exchange(
                sums[mirror(y + reach, height) % lines],
                sums[mirror(y - reach - 1, height) % lines], total,
            )  # fmt: skip
        _scale(total, share, wide[y])
        _judge(frames[y], line, wide[y], noise, changed[y])


@njit(**LEAN)
def _differ(own, mean, bound, out, cut_off):
    for x in range(out.size):
        away = own[x] - mean[x]
        out[x] = away
        cut_off[x] = min(max(away, -bound), bound)


@njit(**LEAN)
def _add(row, total):
    for x in range(total.size):
        total[x] += row[x]


@njit(**LEAN)
def _exchange(entering, leaving, total):
    for x in range(total.size):
        total[x] += entering[x] - leaving[x]


@njit(**LEAN)
def _scale(row, share, out):
    for x in range(out.size):
        out[x] = share * row[x]


@njit(**LEAN)
def _square(row, out):
    for x in range(row.size):
        out[x] = row[x] * row[x]


@njit(**LEAN)
def _judge(frames, power, wide, noise, changed):
    """Mark the pixels of a row whose surroundings differ from their mean by more than noise."""
    one = np.float32(1.0)
    excess = np.float32(EXCESS * PASSED)
    tolerated = np.float32(TOLERATED * TOLERATED)
    spread = np.float32(16.0 / (WIDE_BOX * WIDE_BOX))
    margin = np.float32(WIDE_TOLERATED)
    for x in range(frames.size):
        variance = noise * noise * (one + one / frames[x])
        is_strong = power[x] > excess * variance + tolerated
        # without a root: farther than the margin, and that by more than four deviations
        beyond = abs(wide[x]) - margin
        is_wide = (beyond > 0) & (beyond * beyond > spread * variance)
        changed[x] = is_strong | is_wide


@njit(**EXACT)
def _average(luma, changed, means, counts, mean, count):
    """Write the means that a frame has joined; where something has changed it begins a new one."""
    one = np.float32(1.0)
    most = np.float32(MOST_FRAMES)
    for row in range(luma.shape[0]):
        begins, now, before, frames = changed[row], luma[row], means[row], counts[row]
        out, number = mean[row], count[row]
        # without a branch, eight at once
        for column in range(luma.shape[1]):
            goes_on = min(frames[column] + one, most)
            number[column] = one if begins[column] else goes_on
        for column in range(luma.shape[1]):
            out[column] = before[column] + (now[column] - before[column]) / number[column]
