"""Many images handed to a compiled loop at once: a table says where they lie.

One call for all views of a small part of a picture in place of one for each: between calls threads
wait for the interpreter's lock. Whoever makes a table holds what it points to while it is used.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import numpy.typing as npt
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

Table = npt.NDArray[np.int64]
"""(N, n + 2): of each of N rows, where n images lie, and their height and width."""


_READ = np.dtype(np.float32), np.dtype(np.uint8)


def table_of(rows: Iterable[Sequence[npt.NDArray]]) -> Table:
    """Return where images lie, those of a row being of one size; of points, too, (H, W, 2).

    Raises
    ------
    ValueError
        Where one does not lie in one piece, row by row, is not as large as those beside it, or is
        of other numbers than those that are read here.
    """
    lines = []
    for images in rows:
        shape = images[0].shape[:2]
        for image in images:
            if not image.flags.c_contiguous or image.shape[:2] != shape:
                raise ValueError("images of a row lie in one piece each, and are of one size")
            if image.dtype not in _READ:
                raise ValueError(f"images are of float32 or uint8, not {image.dtype}")
        lines.append((*(image.ctypes.data for image in images), *shape))
    return np.array(lines, np.int64).reshape(len(lines), -1 if lines else 2)


@intrinsic
def floats_at(typing_context, table, row, column):
    """Return an image of float32 of a table."""
    return _image_at(types.float32, table, row, column)


@intrinsic
def bytes_at(typing_context, table, row, column):
    """Return an image of uint8 of a table."""
    return _image_at(types.uint8, table, row, column)


@intrinsic
def points_at(typing_context, table, row, column):
    """Return an image of points of a table, (H, W, 2) float32."""
    return _image_at(types.float32, table, row, column, 2)


def _image_at(
    kind: types.Type, table: types.Type, row: types.Type, column: types.Type, *further: int
):
    """Return signature and code of what makes an image of a table's; nobody counts who holds it.

    Parameters
    ----------
    further : int
        Sizes along further axes.
    """
    image = types.Array(kind, 2 + len(further), "C")

    def generate(context, builder, signature, arguments):
        lines = context.make_array(table)(context, builder, arguments[0])
        count = cgutils.unpack_tuple(builder, lines.shape)[1]
        first = builder.gep(lines.data, [builder.mul(arguments[1], count)])
        two, one = (context.get_constant(types.intp, number) for number in (2, 1))
        address, height, width = (
            builder.load(builder.gep(first, [place]))
            for place in (arguments[2], builder.sub(count, two), builder.sub(count, one))
        )
        shape = height, width, *(context.get_constant(types.intp, size) for size in further)
        item = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(kind)))
        strides = [item]
        for size in shape[:0:-1]:
            strides.insert(0, builder.mul(size, strides[0]))
        made = make_array(image)(context, builder)
        populate_array(
            made, data=builder.inttoptr(address, made.data.type), shape=shape, strides=strides,
            itemsize=item, meminfo=None,
        )  # fmt: skip
        return made._getvalue()

    return image(table, types.intp, types.intp), generate
