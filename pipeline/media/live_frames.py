"""Frames from what cameras send: encoded pictures in, a multi-view frame out.

What comes is not to be trusted: size and shape are read from the header and
compared with the limits before anything is decoded.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.colour import CHROMA_CENTRE, Picture, picture_from_grey, picture_from_rgb
from pipeline.errors import SceneError
from pipeline.frames import DepthMap, MultiViewFrame, View
from pipeline.media.depth_estimation import estimate_missing_depth
from pipeline.media.depth_maps import nearness_from_stored, resampled
from pipeline.media.images import StoredImage, declared_header, decode_image, image_kind
from pipeline.media.live_manifest import LiveManifest
from pipeline.media.scene import DepthKind
from pipeline.media.ycbcr import matrix_for
from pipeline.media.yuv import (
    PlanarFormat,
    Range,
    parse_pixel_format,
    picture_from_planes,
)
from pipeline.threads import map_threads

MAX_SIDE = 1 << 15
"""Longest side of a picture, pixels."""

MAX_RATIO = 1100
"""Most pixels that a byte of a large PNG or JPEG may stand for (deflate reaches 1032)."""

SMALL = 1 << 20
"""Pictures up to this size may stand for any ratio, pixels."""

PACKED: dict[str, tuple[np.dtype[Any], int]] = {
    "rgb24": (np.dtype("u1"), 3), "bgr24": (np.dtype("u1"), 3), "rgba": (np.dtype("u1"), 4),
    "bgra": (np.dtype("u1"), 4), "rgb48le": (np.dtype("<u2"), 3), "grayf32le": (np.dtype("<f4"), 1),
}  # fmt: skip
"""Pixel formats besides the planar ones: type of a sample, samples a pixel."""


class PictureEncoding(StrEnum):
    """How a picture is sent."""

    JPEG = "image/jpeg"
    PNG = "image/png"
    RAW = "video/raw"

    @classmethod
    def named(cls, name: str) -> PictureEncoding:
        """Return the encoding of a short name: ``jpeg``, ``png`` or ``raw``."""
        return cls[name.upper()]


@dataclass(frozen=True, kw_only=True, eq=False)
class EncodedPicture:
    """A picture or depth map as it came."""

    encoding: PictureEncoding
    data: bytes
    width: int = 0
    """Of raw ones, pixels."""
    height: int = 0
    """Of raw ones, pixels."""
    pixel_format: str = ""
    """Of raw ones: FFmpeg's name."""


@dataclass(frozen=True, kw_only=True)
class Refused:
    """A picture that cannot be used."""

    view_id: str
    part: str
    """``color`` or ``depth``."""
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class _Decoded:
    color: Mapping[str, Picture]
    depth: Mapping[str, DepthMap]


