"""Segments joined into one video: their packets copied into the container asked for.

Nothing is encoded again. Muxers write no dates, ids or versions of the moment, so that a job ends
with the same bytes wherever its segments were made.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av

from pipeline.errors import OutputError
from pipeline.media.encode import BITEXACT, FIRST_FRAME_TAG, libav_errors, sample_aspect
from pipeline.media.files import atomic_path
from pipeline.media.info import Sound
from pipeline.media.isobmff import HANDLER, set_packing
from pipeline.media.matroska import set_eye_shape
from pipeline.media.sound import SoundCopy, holds_sound
from pipeline.media.video_format import Container, VideoCodec, VideoFormat

REORDER_DELAY = {VideoCodec.H264: 1, VideoCodec.HEVC: 1}
"""Frames by which decoding runs ahead of showing: B-frames that nothing refers to."""

_MUXERS: dict[Container, tuple[str, dict[str, str]]] = {
    Container.MKV: ("matroska", {}),
    Container.WEBM: ("webm", {}),
    # The stereo box counts as unofficial; without faststart a browser fetches the end first.
    Container.MP4: ("mp4", {"movflags": "+faststart", "strict": "unofficial"}),
    Container.MOV: ("mov", {"movflags": "+faststart", "strict": "unofficial"}),
}

_EYE_SHAPED = (Container.MKV, Container.WEBM)
"""Containers that say the shape of one eye, not of the picture."""

_APPLE_TAG = "hvc1"
"""The name of HEVC in MP4 and MOV by which Apple's players know it."""


def takes_sound(container: Container, path: Path) -> bool:
    """Tell whether a kind of file takes the sound of a video file as it is."""
    muxer, options = _MUXERS[container]
    # what moves the index to the front asks for a file on disk
    return holds_sound(muxer, {key: options[key] for key in options if key != "movflags"}, path)


def join_segments(
    segments: Sequence[Path], out: Path, video_format: VideoFormat, sound: Sound | None = None,
    *, timecode: str | None = None,
) -> int:  # fmt: skip
    """Copy the packets of segments into one video; return its number of frames.

    Nothing is encoded again. The video starts at time 0; frame n is shown at
    n / fps exactly in MP4, to the nearest millisecond in Matroska and WebM.

    Parameters
    ----------
    segments : sequence of Path
        Written with the same ``video_format``, in order, one beginning where
        the one before ends.
    out : Path
        Written whole or not at all; an existing file is replaced.
    video_format : VideoFormat
    sound : Sound, optional
        Copied along; of a kind that the container takes, see :func:`takes_sound`.
    timecode : str, optional
        Of the first frame, as :mod:`timecode` has them; WebM has no place for it.

    Raises
    ------
    OutputError
        If a segment is missing, damaged, out of order or of another kind, the sound cannot be
        read, or the video cannot be written.
    """
    if not segments:
        raise OutputError(f"{out}: there are no segments to join")
    muxer, options = _MUXERS[video_format.container]
    layout = video_format.layout
    is_packed_apple = layout.packed and video_format.container not in _EYE_SHAPED
    with atomic_path(out) as temporary:
        with contextlib.ExitStack() as stack:
            first = stack.enter_context(_open_segment(segments[0]))
            with libav_errors(out):
                output = stack.enter_context(_closing(
                    out, av.open(str(temporary), "w", format=muxer, options=BITEXACT | options)
                ))  # fmt: skip
                stream = output.add_stream_from_template(first.streams.video[0], opaque=True)
                stream.time_base = 1 / video_format.fps
                stream.codec_context.framerate = video_format.fps
                stream.codec_context.sample_aspect_ratio = sample_aspect(video_format)
                if (
                    video_format.codec is VideoCodec.HEVC
                    and video_format.container is not Container.MKV
                ):
                    stream.codec_context.codec_tag = _APPLE_TAG
                if timecode is not None and video_format.container is not Container.WEBM:
                    stream.metadata["timecode"] = timecode
                if is_packed_apple:
                    stream.metadata["handler_name"] = HANDLER
                track = None if sound is None else stack.enter_context(SoundCopy(sound, output))
            joiner = _Joiner(out, output, stream, video_format, track)
            for path in segments:
                joiner.append(path)
            joiner.finish()
        if is_packed_apple:
            set_packing(temporary, side_by_side=layout.side_by_side)
        is_oblong = layout.half or video_format.pixel_aspect != 1
        if layout.packed and is_oblong and video_format.container in _EYE_SHAPED:
            eyes_across = 1 if layout.half else 2 if layout.side_by_side else Fraction(1, 2)
            set_eye_shape(temporary, video_format.pixel_aspect / eyes_across)
        return joiner.num_frames


