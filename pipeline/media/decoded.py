"""What a frame that PyAV has decoded says: its samples, its colours, how two views share it."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt

from pipeline.colour import Picture, picture_from_rgb
from pipeline.errors import SceneError
from pipeline.media.colorimetry import Colorimetry, LightLevel, MasteringDisplay
from pipeline.media.ycbcr import YcbcrMatrix, matrix_for
from pipeline.media.yuv import (
    PlanarFormat,
    Range,
    parse_pixel_format,
    picture_from_planes,
    stored_values,
)

_MATRICES = {
    1: YcbcrMatrix.BT709,
    4: YcbcrMatrix.BT601,
    5: YcbcrMatrix.BT601,
    6: YcbcrMatrix.BT601,
    9: YcbcrMatrix.BT2020,
    10: YcbcrMatrix.BT2020,
}
"""ISO/IEC 23091-2 matrix coefficients to ours; others are taken for the default."""

_STEREO_MODES = {
    "left_right": ("sbs", False),
    "right_left": ("sbs", True),
    "top_bottom": ("tab", False),
    "bottom_top": ("tab", True),
}
"""Matroska's names to (layout, right eye first)."""

_STEREO_TYPES = {1: "sbs", 2: "tab"}
"""FFmpeg's AVStereo3D types to ours."""


@dataclass(frozen=True, kw_only=True)
class StereoTag:
    """How two views share the picture, as far as the file says."""

    arrangement: str
    """``sbs`` or ``tab``; whether halves are squeezed is not said."""
    right_first: bool
    """True where the left or upper half is the right eye's."""
    origin: str
    """Where it was found, for messages."""


def stereo_tag(stream: av.VideoStream, first: av.VideoFrame) -> StereoTag | None:
    """Return what the container or the stream's first frame says of two views; None: nothing."""
    mode = stream.metadata.get("stereo_mode")
    if mode in _STEREO_MODES:
        arrangement, right_first = _STEREO_MODES[mode]
        return StereoTag(arrangement=arrangement, right_first=right_first, origin="container tag")
    for data in first.side_data:
        if data.type.name == "STEREO3D":  # type: ignore[attr-defined]  # typed as a mapping
            kind, flags = struct.unpack_from("<ii", bytes(data))  # type: ignore[arg-type]
            if kind in _STEREO_TYPES:
                return StereoTag(
                    arrangement=_STEREO_TYPES[kind],
                    right_first=bool(flags & 1),
                    origin="file's stereo signal",
                )
    return None


def colorimetry_of(first: av.VideoFrame) -> Colorimetry:
    """Return what a stream's first frame says of its colours."""
    mastering = light_level = None
    for data in first.side_data:
        kind = data.type.name  # type: ignore[attr-defined]  # typed as a mapping
        if kind == "MASTERING_DISPLAY_METADATA":
            mastering = _mastering_display(bytes(data))  # type: ignore[arg-type]
        elif kind == "CONTENT_LIGHT_LEVEL":
            pixel, frame = struct.unpack_from("<II", bytes(data))  # type: ignore[arg-type]
            if pixel or frame:  # 0 says that nothing is said (ITU-T H.265, D.3.35)
                light_level = LightLevel(pixel=pixel, frame=frame)
    return Colorimetry.told(
        int(first.color_primaries), int(first.color_trc), mastering, light_level
    )  # fmt: skip


def _mastering_display(data: bytes) -> MasteringDisplay | None:
    """Return what FFmpeg's AVMasteringDisplayMetadata says; None where a part is missing."""
    *numbers, has_primaries, has_luminance = struct.unpack_from("<22i", data)
    if not (has_primaries and has_luminance and all(numbers[1::2])):
        return None
    red_x, red_y, green_x, green_y, blue_x, blue_y, white_x, white_y, darkest, brightest = (
        Fraction(*pair) for pair in zip(numbers[::2], numbers[1::2], strict=True)
    )
    return MasteringDisplay(
        red=(red_x, red_y), green=(green_x, green_y), blue=(blue_x, blue_y),
        white=(white_x, white_y), darkest=darkest, brightest=brightest,
    )  # fmt: skip


