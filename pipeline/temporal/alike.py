"""What changes in all views alike: the scene; what a codec leaves it leaves in each by itself.

Not in the thesis. Where a mean is behind a frame, it is so in all views alike, for they show one
scene; a camera's noise, and what a codec leaves as it was or draws better, each view has of its
own. So what a view differs by from its mean is compared with what others differ by from theirs,
where registration has found them to show the same: their correlation is the share of it that the
scene has changed, whatever the codec does. That tells it in two frames, and in small pictures.

Which of the two is better the other views tell, too, for they are nearer to it: where a codec has
drawn a frame better than those before, means are moved on to it, as far as is best.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.frames import GreyImage, Mask, Positions, frozen
from pipeline.temporal.lagging import tile_of, tiles_of

LOOKED_AT = 1 << 13
"""Pixels of a view that are looked at, about; all of a smaller one."""

ASKED = 3
"""Other views that are asked, the nearest of them."""

SHARED = (0.025, 0.04)
"""Correlation from which a tile is behind, and what is added to it for each time that the mean is
better than the frame by the power of what they differ by: then less of a lag is lost."""

LEAST = 0.004
"""What they differ by alike, at least, grey levels²."""

HARMLESS = 0.04
"""The same that does no harm …"""

CERTAIN = 0.2
"""… where the correlation is as high: a codec, which hides more than it shows, leaves less."""

MUCH = 1 / 4
"""Share of the tiles, each with those around it, beyond which a picture is behind …"""

MOST = 1 / 2
"""… and beyond which most of it is."""

DOUBTED = 2
"""Frames after one in which much was behind, or that was restored as if the camera had moved, that
begin from their means alone: a frame tells little of a mean of two or three."""

NOISY = 1.0
"""Noise below which these means are left for the frame: there is little to gain by them, grey
levels."""

LITTLE = 0.02
"""Part of the way to the frame up to which means are left where they are."""

FAR = (0.3, 0.03)
"""Part of the way from which it is far to a frame, and by how much nearer, at least, to what the
other views show that brings the means, grey levels²: then a picture of few tiles begins from its
means alone, and means that are doubted are left for the frame."""

NUM_SUMS = 5


@dataclass(frozen=True, kw_only=True, eq=False)
class Looked:
    """A frame's view that was registered onto a target."""

    luma: GreyImage
    """(H, W) float32, grey levels, less what registration takes off."""
    mean: GreyImage
    """(H, W) float32: of the frames in which it has stood still, this one among them."""
    touched: Mask
    """(H, W): what has changed at once, or lies near that: there nothing is asked."""
    position: Positions
    """(H, W, 2) float32: where its pixels are in the target."""
    flags: npt.NDArray[np.uint8]
    """(H, W): 0 where that is trusted."""
    offset: GreyImage
    """(H, W): what is taken off to be as bright as the target."""


def differences_alike(
    luma: GreyImage, mean: GreyImage, touched: Mask, others: Iterable[Looked]
) -> npt.NDArray[np.float64]:
    """Return the sums of a target's tiles, (5, rows, columns); see :class:`Alike`.

    Parameters
    ----------
    luma, mean, touched
        Of the target, as in :class:`Looked`.
    """
    sums = np.zeros((NUM_SUMS, *tiles_of(luma.shape)))
    step = max(1, int((luma.size / LOOKED_AT) ** 0.5))
    for other in others:
        # all read-only, for one compilation
        _add_up(
            frozen(luma), frozen(mean), touched, frozen(other.luma), frozen(other.mean),
            other.touched, frozen(other.position), frozen(other.flags), frozen(other.offset),
            step, sums,
        )  # fmt: skip
    return sums


