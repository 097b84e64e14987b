"""Video out: segments that depend on nothing but their frames.

A job is cut into segments; each is encoded by a fresh encoder into a small Matroska file
(:mod:`pipeline.media.join` copies them into the container asked for). Encoders run with fixed
thread counts, so that a job ends with the same bytes however often it was interrupted and
wherever its segments were made.

The stereo layout is signalled in every way players read: H.264 frame-packing
SEI (3-D televisions), Matroska and WebM StereoMode, MP4 ``st3d`` box, shape of
the samples (half layouts). For the file name see ``video_format.suggested_name``.
"""

from __future__ import annotations

import contextlib
import errno
import operator
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import numpy.typing as npt

from pipeline.errors import OutputError
from pipeline.machine import available_cores
from pipeline.media.colorimetry import Colorimetry, MasteringDisplay
from pipeline.media.files import atomic_path, output_error
from pipeline.media.matroska import ROOM, set_light
from pipeline.media.video_format import VideoCodec, VideoFormat
from pipeline.media.ycbcr import (
    MATRIX_CODES,
    YcbcrMatrix,
    Yuv420,
    matrix_for,
    to_yuv420,
    to_yuv422,
)
from pipeline.stereo import Picture, StereoLayout, pack, pad_to_multiple

Eyes = tuple[Picture, Picture] | tuple[Picture]
"""(left, right), or the one picture of layouts ``left``, ``right`` and ``views``;
(H, W, 3) RGB or (H, W) grey, uint8 or uint16, full range."""

CodedEyes = tuple[Yuv420]
"""The same as they are coded, packed as the layout says."""

KEYFRAME_INTERVAL = 32
"""Frames from one keyframe to the next at most, for seeking; segments start with one anyway."""

ENCODER_THREADS = 4
"""Fixed, whatever the machine, but where H.264 has to be quick: its bytes and those of VP9 depend
on it."""

QP_PER_BIT = 6
"""Steps of x264's quantiser for one bit of a sample, which its rate factor does without."""

MIN_SLICED_SIZE = 32
"""Height and width from which FFV1 pictures are cut into slices, samples."""

REORDERED = 16
"""Frames that an encoder keeps back to put them in another order, at most."""

LEAST_HEVC_SIZE = 16
"""Height and width from which x265 takes pictures, samples."""

LEAST_AV1_SIZE = 4
"""Height and width from which SVT-AV1 takes pictures, samples."""

LEAST_LONG_AV1_SIZE = 32
"""The same where the other side is longer than a superblock: below 28, SVT-AV1 4.1 waits for
ever, deaf to signals."""

AV1_SUPERBLOCK = 64
"""Samples along a side."""


FIRST_FRAME_TAG = "DEPTHSR_FIRST_FRAME"
"""Of a segment: source frame number of its first frame."""

_ENCODERS: dict[VideoCodec, tuple[str, dict[str, str]]] = {
    VideoCodec.H264: ("libx264", {"preset": "veryfast", "bf": "3"}),
    VideoCodec.HEVC: ("libx265", {"preset": "fast"}),
    VideoCodec.VP9: (
        "libvpx-vp9",
        {"deadline": "good", "cpu-used": "5", "tile-columns": "2", "row-mt": "0"},
    ),
    VideoCodec.AV1: ("libsvtav1", {"preset": "8"}),
    VideoCodec.FFV1: ("ffv1", {"level": "3", "slicecrc": "1", "g": "1"}),
    VideoCodec.PRORES: ("prores_ks", {"profile": "hq", "vendor": "apl0"}),
}
"""Encoder and its settings, by codec."""

_QUICK = {
    VideoCodec.H264: {"preset": "ultrafast", "bf": "0"},
    VideoCodec.HEVC: {"preset": "ultrafast"},
}
"""What is set otherwise where the encoder has to be quick."""

_EXACT_X264 = (
    "aq-mode=0:no-mbtree=1:no-dct-decimate=1:psy=0:chroma-qp-offset=-6"
    ":deadzone-intra=6:deadzone-inter=6"
)
"""x264 by fidelity instead of by looks: small coefficients stay, no block is coarser than
another, and chroma, one code of which is two of red or blue, is finer than luma."""

_QUICK_X264 = "deadzone-inter=12"
"""What is set otherwise where x264 has to be quick: of what a frame adds to the one before it,
fewer of the smallest coefficients stay."""

