"""Where small patches of a picture were in another one, to a fraction of a pixel.

Not in the thesis, whose motion from frame to frame is by whole pixels. Inverse search (T. Kroeger,
R. Timofte, D. Dai, L. Van Gool, Fast Optical Flow using Dense Inverse Search, ECCV 2016), and only
where it is asked for: from coarse pictures to fine ones, each patch begins with what the coarser
picture says or its neighbours have found, and takes Gauss–Newton steps from there; each pixel then
moves as the patches over it do, by how well they match in it. How bright a patch is does not
matter.

The measurements that chose the constants: docs/experiments.md#what-moves-followed.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import INLINED, LEAN
from pipeline.frames import GreyImage, Mask
from pipeline.reconstruction.simd import LANES, add_shares, compare_patch

SIDE = LANES
"""Of a patch, pixels: those of a row are worked on together."""

SPACING = 4
"""From one patch to the next, pixels."""

LEVELS = 4
"""Pictures of half the size of the one before, the first included."""

STEPS = 5
"""Gauss–Newton steps of a patch at each of them, at most."""

SETTLED = 0.02
"""Length of a step after which there is none, pixels."""

MARGIN = 16
"""Pixels beyond the edge that are made up, so that patches may leave the picture."""

RIDGE = (1e-3, 1.0)
"""Of the squared gradients of a patch, and beside, that are added to them: where it shows nothing
it stays where it was."""

Flow = npt.NDArray[np.float32]
"""(H, W, 2): x and y from a pixel to where it was, pixels; zero where it was not asked for."""


def flow_of(now: GreyImage, before: GreyImage, wanted: Mask) -> Flow:
    """Return where pixels of a picture are found in another one.

    Parameters
    ----------
    now, before : (H, W) float32
        Of equal size.
    wanted : (H, W) bool
        Pixels that are asked for.
    """
    found = np.zeros((0, 0, 2), np.float32)
    levels = [(now, before, wanted.view(np.uint8))]
    while len(levels) < LEVELS and min(levels[-1][0].shape) >= 2 * SIDE:
        levels.append(_halved(*levels[-1]))
    if min(now.shape) < SIDE:
        return np.zeros((*now.shape, 2), np.float32)
    for picture, other, asked in reversed(levels):
        found = _flow_at(picture, other, asked, found)
    return found


def _halved(
    now: GreyImage, before: GreyImage, wanted: npt.NDArray[np.uint8]
) -> tuple[GreyImage, GreyImage, npt.NDArray[np.uint8]]:
    """Return two pictures at half their size, and what is asked for of them."""
    height, width = now.shape[0] // 2, now.shape[1] // 2
    now, before = (
        cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA) for image in (now, before)
    )
    reached = cv2.dilate(wanted, np.ones((3, 3), np.uint8))
    return now, before, np.ascontiguousarray(reached[: 2 * height : 2, : 2 * width : 2])


def _flow_at(
    now: GreyImage, before: GreyImage, wanted: npt.NDArray[np.uint8], coarser: Flow
) -> Flow:
    """Return the flow at one size; ``coarser`` is that at half of it, if there is any."""
    height, width = now.shape
    rows, columns = (-(-(size - SIDE) // SPACING) + 1 for size in (height, width))
    around = cv2.copyMakeBorder(before, MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_REPLICATE)
    motion = np.zeros((rows, columns, 2), np.float32)
    is_asked = np.zeros((rows, columns), np.bool_)
    # writable, for one compilation
    picture = np.require(now, np.float32, ("C", "W"))
    patches, of_patch = np.empty(3 * SIDE * SIDE, np.float32), np.empty(4, np.float32)
    _fit_patches(
        picture, around.reshape(-1), wanted, coarser, patches, of_patch,
        np.empty(width, np.uint8), motion, is_asked,
    )  # fmt: skip
    found = np.empty((height, width, 2), np.float32)
    sums = np.zeros((3, SIDE * width), np.float32)
    _spread(picture, around.reshape(-1), motion, is_asked, sums, found)
    return found


@njit(**INLINED)
def _take_patch(now, top, left, patch, slopes_x, slopes_y):
    """Write a patch and its slopes along x and y; beyond the edge lies its outermost pixel."""
    height, width = now.shape
    half = np.float32(0.5)
    for y in range(SIDE):
        row = top + y
        above, below = max(row - 1, 0), min(row + 1, height - 1)
        for x in range(SIDE):
            column, at = left + x, y * SIDE + x
            before, after = max(column - 1, 0), min(column + 1, width - 1)
            patch[at] = now[row, column]
            slopes_x[at] = half * (now[row, after] - now[row, before])
            slopes_y[at] = half * (now[below, column] - now[above, column])


@njit(**INLINED)
def _take_inner_patch(now, top, left, patch, slopes_x, slopes_y):
    """Do the same for a patch that lies a pixel from the edge or farther."""
    half = np.float32(0.5)
    for y in range(SIDE):
        row = top + y
        above, own, below = now[row - 1, left:], now[row, left - 1 :], now[row + 1, left:]
        for x in range(SIDE):
            at = y * SIDE + x
            patch[at] = own[x + 1]
            slopes_x[at] = half * (own[x + 2] - own[x])
            slopes_y[at] = half * (below[x] - above[x])


@njit(**LEAN)
def _join_rows(wanted, top, columns):
    """Write which columns of some rows hold a pixel that is asked for."""
    for x in range(columns.size):
        columns[x] = wanted[top, x]
    for row in range(top + 1, top + SIDE):
        own = wanted[row]
        for x in range(columns.size):
            columns[x] |= own[x]


@njit(**LEAN)
def _fit_patches(now, before, wanted, coarser, patches, found, columns, motion, is_asked):
    """Write where the patches asked for are found, and which they are."""
    height, width = now.shape
    pitch = width + 2 * MARGIN
    share = np.float32(1.0 / SIDE**2)
    size = SIDE * SIDE
    patch, of_x, of_y = patches[:size], patches[size : 2 * size], patches[2 * size :]
    two, settled = np.float32(2.0), np.float32(SETTLED**2)
    for row in range(is_asked.shape[0]):
        top = min(row * SPACING, height - SIDE)
        _join_rows(wanted, top, columns)
        for column in range(is_asked.shape[1]):
            left = min(column * SPACING, width - SIDE)
            found_one = np.uint8(0)
            for x in range(left, left + SIDE):
                found_one |= columns[x]
            if found_one == 0:
                continue
            is_asked[row, column] = True
            if 0 < top < height - SIDE and 0 < left < width - SIDE:
                _take_inner_patch(now, top, left, patch, of_x, of_y)
            else:
                _take_patch(now, top, left, patch, of_x, of_y)
            sum_x = sum_y = xx = xy = yy = np.float32(0.0)
            for k in range(size):
                sum_x += of_x[k]
                sum_y += of_y[k]
                xx += of_x[k] * of_x[k]
                xy += of_x[k] * of_y[k]
                yy += of_y[k] * of_y[k]
            xx, xy, yy = (
                xx - sum_x * sum_x * share, xy - sum_x * sum_y * share,
                yy - sum_y * sum_y * share,
            )  # fmt: skip
            more = np.float32(RIDGE[0]) * (xx + yy) + np.float32(RIDGE[1])
            xx, yy = xx + more, yy + more
            inverse = np.float32(1.0) / (xx * yy - xy * xy)
            least_u, most_u = -left - MARGIN, width - SIDE - left + MARGIN - 2
            least_v, most_v = -top - MARGIN, height - SIDE - top + MARGIN - 2
            best = np.float32(np.inf)
            u = v = total = along_x = along_y = np.float32(0.0)
            # the first look is at what the coarser picture says, two are at the neighbours' motion,
            # the others each a step on from the best one
            step_u = step_v = np.float32(0.0)
            for look in range(3 + STEPS):
                if look == 0:
                    try_u = try_v = np.float32(0.0)
                    if coarser.shape[0] > 0:
                        from_y = min((top + SIDE // 2) // 2, coarser.shape[0] - 1)
                        from_x = min((left + SIDE // 2) // 2, coarser.shape[1] - 1)
                        try_u = two * coarser[from_y, from_x, 0]
                        try_v = two * coarser[from_y, from_x, 1]
                elif look == 1:
                    if column == 0 or not is_asked[row, column - 1]:
                        continue
                    try_u, try_v = motion[row, column - 1, 0], motion[row, column - 1, 1]
                elif look == 2:
                    if row == 0 or not is_asked[row - 1, column]:
                        continue
                    try_u, try_v = motion[row - 1, column, 0], motion[row - 1, column, 1]
                else:
                    less_x = along_x - total * sum_x * share
                    less_y = along_y - total * sum_y * share
                    step_u = (yy * less_x - xy * less_y) * inverse
                    step_v = (xx * less_y - xy * less_x) * inverse
                    try_u, try_v = u - step_u, v - step_v
                try_u = min(max(try_u, np.float32(least_u)), np.float32(most_u))
                try_v = min(max(try_v, np.float32(least_v)), np.float32(most_v))
                whole_u, whole_v = np.int64(np.floor(try_u)), np.int64(np.floor(try_v))
                at = (top + MARGIN + whole_v) * pitch + left + MARGIN + whole_u
                compare_patch(
                    before, at, pitch, np.float32(try_u - whole_u), np.float32(try_v - whole_v),
                    patches, found,
                )  # fmt: skip
                left_over = found[1] - found[0] * found[0] * share
                if left_over < best:
                    best, u, v = left_over, try_u, try_v
                    total, along_x, along_y = found[0], found[2], found[3]
                elif look >= 3:
                    break
                if look >= 3 and step_u * step_u + step_v * step_v < settled:
                    break
            motion[row, column, 0], motion[row, column, 1] = u, v


@njit(**LEAN)
def _spread(now, before, motion, is_asked, sums, found):
    """Write the mean motion of the patches over each pixel, by how well they match in it.

    ``sums``, (3, SIDE · W) float32, zero, hold what the patches of a row give, and what those of
    the row before gave to the same pixels: weights, and these times the motion along x and y.
    """
    height, width = now.shape
    pitch = width + 2 * MARGIN
    pixels, flat = now.reshape(-1), sums.reshape(-1)
    for row in range(is_asked.shape[0]):
        top = min(row * SPACING, height - SIDE)
        for column in range(is_asked.shape[1]):
            if not is_asked[row, column]:
                continue
            left = min(column * SPACING, width - SIDE)
            u, v = motion[row, column, 0], motion[row, column, 1]
            whole_u, whole_v = np.int64(np.floor(u)), np.int64(np.floor(v))
            at = (top + MARGIN + whole_v) * pitch + left + MARGIN + whole_u
            add_shares(
                before, at, pitch, np.float32(u - whole_u), np.float32(v - whole_v), pixels,
                top * width + left, width, u, v, flat, left, sums.shape[1],
            )  # fmt: skip
        # patches to come do not reach above the next row of them
        is_last = row == is_asked.shape[0] - 1
        done = SIDE if is_last else min((row + 1) * SPACING, height - SIDE) - top
        for y in range(done):
            part = slice(y * width, (y + 1) * width)
            _divide(sums[0, part], sums[1, part], sums[2, part], found[top + y].reshape(-1))
        for plane in range(3):
            _move_up(sums[plane], done * width)


@njit(**LEAN)
def _move_up(row, size):
    """Let what lies so far on in a row begin it, and nothing follow."""
    for x in range(row.size - size):
        row[x] = row[x + size]
    for x in range(row.size - size, row.size):
        row[x] = 0


@njit(**LEAN)
def _divide(weights, along, down, out):
    """Write sums of motions over those of their weights, x and y in turn; zero where is none."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for x in range(weights.size):
        # without a branch, many at once
        weight = weights[x]
        weights[x] = one / weight if weight > zero else zero
    for x in range(weights.size):
        out[2 * x] = along[x] * weights[x]
        out[2 * x + 1] = down[x] * weights[x]
