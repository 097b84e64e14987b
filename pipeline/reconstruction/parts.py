"""Reconstructing parts of a reference view: boxes of it, each as if it were an image of its own.

What stands still need not be solved again. A box is solved with a halo around it, from
estimates that the halo's surroundings have too, so that its middle joins them without a seam.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT
from pipeline.frames import GreyImage, Mask, Positions, RegisteredView
from pipeline.grid import Grid
from pipeline.reconstruction.tables import bytes_at, floats_at, points_at, table_of

TILE = 4
"""Side of the tiles of which boxes are made, LR pixels."""

HALO = 3
"""Pixels around a box that are solved and thrown away, LR pixels."""

BOX_COST = 1500
"""What a box costs beside its pixels, LR pixels."""

BITS = 64
"""Boxes that are told apart at once, by the bits of a number."""

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
    height, width = wanted.shape
    columns = np.empty(width, np.bool_)
    for tile in range(tiles.shape[0]):
        columns[:] = False
        for row in range(tile * side, min((tile + 1) * side, height)):
            line = wanted[row]
            # without a branch, many at once
            for column in range(width):
                columns[column] |= line[column]
        for column in range(width):
            if columns[column]:
                tiles[tile, column // side] = True


@njit(**EXACT)
def _set_box(box, top, bottom, left, right):
    box[0], box[1], box[2], box[3] = top, bottom, left, right


@njit(**EXACT)
def _extents(tiles, box, axis, extents):
    """Write where each row (axis 0) or column of a box has its first wanted tile and its last.

    They are half-open, and counted in the whole image.
    """
    nothing = np.int64(0)
    for line in range(box[2 * axis], box[2 * axis + 1]):
        extents[line, 0], extents[line, 1] = max(tiles.shape[0], tiles.shape[1]), nothing
    for row in range(box[0], box[1]):
        for column in range(box[2], box[3]):
            if tiles[row, column]:
                line, at = (column, row) if axis else (row, column)
                extents[line, 0] = min(extents[line, 0], at)
                extents[line, 1] = max(extents[line, 1], at + 1)


@njit(**EXACT)
def _grow(extents, line, axis, box):
    """Let a box hold a row or column of wanted tiles, too, in place."""
    if extents[line, 1] > 0:
        across = 2 * (1 - axis)
        box[2 * axis] = min(box[2 * axis], line)
        box[2 * axis + 1] = max(box[2 * axis + 1], line + 1)
        box[across] = min(box[across], extents[line, 0])
        box[across + 1] = max(box[across + 1], extents[line, 1])


@njit(nogil=True, cache=True, error_model="numpy")
def _cover(tiles, tile, margin, extra, found):
    """Write boxes of tiles (rows, columns, each half-open), and return how many there are."""
    rows, columns = tiles.shape
    far, nothing = max(rows, columns), np.int64(0)
    extents = np.empty((2, far, 2), np.int64)
    # of the lines before each one, and of it and those behind it
    halves = np.empty((2, far + 1, 4), np.int64)
    whole = np.empty(4, np.int64)
    _set_box(whole, nothing, rows, nothing, columns)
    _extents(tiles, whole, 0, extents[0])
    first = found[0]
    _set_box(first, far, nothing, far, nothing)
    for row in range(rows):
        _grow(extents[0], row, 0, first)
    if first[1] == 0:
        return 0
    count, done = 1, 0
    while done < count:
        whole[:] = found[done]
        least = ((whole[1] - whole[0]) * tile + margin) * ((whole[3] - whole[2]) * tile + margin)
        least += extra
        cut = False
        for axis in range(2):
            start, end = whole[2 * axis], whole[2 * axis + 1]
            _extents(tiles, whole, axis, extents[axis])
            before, behind = halves[0], halves[1]
            _set_box(before[start], far, nothing, far, nothing)
            _set_box(behind[end], far, nothing, far, nothing)
            for line in range(start, end):
                before[line + 1] = before[line]
                _grow(extents[axis], line, axis, before[line + 1])
            for line in range(end - 1, start - 1, -1):
                behind[line] = behind[line + 1]
                _grow(extents[axis], line, axis, behind[line])
            for at in range(start + 1, end):
                cost = 0
                for side in range(2):
                    half = halves[side, at]
                    cost += ((half[1] - half[0]) * tile + margin) * (
                        (half[3] - half[2]) * tile + margin
                    ) + extra
                if cost < least:
                    least = cost
                    found[done], found[count] = before[at], behind[at]
                    cut = True
        if cut:
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


def put_pixels(
    image: GreyImage, part: GreyImage, wanted: Mask, box: Box, grid: Grid,
    inner: Box | None = None, *, is_clipped: bool = False,
) -> None:  # fmt: skip
    """Write the HR pixels of a box whose LR pixels are wanted, in place.

    Parameters
    ----------
    part : (K·h, K·w) float32
        Of the box, or of more around it.
    wanted : (H, W) bool
        Of the whole reference.
    inner : Box, optional
        Where the box lies in the part, LR pixels.
    is_clipped : bool
        Whether to 0..255.
    """
    rows, columns = box
    before = (0, 0) if inner is None else (inner[0].start, inner[1].start)
    # contiguous, for one compilation
    _put_pixels(
        np.ascontiguousarray(part), wanted, rows.start, rows.stop, columns.start, columns.stop,
        *before, grid.magnification_y, grid.magnification_x, is_clipped, image,
    )  # fmt: skip


@njit(**EXACT)
def _put_pixels(
    part, wanted, top, bottom, left, right, above, before, down, across, is_clipped, image
):  # fmt: skip
    black, white = np.float32(0.0), np.float32(255.0)
    for row in range(top, bottom):
        end = left
        while end < right:
            start = end
            while start < right and not wanted[row, start]:
                start += 1
            end = start
            while end < right and wanted[row, end]:
                end += 1
            # a run of them at once
            for fine in range(down):
                source = part[(row - top + above) * down + fine, (start - left + before) * across :]
                target = image[row * down + fine, start * across : end * across]
                if is_clipped:
                    for column in range(target.size):
                        target[column] = min(max(source[column], black), white)
                else:
                    for column in range(target.size):
                        target[column] = source[column]


class Uncut:
    """Views registered onto a reference, to be cut down to what lands in boxes of it.

    Parameters
    ----------
    registered : sequence of RegisteredView
        The reference among them.
    offsets : sequence of (H, W) float32, optional
        What is taken off the pixels observed of each, grey levels; default: nothing.
    """

    def __init__(
        self, registered: Sequence[RegisteredView], offsets: Sequence[GreyImage] | None = None
    ) -> None:
        self.registered = registered
        self.is_offset = offsets is not None
        rows = [
            (view.position, view.observed, view.flags, *more)
            for view, *more in zip(registered, *([] if offsets is None else [offsets]), strict=True)
        ]
        # held, since the table only says where they lie
        self._held = [[np.ascontiguousarray(image) for image in row] for row in rows]
        self.table = table_of(self._held)


_POSITION, _PIXELS, _FLAGS, _OFFSET = range(4)
"""Of the images of a row of that table."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CutView:
    """A view cut down to what lands in a box of the reference."""

    view_id: str
    is_reference: bool
    place: Box
    """Rows and columns that were taken."""
    x: GreyImage
    """Landing points on the HR grid of the box, HR pixels, (h, w); …"""
    y: GreyImage
    observed: GreyImage
    flags: Flags


