"""One reader for each way a view's pictures can lie on disk, all with one face.

A reader is asked by source frame number; it answers with a :class:`Picture` (for colour) or
with the stored numbers (for depth). Errors name the file; view and frame are added by the
caller.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pipeline.colour import Picture, picture_from_grey, picture_from_rgb
from pipeline.errors import SceneError
from pipeline.media.colorimetry import BT709, BT2020, Colorimetry
from pipeline.media.decode import VideoReader
from pipeline.media.images import read_header, read_image
from pipeline.media.scene import (
    ImageFiles,
    Locator,
    PackedEye,
    RawVideo,
    VideoFile,
    confined,
)
from pipeline.media.ycbcr import YcbcrMatrix
from pipeline.media.yuv import RawVideoFile
from pipeline.stereo import pad_to_multiple

ROUNDED = Fraction(1, 100)
"""By how much the shape of a pixel differs from a square, at most, where sizes were but rounded."""


@dataclass(frozen=True, kw_only=True)
class PictureForm:
    """What the pictures of a reader look like."""

    width: int
    """Pixels."""
    height: int
    """Pixels."""
    is_color: bool
    bit_depth: int
    """8, 10 or 16."""
    colorimetry: Colorimetry = field(default_factory=Colorimetry)
    pixel_aspect: Fraction = Fraction(1)
    """Width over height of a pixel as shown."""


class PictureReader(Protocol):
    """Reads one view's pictures, or its depth maps."""

    form: PictureForm
    num_frames: int
    """Frames that can be read, from the scene's first frame on."""
    fps: Fraction | None
    """What the file says; None: nothing."""
    timecode: str | None
    """Of the first frame, as the file says it."""
    has_uneven_times: bool
    """Whether the file shows its frames for unequal times."""
    is_interlaced: bool
    """Whether the two fields of a frame were taken one after the other."""
    holds_layers: bool
    """Whether a second view lies in layers that are not read."""
    is_still: bool
    """True for a single image file."""
    repeats_line: bool
    """Whether the last row or column is one that is there once more."""

    def picture(self, frame_index: int, *, with_chroma: bool = True) -> Picture:
        """Return the picture of that source frame number as luma and, if wanted, chroma."""

    def samples(self, frame_index: int) -> npt.NDArray:
        """Return the stored values of that source frame number, (H, W)."""

    def approach(self, frame_index: int) -> bool:
        """Come nearer to a frame, by little work; return whether it can be read at once."""

    def missing(self, frame_index: int) -> SceneError:
        """Return what to say of a frame that is not there."""

    def close(self) -> None:
        """Let go of files; further reads are undefined."""


class OpenVideos:
    """Video files that several readers share, each opened once."""

    def __init__(self) -> None:
        self._videos: dict[Path, VideoReader] = {}

    def open(self, path: Path) -> VideoReader:
        """Return the reader of that file."""
        if path not in self._videos:
            self._videos[path] = VideoReader(path)
        return self._videos[path]

    def close(self) -> None:
        """Close all of them."""
        for video in self._videos.values():
            video.close()
        self._videos.clear()


def open_reader(
    root: Path, locator: Locator, *, first_frame: int, frame_count: int | None, videos: OpenVideos
) -> PictureReader:
    """Return the reader for a locator.

    Parameters
    ----------
    root : Path
        The scene's folder.
    locator : Locator
        Where the pictures lie.
    first_frame : int
        Source frame number of the first frame.
    frame_count : int or None
        Frames wanted; None: count them.
    videos : OpenVideos
        Where video files are opened, so that two halves of one are decoded once.

    Raises
    ------
    SceneError
        If the first file cannot be read, or a path leaves the folder.
    """
    if isinstance(locator, ImageFiles):
        return ImageFilesReader(root, locator, first_frame, frame_count)
    path = confined(root, locator.path)
    if isinstance(locator, VideoFile):
        return VideoFileReader(videos.open(path), first_frame)
    if isinstance(locator, PackedEye):
        return PackedEyeReader(videos.open(path), locator, first_frame)
    return RawVideoReader(path, locator, first_frame)


