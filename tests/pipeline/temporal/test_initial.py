"""Blocks are found in the picture before where they are there, and nowhere else."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.temporal.initial import BLOCK, REACH, TOLERATED, match_blocks

NOISE = 2.0
HEIGHT, WIDTH = 44, 70
"""No whole number of blocks."""


def _picture(seed):
    chance = np.random.default_rng(seed)
    rough = chance.normal(120, 90, (HEIGHT, WIDTH)).astype(np.float32)
    return cv2.GaussianBlur(rough, (0, 0), 1.5)


def _least_squares(now, before, row, column):
    """Return the least mean squared difference of a block over all motions."""
    y, x = row * BLOCK, column * BLOCK
    block = now[y : y + BLOCK, x : x + BLOCK]
    height, width = block.shape
    found = np.inf
    for v in range(max(-REACH, -y), min(REACH, HEIGHT - y - height) + 1):
        for u in range(max(-REACH, -x), min(REACH, WIDTH - x - width) + 1):
            other = before[y + v : y + v + height, x + u : x + u + width]
            found = min(found, float(((block - other) ** 2).mean()))
    return found


def test_a_block_is_matched_where_some_motion_explains_it():
    before = _picture(0)
    now = np.roll(before, (2, -3), axis=(0, 1))
    now[:, 40:] = _picture(1)[:, 40:]
    now[:, :40] += np.random.default_rng(2).normal(0, NOISE, (HEIGHT, 40)).astype(np.float32)
    found = match_blocks(now, before, NOISE)
    limit = 3 * NOISE**2 + TOLERATED**2
    for row, column in np.ndindex(found.matched.shape):
        assert not found.matched[row, column] or _least_squares(now, before, row, column) <= limit
    moved = found.matched[1:-1, 1:5]
    assert moved.mean() > 0.8, "but for blocks of which a part disagrees"
    assert np.abs(found.motion[1:-1, 1:5][moved] - [3, -2]).max() <= 1
    assert not found.matched[:, 5:].any()
