"""What people watch while a job runs: both eyes in full, and what they are compared with.

Two tracks of H.264 (:mod:`service.live.track`): ``result``, and ``before``, which has the
observed left and right views as they are; a page enlarges them bicubically. Whatever layout
and codec the job writes, these are side by side, 8 bits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2

from pipeline.colour import to_grey, to_rgb
from pipeline.frames import ChromaImage, GreyImage
from pipeline.job import InputOptions, Segment
from pipeline.media.source import FrameSource
from pipeline.results import FrameResult
from pipeline.sink import OutputPlan
from pipeline.stereo import Picture, StereoLayout, pack
from service.live.track import Track, TrackInfo, TrackWriter, piece_name

TRACKS = ("result", "before")
"""By the names of their folders."""

CRF = {"result": 18, "before": 12}
"""What is enlarged needs more bits."""

MAX_WIDTH = 4096
"""Widest picture that most decoders take, pixels."""

OnPiece = Callable[[str, int], None]
"""Told the track and the number of a piece."""


def untold(track: str, number: int) -> None:
    """Tell nobody of a piece; can be sent to other machines."""


class FoundPieces:
    """Tells of pieces that others write into the folder of the tracks, in their order."""

    def __init__(self, folder: Path, on_piece: OnPiece) -> None:
        self._folder, self._on_piece = folder, on_piece
        self._told = {track: len(Track(folder / track).pieces()) for track in TRACKS}

    def look(self) -> None:
        """Tell of those that have come, up to the first that is missing."""
        for track in TRACKS:
            for piece in Track(self._folder / track).pieces()[self._told[track] :]:
                self._on_piece(track, piece.number)
                self._told[track] += 1


def watched_eyes(plan: OutputPlan) -> tuple[str, ...]:
    """Return the views shown: left and right where both are written, else one."""
    eyes = tuple(view for view in (plan.left, plan.right) if view in plan.targets)
    return eyes or plan.targets[:1]


@dataclass(frozen=True, kw_only=True)
class EyeSources:
    """Opens the observed views of a scene, one by one, so that no depth is looked for."""

    open_scene: Callable[..., FrameSource]
    scene: Path
    options: InputOptions

    def open(self, view_id: str) -> FrameSource:
        """Return a source of that view alone."""
        return self.open_scene(
            self.scene,
            input_layout=self.options.input_layout,
            left=self.options.left,
            right=self.options.right,
            views=(view_id,),
        )


class WatchSink:
    """Writes the tracks: see :class:`pipeline.sink.Sink`.

    Parameters
    ----------
    plan : OutputPlan
        What the job writes.
    folder : Path
        Of the tracks.
    sources : EyeSources
        Where the observed views come from.
    on_piece : callable
        Told of every piece that can be watched.
    """

    def __init__(
        self,
        plan: OutputPlan,
        folder: Path,
        sources: EyeSources,
        on_piece: OnPiece = untold,
    ) -> None:
        self._plan = plan
        self._folder = folder
        self._sources = sources
        self._on_piece = on_piece
        self._eyes = watched_eyes(plan)
        self._group = max(1, int(plan.fps))

    def prepare(self) -> None:
        """Clear away what killed runs left."""
        for track in TRACKS:
            for path in (self._folder / track).glob(".*.tmp"):
                path.unlink(missing_ok=True)

    def write_segment(
        self, segment: Segment, stem: Path, results: Iterable[FrameResult]
    ) -> dict[str, float]:
        """Write the pieces of a segment; what it costs is not told apart."""
        with ExitStack() as stack:
            sources = {
                view: stack.enter_context(closing(self._sources.open(view))) for view in self._eyes
            }
            writers: dict[str, TrackWriter] = {}
            for result in results:
                pictures = {
                    "result": self._picture(
                        (result.images[view].luma, result.images[view].chroma)
                        for view in self._eyes
                    ),
                    "before": self._picture(_observed(sources, self._eyes, result.frame_index)),
                }
                for track, (picture, shape) in pictures.items():
                    if track not in writers:
                        writers[track] = self._writer(track, shape, segment)
                        stack.callback(writers[track].close)
                    writers[track].add(picture)
            for writer in writers.values():
                writer.finish()
        return {}

    def files_of(self, segment: Segment, stem: Path) -> Sequence[Path]:
        """Return the files that :meth:`write_segment` leaves."""
        first = self._first_piece(segment)
        files = []
        for track in TRACKS:
            for begin in range(0, len(segment), self._group):
                number = first + begin // self._group
                num_frames = min(self._group, len(segment) - begin)
                files.append(self._folder / track / piece_name(number, num_frames))
        return files

    def join(self, stems: Sequence[Path]) -> Sequence[Path]:
        """Nothing to put together: a player does."""
        return []

    def _first_piece(self, segment: Segment) -> int:
        return segment.index * math.ceil(self._plan.options.segment_length / self._group)

    def _writer(self, track: str, shape: tuple[int, int], segment: Segment) -> TrackWriter:
        place = segment.index * self._plan.options.segment_length
        both = len(self._eyes) == 2
        alone = StereoLayout.RIGHT if self._eyes[0] == self._plan.right else StereoLayout.LEFT
        grid, aspect = self._plan.grid, self._plan.pixel_aspect
        if track == "before":
            aspect *= Fraction(grid.magnification_x, grid.magnification_y)
        info = TrackInfo(
            fps=f"{self._plan.fps.numerator}/{self._plan.fps.denominator}",
            layout=StereoLayout.SBS if both else alone,
            eye_height=shape[0],
            eye_width=shape[1],
            first_frame=segment.start - place,
            pixel_aspect=str(aspect),
            primaries=self._plan.colorimetry.primaries,
            transfer=self._plan.colorimetry.transfer,
        )
        return TrackWriter(
            self._folder / track,
            info,
            number=self._first_piece(segment),
            frame=place,
            crf=CRF[track],
            on_piece=lambda number: self._on_piece(track, number),
        )

    def _picture(
        self, eyes: Iterable[tuple[GreyImage, ChromaImage | None]]
    ) -> tuple[Picture, tuple[int, int]]:
        """Return the packed picture, and the (height, width) of an eye in it."""
        pictures = [
            _shrunk(
                to_grey(luma, 8) if chroma is None else to_rgb(luma, chroma, 8), len(self._eyes)
            )
            for luma, chroma in eyes
        ]
        shape = pictures[0].shape[:2]
        layout = StereoLayout.SBS if len(pictures) == 2 else StereoLayout.LEFT
        return pack(pictures[0], pictures[-1], layout, multiple=2), (shape[0], shape[1])


def _observed(
    sources: Mapping[str, FrameSource], eyes: Sequence[str], frame_index: int
) -> Iterator[tuple[GreyImage, ChromaImage | None]]:
    for view_id in eyes:
        view = sources[view_id].read(frame_index).view(view_id)
        yield view.luma, view.chroma


def _shrunk(picture: Picture, num_eyes: int) -> Picture:
    """Return the eye small enough for decoders, by area averaging."""
    height, width = picture.shape[:2]
    factor = MAX_WIDTH // num_eyes / width
    if factor >= 1:
        return picture
    size = (MAX_WIDTH // num_eyes, round(height * factor))
    return cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