def landing_in(uncut: Uncut, boxes: Sequence[Box]) -> npt.NDArray[np.int64]:
    """Return the rows and columns of each view that hold what lands in boxes.

    (boxes, views, 4), half-open: top, bottom, left, right.
    """
    if len(boxes) > BITS:
        first, others = (landing_in(uncut, some) for some in (boxes[:BITS], boxes[BITS:]))
        return np.concatenate([first, others])
    bounds = np.array(
        [(rows.start, rows.stop, columns.start, columns.stop) for rows, columns in boxes], np.int64
    ).reshape(-1, 4)
    views = uncut.registered
    reference = next(index for index, view in enumerate(views) if view.is_reference)
    marks = np.empty(views[reference].flags.shape, np.uint64)
    _mark_boxes(bounds, marks)
    places = np.empty((len(boxes), len(views), 4), np.int64)
    places[:, reference] = bounds
    _landing_in(uncut.table, reference, marks, places)
    return places


def cut_views(
    uncut: Uncut, places: npt.NDArray[np.int64], some: Sequence[int], box: Box, grid: Grid
) -> list[CutView]:
    """Return views cut down to what lands in a box, landing points counted from its corner.

    Parameters
    ----------
    places : (views, 4) int64
        Of :func:`landing_in`.
    some : sequence of int
        Those that are cut.
    """
    bounds = places[some].tolist()
    sizes = [(bottom - top) * (right - left) for top, bottom, left, right in bounds]
    starts = list(itertools.accumulate(sizes, initial=0))
    x, y, observed = np.empty((3, starts[-1]), np.float32)
    flags = np.empty(starts[-1], np.uint8)
    _cut_out(
        uncut.table, np.array(some, np.int64), places, uncut.is_offset,
        np.float32(box[1].start), np.float32(grid.magnification_x), np.float32(grid.offset_x),
        np.float32(box[0].start), np.float32(grid.magnification_y), np.float32(grid.offset_y),
        x, y, observed, flags,
    )  # fmt: skip
    found = []
    for index, start, size, (top, bottom, left, right) in zip(
        some, starts, sizes, bounds, strict=False
    ):
        view, part, shape = uncut.registered[index], slice(start, start + size), (bottom - top, -1)
        found.append(
            CutView(
                view_id=view.view_id, is_reference=view.is_reference,
                place=(slice(top, bottom), slice(left, right)),
                x=x[part].reshape(shape), y=y[part].reshape(shape),
                observed=observed[part].reshape(shape), flags=flags[part].reshape(shape),
            )
        )  # fmt: skip
    return found


