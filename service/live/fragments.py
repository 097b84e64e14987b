"""Cutting the byte stream of a fragmented MP4 into its init segment and its fragments.

Pure: bytes in, values out. Box structure after ISO/IEC 14496-12.
"""

from __future__ import annotations

import dataclasses
import struct
from collections.abc import Iterator
from dataclasses import dataclass

MAX_BOX = 64 << 20
"""Largest box taken, bytes; a length above it is damage."""

_NOT_SYNC = 0x10000
"""``sample_is_non_sync_sample`` of the sample flags (8.8.3.1)."""


class DamagedStreamError(ValueError):
    """The bytes are no fragmented MP4."""


@dataclass(frozen=True, kw_only=True)
class Init:
    """What a player needs first: ``ftyp`` and ``moov``."""

    data: bytes
    codec: str
    """As in RFC 6381: ``avc1.640028``."""
    timescale: int
    """Ticks a second of the fragments' times."""
    width: int
    """Of the coded picture, pixels."""
    height: int


@dataclass(frozen=True, kw_only=True)
class Fragment:
    """One ``moof`` and ``mdat``."""

    data: bytes
    start: int
    """Decoding time of its first sample, ticks."""
    duration: int
    """Of all its samples, ticks."""
    is_key: bool
    """Whether a player can begin with it."""


def boxes(data: bytes, begin: int = 0, end: int | None = None) -> Iterator[tuple[str, int, int]]:
    """Yield (type, begin of the content, end) of every whole box between two offsets."""
    end = len(data) if end is None else end
    while begin + 8 <= end:
        (size,) = struct.unpack_from(">I", data, begin)
        if size < 8 or begin + size > end:
            return
        yield data[begin + 4 : begin + 8].decode("latin-1"), begin + 8, begin + size
        begin += size


class Splitter:
    """Takes bytes as they come; gives whole parts."""

    def __init__(self) -> None:
        self._rest = b""
        self._head = b""
        self._moof = b""
        self._init: Init | None = None

    def feed(self, data: bytes) -> list[Init | Fragment]:
        """Return the parts that ``data`` completes.

        Raises
        ------
        DamagedStreamError
            If the bytes are no fragmented MP4.
        """
        self._rest += data
        parts: list[Init | Fragment] = []
        while len(self._rest) >= 8:
            size, name = struct.unpack_from(">I4s", self._rest)
            if not 8 <= size <= MAX_BOX:
                raise DamagedStreamError(f"box {name!r} says that it holds {size} bytes")
            if len(self._rest) < size:
                break
            box, self._rest = self._rest[:size], self._rest[size:]
            part = self._take(name, box)
            if part is not None:
                parts.append(part)
        return parts

    def _take(self, name: bytes, box: bytes) -> Init | Fragment | None:
        if name == b"ftyp":
            self._head = box
        elif name == b"moov":
            self._init = read_init(self._head + box)
            return self._init
        elif name == b"moof":
            self._moof = box
        elif name == b"mdat":
            if self._init is None or not self._moof:
                raise DamagedStreamError("samples before the boxes that describe them")
            start, duration, is_key = _times(self._moof)
            data, self._moof = self._moof + box, b""
            return Fragment(data=data, start=start, duration=duration, is_key=is_key)
        return None


def read_init(data: bytes) -> Init:
    """Return the init segment with what a playlist and a page need of it."""
    avc1 = data.find(b"avc1", data.find(b"stsd"))
    avcc = data.find(b"avcC")
    mdhd = data.find(b"mdhd")
    if avc1 < 0 or avcc < avc1 + 32 or mdhd < 0 or len(data) < avcc + 8:
        raise DamagedStreamError("the init segment describes no H.264 track")
    version = data[mdhd + 4]
    (timescale,) = struct.unpack_from(">I", data, mdhd + (24 if version else 16))
    profile, constraints, level = data[avcc + 5 : avcc + 8]
    codec = f"avc1.{profile:02x}{constraints:02x}{level:02x}"
    width, height = struct.unpack_from(">HH", data, avc1 + 28)
    return Init(data=data, codec=codec, timescale=timescale, width=width, height=height)


def _times(moof: bytes) -> tuple[int, int, bool]:
    """Return (start, duration, whether it starts with a key frame) of a ``moof`` of one track."""
    start, total, first_flags = 0, 0, None
    default_duration = default_flags = 0
    for name, begin, _ in _children(moof):
        flags = int.from_bytes(moof[begin + 1 : begin + 4], "big")
        at = begin + 8
        if name == "tfhd":
            for bit, size in ((1, 8), (2, 4), (8, 4), (16, 4), (32, 4)):
                if not flags & bit:
                    continue
                value = int.from_bytes(moof[at : at + size], "big")
                default_duration = value if bit == 8 else default_duration
                default_flags = value if bit == 32 else default_flags
                at += size
        elif name == "tfdt":
            start = int.from_bytes(moof[begin + 4 : begin + (12 if moof[begin] else 8)], "big")
        elif name == "trun":
            (count,) = struct.unpack_from(">I", moof, begin + 4)
            at += 4 if flags & 1 else 0
            if flags & 4:
                first_flags = int.from_bytes(moof[at : at + 4], "big")
                at += 4
            step = 4 * sum(bool(flags & bit) for bit in (0x100, 0x200, 0x400, 0x800))
            for sample in range(count):
                place = at + sample * step
                duration = default_duration
                if flags & 0x100:
                    (duration,) = struct.unpack_from(">I", moof, place)
                total += duration
                if sample == 0 and flags & 0x400:
                    place += 4 * sum(bool(flags & bit) for bit in (0x100, 0x200))
                    (first_flags,) = struct.unpack_from(">I", moof, place)
    flags = default_flags if first_flags is None else first_flags
    return start, total, not flags & _NOT_SYNC


def _children(moof: bytes) -> Iterator[tuple[str, int, int]]:
    for name, begin, end in boxes(moof, 8):
        if name == "traf":
            yield from boxes(moof, begin, end)


def moved(fragment: Fragment, ticks: int, *, sequence: int) -> Fragment:
    """Return the fragment with its times shifted and its sequence number set.

    Raises
    ------
    DamagedStreamError
        If it does not say when it begins.
    """
    data = bytearray(fragment.data)
    at = data.find(b"tfdt")
    header = data.find(b"mfhd")
    if at < 0 or header < 0:
        raise DamagedStreamError("the fragment does not say when it begins")
    version = data[at + 4]
    struct.pack_into(">Q" if version else ">I", data, at + 8, fragment.start + ticks)
    struct.pack_into(">I", data, header + 8, sequence)
    return dataclasses.replace(fragment, data=bytes(data), start=fragment.start + ticks)