_EXACT_X265 = (
    "aq-mode=0:cutree=0:psy-rd=0:psy-rdoq=0:rdoq-level=0:sao=0:cbqpoffs=-6:crqpoffs=-6"
    ":deblock=-2,-2"
)
"""The same of x265."""

_FIXED_X265 = (
    f"log-level=none:info=0:frame-threads=2:pools={ENCODER_THREADS}:open-gop=0:b-pyramid=0"
    ":bframes=3"
)
"""Bytes that depend on the pictures alone, and segments that need nothing of each other."""

_LOSSLESS_PIXELS = {
    (8, False): "bgr0",
    (8, True): "gray",
    (16, False): "gbrp16le",
    (16, True): "gray16le",
}
"""Pixel format by (bits, is grey)."""

_PRORES_PIXELS = "yuv422p10le"


BITEXACT = {"fflags": "+bitexact"}
"""Makes muxers leave out random ids and version strings."""


def write_segment(
    path: Path, video_format: VideoFormat, frames: Iterable[Eyes | CodedEyes], *, first_frame: int
) -> int:
    """Encode frames into a file of their own, whole or not at all; return how many there were.

    Parameters
    ----------
    path : Path
        A Matroska file, whatever container the job ends in.
    video_format : VideoFormat
    frames : iterable of tuples of ndarray
        ``(left, right)``, or one picture for ``left``, ``right`` and ``views``;
        (H, W, 3) RGB or (H, W) grey, uint8 or uint16, all alike. What it
        raises passes unchanged.
    first_frame : int
        Source frame number of the first of them;
        :func:`pipeline.media.join.join_segments` checks the order by it.

    Raises
    ------
    OutputError
        If the file cannot be written, there is no frame, or frames differ in
        size or type.
    """
    with atomic_path(path) as temporary, contextlib.closing(
        _SegmentEncoder(path, temporary, video_format, first_frame)
    ) as encoder:  # fmt: skip
        for eyes in frames:
            encoder.add(eyes)
        return encoder.finish()


def check_size(path: Path, video_format: VideoFormat, hr_shape: tuple[int, int], eyes: int) -> None:
    """See to it that the encoder takes pictures made of that many eyes, before any is computed.

    Parameters
    ----------
    path : Path
        What the pictures are for, for the message.
    video_format : VideoFormat
    hr_shape : tuple of int
        (height, width) of one eye.
    eyes : int
        1 or 2.

    Raises
    ------
    OutputError
        If it does not.
    """
    if video_format.codec not in (VideoCodec.AV1, VideoCodec.HEVC):
        return
    eye = np.zeros(hr_shape, np.uint8)
    height, width = _picture((eye, eye) if eyes == 2 else (eye,), video_format).shape
    if video_format.codec is VideoCodec.HEVC:
        least = LEAST_HEVC_SIZE
    else:
        least = LEAST_LONG_AV1_SIZE if max(height, width) > AV1_SUPERBLOCK else LEAST_AV1_SIZE
    if min(height, width) < least:
        codec = video_format.codec.value
        raise OutputError(
            f"{path}: cannot be written: {codec} takes no pictures of {width}×{height}; "
            f"choose another codec"
        )


def write_planes(frame: av.VideoFrame, planes: Sequence[npt.NDArray]) -> None:
    """Fill a planar frame, which may be one that was encoded before."""
    frame.make_writable()  # new memory only where the encoder still holds the old
    for plane, samples in zip(frame.planes, planes, strict=True):
        rows, columns = samples.shape
        stored = np.frombuffer(memoryview(plane), samples.dtype)
        step = plane.line_size // samples.itemsize
        stored[: rows * step].reshape(rows, step)[:, :columns] = samples


@dataclass(kw_only=True)
class _Pixels:
    """How pictures go into frames of the encoder."""

    name: str
    """FFmpeg's name of the pixel format."""
    coded_bits: int
    matrix: YcbcrMatrix | None
    """None where samples go in as they are."""
    _frame: av.VideoFrame | None = None
    """The last one of planes: the next picture takes its memory over."""

    def frame(self, picture: Picture | Yuv420) -> av.VideoFrame:
        """Return the picture as a frame of the encoder's pixel format."""
        if isinstance(picture, Yuv420):
            return self._planar(picture.planes)
        if self.matrix is not None and self.name == _PRORES_PIXELS:
            planes = to_yuv422(picture, self.matrix, coded_bits=self.coded_bits)
            return av.VideoFrame.from_ndarray(np.stack(planes), format=self.name)
        if self.matrix is not None:
            return self._planar(to_yuv420(picture, self.matrix, coded_bits=self.coded_bits))
        if self.name == "bgr0":
            # Same samples in another order; nothing is computed.
            return av.VideoFrame.from_ndarray(picture, format="rgb24").reformat(format="bgr0")
        return av.VideoFrame.from_ndarray(picture, format=self.name)

    def _planar(self, planes: Sequence[npt.NDArray]) -> av.VideoFrame:
        if self._frame is None:
            height, width = planes[0].shape
            self._frame = av.VideoFrame(width, height, self.name)
        write_planes(self._frame, planes)
        return self._frame