@njit(**EXACT)
def _cut_out(
    table, some, places, is_offset, before, magnification_x, offset_x, above, magnification_y,
    offset_y, x, y, observed, flags,
):  # fmt: skip
    """Write parts of views, one behind the other, and where on the HR grid of a box they land."""
    at = 0
    for index in some:
        top, bottom, left, right = places[index]
        height, width = bottom - top, right - left
        end = at + height * width
        cut_rows(
            table, index, places, is_offset, before, magnification_x, offset_x, above,
            magnification_y, offset_y, 0, height, x[at:end].reshape(height, width),
            y[at:end].reshape(height, width), observed[at:end].reshape(height, width),
            flags[at:end].reshape(height, width),
        )  # fmt: skip
        at = end


@njit(**EXACT)
def cut_rows(
    table, index, places, is_offset, before, magnification_x, offset_x, above, magnification_y,
    offset_y, lo, hi, x, y, observed, flags,
):  # fmt: skip
    """Write rows of a view's part, and where on the HR grid of a box they land.

    Parameters
    ----------
    table, index : Table, int
        Of :class:`Uncut`; which view.
    places : (views, 4) int64
        Of :func:`landing_in`.
    is_offset : bool
        Whether intensity terms are taken off.
    before, magnification_x, offset_x, above, magnification_y, offset_y : float32
        Column and row of the box's corner, which LR coordinates are counted from, and what they
        are then multiplied by, and what is added.
    lo, hi : int
        Rows of the part, half-open.
    x, y, observed : (h, w) float32
        Overwritten.
    flags : (h, w) uint8
        Overwritten.
    """
    positions, pixels = points_at(table, index, _POSITION), floats_at(table, index, _PIXELS)
    judged = bytes_at(table, index, _FLAGS)
    top, _, left, right = places[index]
    # flat, so that several are worked on at once
    width, flat, pitch = right - left, positions.reshape(-1), 2 * pixels.shape[1]
    for row in range(lo, hi):
        points, grey = flat[(top + row) * pitch + 2 * left :], pixels[top + row, left:right]
        along, down, line, verdicts = x[row], y[row], observed[row], flags[row]
        own = judged[top + row, left:right]
        for column in range(width):
            along[column] = (points[2 * column] - before) * magnification_x + offset_x
            down[column] = (points[2 * column + 1] - above) * magnification_y + offset_y
        for column in range(width):
            verdicts[column] = own[column]
        if is_offset:
            less = floats_at(table, index, _OFFSET)[top + row, left:right]
            for column in range(width):
                line[column] = grey[column] - less[column]
        else:
            for column in range(width):
                line[column] = grey[column]


