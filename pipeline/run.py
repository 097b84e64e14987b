"""A whole job: cut into segments, read, super-resolved, written, joined.

::

    reader thread ──► main thread ──► writer thread        one bounded channel each
    source.frames     superresolve     sink.write_segment

A segment depends on nothing but its input frames (and, where frames start warm, a few
frames before it), so that it comes out the same
whether it is computed now, after an interruption or on another machine; finished
segments stay in the work folder until all are joined. The module prints nothing:
it reports events.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.channel import Channel, ChannelClosedError
from pipeline.config import Settings
from pipeline.debug_pictures import write_debug_pictures
from pipeline.errors import ConfigurationError, OutputError, SceneError
from pipeline.events import (
    Event,
    FrameFinished,
    JobFinished,
    JobStarted,
    Joining,
    SegmentFinished,
    Warned,
)
from pipeline.fingerprint import make_fingerprint
from pipeline.frames import MultiViewFrame
from pipeline.job import InputOptions, Job, OutputOptions, Segment, cut_segments
from pipeline.media.files import check_folder_writable, check_writable, write_atomic
from pipeline.media.info import SceneInfo
from pipeline.media.media_sink import MediaSink
from pipeline.media.source import FrameSource, open_scene
from pipeline.psf_curve import PsfCurve
from pipeline.psf_search import search_psf
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.report import depth_origin, make_report, strict_json, to_plain
from pipeline.results import FrameResult
from pipeline.sink import OutputPlan, Sink
from pipeline.stop import StopFlag
from pipeline.superresolve import superresolve
from pipeline.threads import set_threads
from pipeline.worker import Worker
from pipeline.workfolder import WorkFolder, work_folder_of

WARM_UP = 3
"""Frames before a segment that are computed and thrown away where frames start warm, so that
a segment comes out the same wherever it is computed and the picture does not jump there."""

READ_AHEAD = 1
"""Frames that may wait to be super-resolved."""

WRITE_BEHIND = 1
"""Super-resolved frames that may wait to be written."""

JOIN_POLL = 0.2
"""Seconds between two looks at the stop flag while waiting for the writer."""


@dataclass(frozen=True, kw_only=True)
class Tools:
    """The doors a job goes through; others in tests."""

    open_scene: Callable[..., FrameSource] = open_scene
    superresolve: Callable[..., FrameResult] = superresolve
    search_psf: Callable[..., tuple[PsfCurve, ...]] = search_psf
    make_sink: Callable[[OutputPlan], Sink] = MediaSink
    clock: Callable[[], float] = time.perf_counter


@dataclass(frozen=True, kw_only=True)
class RunSummary:
    """What came of a job."""

    written: tuple[Path, ...]
    """Files and folders that now exist."""
    frames: int
    """Frames in them."""
    frames_computed: int
    """Frames computed by this run; the others an earlier one had done."""
    seconds: float
    report: Mapping[str, Any]
    """The content of report.json."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _ReadFrame:
    segment: Segment
    frame: MultiViewFrame
    seconds: float
    begins: bool = False
    """Whether a new chain begins with it."""

    @property
    def is_warm_up(self) -> bool:
        """Whether it is a frame before its segment: computed and thrown away."""
        return self.frame.frame_index < self.segment.start


@dataclass(frozen=True, kw_only=True, eq=False)
class _DoneFrame:
    segment: Segment
    result: FrameResult
    timings: Mapping[str, float]
    depth: Mapping[str, str]


@dataclass(kw_only=True, eq=False)
class _Run:
    """One run of a job: what the threads share."""

    job: Job
    tools: Tools
    stop: StopFlag
    on_event: Callable[[Event], None]
    resume: bool
    psf: GaussianPsf | None = None
    seen_warnings: dict[str, None] = field(default_factory=dict)

    def warn(self, texts: Sequence[str]) -> None:
        for text in texts:
            if text not in self.seen_warnings:
                self.seen_warnings[text] = None
                self.on_event(Warned(text=text))


