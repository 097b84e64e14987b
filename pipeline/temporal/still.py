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

from pipeline.frames import GreyImage, Mask, frozen
from pipeline.temporal import still_kernels
from pipeline.temporal.lagging import (
    STAYS,
    Away,
    has_few_tiles,
    lagging_tiles,
    no_sums,
    tile_pixels,
    tiles_of,
)
from pipeline.temporal.still_kernels import CHANGE_REACH, REACH

MOST_FRAMES = 4
"""Weight of the mean against a new frame, at most, frames: older ones fade."""

SMOOTHING = 0.7
"""σ of the Gaussian on the difference, LR pixels: it leaves ``still_kernels.PASSED`` of the noise's
power."""

WIDE_BOUND = (1.0, 1.5)
"""What it is cut off at, constant and factor on the noise, so that a strong change does not
reach as far as the box: grey levels."""


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
    noise_stays: bool = False
    """Whether noise stays for some frames, as a codec's does."""

    @functools.cached_property
    def share_touched(self) -> float:
        """Share of the pixels that have changed, or lie near what has."""
        return np.count_nonzero(self.touched) / self.touched.size

    @functools.cached_property
    def begun(self) -> Mask:
        """(H, W): whether the mean of the pixel has lagged behind."""
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
    detail, fine = (np.empty(luma.shape, np.int16) for _ in range(2))
    mean, count = (np.empty(luma.shape, np.float32) for _ in range(2))
    changed, reached = (np.empty(luma.shape, np.uint8) for _ in range(2))
    sums, numbers = no_sums(luma.shape)
    still_kernels.compare(
        # both read-only, for one compilation
        frozen(luma), frozen(before.mean), before.count, MOST_FRAMES, noise,
        WIDE_BOUND[0] + WIDE_BOUND[1] * noise, _taps(), *before.away.detail, before.away.fine,
        before.restless, detail, fine, changed, reached, sums, numbers, mean, count,
    )  # fmt: skip
    away = Away(detail=(detail, before.away.detail[0]), fine=fine)
    lagging, begins_to_lag, share = lagging_tiles(sums, numbers, noise, before.restless)
    noise_stays = before.noise_stays if share is None else share > STAYS
    begin_anew = not has_few_tiles(luma.shape)
    if begin_anew and lagging.any():
        anew = tile_pixels(lagging, luma.shape)
        mean[anew], count[anew], changed[anew] = luma[anew], 1, 1
        reached = _reached(changed)
    return Still(
        mean=mean, count=count, changed=changed.view(np.bool_), touched=reached.view(np.bool_),
        away=away, lagging=lagging, restless=before.lagging & begin_anew,
        begins_to_lag=begins_to_lag, noise_stays=noise_stays,
    )  # fmt: skip


def _reached(found: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
    """Return what changes reach, themselves included."""
    side = 2 * CHANGE_REACH + 1
    return cv2.dilate(found, np.ones((side, side), np.uint8))


@functools.cache
def _taps() -> npt.NDArray[np.float32]:
    """Return the half taps of the Gaussian."""
    return cv2.getGaussianKernel(2 * REACH + 1, SMOOTHING)[REACH:, 0].astype(np.float32)
