"""Eight pixels at once: the loops that the compiler does not vectorise by itself.

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

CELL = 16
"""Numbers kept for each HR pixel while observations are gathered, see :func:`add_nine`."""

TOGETHER = 128
"""Observations whose taps are worked out together, before they are added one by one."""

PATCH = 7
"""Side of the patches of :func:`weigh_patch`, pixels."""

_FLOAT, _WORD, _SHORT = ir.FloatType(), ir.IntType(32), ir.IntType(16)
_FLOATS = ir.VectorType(_FLOAT, LANES)
_WORDS = ir.VectorType(_WORD, LANES)
_SHORTS = ir.VectorType(_SHORT, LANES)
_ZEROS = ir.Constant(_FLOATS, [0.0] * LANES)


class _Eight:
    """Writes instructions on eight numbers; sums may be contracted to multiply-adds."""

    flags = ("contract", "reassoc", "nsz", "arcp")

    def __init__(self, builder: ir.IRBuilder) -> None:
        self.builder = builder

    def spread(self, number):
        """Return eight times the same number."""
        undefined = ir.Constant(_FLOATS, ir.Undefined)
        first = self.builder.insert_element(undefined, number, ir.Constant(_WORD, 0))
        return self.builder.shuffle_vector(first, undefined, ir.Constant(_WORDS, [0] * LANES))

    def choose(self, first, second, lanes):
        """Return the lanes named, 0 to 7 of the first and 8 to 15 of the second."""
        return self.builder.shuffle_vector(first, second, ir.Constant(_WORDS, lanes))

    def add(self, first, second):
        return self.builder.fadd(first, second, flags=self.flags)

    def subtract(self, first, second):
        return self.builder.fsub(first, second, flags=self.flags)

    def times(self, first, second):
        return self.builder.fmul(first, second, flags=self.flags)

    def place(self, data, at, more: int = 0, kind=_FLOATS):
        """Return the address of eight elements, ``more`` behind ``at``."""
        where = self.builder.add(at, ir.Constant(at.type, more)) if more else at
        return self.builder.bitcast(self.builder.gep(data, [where]), kind.as_pointer())

    def load(self, data, at, more: int = 0):
        return self.builder.load(self.place(data, at, more), align=4)

    def store(self, value, data, at, more: int = 0) -> None:
        self.builder.store(value, self.place(data, at, more), align=4)

    def load_shorts(self, data, at, more: int = 0):
        """Return eight unsigned 16-bit numbers as floats."""
        found = self.builder.load(self.place(data, at, more, _SHORTS), align=2)
        return self.builder.uitofp(self.builder.zext(found, _WORDS), _FLOATS)


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
        eight = _Eight(builder)
        data, numbers = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        start, stride, first = arguments[1], arguments[2], arguments[4]

        def number(place: int):
            where = builder.add(first, ir.Constant(first.type, TOGETHER * place))
            return builder.load(builder.gep(numbers, [where]))

        x = [number(b) for b in range(3)]
        taps = _ZEROS
        for lane, tap_x in enumerate((*x, ir.Constant(_FLOAT, 1.0))):
            taps = builder.insert_element(taps, tap_x, ir.Constant(_WORD, lane))

        def tap(column: int) -> int:
            return column if 0 <= column <= 2 else LANES  # beyond: the zero of the other vector

        across = []
        for b in range(3):
            below = [tap(b + d) for d in range(-2, 3)]
            own = eight.spread(x[b])
            low = eight.choose(taps, _ZEROS, [tap(b), tap(b + 1), tap(b + 2), *below])
            high = eight.choose(taps, _ZEROS, [*below, 3, LANES, LANES])
            across.append((eight.times(low, own), eight.times(high, own)))
        place = 3
        for a in range(3):
            rows = [_ZEROS] * 3
            for d in range(3 - a):
                rows[d] = eight.spread(number(place))
                place += 1
            right = eight.spread(number(9 + a))
            low = eight.choose(rows[0], rows[1], [0, 1, 2, *range(LANES + 3, 2 * LANES)])
            high = eight.choose(rows[2], right, [0, 1, 2, 3, 4, *range(LANES + 5, 2 * LANES)])
            line = builder.add(start, builder.mul(stride, ir.Constant(stride.type, a)))
            for b in range(3):
                for half, (down, along) in enumerate(zip((low, high), across[b], strict=True)):
                    more = CELL * b + LANES * half
                    before = eight.load(data, line, more)
                    eight.store(eight.add(before, eight.times(down, along)), data, line, more)
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
        eight = _Eight(builder)
        source, target, right = (
            _data(context, builder, signature, arguments, number) for number in (0, 3, 6)
        )
        at, to, plane = arguments[1], arguments[4], arguments[5]
        inverse = eight.spread(arguments[2])
        half = ir.Constant(_FLOATS, [0.5] * LANES)
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
                whole = builder.fptosi(eight.add(eight.times(row, inverse), half), _WORDS)
                where = builder.add(to, builder.mul(plane, ir.Constant(plane.type, number)))
                address = eight.place(target, where, kind=_SHORTS)
                builder.store(builder.trunc(whole, _SHORTS), address, align=2)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def stencil_eight(
    typing_context, couplings, at, plane, pitch, s0, s1, s2, image, g0, g1, g2, g3, g4, out, to
):
    """Write the symmetric 5 × 5 stencil at eight pixels of a row.

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
        eight = _Eight(builder)
        planes, pixels, result = (
            _data(context, builder, signature, arguments, number) for number in (0, 7, 13)
        )
        first, plane, pitch = arguments[1:4]
        units, rows, to = arguments[4:7], arguments[8:13], arguments[14]

        def coupling(number: int, up: int, dx: int):
            where = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            where = builder.sub(where, builder.mul(pitch, ir.Constant(pitch.type, up)))
            return eight.load_shorts(planes, where, dx)

        def pixel(row: int, dx: int):
            return eight.load(pixels, rows[row], dx)

        own = eight.times(coupling(0, 0, 0), pixel(2, 0))
        below, above, far = _ZEROS, _ZEROS, _ZEROS
        for d in (1, 2):
            own = eight.add(own, eight.times(coupling(d, 0, 0), pixel(2, d)))
            below = eight.add(below, eight.times(coupling(d, 0, -d), pixel(2, -d)))
        for d in range(-2, 3):
            own = eight.add(own, eight.times(coupling(5 + d, 0, 0), pixel(3, d)))
            below = eight.add(below, eight.times(coupling(10 + d, 0, 0), pixel(4, d)))
            above = eight.add(above, eight.times(coupling(5 + d, 1, -d), pixel(1, -d)))
            far = eight.add(far, eight.times(coupling(10 + d, 2, -d), pixel(0, -d)))
        total = eight.times(eight.add(own, below), eight.spread(units[0]))
        total = eight.add(total, eight.times(above, eight.spread(units[1])))
        total = eight.add(total, eight.times(far, eight.spread(units[2])))
        eight.store(total, result, to)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def blur_of_eight(
    typing_context, image, middle, a1, b1, a2, b2, a3, b3, tap0, tap1, tap2, tap3, out, to
):
    """Write tap0 · middle + tap1 · (a1 + b1) + tap2 · (a2 + b2) + tap3 · (a3 + b3).

    Parameters
    ----------
    image : float32 array
    middle, a1 … b3 : intp
        Of the first of eight pixels, each.
    """
    signature = types.void(image, *(types.intp,) * 7, *(types.float32,) * 4, out, types.intp)

    def generate(context, builder, signature, arguments):
        eight = _Eight(builder)
        pixels = _data(context, builder, signature, arguments, 0)
        result = _data(context, builder, signature, arguments, 12)
        places, taps = arguments[1:8], [eight.spread(tap) for tap in arguments[8:12]]
        total = eight.times(eight.load(pixels, places[0]), taps[0])
        for number in range(1, 4):
            pair = (eight.load(pixels, place) for place in places[2 * number - 1 : 2 * number + 1])
            total = eight.add(total, eight.times(eight.add(*pair), taps[number]))
        eight.store(total, result, arguments[13])
        return context.get_dummy_value()

    return signature, generate


