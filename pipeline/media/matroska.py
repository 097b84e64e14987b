"""Two things about Matroska files that the muxer is not told or gets wrong, put right in place.

The shape of a squeezed eye: Matroska's DisplayWidth and DisplayHeight are the
size of *one* eye as shown. For a file with a stereo mode FFmpeg always writes
half the coded width (height), which says "each eye in full, of square pixels".
In the half layouts the eye is shown as large as the whole coded picture, and
eyes that came in squeezed may be so still.

The light of HDR10: FFmpeg writes it of a stream that it has read it of, and no
encoder hands it on. What is written into a segment is read when segments are
joined, and so gets into every container that has a place for it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from pipeline.errors import OutputError
from pipeline.media.colorimetry import Colorimetry

_SEGMENT, _TRACKS, _TRACK_ENTRY, _VIDEO = 0x18538067, 0x1654AE6B, 0xAE, 0xE0
_PIXEL_WIDTH, _PIXEL_HEIGHT, _DISPLAY_WIDTH, _DISPLAY_HEIGHT = 0xB0, 0xBA, 0x54B0, 0x54BA
_NAME, _COLOUR, _MAX_CLL, _MAX_FALL, _MASTERING = 0x536E, 0x55B0, 0x55BC, 0x55BD, 0x55D0
_RED_X, _BRIGHTEST, _DARKEST = 0x55D1, 0x55D9, 0x55DA
_CRC32, _VOID = 0xBF, 0xEC

ROOM = " " * 192
"""Name of a track that leaves room for what :func:`set_light` says: 140 bytes, and longer sizes."""

_HEADER_BYTES = 1 << 16
"""How much of the file's start is read; the tracks stand well within it."""


@dataclass(frozen=True, kw_only=True)
class _Element:
    """One EBML element: its id, and where it and its content lie in the file (end exclusive)."""

    element_id: int
    begin: int
    """Where its id stands."""
    start: int
    """Where its content begins."""
    end: int


def set_eye_shape(path: Path, aspect: Fraction) -> None:
    """Set the display size of the first video track, that of one eye. Modifies the file.

    Where a number takes more bytes than the muxer left for it, both sides are
    halved: the same shape.

    Parameters
    ----------
    path : Path
        A Matroska or WebM file with a stereo mode.
    aspect : Fraction
        Shape of one eye as shown over that of the whole coded picture, each width over
        height: 1 for the half layouts, ½ for side by side, 2 for top and bottom.

    Raises
    ------
    OutputError
        If the file has no such track.
    """

    def rewrite(head: bytearray, entry: _Element) -> None:
        _rewrite_display_size(head, _child(head, entry, _VIDEO), aspect)

    _rewrite_track(path, rewrite)


def set_light(path: Path, colorimetry: Colorimetry) -> None:
    """Say the mastering display and the light levels of the first track. Modifies the file.

    Parameters
    ----------
    path : Path
        A Matroska file whose first track is video that says its colours and is called
        :data:`ROOM`; it has no name then.
    colorimetry : Colorimetry

    Raises
    ------
    OutputError
        If the file has no such track.
    """
    added = _light(colorimetry)

    def rewrite(head: bytearray, entry: _Element) -> None:
        parts = []
        for child in _children(head, entry):
            if child.element_id == _VIDEO:
                parts.append(_with_light(head, child, added))
            elif child.element_id != _NAME:
                parts.append(bytes(head[child.begin : child.end]))
        room = entry.end - entry.start - sum(map(len, parts))
        head[entry.start : entry.end] = b"".join([*parts, _void(room)])

    _rewrite_track(path, rewrite)


def _light(colorimetry: Colorimetry) -> bytes:
    """Return the elements of a Colour that say what HDR10 says of light."""
    said = b""
    level, display = colorimetry.light_level, colorimetry.mastering
    if level is not None:
        said += _element(_MAX_CLL, level.pixel.to_bytes(4, "big"))
        said += _element(_MAX_FALL, level.frame.to_bytes(4, "big"))
    if display is not None:
        points = (display.red, display.green, display.blue, display.white)
        values = [value for point in points for value in point]
        numbered = [*enumerate(values, _RED_X), (_BRIGHTEST, display.brightest)]
        numbered.append((_DARKEST, display.darkest))
        floats = [_element(number, struct.pack(">d", value)) for number, value in numbered]
        said += _element(_MASTERING, b"".join(floats))
    return said


