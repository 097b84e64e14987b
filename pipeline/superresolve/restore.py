"""A frame for which nothing is registered: the quickest ways to it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from pipeline.config import Settings, Solver
from pipeline.effort import FULL, Effort, looked_at, nearest_views
from pipeline.frames import MultiViewFrame
from pipeline.reconstruction.again import Due
from pipeline.reconstruction.alone import Restored, refreshed, restored
from pipeline.reconstruction.psf import Psf
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage
from pipeline.superresolve.account import report_restored
from pipeline.superresolve.choices import chosen_filters, default_residual_threshold, psf_of
from pipeline.superresolve.due import MOSTLY_CHANGED, STILL, WARM, in_turn
from pipeline.superresolve.memory import Memory
from pipeline.superresolve.reconstruct import chroma_of
from pipeline.superresolve.stages import Stages
from pipeline.threads import map_threads, set_threads, stoppable


def restore_frame(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: tuple[str, ...],
    psf: Psf | None = None,
    stop: Callable[[], bool] | None = None,
    memory: Memory | None = None,
    effort: Effort = FULL,
) -> FrameResult:
    """Do what :func:`superresolve` does where nothing is to be registered.

    What has changed since the previous frame is made of its own view, and then of others by the
    motions of an earlier frame, if the effort says so. The rest stays as it was, but for the part
    of it that is refreshed: made again of all views as they were when they were last looked at.
    """
    set_threads(settings.threads)
    clock = Stages(stop)
    psf = psf or psf_of(settings)
    memory = memory or Memory()
    view_ids = [view.view_id for view in frame.views]
    names = looked_at(effort, view_ids, targets, frame.frame_index)
    near = nearest_views(view_ids, targets, effort.views)
    frame = replace(frame, views=tuple(frame.view(name) for name in names))
    with stoppable(stop):
        if not memory.is_of_size(frame):
            memory.forget()
        noise = memory.known_noise(targets)
        if noise is None:
            noise = memory.noise(frame, settings, targets)
        frame = memory.averaged(frame, noise)
        learned = chosen_filters(settings, psf, noise)
        clock.done("preparation")
        if any(memory.still[target].touched.mean() > MOSTLY_CHANGED for target in targets):
            memory.move_on()
        is_refreshed = effort.refresh_every is not None and settings.solver == Solver.FUSED
        known = memory.known_views() if is_refreshed else {}

        def restore(target: str) -> Restored:
            still = memory.still[target]
            made = restored(still, memory.restored(target), settings.grid, psf, noise, learned)
            if not (effort.refresh_every and known):
                return made
            refresh = in_turn(~still.touched, effort.refresh_every, frame.frame_index)
            due = [Due(wanted=refresh, noise=noise, tuning=STILL)]
            if not effort.alone:
                due.append(Due(wanted=still.touched, noise=noise, tuning=WARM, views=near))
            threshold = settings.residual_threshold or default_residual_threshold(noise)
            return refreshed(
                made, due, known[target], settings.grid, psf, learned,
                residual_threshold=threshold, most_steps=effort.steps, stop=stop,
            )  # fmt: skip

        found = dict(zip(targets, map_threads(restore, targets), strict=True))
        memory.keep_restored(frame, found)
        clock.done("reconstruction")
        images = {
            target: SuperResolvedImage(
                view_id=target,
                luma=made.shown,
                chroma=chroma_of(frame, settings, target, targets, psf),
            )
            for target, made in found.items()
        }
    clock.done("chroma")
    report = FrameReport(
        frame_index=frame.frame_index,
        noise_sigma=noise,
        noise_is_estimated=settings.noise_sigma is None,
        psf_sigma=psf.sigma,
        psf_support=psf.support,
        psf_is_estimated=settings.psf == "auto",
        targets=tuple(report_restored(target, settings, effort) for target in targets),
        effort=effort,
        timings=clock.timings,
    )
    return FrameResult(frame_index=frame.frame_index, images=images, report=report)
