"""What stands still is averaged over time: its noise falls from frame to frame.

Not in the thesis. A pixel whose surroundings differ from the mean of the frames before by no
more than noise explains joins that mean; another begins a new one. Differences are judged
against the mean, not the frame before, so that what changes slowly is found too.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.frames import GreyImage, Mask
from pipeline.temporal.lagging import Away, has_few_tiles, lagging_tiles, tile_pixels, tiles_of

MOST_FRAMES = 4
"""Weight of the mean against a new frame, at most, frames: older ones fade."""

SMOOTHING = 0.7
"""σ of the Gaussian on the difference, LR pixels: it leaves ``PASSED`` of the noise's power."""

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
    difference = luma - before.mean
    smooth = cv2.GaussianBlur(difference, (0, 0), SMOOTHING, borderType=cv2.BORDER_REFLECT)
    power = cv2.blur(smooth * smooth, (BOX, BOX), borderType=cv2.BORDER_REFLECT)
    bound = WIDE_BOUND[0] + WIDE_BOUND[1] * noise
    np.clip(difference, -bound, bound, out=difference)
    wide = cv2.blur(difference, (WIDE_BOX, WIDE_BOX), borderType=cv2.BORDER_REFLECT)
    found = np.empty(luma.shape, np.uint8)
    _judge(before.count, power, wide, np.float32(noise), found)
    # what changes is wider than a pixel, what noise feigns is not
    found = cv2.morphologyEx(found, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    reached = _reached(found)
    away, lagging, begins_to_lag = lagging_tiles(
        difference, smooth, wide, before.away, before.count, reached, noise
    )
    if lagging.any() and not has_few_tiles(luma.shape):
        found[tile_pixels(lagging, found.shape)] = 1
        reached = _reached(found)
    mean, count = np.empty_like(before.mean), np.empty_like(before.count)
    _average(luma, found, before.mean, before.count, mean, count)
    return Still(
        mean=mean, count=count, changed=found.view(np.bool_), touched=reached.view(np.bool_),
        away=away, lagging=lagging, begins_to_lag=begins_to_lag,
    )  # fmt: skip


def _reached(found: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return what changes reach, themselves included."""
    side = 2 * CHANGE_REACH + 1
    return cv2.dilate(found, np.ones((side, side), np.uint8))


@njit(nogil=True, cache=True, error_model="numpy")
def _judge(frames, power, wide, noise, changed):
    """Mark the pixels whose surroundings differ from their mean by more than noise."""
    one = np.float32(1.0)
    excess = np.float32(EXCESS * PASSED)
    tolerated = np.float32(TOLERATED * TOLERATED)
    spread = np.float32(16.0 / (WIDE_BOX * WIDE_BOX))
    margin = np.float32(WIDE_TOLERATED)
    for row in range(frames.shape[0]):
        for column in range(frames.shape[1]):
            variance = noise * noise * (one + one / frames[row, column])
            changed[row, column] = power[row, column] > excess * variance + tolerated or abs(
                wide[row, column]
            ) > margin + np.sqrt(spread * variance)


@njit(nogil=True, cache=True, error_model="numpy")
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
