"""What one job is: a scene, how to read it, the settings, and what to write.

Frozen values only; nothing here touches the disk. As in :mod:`pipeline.config`
every field carries its help text and unit, so that the command line and the
HTTP schema are made from this table.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from pipeline.config import Settings, setting
from pipeline.errors import ConfigurationError

INPUT_LAYOUTS = ("sbs", "half-sbs", "tab", "half-tab")
"""How two eyes may share one input picture."""

SOUNDS = ("copy", "none")
OUTPUT_LAYOUTS = ("sbs", "half-sbs", "tab", "half-tab", "anaglyph", "left", "right", "views")
"""How the eyes may be written."""

CODECS = ("h264", "hevc", "vp9", "av1", "ffv1", "prores")
"""How a video may be compressed."""

SEGMENT_LENGTH = 32
"""Frames of a segment unless said otherwise."""


@dataclass(frozen=True, kw_only=True)
class FrameRange:
    """A half-open range of source frame numbers; None where it is open.

    >>> FrameRange.parse("4:8"), FrameRange.parse(":8").start
    (FrameRange(start=4, stop=8), None)
    """

    start: int | None = None
    stop: int | None = None

    @classmethod
    def parse(cls, text: str) -> FrameRange:
        """Return the range written as ``A:B``, ``A:``, ``:B`` or ``:``."""
        match = re.fullmatch(r"\s*(\d*)\s*:\s*(\d*)\s*", text)
        if match is None:
            raise ConfigurationError(
                f"--frames: {text!r} is not a range of frame numbers like 4:8, 4: or :8"
            )
        start, stop = (int(part) if part else None for part in match.groups())
        if start is not None and stop is not None and start >= stop:
            raise ConfigurationError(f"--frames: {text} holds no frame (half-open: A < B)")
        return cls(start=start, stop=stop)

    def within(self, available: range) -> range:
        """Return the frame numbers meant, all of which must be available."""
        start = available.start if self.start is None else self.start
        stop = available.stop if self.stop is None else self.stop
        if start >= stop or start < available.start or stop > available.stop:
            raise ConfigurationError(
                f"--frames: {'' if self.start is None else self.start}:"
                f"{'' if self.stop is None else self.stop} is not within the scene's frames "
                f"{available.start}:{available.stop}"
            )
        return range(start, stop)


@dataclass(frozen=True, kw_only=True)
class InputOptions:
    """How a scene is read."""

    views: tuple[str, ...] | None = setting(
        None, "views to observe, comma-separated; one is enough (default: all)", unit="view ids"
    )
    left: str | None = setting(None, "view of the left eye (default: the scene's)", unit="view id")
    right: str | None = setting(
        None, "view of the right eye (default: the scene's)", unit="view id"
    )
    frames: FrameRange = setting(
        FrameRange(), "half-open range A:B of source frames; ends may be left open", unit="frames"
    )
    input_layout: str | None = setting(
        None,
        "how the two eyes share the picture of a plain stereo video (default: what it says)",
        choices=INPUT_LAYOUTS,
    )

    def __post_init__(self) -> None:
        if self.input_layout is not None and self.input_layout not in INPUT_LAYOUTS:
            raise ConfigurationError(
                f"--input-layout: {self.input_layout!r} is not one of {', '.join(INPUT_LAYOUTS)}"
            )
        if self.views is not None:
            if not self.views or not all(self.views):
                raise ConfigurationError("--views: names no view, or an empty one")
            doubled = sorted({view for view in self.views if self.views.count(view) > 1})
            if doubled:
                raise ConfigurationError(f"--views: {doubled[0]!r} is named twice")
        if self.left is not None and self.left == self.right:
            raise ConfigurationError(f"--left, --right: both are {self.left!r}")


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """What a job writes, and where."""

    output: Path | None = setting(None, "video file to write; its ending names the container")
    layout: str = setting("sbs", "how the eyes share the picture", choices=OUTPUT_LAYOUTS)
    codec: str | None = setting(
        None, "video codec (default: the container's first)", choices=CODECS
    )
    quality: int | None = setting(
        None, "constant rate factor; smaller is better (default: the codec's)", unit="CRF"
    )
    sound: str = setting(
        "copy", "the sound of the video that is read: as it is, or none", choices=SOUNDS
    )
    frames_dir: Path | None = setting(
        None, "folder for lossless PNG of every frame, left-000000.png and so on"
    )
    report: Path | None = setting(None, "JSON file to write the account of the run to")
    debug_dir: Path | None = setting(None, "folder for pictures of what happened inside")
    view_at: float | None = setting(
        None,
        "render the view between two cameras instead of the eyes: 3.5 lies halfway between the "
        "fourth and the fifth; one picture, --layout has no effect",
        unit="views from 0",
    )
    segment_length: int = setting(
        SEGMENT_LENGTH, "frames computed, kept and resumed as one piece", unit="frames"
    )

    def __post_init__(self) -> None:
        if self.codec is not None and self.codec not in CODECS:
            raise ConfigurationError(f"--codec: {self.codec!r} is not one of {', '.join(CODECS)}")
        if self.sound not in SOUNDS:
            raise ConfigurationError(f"--sound: {self.sound!r} is not one of {', '.join(SOUNDS)}")
        if self.layout not in OUTPUT_LAYOUTS:
            raise ConfigurationError(
                f"--layout: {self.layout!r} is not one of {', '.join(OUTPUT_LAYOUTS)}"
            )
        if not 1 <= self.segment_length <= 100_000:
            raise ConfigurationError(
                f"--segment-length: must be 1 to 100000, not {self.segment_length}"
            )
        if self.view_at is not None and not 0 <= self.view_at <= 1000:
            raise ConfigurationError(f"--view-at: must be 0 to 1000, not {self.view_at:g}")
        if self.output is None and self.frames_dir is None:
            raise ConfigurationError("nothing to write: give -o FILE or --frames-dir FOLDER")


@dataclass(frozen=True, kw_only=True)
class Job:
    """One piece of work: what to read, what to compute, what to write."""

    scene: Path
    settings: Settings = field(default_factory=Settings)
    magnification_is_default: bool = False
    """True where nobody asked for a magnification: halved eyes are then restored to full
    width (2x1) or height (1x2)."""
    input: InputOptions = field(default_factory=InputOptions)
    output: OutputOptions


@dataclass(frozen=True, kw_only=True)
class Segment:
    """Consecutive frames that are computed and kept as one piece; depends on nothing else."""

    index: int
    """0-based."""
    start: int
    """First source frame number."""
    stop: int
    """One past the last source frame number."""

    @property
    def name(self) -> str:
        """The stem of its files in the work folder."""
        return f"segment-{self.index:06d}"

    def __len__(self) -> int:
        return self.stop - self.start


def cut_segments(frames: range, length: int) -> tuple[Segment, ...]:
    """Return the frames cut into segments of that length; the last may be shorter.

    >>> [(s.start, s.stop) for s in cut_segments(range(3, 10), 4)]
    [(3, 7), (7, 10)]
    """
    return tuple(
        Segment(index=index, start=start, stop=min(start + length, frames.stop))
        for index, start in enumerate(range(frames.start, frames.stop, length))
    )


def describe_difference(then: dict[str, object], now: dict[str, object]) -> str:
    """Return the first difference of two flat records in words, or an empty text."""
    for key in sorted(then.keys() | now.keys()):
        if then.get(key) != now.get(key):
            return f"{key} was {then.get(key)}, is {now.get(key)}"
    return ""
