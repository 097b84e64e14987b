"""A scene on disk as a live source: its manifest, and each view's pictures as they are sent.

Pictures that lie on disk as PNG or JPEG are sent as they are; all others are
decoded and encoded. Depth keeps its stored values, so that a stream of PNG is
the scene, number for number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.colour import to_grey, to_rgb
from pipeline.errors import SceneError
from pipeline.media.depth_maps import camera_nearness, nearness_from_stored
from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_frames import EncodedPicture, PictureEncoding
from pipeline.media.live_manifest import LiveManifest, live_manifest, without_paths
from pipeline.media.png import encode_png
from pipeline.media.readers import OpenVideos, PictureReader, open_reader
from pipeline.media.scene import (
    DepthKind,
    ImageFiles,
    SceneDescription,
    ViewDescription,
)

FILE_ENCODINGS = {
    ".png": PictureEncoding.PNG, ".jpg": PictureEncoding.JPEG, ".jpeg": PictureEncoding.JPEG,
}  # fmt: skip

RAW_NAMES = {
    (np.dtype(np.uint8), 2): "gray", (np.dtype(np.uint8), 3): "rgb24",
    (np.dtype(np.uint16), 2): "gray16le", (np.dtype(np.uint16), 3): "rgb48le",
    (np.dtype(np.float32), 2): "grayf32le",
}  # fmt: skip
"""Pixel format by type and dimensions of an array."""


@dataclass(frozen=True, kw_only=True)
class _OpenView:
    description: ViewDescription
    color: PictureReader
    depth: PictureReader | None


class LiveSource:
    """The cameras of a scene.

    Parameters
    ----------
    scene : SceneDescription
        What lies where.
    encoding : PictureEncoding or None
        How colour is sent; None: as it lies on disk where that is PNG or JPEG, else JPEG.
    quality : int
        Of JPEG, 1 to 100.
    fps : Fraction or None
        Frames a second; None: the scene's.

    Raises
    ------
    SceneError
        If a file is missing.
    """

    def __init__(
        self,
        scene: SceneDescription,
        *,
        encoding: PictureEncoding | None = None,
        quality: int = 92,
        fps: Fraction | None = None,
    ) -> None:
        self._fps = fps
        self._scene, self._encoding, self._quality = scene, encoding, quality
        self._videos = OpenVideos()
        try:
            self._views = [self._open(view) for view in scene.views]
        except BaseException:
            self.close()
            raise
        counts = [view.color.num_frames for view in self._views]
        counts += [view.depth.num_frames for view in self._views if view.depth is not None]
        count = min(counts) if scene.frame_count is None else min(scene.frame_count, *counts)
        self.frame_indices = range(scene.first_frame, scene.first_frame + count)
        self.manifest: LiveManifest = live_manifest(self._manifest())

    def read(self, frame_index: int) -> dict[tuple[str, str], EncodedPicture]:
        """Return what all cameras send of one instant, by view id and ``color`` or ``depth``."""
        sent: dict[tuple[str, str], EncodedPicture] = {}
        for view in self._views:
            view_id = view.description.view_id
            sent[view_id, "color"] = self._color(view, frame_index)
            if view.depth is not None:
                sent[view_id, "depth"] = self._depth(view, frame_index)
        return sent

    def close(self) -> None:
        """Let go of all files; may be called twice."""
        for view in getattr(self, "_views", ()):
            for reader in (view.color, view.depth):
                if reader is not None:
                    reader.close()
        self._videos.close()

    def __enter__(self) -> LiveSource:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _open(self, view: ViewDescription) -> _OpenView:
        def reader(locator: Any) -> PictureReader:
            return open_reader(
                self._scene.root, locator, first_frame=self._scene.first_frame,
                frame_count=self._scene.frame_count, videos=self._videos,
            )  # fmt: skip

        try:
            depth = None if view.depth is None else reader(view.depth)
            return _OpenView(description=view, color=reader(view.color), depth=depth)
        except SceneError as error:
            raise SceneError(str(error), view=view.view_id) from error

    @property
    def _is_converted(self) -> bool:
        """True where depth cannot be told as it is stored, and is sent as nearness."""
        return self._scene.depth is not None and self._scene.depth.is_world_z

    def _manifest(self) -> dict[str, Any]:
        scene = self._scene
        stand_ins = tuple(
            replace(
                view,
                color=ImageFiles(pattern="x.png"),
                depth=None if view.depth is None else ImageFiles(pattern="x.png"),
            )
            for view in scene.views
        )
        depth = scene.depth
        if depth is not None and self._is_converted:
            depth = replace(
                depth, kind=DepthKind.INVERSE_DEPTH, scale=1.0, offset=0.0, unknown=None,
                is_world_z=False,
            )  # fmt: skip
        fps = (
            self._fps or scene.fps or next((v.color.fps for v in self._views if v.color.fps), None)
        )
        return without_paths(replace(scene, views=stand_ins, depth=depth, fps=fps))

    def _color(self, view: _OpenView, frame_index: int) -> EncodedPicture:
        found = self._file(view.description.color, frame_index)
        if found is not None and self._encoding in (None, found.encoding):
            return found
        picture = view.color.picture(frame_index)
        depth = view.color.form.bit_depth
        if picture.chroma is None:
            samples = to_grey(picture.luma, depth)
        else:
            samples = to_rgb(picture.luma, picture.chroma, depth)
        if self._encoding is PictureEncoding.RAW:
            return _raw(samples)
        if self._encoding is PictureEncoding.PNG:
            return EncodedPicture(encoding=PictureEncoding.PNG, data=encode_png(samples))
        if depth > 8:
            samples = np.rint(samples / 257.0).astype(np.uint8)
        data = encode_jpeg(samples, quality=self._quality)
        return EncodedPicture(encoding=PictureEncoding.JPEG, data=data)

    def _depth(self, view: _OpenView, frame_index: int) -> EncodedPicture:
        assert view.depth is not None
        assert view.description.depth is not None
        encoding = self._scene.depth
        if not self._is_converted:
            found = self._file(view.description.depth, frame_index)
            if found is not None and found.encoding is PictureEncoding.PNG:
                return found
        samples = view.depth.samples(frame_index)
        if self._is_converted and encoding is not None:
            assert view.description.calibration is not None
            world = nearness_from_stored(samples, encoding)
            samples = camera_nearness(world, view.description.calibration)
            samples = np.where(np.isfinite(samples), samples, np.float32(np.inf))
        if samples.dtype == np.float32 or self._encoding is PictureEncoding.RAW:
            return _raw(np.ascontiguousarray(samples))
        return EncodedPicture(encoding=PictureEncoding.PNG, data=encode_png(samples))

    def _file(self, locator: object, frame_index: int) -> EncodedPicture | None:
        """Return an image file as it is, where it is one that can be sent."""
        if not isinstance(locator, ImageFiles):
            return None
        path = self._scene.root / locator.path_of(frame_index)
        encoding = FILE_ENCODINGS.get(Path(path).suffix.lower())
        if encoding is None:
            return None
        try:
            return EncodedPicture(encoding=encoding, data=path.read_bytes())
        except OSError as error:
            raise SceneError(f"cannot be read: {error.strerror}", path=path) from error


def _raw(samples: np.ndarray) -> EncodedPicture:
    height, width = samples.shape[:2]
    little = samples.astype(samples.dtype.newbyteorder("<"), copy=False)
    return EncodedPicture(
        encoding=PictureEncoding.RAW,
        data=little.tobytes(),
        width=width,
        height=height,
        pixel_format=RAW_NAMES[np.dtype(samples.dtype.newbyteorder("=")), samples.ndim],
    )