class _Joiner:
    """Appends segments to a container and keeps count of the time."""

    def __init__(
        self, out: Path, output: Any, stream: Any, video_format: VideoFormat,
        sound: SoundCopy | None,
    ) -> None:  # fmt: skip
        self._out = out
        self._output = output
        self._stream = stream
        self._sound = sound
        self._format = video_format
        self._delay = REORDER_DELAY.get(video_format.codec, 0)
        self._kind: tuple | None = None
        self._next_frame: int | None = None
        self.num_frames = 0

    def append(self, path: Path) -> None:
        with _open_segment(path) as container:
            self._check(path, container)
            offset = self.num_frames
            for number, packet in _packets(path, container, self._format.fps):
                packet.stream = self._stream
                packet.time_base = 1 / self._format.fps
                packet.pts = offset + number
                packet.dts = self.num_frames - self._delay
                packet.duration = 1
                with libav_errors(self._out):
                    self._output.mux(packet)
                self.num_frames += 1
                if self._sound is not None:
                    with libav_errors(self._out):
                        self._sound.up_to(self.num_frames / self._format.fps)
        assert self._next_frame is not None
        self._next_frame += self.num_frames - offset

    def finish(self) -> None:
        """Append what is left of the sound."""
        if self._sound is not None:
            with libav_errors(self._out):
                self._sound.to_end()

    def _check(self, path: Path, container: Any) -> None:
        stream = container.streams.video[0]
        context = stream.codec_context
        kind = (context.name, context.width, context.height, context.pix_fmt, context.extradata)
        if self._kind is not None and kind != self._kind:
            raise OutputError(f"{path}: this segment is of another kind than those before it")
        self._kind = kind
        first_frame = _first_frame(path, container)
        if self._next_frame is not None and first_frame != self._next_frame:
            raise OutputError(
                f"{path}: starts with frame {first_frame}, "
                f"but the segment before it ends with frame {self._next_frame - 1}"
            )
        self._next_frame = first_frame


def _open_segment(path: Path) -> Any:
    try:
        container = av.open(str(path), format="matroska")
    except av.error.FFmpegError as error:
        raise _damaged(path) from error
    if not container.streams.video:
        container.close()
        raise _damaged(path)
    return container


def _packets(path: Path, container: Any, fps: Fraction) -> Iterator[tuple[int, Any]]:
    """Yield every packet, in decoding order, with the number of the frame it holds.

    Matroska keeps no decoding times, and showing times to the millisecond; the
    frame number is what those come from.
    """
    seen: set[int] = set()
    count = 0
    try:
        for packet in container.demux(container.streams.video[0]):
            if not packet.size:
                continue
            number = round(packet.pts * packet.time_base * fps)
            seen.add(number)
            count += 1
            yield number, packet
    except av.error.FFmpegError as error:
        raise _damaged(path) from error
    if not count or seen != set(range(count)):
        raise _damaged(path)


def _first_frame(path: Path, container: Any) -> int:
    try:
        return int(container.metadata[FIRST_FRAME_TAG])
    except (KeyError, ValueError) as error:
        raise _damaged(path) from error


def _damaged(path: Path) -> OutputError:
    return OutputError(f"{path}: this segment is missing or damaged; remove it and make it again")


@contextlib.contextmanager
def _closing(path: Path, container: Any) -> Iterator[Any]:
    """Close the container at the end; after an error, without minding another one."""
    try:
        yield container
    except BaseException:
        with contextlib.suppress(av.error.FFmpegError):
            container.close()
        raise
    with libav_errors(path):
        container.close()
