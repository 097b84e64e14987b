"""Read one image file: PNG, JPEG, PNM, PFM or TIFF; what is cut short is an error.

Decoders like to hand out what they could read of a file that ends too early. A picture
half of which is grey must not enter super-resolution silently, so the structure of a file is
checked before it is decoded. Knows nothing of scenes: errors name the file, the caller adds
view and frame.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.errors import SceneError
from pipeline.media.colorimetry import Colorimetry

IMAGE_SUFFIXES = frozenset(
    {".png", ".jpg", ".jpeg", ".ppm", ".pgm", ".pnm", ".pfm", ".tif", ".tiff"}
)
"""Names of files that are read here, lower case."""

HEADER_BYTES = 1 << 16
"""How much of a file is read to learn its size, bytes; JPEG metadata may need more."""


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """What a file says of itself before its samples are decoded."""

    width: int
    """Pixels."""
    height: int
    """Pixels."""
    channels: int
    """1 for grey, 3 for RGB; alpha does not count."""
    peak: float
    """Stored value of white: 255, 65535, the PNM maximum; 1 for floating point."""
    is_float: bool = False
    colorimetry: Colorimetry = field(default_factory=Colorimetry)
    """What PNG's cICP chunk says."""

    @property
    def bit_depth(self) -> int:
        """8, 10 or 16: the smallest that holds the peak (16 for floating point)."""
        if self.is_float:
            return 16
        return 8 if self.peak <= 255 else 10 if self.peak <= 1023 else 16


@dataclass(frozen=True, kw_only=True, eq=False)
class StoredImage:
    """The samples of a file, as stored."""

    samples: npt.NDArray
    """(H, W) or (H, W, 3), red first; uint8, uint16 or float32."""
    peak: float
    """Stored value of white."""


def read_header(path: Path) -> ImageHeader:
    """Return size, channels and depth of an image file, reading as little as needed.

    Raises
    ------
    SceneError
        If the file is missing, of no known kind, or its header is damaged.
    """
    head = _bytes_of(path, HEADER_BYTES)
    kind = image_kind(head, path)
    try:
        if kind == "png":
            return _png_header(head)
        if kind == "jpeg":
            try:
                return _jpeg_header(head)
            except (_Damaged, struct.error, IndexError):
                return _jpeg_header(_bytes_of(path))
        if kind == "pnm":
            return _pnm_header(head)[0]
        if kind == "pfm":
            return _pfm_header(head)[0]
    except (_Damaged, struct.error, IndexError) as error:
        raise SceneError(_reason(error, kind), path=path) from error
    image = read_image(path)
    samples = image.samples
    return ImageHeader(
        width=samples.shape[1],
        height=samples.shape[0],
        channels=1 if samples.ndim == 2 else 3,
        peak=image.peak,
        is_float=samples.dtype == np.float32,
    )


def read_image(path: Path) -> StoredImage:
    """Return the samples of an image file.

    Parameters
    ----------
    path : Path
        A PNG, JPEG, PNM (PGM, PPM), PFM or TIFF file, recognised by its content.

    Returns
    -------
    StoredImage
        Grey (H, W) or RGB (H, W, 3), row 0 on top; alpha is dropped. Integers as stored,
        floating point as float32 with its infinities and NaNs.

    Raises
    ------
    SceneError
        If the file is missing, of no known kind, cut short or damaged.
    """
    return decode_image(_bytes_of(path), path)


def decode_image(data: bytes, path: Path) -> StoredImage:
    """Return the samples of an image file's bytes; see :func:`read_image`.

    ``path`` is what errors call it.
    """
    kind = image_kind(data, path)
    try:
        if kind == "pnm":
            return _read_pnm(data)
        if kind == "pfm":
            return _read_pfm(data)
        header = None
        if kind == "png":
            header = _check_png(data)
        elif kind == "jpeg":
            _check_jpeg(data)
        return _decoded(data, header)
    except (_Damaged, struct.error, IndexError) as error:
        raise SceneError(_reason(error, kind), path=path) from error


class _Damaged(Exception):
    """A file's structure is broken; the message says where."""


def _reason(error: Exception, kind: str) -> str:
    if isinstance(error, _Damaged):
        return str(error)
    return f"truncated {kind.upper()}: it ends within its header"


def _bytes_of(path: Path, limit: int = -1) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(limit)
    except OSError as error:
        raise SceneError(f"cannot be read: {error.strerror}", path=path) from error


