"""The line of stages that frames go through before they are packed: read, register, reconstruct.

Each stage takes what the one before it yields; :class:`pipeline.segments.LocalEngine` runs them in
threads. One :class:`pipeline.worker.Worker` owns the chain, and its two halves are two stages;
where a rate is held they are one, :func:`hold_rate`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from pipeline.effort import FULL, Effort, depth_looked_at, looked_at
from pipeline.errors import SceneError
from pipeline.frames import MultiViewFrame
from pipeline.job import Job, Segment
from pipeline.media.info import SceneInfo
from pipeline.media.source import FrameSource
from pipeline.realtime import Controller, find_motions, paced
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.report import depth_origin
from pipeline.results import FrameResult
from pipeline.sink import OutputPlan
from pipeline.stop import StopFlag
from pipeline.superresolve import RegisteredFrame
from pipeline.temporal.neighbours import in_windows
from pipeline.temporal.still import MOST_FRAMES
from pipeline.view_at import with_view_between
from pipeline.worker import Worker

WARM_UP = 12
"""Frames before a segment that are computed and thrown away where frames start warm, so that
a segment comes out the same wherever it is computed and the picture does not jump there."""

SWIFT_WARM_UP = 16
"""The same with ``--temporal swift``, which solves less of what stands still in a frame."""

WATCHED = MOST_FRAMES + 1
"""Frames before those that are only looked at, for the mean of what stands still."""


@dataclass(frozen=True, kw_only=True)
class Work:
    """Everything that a segment depends on: whoever has it and the scene can compute one."""

    job: Job
    plan: OutputPlan
    frames: range
    """Source frames of the job; none outside of it is read."""
    num_segments: int
    folder: Path
    """The work folder."""
    psf: GaussianPsf | None = None
    """The estimated PSF, where the settings ask for one."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ReadFrame:
    """A frame that is read, and which chain it belongs to."""

    segment: Segment
    frame: MultiViewFrame
    neighbours: tuple[MultiViewFrame, ...]
    """The frames around it whose pixels are constraints too."""
    seconds: float
    begins: bool
    """Whether a new chain begins with it."""
    first_computed: int
    """The first frame of that chain that is not only looked at, unless the scene begins later."""

    @property
    def is_warm_up(self) -> bool:
        """Whether it is a frame before its segment: computed and thrown away."""
        return self.frame.frame_index < self.segment.start

    @property
    def is_watched(self) -> bool:
        """Whether it is a frame before those: only looked at."""
        return self.frame.frame_index < self.first_computed


@dataclass(frozen=True, kw_only=True, eq=False)
class HalfDoneFrame:
    """A frame whose views are registered."""

    read: ReadFrame
    registered: RegisteredFrame
    seconds: float


@dataclass(frozen=True, kw_only=True, eq=False)
class DoneFrame:
    """A frame that is super-resolved."""

    result: FrameResult
    timings: Mapping[str, float]
    depth: Mapping[str, str]
    realtime: RealtimeRecord | None = None