class _SegmentEncoder:
    """One encoder and the file it fills; opened by the first picture, which sets the size."""

    def __init__(
        self, path: Path, temporary: Path, video_format: VideoFormat, first_frame: int
    ) -> None:
        self._path = path
        self._temporary = temporary
        self._format = video_format
        self._first_frame = first_frame
        self._container: Any = None
        self._stream: Any = None
        self._pixels: _Pixels | None = None
        self._like: tuple[tuple[int, ...], np.dtype] | None = None
        self._eyes: Sequence[Picture | Yuv420] = ()
        self._frame: Any = None
        self._num_frames = 0

    def add(self, eyes: Eyes | CodedEyes) -> None:
        if len(self._eyes) == len(eyes) and all(map(operator.is_, self._eyes, eyes)):
            self._encode()  # the same picture again
            return
        self._eyes = eyes
        picture = _picture(eyes, self._format)
        like = (picture.shape, picture.dtype)
        if self._like is None:
            if not isinstance(picture, Yuv420):
                check_size(self._path, self._format, eyes[0].shape[:2], len(eyes))
            self._like = like
            with self._errors():
                self._open(picture)
        elif like != self._like:
            raise OutputError(
                f"{self._path}: frame {self._first_frame + self._num_frames} is "
                f"{_describe(*like)}, the frames before are {_describe(*self._like)}"
            )
        assert self._pixels is not None
        with self._errors():
            self._frame = self._pixels.frame(picture)
            _tag_colours(self._frame, self._pixels, self._format.colorimetry)
        self._encode()

    def _encode(self) -> None:
        """Encode the frame of now."""
        with self._errors():
            self._frame.pts = self._num_frames
            self._frame.time_base = 1 / self._format.fps
            self._container.mux(self._stream.encode(self._frame))
        self._num_frames += 1

    def finish(self) -> int:
        """Flush the encoder and close the file; return the number of frames in it."""
        if self._container is None:
            raise OutputError(f"{self._path}: there are no frames to write")
        with libav_errors(self._path):
            self._container.mux(in_time(self._stream.encode(None)))
            container, self._container = self._container, None
            container.close()
        if self._format.colorimetry.says_light:
            set_light(self._temporary, self._format.colorimetry)
        return self._num_frames

    def close(self) -> None:
        """Let go of the file, also after an error; its content no longer matters."""
        if self._container is not None:
            container, self._container = self._container, None
            with contextlib.suppress(av.error.FFmpegError):
                container.close()

    def _errors(self) -> contextlib.AbstractContextManager[None]:
        """Let errors of the encoder name the file, the codec and the pictures."""
        assert self._like is not None
        return libav_errors(self._path, f"{self._format.codec}, {_describe(*self._like)}")

    def _open(self, picture: Picture | Yuv420) -> None:
        codec, fmt = self._format.codec, self._format
        encoder, options = _ENCODERS[codec]
        if codec is VideoCodec.AV1:
            # The encoder talks on the error stream otherwise; it reads only this variable.
            os.environ.setdefault("SVT_LOG", "0")
        if fmt.is_quick:
            options = options | _QUICK.get(codec, {})
        options = options | _quality_options(fmt, picture) | _codec_parameters(fmt)
        self._pixels = pixels = _pixels_for(picture, fmt)
        self._container = av.open(
            str(self._temporary), "w", format="matroska", options=dict(BITEXACT)
        )
        self._container.metadata[FIRST_FRAME_TAG] = str(self._first_frame)
        self._stream = self._container.add_stream(encoder, rate=fmt.fps, options=options)
        if fmt.layout.packed:
            mode = "left_right" if fmt.layout.side_by_side else "top_bottom"
            self._stream.metadata["stereo_mode"] = mode
        if fmt.colorimetry.says_light:
            self._stream.metadata["title"] = ROOM
        context = self._stream.codec_context
        context.height, context.width = picture.shape[:2]
        context.pix_fmt = pixels.name
        context.time_base = 1 / fmt.fps
        context.thread_count = _threads_for(fmt)
        context.thread_type = "AUTO"
        context.sample_aspect_ratio = sample_aspect(fmt)
        _tag_colours(context, pixels, fmt.colorimetry)
        with _scheduling_kept():
            context.open()


