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

SIDE = 8
"""Of a patch, pixels."""

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
    room = np.empty((3, SIDE * SIDE), np.float32)
    _fit_patches(picture, around.reshape(-1), wanted, coarser, *room, motion, is_asked)
    found, weights = np.zeros((height, width, 2), np.float32), np.zeros((height, width), np.float32)
    _spread(picture, around.reshape(-1), motion, is_asked, weights, found)
    return found


@njit(**INLINED)
def _compare(before, at, pitch, across, down, patch, slopes_x, slopes_y):
    """Return the sums of a patch's differences to another picture.

    The difference, its square, and its products with the slopes along x and y.

    Parameters
    ----------
    before : (n,) float32
        The other picture.
    at, pitch : int
        Of the patch's first pixel there; from row to row.
    across, down : float32
        How far it lies beyond that, 0..1.
    patch, slopes_x, slopes_y : (SIDE²,) float32
    """
    one = np.float32(1.0)
    here, right = (one - across) * (one - down), across * (one - down)
    below, beyond = (one - across) * down, across * down
    total = square = along_x = along_y = np.float32(0.0)
    for row in range(SIDE):
        upper = before[at + row * pitch : at + row * pitch + SIDE + 1]
        lower = before[at + (row + 1) * pitch : at + (row + 1) * pitch + SIDE + 1]
        for k in range(SIDE):
            away = here * upper[k] + right * upper[k + 1] + below * lower[k] + beyond * lower[k + 1]
            away -= patch[row * SIDE + k]
            total += away
            square += away * away
            along_x += away * slopes_x[row * SIDE + k]
            along_y += away * slopes_y[row * SIDE + k]
    return total, square, along_x, along_y


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
def _is_wanted(wanted, top, left):
    """Return whether a pixel of a patch is asked for."""
    found = np.uint8(0)
    for row in range(top, top + SIDE):
        for column in range(left, left + SIDE):
            found |= wanted[row, column]
    return found != 0


@njit(**LEAN)
def _fit_patches(now, before, wanted, coarser, patch, of_x, of_y, motion, is_asked):
    """Write where the patches asked for are found, and which they are."""
    height, width = now.shape
    pitch = width + 2 * MARGIN
    share = np.float32(1.0 / SIDE**2)
    two, settled = np.float32(2.0), np.float32(SETTLED**2)
    for row in range(is_asked.shape[0]):
        top = min(row * SPACING, height - SIDE)
        for column in range(is_asked.shape[1]):
            left = min(column * SPACING, width - SIDE)
            if not _is_wanted(wanted, top, left):
                continue
            is_asked[row, column] = True
            _take_patch(now, top, left, patch, of_x, of_y)
            sum_x = sum_y = xx = xy = yy = np.float32(0.0)
            for k in range(SIDE * SIDE):
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
                found = _compare(
                    before, at, pitch, np.float32(try_u - whole_u), np.float32(try_v - whole_v),
                    patch, of_x, of_y,
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
def _spread(now, before, motion, is_asked, weights, found):
    """Write the mean motion of the patches over each pixel, by how well they match in it."""
    height, width = now.shape
    pitch = width + 2 * MARGIN
    one = np.float32(1.0)
    for row in range(is_asked.shape[0]):
        top = min(row * SPACING, height - SIDE)
        for column in range(is_asked.shape[1]):
            if not is_asked[row, column]:
                continue
            left = min(column * SPACING, width - SIDE)
            u, v = motion[row, column, 0], motion[row, column, 1]
            whole_u, whole_v = np.int64(np.floor(u)), np.int64(np.floor(v))
            across, down = np.float32(u - whole_u), np.float32(v - whole_v)
            here, right = (one - across) * (one - down), across * (one - down)
            below, beyond = (one - across) * down, across * down
            at = (top + MARGIN + whole_v) * pitch + left + MARGIN + whole_u
            for y in range(SIDE):
                upper = before[at + y * pitch : at + y * pitch + SIDE + 1]
                lower = before[at + (y + 1) * pitch : at + (y + 1) * pitch + SIDE + 1]
                own = now[top + y, left:]
                weight, out = weights[top + y, left:], found[top + y, left:]
                for x in range(SIDE):
                    away = here * upper[x] + right * upper[x + 1]
                    away += below * lower[x] + beyond * lower[x + 1] - own[x]
                    share = one / (one + away * away)
                    weight[x] += share
                    out[x, 0] += share * u
                    out[x, 1] += share * v
    for row in range(height):
        for column in range(width):
            if weights[row, column] > 0:
                found[row, column, 0] /= weights[row, column]
                found[row, column, 1] /= weights[row, column]
