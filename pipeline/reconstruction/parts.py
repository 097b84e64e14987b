"""Reconstructing parts of a reference view: boxes of it, each as if it were an image of its own.

What stands still need not be solved again. A box is solved with a halo around it, from
estimates that the halo's surroundings have too, so that its middle joins them without a seam.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.frames import GreyImage, Mask, Positions, RegisteredView
from pipeline.grid import Grid

TILE = 8
"""Side of the tiles of which boxes are made, LR pixels."""

HALO = 4
"""Pixels around a box that are solved and thrown away, LR pixels."""

BOX_COST = 1500
"""What a box costs beside its pixels, LR pixels."""

Flags = npt.NDArray[np.uint8]

Box = tuple[slice, slice]
"""Rows and columns of an image, LR pixels."""


def covering_boxes(wanted: Mask) -> list[Box]:
    """Return disjoint boxes that hold all pixels wanted, chosen to be cheap with their halos.

    A box is cut in two along the row or column of tiles that saves most, as long as one does.
    """
    height, width = wanted.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    tiles = np.zeros((rows, columns), bool)
    _find_tiles(wanted, TILE, tiles)
    found = np.empty((rows * columns + 1, 4), np.int64)
    count = _cover(tiles, TILE, 2 * HALO, BOX_COST, found)
    return [
        (
            slice(top * TILE, min(bottom * TILE, height)),
            slice(left * TILE, min(right * TILE, width)),
        )
        for top, bottom, left, right in found[:count].tolist()
    ]


@njit(nogil=True, cache=True, error_model="numpy")
def _find_tiles(wanted, side, tiles):
    """Mark the tiles in which a pixel is wanted."""
    for row in range(wanted.shape[0]):
        for column in range(wanted.shape[1]):
            if wanted[row, column]:
                tiles[row // side, column // side] = True


@njit(nogil=True, cache=True, error_model="numpy")
def _set_box(box, top, bottom, left, right):
    box[0], box[1], box[2], box[3] = top, bottom, left, right


@njit(nogil=True, cache=True, error_model="numpy")
def _copy_box(source, target):
    _set_box(target, source[0], source[1], source[2], source[3])


@njit(nogil=True, cache=True, error_model="numpy")
def _shrink(tiles, box):
    """Take rows and columns without a wanted tile off the sides of a box, in place; False: all."""
    top, bottom, left, right = box[1], box[0], box[3], box[2]
    for row in range(box[0], box[1]):
        for column in range(box[2], box[3]):
            if tiles[row, column]:
                top, bottom = min(top, row), row + 1
                left, right = min(left, column), max(right, column + 1)
    _set_box(box, top, bottom, left, right)
    return bottom > top


@njit(nogil=True, cache=True, error_model="numpy")
def _cover(tiles, tile, margin, extra, found):
    """Write boxes of tiles (rows, columns, each half-open), and return how many there are."""
    _set_box(found[0], np.int64(0), tiles.shape[0], np.int64(0), tiles.shape[1])
    if not _shrink(tiles, found[0]):
        return 0
    count, done = 1, 0
    halves = np.empty((2, 4), np.int64)
    best = np.empty((2, 4), np.int64)
    while done < count:
        whole = found[done]
        least = ((whole[1] - whole[0]) * tile + margin) * ((whole[3] - whole[2]) * tile + margin)
        least += extra
        cut = False
        for axis in range(2):
            for at in range(whole[2 * axis] + 1, whole[2 * axis + 1]):
                cost = 0
                for side in range(2):
                    half = halves[side]
                    _copy_box(whole, half)
                    half[2 * axis + 1 - side] = at
                    _shrink(tiles, half)
                    cost += ((half[1] - half[0]) * tile + margin) * (
                        (half[3] - half[2]) * tile + margin
                    ) + extra
                if cost < least:
                    least = cost
                    _copy_box(halves[0], best[0])
                    _copy_box(halves[1], best[1])
                    cut = True
        if cut:
            _copy_box(best[0], found[done])
            _copy_box(best[1], found[count])
            count += 1
        else:
            done += 1
    return count


def widened(box: Box, shape: tuple[int, ...], halo: int = HALO) -> Box:
    """Return the box with its halo, as far as the image goes."""
    rows, columns = (
        slice(max(side.start - halo, 0), min(side.stop + halo, size))
        for side, size in zip(box, shape, strict=True)
    )
    return rows, columns


def within(box: Box, outer: Box) -> Box:
    """Return where a box lies in one around it."""
    rows, columns = (
        slice(side.start - around.start, side.stop - around.start)
        for side, around in zip(box, outer, strict=True)
    )
    return rows, columns


def on_hr_grid(box: Box, grid: Grid) -> Box:
    """Return the HR pixels of a box of LR pixels."""
    rows, columns = box
    down, across = grid.magnification_y, grid.magnification_x
    return (
        slice(rows.start * down, rows.stop * down),
        slice(columns.start * across, columns.stop * across),
    )


def put_pixels(image: GreyImage, part: GreyImage, wanted: Mask, box: Box, grid: Grid) -> None:
    """Write the HR pixels of a box whose LR pixels are wanted, in place.

    Parameters
    ----------
    part : (K·h, K·w) float32
        Of the box.
    wanted : (h, w) bool
        Likewise.
    """
    top, left = box[0].start * grid.magnification_y, box[1].start * grid.magnification_x
    # contiguous, for one compilation
    _put_pixels(
        np.ascontiguousarray(part), np.ascontiguousarray(wanted), grid.magnification_y,
        grid.magnification_x, top, left, image,
    )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy")
def _put_pixels(part, wanted, down, across, top, left, image):
    for row in range(part.shape[0]):
        is_wanted, source = wanted[row // down], part[row]
        target = image[top + row]
        for column in range(wanted.shape[1]):
            if is_wanted[column]:
                for fine in range(column * across, (column + 1) * across):
                    target[left + fine] = source[fine]


@dataclass(frozen=True, kw_only=True, eq=False)
class CutViews:
    """Views cut down to what lands in a box of the reference."""

    views: tuple[RegisteredView, ...]
    """Their positions are still those in the whole reference."""
    points: tuple[tuple[GreyImage, GreyImage], ...]
    """x and y of their landing points on the HR grid of the box, HR pixels."""
    places: tuple[Box, ...]
    """Rows and columns of each that were taken."""


def landing_in(registered: Sequence[RegisteredView], boxes: Sequence[Box]) -> list[list[Box]]:
    """Return, for each box, the rows and columns of each view that hold what lands in it."""
    bounds = np.array(
        [(rows.start, rows.stop, columns.start, columns.stop) for rows, columns in boxes], np.int64
    ).reshape(-1, 4)
    places: list[list[Box]] = [[] for _ in boxes]
    for view in registered:
        if view.is_reference:
            for of_box, box in zip(places, boxes, strict=True):
                of_box.append(box)
            continue
        found = np.empty((len(boxes), 4), np.int64)
        _landing_in(view.position, bounds, found)
        for of_box, (top, bottom, left, right) in zip(places, found.tolist(), strict=True):
            of_box.append((slice(top, bottom), slice(left, right)))
    return places


def cut_views(
    known: Sequence[tuple[RegisteredView, GreyImage, Box]], box: Box, grid: Grid
) -> CutViews:
    """Return views cut down to what lands in a box, landing points counted from its corner.

    Parameters
    ----------
    known : sequence of (view, offset, place)
        With what is taken off the pixels observed, (H, W) grey levels or nothing, and
        with the rows and columns that :func:`landing_in` found.
    """
    cuts = [_cut(view, offset, place, box, grid) for view, offset, place in known]
    return CutViews(
        views=tuple(view for view, _ in cuts),
        points=tuple(points for _, points in cuts),
        places=tuple(place for _, _, place in known),
    )


def _cut(
    view: RegisteredView, offset: GreyImage, place: Box, box: Box, grid: Grid
) -> tuple[RegisteredView, tuple[GreyImage, GreyImage]]:
    x, y, observed = (np.empty(view.flags[place].shape, np.float32) for _ in range(3))
    # writable pixels, for one compilation
    pixels = np.require(view.observed, requirements="W")
    _cut_out(
        view.position, pixels, offset, place[0].start, place[1].start,
        np.float32(box[1].start), np.float32(grid.magnification_x), np.float32(grid.offset_x),
        np.float32(box[0].start), np.float32(grid.magnification_y), np.float32(grid.offset_y),
        x, y, observed,
    )  # fmt: skip
    part = replace(
        view,
        observed=observed,
        position=view.position[place],
        registration_weights=view.registration_weights[place],
        flags=view.flags[place],
        confidence=view.confidence[place],
    )
    return part, (x, y)


@njit(nogil=True, cache=True, error_model="numpy")
def _cut_out(
    positions, pixels, offsets, top, left, before, magnification_x, offset_x, above,
    magnification_y, offset_y, x, y, observed,
):  # fmt: skip
    """Write a part of a view, and where on the HR grid of a box it lands."""
    for row in range(observed.shape[0]):
        points, grey = positions[top + row, left:], pixels[top + row, left:]
        for column in range(observed.shape[1]):
            x[row, column] = (points[column, 0] - before) * magnification_x + offset_x
            y[row, column] = (points[column, 1] - above) * magnification_y + offset_y
            observed[row, column] = grey[column]
        if offsets.size > 0:
            less = offsets[top + row, left:]
            for column in range(observed.shape[1]):
                observed[row, column] -= less[column]


@njit(nogil=True, cache=True, error_model="numpy")
def _landing_in(position, boxes, found):
    """Write the rows and columns, half-open, of the pixels that land in boxes; one, if none.

    Every third row and column is looked at, and the box found widened by as much.
    """
    rows, columns = position.shape[:2]
    half = np.float32(0.5)
    zero, one = np.int64(0), np.int64(1)
    top = left = np.float32(np.inf)
    bottom = right = np.float32(-np.inf)
    for k in range(boxes.shape[0]):
        _set_box(found[k], rows, -one, columns, -one)
        top, bottom = min(top, boxes[k, 0] - half), max(bottom, boxes[k, 1] - half)
        left, right = min(left, boxes[k, 2] - half), max(right, boxes[k, 3] - half)
    for row in range(0, rows, 3):
        for column in range(0, columns, 3):
            x, y = position[row, column, 0], position[row, column, 1]
            if not (y > top and y < bottom and x > left and x < right):
                continue
            for k in range(boxes.shape[0]):
                if (
                    y > boxes[k, 0] - half and y < boxes[k, 1] - half
                    and x > boxes[k, 2] - half and x < boxes[k, 3] - half
                ):  # fmt: skip
                    found[k, 0] = min(found[k, 0], row)
                    found[k, 1] = row
                    found[k, 2] = min(found[k, 2], column)
                    found[k, 3] = max(found[k, 3], column)
    for k in range(boxes.shape[0]):
        if found[k, 1] < 0:
            _set_box(found[k], zero, one, zero, one)
        else:
            found[k, 0] = max(found[k, 0] - 2, 0)
            found[k, 1] = min(found[k, 1] + 3, rows)
            found[k, 2] = max(found[k, 2] - 2, 0)
            found[k, 3] = min(found[k, 3] + 3, columns)


@njit(nogil=True, cache=True, error_model="numpy")
def _put_back(weights, flags, all_weights, all_flags, position, top, left, bounds):
    """Write what was found of the pixels that land in a box."""
    half = np.float32(0.5)
    for row in range(weights.shape[0]):
        for column in range(weights.shape[1]):
            x, y = position[top + row, left + column, 0], position[top + row, left + column, 1]
            if (
                y > bounds[0] - half and y < bounds[1] - half
                and x > bounds[2] - half and x < bounds[3] - half
            ):  # fmt: skip
                all_weights[top + row, left + column] = weights[row, column]
                all_flags[top + row, left + column] = flags[row, column]


def put_back(
    part: tuple[GreyImage, Flags], whole: tuple[GreyImage, Flags], place: Box,
    position: Positions, box: Box,
) -> None:  # fmt: skip
    """Write the weights and flags found of a view's pixels that land in a box, in place."""
    rows, columns = box
    bounds = (rows.start, rows.stop, columns.start, columns.stop)
    _put_back(*part, *whole, position, place[0].start, place[1].start, bounds)
