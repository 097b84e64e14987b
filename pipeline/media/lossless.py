"""Lossless clips for the browser: RGB in VP9 in WebM, and lossless video read sample by sample.

Nothing here converts colours: what is read are the stored RGB samples, what is written decodes
to the same ones. Samples of 16 bits are rounded to the 8 that screens show.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import av.error
import numpy as np
import numpy.typing as npt

from pipeline.errors import OutputError, SceneError
from pipeline.media.colorimetry import HLG, PQ
from pipeline.media.files import atomic_path, output_error

RgbImage = npt.NDArray[np.uint8]
"""(H, W, 3), red first, full range."""

LOSSLESS_CODECS = ("ffv1", "vp9", "png", "rawvideo", "utvideo", "huffyuv", "ffvhuff")
"""Codecs of RGB without loss; VP9 for what is written here."""

ENCODER_THREADS = 4
"""Fixed, since the bytes depend on it."""

_RGB, _FULL, _BT709, _SRGB = 0, 2, 1, 13
"""Code points of ITU-T H.273: matrix, range, primaries, transfer."""


@dataclass(frozen=True, kw_only=True)
class LosslessClip:
    """What a file of lossless video is."""

    path: Path
    fps: Fraction
    stereo_mode: str
    """Matroska's name of how two eyes share the picture; empty: it does not say."""

    def frames(self) -> Iterator[RgbImage]:
        """Yield the pictures, from the first."""
        with _opened(self.path) as container, _errors(self.path):
            for frame in container.decode(video=0):
                yield _rgb(frame, self.path)


def open_lossless(path: Path) -> LosslessClip:
    """Return a file of lossless video whose samples can be read as they are.

    Raises
    ------
    SceneError
        If it is missing, damaged, or its samples are not RGB or grey without loss.
    """
    with _opened(path) as container, _errors(path):
        stream = container.streams.video[0]
        name, pixels = stream.codec_context.name, stream.codec_context.pix_fmt or ""
        if name not in LOSSLESS_CODECS or not _is_rgb_or_grey(pixels):
            raise SceneError(
                f"{name} of {pixels}: has lost something already; stimuli are made of lossless "
                "results (--codec ffv1, or --frames-dir)",
                path=path,
            )
        if stream.codec_context.color_trc in (PQ, HLG):
            raise SceneError(
                "is of high dynamic range; the assessor's page shows 8 bits of an ordinary one: "
                "convert it before",
                path=path,
            )
        rate = stream.average_rate or stream.guessed_rate
        if not rate:
            raise SceneError("does not say its frame rate", path=path)
        return LosslessClip(
            path=path,
            fps=Fraction(rate.numerator, rate.denominator),
            stereo_mode=stream.metadata.get("stereo_mode", ""),
        )


def write_lossless_webm(path: Path, frames: Iterable[RgbImage], fps: Fraction) -> int:
    """Write a clip that decodes to the same samples; return the number of frames.

    Parameters
    ----------
    path : Path
        Written whole or not at all.
    frames : iterable of ndarray of shape (H, W, 3), uint8
        All alike.
    fps : Fraction

    Raises
    ------
    OutputError
        If there is no frame, they differ in size, or the file cannot be written.
    """
    count = 0
    with atomic_path(path) as temporary:
        try:
            with av.open(
                str(temporary), "w", format="webm", options={"fflags": "+bitexact"}
            ) as out:
                stream: Any = None
                for picture in frames:
                    if stream is None:
                        stream = _stream(out, picture, fps)
                    if picture.shape != (stream.height, stream.width, 3):
                        raise OutputError(f"{path}: frame {count} has another size than the first")
                    frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                    frame = frame.reformat(format="gbrp")
                    frame.pts, frame.time_base = count, 1 / fps
                    out.mux(stream.encode(frame))
                    count += 1
                if stream is None:
                    raise OutputError(f"{path}: there are no frames to write")
                out.mux(stream.encode(None))
        except av.error.FFmpegError as error:
            said = OSError(abs(error.errno or 0), error.strerror or str(error))
            raise output_error(path, said) from error
    return count


def to_8_bits(samples: npt.NDArray) -> RgbImage:
    """Return grey or RGB samples of 8 or 16 bits as RGB of 8 bits, rounded to nearest."""
    if samples.dtype == np.uint16:
        samples = ((samples.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if samples.ndim == 2:
        samples = np.repeat(samples[:, :, None], 3, axis=2)
    return np.ascontiguousarray(samples)


def _stream(out: Any, picture: RgbImage, fps: Fraction) -> Any:
    options = {"lossless": "1", "deadline": "good", "cpu-used": "2", "row-mt": "1", "g": "32"}
    stream = out.add_stream("libvpx-vp9", rate=fps, options=options)
    context = stream.codec_context
    context.height, context.width = picture.shape[:2]
    context.pix_fmt = "gbrp"
    context.time_base = 1 / fps
    context.thread_count = ENCODER_THREADS
    context.colorspace, context.color_range = _RGB, _FULL
    context.color_primaries, context.color_trc = _BT709, _SRGB
    return stream


def _is_rgb_or_grey(pixels: str) -> bool:
    return pixels.startswith(("gbr", "rgb", "bgr", "0rgb", "0bgr", "gray"))


def _rgb(frame: av.VideoFrame, path: Path) -> RgbImage:
    name = frame.format.name
    if not _is_rgb_or_grey(name):
        raise SceneError(f"changes to {name}, which is neither RGB nor grey", path=path)
    if name.startswith("gray"):
        return to_8_bits(frame.to_ndarray())
    deep = max(component.bits for component in frame.format.components) > 8
    return to_8_bits(frame.to_ndarray(format="rgb48le" if deep else "rgb24"))


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    try:
        container = av.open(str(path), metadata_errors="replace")
    except (av.error.FFmpegError, OSError) as error:
        raise SceneError(f"cannot be opened as a video: {error.strerror}", path=path) from error
    try:
        if not container.streams.video:
            raise SceneError("no video in this file", path=path)
        yield container
    finally:
        container.close()


@contextlib.contextmanager
def _errors(path: Path) -> Iterator[None]:
    try:
        yield
    except av.error.FFmpegError as error:
        raise SceneError(f"cut short or damaged: {error.strerror}", path=path) from error
