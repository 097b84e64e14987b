"""A whole job: planned, cut into segments, computed by an engine, joined, accounted for.

A segment depends on nothing but its input frames (and, where frames start warm, a few
frames before it), so that it comes out the same whether it is computed now, after an
interruption or on another machine; finished segments stay in the work folder until all
are joined. The module prints nothing: it reports events.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pipeline.events import Event, FrameFinished, JobFinished, JobStarted, Joining, Warned
from pipeline.fingerprint import make_fingerprint
from pipeline.frames import MultiViewFrame
from pipeline.job import Job, cut_segments
from pipeline.line import Work
from pipeline.media.files import write_atomic
from pipeline.plan import check_outputs, check_scene_kept, files_of, make_plan, with_magnification
from pipeline.psf_curve import PsfCurve
from pipeline.psf_search import search_psf
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.report import make_report, strict_json
from pipeline.segments import (
    Engine,
    FrameComputed,
    LocalEngine,
    SegmentTools,
    is_finished,
    open_source,
)
from pipeline.stop import StopFlag
from pipeline.threads import set_threads
from pipeline.workfolder import WorkFolder, work_folder_of


@dataclass(frozen=True, kw_only=True)
class Tools(SegmentTools):
    """The doors a job goes through; others in tests."""

    search_psf: Callable[..., tuple[PsfCurve, ...]] = search_psf


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


@dataclass(kw_only=True, eq=False)
class _Listener:
    """Passes events on: each warning once, and frames with the number of those before them."""

    on_event: Callable[[Event], None]
    done: set[int] = field(default_factory=set)
    """Source frame numbers."""
    total: int = 0
    warnings: set[str] = field(default_factory=set)

    def __call__(self, event: Event) -> None:
        if isinstance(event, Warned):
            if event.text in self.warnings:
                return
            self.warnings.add(event.text)
        elif isinstance(event, FrameComputed):
            self.done.add(event.frame_index)
            event = FrameFinished(
                frame_index=event.frame_index, done=len(self.done), total=self.total
            )
        self.on_event(event)


def run_job(
    job: Job,
    *,
    on_event: Callable[[Event], None] = lambda _: None,
    stop: StopFlag | None = None,
    resume: bool = False,
    engine: Engine | None = None,
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
    engine : Engine, optional
        What computes the segments; default: this process.
    tools : Tools, optional
        How scenes are opened, frames computed, results written.

    Raises
    ------
    SceneError, ConfigurationError, OutputError
        Of the input, the settings, the output; the latter before any work is done.
    Interrupted
        If the stop flag was set.
    """
    tools = tools or Tools()
    stop = stop or StopFlag()
    tell = _Listener(on_event=on_event)
    begin = tools.clock()
    set_threads(job.settings.threads)
    check_outputs(job)
    with open_source(job, tools.open_scene) as source:
        stop.check()
        info = source.info
        job = with_magnification(job, info)
        frames = job.input.frames.within(info.frame_indices)
        plan = make_plan(job, info)
        check_scene_kept(source, files_of(plan, frames))
        sink = tools.make_sink(plan)
        segments = cut_segments(frames, job.output.segment_length)
        anchor = job.output.output or job.output.frames_dir
        assert anchor is not None  # OutputOptions has seen to it
        fingerprint = make_fingerprint(job, frames, plan.targets)
        with WorkFolder(work_folder_of(anchor), fingerprint, resume=resume) as folder:
            sink.prepare()
            todo = [segment for segment in segments if not is_finished(folder, sink, segment)]
            computed = sum(len(segment) for segment in todo)
            tell.total = len(frames)
            for segment in segments:
                if segment not in todo:
                    tell.done.update(range(segment.start, segment.stop))
            tell(
                JobStarted(
                    frames_total=len(frames),
                    frames_done=len(tell.done),
                    num_views=len(info.view_ids),
                    targets=plan.targets,
                    lr_shape=info.lr_shape,
                    hr_shape=plan.hr_shape,
                )
            )
            for text in (*info.warnings, *plan.warnings):
                tell(Warned(text=text))
            if todo:
                work = Work(
                    job=job,
                    plan=plan,
                    frames=frames,
                    num_segments=len(segments),
                    folder=folder.folder,
                    psf=_estimated_psf(job, source.read(frames.start), tools, stop, tell)
                    if job.settings.psf == "auto"
                    else None,
                )
                (engine or LocalEngine(source, sink, tools)).compute(
                    work, todo, on_event=tell, stop=stop
                )
            stop.check()
            tell(Joining(segments=len(segments)))
            begin_join = tools.clock()
            written = list(sink.join([folder.stem(segment) for segment in segments]))
            end = tools.clock()
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
    tell(JobFinished(seconds=facts["seconds"], timings=report["timings"]))
    written += [path for path in (job.output.report, job.output.debug_dir) if path is not None]
    return RunSummary(
        written=tuple(written),
        frames=len(frames),
        frames_computed=computed,
        seconds=facts["seconds"],
        report=report,
    )


def _estimated_psf(
    job: Job,
    first: MultiViewFrame,
    tools: Tools,
    stop: StopFlag,
    tell: Callable[[Event], None],
) -> GaussianPsf:
    """Return the PSF of the job, estimated on its first frame so that all segments agree."""
    if job.input.views is not None:
        first = replace(first, views=tuple(first.view(view) for view in job.input.views))
    with stop.breakable():
        curve = tools.search_psf(first, job.settings)[0]
    if curve.remark:
        tell(Warned(text=curve.remark))
    return GaussianPsf.of(curve.sigma, curve.support)
