"""Other forms of a finished video: from its lossless master, without computing anything again.

The master is decoded, its eyes are unpacked and written in another layout, codec or container,
or as PNG, in segments that survive an interruption as those of a job do.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from pipeline.errors import OutputError
from pipeline.events import (
    Event,
    FrameFinished,
    JobFinished,
    JobStarted,
    Joining,
    SegmentFinished,
    Warned,
)
from pipeline.job import OutputOptions, Segment, cut_segments
from pipeline.media.colorimetry import Colorimetry
from pipeline.media.decode import VideoReader
from pipeline.media.encode import Eyes, write_segment
from pipeline.media.files import check_folder_writable, check_writable, remove_leftovers
from pipeline.media.info import Sound
from pipeline.media.join import join_segments, takes_sound
from pipeline.media.png import png_path, write_png
from pipeline.media.sound import sound_codec
from pipeline.media.video_format import VideoCodec, VideoFormat, lost_of_hdr
from pipeline.stereo import StereoLayout, unpack
from pipeline.stop import StopFlag
from pipeline.workfolder import WorkFolder, work_folder_of


@dataclass(frozen=True, kw_only=True)
class Master:
    """A lossless video of both eyes side by side, or of one eye."""

    path: Path
    fps: Fraction
    first_frame: int
    """Source frame number of its first picture."""
    layout: StereoLayout
    """``sbs``, ``left`` or ``right``."""
    pixel_aspect: Fraction = Fraction(1)
    """Width over height of a pixel as shown."""


def export(
    master: Master,
    output: OutputOptions,
    *,
    on_event: Callable[[Event], None] = lambda _: None,
    stop: StopFlag | None = None,
) -> int:
    """Write a master in another form; return the number of frames.

    Finished segments of an earlier, interrupted call with the same arguments are kept.

    Raises
    ------
    ConfigurationError
        If the file cannot hold what is asked for.
    OutputError
        If the master has not the eyes for it, or something cannot be written.
    Interrupted
        If the stop flag was set.
    """
    stop = stop or StopFlag()
    layout = StereoLayout(output.layout)
    _check(master, layout)
    if output.output is not None:
        check_writable(output.output)
        remove_leftovers(output.output)
    if output.frames_dir is not None:
        check_folder_writable(output.frames_dir)
    anchor = output.output or output.frames_dir
    assert anchor is not None  # OutputOptions has seen to it
    with contextlib.closing(VideoReader(master.path)) as reader:
        video_format = _video_format(master, output, reader.colorimetry)
        if reader.colorimetry.is_hdr:
            for text in lost_of_hdr(output.output, output.codec, layout):
                on_event(Warned(text=text))
        frames = range(master.first_frame, master.first_frame + reader.num_frames)
        segments = cut_segments(frames, output.segment_length)
        with WorkFolder(work_folder_of(anchor), _fingerprint(output), resume=True) as folder:
            todo = [segment for segment in segments if folder.account(segment) is None]
            done = len(frames) - sum(map(len, todo))
            shape = (reader.height, reader.width)
            on_event(
                JobStarted(
                    frames_total=len(frames), frames_done=done, num_views=0,
                    targets=(), lr_shape=shape, hr_shape=shape,
                )
            )  # fmt: skip

            def eyes_of(segment: Segment) -> Iterator[Eyes]:
                nonlocal done
                for frame in range(segment.start, segment.stop):
                    stop.check()
                    eyes = _eyes(master, layout, reader.stored(frame - frames.start))
                    if output.frames_dir is not None:
                        _write_pictures(output.frames_dir, layout, eyes, frame, reader.colorimetry)
                    yield eyes
                    done += 1
                    on_event(FrameFinished(frame_index=frame, done=done, total=len(frames)))

            for segment in todo:
                if video_format is None:
                    for _ in eyes_of(segment):
                        pass
                else:
                    write_segment(
                        _video(folder, segment), video_format, eyes_of(segment),
                        first_frame=segment.start,
                    )  # fmt: skip
                folder.finish(segment, {"segment": segment.index})
                on_event(SegmentFinished(index=segment.index, count=len(segments)))
            stop.check()
            on_event(Joining(segments=len(segments)))
            if video_format is not None and output.output is not None:
                join_segments(
                    [_video(folder, item) for item in segments], output.output, video_format,
                    _sound(master, len(frames), output, video_format), timecode=reader.timecode,
                )  # fmt: skip
            folder.remove()
    on_event(JobFinished(seconds=0.0))
    return len(frames)


def _video_format(
    master: Master, output: OutputOptions, colorimetry: Colorimetry
) -> VideoFormat | None:
    """Return what kind of video is written, if one is."""
    if output.output is None:
        return None
    return VideoFormat.for_path(
        output.output,
        layout=StereoLayout(output.layout),
        fps=master.fps,
        codec=None if output.codec is None else VideoCodec(output.codec),
        crf=output.quality,
        pixel_aspect=master.pixel_aspect,
        colorimetry=colorimetry,
    )


def _check(master: Master, layout: StereoLayout) -> None:
    if layout is StereoLayout.VIEWS:
        raise OutputError("the master has the two eyes only: layout 'views' needs another job")
    if master.layout is not StereoLayout.SBS and layout is not master.layout:
        raise OutputError(
            f"the master has the {master.layout.value} eye only: layout {layout.value!r} needs both"
        )


def _sound(
    master: Master, num_frames: int, output: OutputOptions, video_format: VideoFormat
) -> Sound | None:
    """Return the master's sound, if the export is to have it and takes it."""
    if output.sound == "none" or sound_codec(master.path) is None:
        return None
    if not takes_sound(video_format.container, master.path):
        return None
    return Sound(path=master.path, begin=Fraction(0), end=num_frames / master.fps)


def _fingerprint(output: OutputOptions) -> Mapping[str, Any]:
    return {
        "export": output.layout,
        "codec": output.codec,
        "quality": output.quality,
        "segment_length": output.segment_length,
        "frames": output.frames_dir is not None,
    }


def _video(folder: WorkFolder, segment: Segment) -> Path:
    stem = folder.stem(segment)
    return stem.with_name(f"{stem.name}.mkv")


def _eyes(master: Master, layout: StereoLayout, picture: Any) -> Eyes:
    if master.layout is not StereoLayout.SBS:
        return (picture,)
    left, right = unpack(picture, StereoLayout.SBS)
    if layout in (StereoLayout.LEFT, StereoLayout.RIGHT):
        return (left if layout is StereoLayout.LEFT else right,)
    return left, right


def _write_pictures(
    folder: Path, layout: StereoLayout, eyes: Eyes, frame: int, colorimetry: Colorimetry
) -> None:
    names = ("left", "right") if len(eyes) == 2 else (layout.value,)
    for name, picture in zip(names, eyes, strict=True):
        write_png(png_path(folder, name, frame), picture, colorimetry)