@dataclass(frozen=True, kw_only=True)
class RealtimeRecord:
    """What was left out of a frame so that the rate was held."""

    dropped: bool
    """Not computed: the frame before it is shown again."""
    rung: str
    """How much went into it, in words."""
    repeated: tuple[str, ...]
    """Views whose picture is that of an earlier frame."""
    late: float
    """Seconds after its time when it was begun."""
    waited: float
    """Seconds that were waited for its views beyond its time."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """The stages before packing; each takes what the one before it yields."""

    work: Work
    worker: Worker
    clock: Callable[[], float]
    stop: StopFlag
    levels: dict[int, int] = field(default_factory=dict)
    """Rung that a frame which is read ahead was read for, from the frame's number."""

    def controller(self, info: SceneInfo) -> Controller:
        """Return what is to hold the rate."""
        return Controller(
            rate=self.work.job.settings.rate or float(info.fps),
            num_views=len(info.view_ids),
            num_eyes=len(self.work.plan.targets),
            has_depth=all(info.has_depth),
            mixes=True,
        )

    def read_for(
        self, source: FrameSource, segments: Sequence[Segment], controller: Controller
    ) -> Iterator[ReadFrame]:
        """Yield the frames of the segments, of each what its rung looks at, and note that rung."""
        window = self.work.job.settings.temporal_window
        targets = self.work.plan.targets
        is_enlarged = self.work.job.settings.chroma == "bicubic"
        colour = self.work.plan.computed if is_enlarged else None
        efforts = [rung.effort for rung in controller.rungs]
        before = FULL

        def frames(wanted: range) -> Iterator[MultiViewFrame]:
            nonlocal before
            for number in wanted:
                level = 0 if window else controller.level_to_read_for
                level = highest_at_hand(source, targets, number, efforts, level, before)
                effort = before = efforts[level]
                self.levels[number] = level
                view_ids = source.info.view_ids
                only = looked_at(effort, view_ids, targets, number)
                depth = depth_looked_at(effort, view_ids, targets)
                is_all = only == depth == view_ids
                yield source.read(number, only=None if is_all else only, depth=depth, colour=colour)

        return self._read(frames, segments)

    def read(self, source: FrameSource, segments: Sequence[Segment]) -> Iterator[ReadFrame]:
        """Yield the frames of the segments, each segment's warm-up before it."""
        return self._read(lambda wanted: source.frames(wanted.start, wanted.stop), segments)

    def _read(
        self, frames_of: Callable[[range], Iterator[MultiViewFrame]], segments: Sequence[Segment]
    ) -> Iterator[ReadFrame]:
        settings, frames = self.work.job.settings, self.work.frames
        window = settings.temporal_window
        for segment in segments:
            begin = self.clock()
            first = first_frame(self.work, segment)
            wanted = range(
                max(first - window, frames.start), min(segment.stop + window, frames.stop)
            )
            for frame, neighbours in in_windows(self._whole(frames_of, wanted), window):
                if not first <= frame.frame_index < segment.stop:
                    continue
                yield ReadFrame(
                    segment=segment, frame=frame, neighbours=neighbours,
                    seconds=self.clock() - begin,
                    begins=frame.frame_index == first
                    and (segment is segments[0] or not settings.realtime),
                    first_computed=segment.start - warm_up(settings.temporal),
                )  # fmt: skip
                begin = self.clock()

    def _whole(
        self, frames_of: Callable[[range], Iterator[MultiViewFrame]], wanted: range
    ) -> Iterator[MultiViewFrame]:
        """Yield the frames wanted; raise SceneError where one is missing."""
        expected = wanted.start
        for frame in frames_of(wanted):
            self.stop.check()
            if frame.frame_index != expected:
                break
            expected += 1
            yield frame
        if expected != wanted.stop:
            raise SceneError(f"frame {expected} is missing", path=self.work.job.scene)

    def take(self, frames: Iterable[ReadFrame]) -> Iterator[DoneFrame]:
        """Do both halves of a frame before the next one is begun, as a swift one needs it."""
        for item in self._computed(frames):
            begin = self.clock()
            result = self.worker.take(item.frame, neighbours=item.neighbours)
            if not item.is_warm_up:
                yield self._done(item, result, begin)

    def register(self, frames: Iterable[ReadFrame]) -> Iterator[HalfDoneFrame]:
        """Do the first half of each frame."""
        for item in self._computed(frames):
            begin = self.clock()
            registered = self.worker.register(item.frame, neighbours=item.neighbours)
            yield HalfDoneFrame(read=item, registered=registered, seconds=self.clock() - begin)

    def reconstruct(self, frames: Iterable[HalfDoneFrame]) -> Iterator[DoneFrame]:
        """Do the second half of each; of those before a segment nothing is left."""
        for item in frames:
            begin = self.clock()
            result = self.worker.reconstruct(item.registered)
            if not item.read.is_warm_up:
                yield self._done(item.read, result, begin, item.seconds)

    def _computed(self, frames: Iterable[ReadFrame]) -> Iterator[ReadFrame]:
        """Yield the frames that are not only looked at; the others the worker is told of."""
        for item in frames:
            if item.begins:
                self.worker.reset()
            if item.is_watched:
                self.worker.watch(item.frame)
            else:
                yield item

    def _done(
        self, read: ReadFrame, result: FrameResult, begin: float, before: float = 0.0
    ) -> DoneFrame:
        """Return a frame that is computed, with the view between its eyes, if one is asked for."""
        plan = self.work.plan
        if plan.between is not None:
            result = with_view_between(
                result, read.frame, plan.between, plan.targets[0], plan.grid
            )  # fmt: skip
        seconds = before + self.clock() - begin
        return DoneFrame(
            result=result,
            timings={"decode": read.seconds, **result.report.timings, "frame": seconds},
            depth=depth_origin(read.frame),
        )


