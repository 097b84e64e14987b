"""Several pixels at once: the loops that the compiler does not vectorise by itself.

Each function here becomes a few vector instructions (LLVM's ``<8 x float>``, which any
processor has or emulates); it is called from compiled loops only. Arrays are addressed by a
number of elements from their first one, and nothing is checked: callers keep arrays padded so
that eight elements from the last pixel of a row lie within them.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from pipeline.vectors import LANES, WIDE
from pipeline.vectors import Vectors as _Vectors
from pipeline.vectors import data_of as _data

FAR = 4
"""Vectors of these that share what they are multiplied by."""

TOGETHER = 128
"""Observations whose taps or places are worked out together, before they are used one by one."""

PATCH = 7
"""Side of the patches of :func:`weigh_patches` and :func:`weigh_eight`, pixels."""

FOLDED = PATCH // 2 + 1
"""Rows of those, where the ones that lie opposite each other are one."""

_WORD = ir.IntType(32)


@intrinsic
def gather_wide(
    typing_context, position_x, position_y, observed, weight, at, limits, places, sums, pitch
):  # fmt: skip
    """Add sixteen observations to sums on the half-pixel lattice, each to four places, in place.

    Parameters
    ----------
    position_x, position_y, observed, weight : float32 array
        Landing points, HR pixels; grey levels.
    at : intp
        Of the first of them.
    limits : tuple of float32
        Level that is taken off what is observed; weight up to which one is left out; last column
        and last row of the image; first and last row on which observations are to land; twice the
        row from which sums are kept, and the places of the lattice in a row of them.
    places : (16,) int32
        Room to work in.
    sums : float32 array
        Two of each place: of weights, and of what is observed times them.
    pitch : intp
        From row to row of the lattice.
    """
    signature = types.void(
        position_x, position_y, observed, weight, types.intp, limits, places, sums, types.intp
    )

    def generate(context, builder, signature, arguments):
        wide, four = _Vectors(builder, WIDE), _Vectors(builder, 4)
        across, down, grey, mass, room, data = (
            _data(context, builder, signature, arguments, n) for n in (0, 1, 2, 3, 6, 7)
        )
        at, pitch = arguments[4], arguments[8]
        level, smallest, right, under, top, bottom, twice_above, line = (
            wide.spread(builder.extract_value(arguments[5], n)) for n in range(8)
        )
        zeros, ones, halves = wide.zeros, wide.ones, wide.halves
        floor = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(wide.floats, [wide.floats]), f"llvm.floor.v{WIDE}f32"
        )

        def floored(values):
            return builder.call(floor, [values])

        def between(value, last):
            """Return a coordinate on the half-pixel lattice, and what lies before it there."""
            least = builder.select(builder.fcmp_ordered(">", value, zeros), value, zeros)
            most = builder.select(builder.fcmp_ordered("<", least, last), least, last)
            twice = wide.add(most, most)
            whole = floored(twice)
            return whole, wide.subtract(twice, whole)

        weights, x, y, value = (wide.load(numbers, at) for numbers in (mass, across, down, grey))
        nearest_x, nearest_y = (floored(wide.add(number, halves)) for number in (x, y))
        is_in = builder.fcmp_ordered(">", weights, smallest)
        for sign, number, bound in (
            (">=", nearest_x, zeros), ("<=", nearest_x, right), (">=", nearest_y, top),
            ("<=", nearest_y, bottom),
        ):  # fmt: skip
            is_in = builder.and_(is_in, builder.fcmp_ordered(sign, number, bound))
        # what is left out adds nothing, where it is
        weights, x, y = (
            builder.select(is_in, number, other)
            for number, other in ((weights, zeros), (x, zeros), (y, top))
        )
        value = builder.select(is_in, wide.subtract(value, level), zeros)
        # beyond the outermost pixels lies what they are
        column, u = between(x, right)
        row, v = between(y, under)
        # exact: what is kept of rows at once has far fewer places than 2 ** 24
        place = wide.add(wide.times(wide.subtract(row, twice_above), line), column)
        place = builder.fptosi(wide.add(place, place), wide.words)
        first = ir.Constant(at.type, 0)
        builder.store(place, wide.place(room, first, kind=wide.words), align=4)
        sides = wide.subtract(ones, u), u
        fours = []
        for part in (wide.times(weights, wide.subtract(ones, v)), wide.times(weights, v)):
            both = [wide.times(part, side) for side in sides]
            # a weight and what is observed times it, of one place and of that beside it
            firsts, lasts = (_in_pairs(wide, side, wide.times(side, value)) for side in both)
            turned = [
                [four + n + lane for four in range(0, WIDE, 4) for lane in (0, 1, WIDE, WIDE + 1)]
                for n in (0, 2)
            ]
            fours.append(
                [wide.choose(firsts[n // 2], lasts[n // 2], turned[n % 2]) for n in range(4)]
            )
        for lane in range(WIDE):
            here = builder.load(builder.gep(room, [ir.Constant(at.type, lane)]))
            to = builder.sext(here, pitch.type)
            for row in fours:
                own = row[lane % 4]
                share = four.choose(own, own, list(range(lane // 4 * 4, lane // 4 * 4 + 4)))
                four.store(four.add(four.load(data, to), share), data, to)
                to = builder.add(to, pitch)
        return context.get_dummy_value()

    return signature, generate


def _in_pairs(wide: _Vectors, first, second):
    """Return first and second by turns: of numbers 0 and 1 of each four, and of 2 and 3."""
    return [
        wide.choose(
            first,
            second,
            [four + n + lane for four in range(0, WIDE, 4) for n in both for lane in (0, WIDE)],
        )
        for both in ((0, 1), (2, 3))
    ]


@intrinsic
def part_wide(
    typing_context, sums, at, pitch, own, factor, masses, line, plane, even, odd, to
):  # fmt: skip
    """Part what has been gathered on sixteen pixels of a row: weights, rounded, and the rest.

    Parameters
    ----------
    sums : float32 array
        As of :func:`gather_wide`. What no later row needs is made zero.
    at, pitch : intp
        Of the first place of the first pixel; from row to row of the lattice.
    own : float32
        What its own row counts; those half a pixel beside it count a half, a pixel beside an
        eighth.
    factor : float32
        What weights are multiplied by before they are rounded.
    masses : uint8 or uint16 array
        Of the four places of each pixel.
    line, plane : intp
        Of the first pixel there; from one of its places to the next.
    even, odd : float32 array
        What is observed times its weight, rows added, of the places of the pixels and of those
        right of them.
    to : intp
        Of the first pixel in these.
    """
    signature = types.void(
        sums, types.intp, types.intp, types.float32, types.float32, masses, types.intp, types.intp,
        even, odd, types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        data, rounded, *results = (
            _data(context, builder, signature, arguments, n) for n in (0, 5, 8, 9)
        )
        at, pitch, line, plane, to = (arguments[n] for n in (1, 2, 6, 7, 10))
        own, factor = wide.spread(arguments[3]), wide.spread(arguments[4])
        kept = ir.VectorType(ir.IntType(masses.dtype.bitwidth), WIDE)

        def row(number: int):
            """Return a row of the lattice so many rows from the pixels' own one."""
            first = builder.add(at, builder.mul(pitch, ir.Constant(pitch.type, number)))
            return [wide.load(data, first, quarter * WIDE) for quarter in range(4)]

        def parted(quarters, which: int):
            """Return every fourth number from one on, and from the second one after it on."""
            lanes = [4 * lane + first for first in (which, which + 2) for lane in range(8)]
            low, high = (wide.choose(quarters[n], quarters[n + 1], lanes) for n in (0, 2))
            first = [*range(8), *range(WIDE, WIDE + 8)]
            return [wide.choose(low, high, [lane + more for lane in first]) for more in (0, 8)]

        above, before, middle, behind, below = (row(number) for number in range(-2, 3))
        eighth = wide.constant(0.125)
        total = [
            wide.add(
                wide.add(
                    wide.times(own, middle[n]),
                    wide.times(wide.halves, wide.add(before[n], behind[n])),
                ),
                wide.times(eighth, wide.add(above[n], below[n])),
            )
            for n in range(4)
        ]
        for part, result in zip(parted(total, 1), results, strict=True):
            wide.store(part, result, to)
        for part in (*parted(middle, 0), *parted(behind, 0)):
            found = wide.add(wide.times(part, factor), wide.halves)
            found = builder.trunc(builder.fptosi(found, wide.words), kept)
            builder.store(found, wide.place(rounded, line, kind=kept), align=1)
            line = builder.add(line, plane)
        for number in (-2, -1):
            first = builder.add(at, builder.mul(pitch, ir.Constant(pitch.type, number)))
            for quarter in range(4):
                wide.store(wide.zeros, data, first, quarter * WIDE)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def sample_eight(typing_context, image, places, pitch, taps, first, out):
    """Write eight weighted sums of three by three pixels.

    Parameters
    ----------
    image : float32 array
        Four pixels are read of each row.
    places : int32 array
        Of the first of the nine pixels of each sum.
    pitch : intp
        From row to row.
    taps : float32 array
        x₀ x₁ x₂ y₀ y₁ y₂, ``TOGETHER`` apart.
    first : intp
        Of the first sum, in places, taps and ``out``.
    out : float32 array
    """
    signature = types.void(image, places, types.intp, taps, types.intp, out)

    def generate(context, builder, signature, arguments):
        eight, four = _Vectors(builder), _Vectors(builder, 4)
        pixels, starts, numbers, target = (
            _data(context, builder, signature, arguments, number) for number in (0, 1, 3, 5)
        )
        pitch, first = arguments[2], arguments[4]

        def at(number: int):
            return builder.add(first, ir.Constant(first.type, number))

        columns = []
        for lane in range(LANES):
            start = builder.load(builder.gep(starts, [at(lane)]))
            line = builder.sext(start, pitch.type)
            total = four.zeros
            for row in range(3):
                tap = builder.load(builder.gep(numbers, [at((3 + row) * TOGETHER + lane)]))
                total = four.add(total, four.times(four.load(pixels, line), four.spread(tap)))
                line = builder.add(line, pitch)
            columns.append(total)
        # transposed: the first, second and third of each
        pairs = [
            four.choose(columns[lane], columns[lane + 4], list(range(LANES))) for lane in range(4)
        ]
        low, high = [0, 8, 1, 9, 4, 12, 5, 13], [2, 10, 3, 11, 6, 14, 7, 15]
        even, odd = (
            [eight.choose(pairs[half], pairs[half + 2], lanes) for lanes in (low, high)]
            for half in range(2)
        )
        sums = [
            eight.choose(even[0], odd[0], low),
            eight.choose(even[0], odd[0], high),
            eight.choose(even[1], odd[1], low),
        ]
        total = eight.zeros
        for column, part in enumerate(sums):
            tap = eight.load(numbers, first, column * TOGETHER)
            total = eight.add(total, eight.times(part, tap))
        eight.store(total, target, first)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def vertical_wide(
    typing_context, image, above, own, below, middle, side, half, out, to_own, to_between
):
    """Write sixteen spline samples along y at a row, and half-way to the next one.

    Parameters
    ----------
    image : float32 array
    above, own, below : intp
        Of the first pixel in the row above, this one and the row below.
    middle, side, half : float32
        The taps.
    out, to_own, to_between : float32 array, intp, intp
        Where the results go.
    """
    signature = types.void(
        image, *(types.intp,) * 3, *(types.float32,) * 3, out, types.intp, types.intp
    )

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        data, result = (_data(context, builder, signature, arguments, n) for n in (0, 7))
        first, centre, last = (wide.load(data, place) for place in arguments[1:4])
        middle, side, half = (wide.spread(tap) for tap in arguments[4:7])
        at = wide.add(wide.times(wide.add(first, last), side), wide.times(centre, middle))
        wide.store(at, result, arguments[8])
        wide.store(wide.times(wide.add(centre, last), half), result, arguments[9])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def weigh_wide(
    typing_context, image, own, between, middle, side, half, masses, at, plane, to, pitch
):
    """Write sixteen times four weighted spline samples along x, of samples along y.

    Parameters
    ----------
    image : float32 array
    own, between : intp
        Of the first sample at the row, and of that half-way to the next one.
    middle, side, half : float32
        The taps.
    masses : uint8 or uint16 array
    at, plane : intp
        Of the first pixel's weight at the first place of the lattice; from place to place.
    to, pitch : intp
        Where the results go in ``image``; from place to place.
    """
    signature = types.void(
        image, types.intp, types.intp, *(types.float32,) * 3, masses, *(types.intp,) * 4
    )

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        data, weights = (_data(context, builder, signature, arguments, n) for n in (0, 6))
        middle, side, half = (wide.spread(tap) for tap in arguments[3:6])
        at, plane, to, pitch = arguments[7:11]
        for row in arguments[1:3]:
            left, centre, right = (wide.load(data, row, dx) for dx in (-1, 0, 1))
            here = wide.add(wide.times(wide.add(left, right), side), wide.times(centre, middle))
            for sample in (here, wide.times(wide.add(centre, right), half)):
                weight = wide.load_counts(weights, at, signature.args[6].dtype)
                wide.store(wide.times(sample, weight), data, to)
                at, to = builder.add(at, plane), builder.add(to, pitch)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def collect_wide(typing_context, image, at, pitch, middle, side, half, out, to_own, to_between):
    """Write what four places of the lattice add along x to sixteen pixels.

    Parameters
    ----------
    image : float32 array
    at, pitch : intp
        Of the first pixel at the first place; from place to place.
    middle, side, half : float32
        The taps.
    out, to_own, to_between : float32 array, intp, intp
        Where what the first two places add goes, and what the last two do.
    """
    signature = types.void(
        image, types.intp, types.intp, *(types.float32,) * 3, out, types.intp, types.intp
    )

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        data, result = (_data(context, builder, signature, arguments, n) for n in (0, 6))
        at, pitch = arguments[1:3]
        middle, side, half = (wide.spread(tap) for tap in arguments[3:6])
        for to in arguments[7:9]:
            left, centre, right = (wide.load(data, at, dx) for dx in (-1, 0, 1))
            at = builder.add(at, pitch)
            between = wide.add(wide.load(data, at, -1), wide.load(data, at))
            at = builder.add(at, pitch)
            total = wide.add(wide.times(wide.add(left, right), side), wide.times(centre, middle))
            wide.store(wide.add(total, wide.times(between, half)), result, to)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def join_wide(
    typing_context, image, above, own, below, here, before, middle, side, half, of_before,
    out, to,
):  # fmt: skip
    """Write what the lattice adds along y to sixteen pixels.

    Parameters
    ----------
    image : float32 array
    above, own, below : intp
        Of the first pixel in what three rows add.
    here, before : intp
        In what lies between this row and the next one, and between this one and that before.
    middle, side, half, of_before : float32
        Taps of those three, and of these two.
    out, to : float32 array, intp
        Where the result goes.
    """
    signature = types.void(image, *(types.intp,) * 5, *(types.float32,) * 4, out, types.intp)

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        data, result = (_data(context, builder, signature, arguments, n) for n in (0, 10))
        above, own, below, here, before = (wide.load(data, place) for place in arguments[1:6])
        middle, side, half, of_before = (wide.spread(tap) for tap in arguments[6:10])
        total = wide.add(wide.times(wide.add(above, below), side), wide.times(own, middle))
        halves = wide.add(wide.times(here, half), wide.times(before, of_before))
        wide.store(wide.add(total, halves), result, arguments[11])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def blur_wide(typing_context, image, places, taps, out, to):
    """Write sixteen sums of pixels, each pair of them times its tap.

    Parameters
    ----------
    image : float32 array
    places : tuple of intp
        Of the first of sixteen pixels, each: the middle ones, then pair by pair.
    taps : tuple of float32
        Of the middle ones, then of each pair.
    out, to : float32 array, intp
        Where the result goes.
    """
    signature = types.void(image, places, taps, out, types.intp)

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        pixels, result = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        parts = [
            wide.load(pixels, builder.extract_value(arguments[1], n)) for n in range(len(places))
        ]
        sums = [
            parts[0],
            *(wide.add(*pair) for pair in zip(parts[1::2], parts[2::2], strict=True)),
        ]
        total = wide.zeros
        for number, part in enumerate(sums):
            tap = wide.spread(builder.extract_value(arguments[2], number))
            total = wide.add(total, wide.times(part, tap))
        wide.store(total, result, arguments[4])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def plus_wide(typing_context, first, at, factor, second, there, out, to):
    """Write sixteen numbers + ``factor`` · sixteen others.

    Parameters
    ----------
    first, second, out : float32 or uint16 array
        The latter holds the bits of float16, in which numbers are cut off at 65504.
    at, there, to : intp
        Of the first one in each.
    factor : float32
    """
    return _adding(WIDE, first, second, out)