def run_job(
    job: Job,
    *,
    on_event: Callable[[Event], None] = lambda _: None,
    stop: StopFlag | None = None,
    resume: bool = False,
    tools: Tools | None = None,
) -> RunSummary:
    """Do a job.

    Parameters
    ----------
    job : Job
        What to do.
    on_event : callable
        Told what happens, in the calling thread.
    stop : StopFlag, optional
        Set by somebody to end the work soon; finished segments stay for a resumed run.
    resume : bool
        Go on from segments that an earlier run of the same job finished; otherwise they
        are discarded.
    tools : Tools, optional
        How scenes are opened, frames computed, results written.

    Raises
    ------
    SceneError, ConfigurationError, OutputError
        Of the input, the settings, the output; the latter before any work is done.
    Interrupted
        If the stop flag was set.
    """
    run = _Run(
        job=job,
        tools=tools or Tools(),
        stop=stop or StopFlag(),
        on_event=on_event,
        resume=resume,
    )
    begin = run.tools.clock()
    set_threads(job.settings.threads)
    check_outputs(job)
    options = job.input
    with run.tools.open_scene(
        job.scene,
        input_layout=options.input_layout,
        left=options.left,
        right=options.right,
        views=options.views,
    ) as source:
        run.stop.check()
        info = source.info
        run.job = job = with_magnification(job, info)
        frames = options.frames.within(info.frame_indices)
        plan = make_plan(job, info)
        sink = run.tools.make_sink(plan)
        segments = cut_segments(frames, job.output.segment_length)
        anchor = job.output.output or job.output.frames_dir
        assert anchor is not None  # OutputOptions has seen to it
        fingerprint = make_fingerprint(job, frames, plan.targets)
        with WorkFolder(work_folder_of(anchor), fingerprint, resume=resume) as folder:
            sink.prepare()
            todo = [segment for segment in segments if not _is_there(folder, sink, segment)]
            computed = sum(len(segment) for segment in todo)
            on_event(
                JobStarted(
                    frames_total=len(frames),
                    frames_done=len(frames) - computed,
                    num_views=len(info.view_ids),
                    targets=plan.targets,
                    lr_shape=info.lr_shape,
                    hr_shape=plan.hr_shape,
                )
            )
            run.warn(info.warnings)
            if todo and job.settings.psf == "auto":
                run.psf = _estimated_psf(run, source.read(frames.start))
            _work(run, source, sink, folder, plan.targets, todo, len(frames), len(segments))
            run.stop.check()
            on_event(Joining(segments=len(segments)))
            begin_join = run.tools.clock()
            written = list(sink.join([folder.stem(segment) for segment in segments]))
            end = run.tools.clock()
            facts = {
                "seconds": end - begin,
                "join_seconds": end - begin_join,
                "frames_computed": computed,
                "frames_resumed": len(frames) - computed,
            }
            accounts = [folder.account(segment) or {} for segment in segments]
            report = make_report(job, info, plan, accounts, run=facts)
            if job.output.report is not None:
                write_atomic(job.output.report, strict_json(report).encode())
            folder.remove()
    on_event(JobFinished(seconds=facts["seconds"]))
    written += [path for path in (job.output.report, job.output.debug_dir) if path is not None]
    return RunSummary(
        written=tuple(written),
        frames=len(frames),
        frames_computed=computed,
        seconds=facts["seconds"],
        report=report,
    )


def make_plan(job: Job, info: SceneInfo) -> OutputPlan:
    """Return what is written, now that the scene has said what it is."""
    targets, layout = choose_targets(info, job.input, job.output)
    grid = job.settings.grid
    return OutputPlan(
        options=replace(job.output, layout=layout),
        targets=targets,
        left=info.left,
        right=info.right,
        hr_shape=grid.hr_shape(info.lr_shape),
        fps=info.fps,
        bit_depth=info.bit_depth,
        is_color=info.is_color,
        grid=grid,
    )


