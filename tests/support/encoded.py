"""Small videos, written and read back."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path

import av
import numpy as np

from pipeline.media.encode import write_segment
from pipeline.media.join import join_segments
from pipeline.media.video_format import Container, VideoCodec, VideoFormat
from pipeline.stereo import StereoLayout

NTSC = Fraction(30000, 1001)

HEIGHT, WIDTH = 48, 80
"""Size of one eye in most tests."""

LOSSY = [
    (Container.MKV, VideoCodec.H264),
    (Container.MP4, VideoCodec.H264),
    (Container.WEBM, VideoCodec.VP9),
    (Container.MKV, VideoCodec.AV1),
    (Container.MP4, VideoCodec.HEVC),
    (Container.MOV, VideoCodec.PRORES),
]
"""Kinds of video whose pictures come back nearly."""


def video_format(
    container: Container = Container.MKV,
    codec: VideoCodec = VideoCodec.H264,
    layout: StereoLayout = StereoLayout.SBS,
    fps: Fraction = NTSC,
) -> VideoFormat:
    return VideoFormat(container=container, codec=codec, layout=layout, fps=fps)


def moving_eyes(
    numbers: range, height: int = HEIGHT, width: int = WIDTH, dtype: type = np.uint8
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield (left, right) RGB pictures that depend on nothing but the frame number."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    scale = 257 if dtype == np.uint16 else 1
    for number in numbers:
        waves = [np.sin((x + 3 * number) / 9), np.cos(y / 7 + number / 5), np.sin((x - y) / 11)]
        left = ((np.stack(waves, axis=-1) * 100 + 128) * scale).astype(dtype)
        yield left, np.roll(left, 5, axis=1)


def flat_eyes(colour: tuple[int, ...], height: int, width: int, dtype: type = np.uint8):
    scale = 257 if dtype == np.uint16 else 1
    eye = np.broadcast_to(np.array(colour) * scale, (height, width, 3)).astype(dtype)
    return eye, eye


def write_and_join(
    folder: Path, name: str, video: VideoFormat, segments: list[list]
) -> tuple[Path, list[Path]]:
    """Write lists of frames as segments and join them."""
    paths, first_frame = [], 100
    for index, frames in enumerate(segments):
        path = folder / f"{name}-{index}.mkv"
        assert write_segment(path, video, iter(frames), first_frame=first_frame) == len(frames)
        first_frame += len(frames)
        paths.append(path)
    out = folder / f"{name}.{video.container}"
    assert join_segments(paths, out, video) == first_frame - 100
    return out, paths


def decoded(path: Path, pixels: str | None = None) -> list[np.ndarray]:
    """Return the frames of a video."""
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format=pixels) for frame in container.decode(video=0)]


def digest(path: Path) -> str:
    """Return what tells files apart."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
