"""Registering all views of a frame onto its reference views (thesis chapter 2): the order of it.

For each view and reference: patches (Eq. 1), their motions (Eq. 2), the landing point of
every pixel, registration weights (Eq. 3) and verification (Eq. 4). The first reference is
registered from scratch; the others start from what the first one taught: patches keep
their refined depth, and views reach a second reference through the first.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline.frames import RegisteredView, View
from pipeline.registration.again import (
    Again,
    Counts,
    count_changes,
    judged_again,
    register_again,
    renumbered,
    stale_patches,
    with_pixels_of,
)
from pipeline.registration.carried import carry_motions, carry_pixels
from pipeline.registration.inverse import inverted
from pipeline.registration.method import Layout, MotionModel, RegistrationMethod
from pipeline.registration.moved import register_moved
from pipeline.registration.parallax import identity
from pipeline.registration.prepare import PreparedView, prepare
from pipeline.registration.records import Previous, Thresholds, ViewRegistration
from pipeline.registration.strips import register_strips
from pipeline.registration.verdict import registered_view
from pipeline.registration.window_fits import windows_of
from pipeline.registration.windows import (
    LEAST_PARALLAX,
    Landed,
    WindowFit,
    depth_fits,
    land,
    pixels_of,
    pixels_per_nearness,
    register_windows,
)
from pipeline.threads import map_threads

__all__ = [
    "Previous",
    "Thresholds",
    "ViewRegistration",
    "prepare_views",
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
    method: RegistrationMethod,
    *,
    noise: float,
    thresholds: Thresholds,
    previous: Previous | None = None,
) -> dict[str, list[ViewRegistration]]:
    """Return, for each target, every source view registered onto it, in the order of sources.

    Parameters
    ----------
    prepared : dict
        All views, by id; targets and sources are among them.
    targets, sources : sequences of view ids
        A target that is among the sources appears as its own, unmoved observation.
    noise : float
        Standard deviation, grey levels.
    previous : Previous, optional
        The previous frame: what has not changed since then keeps its motion.
    """
    if (
        previous is not None
        and method.layout is Layout.WINDOWS
        and method.refine
        and _depth_fits(prepared, _by_views(previous, targets), targets, sources)
    ):
        again = _register_moved if previous.has_moved else _register_again
        return again(prepared, targets, sources, method, noise, thresholds, previous)
    first, *others = targets
    chained = method.layout is Layout.WINDOWS and method.refine
    wanted = list(sources)
    if chained:
        wanted += [target for target in others if target not in wanted]
    found = dict(
        zip(
            wanted,
            map_threads(
                lambda source: register_view(
                    prepared[source], prepared[first], method, noise=noise, thresholds=thresholds
                ),
                wanted,
            ),
            strict=True,
        )
    )
    result = {first: [found[source] for source in sources]}
    tasks = [(target, source) for target in others for source in sources]
    bridges = {}
    if chained:
        for target in others:
            bridges[target] = map_threads(
                lambda target: register_view(
                    prepared[first], prepared[target], method, noise=noise, thresholds=thresholds
                ),
                [target],
            )[0]

    # the coarse start of a second reference comes through the first one
    def second(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        bridge = bridges.get(target)
        if bridge is not None and source == first:
            return bridge
        return register_view(
            prepared[source], prepared[target], method, noise=noise, thresholds=thresholds,
            through=None if bridge is None or source == target else (found[source], bridge),
        )  # fmt: skip

    for (target, _), registration in zip(tasks, map_threads(second, tasks), strict=True):
        result.setdefault(target, []).append(registration)
    return result


def register_view(
    source: PreparedView,
    reference: PreparedView,
    method: RegistrationMethod,
    *,
    noise: float,
    thresholds: Thresholds,
    through: tuple[ViewRegistration, ViewRegistration] | None = None,
    before: Before | None = None,
) -> ViewRegistration:
    """Return one view registered onto one reference.

    Parameters
    ----------
    through : (source onto another reference, that reference onto this one), optional
        Where given, motions start from the composition of the two.
    before : Before, optional
        The same two views in the previous frame.
    """
    if source.view.view_id == reference.view.view_id:
        return _onto_itself(source)
    if method.layout is Layout.STRIPS:
        fitted, labels, position, offset = register_strips(source, reference, method, noise)
        return ViewRegistration(
            registered=registered_view(source, reference, position, offset, thresholds),
            motions=fitted, parallax=None, patch_labels=labels, offset=offset,
        )  # fmt: skip
    if before is not None:
        again = register_again(
            source, reference, before.registration, before.changed, noise, before.turn, method.model
        )
        if again is not None:
            return _renewed(source, reference, again, before, method, noise, thresholds)
    start = None if before is None else before.registration.parallax
    fit = register_windows(source, reference, method, noise, through, start)
    return _landed(source, reference, fit, method, noise, thresholds)


def _landed(
    source: PreparedView,
    reference: PreparedView,
    fit: WindowFit,
    method: RegistrationMethod,
    noise: float,
    thresholds: Thresholds,
) -> ViewRegistration:
    """Return a view whose windows are fitted, each of its pixels with one of their motions."""
    landed = land(source, reference, fit, noise, method)
    return ViewRegistration(
        registered=registered_view(source, reference, landed.position, landed.offset, thresholds),
        motions=fit.fitted,
        parallax=fit.parallax,
        prior=fit.prior,
        patch_labels=landed.labels,
        offset=landed.offset,
    )


def _onto_itself(source: PreparedView) -> ViewRegistration:
    height, width = source.view.luma.shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    return ViewRegistration(
        registered=RegisteredView(
            view_id=source.view.view_id,
            observed=source.view.luma,
            position=np.stack([x, y], axis=-1),
            registration_weights=np.zeros((height, width), np.float32),
            flags=np.zeros((height, width), np.uint8),
            confidence=np.ones((height, width), np.float32),
            is_reference=True,
        ),
        motions=None,
        parallax=identity(),
        patch_labels=np.zeros((height, width), np.int32),
        offset=np.zeros((height, width), np.float32),
    )


# --- from the previous frame -----------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class Before:
    """Two views in the previous frame, and what has happened to them since."""

    registration: ViewRegistration
    changed: tuple[Counts, Counts]
    """Pixels in the source and in the reference, counted."""
    turn: int


def _register_again(
    prepared: dict[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    method: RegistrationMethod,
    noise: float,
    thresholds: Thresholds,
    previous: Previous,
) -> dict[str, list[ViewRegistration]]:
    """Register the views of a frame onto its references, starting from the previous frame."""
    names = list(dict.fromkeys((*targets, *sources)))
    old = _by_views(previous, targets)

    def changes(name: str) -> Counts:
        return count_changes(prepared[name], previous.prepared[name], noise)

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
        return register_view(
            prepared[source], prepared[target], method, noise=noise, thresholds=thresholds,
            before=before(task),
        )  # fmt: skip

    leads = {source: _lead(prepared[source], targets, method, old) for source in sources}
    tasks = [(target, source) for target in targets for source in sources]
    fitted = [task for task in tasks if leads[task[1]] in (None, task[0])]
    found = dict(zip(fitted, map_threads(again, fitted), strict=True))

    def carried(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        lead = found[leads[source] or target, source]
        return _carried(
            prepared[source], prepared[target], lead, before(task), noise, thresholds
        ) or again(task)

    others = [task for task in tasks if task not in found]
    found |= dict(zip(others, map_threads(carried, others), strict=True))
    return {target: [found[target, source] for source in sources] for target in targets}


def register_some(
    prepared: dict[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    due: Sequence[str],
    method: RegistrationMethod,
    *,
    noise: float,
    thresholds: Thresholds,
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
    found = register_views(
        prepared, targets, due, method, noise=noise, thresholds=thresholds, previous=previous
    )
    kept = _by_views(previous, targets)
    changed = {
        name: count_changes(prepared[name], previous.prepared[name], noise) for name in targets
    }

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


def _together(
    now: tuple[Counts, Counts], before: tuple[Counts, Counts] | None
) -> tuple[Counts, Counts]:
    """Return how many pixels have changed now or before, in a view and in its reference."""
    return now if before is None else (now[0] + before[0], now[1] + before[1])


def _register_moved(
    prepared: dict[str, PreparedView],
    targets: Sequence[str],
    sources: Sequence[str],
    method: RegistrationMethod,
    noise: float,
    thresholds: Thresholds,
    previous: Previous,
) -> dict[str, list[ViewRegistration]]:
    """Register the views of a frame in which the rig has moved.

    Of two references that are registered onto one another one is fitted, and its motion inverted.
    Where the first view that is fitted does not keep to how it stood before, none is held to that.
    """
    old = _by_views(previous, targets)

    def kept(task: tuple[str, str]) -> ViewRegistration | None:
        target, source = task
        fit = register_moved(prepared[source], prepared[target], old[task], noise, method.model)
        if fit is None:
            return None
        return _landed(prepared[source], prepared[target], fit, method, noise, thresholds)

    def again(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        found = None if target == source else kept(task)
        return found or register_view(
            prepared[source], prepared[target], method, noise=noise, thresholds=thresholds
        )

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
            return register_views(
                prepared, targets, sources, method, noise=noise, thresholds=thresholds
            )
        found[first] = lead
    rest = [task for task in fitted if task != first]
    found |= dict(zip(rest, map_threads(again, rest), strict=True))

    def inverse(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        lead = found[source, target]
        if lead.parallax is not old[source, target].parallax:
            return again(task)
        return _inverse(prepared[source], prepared[target], lead, old[task], thresholds)

    others = [task for task in tasks if task in inverses]
    found |= dict(zip(others, map_threads(inverse, others), strict=True))
    return {target: [found[target, source] for source in sources] for target in targets}


def _inverse(
    source: PreparedView,
    reference: PreparedView,
    lead: ViewRegistration,
    rig: ViewRegistration,
    thresholds: Thresholds,
) -> ViewRegistration:
    """Return a view registered onto a reference, from how that one is registered onto the view.

    Parameters
    ----------
    lead : ViewRegistration
        The reference onto the view.
    rig : ViewRegistration
        The view onto the reference in the previous frame.
    """
    landed = inverted(lead, reference.fine.nearness, source.fine.nearness)
    return ViewRegistration(
        registered=registered_view(source, reference, landed.position, landed.offset, thresholds),
        motions=None,
        parallax=rig.parallax,
        prior=rig.prior,
        patch_labels=landed.labels,
        offset=landed.offset,
    )


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


def _carried(
    source: PreparedView,
    reference: PreparedView,
    lead: ViewRegistration,
    before: Before,
    noise: float,
    thresholds: Thresholds,
) -> ViewRegistration | None:
    """Return a registration of the previous frame with what another reference tells of a view.

    None where that one was registered from scratch, or this one must be.
    """
    old = before.registration
    stale = stale_patches(source, reference, old, before.changed, noise, before.turn)
    if (
        stale is None or lead.fresh is None or old.motions is None or old.parallax is None
        or old.prior is None or lead.prior is None
    ):  # fmt: skip
        return None
    fresh = lead.fresh.copy()
    fresh.flat[windows_of(old.motions).cell[stale]] = True
    if not fresh.any():
        return replace(with_pixels_of(old, source), fresh=fresh)
    offset = old.prior.offset_mean - lead.prior.offset_mean
    kept = Landed(
        labels=old.patch_labels, position=old.registered.position, offset=old.offset
    )  # fmt: skip
    pixels = pixels_of(fresh, old.offset.shape)
    landed = carry_pixels(source, lead, old.parallax, offset, kept, pixels)
    renewed = judged_again(pixels)
    return replace(
        old,
        registered=registered_view(
            source, reference, landed.position, landed.offset, thresholds,
            before=(old.registered, pixels, renewed),
        ),
        motions=carry_motions(lead, old.parallax, offset),
        patch_labels=landed.labels,
        offset=landed.offset,
        renewed=renewed,
        fresh=fresh,
    )  # fmt: skip


def _renewed(
    source: PreparedView,
    reference: PreparedView,
    again: Again,
    before: Before,
    method: RegistrationMethod,
    noise: float,
    thresholds: Thresholds,
) -> ViewRegistration:
    """Return a registration of the previous frame with the changed pixels' landing points."""
    old = before.registration
    if not again.fitted.any():
        return replace(with_pixels_of(old, source), fresh=again.fresh)
    kept = Landed(
        labels=renumbered(old.patch_labels, again.kept), position=old.registered.position,
        offset=old.offset,
    )  # fmt: skip
    landed = land(source, reference, again.fit, noise, method, before=(kept, again.fresh))
    pixels = pixels_of(again.fresh, old.offset.shape)
    renewed = judged_again(pixels)
    return ViewRegistration(
        registered=registered_view(
            source, reference, landed.position, landed.offset, thresholds,
            before=(old.registered, pixels, renewed),
        ),
        motions=again.fit.fitted,
        parallax=again.fit.parallax,
        prior=again.fit.prior,
        patch_labels=landed.labels,
        offset=landed.offset,
        renewed=renewed,
        fresh=again.fresh,
    )  # fmt: skip
