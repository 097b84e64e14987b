"""A frame for which nothing is registered: the quickest ways to it.

The measurements that chose the constants: docs/experiments.md#swift-frames.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from pipeline.config import Settings, Solver
from pipeline.effort import FULL, SWIFT, Effort, looked_at, nearest_views
from pipeline.frames import Mask, MultiViewFrame
from pipeline.reconstruction.again import Again, Due
from pipeline.reconstruction.alone import Restored, refreshed, restored
from pipeline.reconstruction.fused import FusedTuning
from pipeline.reconstruction.learned import LearnedFilters
from pipeline.reconstruction.psf import Psf
from pipeline.registration.again import AGAIN
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage
from pipeline.superresolve.account import report_restored
from pipeline.superresolve.choices import chosen_filters, default_residual_threshold, psf_of
from pipeline.superresolve.due import (
    HELD,
    MOSTLY_CHANGED,
    NEW,
    STILL,
    WARM,
    as_cold_where_quiet,
    in_turn,
    in_turn_or_seldom,
)
from pipeline.superresolve.follow import Following, followable, leaders_of
from pipeline.superresolve.memory import Memory
from pipeline.superresolve.reconstruct import colour_of
from pipeline.superresolve.stages import Stages
from pipeline.temporal.alike import NOTHING_ASKED
from pipeline.threads import map_threads, set_threads, stoppable

CHANGED = replace(
    NEW, prior_strength=0.18, settled=0.065, settled_noise_powers=(1.0, -1.2), hold=4.2,
    data_share=FusedTuning.data_share, gain=FusedTuning.gain, stretch=2.3,
)  # fmt: skip
"""Work on what has changed in such a frame; at noise 2 every second step weighs the prior anew, and
the last step is not measured."""

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
    # one that has its turn costs little more once it is looked at
    near = names if effort.in_turn else nearest_views(view_ids, targets, effort.views)
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
    ready = _Ready(
        frame=frame, settings=settings, targets=targets, near=near, psf=psf, noise=noise,
        memory=memory, effort=effort, is_held=True,
    )  # fmt: skip
    return _made(ready, clock, stop)


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
        Where a rate is held: then one registered frame is enough, and none has its turn. Where much
        has changed, the memory lacks motions then.
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
        noise = memory.seen.noise(frame, settings, names)
        drifts = memory.seen.drifts(frame, targets, noise)
        jumps = memory.seen.jumps(targets, noise)
        averaged = memory.seen.averaged(frame, noise)
        shares = [memory.seen.still[target].share_touched for target in targets]
        lags = memory.seen.lags(targets) or (not is_held and memory.seen.begins_to_lag(targets))
        alike = NOTHING_ASKED if is_held else memory.found_alike(frame, targets)
        if not alike.is_behind and alike.way_on > 0:
            averaged = memory.seen.moved_on_to(frame, alike.way_on)
        if (
            memory.seen.is_quieter
            or drifts
            or jumps
            or lags
            or alike.is_behind
            or max(shares) > MUCH_CHANGED
        ):
            memory.seen = before
            if is_held and max(shares) > MUCH_CHANGED:
                memory.move_on()
            elif lags:
                memory.solve_again()
            return None
        memory.land(averaged, near)
    ready = _Ready(
        frame=averaged, settings=settings, targets=targets, near=near, psf=psf, noise=noise,
        memory=memory, effort=effort, is_held=is_held,
    )  # fmt: skip
    return _made(ready, clock, stop)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Ready:
    """A frame for which nothing is to be registered, and how it is to be made."""

    frame: MultiViewFrame
    """Averaged over the frames in which it has stood still."""
    settings: Settings
    targets: tuple[str, ...]
    near: tuple[str, ...]
    """Views that what has changed is made of, if the effort says so."""
    psf: Psf
    noise: float
    """Standard deviation, grey levels."""
    memory: Memory
    effort: Effort
    is_held: bool
    """Whether it is one of those that hold a rate."""


def _made(ready: _Ready, clock: Stages, stop: Callable[[], bool] | None) -> FrameResult:
    """Return the result of a frame that is ready."""
    frame, settings, targets, psf = ready.frame, ready.settings, ready.targets, ready.psf
    with stoppable(stop):
        learned = chosen_filters(settings, psf, ready.noise)
        clock.done("preparation")
        made = _restored(ready, learned, stop)
        ready.memory.keep_restored(frame, made)
        clock.done("reconstruction")
        images = {
            target: SuperResolvedImage(
                view_id=target,
                luma=left.shown,
                colour=colour_of(frame, settings, target, targets, psf),
            )
            for target, left in made.items()
        }
    clock.done("chroma")

    def share_kept(target: str) -> float:
        by_depth = ready.effort.by_depth
        return 1 - ready.memory.seen.still[target].share_touched if by_depth else 0.0

    report = FrameReport(
        frame_index=frame.frame_index,
        noise_sigma=ready.noise,
        noise_is_estimated=settings.noise_sigma is None,
        psf_sigma=psf.sigma,
        psf_support=psf.support,
        psf_is_estimated=settings.psf == "auto",
        targets=tuple(
            report_restored(target, settings, ready.effort, share_kept(target))
            for target in targets
        ),
        effort=ready.effort,
        timings=clock.timings,
    )
    return FrameResult(frame_index=frame.frame_index, images=images, report=report)


def _restored(
    ready: _Ready, learned: LearnedFilters | None, stop: Callable[[], bool] | None
) -> dict[str, Restored]:
    """Return the targets, made of themselves alone and then, if the effort says so, of others."""
    settings, psf, noise, effort = ready.settings, ready.psf, ready.noise, ready.effort
    memory, still = ready.memory, ready.memory.seen.still
    is_refreshed = effort.refresh_every is not None and settings.solver == Solver.FUSED
    known = memory.known_views() if is_refreshed else {}

    before = memory.shown(ready.targets)
    lefts = {target: memory.restored(target) for target in ready.targets}
    is_followed = effort.in_turn or (effort.alone and effort.follow)
    leaders = leaders_of(
        followable(ready.targets, before, still) if is_followed else [], ready.frame.frame_index
    )
    following = Following(
        leaders=leaders, before=before, still=still, settings=settings, psf=psf, noise=noise,
        flows=memory.landed_flows(leaders) if effort.by_depth else {},
        in_turn=effort.in_turn and bool(known),
    )  # fmt: skip

    def alone(target: str) -> Restored:
        return restored(
            still[target], lefts[target], settings.grid, psf, noise, learned,
            ripens=not (is_followed and known),
        )  # fmt: skip

    def again(target: str, start: Restored) -> Again:
        views, offsets = known[target]
        left = lefts[target] if effort.in_turn else None
        is_led = effort.in_turn and leaders.get(target) is not None
        due = _due(ready, target, None if left is None else left.waiting, is_led=is_led)
        return Again(due=due, registered=views, offsets=offsets, start=start.estimate)

    # the searches beside what is restored: they need nothing of it
    tasks: list[Callable[[], Any]] = [functools.partial(alone, name) for name in ready.targets]
    tasks += [functools.partial(following.find, name) for name in following.sought]
    done = map_threads(lambda task: task(), tasks)
    made = dict(zip(ready.targets, done, strict=False))
    following.improve(made, leads=True)
    if effort.alone:
        following.improve(made, leads=False)
    if known:
        due = map_threads(lambda pair: again(*pair), made.items())
        found = refreshed(
            list(made.values()), due, settings.grid, psf, learned, stop=stop,
            most_steps=effort.steps,
            residual_threshold=settings.residual_threshold or default_residual_threshold(noise),
        )  # fmt: skip
        made = dict(zip(ready.targets, found, strict=True))
    if effort.in_turn:
        following.improve(made, leads=False)
    return made


def _due(ready: _Ready, target: str, waiting: Mask | None, *, is_led: bool) -> list[Due]:
    """Return what of a target is made again, of all views or of those near.

    Parameters
    ----------
    waiting : (H, W) bool, optional
        What has changed before and was not made of others yet.
    is_led : bool
        Whether the target follows another one where it changes, and has its turn later.
    """
    noise, effort, memory = ready.noise, ready.effort, ready.memory
    every, number = effort.refresh_every, ready.frame.frame_index
    assert every is not None  # something is made again
    still = memory.seen.still[target]
    touched = still.touched
    wanted = touched if waiting is None else touched | waiting
    if effort.alone or effort.in_turn:
        is_ripe = functools.partial(memory.is_ripe, target)
        refresh = in_turn_or_seldom(~wanted, is_ripe, every, number)
    elif still.noise_stays and not ready.is_held:
        # as in a frame that is registered
        refresh = ~wanted
    else:
        refresh = in_turn(~wanted, every, number)
    # views as they were say less than those that are looked at
    tuning = HELD if ready.is_held and effort.others else STILL
    due = [Due(wanted=refresh, noise=noise, tuning=tuning)]
    if not (effort.alone or is_led):
        tuning = CHANGED if effort.by_depth else WARM
        if effort.in_turn:
            tuning = replace(tuning, stretch=1.0)
        if effort.by_depth:
            tuning = as_cold_where_quiet(tuning, noise)
        due.append(Due(wanted=wanted, noise=noise, tuning=tuning, views=ready.near))
    return due
