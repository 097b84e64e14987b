"""The first half of the work on a frame: its views registered onto the targets."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.effort import FULL, Effort, nearest_views
from pipeline.errors import SceneError
from pipeline.frames import MultiViewFrame, View
from pipeline.reconstruction.fused import Begun, begun_alone
from pipeline.reconstruction.psf import Psf
from pipeline.registration.layers import layer_labels, layer_thresholds
from pipeline.registration.method import RegistrationMethod
from pipeline.registration.prepare import PreparedView
from pipeline.registration.register import (
    Previous,
    Terms,
    ViewRegistration,
    prepare_views,
    register_some,
    register_views,
)
from pipeline.superresolve.chain import continued
from pipeline.superresolve.choices import chosen_filters, psf_of, terms_of
from pipeline.superresolve.due import MOVED
from pipeline.superresolve.memory import Memory
from pipeline.superresolve.registered import RegisteredFrame
from pipeline.superresolve.stages import Stages
from pipeline.temporal.neighbours import with_neighbours
from pipeline.threads import begin, set_threads, stoppable

PICTURE_LAYERS = 11
"""Depth layers shown in debug pictures where the method has none of its own (thesis Figure 2)."""


def register_frame(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: tuple[str, ...],
    observed_views: tuple[str, ...] | None = None,
    psf: Psf | None = None,
    keep_intermediates: bool = False,
    stop: Callable[[], bool] | None = None,
    memory: Memory | None = None,
    effort: Effort = FULL,
    neighbours: Sequence[MultiViewFrame] = (),
) -> RegisteredFrame:
    """Do the first half of :func:`superresolve`, which takes the same parameters.

    Of a chain, the next frame may be registered while this one is reconstructed.
    """
    set_threads(settings.threads)
    clock = Stages(stop)
    sources = observed_views or tuple(view.view_id for view in frame.views)
    for target in targets:
        if target not in sources:
            raise SceneError(
                "cannot be reconstructed: it is not among the observed views",
                view=target, frame=frame.frame_index,
            )  # fmt: skip
    in_order = [view.view_id for view in frame.views if view.view_id in sources]
    near = sources if effort.views is None else nearest_views(in_order, targets, effort.views)
    widened = frame
    added: tuple[str, ...] = ()
    if neighbours and effort.views is None:
        widened, added = with_neighbours(frame, neighbours, sources)
    noise = (memory or Memory()).seen.noise(frame, settings, sources)
    psf = psf or psf_of(settings)
    clock.done("preparation")
    with stoppable(stop):
        chain = continued(memory, frame, settings, targets, sources, noise)
        frame, noise = chain.frame, chain.noise
        if not added:
            widened = frame
        previous = None if memory is None else memory.to_go_on_from()
        observed = due = (*sources, *added)
        if previous is None or previous.has_moved:
            observed = due = (*near, *added)
        elif effort.register_every > 1:
            due = _due_views(observed, effort.register_every, previous.turn)
            known = {name for name in observed if _covers(previous, targets, [name])}
            observed = tuple(name for name in observed if name in known or name in due)
        begun = _begun(frame, settings, targets, psf, noise) if chain.has_moved else {}
        terms = terms_of(settings, noise)
        views = [widened.view(view_id) for view_id in dict.fromkeys((*targets, *observed))]
        prepared, registrations = _registered(frame, views, targets, observed, terms, previous, due)
        found = Previous(prepared=prepared, registrations=registrations, turn=0)
        if len(due) < len(observed):
            registrations = _with_pixels_of(found, widened, targets, observed)
    if memory is not None:
        # motions that are kept stay with the pixels that they were found from
        memory.keep(found, {target: frame.view(target).luma for target in targets})
    clock.done("registration")
    return RegisteredFrame(
        frame=frame,
        settings=settings,
        targets=targets,
        sources=tuple(name for name in observed if name in sources),
        near=(*near, *added),
        still=chain.still,
        psf=psf,
        noise=noise,
        registrations=registrations,
        matches=chain.matches,
        is_cut=chain.is_cut,
        has_moved=chain.has_moved,
        effort=effort,
        turn=1 if memory is None else memory.turn,
        begun=begun,
        layers=_layers_of(found.prepared, terms.method) if keep_intermediates else None,
        timings=clock.timings,
    )


def _begun(
    frame: MultiViewFrame,
    settings: Settings,
    targets: Sequence[str],
    psf: Psf,
    noise: float,
) -> dict[str, Callable[[], Begun]]:
    """Begin what needs no view but each target itself; nothing without filters.

    Where the rig has moved, one view is registered first, and by itself. What is begun is the same
    however many views there are.
    """
    learned = chosen_filters(settings, psf, noise)
    if learned is None:
        return {}
    return {
        target: begin(
            functools.partial(
                begun_alone, frame.view(target).luma, settings.grid, psf, noise, learned, MOVED
            )
        )
        for target in targets
    }


def _registered(
    frame: MultiViewFrame,
    views: Sequence[View],
    targets: Sequence[str],
    sources: Sequence[str],
    terms: Terms,
    previous: Previous | None,
    due: Sequence[str],
) -> tuple[dict[str, PreparedView], dict[str, list[ViewRegistration]]]:
    """Return the views prepared and registered; those that are not due keep their motions."""
    needed = [view for view in views if view.view_id in (*targets, *due)]
    prepared = prepare_views(needed, metric=frame.depth_is_metric)
    covered = [
        source
        for source in sources
        if previous is not None and _covers(previous, targets, [source])
    ]
    new = [source for source in sources if source not in covered]
    again = [source for source in covered if source in due]
    found: dict[str, dict[str, ViewRegistration]] = {target: {} for target in targets}

    def register(part: Sequence[str], before: Previous | None) -> None:
        registrations = register_views(prepared, targets, part, terms, previous=before)
        for target in targets:
            found[target] |= dict(zip(part, registrations[target], strict=True))

    if new:
        register(new, None)
    if previous is not None and len(again) < len(covered):
        prepared = {**previous.prepared, **prepared}
        registrations = register_some(prepared, targets, covered, again, terms, previous=previous)
        for target in targets:
            found[target] |= dict(zip(covered, registrations[target], strict=True))
    elif covered:
        register(covered, previous)
    return prepared, {target: [found[target][source] for source in sources] for target in targets}


def _due_views(sources: Sequence[str], every: int, turn: int) -> tuple[str, ...]:
    """Return the views whose motions are found anew in this frame.

    >>> [_due_views("abcd", 3, turn) for turn in range(3)]
    [('a', 'd'), ('c',), ('b',)]
    """
    return tuple(name for place, name in enumerate(sources) if (place + turn) % every == 0)


def _covers(previous: Previous, targets: Sequence[str], sources: Sequence[str]) -> bool:
    """Return whether all of the sources were registered onto all of the targets before."""
    return all(
        set(sources) <= {one.registered.view_id for one in previous.registrations.get(target, ())}
        for target in targets
    )


def _with_pixels_of(
    previous: Previous,
    frame: MultiViewFrame,
    targets: Sequence[str],
    sources: Sequence[str],
) -> dict[str, list[ViewRegistration]]:
    """Return the previous frame's registrations, unchanged but for the pixels observed."""
    found: dict[str, list[ViewRegistration]] = {}
    for target in targets:
        before = {one.registered.view_id: one for one in previous.registrations[target]}
        found[target] = []
        for source in sources:
            old = before[source]
            observed = frame.view(source).luma - old.offset
            found[target].append(
                replace(old, registered=replace(old.registered, observed=observed))
            )
    return found


def _layers_of(
    prepared: Mapping[str, PreparedView], method: RegistrationMethod
) -> dict[str, npt.NDArray[np.int32]]:
    """Return the depth layer of every pixel of every view, for pictures."""
    labels = {}
    for view_id, view in prepared.items():
        nearness = view.fine.nearness
        labels[view_id] = layer_labels(
            nearness, layer_thresholds(nearness, method.num_layers or PICTURE_LAYERS)
        )
    return labels