@intrinsic
def plus_one(typing_context, first, at, factor, second, there, out, to):
    """Do what :func:`plus_wide` does with one number."""
    return _adding(1, first, second, out)


def _adding(lanes: int, first, second, out):
    """Return signature and code of what adds so many numbers to so many."""
    signature = types.void(first, types.intp, types.float32, second, types.intp, out, types.intp)

    def generate(context, builder, signature, arguments):
        vectors = _Vectors(builder, lanes, ("contract",))
        left, right = (
            vectors.load_kept(
                _data(context, builder, signature, arguments, n), arguments[n + 1],
                signature.args[n].dtype,
            )
            for n in (0, 3)
        )  # fmt: skip
        total = vectors.add(left, vectors.times(right, vectors.spread(arguments[2])))
        target = _data(context, builder, signature, arguments, 5)
        vectors.keep(total, target, arguments[6], signature.args[5].dtype)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def move_wide(typing_context, row, out, at):
    """Copy sixteen numbers; arrays are of the kinds that :func:`plus_wide` takes."""
    return _moving(WIDE, row, out)


@intrinsic
def move_one(typing_context, row, out, at):
    """Do what :func:`move_wide` does with one number."""
    return _moving(1, row, out)


def _moving(lanes: int, row, out):
    """Return signature and code of what copies so many numbers."""
    signature = types.void(row, out, types.intp)

    def generate(context, builder, signature, arguments):
        vectors = _Vectors(builder, lanes)
        source, target = (_data(context, builder, signature, arguments, n) for n in (0, 1))
        found = vectors.load_kept(source, arguments[2], signature.args[0].dtype)
        vectors.keep(found, target, arguments[2], signature.args[1].dtype)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def blur_along(typing_context, row, at, taps, out, to):
    """Write sixteen sums of neighbours in a row, each pair of them times its tap.

    All that is read begins with lines of the processor's cache where the first pixel does; what
    lies beside it is moved into place, since reading across lines takes twice as long.

    Parameters
    ----------
    row : float32 array
        Sixteen are read before the first pixel, and behind the last one.
    at : intp
        Of the first pixel.
    taps : tuple of float32
        Of the middle ones, then of each pair.
    out, to : float32 array, intp
        Where the result goes.
    """
    signature = types.void(row, types.intp, taps, out, types.intp)

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        pixels, result = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        before, own, behind = (wide.load(pixels, arguments[1], n * WIDE) for n in (-1, 0, 1))
        total = wide.zeros
        for away in range(len(taps)):
            part = own
            if away > 0:
                left = wide.choose(before, own, [WIDE - away + n for n in range(WIDE)])
                right = wide.choose(own, behind, [away + n for n in range(WIDE)])
                part = wide.add(left, right)
            tap = wide.spread(builder.extract_value(arguments[2], away))
            total = wide.add(total, wide.times(part, tap))
        wide.store(total, result, arguments[4])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def blur_across(typing_context, image, places, taps, out, to, pitch):
    """Write sixteen sums of pixels in rows around one, and in those around the next.

    Parameters
    ----------
    image : float32 array
    places : tuple of intp
        Of the first of sixteen pixels in each row, one below another; of an even number of rows.
    taps : tuple of float32
        Of the row in the middle, then of those on both sides of it.
    out, to, pitch : float32 array, intp, intp
        Where the first results go; from these to those of the next row.
    """
    signature = types.void(image, places, taps, out, types.intp, types.intp)

    def generate(context, builder, signature, arguments):
        # each sum by itself, so that it does not matter which of the two a row gets
        wide = _Vectors(builder, WIDE, ("contract",))
        pixels, result = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        rows = [
            wide.load(pixels, builder.extract_value(arguments[1], n)) for n in range(len(places))
        ]
        to = arguments[4]
        for middle in (len(taps) - 1, len(taps)):
            total = None
            for away in range(len(taps)):
                part = rows[middle]
                if away > 0:
                    part = wide.add(rows[middle - away], rows[middle + away])
                part = wide.times(part, wide.spread(builder.extract_value(arguments[2], away)))
                total = part if total is None else wide.add(total, part)
            wide.store(total, result, to)
            to = builder.add(to, arguments[5])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def weigh_places(typing_context, image, places, more, taps, first, out, to):
    """Write sixteen sums of pixels, those at each place times its tap, one after another.

    Parameters
    ----------
    image : float32 array
    places : int64 array
        Of the first of sixteen pixels, …
    more : intp
        … if as many are added to it.
    taps : float32 array
    first : intp
        Of the first place's tap.
    out, to : float32 array, intp
        Where the result goes.
    """
    return _weighing(1, WIDE, image, places, taps, out)