class LiveFrames:
    """Makes frames of the pictures of one live source.

    Parameters
    ----------
    manifest : LiveManifest
        What the source is.
    max_pixels : int
        Largest picture taken.
    """

    def __init__(self, manifest: LiveManifest, *, max_pixels: int = 1 << 25) -> None:
        self.manifest = manifest
        self.max_pixels = max_pixels

    def decode(
        self,
        color: Mapping[str, EncodedPicture],
        depth: Mapping[str, EncodedPicture],
        *,
        colour: Container[str] | None = None,
    ) -> tuple[_Decoded, list[Refused]]:
        """Return what could be decoded of a frame, and what could not.

        All pictures of a frame must be of the size of its left reference (of
        the first one, where that is missing).

        Parameters
        ----------
        color, depth : mapping of EncodedPicture
            By view id; several are decoded at a time.
        colour : container of view ids, optional
            Views of which more than luma is wanted; all if left out.
        """

        def decoded(item: tuple[str, EncodedPicture]) -> Picture | SceneError:
            view_id, picture = item
            with_chroma = colour is None or view_id in colour
            try:
                return decode_color(picture, max_pixels=self.max_pixels, with_chroma=with_chroma)
            except SceneError as error:
                return error

        refused: list[Refused] = []
        pictures: dict[str, Picture] = {}
        for view_id, found in zip(color, map_threads(decoded, color.items()), strict=True):
            if isinstance(found, Picture):
                pictures[view_id] = found
            else:
                refused.append(Refused(view_id=view_id, part="color", reason=str(found)))
        shape = self._shape(pictures)
        for view_id in [key for key, item in pictures.items() if item.luma.shape != shape]:
            height, width = pictures.pop(view_id).luma.shape
            reason = f"{width}×{height} pixels, others of the frame are {shape[1]}×{shape[0]}"
            refused.append(Refused(view_id=view_id, part="color", reason=reason))
        maps: dict[str, DepthMap] = {}
        encoding = self.manifest.scene.depth

        def nearness_of(item: EncodedPicture) -> DepthMap | SceneError:
            assert encoding is not None
            try:
                stored = decode_samples(item, max_pixels=self.max_pixels)
                return resampled(nearness_from_stored(stored, encoding), shape)
            except SceneError as error:
                return error

        wanted = {} if encoding is None else {key: depth[key] for key in depth if key in pictures}
        for view_id, near in zip(wanted, map_threads(nearness_of, wanted.values()), strict=True):
            if isinstance(near, SceneError):
                refused.append(Refused(view_id=view_id, part="depth", reason=str(near)))
            elif np.isfinite(near).any():
                maps[view_id] = near
        return _Decoded(color=pictures, depth=maps), refused

    def frame(
        self, frame_index: int, decoded: _Decoded, *, depth: Container[str] | None = None
    ) -> MultiViewFrame:
        """Return the frame of what was decoded; missing depth is estimated where it is needed.

        Parameters
        ----------
        depth : container of view ids, optional
            Views whose depth is needed; all if left out.

        Raises
        ------
        SceneError
            If a reference view is not among it.
        """
        scene = self.manifest.scene
        left, right = self.manifest.pair
        for view_id in (left, right):
            if view_id not in decoded.color:
                raise SceneError("is needed, and missing", view=view_id, frame=frame_index)
        is_color = any(item.chroma is not None for item in decoded.color.values())
        calibrated = all(view.calibration is not None for view in scene.views)
        views = []
        for view in scene.views:
            if view.view_id not in decoded.color:
                continue
            picture = decoded.color[view.view_id]
            chroma = picture.chroma
            if chroma is None and is_color:
                chroma = np.full((*picture.luma.shape, 2), CHROMA_CENTRE, np.float32)
            views.append(
                View(
                    view_id=view.view_id,
                    luma=picture.luma,
                    chroma=chroma,
                    depth_map=decoded.depth.get(view.view_id),
                    calibration=view.calibration,
                )
            )
        is_metric = calibrated and (
            scene.depth is None or scene.depth.kind is not DepthKind.DISPARITY
        )
        deep = [view for view in views if depth is None or view.view_id in depth]
        filled = {
            view.view_id: view
            for view in estimate_missing_depth(deep, depth_is_metric=is_metric)
        }  # fmt: skip
        return MultiViewFrame(
            frame_index=frame_index,
            views=tuple(filled.get(view.view_id, view) for view in views),
            left=left,
            right=right,
            depth_is_metric=is_metric,
        )

    def _shape(self, pictures: Mapping[str, Picture]) -> tuple[int, int]:
        chosen = pictures.get(self.manifest.pair[0]) or next(iter(pictures.values()), None)
        if chosen is None:
            return 0, 0
        height, width = chosen.luma.shape
        return height, width