@njit(**EXACT)
def _mark_boxes(boxes, marks):
    """Set bit k of the pixels that lie in box k, and clear the others, up to 64 boxes."""
    marks[:] = 0
    for k in range(boxes.shape[0]):
        bit = np.uint64(1) << np.uint64(k)
        for row in range(boxes[k, 0], boxes[k, 1]):
            line = marks[row, boxes[k, 2] : boxes[k, 3]]
            for column in range(line.size):
                line[column] |= bit


@njit(**EXACT)
def _landing_in(table, reference, marks, places):
    """Write the rows and columns, half-open, of the pixels that land in boxes; one, if none.

    Every third row and column is looked at, and the box found widened by as much.

    Parameters
    ----------
    table : Table
        Of :class:`Uncut`.
    reference : int
        Of its views, the one that is left out.
    marks : (H, W) uint64
        Of :func:`_mark_boxes`, of the reference.
    places : (boxes, views, 4) int64
    """
    for index in range(table.shape[0]):
        if index != reference:
            _view_landing_in(points_at(table, index, _POSITION), marks, places[:, index])


@njit(**EXACT)
def _view_landing_in(position, marks, found):
    """Write those of one view."""
    rows, columns = position.shape[:2]
    half, nothing = np.float32(0.5), np.uint64(0)
    right, under = np.float32(marks.shape[1] - 0.5), np.float32(marks.shape[0] - 0.5)
    zero, one = np.int64(0), np.int64(1)
    for k in range(found.shape[0]):
        _set_box(found[k], rows, -one, columns, -one)
    for row in range(0, rows, 3):
        before, last = nothing, 0
        for column in range(0, columns, 3):
            x, y = position[row, column, 0], position[row, column, 1]
            here = nothing
            if x > -half and y > -half and x < right and y < under:
                here = marks[np.uint64(y + half), np.uint64(x + half)]
            # most pixels land where those beside them do
            if here != before:
                _hold(found, before, row, last)
                _hold(found, here, row, column)
            before, last = here, column
        _hold(found, before, row, last)
    for k in range(found.shape[0]):
        if found[k, 1] < 0:
            _set_box(found[k], zero, one, zero, one)
        else:
            found[k, 0] = max(found[k, 0] - 2, 0)
            found[k, 1] = min(found[k, 1] + 3, rows)
            found[k, 2] = max(found[k, 2] - 2, 0)
            found[k, 3] = min(found[k, 3] + 3, columns)


@njit(**EXACT)
def _hold(found, marks, row, column):
    """Let the boxes whose bits are set hold a pixel, in place: their first and last lines."""
    k = 0
    while marks != 0:
        if marks & np.uint64(1):
            found[k, 0], found[k, 1] = min(found[k, 0], row), max(found[k, 1], row)
            found[k, 2], found[k, 3] = min(found[k, 2], column), max(found[k, 3], column)
        marks >>= np.uint64(1)
        k += 1


@njit(**EXACT)
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
