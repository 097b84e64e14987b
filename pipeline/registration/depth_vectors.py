"""Several pixels of a depth map at once: their medians, and what is written of where they land.

Vectors written out as such; callers keep arrays padded so that sixteen elements from the last
pixel of a row lie within them, or leave the last few out.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from pipeline.vectors import WIDE, Vectors, data_of

_WORD = ir.IntType(32)

_IN_ORDER = (
    (0, 1), (3, 4), (2, 4), (2, 3), (1, 4), (0, 3), (0, 2), (1, 3), (1, 2),
)  # fmt: skip
"""Pairs of five numbers that are put in order one after another, for all five to be."""


def _in_order(wide, numbers):
    """Return five vectors in order, the least first, lane by lane."""
    found = list(numbers)
    for low, high in _IN_ORDER:
        found[low], found[high] = _lesser(wide, found[low], found[high])
    return found


def _lesser(wide, first, second):
    """Return the lesser and the greater one of two vectors' numbers."""
    builder = wide.builder
    return tuple(
        builder.select(builder.fcmp_ordered(sign, first, second), first, second)
        for sign in ("<", ">")
    )


@intrinsic
def sort_wide(typing_context, image, rows, at, out, to, pitch):
    """Write the pixels of sixteen columns of five rows in order, the least first.

    Parameters
    ----------
    image : float32 array
    rows : tuple of intp
        Of the first pixels of the five.
    at : intp
        Of the first column, in each of them.
    out, to, pitch : float32 array, intp, intp
        Of the first of the least; from these to the next ones.
    """
    signature = types.void(image, rows, types.intp, out, types.intp, types.intp)

    def generate(context, builder, signature, arguments):
        wide = Vectors(builder, WIDE)
        pixels, result = (data_of(context, builder, signature, arguments, n) for n in (0, 3))
        column, to, pitch = arguments[2], arguments[4], arguments[5]
        loaded = [
            wide.load(pixels, builder.add(builder.extract_value(arguments[1], n), column))
            for n in range(5)
        ]
        for ordered in _in_order(wide, loaded):
            wide.store(ordered, result, to)
            to = builder.add(to, pitch)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def median_wide(typing_context, columns, at, pitch, out, to):
    """Write the medians of sixteen squares of five by five pixels.

    Parameters
    ----------
    columns, at, pitch : float32 array, intp, intp
        Of :func:`sort_wide`; of the first column of the first square.
    out, to : float32 array, intp

    Notes
    -----
    Once the rows of ordered columns are put in order, too, the median is none but of thirteen of
    them, which lie along the diagonal from the greatest of the least to the least of the greatest
    and on either side of it. Of two numbers told apart, the lesser and the greater ones of them
    border on one another along a stair: there are 252 of these, of which it can be seen that it is
    the greatest of three leasts.
    """
    signature = types.void(columns, types.intp, types.intp, out, types.intp)

    def generate(context, builder, signature, arguments):
        wide = Vectors(builder, WIDE)
        data, result = (data_of(context, builder, signature, arguments, n) for n in (0, 3))
        at, pitch = arguments[1], arguments[2]
        rows = []
        for _ in range(5):
            rows.append(_in_order(wide, [wide.load(data, at, dx) for dx in range(5)]))
            at = builder.add(at, pitch)

        def least(*numbers):
            found = numbers[0]
            for other in numbers[1:]:
                found = _lesser(wide, found, other)[0]
            return found

        def greatest(*numbers):
            found = numbers[0]
            for other in numbers[1:]:
                found = _lesser(wide, found, other)[1]
            return found

        before, own, behind = (
            [rows[k][last - k] for k in range(5) if 0 <= last - k < 5] for last in (3, 4, 5)
        )
        middle = _in_order(wide, own)
        first, second = _lesser(wide, behind[0], behind[1])
        third, fourth = _lesser(wide, behind[2], behind[3])
        low, beyond = _lesser(wide, first, third)
        low_but_one = least(beyond, second, fourth)
        high = greatest(*before)
        median = greatest(
            least(low, middle[2]), least(low, middle[3], high), least(low_but_one, middle[2], high)
        )
        wide.store(median, result, arguments[4])
        return context.get_dummy_value()

    return signature, generate


