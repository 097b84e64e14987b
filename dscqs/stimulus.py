"""Files of stimuli: what they hold, and how their bytes are made to tell nothing.

The pictures themselves can only be looked at. Everything around them is made alike: the files of
one content all get the same length (a filler that decoders skip: a chunk of PNG, a Void element
of WebM), and the end of the filler is random and new at every serving, so that no two servings
have the same bytes.
"""

from __future__ import annotations

import hashlib
import struct
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from dscqs.errors import StimulusError

RANDOM_BYTES = 4096
"""Random bytes at the end of the filler."""

LENGTH_STEP = 4096
"""Padded files are a whole number of these long."""

_PNG_MAGIC = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
_PNG_FILLER = b"paDd"
"""Ancillary, private, safe to copy: decoders pass over it."""

_WEBM_MAGIC = b"\x1a\x45\xdf\xa3"
_WEBM_FILLER = b"\xec\x01"
"""Void, with a length of seven bytes."""

MEDIA_TYPES = {"still": "image/png", "video": "video/webm"}
"""By the kind of the plan."""


@dataclass(frozen=True, kw_only=True)
class StimulusInfo:
    """What the head of a file says."""

    media_type: str
    width: int
    height: int
    codec: str = "png"


@dataclass(frozen=True, kw_only=True)
class Padded:
    """A file with a filler, and what is needed to renew the random end of it."""

    data: bytes
    random_at: int
    """Where the random bytes begin."""
    checksum: int
    """CRC of the filler before the random bytes; 0 for WebM, which has none."""


def inspect(data: bytes, name: str = "stimulus") -> StimulusInfo:
    """Return what a PNG or WebM file holds, from its structure alone.

    Raises
    ------
    StimulusError
        If it is damaged, or neither; the message begins with ``name``.
    """
    try:
        if data.startswith(_PNG_MAGIC):
            return _inspect_png(data)
        if data.startswith(_WEBM_MAGIC):
            return _inspect_webm(data)
    except (IndexError, struct.error, ValueError, KeyError) as error:
        raise StimulusError(f"{name}: is damaged ({error})") from None
    raise StimulusError(f"{name}: is neither a PNG nor a WebM file")