class ImageFilesReader:
    """Image files by pattern, or one image."""

    repeats_line = False
    timecode: str | None = None
    has_uneven_times = False
    is_interlaced = False
    holds_layers = False

    def __init__(
        self, root: Path, files: ImageFiles, first_frame: int, frame_count: int | None
    ) -> None:
        self._root, self._files = root, files
        self.fps: Fraction | None = None
        self.is_still = files.is_still
        self.num_frames = self._count(first_frame, frame_count)
        if not self.num_frames:
            raise self.missing(first_frame)
        header = read_header(self._path(first_frame))
        self.form = PictureForm(
            width=header.width,
            height=header.height,
            is_color=header.channels == 3,
            bit_depth=header.bit_depth,
            colorimetry=header.colorimetry,
        )

    def _path(self, frame_index: int) -> Path:
        return confined(self._root, self._files.path_of(frame_index))

    def _count(self, first_frame: int, frame_count: int | None) -> int:
        if self.is_still:
            return int(os.path.isfile(self._path(first_frame)))
        count = 0
        while (frame_count is None or count < frame_count) and os.path.isfile(
            self._path(first_frame + count)
        ):
            count += 1
        return count

    def picture(self, frame_index: int, *, with_chroma: bool = True) -> Picture:
        """Return the picture of that frame."""
        path = self._path(frame_index)
        image = read_image(path)
        if image.samples.dtype == np.float32:
            raise SceneError("a colour image of floating-point samples", path=path)
        if image.samples.ndim == 2:
            return picture_from_grey(image.samples, image.peak)
        return picture_from_rgb(image.samples, image.peak, with_chroma=with_chroma)

    def samples(self, frame_index: int) -> npt.NDArray:
        """Return the stored values of that frame."""
        path = self._path(frame_index)
        stored = read_image(path).samples
        if stored.ndim == 3:
            if not ((stored[..., 0] == stored[..., 1]) & (stored[..., 0] == stored[..., 2])).all():
                raise SceneError("a depth map in colour; one channel is needed", path=path)
            stored = stored[..., 0]
        if stored.dtype == np.float32 and np.isnan(stored).any():
            row, column = np.argwhere(np.isnan(stored))[0]
            raise SceneError(
                f"NaN in a floating-point depth map, at row {row}, column {column}; "
                "unknown depth is infinite, or the value of 'unknown'",
                path=path,
            )
        return stored

    def approach(self, frame_index: int) -> bool:
        """Files do not need one another."""
        return True

    def missing(self, frame_index: int) -> SceneError:
        """Return what to say of a frame whose file is not there."""
        path = self._path(frame_index)
        if self.is_still and os.path.isfile(path):
            return SceneError("one image, and so one frame", path=path)
        return SceneError("the file is missing", path=path)

    def close(self) -> None:
        """Nothing is kept open."""


class _StreamReader:
    """What readers of one file with many frames share."""

    is_still = False
    repeats_line = False

    def __init__(self, path: Path, first_frame: int, num_frames: int) -> None:
        self._path, self._first = path, first_frame
        self.num_frames = num_frames

    def approach(self, frame_index: int) -> bool:
        """Frames do not need one another."""
        return True

    def missing(self, frame_index: int) -> SceneError:
        """Return what to say of a frame after the file's end."""
        return SceneError(
            f"the file holds {self.num_frames} frame{'s'[: self.num_frames != 1]}, numbered "
            f"{self._first} to {self._first + self.num_frames - 1}",
            path=self._path,
        )

    def close(self) -> None:
        """Files are closed by whoever opened them."""


