"""Where super-resolved frames go: segments of video, pictures, and the finished file.

:class:`Sink` is the door; :class:`pipeline.media.media_sink.MediaSink` writes files,
:class:`MemorySink` is its twin for tests and for callers who want arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Protocol

from pipeline.frames import Place
from pipeline.grid import Grid
from pipeline.job import OutputOptions, Segment
from pipeline.media.colorimetry import Colorimetry
from pipeline.media.info import Sound
from pipeline.results import FrameResult


@dataclass(frozen=True, kw_only=True)
class OutputPlan:
    """What a job writes, with what the scene has said."""

    options: OutputOptions
    """With the layout that is really written: one eye where the other is not observed."""
    targets: tuple[str, ...]
    """Ids of the views written, left to right."""
    left: str
    right: str
    hr_shape: tuple[int, int]
    """(height, width) of one eye."""
    fps: Fraction
    """Frames a second."""
    bit_depth: int
    """Of the input: 8, 10 or 16."""
    is_color: bool
    grid: Grid
    """The HR grid of the targets."""
    pixel_aspect: Fraction = Fraction(1)
    """Width over height of a pixel of the targets."""
    between: Place | None = None
    """Where the one target lies, if it is a view between two cameras."""
    is_realtime: bool = False
    """Whether it is written at the pace of a live stream."""
    colorimetry: Colorimetry = field(default_factory=Colorimetry)
    """What is said of the pictures' RGB."""
    timecode: str | None = None
    """Of the first frame that is written."""
    sound: Sound | None = None
    """What goes along with the pictures, into files of a kind that takes it."""
    warnings: tuple[str, ...] = ()
    """What of it cannot be as one would expect, a sentence each."""

    @property
    def computed(self) -> tuple[str, ...]:
        """Ids of the views that are super-resolved: the targets, or what theirs lies between."""
        if self.between is None:
            return self.targets
        return self.between.left, self.between.right

    @property
    def picture_names(self) -> dict[str, str]:
        """The first part of the PNG names by view id: left and right, or the ids themselves."""
        if self.options.layout == "views" or self.between is not None:
            return {view_id: view_id for view_id in self.targets}
        eyes = {self.left: "left", self.right: "right"}
        return {view_id: eyes[view_id] for view_id in self.targets}


class Sink(Protocol):
    """The way out of a job."""

    def prepare(self) -> None:
        """Find out whether everything can be written, and clear away what killed runs left."""

    def write_segment(
        self, segment: Segment, stem: Path, results: Iterable[FrameResult]
    ) -> dict[str, float]:
        """Write the frames of a segment; return the seconds by stage.

        Video files get the stem's name with an ending. They come into being whole or not at
        all, also if the frames end in an error, which passes unchanged.
        """

    def files_of(self, segment: Segment, stem: Path) -> Sequence[Path]:
        """Return the files that :meth:`write_segment` leaves."""

    def join(self, stems: Sequence[Path]) -> Sequence[Path]:
        """Put the segments together, whole or not at all; return all files and folders written."""


class MemorySink:
    """Keeps everything in memory; the "video" files hold the frame numbers as text."""

    def __init__(self, plan: OutputPlan) -> None:
        self.plan = plan
        self.results: list[FrameResult] = []

    def prepare(self) -> None:
        """Nothing can go wrong."""

    def write_segment(
        self, segment: Segment, stem: Path, results: Iterable[FrameResult]
    ) -> dict[str, float]:
        """Keep the frames and write their numbers."""
        kept = list(results)
        self.results += kept
        (video,) = self.files_of(segment, stem)
        video.write_text("".join(f"{result.frame_index}\n" for result in kept))
        return {"encode": 0.0}

    def files_of(self, segment: Segment, stem: Path) -> Sequence[Path]:
        """Return the file of numbers."""
        return [stem.with_suffix(".txt")]

    def join(self, stems: Sequence[Path]) -> Sequence[Path]:
        """Write all numbers into one file."""
        output = self.plan.options.output
        assert output is not None
        half = output.with_name(f"{output.name}.tmp")
        half.write_text("".join(stem.with_suffix(".txt").read_text() for stem in stems))
        half.replace(output)
        return [output]
