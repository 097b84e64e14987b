"""The small JSON that goes along with pictures, read with suspicion and written. Pure."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from pipeline.media.live_frames import EncodedPicture, PictureEncoding

MAX_ATTACHMENT = 4096
"""Longest attachment that is read, bytes."""

MAX_INTEGER = 1 << 63


class MessageError(ValueError):
    """A message is not as it should be; says what and where."""


@dataclass(frozen=True, kw_only=True)
class InputHeader:
    """What the attachment of a picture says."""

    frame_index: int
    capture_time_ns: int
    width: int = 0
    height: int = 0
    pixel_format: str = ""


@dataclass(frozen=True, kw_only=True)
class OutputHeader:
    """What goes along with a picture that a stream gives."""

    sequence: int
    """Grows by one with each message of this key; what is missing was lost on the way."""
    run: int
    """Which worker made it: grows by one when the worker is started anew; sequences go on."""
    frame_index: int
    """Of the source."""
    position: int
    """Frame of the stream, for time: position / fps. Gaps are frames that were not computed."""
    capture_time_ns: int
    """When the source captured it, by its clock."""
    published_time_ns: int
    """When it was sent, by the service's clock."""
    fps: str
    width: int
    """Of the picture, pixels."""
    height: int
    layout: str
    """``sbs``, ``left`` or ``right``."""
    key: bool = True
    """Whether decoding can begin with it."""

    def encoded(self) -> bytes:
        """Return it as JSON."""
        return json.dumps(asdict(self), separators=(",", ":")).encode()


def read_input_header(attachment: bytes) -> InputHeader:
    """Return what the attachment of a picture says.

    Raises
    ------
    MessageError
        If it is not the JSON that docs/zenoh.md describes.

    >>> read_input_header(b'{"frame_index": 3, "capture_time_ns": 1760000000000000000}').frame_index
    3
    """
    if not attachment:
        raise MessageError("attachment: missing; it must hold frame_index and capture_time_ns")
    if len(attachment) > MAX_ATTACHMENT:
        raise MessageError(f"attachment: longer than {MAX_ATTACHMENT} bytes")
    try:
        said = json.loads(attachment)
    except (ValueError, RecursionError):
        raise MessageError("attachment: is not JSON") from None
    if not isinstance(said, dict):
        raise MessageError("attachment: must be a JSON object")
    pixel_format = said.get("pixel_format", "")
    if not isinstance(pixel_format, str) or len(pixel_format) > 32:
        raise MessageError("attachment: pixel_format must be a name")
    return InputHeader(
        frame_index=_integer(said, "frame_index"),
        capture_time_ns=_integer(said, "capture_time_ns"),
        width=_integer(said, "width", 0),
        height=_integer(said, "height", 0),
        pixel_format=pixel_format,
    )


def read_picture(encoding: str, data: bytes, header: InputHeader) -> EncodedPicture:
    """Return the picture of a message; only its encoding's name is looked at.

    Raises
    ------
    MessageError
        If it is not JPEG, PNG or raw, or raw without its size.
    """
    kind = check_encoding(encoding)
    if kind is PictureEncoding.RAW and not (header.width and header.height and header.pixel_format):
        raise MessageError("attachment: raw pictures need width, height and pixel_format")
    return EncodedPicture(
        encoding=kind, data=data, width=header.width, height=header.height,
        pixel_format=header.pixel_format,
    )  # fmt: skip


def check_encoding(encoding: str) -> PictureEncoding:
    """Return the encoding of a picture by its name on the bus."""
    name = encoding.partition(";")[0].strip().lower()
    try:
        return PictureEncoding(name)
    except ValueError:
        raise MessageError(
            f"encoding: {encoding[:60]!r}; image/jpeg, image/png and video/raw are taken"
        ) from None


def write_input_header(header: InputHeader) -> bytes:
    """Return the attachment of a picture."""
    said = {name: value for name, value in asdict(header).items() if value or name in _ALWAYS}
    return json.dumps(said, separators=(",", ":")).encode()


_ALWAYS = ("frame_index", "capture_time_ns")


def _integer(said: dict[str, Any], name: str, default: int | None = None) -> int:
    value = said.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < MAX_INTEGER:
        raise MessageError(f"attachment: {name} must be a whole number from 0 up")
    return value
