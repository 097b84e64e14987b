"""Where a frame's reconstruction starts: the previous frame's result, moved block by block.

Thesis, "Extension to Temporal SR". Motion is by whole LR pixels and is searched only where
a block has changed; a block that nothing in the previous frame explains starts cold.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT, OPTIONS
from pipeline.frames import GreyImage, Mask
from pipeline.grid import Grid
from pipeline.results import StartChoice

BLOCK = 8
"""Side of a block, LR pixels."""

REACH = 7
"""Farthest motion that is searched, LR pixels along each axis."""

TOLERATED = 3.0
"""Grey levels by which a matched pixel may differ beside the noise."""

PART = 4
"""Side of the parts of a block whose sums say at a glance that it does not match."""

SLACK = 1.001
"""Of the bound, against their rounding."""

CUT = 0.35
"""Share of matched blocks below which the whole frame starts cold: a cut, or a flash."""


GLANCE = 4
"""One row of blocks in so many is matched first; where not half of ``CUT`` of them are, no other
is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BlockMatch:
    """Where the blocks of a picture are found in the previous one."""

    motion: npt.NDArray[np.int32]
    """(R, C, 2): (x, y) by which a block's pixels are found there, LR pixels."""
    matched: npt.NDArray[np.bool_]
    """(R, C): whether that may be believed."""

    @property
    def is_cut(self) -> bool:
        """Whether so few blocks match that the whole frame starts cold: a cut, or a flash."""
        return bool(self.matched.mean() < CUT)

    @property
    def choice(self) -> StartChoice:
        """What the report says."""
        share = 0.0 if self.is_cut else float(self.matched.mean())
        return StartChoice(warm_share=share, is_cut=self.is_cut)

    def matched_pixels(self, shape: tuple[int, int]) -> Mask:
        """Return whether the block of each LR pixel is matched, (H, W)."""
        return _spread(self.matched, shape)

    def share_in_place(self, changed: Mask) -> float:
        """Return the share of the pixels that have changed in blocks that match unmoved."""
        unmoved = self.matched & (self.motion == 0).all(axis=2)
        return float((changed & _spread(unmoved, changed.shape)).mean())


@njit(**EXACT)
def _glance(sums, sums_before, y0, x0, y1, x1, first, last, v, least):  # type: ignore[no-untyped-def]
    """Write what the sums of a block's parts say of its motions from (first, v) to (last, v).

    ``PART``² times as much as it differs by at least: the mean of the squares is no smaller than
    the square of the mean.
    """
    for k in range(last - first + 1):
        least[k] = np.float32(0.0)
    for y in range(y0, y1 - PART + 1, PART):
        for x in range(x0, x1 - PART + 1, PART):
            # within the picture, and unsigned numbers need no check that they are
            here = sums[np.uint64(y), np.uint64(x)]
            for k in range(last - first + 1):
                away = here - sums_before[np.uint64(y + v), np.uint64(x + first + k)]
                least[np.uint64(k)] += away * away


@njit(**EXACT)
def _matches(now, before, y0, x0, y1, x1, u, v, bound):  # type: ignore[no-untyped-def]
    """Return whether the squared differences of a block come to no more than they may."""
    total = 0.0
    for y in range(y0, y1):
        for x in range(x0, x1):
            here = now[np.uint64(y), np.uint64(x)]
            away = here - before[np.uint64(y + v), np.uint64(x + u)]
            total += away * away
        if total > bound:
            return False
    return True