@dataclass(frozen=True, eq=False)
class Alike:
    """What a picture's means differ by from its last frame, in its targets and in other views."""

    sums: npt.NDArray[np.float64]
    """(5, rows, columns), of tiles: by how much farther the mean is from the other views than the
    frame is, squared; the power of what both differ by, here and there; what it has in common here
    and there; and pixels."""

    @functools.cached_property
    def share_behind(self) -> float:
        """Share of the tiles whose mean is behind, of those that were looked at."""
        # chance says less of a tile and those around it
        excess, here, there, alike, count = (
            np.maximum(cv2.blur(one, (3, 3), borderType=cv2.BORDER_CONSTANT), least)
            for one, least in zip(self.sums, (-np.inf, 0, 0, -np.inf, 0), strict=True)
        )
        seen = count > 0
        if not seen.any():
            return 0.0
        constant, share = SHARED
        bound = constant * here + share * np.maximum(-excess, 0)
        least = np.where(alike > CERTAIN * np.sqrt(here * there), HARMLESS, LEAST)
        behind = (alike > least * count) & (alike * np.sqrt(here) > bound * np.sqrt(there))
        return float(behind[seen].mean())

    @property
    def is_behind(self) -> bool:
        """Whether much of the picture is."""
        return self.share_behind > MUCH

    @functools.cached_property
    def way_on(self) -> float:
        """How far to the frame the means are best moved, 0..1; 0 up to ``LITTLE``.

        A mean that is moved a part p of the way there is by p² P − p (P + T) farther from what
        the other views show, P the power of what both differ by and T that by which it is farther
        than the frame.
        """
        excess, here = (float(one.sum()) for one in self.sums[:2])
        part = min((1 + excess / here) / 2, 1.0) if here > 0 else 0.0
        return part if part > LITTLE else 0.0

    @property
    def is_far(self) -> bool:
        """Whether that is so far, and gains so much, that the means are of little use."""
        nearer, count = self.way_on**2 * self.sums[1].sum(), self.sums[4].sum()
        return bool(self.way_on > FAR[0] and nearer > FAR[1] * count)


NOTHING_ASKED = Alike(np.zeros((NUM_SUMS, 1, 1)))
"""What views tell that nobody has asked: nothing is behind."""


@njit(**OPTIONS)
def _add_up(
    luma, mean, touched, other, mean_there, touched_there, position, flags, offset, step, sums
):  # fmt: skip
    """Add up what every so manyth pixel of another view says of the tile that it lies in."""
    height, width = luma.shape
    rows, columns = sums.shape[1:]
    along_x, along_y = np.empty(4, np.float32), np.empty(4, np.float32)
    for row in range(step // 2, height, step):
        for column in range(step // 2, width, step):
            x, y = position[row, column, 0], position[row, column, 1]
            if flags[row, column] | touched_there[row, column]:
                continue
            # not where it is not known, either
            if not (x >= 1 and y >= 1 and x < width - 2 and y < height - 2):
                continue
            left, top = np.int64(x), np.int64(y)
            if touched[np.int64(y + np.float32(0.5)), np.int64(x + np.float32(0.5))]:
                continue
            _cubic(x - np.float32(left), along_x)
            _cubic(y - np.float32(top), along_y)
            here = shown = np.float32(0.0)
            for j in range(4):
                differs = seen = np.float32(0.0)
                for i in range(4):
                    own = luma[top + j - 1, left + i - 1]
                    differs += along_x[i] * (own - mean[top + j - 1, left + i - 1])
                    seen += along_x[i] * own
                here += along_y[j] * differs
                shown += along_y[j] * seen
            there = other[row, column] - mean_there[row, column]
            farther = other[row, column] - offset[row, column] - shown
            at, tile = tile_of(top, rows), tile_of(left, columns)
            # square of how far the mean is, less that of how far the frame is
            sums[0, at, tile] += here * (farther + farther + here)
            sums[1, at, tile] += here * here
            sums[2, at, tile] += there * there
            sums[3, at, tile] += here * there
            sums[4, at, tile] += 1


@njit(**LEAN)
def _cubic(part, taps):
    """Write the taps of a cubic through four pixels, a part of the way from the second on."""
    half, square = np.float32(0.5), part * part
    cube = square * part
    taps[0] = half * (square + square - cube - part)
    taps[1] = half * (3 * cube - 5 * square + 2)
    taps[2] = half * (part + 4 * square - 3 * cube)
    taps[3] = half * (cube - square)