def highest_at_hand(
    source: FrameSource,
    targets: Sequence[str],
    frame_index: int,
    efforts: Sequence[Effort],
    level: int,
    before: Effort,
) -> int:
    """Return the first rung from ``level`` for which a frame has what it takes.

    What a rung does not look at is let go, and not decoded. When it is looked at again it is
    caught up with while frames go on being made without it.

    Parameters
    ----------
    efforts : sequence of Effort
        Of all rungs.
    before : Effort
        With which the frame before was read.
    """
    wanted = efforts[level]
    depths = [set(depth_looked_at(effort, source.info.view_ids, targets)) for effort in efforts]
    had = set(depth_looked_at(before, source.info.view_ids, targets))
    has_depth = source.approach(frame_index, depth=depths[level])
    has_views = not wanted.looks_around or source.approach(frame_index)
    if not (has_views or before.looks_around):
        return next(level for level, effort in enumerate(efforts) if not effort.looks_around)
    if not has_depth:
        return next(lower for lower in range(level, len(efforts)) if depths[lower] <= had)
    return level


def hold_rate(
    line: Line, frames: Iterable[ReadFrame], controller: Controller
) -> Iterator[DoneFrame]:
    """Yield frames as a live stream would have them: see :mod:`pipeline.realtime`.

    One chain goes through all segments. A frame that is dropped shows the last picture again; one
    that was read ahead for a lower rung is made on that.
    """
    targets = line.work.plan.targets
    last: FrameResult | None = None
    work = [0.0]
    for item, choice in paced(
        frames, controller, line.clock, lambda: work[-1],
        lambda item: line.levels.pop(item.frame.frame_index),
        lambda left: find_motions(line.worker, controller, left, line.clock),
    ):  # fmt: skip
        begin = line.clock()
        frame = item.frame
        is_shown_again = choice.drop and last is not None
        rung = choice.rung
        if choice.drop and last is not None:
            report = replace(last.report, frame_index=frame.frame_index, timings={})
            last = replace(last, frame_index=frame.frame_index, report=report, debug={})
        else:
            last = line.worker.take(frame, effort=rung.effort, neighbours=item.neighbours)
            controller.look_at(line.worker)
        work[-1] = line.clock() - begin
        yield DoneFrame(
            result=last,
            timings={
                "decode": item.seconds, **last.report.timings, "frame": work[-1],
            },
            depth=depth_origin(frame) if rung.effort.needs_depth else {},
            realtime=RealtimeRecord(
                dropped=choice.drop,
                rung=str(rung),
                repeated=targets if is_shown_again else (),
                late=max(0.0, choice.late),
                waited=choice.waited,
            ),
        )  # fmt: skip
        if choice.begins_anew:
            line.worker.begin_anew(frame, rung.effort)


def first_frame(work: Work, segment: Segment) -> int:
    """Return the frame a segment's chain begins with: the segment's own, or one before it."""
    settings = work.job.settings
    if settings.temporal == "cold" or settings.realtime:
        return segment.start
    return max(segment.start - warm_up(settings.temporal) - WATCHED, work.frames.start)


def warm_up(temporal: str) -> int:
    """Return how many frames before a segment are computed and thrown away."""
    return {"cold": 0, "swift": SWIFT_WARM_UP}.get(temporal, WARM_UP)
