"""What loops are written with that work on several pixels at once, as vectors.

LLVM's ``<8 x float>``, which any processor has or emulates, for what the compiler does not
vectorise by itself. Arrays are addressed by a number of elements from their first one, and nothing
is checked.
"""

from __future__ import annotations

from llvmlite import ir
from numba import types

LANES = 8
"""Pixels worked on together."""

WIDE = 16
"""The same where all is arithmetic, for processors that have such vectors."""

_FLOAT, _WORD, _SHORT, _HALF = ir.FloatType(), ir.IntType(32), ir.IntType(16), ir.HalfType()

LARGEST = 65504.0
"""Of what numbers of sixteen bits hold."""


class Vectors:
    """Writes instructions on so many numbers; sums may be contracted to multiply-adds."""

    def __init__(
        self,
        builder: ir.IRBuilder,
        lanes: int = LANES,
        flags: tuple[str, ...] = ("contract", "reassoc", "nsz", "arcp"),
    ) -> None:
        self.builder = builder
        self.flags = flags
        self.lanes = lanes
        self.floats, self.words, self.shorts = (
            ir.VectorType(kind, lanes) for kind in (_FLOAT, _WORD, _SHORT)
        )
        self.sixteen_bits = ir.VectorType(_HALF, lanes)
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
        """Return the sums."""
        return self.builder.fadd(first, second, flags=self.flags)

    def subtract(self, first, second):
        """Return what the first ones are more."""
        return self.builder.fsub(first, second, flags=self.flags)

    def times(self, first, second):
        """Return the products."""
        return self.builder.fmul(first, second, flags=self.flags)

    def place(self, data, at, more: int = 0, kind=None):
        """Return the address of a vector of elements, ``more`` behind ``at``."""
        where = self.builder.add(at, ir.Constant(at.type, more)) if more else at
        kind = self.floats if kind is None else kind
        return self.builder.bitcast(self.builder.gep(data, [where]), kind.as_pointer())

    def load(self, data, at, more: int = 0):
        """Return a vector of elements, from ``more`` behind ``at`` on."""
        return self.builder.load(self.place(data, at, more), align=4)

    def store(self, value, data, at, more: int = 0) -> None:
        """Write a vector there."""
        self.builder.store(value, self.place(data, at, more), align=4)

    def load_kept(self, data, at, kind: types.Type):
        """Return a vector of elements kept as float32, or as uint16: the bits of float16."""
        if kind == types.float32:
            return self.load(data, at)
        found = self.builder.load(self.place(data, at, kind=self.sixteen_bits), align=2)
        return self.builder.fpext(found, self.floats)

    def keep(self, value, data, at, kind: types.Type) -> None:
        """Write a vector of elements as :meth:`load_kept` reads them, cut off at the largest."""
        if kind == types.float32:
            self.store(value, data, at)
            return
        for sign, bound in (("<", LARGEST), (">", -LARGEST)):
            most = self.constant(bound)
            value = self.builder.select(self.builder.fcmp_ordered(sign, value, most), value, most)
        found = self.builder.fptrunc(value, self.sixteen_bits)
        self.builder.store(found, self.place(data, at, kind=self.sixteen_bits), align=2)

    def load_counts(self, data, at, kind: types.Type, more: int = 0):
        """Return unsigned numbers of 8 or 16 bits as floats."""
        counts = ir.VectorType(ir.IntType(kind.bitwidth), self.lanes)
        where = self.place(data, at, more, counts)
        found = self.builder.load(where, align=kind.bitwidth // 8)
        return self.builder.uitofp(self.builder.zext(found, self.words), self.floats)


def data_of(context, builder, signature, arguments, number: int):
    """Return the address of the first element of an array argument."""
    return context.make_array(signature.args[number])(context, builder, arguments[number]).data