def with_magnification(job: Job, info: SceneInfo) -> Job:
    """Return the job with the magnification that halved eyes need, if none was asked for."""
    if not job.magnification_is_default or info.pixel_aspect == 1:
        return job
    magnification = "2x1" if info.pixel_aspect > 1 else "1x2"
    return replace(
        job,
        settings=replace(job.settings, magnification=magnification),
        magnification_is_default=False,
    )


def choose_targets(
    info: SceneInfo, options: InputOptions, output: OutputOptions
) -> tuple[tuple[str, ...], str]:
    """Return the views to super-resolve, left to right, and the layout they are written in.

    An eye whose own view is not observed is not written; the video is then that of one eye.
    """
    observed = set(options.views or info.view_ids)
    if output.layout == "views":
        return tuple(view for view in info.view_ids if view in observed), "views"
    eyes = {"left": info.left, "right": info.right}
    wanted = (output.layout,) if output.layout in eyes else ("left", "right")
    there = tuple(eye for eye in wanted if eyes[eye] in observed)
    if not there:
        missing = " nor ".join(f"{eyes[eye]!r} ({eye})" for eye in wanted)
        neither = "neither " if len(wanted) > 1 else "not "
        raise ConfigurationError(
            f"--views: {neither}{missing} is among them, so there is no eye to write"
        )
    layout = output.layout if len(there) == 2 else there[0]
    return tuple(eyes[eye] for eye in there), layout


def check_outputs(job: Job) -> None:
    """Find out before the work whether the outputs can be written; make the folders asked for.

    Raises
    ------
    OutputError
        If a file or folder cannot be written, or would overwrite the scene.
    """
    output = job.output
    files = [path for path in (output.output, output.report) if path is not None]
    for path in files:
        if path.is_file() and job.scene.exists() and path.samefile(job.scene):
            raise OutputError(f"{path}: would overwrite the scene")
        check_writable(path)
    if len({path.absolute() for path in files}) < len(files):
        raise OutputError(f"{output.output}: is named for the video and for the report")
    for folder in (output.frames_dir, output.debug_dir):
        if folder is not None:
            check_folder_writable(folder)


def _estimated_psf(run: _Run, first: MultiViewFrame) -> GaussianPsf:
    """Return the PSF of the job, estimated on its first frame so that all segments agree."""
    job = run.job
    if job.input.views is not None:
        first = replace(first, views=tuple(first.view(view) for view in job.input.views))
    with run.stop.breakable():
        curve = run.tools.search_psf(first, job.settings)[0]
    if curve.remark:
        run.warn((curve.remark,))
    return GaussianPsf.of(curve.sigma, curve.support)


def _work(
    run: _Run,
    source: FrameSource,
    sink: Sink,
    folder: WorkFolder,
    targets: tuple[str, ...],
    segments: Sequence[Segment],
    num_frames: int,
    num_segments: int,
) -> None:
    """Compute the segments that are missing: reader, super-resolution and writer at once."""
    if not segments:
        return
    to_compute: Channel[_ReadFrame] = Channel(READ_AHEAD)
    to_write: Channel[_DoneFrame] = Channel(WRITE_BEHIND)
    notices: list[Event] = []
    failure: list[BaseException] = []

    def read() -> None:
        try:
            _read(run, source, segments, to_compute)
        except ChannelClosedError:
            pass
        except BaseException as error:  # it belongs to whoever takes the frames
            to_compute.finish(error)
        else:
            to_compute.finish()

    def write() -> None:
        try:
            for segment in segments:
                _write(run, sink, folder, segment, to_write)
                notices.append(SegmentFinished(index=segment.index, count=num_segments))
        except ChannelClosedError:
            pass
        except BaseException as error:  # raised again in the main thread
            failure.append(error)
        finally:
            to_write.close()

    threads = [
        threading.Thread(target=read, name="depthsr-read"),
        threading.Thread(target=write, name="depthsr-write"),
    ]
    for thread in threads:
        thread.start()
    done = num_frames - sum(len(segment) for segment in segments)
    try:
        with contextlib.suppress(ChannelClosedError):  # the writer has failed: see below
            worker = Worker(
                run.job.settings,
                compute=run.tools.superresolve,
                targets=targets,
                observed_views=run.job.input.views,
                keep_intermediates=run.job.output.debug_dir is not None,
                **({} if run.psf is None else {"psf": run.psf}),
            )
            for item in to_compute:
                if item.begins:
                    worker.reset()
                finished = _compute(run, item, worker)
                if item.is_warm_up:
                    continue
                to_write.put(finished)
                done += 1
                run.on_event(
                    FrameFinished(frame_index=item.frame.frame_index, done=done, total=num_frames)
                )
                while notices:
                    run.on_event(notices.pop(0))
            to_write.finish()
        while threads[1].is_alive():
            threads[1].join(JOIN_POLL)
            run.stop.check()
        if failure:
            raise failure[0]
        while notices:
            run.on_event(notices.pop(0))
    finally:
        to_compute.close()
        to_write.close()
        for thread in threads:
            thread.join()