def decode_color(item: EncodedPicture, *, max_pixels: int, with_chroma: bool = True) -> Picture:
    """Return a picture as luma and chroma.

    Parameters
    ----------
    with_chroma : bool
        False: luma alone is wanted.

    Raises
    ------
    SceneError
        If it is larger than allowed, of another kind than it says, cut short or damaged.
    """
    if item.encoding is not PictureEncoding.RAW:
        stored = _decoded_file(item, max_pixels)
        if stored.samples.ndim == 3:
            return picture_from_rgb(stored.samples, stored.peak, with_chroma=with_chroma)
        return picture_from_grey(stored.samples, stored.peak)
    if item.pixel_format in PACKED:
        samples = _packed(item, max_pixels)
        if samples.dtype == np.float32:
            raise SceneError(f"{item.pixel_format}: is for depth only")
        if samples.ndim == 2:
            return picture_from_grey(samples, float(np.iinfo(samples.dtype).max))
        rgb = samples[..., 2::-1] if item.pixel_format.startswith("bgr") else samples[..., :3]
        peak = float(np.iinfo(rgb.dtype).max)
        return picture_from_rgb(np.ascontiguousarray(rgb), peak, with_chroma=with_chroma)
    layout, planes = _planes(item, max_pixels)
    value_range = Range.LIMITED if layout.has_chroma else Range.FULL
    if item.pixel_format.startswith("yuvj"):
        value_range = Range.FULL
    matrix = matrix_for(item.height)
    return picture_from_planes(planes, layout, matrix, value_range, with_chroma=with_chroma)


def decode_samples(item: EncodedPicture, *, max_pixels: int) -> npt.NDArray:
    """Return the stored values of a depth map, (H, W) uint8, uint16 or float32.

    Raises
    ------
    SceneError
        As :func:`decode_color`; also if it is in colour.
    """
    if item.encoding is PictureEncoding.RAW:
        if item.pixel_format in PACKED:
            samples = _packed(item, max_pixels)
        else:
            samples = _planes(item, max_pixels)[1][0]
    else:
        samples = _decoded_file(item, max_pixels).samples
    if samples.ndim == 3:
        if not ((samples[..., 0] == samples[..., 1]) & (samples[..., 0] == samples[..., 2])).all():
            raise SceneError("a depth map in colour; one channel is needed")
        samples = np.ascontiguousarray(samples[..., 0])
    return samples


def _decoded_file(item: EncodedPicture, max_pixels: int) -> StoredImage:
    name = Path(item.encoding.value)
    kind = image_kind(item.data[:16], name)
    if f"image/{kind}" != item.encoding.value:
        raise SceneError(f"says {item.encoding.value} and is {kind.upper()}")
    header = declared_header(item.data, name)
    _check_size(header.width, header.height, max_pixels)
    pixels = header.width * header.height
    if pixels > SMALL and pixels > MAX_RATIO * len(item.data):
        raise SceneError(
            f"{header.width}×{header.height} pixels of {len(item.data)} bytes: too good to be true"
        )
    return decode_image(item.data, name)


def _check_size(width: int, height: int, max_pixels: int) -> None:
    if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and width * height <= max_pixels):
        raise SceneError(f"{width}×{height} pixels; up to {max_pixels} are taken")


def _packed(item: EncodedPicture, max_pixels: int) -> npt.NDArray:
    _check_size(item.width, item.height, max_pixels)
    dtype, channels = PACKED[item.pixel_format]
    _check_bytes(item, item.width * item.height * channels * dtype.itemsize)
    samples = np.frombuffer(item.data, dtype).astype(dtype.newbyteorder("="), copy=False)
    shape = (item.height, item.width, channels)
    return samples.reshape(shape[:2] if channels == 1 else shape)


def _planes(item: EncodedPicture, max_pixels: int) -> tuple[PlanarFormat, tuple[npt.NDArray, ...]]:
    _check_size(item.width, item.height, max_pixels)
    try:
        layout = parse_pixel_format(item.pixel_format)
    except ValueError as error:
        raise SceneError(f"{error}; or {', '.join(PACKED)}") from error
    _check_bytes(item, layout.frame_bytes(item.width, item.height))
    samples = np.frombuffer(item.data, layout.dtype)
    samples = samples.astype(layout.dtype.newbyteorder("="), copy=False)
    planes, at = [], 0
    for rows, columns in layout.plane_shapes(item.width, item.height):
        planes.append(samples[at : at + rows * columns].reshape(rows, columns))
        at += rows * columns
    return layout, tuple(planes)


def _check_bytes(item: EncodedPicture, wanted: int) -> None:
    if len(item.data) != wanted:
        raise SceneError(
            f"{len(item.data)} bytes; {item.width}×{item.height} {item.pixel_format} are {wanted}"
        )
