"""Segments computed: decoded, registered, reconstructed, packed and encoded, all at once.

::

    read ──► register ──► reconstruct ──► pack ──► encode
    thread   thread       thread          thread   the caller's thread

Between two stages one frame waits at most, so that the slowest of them paces all, results
stay in order, and memory does not grow with the length. A stage that fails or a stop ends
all of them. What the stages before packing do is :mod:`pipeline.line`.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol, TypeVar

from pipeline.background import giving_way
from pipeline.channel import Ahead
from pipeline.debug_pictures import write_debug_pictures
from pipeline.events import Event, SegmentFinished, Warned
from pipeline.job import Job, Segment
from pipeline.line import DoneFrame, Line, Work, hold_rate
from pipeline.media.media_sink import MediaSink
from pipeline.media.source import FrameSource, open_scene
from pipeline.rehearsal import as_far_as_it_goes, rehearse
from pipeline.report import to_plain, unknown_depth
from pipeline.results import FrameResult
from pipeline.sink import OutputPlan, Sink
from pipeline.stop import StopFlag
from pipeline.threads import set_threads, thread_count
from pipeline.worker import Worker
from pipeline.workfolder import SegmentFiles

Item = TypeVar("Item")


@dataclass(frozen=True, kw_only=True)
class FrameComputed(Event):
    """A frame of a segment is super-resolved; a segment that is tried again says so again."""

    frame_index: int
    """Source frame number."""


@dataclass(frozen=True, kw_only=True)
class SegmentTools:
    """The doors that segments go through; others in tests."""

    open_scene: Callable[..., FrameSource] = open_scene
    make_worker: Callable[..., Worker] = Worker
    make_sink: Callable[[OutputPlan], Sink] = MediaSink
    clock: Callable[[], float] = time.perf_counter


class Engine(Protocol):
    """What computes segments."""

    def compute(
        self,
        work: Work,
        segments: Sequence[Segment],
        *,
        on_event: Callable[[Event], None],
        stop: StopFlag,
    ) -> None:
        """Compute the segments into the work folder, each whole or not at all.

        Parameters
        ----------
        on_event : callable
            Told of frames and segments finished and of warnings, in the calling thread.

        Raises
        ------
        Interrupted
            If the stop flag was set; finished segments stay.
        PipelineError
            The first error met; finished segments stay.
        """


class LocalEngine:
    """Computes segments in this process, one after another.

    Parameters
    ----------
    source : FrameSource
        The scene, open.
    sink : Sink
        Where results go.
    tools : SegmentTools, optional
    """

    def __init__(self, source: FrameSource, sink: Sink, tools: SegmentTools | None = None) -> None:
        self._source = source
        self._sink = sink
        self._tools = tools or SegmentTools()

    def compute(
        self,
        work: Work,
        segments: Sequence[Segment],
        *,
        on_event: Callable[[Event], None],
        stop: StopFlag,
    ) -> None:
        """Compute the segments; see :class:`Engine`."""
        set_threads(work.job.settings.threads)
        failed = threading.Event()
        worker = self._tools.make_worker(
            work.job.settings,
            stop=lambda: stop.is_set or failed.is_set(),
            targets=work.plan.computed,
            observed_views=work.job.input.views,
            keep_intermediates=work.job.output.debug_dir is not None
            or work.plan.between is not None,
            **({} if work.psf is None else {"psf": work.psf}),
        )
        line = Line(work=work, worker=worker, clock=self._tools.clock, stop=stop)
        with ExitStack() as stages:

            def stage(
                items: Iterable[Item], name: str, *, gives_way: bool = False
            ) -> Iterator[Item]:
                ahead = Ahead(items, name=f"depthsr-{name}", gives_way=gives_way)
                return stages.enter_context(closing(ahead))

            if work.job.settings.realtime:
                controller = line.controller(self._source.info)
                with as_far_as_it_goes():
                    rehearse(
                        work.job.settings, [rung.effort for rung in controller.rungs],
                        num_views=controller.num_views, num_eyes=controller.num_eyes,
                        has_depth=any(self._source.info.has_depth), stop=lambda: stop.is_set,
                    )  # fmt: skip
                frames = stage(
                    line.read_for(self._source, segments, controller), "read", gives_way=True
                )
                done = stage(hold_rate(line, frames, controller), "hold-rate")
            else:
                frames = stage(line.read(self._source, segments), "read")
                if work.job.settings.temporal == "swift":
                    done = stage(line.take(frames), "take")
                else:
                    registered = line.register(frames)
                    if thread_count() > 1:
                        registered = stage(registered, "register")
                    done = stage(line.reconstruct(registered), "reconstruct")
            try:
                for segment in segments:
                    self._write(work, segment, done, on_event, stop)
                    on_event(SegmentFinished(index=segment.index, count=work.num_segments))
            except BaseException:
                failed.set()  # so that no stage goes on with its frame
                stop.check()  # what a stop made fail is the stop
                raise

    def _write(
        self,
        work: Work,
        segment: Segment,
        done: Iterator[DoneFrame],
        on_event: Callable[[Event], None],
        stop: StopFlag,
    ) -> None:
        """Write one segment; its account comes last and makes it count."""
        accounts: list[dict[str, Any]] = []
        debug_dir = work.job.output.debug_dir
        clock = self._tools.clock

        def results() -> Iterator[FrameResult]:
            for _ in range(len(segment)):
                item = next(done)
                account = to_plain(item.result.report)
                warnings = (
                    *item.result.report.warnings,
                    *unknown_depth(self._source.info, item.depth),
                )
                account |= {
                    "timings": to_plain(item.timings),
                    "depth": to_plain(item.depth),
                    "warnings": to_plain(warnings),
                }
                if debug_dir is not None:
                    begin = clock()
                    write_debug_pictures(
                        debug_dir, item.result, work.job.settings.grid, check=stop.check
                    )
                    account["timings"]["debug pictures"] = clock() - begin
                if item.realtime is not None:
                    account["realtime"] = to_plain(item.realtime)
                accounts.append(account)
                for text in warnings:
                    on_event(Warned(text=text))
                on_event(FrameComputed(frame_index=item.result.frame_index))
                yield item.result

        files = SegmentFiles(work.folder)
        timings = self._sink.write_segment(segment, files.stem(segment), results())
        stop.check()  # nobody may want it any more
        files.finish(
            segment,
            {
                "segment": segment.index,
                "start": segment.start,
                "stop": segment.stop,
                "frames": accounts,
                "timings": timings,
            },
        )


def open_source(job: Job, open_scene: Callable[..., FrameSource] = open_scene) -> FrameSource:
    """Return the scene of a job, open; where a rate is held, its decoders' threads give way."""
    options = job.input
    opened = partial(
        open_scene, job.scene, input_layout=options.input_layout, left=options.left,
        right=options.right, views=options.views,
    )  # fmt: skip
    return giving_way(opened) if job.settings.realtime else opened()


def is_finished(files: SegmentFiles, sink: Sink, segment: Segment) -> bool:
    """Return whether a segment is finished and its files are all there."""
    account = files.account(segment)
    if account is None or len(account.get("frames", ())) != len(segment):
        return False
    return all(path.is_file() for path in sink.files_of(segment, files.stem(segment)))