def _with_light(head: bytearray, video: _Element, added: bytes) -> bytes:
    """Return the element of a video track with more in its Colour."""
    parts = []
    for child in _children(head, video):
        content = bytes(head[child.start : child.end])
        is_colour = child.element_id == _COLOUR
        parts.append(_element(child.element_id, content + added if is_colour else content))
    return _element(_VIDEO, b"".join(parts))


def _rewrite_track(path: Path, rewrite: Callable[[bytearray, _Element], None]) -> None:
    """Have the first track's entry changed in place; it keeps its length."""
    with path.open("r+b") as file:
        head = bytearray(file.read(_HEADER_BYTES))
        try:
            tracks = _child(head, _child(head, _whole(head), _SEGMENT), _TRACKS)
            rewrite(head, _child(head, tracks, _TRACK_ENTRY))
        except (KeyError, IndexError) as error:
            raise OutputError(f"{path}: no video track found in the Matroska header") from error
        _refresh_checksum(head, tracks)
        file.seek(0)
        file.write(head)


def _rewrite_display_size(head: bytearray, video: _Element, aspect: Fraction) -> None:
    sides = [
        (_child(head, video, coded), _child(head, video, shown))
        for coded, shown in ((_PIXEL_WIDTH, _DISPLAY_WIDTH), (_PIXEL_HEIGHT, _DISPLAY_HEIGHT))
    ]
    width, height = (_number(head, coded) for coded, _ in sides)
    sizes = [width * aspect.numerator, height * aspect.denominator]
    while any(
        size >= 1 << 8 * (shown.end - shown.start)
        for size, (_, shown) in zip(sizes, sides, strict=True)
    ):
        sizes = [size // 2 for size in sizes]
    for size, (_, shown) in zip(sizes, sides, strict=True):
        head[shown.start : shown.end] = size.to_bytes(shown.end - shown.start, "big")


def _refresh_checksum(head: bytearray, master: _Element) -> None:
    """Recompute the CRC-32 that may open a master element (RFC 8794 §11.3.1)."""
    first = next(_children(head, master))
    if first.element_id == _CRC32:
        checksum = zlib.crc32(head[first.end : master.end])
        head[first.start : first.end] = checksum.to_bytes(4, "little")


def _whole(head: bytearray) -> _Element:
    return _Element(element_id=0, begin=0, start=0, end=len(head))


def _child(head: bytearray, parent: _Element, element_id: int) -> _Element:
    """Return the first child with that id; KeyError where there is none."""
    for child in _children(head, parent):
        if child.element_id == element_id:
            return child
    raise KeyError(element_id)


def _children(head: bytearray, parent: _Element) -> Iterator[_Element]:
    at = parent.start
    while at < min(parent.end, len(head)):
        begin = at
        id_length = _vint_length(head[at])
        element_id = int.from_bytes(head[at : at + id_length], "big")
        at += id_length
        size_length = _vint_length(head[at])
        coded = int.from_bytes(head[at : at + size_length], "big")
        size = coded - (1 << 7 * size_length)
        at += size_length
        unknown = size == (1 << 7 * size_length) - 1
        end = parent.end if unknown else at + size
        yield _Element(element_id=element_id, begin=begin, start=at, end=end)
        at = end


def _element(element_id: int, content: bytes, size_length: int = 2) -> bytes:
    """Return an EBML element whose size takes so many bytes."""
    size = len(content) + (1 << 7 * size_length)
    number = element_id.to_bytes((element_id.bit_length() + 7) // 8, "big")
    return number + size.to_bytes(size_length, "big") + content


def _void(length: int) -> bytes:
    """Return so many bytes, 9 or more, that say nothing."""
    return _element(_VOID, bytes(length - 9), size_length=8)


def _vint_length(first: int) -> int:
    """Return the bytes of a variable-size integer that starts with this byte (RFC 8794 §4)."""
    return 9 - first.bit_length()


def _number(head: bytearray, element: _Element) -> int:
    return int.from_bytes(head[element.start : element.end], "big")