@intrinsic
def weigh_places_far(typing_context, image, places, more, taps, first, out, to):
    """Write ``FAR`` times as many sums; arguments are those of :func:`weigh_places`."""
    return _weighing(FAR, WIDE, image, places, taps, out)


@intrinsic
def weigh_place(typing_context, image, places, more, taps, first, out, to):
    """Write one sum, as :func:`weigh_places` does; arguments are those of that."""
    return _weighing(1, 1, image, places, taps, out)


def _weighing(count: int, lanes: int, image, places, taps, out):
    """Return signature and code of what writes so many vectors of so many sums."""
    signature = types.void(image, places, types.intp, taps, types.intp, out, types.intp)

    def generate(context, builder, signature, arguments):
        # in this order, so that it does not matter which of them a pixel gets
        vectors = _Vectors(builder, lanes, ("contract",))
        pixels, starts, weights, result = (
            _data(context, builder, signature, arguments, n) for n in (0, 1, 3, 5)
        )
        lines = context.make_array(signature.args[1])(context, builder, arguments[1])
        size = cgutils.unpack_tuple(builder, lines.shape)[0]
        totals = [cgutils.alloca_once_value(builder, vectors.zeros) for _ in range(count)]
        with cgutils.for_range(builder, size) as loop:
            at = builder.add(builder.load(builder.gep(starts, [loop.index])), arguments[2])
            tap = builder.gep(weights, [builder.add(arguments[4], loop.index)])
            tap = vectors.spread(builder.load(tap))
            for number, total in enumerate(totals):
                part = vectors.times(vectors.load(pixels, at, number * lanes), tap)
                builder.store(vectors.add(builder.load(total), part), total)
        for number, total in enumerate(totals):
            vectors.store(builder.load(total), result, arguments[6], number * lanes)
        return context.get_dummy_value()

    return signature, generate