@njit(**EXACT)
def _match(  # type: ignore[no-untyped-def]
    now, before, sums, sums_before, reach, block, limit, first, most, least, motion, matched
):
    """Fill the motion (x, y) of blocks and whether it holds; the first motion that does wins.

    Those of every ``GLANCE``-th row, from the ``first``; where more than ``most`` of them do not
    match, the others are left out. ``least``, as long as there are motions along x, is scratch.
    """
    height, width = now.shape
    unmatched = 0
    for row in range(first, matched.shape[0], GLANCE):
        for column in range(matched.shape[1]):
            y0, x0 = row * block, column * block
            y1, x1 = min(y0 + block, height), min(x0 + block, width)
            bound = limit * (y1 - y0) * (x1 - x0)
            left, right = max(-reach, -x0), min(reach, width - x1)
            # the block that stood still is tried first
            found = _matches(now, before, y0, x0, y1, x1, 0, 0, bound)
            v, u = 0, 0
            for dy in range(max(-reach, -y0), min(reach, height - y1) + 1):
                if found:
                    break
                _glance(sums, sums_before, y0, x0, y1, x1, left, right, dy, least)
                for dx in range(left, right + 1):
                    may_match = least[np.uint64(dx - left)] <= PART * PART * bound * SLACK
                    if may_match and _matches(now, before, y0, x0, y1, x1, dx, dy, bound):
                        found, v, u = True, dy, dx
                        break
            if found:
                motion[row, column, 0], motion[row, column, 1] = u, v
                matched[row, column] = True
                continue
            unmatched += 1
            if unmatched > most:
                return


@njit(**OPTIONS)
def _agree(now, before, motion, matched, most, agreeing):  # type: ignore[no-untyped-def]
    """Write which matched blocks agree everywhere: no mean of 3 × 3 squares is above ``most``.

    Blocks that are not matched spoil no neighbour; beyond a side lies what is at it.
    """
    height, width = now.shape
    squares = np.zeros((height + 2, width + 2), np.float32)
    for row in range(matched.shape[0]):
        y0, y1 = row * BLOCK, min((row + 1) * BLOCK, height)
        for column in range(matched.shape[1]):
            if not matched[row, column]:
                continue
            x0, x1 = column * BLOCK, min((column + 1) * BLOCK, width)
            u, v = motion[row, column, 0], motion[row, column, 1]
            for y in range(y0, y1):
                # within the picture, and unsigned numbers need no check that they are
                own, other, out = np.uint64(y), np.uint64(y + v), np.uint64(y + 1)
                for x in range(x0, x1):
                    away = now[own, np.uint64(x)] - before[other, np.uint64(x + u)]
                    squares[out, np.uint64(x + 1)] = away * away
    for y in range(1, height + 1):
        squares[y, 0], squares[y, width + 1] = squares[y, 1], squares[y, width]
    for x in range(width + 2):
        squares[0, x], squares[height + 1, x] = squares[1, x], squares[height, x]
    for row in range(matched.shape[0]):
        y0, y1 = row * BLOCK, min((row + 1) * BLOCK, height)
        for column in range(matched.shape[1]):
            agreeing[row, column] = matched[row, column]
            if not matched[row, column]:
                continue
            x0, x1 = column * BLOCK, min((column + 1) * BLOCK, width)
            largest = np.float32(0.0)
            for y in range(y0, y1):
                above, own, below = np.uint64(y), np.uint64(y + 1), np.uint64(y + 2)
                for k in range(x0, x1):
                    a, b, c = np.uint64(k), np.uint64(k + 1), np.uint64(k + 2)
                    total = squares[above, a] + squares[above, b] + squares[above, c]
                    total += squares[own, a] + squares[own, b] + squares[own, c]
                    total += squares[below, a] + squares[below, b] + squares[below, c]
                    largest = max(largest, total)
            agreeing[row, column] = largest <= np.float32(9 * most)


