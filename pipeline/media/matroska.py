"""The one thing about Matroska files that the muxer gets wrong: the shape of a squeezed eye.

Matroska's DisplayWidth and DisplayHeight are the size of *one* eye as shown.
For a file with a stereo mode FFmpeg always writes half the coded width
(height), which says "each eye in full, of square pixels". In the half layouts
the eye is shown as large as the whole coded picture, and eyes that came in
squeezed may be so still; this module says so in place.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from pipeline.errors import OutputError

_SEGMENT, _TRACKS, _TRACK_ENTRY, _VIDEO = 0x18538067, 0x1654AE6B, 0xAE, 0xE0
_PIXEL_WIDTH, _PIXEL_HEIGHT, _DISPLAY_WIDTH, _DISPLAY_HEIGHT = 0xB0, 0xBA, 0x54B0, 0x54BA
_CRC32 = 0xBF

_HEADER_BYTES = 1 << 16
"""How much of the file's start is read; the tracks stand well within it."""


@dataclass(frozen=True, kw_only=True)
class _Element:
    """One EBML element: its id, and where its content lies in the file (end exclusive)."""

    element_id: int
    start: int
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
    with path.open("r+b") as file:
        head = bytearray(file.read(_HEADER_BYTES))
        try:
            tracks = _child(head, _child(head, _whole(head), _SEGMENT), _TRACKS)
            video = _child(head, _child(head, tracks, _TRACK_ENTRY), _VIDEO)
            _rewrite_display_size(head, video, aspect)
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
    return _Element(element_id=0, start=0, end=len(head))


def _child(head: bytearray, parent: _Element, element_id: int) -> _Element:
    """Return the first child with that id; KeyError where there is none."""
    for child in _children(head, parent):
        if child.element_id == element_id:
            return child
    raise KeyError(element_id)


def _children(head: bytearray, parent: _Element) -> Iterator[_Element]:
    at = parent.start
    while at < min(parent.end, len(head)):
        id_length = _vint_length(head[at])
        element_id = int.from_bytes(head[at : at + id_length], "big")
        at += id_length
        size_length = _vint_length(head[at])
        coded = int.from_bytes(head[at : at + size_length], "big")
        size = coded - (1 << 7 * size_length)
        at += size_length
        unknown = size == (1 << 7 * size_length) - 1
        end = parent.end if unknown else at + size
        yield _Element(element_id=element_id, start=at, end=end)
        at = end


def _vint_length(first: int) -> int:
    """Return the bytes of a variable-size integer that starts with this byte (RFC 8794 §4)."""
    return 9 - first.bit_length()


def _number(head: bytearray, element: _Element) -> int:
    return int.from_bytes(head[element.start : element.end], "big")
