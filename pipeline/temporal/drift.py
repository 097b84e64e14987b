"""A picture that goes on changing all over, little by little: a dissolve, a slow pan, a focus pull.

Not in the thesis. From one frame to the next most of it seems to stand still, but what is kept of
it lags behind. What tells it is that it changes as it did a frame before, in most of its blocks;
what only moves in front of something does so in some, and noise in none.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

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

FEWEST = 64
"""Blocks below which nothing is said: things that move reach into most of so few."""

KEPT = SPAN + 2
"""Pictures that are needed, the newest one among them."""


def detail_of(luma: GreyImage) -> GreyImage:
    """Return what is looked at of a picture, at half its size."""
    height, width = luma.shape
    size = (max(1, width // 2), max(1, height // 2))
    small = cv2.resize(luma, size, interpolation=cv2.INTER_AREA)
    return small - cv2.blur(small, (AROUND, AROUND), borderType=cv2.BORDER_REFLECT)


def goes_on_changing(details: Sequence[GreyImage], noise: float) -> bool:
    """Return whether a picture changes all over as it did a frame before.

    Parameters
    ----------
    details : sequence of (h, w) float32
        :func:`detail_of` of its last frames, in order; the last ``KEPT`` are looked at.
    noise : float
        Standard deviation, LR pixels of one frame, grey levels.
    """
    span = min(SPAN, len(details) - 2)
    if span < 1 or details[-1].shape != details[-2 - span].shape:
        return False
    # of four frames no two share their noise, unless the span is of one; that only hides a change
    agreeing = (details[-1] - details[-1 - span]) * (details[-2] - details[-2 - span])
    height, width = agreeing.shape
    across, down = width // BLOCK, height // BLOCK
    if across * down < FEWEST:
        return False
    blocks = cv2.resize(agreeing, (across, down), interpolation=cv2.INTER_AREA)
    slowest = (SLOWEST[0] + SLOWEST[1] * noise**2) * SPAN**2
    return float(np.quantile(blocks, 1 - IN_BLOCKS)) > slowest