@contextlib.contextmanager
def _scheduling_kept() -> Iterator[None]:
    """Give this thread, and those begun meanwhile, the scheduling policy that it has now.

    SVT-AV1 in a process of root makes the thread that opens it a real-time one of the
    highest priority; its own threads, and all processes begun later, would inherit that
    and starve the machine.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield
        return
    policy, parameters = os.sched_getscheduler(0), os.sched_getparam(0)
    before = _threads()
    try:
        yield
    finally:
        for thread in (0, *(_threads() - before)):
            with contextlib.suppress(ProcessLookupError):  # ended meanwhile
                os.sched_setscheduler(thread, policy, parameters)


def _threads_for(video_format: VideoFormat) -> int:
    """Return how many threads encode; where cores are few, those of a quick one only cost time."""
    if video_format.is_quick and video_format.codec is VideoCodec.H264:
        return max(1, min(ENCODER_THREADS, available_cores() // 2))
    return ENCODER_THREADS


def _threads() -> set[int]:
    """Return the kernel's numbers of the threads of this process."""
    return {int(name) for name in os.listdir("/proc/self/task")}


def _picture(eyes: Eyes | CodedEyes, video_format: VideoFormat) -> Picture | Yuv420:
    """Return what is encoded for one frame, padded where 4:2:0 video needs even sizes."""
    multiple = 1 if video_format.lossless else 2
    layout = video_format.layout
    if isinstance(eyes[0], Yuv420):
        return eyes[0]
    if len(eyes) == 2:
        return np.ascontiguousarray(pack(*eyes, layout, multiple=multiple))
    if layout.packed or layout is StereoLayout.ANAGLYPH:
        raise OutputError(f"layout {layout.value!r} takes two eyes, there is only one")
    return np.ascontiguousarray(pad_to_multiple(eyes[0], multiple, multiple))


def _pixels_for(picture: Picture | Yuv420, video_format: VideoFormat) -> _Pixels:
    source_bits = 8 * picture.dtype.itemsize
    coded_bits = video_format.coded_bits(source_bits)
    if video_format.lossless:
        name = _LOSSLESS_PIXELS[source_bits, len(picture.shape) == 2]
        return _Pixels(name=name, coded_bits=coded_bits, matrix=None)
    name = "yuv420p" if coded_bits == 8 else "yuv420p10le"
    if video_format.codec is VideoCodec.PRORES:
        name = _PRORES_PIXELS
    primaries = video_format.colorimetry.primaries
    matrix = (
        picture.matrix
        if isinstance(picture, Yuv420)
        else matrix_for(picture.shape[0], primaries)
    )  # fmt: skip
    return _Pixels(name=name, coded_bits=coded_bits, matrix=matrix)


def _quality_options(video_format: VideoFormat, picture: Picture | Yuv420) -> dict[str, str]:
    if video_format.lossless:
        # Slices are coded in parallel; a line of single samples cannot be cut.
        return {"slices": "4" if min(picture.shape[:2]) >= MIN_SLICED_SIZE else "1"}
    if video_format.quality is None:
        return {}
    interval = {"g": str(KEYFRAME_INTERVAL)}
    if video_format.is_quick and video_format.codec is VideoCodec.H264:
        # each frame as fine as the others, so that none is looked at before it is coded
        beyond = video_format.coded_bits(8 * picture.dtype.itemsize) - 8
        return interval | {"qp": str(video_format.quality + QP_PER_BIT * beyond)}
    return interval | {"crf": str(video_format.quality)}


