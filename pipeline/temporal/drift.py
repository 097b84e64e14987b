"""A picture that goes on changing all over, little by little: a dissolve, a slow pan, a focus pull.

Not in the thesis. From one frame to the next most of it seems to stand still, but what is kept of
it lags behind. What tells it is that it changes as it did a frame before, in most of its blocks;
what only moves in front of something does so in some, and noise in none. Noise that a codec has
left does go on, and what is finer than detail with it: that much of it is taken off. A focus that
is pulled goes on there, too, but changes the contrast of most blocks alike, which noise does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage

AROUND = 9
"""Side of the box whose mean is taken off, half LR pixels: how bright a picture is does not matter
much."""

BLOCK = 8
"""Side of a block, half LR pixels."""

SPAN = 4
"""Frames over which changes are looked at; as many as there are at first."""

IN_BLOCKS = 3 / 4
"""Share of the blocks that go on changing."""

SLOWEST = (0.012, 0.001)
"""Square of what they change by from frame to frame at least over that span, and what is added for
each of the noise's, grey levels²."""

CALM = 1 / 4
"""Share of the blocks by which noise is told: those in which what is finest changes least."""

PASSED = 1 / 4
"""Power of a camera's noise in half-size pictures, over that in what is finest."""

LEFT = 0.9985
"""Share of a block's power over that span that is left at most where the focus is pulled, whatever
light does; one over it where it comes back."""

FEWEST = 32
"""Blocks below which nothing is said: things that move reach into most of so few."""

FEW = 64
"""Blocks below which that is so, too, but where a codec's noise goes on, …"""

GOES_ON = 0.1
"""… as the correlation of what is finest says."""

FIRST = 3
"""Frames of a chain that are each computed by themselves where the first two share their noise."""

SHARED = 0.4
"""Power of what is finest in the change from one frame to the next, where that is calm, over what
noise of their own would give it, below which two frames share their noise."""

QUIET = 1.0
"""Noise below which that is not asked, grey levels: frames share what they show, too."""

AT_ONCE = (0.1, 1.3)
"""Square of what a picture differs by at least from the mean of those before where most has changed
at once: grey levels², and a factor on what noise does there."""

