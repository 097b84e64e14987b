"""Several pixels at once: the loops that the compiler does not vectorise by itself.

Each function here becomes a few vector instructions (LLVM's ``<8 x float>``, which any
processor has or emulates); it is called from compiled loops only. Arrays are addressed by a
number of elements from their first one, and nothing is checked: callers keep arrays padded so
that eight elements from the last pixel of a row lie within them.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

LANES = 8
"""Pixels worked on together."""

WIDE = 16
"""The same where all is arithmetic, for processors that have such vectors."""

CELL = 16
"""Numbers kept for each HR pixel while observations are gathered, see :func:`add_nine`."""

TOGETHER = 128
"""Observations whose taps are worked out together, before they are added one by one."""

PATCH = 7
"""Side of the patches of :func:`weigh_patches` and :func:`weigh_patch`, pixels."""

_FLOAT, _WORD, _SHORT = ir.FloatType(), ir.IntType(32), ir.IntType(16)


class _Vectors:
    """Writes instructions on so many numbers; sums may be contracted to multiply-adds."""

    flags = ("contract", "reassoc", "nsz", "arcp")

    def __init__(self, builder: ir.IRBuilder, lanes: int = LANES) -> None:
        self.builder = builder
        self.lanes = lanes
        self.floats, self.words, self.shorts = (
            ir.VectorType(kind, lanes) for kind in (_FLOAT, _WORD, _SHORT)
        )
        self.zeros, self.halves, self.ones = map(self.constant, (0.0, 0.5, 1.0))

    def constant(self, number: float):
        """Return that number in all lanes."""
        return ir.Constant(self.floats, [number] * self.lanes)

    def spread(self, number):
        """Return the same number in all lanes."""
        undefined = ir.Constant(self.floats, ir.Undefined)
        first = self.builder.insert_element(undefined, number, ir.Constant(_WORD, 0))
        return self.choose(first, undefined, [0] * self.lanes)

    def choose(self, first, second, lanes):
        """Return the lanes named, counted through the first and on through the second."""
        named = ir.Constant(ir.VectorType(_WORD, len(lanes)), lanes)
        return self.builder.shuffle_vector(first, second, named)

    def add(self, first, second):
        return self.builder.fadd(first, second, flags=self.flags)

    def subtract(self, first, second):
        return self.builder.fsub(first, second, flags=self.flags)

    def times(self, first, second):
        return self.builder.fmul(first, second, flags=self.flags)

    def place(self, data, at, more: int = 0, kind=None):
        """Return the address of a vector of elements, ``more`` behind ``at``."""
        where = self.builder.add(at, ir.Constant(at.type, more)) if more else at
        kind = self.floats if kind is None else kind
        return self.builder.bitcast(self.builder.gep(data, [where]), kind.as_pointer())

    def load(self, data, at, more: int = 0):
        return self.builder.load(self.place(data, at, more), align=4)

    def store(self, value, data, at, more: int = 0) -> None:
        self.builder.store(value, self.place(data, at, more), align=4)

    def load_shorts(self, data, at, more: int = 0):
        """Return unsigned 16-bit numbers as floats."""
        found = self.builder.load(self.place(data, at, more, self.shorts), align=2)
        return self.builder.uitofp(self.builder.zext(found, self.words), self.floats)


def _data(context, builder, signature, arguments, number: int):
    """Return the address of the first element of an array argument."""
    return context.make_array(signature.args[number])(context, builder, arguments[number]).data


@intrinsic
def add_nine(typing_context, cells, at, stride, taps, first):
    """Add one observation to the cells of the nine HR pixels around it, in place.

    Cell (a, b) gets w · y_a · x_b · (y_a x_b … y_{a+2} x_{b+2}): numbers 0 to 12 are the
    pixel's couplings in the order of the planes of ``kernels.spread_cells``; number 13 gets
    w · y_a · x_b times the grey level.

    Parameters
    ----------
    cells : float32 array
    at, stride : intp
        Of the first of the nine cells; from a row of cells to the next.
    taps : float32 array
        x₀ x₁ x₂, with w in front y₀y₀ y₀y₁ y₀y₂ y₁y₁ y₁y₂ y₂y₂, and with the grey level too
        y₀ y₁ y₂, ``TOGETHER`` apart. What is in memory is spread over lanes as it is loaded,
        which costs next to nothing.
    first : intp
        Of the observation's first number.
    """
    signature = types.void(cells, types.intp, types.intp, taps, types.intp)

    def generate(context, builder, signature, arguments):
        cell = _Vectors(builder, CELL)
        data, numbers = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        start, stride, first = arguments[1], arguments[2], arguments[4]

        def number(place: int):
            where = builder.add(first, ir.Constant(first.type, TOGETHER * place))
            return builder.load(builder.gep(numbers, [where]))

        x = [number(b) for b in range(3)]
        taps = cell.zeros
        for lane, tap_x in enumerate((*x, ir.Constant(_FLOAT, 1.0))):
            taps = builder.insert_element(taps, tap_x, ir.Constant(_WORD, lane))

        def tap(column: int) -> int:
            return column if 0 <= column <= 2 else CELL  # beyond: the zero of the other vector

        across = []
        for b in range(3):
            below = [tap(b + d) for d in range(-2, 3)]
            lanes = [tap(b), tap(b + 1), tap(b + 2), *below, *below, 3, CELL, CELL]
            across.append(cell.times(cell.choose(taps, cell.zeros, lanes), cell.spread(x[b])))
        place = 3
        for a in range(3):
            rows = [cell.zeros] * 3
            for d in range(3 - a):
                rows[d] = cell.spread(number(place))
                place += 1
            near = cell.choose(rows[0], rows[1], [*range(3), *range(CELL + 3, 2 * CELL)])
            far = cell.choose(
                rows[2], cell.spread(number(9 + a)), [*range(13), *range(CELL + 13, 2 * CELL)]
            )
            down = cell.choose(near, far, [*range(8), *range(CELL + 8, 2 * CELL)])
            line = builder.add(start, builder.mul(stride, ir.Constant(stride.type, a)))
            for b in range(3):
                before = cell.load(data, line, CELL * b)
                cell.store(cell.add(before, cell.times(down, across[b])), data, line, CELL * b)
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
def planes_of_eight(typing_context, cells, at, inverse, planes, to, plane, values, to_value):
    """Turn the cells of eight pixels into eight entries of each plane.

    Parameters
    ----------
    cells : float32 array
        Of :func:`add_nine`.
    at : intp
        Of the first cell.
    inverse : float32
        Couplings are multiplied by it, and rounded.
    planes : uint16 array
    to, plane : intp
        Of the first of the eight in plane 0; from plane to plane.
    values, to_value : float32 array, intp
        Where the last number of the cells goes.
    """
    signature = types.void(
        cells, types.intp, types.float32, planes, types.intp, types.intp, values, types.intp
    )
    last = 13

    def generate(context, builder, signature, arguments):
        eight = _Vectors(builder)
        source, target, right = (
            _data(context, builder, signature, arguments, number) for number in (0, 3, 6)
        )
        at, to, plane = arguments[1], arguments[4], arguments[5]
        inverse = eight.spread(arguments[2])
        half = eight.halves
        for part in range(2):
            rows = [eight.load(source, at, CELL * pixel + LANES * part) for pixel in range(LANES)]
            for _ in range(3):  # three perfect shuffles transpose eight by eight
                pairs = [(rows[i], rows[i + 4]) for i in range(4)]
                low = [lane // 2 + LANES * (lane % 2) for lane in range(LANES)]
                high = [number + 4 for number in low]
                rows = [eight.choose(*pair, lanes) for pair in pairs for lanes in (low, high)]
            for lane, row in enumerate(rows):
                number = LANES * part + lane
                if number == last:
                    eight.store(row, right, arguments[7])
                if number >= last:
                    continue
                whole = builder.fptosi(eight.add(eight.times(row, inverse), half), eight.words)
                where = builder.add(to, builder.mul(plane, ir.Constant(plane.type, number)))
                address = eight.place(target, where, kind=eight.shorts)
                builder.store(builder.trunc(whole, eight.shorts), address, align=2)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def stencil_wide(
    typing_context, couplings, at, plane, pitch, s0, s1, s2, image, g0, g1, g2, g3, g4, out, to
):
    """Write the symmetric 5 × 5 stencil at sixteen pixels of a row.

    Parameters
    ----------
    couplings : uint16 array
        Thirteen planes, see ``kernels.spread_cells``.
    at, plane, pitch : intp
        Of the first pixel in plane 0; from plane to plane; from row to row.
    s0, s1, s2 : float32
        What a unit of the couplings is worth: in this row, one above, two above.
    image : float32 array
    g0 … g4 : intp
        Of the first pixel in the rows two above to two below.
    out, to : float32 array, intp
        Where the result goes.
    """
    signature = types.void(
        couplings, *(types.intp,) * 3, *(types.float32,) * 3, image, *(types.intp,) * 5,
        out, types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        planes, pixels, result = (
            _data(context, builder, signature, arguments, number) for number in (0, 7, 13)
        )
        first, plane, pitch = arguments[1:4]
        units, rows, to = arguments[4:7], arguments[8:13], arguments[14]

        def coupling(number: int, up: int, dx: int):
            where = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            where = builder.sub(where, builder.mul(pitch, ir.Constant(pitch.type, up)))
            return wide.load_shorts(planes, where, dx)

        def pixel(row: int, dx: int):
            return wide.load(pixels, rows[row], dx)

        own = wide.times(coupling(0, 0, 0), pixel(2, 0))
        below, above, far = wide.zeros, wide.zeros, wide.zeros
        for d in (1, 2):
            own = wide.add(own, wide.times(coupling(d, 0, 0), pixel(2, d)))
            below = wide.add(below, wide.times(coupling(d, 0, -d), pixel(2, -d)))
        for d in range(-2, 3):
            own = wide.add(own, wide.times(coupling(5 + d, 0, 0), pixel(3, d)))
            below = wide.add(below, wide.times(coupling(10 + d, 0, 0), pixel(4, d)))
            above = wide.add(above, wide.times(coupling(5 + d, 1, -d), pixel(1, -d)))
            far = wide.add(far, wide.times(coupling(10 + d, 2, -d), pixel(0, -d)))
        total = wide.times(wide.add(own, below), wide.spread(units[0]))
        total = wide.add(total, wide.times(above, wide.spread(units[1])))
        total = wide.add(total, wide.times(far, wide.spread(units[2])))
        wide.store(total, result, to)
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


_NEIGHBOURS = ((0, 0, 1), (1, 1, -1), (2, 1, 0), (3, 1, 1))
"""Plane of the prior's weights, rows down and columns right of what it couples a pixel with."""


