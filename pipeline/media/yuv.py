"""Planar YUV: raw files, and the way from its planes to luma and chroma.

The matrix and the range of a picture are honoured (ITU-R BT.601, BT.709, BT.2020, non-constant
luminance); the result is what the pipeline holds, BT.601 full-range luma and chroma, reached
with one matrix and without rounding in between.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.colour import CHROMA_CENTRE, RGB_TO_YCC, Picture, combined, interleaved
from pipeline.errors import SceneError
from pipeline.media.ycbcr import YcbcrMatrix, matrix_for, ycbcr_of_rgb


class Range(StrEnum):
    """Which stored values are black and white."""

    LIMITED = "limited"
    """16 to 235 for luma and 16 to 240 for chroma, at 8 bits."""

    FULL = "full"
    """All values."""


@dataclass(frozen=True, kw_only=True)
class PlanarFormat:
    """How the samples of a planar picture lie."""

    chroma_shift_x: int
    """log2 of luma columns over chroma columns."""
    chroma_shift_y: int
    """log2 of luma rows over chroma rows."""
    has_chroma: bool
    bits: int
    """Bits of a sample that carry the value (the low ones), 8 to 16."""
    dtype: np.dtype
    """Of a stored sample, byte order included."""

    def plane_shapes(self, width: int, height: int) -> tuple[tuple[int, int], ...]:
        """Return (rows, columns) of each plane, luma first."""
        if not self.has_chroma:
            return ((height, width),)
        chroma = (-(-height >> self.chroma_shift_y), -(-width >> self.chroma_shift_x))
        return ((height, width), chroma, chroma)

    def frame_bytes(self, width: int, height: int) -> int:
        """Return the bytes of one frame without padding."""
        samples = sum(rows * columns for rows, columns in self.plane_shapes(width, height))
        return samples * self.dtype.itemsize


_FORMAT = re.compile(
    r"(gray|yuvj?(?P<sub>420|422|444)p)(?:(?P<bits>9|10|12|14|16)(?P<order>le|be))?"
)


def parse_pixel_format(name: object) -> PlanarFormat:
    """Return the format of FFmpeg's name; raise ValueError where it is not planar YUV or grey.

    >>> parse_pixel_format("yuv420p10le").frame_bytes(5, 3)
    54
    """
    found = _FORMAT.fullmatch(name) if isinstance(name, str) else None
    if found is None:
        raise ValueError(
            f"pixel_format {name!r} is not supported; planar YUV and grey are, such as "
            "yuv420p, yuv422p10le, yuv444p16le, gray, gray10le"
        )
    shift_x, shift_y = {"420": (1, 1), "422": (1, 0), "444": (0, 0), None: (0, 0)}[found["sub"]]
    bits = int(found["bits"] or 8)
    order = ">" if found["order"] == "be" else "<"
    return PlanarFormat(
        chroma_shift_x=shift_x,
        chroma_shift_y=shift_y,
        has_chroma=found["sub"] is not None,
        bits=bits,
        dtype=np.dtype(np.uint8) if bits == 8 else np.dtype(order + "u2"),
    )


def levels(bits: int, value_range: Range) -> tuple[float, float, float, float]:
    """Return (black, luma span, chroma centre, chroma span) in stored values."""
    if value_range is Range.FULL:
        peak = float((1 << bits) - 1)
        return 0.0, peak, float(1 << (bits - 1)), peak
    step = float(1 << (bits - 8))
    return 16 * step, 219 * step, 128 * step, 224 * step


def picture_from_planes(
    planes: tuple[npt.NDArray, ...],
    layout: PlanarFormat,
    matrix: YcbcrMatrix,
    value_range: Range,
    *,
    with_chroma: bool = True,
) -> Picture:
    """Return luma and chroma of a planar YUV picture.

    Parameters
    ----------
    planes : tuple of ndarray of shape (rows, columns), uint8 or uint16
        Luma, or luma, Cb and Cr, as stored. Chroma of subsampled formats is taken to sit on
        the even luma columns and between the luma rows (MPEG-2's and H.264's default).
    layout : PlanarFormat
        How they are meant.
    matrix : YcbcrMatrix
        Which RGB they are made of; without effect on grey.
    value_range : Range
        Which values are black and white.
    with_chroma : bool
        False: luma alone is wanted. It takes chroma all the same where the matrix is not BT.601.

    Returns
    -------
    Picture
        New arrays: luma clipped to 0..255, chroma as it comes.
    """
    black, span, centre, chroma_span = levels(layout.bits, value_range)
    if len(planes) == 1:
        luma = planes[0].astype(np.float32)
        if (black, span) != (0.0, 255.0):
            luma = (luma - np.float32(black)) * np.float32(255.0 / span)
        return Picture(luma=np.clip(luma, 0, 255, out=luma))
    scale = np.array([255.0 / span, 255.0 / chroma_span, 255.0 / chroma_span])
    offsets = np.array([0, CHROMA_CENTRE, CHROMA_CENTRE]) - scale * [black, centre, centre]
    if matrix is YcbcrMatrix.BT601:
        luma = _levels_of(planes[0], scale[0], offsets[0])
        chroma = None
        is_halved = layout.chroma_shift_x and layout.chroma_shift_y
        if with_chroma and is_halved and layout.bits == 8:
            chroma = _doubled(planes[1:], luma.shape, scale[1], offsets[1])
        elif with_chroma:
            chroma = _upsampled(interleaved(planes[1:]), layout, luma.shape)
            chroma = combined([chroma], [scale[1]], offsets[1])
        return Picture(luma=luma, chroma=chroma)
    change = RGB_TO_YCC @ np.linalg.inv(ycbcr_of_rgb(matrix)) @ np.diag([219.0, 224.0, 224.0])
    offset = -scale * [black, centre, centre]
    offsets = change @ offset + [0, CHROMA_CENTRE, CHROMA_CENTRE]
    luma = planes[0].astype(np.float32)
    all_planes = luma, *(_upsampled(plane, layout, luma.shape) for plane in planes[1:])
    rows = list(zip(change * scale, offsets, strict=True))
    luma, *mixed = (
        combined(all_planes, row, constant) for row, constant in rows[: 3 if with_chroma else 1]
    )
    return Picture(
        luma=np.clip(luma, 0, 255, out=luma), chroma=interleaved(mixed) if mixed else None
    )


def _levels_of(plane: npt.NDArray, scale: float, offset: float) -> npt.NDArray[np.float32]:
    """Return stored values times ``scale`` and plus ``offset``, clipped to 0..255."""
    if plane.dtype == np.uint8:
        return np.asarray(cv2.LUT(plane, _table_of_levels(scale, offset))).reshape(plane.shape)
    found = combined([plane.astype(np.float32)], [scale], offset)
    return np.clip(found, 0, 255, out=found)


@functools.lru_cache(maxsize=8)
def _table_of_levels(scale: float, offset: float) -> npt.NDArray[np.float32]:
    """Return what :func:`_levels_of` makes of each value of 8 bits."""
    return _levels_of(np.arange(256, dtype=np.uint16), scale, offset)


def _doubled(
    planes: tuple[npt.NDArray, ...], shape: tuple[int, ...], scale: float, offset: float
) -> npt.NDArray[np.float32]:
    """Return what :func:`_upsampled` makes of 4:2:0 of 8 bits, times ``scale`` plus ``offset``."""
    from pipeline.media.chroma_kernels import write_doubled  # numba, which a service need not load

    chroma = np.empty((*shape, 2), np.float32)
    # the decoder's memory may have rows of any length
    write_doubled(*map(np.array, planes), _table_of_eighths(scale, offset), chroma)
    return chroma


@functools.lru_cache(maxsize=8)
def _table_of_eighths(scale: float, offset: float) -> npt.NDArray[np.float32]:
    """Return n / 8 times ``scale`` plus ``offset``, as OpenCV makes it of whole pictures."""
    eighths = np.arange(8 * 256, dtype=np.float32)[np.newaxis] / 8
    return combined([eighths], [scale], offset)[0]


_BETWEEN = np.array([[0, 0.5, 0.5]], np.float32)
"""Mean of a column and the next one."""


def _upsampled(
    chroma: npt.NDArray, layout: PlanarFormat, shape: tuple[int, ...]
) -> npt.NDArray[np.float32]:
    """Return one or more channels of chroma at each pixel of luma, without any rounding."""
    chroma = chroma.astype(np.float32)
    if layout.chroma_shift_x:
        size = 2 * chroma.shape[1], chroma.shape[0]
        twice = cv2.resize(chroma, size, interpolation=cv2.INTER_NEAREST)
        chroma = cv2.filter2D(twice, -1, _BETWEEN, borderType=cv2.BORDER_REPLICATE)
    if layout.chroma_shift_y:
        size = chroma.shape[1], 2 * chroma.shape[0]
        chroma = cv2.resize(chroma, size, interpolation=cv2.INTER_LINEAR)
    return np.asarray(chroma, np.float32)[: shape[0], : shape[1]]


class RawVideoFile:
    """A file of raw frames, read at random.

    Raises
    ------
    SceneError
        If it is missing, empty, or does not hold whole frames.
    """

    def __init__(
        self,
        path: Path,
        *,
        width: int,
        height: int,
        pixel_format: str,
        matrix: YcbcrMatrix | None = None,
        value_range: Range | None = None,
    ) -> None:
        self.path = path
        self.width = width
        self.height = height
        self.layout = parse_pixel_format(pixel_format)
        self.matrix = matrix or matrix_for(height)
        self.range = value_range
        self._frame_bytes = self.layout.frame_bytes(width, height)
        try:
            size = path.stat().st_size
        except OSError as error:
            raise SceneError(f"cannot be read: {error.strerror}", path=path) from error
        self.num_frames, rest = divmod(size, self._frame_bytes)
        if rest or not self.num_frames:
            raise SceneError(
                f"truncated, or not {width}×{height} {pixel_format}: {size} bytes are "
                f"{self.num_frames} frames of {self._frame_bytes} bytes and {rest} more",
                path=path,
            )

    def planes(self, index: int) -> tuple[npt.NDArray, ...]:
        """Return the planes of frame ``index`` (0-based) as stored, in native byte order."""
        try:
            with self.path.open("rb") as file:
                file.seek(index * self._frame_bytes)
                data = file.read(self._frame_bytes)
        except OSError as error:
            raise SceneError(f"cannot be read: {error.strerror}", path=self.path) from error
        if len(data) < self._frame_bytes:
            raise SceneError("truncated", path=self.path, frame=index)
        samples = np.frombuffer(data, self.layout.dtype)
        samples = samples.astype(self.layout.dtype.newbyteorder("="), copy=False)
        planes, at = [], 0
        for rows, columns in self.layout.plane_shapes(self.width, self.height):
            planes.append(samples[at : at + rows * columns].reshape(rows, columns))
            at += rows * columns
        return tuple(planes)

    def picture(self, index: int, *, with_chroma: bool = True) -> Picture:
        """Return frame ``index`` (0-based) as luma and, if it is wanted, chroma."""
        return picture_from_planes(
            self.planes(index), self.layout, self.matrix, self.range or Range.LIMITED,
            with_chroma=with_chroma,
        )  # fmt: skip

    def samples(self, index: int) -> npt.NDArray:
        """Return the first plane of frame ``index`` (0-based) as numbers: (H, W).

        With limited range they are stretched to the full range of the bit depth, float32.
        """
        return stored_values(self.planes(index)[0], self.layout.bits, self.range or Range.FULL)


def stored_values(plane: npt.NDArray, bits: int, value_range: Range) -> npt.NDArray:
    """Return a plane of depth values, stretched to full range where it is limited.

    Parameters
    ----------
    plane : ndarray of shape (H, W), uint8 or uint16
        Stored samples.
    bits : int
        Bits of a sample.
    value_range : Range
        Full: the plane itself is returned.
    """
    if value_range is Range.FULL:
        return plane
    black, span, _, _ = levels(bits, value_range)
    peak = float((1 << bits) - 1)
    return np.clip((plane.astype(np.float32) - black) * np.float32(peak / span), 0, peak)