def padded_length(lengths: Mapping[str, int] | list[int]) -> int:
    """Return the common length of files that must not be told apart [bytes]."""
    longest = max(lengths.values() if isinstance(lengths, Mapping) else lengths)
    needed = longest + RANDOM_BYTES + 64
    return -(-needed // LENGTH_STEP) * LENGTH_STEP


def pad(data: bytes, length: int) -> Padded:
    """Return the file with a filler of zeros that makes it ``length`` bytes long."""
    if data.startswith(_PNG_MAGIC):
        body = data.removesuffix(_PNG_END)
        filler = length - len(data) - 12
        zeros = _PNG_FILLER + bytes(filler - RANDOM_BYTES)
        head = body + struct.pack(">I", filler) + zeros
        made = (
            head + bytes(RANDOM_BYTES) + struct.pack(">I", zlib.crc32(zeros + bytes(RANDOM_BYTES)))
        )
        return Padded(data=made + _PNG_END, random_at=len(head), checksum=zlib.crc32(zeros))
    filler = length - len(data) - 9
    head = (
        _longer_segment(data, length - len(data))
        + _WEBM_FILLER
        + filler.to_bytes(7, "big")
        + bytes(filler - RANDOM_BYTES)
    )
    return Padded(data=head + bytes(RANDOM_BYTES), random_at=len(head), checksum=0)


def freshen(padded: Padded, noise: bytes) -> bytes:
    """Return the file with other random bytes; takes the same time for files of one length.

    Parameters
    ----------
    padded : Padded
    noise : bytes
        :data:`RANDOM_BYTES` of them.
    """
    end = padded.random_at + RANDOM_BYTES
    made = bytearray(padded.data)
    made[padded.random_at : end] = noise
    if made.startswith(_PNG_MAGIC):
        made[end : end + 4] = struct.pack(">I", zlib.crc32(noise, padded.checksum))
    return bytes(made)


def digest(data: bytes) -> str:
    """Return the SHA-256 of a file, in hexadecimal."""
    return hashlib.sha256(data).hexdigest()


def _inspect_png(data: bytes) -> StimulusInfo:
    at, names = len(_PNG_MAGIC), []
    while at < len(data):
        (length,) = struct.unpack_from(">I", data, at)
        name = data[at + 4 : at + 8]
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(memoryview(data)[at + 4 : at + 8 + length]) != checksum:
            raise ValueError(f"checksum of chunk {name!r}")
        names.append(name)
        at += 12 + length
    if names[0] != b"IHDR" or names[-1] != b"IEND" or b"IDAT" not in names:
        raise ValueError("chunks are missing")
    width, height = struct.unpack_from(">II", data, 16)
    return StimulusInfo(media_type="image/png", width=width, height=height)


_SEGMENT, _TRACKS, _TRACK, _VIDEO = 0x18538067, 0x1654AE6B, 0xAE, 0xE0
_CODEC, _WIDTH, _HEIGHT, _CLUSTER = 0x86, 0xB0, 0xBA, 0x1F43B675


def _inspect_webm(data: bytes) -> StimulusInfo:
    found: dict[int, bytes] = {}
    clusters = 0
    for name, start, end in _elements(data, 0, len(data)):
        if name == _CLUSTER:
            clusters += 1
        if name in (_CODEC, _WIDTH, _HEIGHT):
            found[name] = data[start:end]
    if not clusters:
        raise ValueError("it has no pictures")
    codec = {b"V_VP9": "vp9", b"V_AV1": "av1"}[found[_CODEC].rstrip(b"\0")]
    width, height = (int.from_bytes(found[name], "big") for name in (_WIDTH, _HEIGHT))
    return StimulusInfo(media_type="video/webm", width=width, height=height, codec=codec)


def _longer_segment(data: bytes, more: int) -> bytes:
    """Return the file with its segment said to be longer, where the length has room."""
    _, at = _number(data, 0, keep_marker=True)
    length, at = _number(data, at, keep_marker=False)
    name, at = _number(data, at + length, keep_marker=True)
    length, end = _number(data, at, keep_marker=False)
    if name != _SEGMENT or end - at != 8 or end + length != len(data):
        return data
    return data[:at] + b"\x01" + (length + more).to_bytes(7, "big") + data[end:]


def _elements(data: bytes, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield id, start and end of the content of elements, going into those that matter."""
    while at < end:
        name, at = _number(data, at, keep_marker=True)
        length, at = _number(data, at, keep_marker=False)
        if at + length > end:
            raise ValueError("it is cut short")
        yield name, at, at + length
        if name in (_SEGMENT, _TRACKS, _TRACK, _VIDEO):
            yield from _elements(data, at, at + length)
        at += length


def _number(data: bytes, at: int, *, keep_marker: bool) -> tuple[int, int]:
    """Return a number of EBML and where it ends."""
    length = 9 - data[at].bit_length()
    value = int.from_bytes(data[at : at + length], "big")
    if not keep_marker:
        value &= (1 << 7 * length) - 1
    return value, at + length


def signature(data: bytes) -> str:
    """Return what a file and every serving of it have in common: a hash of the coded picture."""
    if data.startswith(_PNG_MAGIC):
        at, coded = len(_PNG_MAGIC), hashlib.sha256()
        while at < len(data):
            (length,) = struct.unpack_from(">I", data, at)
            if data[at + 4 : at + 8] == b"IDAT":
                coded.update(memoryview(data)[at + 8 : at + 8 + length])
            at += 12 + length
        return coded.hexdigest()
    clusters = [
        data[start:end] for name, start, end in _elements(data, 0, len(data)) if name == _CLUSTER
    ]
    return digest(b"".join(clusters))