def _read(
    run: _Run, source: FrameSource, segments: Sequence[Segment], to_compute: Channel[_ReadFrame]
) -> None:
    clock = run.tools.clock
    for segment in segments:
        begin = clock()
        first = _first_frame(run.job.settings, segment, source.info)
        expected = first
        for frame in source.frames(first, segment.stop):
            run.stop.check()
            if frame.frame_index != expected:
                raise SceneError(f"frame {expected} is missing", path=run.job.scene)
            expected += 1
            to_compute.put(
                _ReadFrame(
                    segment=segment,
                    frame=frame,
                    seconds=clock() - begin,
                    begins=frame.frame_index == first,
                )
            )
            begin = clock()
        if expected != segment.stop:
            raise SceneError(f"frame {expected} is missing", path=run.job.scene)


def _first_frame(settings: Settings, segment: Segment, info: SceneInfo) -> int:
    """Return the frame a segment's chain begins with: the segment's own, or one to warm up."""
    if settings.temporal == "cold":
        return segment.start
    return max(segment.start - WARM_UP, info.frame_indices.start)


def _compute(run: _Run, item: _ReadFrame, worker: Worker) -> _DoneFrame:
    with run.stop.breakable():
        begin = run.tools.clock()
        result = worker.take(item.frame)
        seconds = run.tools.clock() - begin
    run.warn(result.report.warnings)
    return _DoneFrame(
        segment=item.segment,
        result=result,
        timings={"decode": item.seconds, **result.report.timings, "frame": seconds},
        depth=depth_origin(item.frame),
    )


def _write(
    run: _Run, sink: Sink, folder: WorkFolder, segment: Segment, to_write: Channel[_DoneFrame]
) -> None:
    accounts: list[dict[str, Any]] = []
    debug_dir = run.job.output.debug_dir

    def results() -> Iterator[FrameResult]:
        for _ in range(len(segment)):
            item = to_write.take()
            run.stop.check()
            account = to_plain(item.result.report)
            account |= {"timings": to_plain(item.timings), "depth": to_plain(item.depth)}
            if debug_dir is not None:
                begin = run.tools.clock()
                write_debug_pictures(debug_dir, item.result, run.job.settings.grid)
                account["timings"]["debug pictures"] = run.tools.clock() - begin
            accounts.append(account)
            yield item.result

    timings = sink.write_segment(segment, folder.stem(segment), results())
    folder.finish(
        segment,
        {
            "segment": segment.index,
            "start": segment.start,
            "stop": segment.stop,
            "frames": accounts,
            "timings": timings,
        },
    )


def _is_there(folder: WorkFolder, sink: Sink, segment: Segment) -> bool:
    """Return whether a segment is finished and its files are all there."""
    account = folder.account(segment)
    if account is None or len(account.get("frames", ())) != len(segment):
        return False
    return all(path.is_file() for path in sink.files_of(segment, folder.stem(segment)))
