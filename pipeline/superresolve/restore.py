"""A frame for which nothing is registered: the quickest ways to it.

The measurements that chose the constants: docs/experiments.md#swift-frames.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace

from pipeline.config import Settings, Solver
from pipeline.effort import FULL, SWIFT, Effort, looked_at, nearest_views
from pipeline.frames import MultiViewFrame
from pipeline.reconstruction.again import Again, Due
from pipeline.reconstruction.alone import Restored, refreshed, restored
from pipeline.reconstruction.psf import Psf
from pipeline.registration.again import AGAIN
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage
from pipeline.superresolve.account import report_restored
from pipeline.superresolve.choices import chosen_filters, default_residual_threshold, psf_of
from pipeline.superresolve.due import (
    MOSTLY_CHANGED,
    NEW,
    STILL,
    WARM,
    as_cold_where_quiet,
    in_turn,
)
from pipeline.superresolve.follow import follow
from pipeline.superresolve.memory import Memory
from pipeline.superresolve.reconstruct import colour_of
from pipeline.superresolve.stages import Stages
from pipeline.threads import map_threads, set_threads, stoppable

CHANGED = replace(NEW, settled=0.12, hold=4.2)
"""Work on what has changed in such a frame; at noise 2 every second step weighs the prior anew."""

REGISTER_EVERY = 16
"""One frame in so many is registered there as a warm one is: drift is found and repaired."""

MUCH_CHANGED = 0.5
"""Share of a target, with what is near, from whose change on a frame is registered, too."""


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
        noise = memory.seen.known_noise(targets)
        if noise is None:
            noise = memory.seen.noise(frame, settings, targets)
        frame = memory.seen.averaged(frame, noise)
        memory.miss(names)
        if any(memory.seen.still[target].share_touched > MOSTLY_CHANGED for target in targets):
            memory.move_on()
    return _made(frame, settings, targets, near, psf, noise, memory, effort, clock, stop)


def swift_frame(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: tuple[str, ...],
    psf: Psf | None = None,
    stop: Callable[[], bool] | None = None,
    memory: Memory,
    effort: Effort | None = None,
) -> FrameResult | None:
    """Do what :func:`superresolve` does for a frame of ``--temporal swift``.

    Nothing is registered: what has changed lands by its depth maps, which the frames registered
    before have shown to be right. None where this frame has to be registered: one in
    ``REGISTER_EVERY``, the first ones of a chain, one of which much has changed or that goes on
    changing all over, or where depth says too little. What the memory knew is then as it was, but
    that what has lagged behind is solved again.

    Parameters
    ----------
    effort : Effort, optional
        Where a rate is held: then one registered frame is enough, and none has its turn.
    """
    is_held = effort is not None
    if not is_held and (
        frame.frame_index % REGISTER_EVERY == 0 or memory.frames_stood <= max(AGAIN)
    ):
        return None
    effort = effort or SWIFT
    view_ids = tuple(view.view_id for view in frame.views)
    near = nearest_views(view_ids, targets, effort.views)
    if not memory.can_land(frame, targets, near):
        return None
    names = looked_at(effort, view_ids, targets, frame.frame_index)
    frame = replace(frame, views=tuple(frame.view(name) for name in names))
    set_threads(settings.threads)
    clock = Stages(stop)
    psf = psf or psf_of(settings)
    with stoppable(stop):
        before = copy.copy(memory.seen)
        noise, nearness = memory.noise_and_nearness(frame, settings, near)
        averaged = memory.seen.averaged(frame, noise)
        shares = [memory.seen.still[target].share_touched for target in targets]
        drifts = memory.seen.drifts(frame, targets, noise)
        lags = memory.seen.lags(targets) or (not is_held and memory.seen.begins_to_lag(targets))
        if memory.seen.is_quieter or drifts or lags or max(shares) > MUCH_CHANGED:
            memory.seen = before
            if lags:
                memory.solve_again()
            return None
        memory.land(averaged, near, nearness)
    return _made(averaged, settings, targets, near, psf, noise, memory, effort, clock, stop)


def _made(
    frame: MultiViewFrame,
    settings: Settings,
    targets: tuple[str, ...],
    near: tuple[str, ...],
    psf: Psf,
    noise: float,
    memory: Memory,
    effort: Effort,
    clock: Stages,
    stop: Callable[[], bool] | None,
) -> FrameResult:
    """Return the result of a frame whose still parts have been averaged; ``near`` make the rest."""
    with stoppable(stop):
        learned = chosen_filters(settings, psf, noise)
        clock.done("preparation")
        is_refreshed = effort.refresh_every is not None and settings.solver == Solver.FUSED
        known = memory.known_views() if is_refreshed else {}

        def restore(target: str) -> Restored:
            left, still = memory.restored(target), memory.seen.still[target]
            return restored(still, left, settings.grid, psf, noise, learned)

        def again(target: str, made: Restored) -> Again:
            still, every = memory.seen.still[target], effort.refresh_every
            assert every is not None  # else there are no known views
            refresh = in_turn(~still.touched, every, frame.frame_index)
            due = [Due(wanted=refresh, noise=noise, tuning=STILL)]
            if not effort.alone:
                due.append(
                    Due(
                        wanted=still.touched,
                        noise=noise,
                        tuning=as_cold_where_quiet(CHANGED, noise) if effort.by_depth else WARM,
                        views=near,
                    )
                )
            views, offsets = known[target]
            return Again(due=due, registered=views, offsets=offsets, start=made.estimate)

        before = memory.shown(targets)
        made = map_threads(restore, targets)
        if effort.alone and effort.follow:
            by_target = dict(zip(targets, made, strict=True))
            follow(by_target, before, memory.seen.still, settings, psf, noise, frame.frame_index)
        if known:
            made = refreshed(
                made, [again(*pair) for pair in zip(targets, made, strict=True)],
                settings.grid, psf, learned,
                residual_threshold=settings.residual_threshold or default_residual_threshold(noise),
                most_steps=effort.steps, stop=stop,
            )  # fmt: skip
        found = dict(zip(targets, made, strict=True))
        memory.keep_restored(frame, found)
        clock.done("reconstruction")
        images = {
            target: SuperResolvedImage(
                view_id=target,
                luma=made.shown,
                colour=colour_of(frame, settings, target, targets, psf),
            )
            for target, made in found.items()
        }
    clock.done("chroma")

    def share_kept(target: str) -> float:
        return 1 - memory.seen.still[target].share_touched if effort.by_depth else 0.0

    report = FrameReport(
        frame_index=frame.frame_index,
        noise_sigma=noise,
        noise_is_estimated=settings.noise_sigma is None,
        psf_sigma=psf.sigma,
        psf_support=psf.support,
        psf_is_estimated=settings.psf == "auto",
        targets=tuple(
            report_restored(target, settings, effort, share_kept(target)) for target in targets
        ),
        effort=effort,
        timings=clock.timings,
    )
    return FrameResult(frame_index=frame.frame_index, images=images, report=report)