_NEIGHBOURS = ((0, 0, 1), (1, 1, -1), (2, 1, 0), (3, 1, 1))
"""Plane of the prior's weights, rows down and columns right of what it couples a pixel with."""


@intrinsic
def pull_wide(
    typing_context, weights, at, plane, pitch, image, up, row, down, strength, share, least,
    balance, balance_at, residual, softness, to,
):  # fmt: skip
    """Take the prior's pull off the residual of sixteen pixels, and write their softness.

    The pull is ``strength`` times the weighted graph Laplacian, diagonals counting half; the
    softness is 1 / (share · balance² · its diagonal + least).

    Parameters
    ----------
    weights : uint8 or uint16 array
        Of ``sweeps.weigh_prior``.
    at, plane, pitch : intp
        Of the first pixel in plane 0; from plane to plane; from row to row.
    image : float32 array
    up, row, down : intp
        Of the first pixel in the row above, this one and the row below.
    balance, balance_at : float32 array, intp
        Of the first pixel.
    residual, softness, to : float32 arrays, intp
        Changed in place, and overwritten.
    """
    signature = types.void(
        weights, *(types.intp,) * 3, image, *(types.intp,) * 3, *(types.float32,) * 3,
        balance, types.intp, residual, softness, types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        planes, pixels, balances, target, soft = (
            _data(context, builder, signature, arguments, number) for number in (0, 4, 11, 13, 14)
        )
        first, plane, pitch = arguments[1:4]
        above, row, below = arguments[5:8]
        strength, share, least = arguments[8:11]
        to = arguments[15]
        centre = wide.load(pixels, row)
        pulls, sums = [wide.zeros, wide.zeros], [wide.zeros, wide.zeros]
        for number, down, dx in _NEIGHBOURS:
            kind = number % 2
            own = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            back = builder.sub(own, builder.mul(pitch, ir.Constant(pitch.type, down)))
            for where, shift, start, sign in (
                (own, 0, below if down else row, 1), (back, -dx, above if down else row, -1),
            ):  # fmt: skip
                weight = wide.load_counts(planes, where, signature.args[0].dtype, shift)
                away = wide.subtract(centre, wide.load(pixels, start, sign * dx))
                pulls[kind] = wide.add(pulls[kind], wide.times(weight, away))
                sums[kind] = wide.add(sums[kind], weight)
        half = wide.halves
        pull, total = (
            wide.times(wide.add(straight, wide.times(diagonal, half)), wide.spread(strength))
            for straight, diagonal in (pulls, sums)
        )
        wide.store(wide.subtract(wide.load(target, to), pull), target, to)
        balanced = wide.load(balances, arguments[12])
        factor = wide.times(wide.spread(share), wide.times(balanced, balanced))
        stiff = wide.add(wide.times(total, factor), wide.spread(least))
        ones = wide.ones
        wide.store(builder.fdiv(ones, stiff, flags=wide.flags), soft, to)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def bend_wide(typing_context, weights, at, plane, image, row, down, out, to):
    """Write the weighted squares of what sixteen pixels differ by from those ahead of them.

    Diagonals count half; arguments as of :func:`pull_wide`.
    """
    signature = types.void(
        weights, types.intp, types.intp, image, types.intp, types.intp, out, types.intp
    )

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        planes, pixels, result = (
            _data(context, builder, signature, arguments, number) for number in (0, 3, 6)
        )
        first, plane = arguments[1:3]
        row, below, to = arguments[4], arguments[5], arguments[7]
        kind = signature.args[0].dtype
        centre = wide.load(pixels, row)
        sums = [wide.zeros, wide.zeros]
        for number, down, dx in _NEIGHBOURS:
            which = number % 2
            where = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            away = wide.subtract(centre, wide.load(pixels, below if down else row, dx))
            square = wide.times(wide.times(away, away), wide.load_counts(planes, where, kind))
            sums[which] = wide.add(sums[which], square)
        half = wide.halves
        wide.store(wide.add(sums[0], wide.times(sums[1], half)), result, to)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def squares_wide(typing_context, image, own, below, out, to, plane):
    """Write the squares of what sixteen pixels differ by from their neighbours, in four planes.

    In the order of ``_NEIGHBOURS``. Sixteen are read before the first pixel below, and behind the
    last ones; see :func:`blur_along`.

    Parameters
    ----------
    image : float32 array
    own, below : intp
        Of the first pixel in this row, and in the one below.
    out, to, plane : float32 array, intp, intp
        Where the results of the first plane go; from plane to plane.
    """
    signature = types.void(image, types.intp, types.intp, out, types.intp, types.intp)

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        pixels, result = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        own, below, to, plane = arguments[1], arguments[2], arguments[4], arguments[5]
        rows = [[wide.load(pixels, start, n * WIDE) for n in (-1, 0, 1)] for start in (own, below)]
        for _, down, dx in _NEIGHBOURS:
            away = wide.subtract(_beside(wide, rows[down], dx), rows[0][1])
            wide.store(wide.times(away, away), result, to)
            to = builder.add(to, plane)
        return context.get_dummy_value()

    return signature, generate


def _beside(wide: _Vectors, three, dx: int):
    """Return what lies so far to the right of the second of three vectors in a row."""
    if dx == 0:
        return three[1]
    left, right, start = (*three[1:], dx) if dx > 0 else (*three[:2], WIDE + dx)
    return wide.choose(left, right, [start + n for n in range(WIDE)])


class _Sums:
    """Sums of three rows, weighted 1 2 1 along both axes, of sixteens that lie behind each other.

    Parameters
    ----------
    data
        The numbers.
    rows : tuple of intp
        Of the first of sixteen in the row above, this one and the row below; as many are read
        before them, and behind the last ones.
    """

    def __init__(self, wide: _Vectors, data, rows) -> None:
        self._wide, self._data, self._rows = wide, data, rows
        self._before, self._own = (
            cgutils.alloca_once_value(wide.builder, self._down(n * WIDE)) for n in (-1, 0)
        )

    def next(self, ahead):
        """Return sixteen more sums, ``ahead`` of the first ones."""
        wide, builder = self._wide, self._wide.builder
        behind = self._down(WIDE, ahead)
        three = builder.load(self._before), builder.load(self._own), behind
        builder.store(three[1], self._before)
        builder.store(behind, self._own)
        left, right = (_beside(wide, three, dx) for dx in (-1, 1))
        return wide.add(wide.add(left, self._twice(three[1])), right)

    def _down(self, more: int, ahead=None):
        """Return sums along the column."""
        above, own, below = (
            self._wide.load(
                self._data, row if ahead is None else self._wide.builder.add(row, ahead), more
            )
            for row in self._rows
        )
        return self._wide.add(self._wide.add(above, self._twice(own)), below)

    def _twice(self, value):
        return self._wide.times(self._wide.constant(2.0), value)


@intrinsic
def share_row(
    typing_context, squares, above, own, below, pitch, count, square, least, floor, strengths, at,
    out, to, plane,
):  # fmt: skip
    """Write m (s / (t + l) + f) at so many sixteens of pixels of four planes.

    t is the sum over 3 × 3 pixels, weighted 1 2 1 along both axes. One division serves all four.

    Parameters
    ----------
    squares : float32 array
    above, own, below : intp
        Of the first pixel in plane 0, in three rows; see :class:`_Sums`.
    pitch : intp
        From plane to plane.
    count : intp
        Of sixteens.
    square, least, floor : float32
        s, l, f.
    strengths, at : float32 array, intp
        m, of the first pixel.
    out, to, plane : float32 array, intp, intp
        Where the result of plane 0 goes; from plane to plane.
    """
    signature = types.void(
        squares, *(types.intp,) * 5, *(types.float32,) * 3, strengths, types.intp, out, types.intp,
        types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        values, strong, result = (
            _data(context, builder, signature, arguments, n) for n in (0, 9, 11)
        )
        rows, pitch, count = arguments[1:4], arguments[4], arguments[5]
        square, least, floor = (wide.spread(number) for number in arguments[6:9])
        at, first, plane = arguments[10], arguments[12], arguments[13]
        planes = []
        for _ in range(4):
            planes.append(_Sums(wide, values, rows))
            rows = [builder.add(row, pitch) for row in rows]
        with cgutils.for_range(builder, count) as loop:
            ahead = builder.mul(loop.index, ir.Constant(count.type, WIDE))
            totals = [wide.add(sums.next(ahead), least) for sums in planes]
            pairs = [wide.times(totals[0], totals[1]), wide.times(totals[2], totals[3])]
            inverse = builder.fdiv(square, wide.times(*pairs), flags=wide.flags)
            of_pairs = [wide.times(inverse, pairs[1]), wide.times(inverse, pairs[0])]
            strength = wide.load(strong, builder.add(at, ahead))
            to = builder.add(first, ahead)
            for number in range(4):
                share = wide.times(of_pairs[number // 2], totals[number ^ 1])
                wide.store(wide.times(strength, wide.add(share, floor)), result, to)
                to = builder.add(to, plane)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def round_row(typing_context, shares, above, own, below, count, out, to):
    """Write so many sixteens of sums over 3 × 3 pixels, weighted 1 2 1 along both axes, rounded.

    Parameters
    ----------
    shares : float32 array
    above, own, below : intp
        Of the first pixel, in three rows; see :class:`_Sums`.
    count : intp
        Of sixteens.
    out, to : uint16 array, intp
    """
    signature = types.void(shares, *(types.intp,) * 4, out, types.intp)

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        values, result = (_data(context, builder, signature, arguments, n) for n in (0, 5))
        sums, count, to = _Sums(wide, values, arguments[1:4]), arguments[4], arguments[6]
        with cgutils.for_range(builder, count) as loop:
            ahead = builder.mul(loop.index, ir.Constant(count.type, WIDE))
            whole = builder.fptosi(wide.add(sums.next(ahead), wide.halves), wide.words)
            where = wide.place(result, builder.add(to, ahead), kind=wide.shorts)
            builder.store(builder.trunc(whole, wide.shorts), where, align=2)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def kinds_wide(
    typing_context, tensor, at, pitch, views, tangents, energies, ratios, loads, tiny, factors,
    kinds, to,
):  # fmt: skip
    """Write the kinds of sixteen pixels, see ``filter_kernels.classify``.

    Parameters
    ----------
    tensor : float32 array
    at, pitch : intp
        Of the first pixel in xx, of three planes; from plane to plane.
    views : float32 array
        How many views observe what lies around each pixel, of which the sixteen from its element
        ``to`` on are taken.
    tangents, energies, ratios, loads : tuple of float32
        Limits of what tells angle, strength, coherence and number of views; where there are none,
        that tells nothing.
    tiny : float32
        Energy below which a structure has no direction.
    factors : tuple of int32
        What one mirroring, angle, strength, coherence and number of views counts.
    kinds, to : int16 array, intp
        Where the result goes.
    """
    signature = types.void(
        tensor, types.intp, types.intp, views, tangents, energies, ratios, loads, types.float32,
        factors, kinds, types.intp,
    )  # fmt: skip
    limits = [kind.count for kind in (tangents, energies, ratios, loads)]

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        numbers, seen, result = (
            _data(context, builder, signature, arguments, n) for n in (0, 3, 10)
        )
        at, pitch, to = arguments[1], arguments[2], arguments[11]
        xx = wide.load(numbers, at)
        xy = wide.load(numbers, builder.add(at, pitch))
        yy = wide.load(numbers, builder.add(at, builder.mul(pitch, ir.Constant(pitch.type, 2))))
        one = ir.FunctionType(wide.floats, [wide.floats])
        root, size = (
            cgutils.get_or_insert_function(builder.module, one, f"llvm.{name}.v{WIDE}f32")
            for name in ("sqrt", "fabs")
        )
        across, slant = wide.subtract(xx, yy), wide.add(xy, xy)
        squares = wide.add(wide.times(across, across), wide.times(slant, slant))
        spread, total = builder.call(root, [squares]), wide.add(xx, yy)
        larger = wide.times(wide.halves, wide.add(total, spread))
        smaller = wide.times(wide.halves, wide.subtract(total, spread))

        def counted(sign, first, second, factor):
            """Return a factor where the comparison holds, else zero."""
            value = builder.extract_value(arguments[9], factor)
            undefined = ir.Constant(wide.words, ir.Undefined)
            single = builder.insert_element(undefined, value, ir.Constant(_WORD, 0))
            spread_out = wide.choose(single, undefined, [0] * WIDE)
            holds = builder.fcmp_ordered(sign, first, second)
            return builder.select(holds, spread_out, ir.Constant(wide.words, [0] * WIDE))

        def limit(number, place):
            return wide.spread(builder.extract_value(arguments[number], place))

        upright = counted("<", across, wide.zeros, 0)
        mirrored = counted("<", slant, wide.zeros, 0)
        kind = builder.add(upright, builder.add(mirrored, mirrored))
        slant, across = builder.call(size, [slant]), builder.call(size, [across])
        for place in range(limits[0]):
            passed = counted(">", slant, wide.times(limit(4, place), across), 1)
            kind = builder.add(kind, passed)
        for place in range(limits[1]):
            kind = builder.add(kind, counted(">=", larger, limit(5, place), 2))
        for place in range(limits[2]):
            bound = wide.add(wide.times(limit(6, place), larger), wide.spread(arguments[8]))
            kind = builder.add(kind, counted(">", smaller, bound, 3))
        for place in range(limits[3]):
            passed = counted(">=", wide.load(seen, to), limit(7, place), 4)
            kind = builder.add(kind, passed)
        where = wide.place(result, to, kind=wide.shorts)
        builder.store(builder.trunc(kind, wide.shorts), where, align=2)
        return context.get_dummy_value()

    return signature, generate


def _add_up(eight, totals):
    """Return the sums of the lanes of eight vectors, one after the other."""
    # halves are added up, of more and more of them in one vector; in this order they end up so
    totals = [totals[lane] for lane in (0, 4, 2, 6, 1, 5, 3, 7)]
    for size in (4, 2, 1):
        count = len(totals) // 2
        low = [lane for lane in range(2 * LANES) if lane % (2 * size) < size]
        high = [lane + size for lane in low]
        totals = [
            eight.add(eight.choose(*pair, low), eight.choose(*pair, high))
            for pair in zip(totals[:count], totals[count:], strict=True)
        ]
    return totals[0]


@intrinsic
def weigh_patches(typing_context, image, at, pitch, taps, kinds, first, out):
    """Write the sums of the pixels of eight patches side by side, each times its tap.

    What lies opposite each other has the same tap: what is below the middle row is added to what is
    above it, turned about.

    Parameters
    ----------
    image : float32 array
    at, pitch : intp
        Of the first patch's first pixel; from row to row.
    taps : float32 array
        For each kind ``FOLDED`` rows of LANES, the last one of the middle row; the last lane zero.
    kinds : int16 array
        Of the patches.
    first : intp
        Of the first patch, in ``kinds`` and ``out``.
    out : float32 array
    """
    signature = types.void(image, types.intp, types.intp, taps, kinds, types.intp, out)

    def generate(context, builder, signature, arguments):
        eight = _Vectors(builder)
        pixels, weights, numbers, result = (
            _data(context, builder, signature, arguments, n) for n in (0, 3, 4, 6)
        )
        at, pitch, first = arguments[1], arguments[2], arguments[5]
        lines = [at]
        for _ in range(1, PATCH):
            lines.append(builder.add(lines[-1], pitch))
        below = [
            [eight.load(pixels, line, LANES * half) for half in range(2)]
            for line in lines[: FOLDED - 1 : -1]
        ]
        totals = []
        for lane in range(LANES):
            where = builder.add(first, ir.Constant(first.type, lane))
            kind = builder.sext(builder.load(builder.gep(numbers, [where])), first.type)
            tap = builder.mul(kind, ir.Constant(first.type, FOLDED * LANES))
            total = eight.zeros
            turned = [lane + PATCH - 1 - n for n in range(PATCH)] + [lane + PATCH]
            for row in range(FOLDED):
                found = eight.load(pixels, lines[row], lane)
                if row < len(below):
                    left, right = below[row]
                    found = eight.add(found, eight.choose(left, right, turned))
                taps_of_row = eight.load(weights, tap, LANES * row)
                total = eight.add(total, eight.times(found, taps_of_row))
            totals.append(total)
        eight.store(_add_up(eight, totals), result, first)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def weigh_eight(typing_context, image, pitch, taps, places, first, out):
    """Write the sums of the pixels of eight patches, each times its taps along x and along y.

    Parameters
    ----------
    image : float32 array
    pitch : intp
        From row to row.
    taps : float32 array
        In rows of LANES, the last lane zero.
    places : (3, N) int32
        Of each patch's first pixel; of its first tap along x, and along y.
    first : intp
        Of the first of the eight patches there, and in ``out``.
    out : float32 array
    """
    signature = types.void(image, types.intp, taps, places, types.intp, out)

    def generate(context, builder, signature, arguments):
        eight = _Vectors(builder)
        pixels, weights, numbers, result = (
            _data(context, builder, signature, arguments, n) for n in (0, 2, 3, 5)
        )
        pitch, first = arguments[1], arguments[4]
        lines = context.make_array(signature.args[3])(context, builder, arguments[3])
        count = cgutils.unpack_tuple(builder, lines.shape)[1]

        def number(plane, lane):
            where = builder.add(first, ir.Constant(first.type, lane))
            where = builder.add(where, builder.mul(count, ir.Constant(first.type, plane)))
            return builder.sext(builder.load(builder.gep(numbers, [where])), first.type)

        totals = []
        for lane in range(LANES):
            line, along_x, along_y = (number(plane, lane) for plane in range(3))
            total = eight.zeros
            for row in range(PATCH):
                where = builder.add(along_y, ir.Constant(along_y.type, row))
                tap = eight.spread(builder.load(builder.gep(weights, [where])))
                total = eight.add(total, eight.times(eight.load(pixels, line), tap))
                line = builder.add(line, pitch)
            totals.append(eight.times(total, eight.load(weights, along_x)))
        eight.store(_add_up(eight, totals), result, first)
        return context.get_dummy_value()

    return signature, generate


def _between(eight, data, arguments):
    """Yield eight rows of eight pixels that lie a share of a pixel to the right, and below.

    The arguments are those of :func:`compare_patch` that say which.
    """
    at, pitch = arguments[:2]
    across, down = (eight.spread(share) for share in arguments[2:])
    right, below = eight.subtract(eight.ones, across), eight.subtract(eight.ones, down)
    shares = [eight.times(*pair) for pair in (
        (right, below), (across, below), (right, down), (across, down),
    )]  # fmt: skip
    upper = [eight.load(data, at, dx) for dx in range(2)]
    for _ in range(LANES):
        at = eight.builder.add(at, pitch)
        lower = [eight.load(data, at, dx) for dx in range(2)]
        total = eight.zeros
        for pixels, share in zip(upper + lower, shares, strict=True):
            total = eight.add(total, eight.times(pixels, share))
        yield total
        upper = lower


@intrinsic
def compare_patch(typing_context, image, at, pitch, across, down, patch, out):
    """Write four sums of what eight rows of eight pixels of an image differ by from a patch.

    The difference, its square, and its products with the slopes along x and y.

    Parameters
    ----------
    image : float32 array
    at, pitch : intp
        Of the first pixel; from row to row.
    across, down : float32
        How far the pixels lie beyond that, 0..1.
    patch : float32 array
        Its pixels, their slopes along x, and along y, ``LANES``² each.
    out : (≥ 4,) float32 array
    """
    signature = types.void(image, types.intp, types.intp, types.float32, types.float32, patch, out)

    def generate(context, builder, signature, arguments):
        eight = _Vectors(builder)
        pixels, own, result = (_data(context, builder, signature, arguments, n) for n in (0, 5, 6))
        first = ir.Constant(arguments[1].type, 0)
        sums = [eight.zeros] * 4
        for number, row in enumerate(_between(eight, pixels, arguments[1:5])):
            patch, along_x, along_y = (
                eight.load(own, first, LANES * (LANES * plane + number)) for plane in range(3)
            )
            away = eight.subtract(row, patch)
            sums[0] = eight.add(sums[0], away)
            for place, other in enumerate((away, along_x, along_y), 1):
                sums[place] = eight.add(sums[place], eight.times(away, other))
        four = _Vectors(builder, 4)
        halves = [
            four.add(eight.choose(one, one, [0, 1, 2, 3]), eight.choose(one, one, [4, 5, 6, 7]))
            for one in sums
        ]
        # pairs of two sums in one vector, then all four
        low, high = [
            four.add(four.choose(one, other, [0, 1, 4, 5]), four.choose(one, other, [2, 3, 6, 7]))
            for one, other in (halves[:2], halves[2:])
        ]
        total = four.add(four.choose(low, high, [0, 2, 4, 6]), four.choose(low, high, [1, 3, 5, 7]))
        four.store(total, result, first)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_shares(
    typing_context, image, at, pitch, across, down, own, here, line, u, v, sums, to, plane
):  # fmt: skip
    """Add to three sums of eight rows of eight pixels 1, u and v, by how alike two images are.

    The share of each is 1 / (1 + d²), d what they differ by.

    Parameters
    ----------
    image, at, pitch, across, down
        As of :func:`compare_patch`.
    own, here, line : float32 array, intp, intp
        The other image; of its first pixel; from row to row, there and in the sums.
    u, v : float32
    sums : float32 array
    to, plane : intp
        Of the first pixel; from sum to sum.
    """
    signature = types.void(
        image, types.intp, types.intp, types.float32, types.float32, own,
        types.intp, types.intp, types.float32, types.float32, sums, types.intp, types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        eight = _Vectors(builder)
        pixels, others, result = (
            _data(context, builder, signature, arguments, n) for n in (0, 5, 10)
        )
        here, line = arguments[6:8]
        factors = [eight.ones, *(eight.spread(number) for number in arguments[8:10])]
        to, plane = arguments[11:13]
        for row in _between(eight, pixels, arguments[1:5]):
            away = eight.subtract(row, eight.load(others, here))
            share = builder.fdiv(
                eight.ones, eight.add(eight.ones, eight.times(away, away)), flags=eight.flags
            )
            where = to
            for factor in factors:
                total = eight.add(eight.load(result, where), eight.times(share, factor))
                eight.store(total, result, where)
                where = builder.add(where, plane)
            here, to = builder.add(here, line), builder.add(to, line)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def add_products(
    typing_context, detail, fine, first, second, fine_before, frames, asked_from, reached, at,
    products, pitch,
):  # fmt: skip
    """Add to sixteen columns what they have in common with the frames before.

    See ``lagging.add_row``, whose rows these are.

    Parameters
    ----------
    detail, fine, first, second, fine_before : int16 array
    frames, asked_from : float32 array
    reached : uint8 array
    at : intp
        Of the first column, in all of them.
    products : float32 array
        Of six rows.
    pitch : intp
        From row to row of it.
    """
    signature = types.void(
        detail, fine, first, second, fine_before, frames, asked_from, reached, types.intp, products,
        types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        at, pitch = arguments[8], arguments[10]
        data = [_data(context, builder, signature, arguments, n) for n in (*range(8), 9)]

        def shorts(number: int):
            found = builder.load(wide.place(data[number], at, kind=wide.shorts), align=2)
            return builder.sitofp(builder.sext(found, wide.words), wide.floats)

        bytes_ = ir.VectorType(ir.IntType(8), WIDE)
        marks = builder.load(wide.place(data[7], at, kind=bytes_), align=1)
        stands = builder.and_(
            builder.icmp_unsigned("==", marks, ir.Constant(bytes_, [0] * WIDE)),
            builder.fcmp_ordered(">=", wide.load(data[5], at), wide.load(data[6], at)),
        )
        own, finer, last, before, finer_last = (
            builder.select(stands, shorts(number), wide.zeros) for number in range(5)
        )
        halves = wide.halves

        def mean_square(one, other):
            return wide.times(halves, wide.add(wide.times(one, one), wide.times(other, other)))

        to = at
        for more in (
            wide.times(own, last), wide.times(own, before), mean_square(own, last),
            wide.times(finer, finer_last), mean_square(finer, finer_last),
            builder.select(stands, wide.ones, wide.zeros),
        ):  # fmt: skip
            wide.store(wide.add(wide.load(data[8], to), more), data[8], to)
            to = builder.add(to, pitch)
        return context.get_dummy_value()

    return signature, generate