def _codec_parameters(video_format: VideoFormat) -> dict[str, str]:
    """Return the options that only one encoder knows.

    Frame packing is signalled by SEI (ITU-T H.264 D.1.26), as is the light of the mastering
    display; in AV1 that is metadata of the stream.
    """
    said = video_format.colorimetry
    if video_format.codec is VideoCodec.AV1:
        parameters = []
        if said.mastering is not None:
            parameters.append(f"mastering-display={_mastering(said.mastering, 1, 1)}")
        if said.light_level is not None:
            parameters.append(f"content-light={said.light_level.pixel},{said.light_level.frame}")
        return {"svtav1-params": ":".join(parameters)} if parameters else {}
    if video_format.codec is VideoCodec.HEVC:
        parameters = [_FIXED_X265, _EXACT_X265]
        if said.is_hdr:
            parameters.append("repeat-headers=1")
        if said.mastering is not None:
            parameters.append(f"master-display={_mastering(said.mastering, 50_000, 10_000)}")
        if said.light_level is not None:
            parameters.append(f"max-cll={said.light_level.pixel},{said.light_level.frame}")
        return {"x265-params": ":".join(parameters)}
    if video_format.codec is not VideoCodec.H264:
        return {}
    parameters = ["b-pyramid=none", _EXACT_X264, *[_QUICK_X264] * video_format.is_quick]
    if video_format.layout.packed:
        parameters.append(f"frame-packing={3 if video_format.layout.side_by_side else 4}")
    if said.mastering is not None:
        parameters.append(f"mastering-display={_mastering(said.mastering, 50_000, 10_000)}")
    if said.light_level is not None:
        parameters.append(f"cll={said.light_level.pixel},{said.light_level.frame}")
    return {"x264-params": ":".join(parameters)}


def _mastering(display: MasteringDisplay, per_one: int, per_nit: int) -> str:
    """Return a display as encoders are told of it, in parts of 1 and of 1 cd/m²."""

    def text(value: Fraction, parts: int) -> str:
        return f"{float(value):.5f}" if parts == 1 else str(round(value * parts))

    points = {"G": display.green, "B": display.blue, "R": display.red, "WP": display.white}
    places = [
        f"{name}({text(x, per_one)},{text(y, per_one)})" for name, (x, y) in points.items()
    ]  # fmt: skip
    light = ",".join(text(value, per_nit) for value in (display.brightest, display.darkest))
    return f"{''.join(places)}L({light})"


def sample_aspect(video_format: VideoFormat) -> Fraction:
    """Return width over height of a sample: squeezed eyes have wide (high) samples."""
    layout, aspect = video_format.layout, video_format.pixel_aspect
    if not layout.half:
        return aspect
    return aspect * 2 if layout.side_by_side else aspect / 2


def _tag_colours(what: Any, pixels: _Pixels, colorimetry: Colorimetry) -> None:
    """Say what the samples of a stream or a frame mean, in the code points of ITU-T H.273.

    Primaries and transfer are those of the pictures that came in, and only the matrix is a
    choice of ours.
    """
    limited, full, rgb, unspecified = 1, 2, 0, 2
    what.color_primaries = colorimetry.primaries
    what.color_trc = colorimetry.transfer
    if pixels.matrix is None:
        what.color_range = full
        what.colorspace = unspecified if pixels.name.startswith("gray") else rgb
    else:
        what.color_range = limited
        what.colorspace = MATRIX_CODES[pixels.matrix]


def _describe(shape: tuple[int, ...], dtype: npt.DTypeLike) -> str:
    return f"{shape[1]}×{shape[0]} {'RGB' if len(shape) == 3 else 'grey'} {np.dtype(dtype)}"


def in_time(packets: Sequence[Any]) -> Sequence[Any]:
    """Return the last packets of an encoder, none of which is decoded after it is shown.

    Where there are fewer frames than x265 keeps back, it leaves their times of decoding as whatever
    its memory held, which no file takes.
    """
    times = [packet.pts for packet in packets]
    is_unset = any(
        packet.dts is not None and not -REORDERED <= packet.dts <= (packet.pts or 0)
        for packet in packets
    )
    if is_unset and None not in times:
        latest = max(times) + 1
        for packet in reversed(packets):
            latest = packet.dts = min(latest - 1, packet.pts)
    return packets


@contextlib.contextmanager
def libav_errors(path: Path, what: str = "") -> Iterator[None]:
    """Turn what PyAV raises while writing ``what`` to ``path`` into our own error."""
    try:
        yield
    except av.error.FFmpegError as error:
        number = abs(error.errno or 0)
        if number == errno.EINVAL:
            said = "the encoder does not take such pictures"
        else:
            said = os.strerror(number) if 0 < number < 1000 else str(error)
        raise output_error(path, OSError(number, f"{said} ({what})" if what else said)) from error