def planar(frame: av.VideoFrame) -> tuple[av.VideoFrame, PlanarFormat | None]:
    """Return the frame with planes we can read, and their format; None: RGB."""
    name = frame.format.name
    if frame.format.is_rgb or name == "pal8":
        return frame, None
    try:
        return frame, parse_pixel_format(name)
    except ValueError:
        pass
    components = frame.format.components
    bits = max(component.bits for component in components)
    suffix = "" if bits <= 8 else "10le" if bits <= 10 else "12le" if bits <= 12 else "16le"
    if len(components) < 3:
        target = f"gray{suffix}"
    else:
        ratio = (frame.width // components[1].width, frame.height // components[1].height)
        sub = {(1, 1): "444", (2, 1): "422"}.get(ratio, "420")
        target = f"yuv{sub}p{suffix}"
    return frame.reformat(format=target), parse_pixel_format(target)


def planes_of(frame: av.VideoFrame, layout: PlanarFormat) -> tuple[npt.NDArray, ...]:
    """Return the planes of a frame of that format, views of its memory where they can be."""
    planes = []
    shapes = layout.plane_shapes(frame.width, frame.height)
    for plane, (rows, columns) in zip(frame.planes, shapes, strict=False):
        samples = np.frombuffer(memoryview(plane), layout.dtype)
        step = plane.line_size // layout.dtype.itemsize
        samples = samples[: rows * step].reshape(rows, step)[:, :columns]
        planes.append(samples.astype(layout.dtype.newbyteorder("="), copy=False))
    return tuple(planes)


def matrix_of(frame: av.VideoFrame) -> YcbcrMatrix:
    """Return the matrix that a frame is tagged with, or else the usual one of its kind."""
    told = _MATRICES.get(int(frame.colorspace))
    return told or matrix_for(frame.height, int(frame.color_primaries))


def range_of(frame: av.VideoFrame, layout: PlanarFormat, untold: Range) -> Range:
    """Return the range that a frame is tagged with; that of its format, or ``untold``, else."""
    tagged = int(frame.color_range or 0)
    if tagged == 2 or frame.format.name.startswith("yuvj") or not layout.has_chroma:
        return Range.LIMITED if tagged == 1 else Range.FULL
    return Range.LIMITED if tagged == 1 else untold


def picture_of(frame: av.VideoFrame, with_chroma: bool) -> Picture:
    """Return a frame as luma and, if wanted, chroma; see :meth:`VideoReader.picture`."""
    flat, layout = planar(frame)
    if layout is None:
        deep = max(component.bits for component in frame.format.components) > 8
        rgb = frame.to_ndarray(format="rgb48le" if deep else "rgb24")
        return picture_from_rgb(rgb, 65535.0 if deep else 255.0, with_chroma=with_chroma)
    value_range = range_of(frame, layout, Range.LIMITED)
    matrix = matrix_of(frame)
    return picture_from_planes(
        planes_of(flat, layout), layout, matrix, value_range, with_chroma=with_chroma
    )


def samples_of(frame: av.VideoFrame, path: Path) -> npt.NDArray:
    """Return the first plane of a frame as stored numbers; see :meth:`VideoReader.samples`."""
    flat, layout = planar(frame)
    if layout is None:
        deep = max(component.bits for component in frame.format.components) > 8
        rgb = frame.to_ndarray(format="rgb48le" if deep else "rgb24")
        if not ((rgb[..., 0] == rgb[..., 1]) & (rgb[..., 0] == rgb[..., 2])).all():
            raise SceneError("a depth map in colour; one channel is needed", path=path)
        return np.ascontiguousarray(rgb[..., 0])
    value_range = range_of(frame, layout, Range.FULL)
    return stored_values(planes_of(flat, layout)[0], layout.bits, value_range).copy()
