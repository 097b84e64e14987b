"""Registering all views of a frame onto its reference views (thesis chapter 2): the order of it.

The first reference is registered from scratch; the others start from what the first one taught:
patches keep their refined depth, and views reach a second reference through the first. Within a
chain, a frame starts from the one before it. What is done with two views is in
:mod:`pipeline.registration.pair`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipeline.frames import View
from pipeline.registration.again import Counts, count_changes
from pipeline.registration.method import Layout, MotionModel, RegistrationMethod
from pipeline.registration.moved import register_moved
from pipeline.registration.pair import (
    Before,
    carried_view,
    inverse_view,
    landed_view,
    register_view,
    seen_again,
)
from pipeline.registration.prepare import PreparedView, prepare
from pipeline.registration.records import Previous, Terms, Thresholds, ViewRegistration
from pipeline.registration.windows import LEAST_PARALLAX, depth_fits, pixels_per_nearness
from pipeline.threads import map_threads

__all__ = [
    "Previous",
    "Terms",
    "Thresholds",
    "ViewRegistration",
    "prepare_views",
    "register_in_steps",
    "register_some",
    "register_view",
    "register_views",
]

NUM_LEVELS = 5
"""Pyramid levels, the LR image included."""


def prepare_views(views: Sequence[View], *, metric: bool) -> dict[str, PreparedView]:
    """Return every view prepared for registration, by view id."""
    prepared = map_threads(lambda view: prepare(view, NUM_LEVELS, metric=metric), views)
    return {view.view.view_id: view for view in prepared}


def register_views(
    prepared: dict[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    terms: Terms,
    *,
    previous: Previous | None = None,
) -> dict[str, list[ViewRegistration]]:
    """Return, for each target, every source view registered onto it, in the order of sources.

    Parameters
    ----------
    prepared : dict
        All views, by id; targets and sources are among them.
    targets, sources : sequences of view ids
        A target that is among the sources appears as its own, unmoved observation.
    previous : Previous, optional
        The previous frame: what has not changed since then keeps its motion.
    """
    if (
        previous is not None
        and terms.method.layout is Layout.WINDOWS
        and terms.method.refine
        and _depth_fits(prepared, _by_views(previous, targets), targets, sources)
    ):
        again = _register_moved if previous.has_moved else _register_again
        return again(prepared, targets, sources, terms, previous)
    return _register_from_scratch(prepared, targets, sources, terms)


def _register_from_scratch(
    prepared: Mapping[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    terms: Terms,
) -> dict[str, list[ViewRegistration]]:
    """Register the views of a frame in one go."""
    *_, found = register_in_steps(prepared, targets, sources, terms)
    assert found is not None  # all steps are done
    return found


def register_in_steps(
    prepared: Mapping[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    terms: Terms,
    at_once: int | None = None,
) -> Iterator[dict[str, list[ViewRegistration]] | None]:
    """Register the views of a frame from scratch; yield None after each step, the result at last.

    The coarse start of a second reference is by the first.

    Parameters
    ----------
    at_once : int, optional
        Views that are registered onto a reference in one step; default: as many as can be.
    """
    first, *others = targets
    chained = terms.method.layout is Layout.WINDOWS and terms.method.refine

    def onto(
        target: str,
        source: str,
        through: tuple[ViewRegistration, ViewRegistration] | None = None,
    ) -> ViewRegistration:
        return register_view(prepared[source], prepared[target], terms, through=through)

    wanted = list(dict.fromkeys((*sources, *others))) if chained else list(sources)
    begun = [(first, source) for source in wanted]
    if chained:  # the bridges to the other references do not wait for anything
        begun += [(target, first) for target in others]
    found: dict[tuple[str, str], ViewRegistration] = {}

    def onto_another(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        bridge = found.get((target, first))
        if bridge is None or source == target:
            return onto(target, source)
        if source == first:
            return bridge
        return onto(target, source, (found[first, source], bridge))

    tasks = [(target, source) for target in others for source in sources]
    steps = [(part, lambda task: onto(*task)) for part in _parts(begun, at_once, [])]
    known = [first] if chained else []
    steps += [(part, onto_another) for part in _parts(tasks, at_once, known)]
    for number, (part, function) in enumerate(steps, 1):
        found |= zip(part, map_threads(function, part), strict=True)
        if number < len(steps):
            yield None
    yield {target: [found[target, source] for source in sources] for target in targets}


def _parts(
    tasks: Sequence[tuple[str, str]], at_once: int | None, known: Sequence[str]
) -> Iterator[Sequence[tuple[str, str]]]:
    """Yield so many (target, source) at once, all by default; the last ones with what is known."""
    cheap = [task for task in tasks if task[0] == task[1] or task[1] in known]
    dear = [task for task in tasks if task not in cheap]
    size = at_once or max(1, len(dear))
    parts = [dear[begin : begin + size] for begin in range(0, len(dear), size)]
    yield from parts[:-1]
    yield [*(parts[-1] if parts else []), *cheap]


def register_some(
    prepared: dict[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    due: Sequence[str],
    terms: Terms,
    *,
    previous: Previous,
) -> dict[str, list[ViewRegistration]]:
    """Return what :func:`register_views` does, with the motions of some views only found anew.

    The others keep theirs, and what has changed meanwhile is remembered for when it is their turn.

    Parameters
    ----------
    prepared : dict
        Of those that are due and of the targets, this frame's views; of the others the previous
        frame's. Pixels of views that are not due are the caller's to bring up to date.
    due : sequence of view ids
        Sources whose motions are found anew.
    """
    found = register_views(prepared, targets, due, terms, previous=previous)
    kept = _by_views(previous, targets)
    changed = {name: _changes(name, prepared, previous, terms.noise) for name in targets}

    def missed(target: str, source: str) -> ViewRegistration:
        old = kept[target, source]
        nothing = np.zeros_like(changed[target])
        return replace(
            old, missed=_together((changed.get(source, nothing), changed[target]), old.missed)
        )

    anew = {(target, one.registered.view_id): one for target in targets for one in found[target]}
    return {
        target: [anew.get((target, source)) or missed(target, source) for source in sources]
        for target in targets
    }


# --- from the previous frame -----------------------------------------------------------------


def _register_again(
    prepared: dict[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    terms: Terms,
    previous: Previous,
) -> dict[str, list[ViewRegistration]]:
    """Register the views of a frame onto its references, starting from the previous frame."""
    names = list(dict.fromkeys((*targets, *sources)))
    old = _by_views(previous, targets)

    def changes(name: str) -> Counts:
        return _changes(name, prepared, previous, terms.noise)

    changed = dict(zip(names, map_threads(changes, names), strict=True))

    def before(task: tuple[str, str]) -> Before:
        target, source = task
        now = changed[source], changed[target]
        return Before(
            registration=replace(old[task], missed=None),
            changed=_together(now, old[task].missed),
            turn=previous.turn,
        )

    def again(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        return register_view(prepared[source], prepared[target], terms, before=before(task))

    leads = {source: _lead(prepared[source], targets, terms.method, old) for source in sources}
    tasks = [(target, source) for target in targets for source in sources]
    fitted = [task for task in tasks if leads[task[1]] in (None, task[0])]
    found = dict(zip(fitted, map_threads(again, fitted), strict=True))

    def carried(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        lead = found[leads[source] or target, source]
        known = carried_view(prepared[source], prepared[target], lead, before(task), terms)
        return known or again(task)

    others = [task for task in tasks if task not in found]
    found |= dict(zip(others, map_threads(carried, others), strict=True))
    return {target: [found[target, source] for source in sources] for target in targets}


def _register_moved(
    prepared: dict[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    terms: Terms,
    previous: Previous,
) -> dict[str, list[ViewRegistration]]:
    """Register the views of a frame in which the rig has moved.

    Of two references that are registered onto one another one is fitted, and its motion inverted.
    Where the first view that is fitted does not keep to how it stood before, none is held to that.
    """
    old = _by_views(previous, targets)

    def kept(task: tuple[str, str]) -> ViewRegistration | None:
        target, source = task
        fit = register_moved(
            prepared[source], prepared[target], old[task], terms.noise, terms.method.model
        )
        return None if fit is None else landed_view(prepared[source], prepared[target], fit, terms)

    def again(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        if target == source:
            return seen_again(old[task], prepared[source])
        return kept(task) or register_view(prepared[source], prepared[target], terms)

    tasks = [(target, source) for target in targets for source in sources]
    inverses = {
        task
        for number, task in enumerate(tasks)
        if task[0] != task[1] and task[::-1] in tasks[:number]
    }
    fitted = [task for task in tasks if task not in inverses]
    found: dict[tuple[str, str], ViewRegistration] = {}
    first = next((task for task in fitted if task[0] != task[1]), None)
    if first is not None:
        lead = kept(first)
        if lead is None:
            return _register_from_scratch(prepared, targets, sources, terms)
        found[first] = lead
    rest = [task for task in fitted if task != first]
    found |= dict(zip(rest, map_threads(again, rest), strict=True))

    def inverse(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        lead = found[source, target]
        if lead.parallax is not old[source, target].parallax:
            return again(task)
        return inverse_view(prepared[source], prepared[target], lead, old[task], terms.thresholds)

    others = [task for task in tasks if task in inverses]
    found |= dict(zip(others, map_threads(inverse, others), strict=True))
    return {target: [found[target, source] for source in sources] for target in targets}


def _by_views(
    previous: Previous, targets: Sequence[str]
) -> dict[tuple[str, str], ViewRegistration]:
    """Return the registrations of the previous frame by target and source."""
    return {
        (target, registration.registered.view_id): registration
        for target in targets
        for registration in previous.registrations[target]
    }


def _lead(
    source: PreparedView,
    targets: Sequence[str],
    method: RegistrationMethod,
    old: Mapping[tuple[str, str], ViewRegistration],
) -> str | None:
    """Return the reference on which a view's depth is best told, the farthest; None: on none.

    A view that is a reference itself, or that has no parallax, is fitted onto each of them.
    """
    name = source.view.view_id
    if name in targets or method.model is not MotionModel.AFFINE:
        return None
    parallaxes = [old[target, name].parallax for target in targets]
    moves = [
        0.0 if parallax is None else pixels_per_nearness(source, parallax) * source.depth_range
        for parallax in parallaxes
    ]
    return targets[int(np.argmax(moves))] if min(moves) > LEAST_PARALLAX else None


def _depth_fits(
    prepared: Mapping[str, PreparedView],
    old: Mapping[tuple[str, str], ViewRegistration],
    targets: Sequence[str],
    sources: Sequence[str],
) -> bool:
    """Return whether depth still means to the rig what it meant in the frames before.

    Depth that is normalised frame by frame, say, has another unit in each.
    """

    def onto_another(source: str) -> ViewRegistration | None:
        found = (old.get((target, source)) for target in targets if target != source)
        return next((one for one in found if one is not None and one.motions is not None), None)

    befores = ((source, onto_another(source)) for source in sources)
    return all(before is None or depth_fits(prepared[source], before) for source, before in befores)


def _changes(
    name: str, prepared: Mapping[str, PreparedView], previous: Previous, noise: float
) -> Counts:
    """Return how many pixels of a view are not what they were in the previous frame."""
    return count_changes(prepared[name], previous.prepared[name], noise, previous.lagging.get(name))


def _together(
    now: tuple[Counts, Counts], before: tuple[Counts, Counts] | None
) -> tuple[Counts, Counts]:
    """Return how many pixels have changed now or before, in a view and in its reference."""
    return now if before is None else (now[0] + before[0], now[1] + before[1])
