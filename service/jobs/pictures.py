"""How large a picture says it is, from its first bytes; nothing is decoded."""

from __future__ import annotations

import struct
from pathlib import Path

HEAD = 1 << 16
"""Bytes that are looked at."""


def declared_size(head: bytes) -> tuple[int, int] | None:
    """Return (width, height) in pixels of a PNG or JPEG; None of anything else.

    >>> declared_size(bytes.fromhex("89504e470d0a1a0a0000000d49484452000000050000000700"))
    (5, 7)
    """
    if head.startswith(b"\x89PNG\r\n\x1a\n") and len(head) >= 24:
        width, height = struct.unpack(">II", head[16:24])
        return width, height
    if not head.startswith(b"\xff\xd8"):
        return None
    at = 2
    while at + 9 <= len(head) and head[at] == 0xFF:
        marker, (length,) = head[at + 1], struct.unpack(">H", head[at + 2 : at + 4])
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack(">HH", head[at + 5 : at + 9])
            return width, height
        at += 2 + length
    return None


def too_large(folder: Path, max_pixels: int) -> str | None:
    """Return what is wrong with the first picture below the folder that is too large."""
    for path in sorted(folder.rglob("*")):
        if path.suffix.lower() in (".png", ".jpg", ".jpeg") and path.is_file():
            with path.open("rb") as file:
                size = declared_size(file.read(HEAD))
            if size is not None and size[0] * size[1] > max_pixels:
                name = path.relative_to(folder)
                return f"{name}: {size[0]}x{size[1]} is more than {max_pixels} pixels"
    return None