_NEIGHBOURS = ((0, 0, 1), (1, 1, -1), (2, 1, 0), (3, 1, 1))
"""Plane of the prior's weights, rows down and columns right of what it couples a pixel with."""


@intrinsic
def pull_of_eight(
    typing_context, weights, at, plane, pitch, image, up, row, down, strength, share, least,
    residual, softness, to,
):  # fmt: skip
    """Take the prior's pull off the residual of eight pixels, and write their softness.

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
        eight = _Eight(builder)
        planes, pixels, target, soft = (
            _data(context, builder, signature, arguments, number) for number in (0, 4, 11, 12)
        )
        first, plane, pitch = arguments[1:4]
        above, row, below = arguments[5:8]
        strength, share, least = arguments[8:11]
        to = arguments[13]
        centre = eight.load(pixels, row)
        pulls, sums = [_ZEROS, _ZEROS], [_ZEROS, _ZEROS]
        for number, down, dx in _NEIGHBOURS:
            kind = number % 2
            own = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            back = builder.sub(own, builder.mul(pitch, ir.Constant(pitch.type, down)))
            for where, shift, start, sign in (
                (own, 0, below if down else row, 1), (back, -dx, above if down else row, -1),
            ):  # fmt: skip
                weight = eight.load_shorts(planes, where, shift)
                away = eight.subtract(centre, eight.load(pixels, start, sign * dx))
                pulls[kind] = eight.add(pulls[kind], eight.times(weight, away))
                sums[kind] = eight.add(sums[kind], weight)
        half = ir.Constant(_FLOATS, [0.5] * LANES)
        pull, total = (
            eight.times(eight.add(straight, eight.times(diagonal, half)), eight.spread(strength))
            for straight, diagonal in (pulls, sums)
        )
        eight.store(eight.subtract(eight.load(target, to), pull), target, to)
        stiff = eight.add(eight.times(total, eight.spread(share)), eight.spread(least))
        ones = ir.Constant(_FLOATS, [1.0] * LANES)
        eight.store(builder.fdiv(ones, stiff, flags=eight.flags), soft, to)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def bend_of_eight(typing_context, weights, at, plane, image, row, down, out, to):
    """Write the weighted squares of what eight pixels differ by from those ahead of them.

    Diagonals count half; arguments as of :func:`pull_of_eight`.
    """
    signature = types.void(
        weights, types.intp, types.intp, image, types.intp, types.intp, out, types.intp
    )

    def generate(context, builder, signature, arguments):
        eight = _Eight(builder)
        planes, pixels, result = (
            _data(context, builder, signature, arguments, number) for number in (0, 3, 6)
        )
        first, plane = arguments[1:3]
        row, below, to = arguments[4], arguments[5], arguments[7]
        centre = eight.load(pixels, row)
        sums = [_ZEROS, _ZEROS]
        for number, down, dx in _NEIGHBOURS:
            kind = number % 2
            where = builder.add(first, builder.mul(plane, ir.Constant(plane.type, number)))
            away = eight.subtract(centre, eight.load(pixels, below if down else row, dx))
            square = eight.times(eight.times(away, away), eight.load_shorts(planes, where))
            sums[kind] = eight.add(sums[kind], square)
        half = ir.Constant(_FLOATS, [0.5] * LANES)
        eight.store(eight.add(sums[0], eight.times(sums[1], half)), result, to)
        return context.get_dummy_value()

    return signature, generate


@intrinsic
def weigh_patch(typing_context, image, at, pitch, taps, first):
    """Return the sum of a patch's pixels, each times its tap.

    Parameters
    ----------
    image : float32 array
    at, pitch : intp
        Of the patch's first pixel; from row to row.
    taps : float32 array
        PATCH rows of LANES, the last lane zero.
    first : intp
        Of the first tap.
    """
    signature = types.float32(image, types.intp, types.intp, taps, types.intp)

    def generate(context, builder, signature, arguments):
        eight = _Eight(builder)
        pixels, weights = (_data(context, builder, signature, arguments, n) for n in (0, 3))
        at, pitch, first = arguments[1], arguments[2], arguments[4]
        total = _ZEROS
        for row in range(PATCH):
            where = builder.add(at, builder.mul(pitch, ir.Constant(pitch.type, row)))
            line = eight.times(eight.load(pixels, where), eight.load(weights, first, LANES * row))
            total = eight.add(total, line)
        for half in (4, 2, 1):
            turned = eight.choose(total, total, [(lane + half) % LANES for lane in range(LANES)])
            total = eight.add(total, turned)
        return builder.extract_element(total, ir.Constant(_WORD, 0))

    return signature, generate