def match_blocks(now: GreyImage, before: GreyImage, noise: float) -> BlockMatch:
    """Return each block's motion to the previous picture, and whether the match may be believed.

    A block in which only a part disagrees, a small thing that moves, is not matched.

    Parameters
    ----------
    now, before : (H, W) float32
        LR pictures of one view; pictures of unequal sizes match nowhere.
    noise : float
        Standard deviation, grey levels.
    """
    height, width = now.shape
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    motion = np.zeros((rows, columns, 2), np.int32)
    matched = np.zeros((rows, columns), np.bool_)
    if before.shape != now.shape:
        return BlockMatch(motion=motion, matched=matched)
    limit = 1.5 * 2 * noise**2 + TOLERATED**2
    middle = min(GLANCE // 2, rows - 1)
    sums, sums_before = (_part_sums(image) for image in (now, before))
    least = np.empty(2 * REACH + 1, np.float32)

    def match(first: int, most: int) -> None:
        _match(
            now, before, sums, sums_before, REACH, BLOCK, limit, first, most, least, motion, matched
        )

    def are_few(some: npt.NDArray[np.bool_]) -> bool:
        return bool(some[middle::GLANCE].mean() < CUT / 2)

    match(middle, int((1 - CUT / 2) * matched[middle::GLANCE].size))
    if are_few(matched) or are_few(_agreeing(now, before, motion, matched, noise)):
        return BlockMatch(motion=motion, matched=np.zeros_like(matched))
    for first in range(GLANCE):
        if first != middle:
            match(first, matched.size)
    return BlockMatch(
        motion=motion, matched=_agreeing(now, before, motion, matched, noise)
    )  # fmt: skip


def _agreeing(
    now: GreyImage,
    before: GreyImage,
    motion: npt.NDArray[np.int32],
    matched: npt.NDArray[np.bool_],
    noise: float,
) -> npt.NDArray[np.bool_]:
    """Return which of the matched blocks agree everywhere, not in the mean alone."""
    agreeing = np.empty_like(matched)
    _agree(now, before, motion, matched, 2.5 * 2 * noise**2 + 2 * TOLERATED**2, agreeing)
    return agreeing


def _part_sums(image: GreyImage) -> GreyImage:
    """Return the sum over the part that has its upper left corner at each pixel."""
    return cv2.boxFilter(image, cv2.CV_32F, (PART, PART), anchor=(0, 0), normalize=False)


def _spread(values: npt.NDArray, shape: tuple[int, int]) -> npt.NDArray:
    """Return the value of each LR pixel's block, (H, W)."""
    return np.repeat(np.repeat(values, BLOCK, axis=0), BLOCK, axis=1)[: shape[0], : shape[1]]


def warped(
    match: BlockMatch,
    previous: npt.NDArray[np.float32],
    cold: npt.NDArray[np.float32],
    grid: Grid,
) -> npt.NDArray[np.float32]:
    """Return the estimate that a reconstruction starts from.

    Parameters
    ----------
    match : BlockMatch
        Of the reference view, to the previous frame.
    previous, cold : (K·H, K·W) float32
        The previous frame's result, which matched blocks take moved, and the cold start, which
        the others take.
    """
    start = previous.copy()
    _warp(
        match.motion, match.matched, previous, cold, grid.magnification_x, grid.magnification_y,
        start,
    )  # fmt: skip
    return start


@njit(nogil=True, cache=True, error_model="numpy")
def _warp(motion, matched, previous, cold, across, down, out):  # type: ignore[no-untyped-def]
    """Write the blocks that are not what the previous picture has there: moved from it, or cold."""
    height, width = out.shape
    for row in range(matched.shape[0]):
        y0, y1 = row * BLOCK * down, min((row + 1) * BLOCK * down, height)
        for column in range(matched.shape[1]):
            x0, x1 = column * BLOCK * across, min((column + 1) * BLOCK * across, width)
            if not matched[row, column]:
                out[y0:y1, x0:x1] = cold[y0:y1, x0:x1]
                continue
            u, v = motion[row, column, 0] * across, motion[row, column, 1] * down
            if u == 0 and v == 0:
                continue
            for y in range(y0, y1):
                at = min(max(y + v, 0), height - 1)
                for x in range(x0, x1):
                    out[y, x] = previous[at, min(max(x + u, 0), width - 1)]