def _any_of(count: int, marks, at):
    """Return signature and code of what tells whether one of so many marks is set."""

    def generate(context, builder, signature, arguments):
        found = builder.gep(data_of(context, builder, signature, arguments, 0), [arguments[1]])
        all_of_them = ir.IntType(8 * count)
        together = builder.load(builder.bitcast(found, all_of_them.as_pointer()), align=1)
        return builder.icmp_unsigned("!=", together, ir.Constant(all_of_them, 0))

    return types.boolean(marks, types.intp), generate


@intrinsic
def any_of_sixteen(typing_context, marks, at):
    """Return whether one of sixteen marks is set.

    Parameters
    ----------
    marks : bool array
    at : intp
        Of the first one.
    """
    return _any_of(WIDE, marks, at)


@intrinsic
def any_of_many(typing_context, marks, at):
    """Return whether one of four times as many is."""
    return _any_of(4 * WIDE, marks, at)


@intrinsic
def put_landed(
    typing_context, along_x, along_y, at, limits, marks, x, offset, outside, points, offsets, flags
):  # fmt: skip
    """Write of sixteen pixels those that are marked: where they land, and what belongs to it.

    Parameters
    ----------
    along_x, along_y, at : float32 array, float32 array, intp
        Where they land; of the first one.
    limits : tuple of float32
        Beyond which x and y lie inside, and below which x does, and y.
    marks, x : bool array, intp
        Of the first one in it, and in what is written.
    offset, outside : float32, uint8
        What is written of a pixel, and of one that lands outside; of another one 0.
    points, offsets, flags : float32 array, float32 array, uint8 array
        Of the points, x and y of each one after the other.
    """
    signature = types.void(
        along_x, along_y, types.intp, limits, marks, types.intp, types.float32, types.uint8, points,
        offsets, flags,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide, twice = Vectors(builder, WIDE), Vectors(builder, 2 * WIDE)
        across, down, marked, to_points, to_offsets, to_flags = (
            data_of(context, builder, signature, arguments, n) for n in (0, 1, 4, 8, 9, 10)
        )
        at, x = arguments[2], arguments[5]
        least, right, under = (
            wide.spread(builder.extract_value(arguments[3], n)) for n in range(3)
        )
        u, v = wide.load(across, at), wide.load(down, at)
        bytes_ = ir.VectorType(ir.IntType(8), WIDE)
        nothing = ir.Constant(bytes_, [0] * WIDE)
        found = builder.load(wide.place(marked, x, kind=bytes_), align=1)
        wanted = builder.icmp_unsigned("!=", found, nothing)
        by_turns = [lane + half for lane in range(WIDE) for half in (0, WIDE)]
        x_twice = builder.mul(x, ir.Constant(x.type, 2))
        kept = twice.load(to_points, x_twice)
        landed = wide.choose(u, v, by_turns)
        both = wide.choose(wanted, wanted, [lane for lane in range(WIDE) for _ in "xy"])
        twice.store(builder.select(both, landed, kept), to_points, x_twice)
        chosen = builder.select(wanted, wide.spread(arguments[6]), wide.load(to_offsets, x))
        wide.store(chosen, to_offsets, x)
        is_in = builder.fcmp_ordered(">", u, least)
        for sign, value, bound in ((">", v, least), ("<", u, right), ("<", v, under)):
            is_in = builder.and_(is_in, builder.fcmp_ordered(sign, value, bound))
        undefined = ir.Constant(bytes_, ir.Undefined)
        first = builder.insert_element(undefined, arguments[7], ir.Constant(_WORD, 0))
        verdict = wide.choose(first, undefined, [0] * WIDE)
        verdict = builder.select(is_in, nothing, verdict)
        where = wide.place(to_flags, x, kind=bytes_)
        builder.store(builder.select(wanted, verdict, builder.load(where, align=1)), where, align=1)
        return context.get_dummy_value()

    return signature, generate