KEPT = SPAN + 2
"""Pictures that are needed, the newest one among them."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Detail:
    """What is looked at of a picture."""

    coarse: GreyImage
    """(h, w): the picture at half its size, less its mean in a box, grey levels."""
    finest: GreyImage
    """(h, w): of the four pixels of each, what differs along both axes, grey levels: noise above
    all, of the same power as in the picture."""
    light: GreyImage
    """(h, w): the mean that is taken off, grey levels."""


def detail_of(luma: GreyImage) -> Detail:
    """Return what is looked at of a picture."""
    coarse, around = _coarse(luma)
    height, width = luma.shape
    even = luma[: 2 * (height // 2), : 2 * (width // 2)]
    along = even[:, ::2] - even[:, 1::2]
    finest = np.float32(0.5) * (along[::2] - along[1::2])
    return Detail(coarse=coarse, finest=finest, light=around)


def changed_at_once(
    details: Sequence[Detail], mean: GreyImage, frames: float, noise: float
) -> bool:
    """Return whether a picture differs in most blocks from those before it by more than noise.

    From the last one, and farther from their mean, which has less noise to hide it; of a codec's
    noise, which goes on, that has too little.

    Parameters
    ----------
    details
        As in :func:`goes_on_changing`.
    mean : (H, W) float32
        The pictures before, averaged, grey levels.
    frames : float
        How many the mean is worth.
    noise : float
        Standard deviation, LR pixels of one frame, grey levels.
    """
    if not _are_two(details[-2:]):
        return False
    last, now = (one.coarse for one in details[-2:])
    before, _ = _coarse(mean)
    if before.shape != now.shape:
        return False
    if _least_of_most(_in_blocks((now - last) ** 2)) <= PASSED * 2 * noise**2:
        return False
    power = _in_blocks((now - before) ** 2)
    return _least_of_most(power) > AT_ONCE[0] + AT_ONCE[1] * PASSED * (1 + 1 / frames) * noise**2


def share_noise(details: Sequence[Detail], noise: float) -> bool:
    """Return whether the first two of some pictures have most of their noise in common.

    Parameters
    ----------
    details, noise
        As in :func:`goes_on_changing`.
    """
    if noise < QUIET or not _are_two(details):
        return False
    squares = _in_blocks((details[1].finest - details[0].finest) ** 2)
    power = float(squares[squares <= np.quantile(squares, CALM)].mean())
    return power < SHARED * 2 * noise**2


def goes_on_changing(details: Sequence[Detail], noise: float) -> bool:
    """Return whether a picture changes all over as it did a frame before.

    Parameters
    ----------
    details : sequence of Detail
        :func:`detail_of` of its last frames, in order; the last ``KEPT`` are looked at.
    noise : float
        Standard deviation, LR pixels of one frame, grey levels.
    """
    span = min(SPAN, len(details) - 2)
    if span < 1 or details[-1].coarse.shape != details[-2 - span].coarse.shape:
        return False
    if _num_blocks(details[-1]) < FEWEST:
        return False
    now, last, before, first = (details[place] for place in (-1, -2, -1 - span, -2 - span))
    slowest = (SLOWEST[0] + SLOWEST[1] * noise**2) * SPAN**2
    changes = now.coarse - before.coarse, last.coarse - first.coarse
    agreeing = _in_blocks(changes[0] * changes[1])
    # of four frames no two share their noise, but a codec's; of three they do, which hides a change
    if span > 1 and _least_of_most(agreeing) <= slowest:
        return False
    power = _in_blocks(changes[0] ** 2 + changes[1] ** 2) / 2
    share, finest = _noise_that_agrees(now.finest - before.finest, last.finest - first.finest)
    if share < GOES_ON and _num_blocks(details[-1]) < FEW:
        return False
    bound = finest if share > 0 else PASSED * finest
    if _least_of_most(agreeing - share * np.minimum(power, bound)) > slowest:
        return True
    if share <= 0:
        return False
    contrast = _contrast_changes(before, now)
    return contrast != 0 and contrast == _contrast_changes(first, last)


def _coarse(luma: GreyImage) -> tuple[GreyImage, GreyImage]:
    """Return a picture at half its size, less its mean in a box, and that mean."""
    height, width = luma.shape
    size = (max(1, width // 2), max(1, height // 2))
    small = cv2.resize(luma, size, interpolation=cv2.INTER_AREA)
    around = cv2.blur(small, (AROUND, AROUND), borderType=cv2.BORDER_REFLECT)
    return small - around, around


def _are_two(details: Sequence[Detail]) -> bool:
    """Return whether there are two pictures of one size, and that is enough."""
    return (
        len(details) > 1
        and details[0].coarse.shape == details[1].coarse.shape
        and _num_blocks(details[0]) >= FEWEST
    )


def _num_blocks(detail: Detail) -> int:
    """Return how many blocks a picture has."""
    height, width = detail.coarse.shape
    return (width // BLOCK) * (height // BLOCK)


def _contrast_changes(before: Detail, now: Detail) -> int:
    """Return 1 where the contrast of most blocks rises, -1 where it falls, 0 where neither."""
    power, other = _in_blocks(now.coarse**2), _in_blocks(before.coarse**2)
    # a gain changes contrast as it does light, an offset changes light alone: neither counts
    light = np.median(_in_blocks(now.light) / np.maximum(_in_blocks(before.light), 1)) ** 2
    falls = power < LEFT * min(1, light) * other
    rises = LEFT * power > max(1, light) * other
    return int(rises.mean() >= IN_BLOCKS) - int(falls.mean() >= IN_BLOCKS)


def _noise_that_agrees(now: GreyImage, before: GreyImage) -> tuple[float, float]:
    """Return the correlation of two changes of what is finest where it is calm, and its power."""
    squares = _in_blocks(now**2 + before**2) / 2
    calm = squares <= np.quantile(squares, CALM)
    power = float(squares[calm].mean())
    share = float(_in_blocks(now * before)[calm].mean()) / power if power else 0.0
    return share, power


def _in_blocks(image: GreyImage) -> npt.NDArray[np.float32]:
    """Return the mean in each block."""
    height, width = image.shape
    return cv2.resize(image, (width // BLOCK, height // BLOCK), interpolation=cv2.INTER_AREA)


def _least_of_most(blocks: npt.NDArray[np.floating]) -> float:
    """Return what is exceeded in as many blocks as have to go on changing."""
    return float(np.quantile(blocks, 1 - IN_BLOCKS))
