"""Two things about the boxes of MP4 and MOV files that FFmpeg does not write, or not tell.

How two eyes lie in one picture: FFmpeg says in Apple's ``vexu`` box (video extended usage) that
both are there, and leaves out the ``pack`` box in it, which says where. And whether a file holds
its two eyes as layers of HEVC (MV-HEVC, Apple's spatial video), of which a decoder hands out one.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

from pipeline.errors import OutputError

PACKING_BYTES = 24
"""Of the boxes ``pack`` and, in it, ``pkin`` (view packing kind)."""

HANDLER = "VideoHandler" + " " * PACKING_BYTES
"""Name of a track that leaves room for what :func:`set_packing` says; it has FFmpeg's own then."""

_ENTRY = b"*"
"""Stands for the first sample entry, whatever its kind."""
_TO_ENTRY = (b"mdia", b"minf", b"stbl", b"stsd", _ENTRY)
_BEFORE_BOXES = {b"stsd": 8, _ENTRY: 78}
"""Bytes that stand in a box before the boxes in it; visual sample entries are meant."""
_BEFORE_NAME = 24
"""The same of a handler's name."""


def set_packing(path: Path, *, side_by_side: bool) -> None:
    """Say how two eyes lie in the picture of the first track. Modifies the file, not its length.

    Parameters
    ----------
    path : Path
        An MP4 or MOV file whose first track is called :data:`HANDLER` and is video with a
        ``vexu`` box.
    side_by_side : bool
        False: one above the other.

    Raises
    ------
    OutputError
        If it is not such a file.
    """
    kind = b"side" if side_by_side else b"over"
    packing = _box(b"pack", _box(b"pkin", bytes(4) + kind))

    def shortened(handler: bytes) -> bytes:
        name = bytearray(handler[_BEFORE_NAME:].replace(b" " * PACKING_BYTES, b""))
        if name[0] == len(HANDLER):  # MOV counts letters, MP4 ends with a zero
            name[0] -= PACKING_BYTES
        return handler[:_BEFORE_NAME] + name

    try:
        place, index = _index(path)
        said = _edited(index, (b"trak", *_TO_ENTRY, b"vexu"), lambda vexu: vexu + packing)
        to_name = (b"mdia", b"hdlr")
        boxes = [
            _box(kind, _edited(said, to_name, shortened) if kind == b"trak" else said)
            for kind, said in _boxes(said)
        ]
    except (KeyError, IndexError) as error:
        raise OutputError(f"{path}: no stereo video found in its index") from error
    said = b"".join(boxes)
    if len(said) < len(index):  # the track of the time code has the name of its video's, too
        said += _box(b"free", bytes(len(index) - len(said) - 8))
    assert len(said) == len(index)  # else every frame would lie elsewhere
    with path.open("r+b") as file:
        file.seek(place)
        file.write(said)


def holds_layers(path: Path) -> bool:
    """Tell whether a file's first video track holds two eyes as layers of HEVC.

    That is what the configuration of a second layer (``lhvC``, ISO/IEC 14496-15) beside a
    ``vexu`` box means; without the latter the second layer is an alpha channel.
    """
    try:
        _, index = _index(path)
    except KeyError:
        return False
    for kind, track in _boxes(index):
        if kind != b"trak" or _inside(track, (b"mdia", b"hdlr"))[8:12] != b"vide":
            continue
        entry = _inside(track, _TO_ENTRY)
        return {b"lhvC", b"vexu"} <= {kind for kind, _ in _boxes(entry[_BEFORE_BOXES[_ENTRY] :])}
    return False


def _index(path: Path) -> tuple[int, bytes]:
    """Return where the content of a file's ``moov`` box lies, and that content."""
    with path.open("rb") as file:
        while len(head := file.read(8)) == 8:
            size, kind = struct.unpack(">I4s", head)
            length = 8
            if size == 1:
                (size,) = struct.unpack(">Q", file.read(8))
                length = 16
            if kind == b"moov":
                return file.tell(), file.read(size - length)
            if size < length:  # up to the end of the file
                break
            file.seek(size - length, 1)
    raise KeyError("moov")


def _boxes(content: bytes) -> Iterator[tuple[bytes, bytes]]:
    """Yield (kind, content) of the boxes that stand one after another."""
    at = 0
    while at + 8 <= len(content):
        size, kind = struct.unpack_from(">I4s", content, at)
        if size < 8:
            return
        yield kind, content[at + 8 : at + size]
        at += size


def _inside(content: bytes, kinds: tuple[bytes, ...]) -> bytes:
    """Return the content of the first box of a kind, in the first of another, and so on."""
    for wanted in kinds:
        content = next((said for kind, said in _boxes(content) if wanted in (kind, _ENTRY)), b"")
        if wanted != kinds[-1]:
            content = content[_BEFORE_BOXES.get(wanted, 0) :]
    return content


def _edited(
    content: bytes, kinds: tuple[bytes, ...], edit: Callable[[bytes], bytes]
) -> bytes:  # fmt: skip
    """Return boxes with the content of one of them edited; found as by :func:`_inside`."""
    wanted, *rest = kinds
    parts, is_done = [], False
    for kind, said in _boxes(content):
        if not is_done and wanted in (kind, _ENTRY):
            is_done = True
            if rest:
                head = _BEFORE_BOXES.get(wanted, 0)
                said = said[:head] + _edited(said[head:], tuple(rest), edit)
            else:
                said = edit(said)
        parts.append(_box(kind, said))
    if not is_done:
        raise KeyError(wanted)
    return b"".join(parts)


def _box(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I4s", 8 + len(content), kind) + content