@intrinsic
def pull_wide(
    typing_context, weights, at, plane, pitch, image, up, row, down, strength, share, least,
    residual, softness, to,
):  # fmt: skip
    """Take the prior's pull off the residual of sixteen pixels, and write their softness.

    The pull is ``strength`` times the weighted graph Laplacian, diagonals counting half; the
    softness is 1 / (share · its diagonal + least).

    Parameters
    ----------
    weights : uint16 array
        Of ``sweeps.weigh_prior``.
    at, plane, pitch : intp
        Of the first pixel in plane 0; from plane to plane; from row to row.
    image : float32 array
    up, row, down : intp
        Of the first pixel in the row above, this one and the row below.
    residual, softness, to : float32 arrays, intp
        Changed in place, and overwritten.
    """
    signature = types.void(
        weights, *(types.intp,) * 3, image, *(types.intp,) * 3, *(types.float32,) * 3,
        residual, softness, types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        planes, pixels, target, soft = (
            _data(context, builder, signature, arguments, number) for number in (0, 4, 11, 12)
        )
        first, plane, pitch = arguments[1:4]
        above, row, below = arguments[5:8]
        strength, share, least = arguments[8:11]
        to = arguments[13]
        centre = wide.load(pixels, row)
        pulls, sums = [wide.zeros, wide.zeros], [wide.zeros, wide.zeros]
        for number, down, dx in _NEIGHBOURS:
            kind = number % 2
            own = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            back = builder.sub(own, builder.mul(pitch, ir.Constant(pitch.type, down)))
            for where, shift, start, sign in (
                (own, 0, below if down else row, 1), (back, -dx, above if down else row, -1),
            ):  # fmt: skip
                weight = wide.load_shorts(planes, where, shift)
                away = wide.subtract(centre, wide.load(pixels, start, sign * dx))
                pulls[kind] = wide.add(pulls[kind], wide.times(weight, away))
                sums[kind] = wide.add(sums[kind], weight)
        half = wide.halves
        pull, total = (
            wide.times(wide.add(straight, wide.times(diagonal, half)), wide.spread(strength))
            for straight, diagonal in (pulls, sums)
        )
        wide.store(wide.subtract(wide.load(target, to), pull), target, to)
        stiff = wide.add(wide.times(total, wide.spread(share)), wide.spread(least))
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
        centre = wide.load(pixels, row)
        sums = [wide.zeros, wide.zeros]
        for number, down, dx in _NEIGHBOURS:
            kind = number % 2
            where = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            away = wide.subtract(centre, wide.load(pixels, below if down else row, dx))
            square = wide.times(wide.times(away, away), wide.load_shorts(planes, where))
            sums[kind] = wide.add(sums[kind], square)
        half = wide.halves
        wide.store(wide.add(sums[0], wide.times(sums[1], half)), result, to)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def three_wide(typing_context, image, above, own, below, out, to):
    """Write above + 2 · own + below at sixteen pixels.

    Parameters
    ----------
    image : float32 array
    above, own, below : intp
        Of the first pixel.
    out, to : float32 array, intp
        Where the result goes.
    """
    signature = types.void(image, types.intp, types.intp, types.intp, out, types.intp)

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        pixels, result = (_data(context, builder, signature, arguments, n) for n in (0, 4))
        above, own, below = (wide.load(pixels, place) for place in arguments[1:4])
        total = wide.add(wide.add(above, wide.times(wide.constant(2.0), own)), below)
        wide.store(total, result, arguments[5])
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def shares_wide(typing_context, sums, at, pitch, square, least, floor, strengths, out, to, plane):
    """Write m (s / (t + l) + f) at sixteen pixels of four planes, t weighted 1 2 1 along the row.

    One division serves all four.

    Parameters
    ----------
    sums : float32 array
    at, pitch : intp
        Of the first of sixteen pixels and two more; from plane to plane.
    square, least, floor : float32
        s, l, f.
    strengths : float32 array
        m, of which the sixteen from its element ``at`` on are taken.
    out, to, plane : float32 array, intp, intp
        Where the result of plane 0 goes; from plane to plane.
    """
    signature = types.void(
        sums, types.intp, types.intp, *(types.float32,) * 3, strengths, out, types.intp,
        types.intp,
    )  # fmt: skip

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        values, strong, result = (
            _data(context, builder, signature, arguments, n) for n in (0, 6, 7)
        )
        at, pitch, to, plane = arguments[1], arguments[2], arguments[8], arguments[9]
        square, least, floor = (wide.spread(number) for number in arguments[3:6])
        totals, where = [], at
        for _ in range(4):
            first, middle, last = (wide.load(values, where, dx) for dx in range(3))
            total = wide.add(wide.add(first, wide.times(wide.constant(2.0), middle)), last)
            totals.append(wide.add(total, least))
            where = builder.add(where, pitch)
        pairs = [wide.times(totals[0], totals[1]), wide.times(totals[2], totals[3])]
        inverse = builder.fdiv(square, wide.times(*pairs), flags=wide.flags)
        of_pairs = [wide.times(inverse, pairs[1]), wide.times(inverse, pairs[0])]
        strength, where = wide.load(strong, at), to
        for number in range(4):
            share = wide.times(of_pairs[number // 2], totals[number ^ 1])
            wide.store(wide.times(strength, wide.add(share, floor)), result, where)
            where = builder.add(where, plane)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def round_wide(typing_context, sums, at, out, to):
    """Write sixteen sums of numbers, weighted 1 2 1 along the row, rounded to 16 bits.

    Parameters
    ----------
    sums, at : float32 array, intp
        Of the first of sixteen numbers and two more.
    out, to : uint16 array, intp
    """
    signature = types.void(sums, types.intp, out, types.intp)

    def generate(context, builder, signature, arguments):
        wide = _Vectors(builder, WIDE)
        values, result = (_data(context, builder, signature, arguments, n) for n in (0, 2))
        first, middle, last = (wide.load(values, arguments[1], dx) for dx in range(3))
        total = wide.add(wide.add(first, wide.times(wide.constant(2.0), middle)), last)
        whole = builder.fptosi(wide.add(total, wide.halves), wide.words)
        where = wide.place(result, arguments[3], kind=wide.shorts)
        builder.store(builder.trunc(whole, wide.shorts), where, align=2)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def weigh_patches(typing_context, image, at, pitch, taps, kinds, first, out):
    """Write the sums of the pixels of eight patches beside each other, each times its tap.

    Parameters
    ----------
    image : float32 array
    at, pitch : intp
        Of the first patch's first pixel; from row to row.
    taps : float32 array
        For each kind PATCH rows of LANES, the last lane zero.
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
        totals = []
        for lane in range(LANES):
            where = builder.add(first, ir.Constant(first.type, lane))
            kind = builder.sext(builder.load(builder.gep(numbers, [where])), first.type)
            tap = builder.mul(kind, ir.Constant(first.type, PATCH * LANES))
            line, total = at, eight.zeros
            for row in range(PATCH):
                taps_of_row = eight.load(weights, tap, LANES * row)
                total = eight.add(total, eight.times(eight.load(pixels, line, lane), taps_of_row))
                line = builder.add(line, pitch)
            totals.append(total)
        # halves are added up, of more and more patches in one vector; in this order they end up
        # one after the other
        totals = [totals[lane] for lane in (0, 4, 2, 6, 1, 5, 3, 7)]
        for size in (4, 2, 1):
            count = len(totals) // 2
            low = [lane for lane in range(2 * LANES) if lane % (2 * size) < size]
            high = [lane + size for lane in low]
            totals = [
                eight.add(eight.choose(*pair, low), eight.choose(*pair, high))
                for pair in zip(totals[:count], totals[count:], strict=True)
            ]
        eight.store(totals[0], result, first)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def weigh_patch(typing_context, image, at, pitch, taps, along_x, along_y):
    """Return the sum of a patch's pixels, each times its taps along x and along y.

    Parameters
    ----------
    image : float32 array
    at, pitch : intp
        Of the patch's first pixel; from row to row.
    taps : float32 array
        In rows of LANES, the last lane zero.
    along_x, along_y : intp
        Of the first tap along either axis.
    """
    signature = types.float32(image, types.intp, types.intp, taps, types.intp, types.intp)

    def generate(context, builder, signature, arguments):
        eight = _Vectors(builder)
        pixels, weights = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        at, pitch, along_x, along_y = (arguments[n] for n in (1, 2, 4, 5))
        total, line = eight.zeros, at
        for row in range(PATCH):
            where = builder.add(along_y, ir.Constant(along_y.type, row))
            tap = eight.spread(builder.load(builder.gep(weights, [where])))
            total = eight.add(total, eight.times(eight.load(pixels, line), tap))
            line = builder.add(line, pitch)
        total = eight.times(total, eight.load(weights, along_x))
        for half in (4, 2, 1):
            turned = eight.choose(total, total, [(lane + half) % LANES for lane in range(LANES)])
            total = eight.add(total, turned)
        return builder.extract_element(total, ir.Constant(_WORD, 0))

    return signature, generate