def declared_header(data: bytes, path: Path) -> ImageHeader:
    """Return what the bytes of a whole PNG or JPEG file say of it; nothing is decoded.

    Raises
    ------
    SceneError
        If it is neither, or its header is damaged.
    """
    kind = image_kind(data, path)
    try:
        if kind == "png":
            return _png_header(data)
        if kind == "jpeg":
            return _jpeg_header(data)
    except (_Damaged, struct.error, IndexError) as error:
        raise SceneError(_reason(error, kind), path=path) from error
    raise SceneError(f"{kind.upper()}: send PNG or JPEG", path=path)


def image_kind(data: bytes, path: Path) -> str:
    """Return what an image file is by its first bytes: png, jpeg, pnm, pfm or tiff.

    Raises
    ------
    SceneError
        If it is none of these.
    """
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        return "png"
    if data.startswith(b"\xff\xd8\xff"):
        return "jpeg"
    if re.match(rb"P[2356]\s", data):
        return "pnm"
    if re.match(rb"P[fF]\s", data):
        return "pfm"
    if data[:4] in (b"II*\x00", b"MM\x00*"):
        return "tiff"
    if not data:
        raise SceneError("the file is empty", path=path)
    raise SceneError("not an image of a known kind (PNG, JPEG, PGM, PPM, PFM, TIFF)", path=path)


def _decoded(data: bytes, header: ImageHeader | None) -> StoredImage:
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)  # what goes wrong is told by our own error
    try:
        samples = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise _Damaged(f"cannot be decoded: {error.err}") from error
    finally:
        log.setLogLevel(level)
    if samples is None:
        raise _Damaged("cannot be decoded: the file is damaged or cut short")
    if samples.dtype == np.float64:
        samples = samples.astype(np.float32)
    if samples.dtype not in (np.uint8, np.uint16, np.float32):
        raise _Damaged(f"samples of type {samples.dtype} are not supported")
    if samples.ndim == 3:
        channels = samples.shape[2]
        if channels == 1 or channels == 2 or (header is not None and header.channels == 1):
            samples = np.ascontiguousarray(samples[:, :, 0])
        else:
            code = cv2.COLOR_BGRA2RGB if channels == 4 else cv2.COLOR_BGR2RGB
            samples = cv2.cvtColor(samples, code)
    if header is not None and samples.shape[:2] != (header.height, header.width):
        raise _Damaged("cannot be decoded: the picture is not of the size its header says")
    peak = {np.dtype(np.uint8): 255.0, np.dtype(np.uint16): 65535.0}.get(samples.dtype, 1.0)
    return StoredImage(samples=samples, peak=peak)


# PNG: ISO/IEC 15948, §5 (structure) and §11.2.2 (IHDR)


def _png_header(data: bytes) -> ImageHeader:
    if data[12:16] != b"IHDR":
        raise _Damaged("damaged PNG: it does not begin with IHDR")
    width, height, depth, colour = struct.unpack(">IIBB", data[16:26])
    if width == 0 or height == 0:
        raise _Damaged("damaged PNG: a picture of no pixels")
    return ImageHeader(
        width=width,
        height=height,
        channels=1 if colour in (0, 4) else 3,
        peak=65535.0 if depth == 16 else 255.0,
        colorimetry=_png_colorimetry(data),
    )


def _png_colorimetry(data: bytes) -> Colorimetry:
    """Return what a cICP chunk says (PNG, third edition, 11.3.2.6), if there is one."""
    at, name = 8, b""
    while name != b"IDAT" and at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        name = data[at + 4 : at + 8]
        if name == b"cICP" and length == 4 and at + 10 <= len(data):
            return Colorimetry.told(data[at + 8], data[at + 9])
        at += 12 + length
    return Colorimetry()