class VideoFileReader(_StreamReader):
    """A video file."""

    def __init__(self, video: VideoReader, first_frame: int) -> None:
        super().__init__(video.path, first_frame, video.num_frames)
        self._video = video
        self.fps: Fraction | None = video.fps
        self.timecode: str | None = video.timecode
        self.has_uneven_times = video.has_uneven_times
        self.is_interlaced = video.is_interlaced
        self.holds_layers = video.holds_layers
        self.form = PictureForm(
            width=video.width,
            height=video.height,
            is_color=video.is_color,
            bit_depth=video.bit_depth,
            colorimetry=video.colorimetry,
            pixel_aspect=_shape_of(video),
        )

    def picture(self, frame_index: int, *, with_chroma: bool = True) -> Picture:
        """Return the picture of that frame."""
        return self._video.picture(frame_index - self._first, with_chroma=with_chroma)

    def samples(self, frame_index: int) -> npt.NDArray:
        """Return the stored values of that frame."""
        return self._video.samples(frame_index - self._first)

    def approach(self, frame_index: int) -> bool:
        """Decode a few of the frames that this one needs."""
        return self._video.approach(frame_index - self._first)


def _shape_of(video: VideoReader) -> Fraction:
    """Return width over height of a pixel as shown; 1 where it is nearly that."""
    aspect = video.pixel_aspect or Fraction(1)
    return Fraction(1) if abs(aspect - 1) < ROUNDED else aspect


class PackedEyeReader(VideoFileReader):
    """One half of the pictures of a video file; of an odd number of lines the last is repeated."""

    def __init__(self, video: VideoReader, eye: PackedEye, first_frame: int) -> None:
        super().__init__(video, first_frame)
        video.keeps_last = True
        width, height = video.width, video.height
        side = width if eye.layout.is_horizontal else height
        if side < 2:
            raise SceneError(f"too small to hold two views ({eye.layout.value})", path=video.path)
        self.repeats_line = bool(side % 2)
        half = (side + 1) // 2
        if eye.layout.is_horizontal:
            width, self._multiples = half, (1, 2)
        else:
            height, self._multiples = half, (2, 1)
        self.form = PictureForm(
            width=width,
            height=height,
            is_color=video.is_color,
            bit_depth=video.bit_depth,
            colorimetry=video.colorimetry,
            pixel_aspect=eye.layout.pixel_aspect_of(_shape_of(video)),
        )
        row = height if eye.second and not eye.layout.is_horizontal else 0
        column = width if eye.second and eye.layout.is_horizontal else 0
        self._window = (slice(row, row + height), slice(column, column + width))

    def picture(self, frame_index: int, *, with_chroma: bool = True) -> Picture:
        """Return the half of that frame, as new arrays."""
        whole = super().picture(frame_index, with_chroma=with_chroma)
        return Picture(
            luma=self._half(whole.luma),
            chroma=None if whole.chroma is None else self._half(whole.chroma),
        )

    def samples(self, frame_index: int) -> npt.NDArray:
        """Return the stored values of the half of that frame."""
        return self._half(super().samples(frame_index))

    def _half(self, whole: npt.NDArray) -> npt.NDArray:
        return pad_to_multiple(whole, *self._multiples)[self._window].copy()


class RawVideoReader(_StreamReader):
    """A file of raw frames."""

    fps: Fraction | None = None
    timecode: str | None = None
    has_uneven_times = False
    is_interlaced = False
    holds_layers = False

    def __init__(self, path: Path, raw: RawVideo, first_frame: int) -> None:
        self._file = RawVideoFile(
            path,
            width=raw.width,
            height=raw.height,
            pixel_format=raw.pixel_format,
            matrix=raw.matrix,
            value_range=raw.range,
        )
        super().__init__(path, first_frame, self._file.num_frames)
        bits = self._file.layout.bits
        self.form = PictureForm(
            width=raw.width,
            height=raw.height,
            is_color=self._file.layout.has_chroma,
            bit_depth=8 if bits == 8 else 10 if bits <= 10 else 16,
            colorimetry=Colorimetry(
                primaries=BT2020 if raw.matrix is YcbcrMatrix.BT2020 else BT709
            ),
        )

    def picture(self, frame_index: int, *, with_chroma: bool = True) -> Picture:
        """Return the picture of that frame."""
        return self._file.picture(frame_index - self._first, with_chroma=with_chroma)

    def samples(self, frame_index: int) -> npt.NDArray:
        """Return the stored values of that frame."""
        return self._file.samples(frame_index - self._first)