def _check_png(data: bytes) -> ImageHeader:
    header = _png_header(data)
    at = 8
    while True:
        if at + 12 > len(data):
            raise _Damaged(f"truncated PNG: it ends after {len(data)} bytes, before IEND")
        (length,) = struct.unpack_from(">I", data, at)
        name = data[at + 4 : at + 8]
        end = at + 12 + length
        if end > len(data):
            raise _Damaged(f"truncated PNG: it ends within a chunk {name.decode('latin-1')!r}")
        (stated,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(data[at + 4 : end - 4]) != stated:
            raise _Damaged(f"damaged PNG: wrong checksum of a chunk {name.decode('latin-1')!r}")
        if name == b"IEND":
            return header
        at = end


# JPEG: ITU-T T.81, annex B (markers)

_NO_PAYLOAD = frozenset({0x01, *range(0xD0, 0xD9)})
_NOT_A_FRAME = frozenset({0xC4, 0xC8, 0xCC})
_MARKER_IN_SCAN = re.compile(rb"\xff[^\x00\xff\xd0-\xd7]")


def _jpeg_header(data: bytes) -> ImageHeader:
    for marker, at in _jpeg_segments(data):
        if 0xC0 <= marker <= 0xCF and marker not in _NOT_A_FRAME:
            depth, height, width, components = struct.unpack_from(">BHHB", data, at + 4)
            return ImageHeader(
                width=width,
                height=height,
                channels=1 if components == 1 else 3,
                peak=255.0 if depth == 8 else 65535.0,
            )
    raise _Damaged("damaged JPEG: no frame header")


def _check_jpeg(data: bytes) -> None:
    for marker, _ in _jpeg_segments(data):
        if marker == 0xD9:
            return
    raise _Damaged(f"truncated JPEG: it ends after {len(data)} bytes, before its end marker")


def _jpeg_segments(data: bytes) -> Iterator[tuple[int, int]]:
    at = 2
    while at + 2 <= len(data):
        if data[at] != 0xFF:
            raise _Damaged("damaged JPEG: a marker is missing")
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
            continue
        yield marker, at
        if marker == 0xD9:
            return
        if marker in _NO_PAYLOAD:
            at += 2
            continue
        (length,) = struct.unpack_from(">H", data, at + 2)
        at += 2 + length
        if marker == 0xDA:
            found = _MARKER_IN_SCAN.search(data, at)
            if found is None:
                return
            at = found.start()


# PNM: Netpbm's pgm(5) and ppm(5)


def _pnm_header(data: bytes) -> tuple[ImageHeader, str, int]:
    kind = chr(data[1])
    at = 2
    numbers: list[int] = []
    while len(numbers) < 3:
        token = re.compile(rb"(?:\s|#[^\n]*\n)*(\d+)").match(data, at)
        if token is None:
            raise _Damaged("damaged PNM: its header is not three numbers")
        numbers.append(int(token.group(1)))
        at = token.end()
    width, height, maximum = numbers
    if width < 1 or height < 1 or not 1 <= maximum <= 65535:
        raise _Damaged("damaged PNM: size or maximum out of range")
    channels = 1 if kind in "25" else 3
    header = ImageHeader(width=width, height=height, channels=channels, peak=float(maximum))
    return header, kind, at + 1  # one white space ends the header


def _read_pnm(data: bytes) -> StoredImage:
    header, kind, at = _pnm_header(data)
    count = header.width * header.height * header.channels
    dtype = np.uint8 if header.peak <= 255 else np.uint16
    if kind in "23":
        try:
            values = np.array(data[at:].split()[:count], dtype=np.int64)
        except ValueError as error:
            raise _Damaged("damaged PNM: something that is not a number") from error
        have = values.size
    else:
        stored = np.dtype(dtype).newbyteorder(">")
        have = (len(data) - at) // stored.itemsize
        values = np.frombuffer(data, stored, count=min(count, have), offset=at)
    if have < count:
        raise _Damaged(f"truncated PNM: {have} samples of {count}")
    shape = (header.height, header.width) + ((3,) if header.channels == 3 else ())
    return StoredImage(samples=values.astype(dtype).reshape(shape), peak=header.peak)


# PFM: as Middlebury writes it; the sign of the scale is the byte order, rows run upwards

_PFM_HEADER = re.compile(rb"P([fF])\s+(\d+)\s+(\d+)\s+([-+0-9.eE]+)\s")


def _pfm_header(data: bytes) -> tuple[ImageHeader, str, int]:
    found = _PFM_HEADER.match(data)
    if found is None:
        raise _Damaged("damaged PFM: its header is not a size and a scale")
    try:
        scale = float(found.group(4))
    except ValueError:
        scale = 0.0
    width, height = int(found.group(2)), int(found.group(3))
    if width < 1 or height < 1 or not np.isfinite(scale) or scale == 0:
        raise _Damaged("damaged PFM: size or scale out of range")
    header = ImageHeader(
        width=width,
        height=height,
        channels=1 if found.group(1) == b"f" else 3,
        peak=1.0,
        is_float=True,
    )
    return header, "<" if scale < 0 else ">", found.end()


def _read_pfm(data: bytes) -> StoredImage:
    header, order, at = _pfm_header(data)
    count = header.width * header.height * header.channels
    have = (len(data) - at) // 4
    if have < count:
        raise _Damaged(f"truncated PFM: {have} samples of {count}")
    shape = (header.height, header.width) + ((3,) if header.channels == 3 else ())
    values = np.frombuffer(data, np.dtype(order + "f4"), count=count, offset=at).reshape(shape)
    return StoredImage(samples=np.ascontiguousarray(values[::-1], dtype=np.float32), peak=1.0)
