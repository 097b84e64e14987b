"""Registering all views of a frame onto its reference views (thesis chapter 2): the order of it.

For each view and reference: patches (Eq. 1), their motions (Eq. 2), the landing point of
every pixel, registration weights (Eq. 3) and verification (Eq. 4). The first reference is
registered from scratch; the others start from what the first one taught: patches keep
their refined depth, and views reach a second reference through the first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.errors import SceneError
from pipeline.frames import Positions, RegisteredView, View
from pipeline.registration import kernels, motions
from pipeline.registration.layers import layer_labels, layer_thresholds
from pipeline.registration.method import (
    Initialisation,
    Layout,
    MotionModel,
    RegistrationMethod,
)
from pipeline.registration.motions import FITTED, FitPrior, FittedMotions, Pass
from pipeline.registration.parallax import (
    ParallaxMotion,
    fit_parallax,
    from_calibration,
    identity,
    match_points,
)
from pipeline.registration.patches import Patches, cut_windows, layer_strips
from pipeline.registration.prepare import PreparedView, prepare
from pipeline.registration.verification import registration_weights, verify
from pipeline.threads import map_threads

NUM_LEVELS = 5
"""Pyramid levels, the LR image included."""

MATCH_WIDTH = 110
"""Sparse matches are searched at the coarsest level at least this wide, pixels."""

SPACING, HALF = 13, 12
"""Distance of our windows' centres and half their side, LR pixels."""

MIN_SUPPORT = 40
"""Fewest LR pixels of a patch that is fitted (thesis: "required for stable registration")."""

PLANE_TOLERANCE = 0.7
"""A window is cut where its depth leaves a plane by more, as displacement in LR pixels."""

AGREEMENT = 0.2
"""Overlapping patches are blended where their motions differ by less, LR pixels."""

CHOICE_RADIUS = 2
"""Half side of the box over which the residual of a candidate motion is averaged, LR pixels."""

MISMATCH = 2.0
"""A candidate of other depth is worth a squared residual more for each such displacement², px."""

NO_CHOICE_COST = 2400.0
"""Mean squared residual above which no candidate is believed, grey levels²."""

LOOSE = FitPrior(along=2.0, across=0.5, linear=4.0, quadratic=16.0, offset_sigma=10.0)
"""Coarse fits: calibration or matches may be half a pixel off."""

FREE = FitPrior(along=1e3, across=1e3, linear=1.0, quadratic=1.0, offset_sigma=10.0)
"""The thesis' fits: nothing is held."""

STRIP_PASSES = tuple(Pass(level=level, iterations=8) for level in (4, 3, 2, 1, 0))

COARSE_PASSES = (Pass(level=1, iterations=4),)
FINE_PASSES = (Pass(level=0, iterations=3, stride=2), Pass(level=0, iterations=1))


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewRegistration:
    """One view registered onto one reference, with what later stages and pictures may ask."""

    registered: RegisteredView
    motions: FittedMotions | None
    """None for the reference view itself."""
    parallax: ParallaxMotion | None
    patch_labels: npt.NDArray[np.int32]
    """(H, W): number of the patch whose motion each pixel took, −1 where none."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """The limits of Eq. 4."""

    weight: float
    """T_w, grey levels."""
    depth: float
    """T_D, fraction of the scene's depth range."""


Changed = npt.NDArray[np.bool_]
"""(H, W): pixels of a view that are not what they were in the previous frame."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Previous:
    """What the previous frame leaves to the registration of the next."""

    prepared: Mapping[str, PreparedView]
    registrations: Mapping[str, Sequence[ViewRegistration]]
    turn: int
    """Frames since the chain began: says which windows are checked for drift now."""


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
    if previous is not None and method.layout is Layout.WINDOWS and method.refine:
        return _register_again(prepared, targets, sources, method, noise, thresholds, previous)
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
    before: tuple[ViewRegistration, Changed, Changed] | None = None,
) -> ViewRegistration:
    """Return one view registered onto one reference.

    Parameters
    ----------
    through : (source onto another reference, that reference onto this one), optional
        Where given, motions start from the composition of the two.
    before : (registration, changed in source, changed in reference), optional
        The same two views in the previous frame, and what has changed in each since then.
    """
    if source.view.view_id == reference.view.view_id:
        return _onto_itself(source)
    parallax: ParallaxMotion | None = None
    if method.layout is Layout.STRIPS:
        fitted, patch_labels, position, offset = _register_strips(source, reference, method, noise)
    else:
        again = (
            None if before is None else _refit_changed(source, reference, method, noise, *before)
        )
        fitted, parallax = again or _register_windows(source, reference, method, noise, through)
        patch_labels, position, offset = _land(source, reference, fitted, parallax, noise, method)
    weights = registration_weights(reference.raw_coefficients, position, source.view.luma, offset)
    depth_range = max(source.depth_range, reference.depth_range)
    says_depth = source.depth_range > 0 and reference.depth_range > 0
    flags = verify(
        position, weights, source.levels[0].nearness, source.known,
        reference.levels[0].nearness, reference.known,
        weight_threshold=thresholds.weight,
        depth_threshold=thresholds.depth * depth_range if says_depth else np.inf,
    )  # fmt: skip
    registered = RegisteredView(
        view_id=source.view.view_id,
        observed=source.view.luma - offset,
        position=position,
        registration_weights=weights,
        flags=flags,
        confidence=np.ones(flags.shape, np.float32),
    )
    return ViewRegistration(
        registered=registered, motions=fitted, parallax=parallax, patch_labels=patch_labels
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
    )


# --- ours: windows ---------------------------------------------------------------------------


def view_parallax(source: PreparedView, reference: PreparedView) -> ParallaxMotion:
    """Return the parallax motion of a view: from calibration, or from matches of the pictures."""
    here, there = source.view.calibration, reference.view.calibration
    if here is not None and there is not None and source.metric and reference.metric:
        return from_calibration(here, there)
    width = source.view.luma.shape[1]
    level = int(np.clip(np.log2(max(width, 1) / MATCH_WIDTH), 0, len(source.levels) - 1))
    coarse, onto = source.levels[level], reference.levels[level]
    points, landed = match_points(coarse.image, onto.image)
    return (
        fit_parallax(points * 2**level, landed * 2**level, _nearness_at(source, points * 2**level))
        or identity()
    )


def _nearness_at(view: PreparedView, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the nearness (M,) at points (M, 2), nearest pixel."""
    nearness = view.levels[0].nearness
    column = np.clip(np.rint(points[:, 0]).astype(int), 0, nearness.shape[1] - 1)
    row = np.clip(np.rint(points[:, 1]).astype(int), 0, nearness.shape[0] - 1)
    return nearness[row, column].astype(float)


def _pixels_per_nearness(source: PreparedView, parallax: ParallaxMotion) -> float:
    """Return how far one unit of nearness moves a point, LR pixels, median over the view."""
    nearness = source.levels[0].nearness
    height, width = nearness.shape
    derivative = parallax.parallax(width / 2, height / 2, nearness[::16, ::16])
    return float(np.median(np.linalg.norm(derivative, axis=-1)))


def _register_windows(
    source: PreparedView,
    reference: PreparedView,
    method: RegistrationMethod,
    noise: float,
    through: tuple[ViewRegistration, ViewRegistration] | None,
) -> tuple[FittedMotions, ParallaxMotion]:
    composed = None if through is None else _start_through(*through)
    if composed is not None:
        fitted, parallax, across = composed
    else:
        if method.initialisation is Initialisation.CALIBRATION:
            parallax = _calibrated(source, reference)
        else:
            parallax = view_parallax(source, reference)
        scale = _pixels_per_nearness(source, parallax)
        patches = cut_windows(
            source.levels[0].nearness,
            spacing=SPACING,
            half=HALF,
            tolerance=PLANE_TOLERANCE / scale
            if scale > 0 and source.depth_range > 0
            else float("inf"),
            min_support=MIN_SUPPORT,
        )
        start = motions.from_parallax(patches, parallax)
        if not method.refine:
            count = len(start)
            return FittedMotions(
                patches=patches, motion=start, status=np.full(count, FITTED, np.int32),
                scale=np.ones(count, np.float32), reliable=np.ones(count, np.float32),
            ), parallax  # fmt: skip
        fitted = motions.fit_motions(
            source, reference, patches, start, COARSE_PASSES, LOOSE,
            motions.parallax_directions(patches, parallax),
            model=method.model, noise=noise, min_support=MIN_SUPPORT,
        )  # fmt: skip
        fitted, parallax, across = _refit_parallax(source, fitted, parallax, scale)
    good = (fitted.status == FITTED) & (fitted.reliable > 0.5)
    offset = float(np.median(fitted.motion[good, motions.OFFSET])) if good.any() else 0.0
    start = fitted.motion.copy()
    start[:, motions.OFFSET] = np.clip(start[:, motions.OFFSET], offset - 4.0, offset + 4.0)
    prior = FitPrior(
        along=1.0, across=across, linear=50.0, quadratic=16.0, offset_mean=offset, offset_sigma=2.0
    )
    final = motions.fit_motions(
        source, reference, fitted.patches, start, FINE_PASSES, prior,
        motions.parallax_directions(fitted.patches, parallax),
        model=method.model, noise=noise, min_support=MIN_SUPPORT,
    )  # fmt: skip
    return final, parallax


def _calibrated(source: PreparedView, reference: PreparedView) -> ParallaxMotion:
    here, there = source.view.calibration, reference.view.calibration
    if here is None or there is None or not (source.metric and reference.metric):
        raise SceneError(
            "this registration method needs calibrated views with metric depth; "
            "choose another --registration",
            view=source.view.view_id,
        )
    return from_calibration(here, there)


SMALLEST_ACROSS, LARGEST_ACROSS = 0.02, 0.5
"""Bounds of the prior across the parallax, LR pixels."""

FEWEST_PATCHES = 30
"""Fitted patches below which the view's parallax motion is not refitted."""


def _refit_parallax(
    source: PreparedView, fitted: FittedMotions, parallax: ParallaxMotion, scale: float
) -> tuple[FittedMotions, ParallaxMotion, float]:
    """Return motions restarted from a parallax motion refitted to them, and its accuracy.

    The view's parallax motion is refitted to the landing points of the patches' centres,
    their depth being corrected along the parallax; what remains across it (median
    absolute deviation) tells how firmly the next fit may be held.
    """
    patches = fitted.patches
    x, y, _ = motions.centres(patches)
    points = np.stack([x, y], axis=-1)
    landed = points + fitted.motion[:, [0, 6]]
    good = (fitted.status == FITTED) & (fitted.reliable > 0.5)
    if good.sum() < FEWEST_PATCHES:
        return fitted, parallax, LARGEST_ACROSS
    nearness = patches.planes[:, 0].copy()
    moves = scale * source.depth_range > 1.0
    for _ in range(2):
        if moves:
            nearness = _along_parallax(points, landed, nearness, parallax)
        better = fit_parallax(
            points[good], landed[good], nearness[good], start=parallax, tolerance=3.0, rounds=6
        )
        if better is None:
            break
        parallax = better
    nearness = _along_parallax(points, landed, nearness, parallax)
    direction = motions.parallax_directions(patches, parallax)
    away = landed - parallax.land(x, y, nearness)
    across = -direction[:, 1] * away[:, 0] + direction[:, 0] * away[:, 1]
    spread = 1.4826 * float(np.median(np.abs(across[good])))
    nearness = np.where(fitted.status == FITTED, nearness, patches.planes[:, 0])
    planes = np.column_stack([nearness, patches.planes[:, 1:]])
    moved = replace(patches, planes=planes)
    start = motions.from_parallax(moved, parallax)
    start[:, motions.OFFSET] = fitted.motion[:, motions.OFFSET]
    return (
        replace(fitted, patches=moved, motion=start),
        parallax,
        float(np.clip(0.7 * spread, SMALLEST_ACROSS, LARGEST_ACROSS)),
    )


def _along_parallax(
    points: npt.NDArray, landed: npt.NDArray, nearness: npt.NDArray, parallax: ParallaxMotion
) -> npt.NDArray:
    """Return the nearness (M,) at which the parallax motion comes closest to ``landed``."""
    derivative = parallax.parallax(points[:, 0], points[:, 1], nearness)
    away = landed - parallax.land(points[:, 0], points[:, 1], nearness)
    length2 = np.maximum((derivative**2).sum(axis=1), 1e-12)
    return nearness + (away * derivative).sum(axis=1) / length2


def _start_through(
    first: ViewRegistration, bridge: ViewRegistration
) -> tuple[FittedMotions, ParallaxMotion, float] | None:
    """Return motions onto a second reference, composed of those onto the first and its own.

    None where the first reference taught too little (it is black, say): too few patches
    that were fitted and land where the bridge is trusted, or too few that agree.

    The landing points of the patches' centres in the first reference are looked up in
    the bridge's position map; the parallax motion is fitted to the pairs, and the
    patches start from it with the depth that the first registration refined.
    """
    fitted, onto_first = first.motions, first.parallax
    if fitted is None or onto_first is None:
        return None
    patches = fitted.patches
    x, y, _ = motions.centres(patches)
    points = np.stack([x, y], axis=-1)
    landed = points + fitted.motion[:, [0, 6]]
    nearness = _along_parallax(points, landed, patches.planes[:, 0], onto_first)
    nearness = np.where(fitted.status == FITTED, nearness, patches.planes[:, 0])
    moved = replace(patches, planes=np.column_stack([nearness, patches.planes[:, 1:]]))
    where = landed.astype(np.float32)[:, None, :]
    position = cv2.remap(
        np.nan_to_num(bridge.registered.position, nan=-1e4), where, None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=(-1e4, -1e4),
    )[:, 0]  # fmt: skip
    trusted = cv2.remap(
        (bridge.registered.flags == 0).astype(np.float32), where, None, cv2.INTER_NEAREST
    )[:, 0]
    good = (fitted.status == FITTED) & (fitted.reliable > 0.5) & (trusted > 0)
    good &= (position > -1e3).all(axis=1)
    parallax = fit_parallax(points[good], position[good].astype(float), nearness[good], rounds=6)
    if parallax is None or parallax.num_inliers < max(FEWEST_PATCHES, good.sum() // 2):
        return None
    start = motions.from_parallax(moved, parallax)
    start[:, motions.OFFSET] = 0.0
    return replace(fitted, patches=moved, motion=start), parallax, 0.1


def _land(
    source: PreparedView,
    reference: PreparedView,
    fitted: FittedMotions,
    parallax: ParallaxMotion,
    noise: float,
    method: RegistrationMethod,
) -> tuple[npt.NDArray[np.int32], Positions, npt.NDArray[np.float32]]:
    """Return the chosen patch, the landing point and the intensity term of every pixel."""
    fine, onto = source.levels[0], reference.levels[0]
    shape = fine.image.shape
    best = np.full(shape, -1, np.int32)
    cost = np.full(shape, NO_CHOICE_COST, np.float32)
    usable = np.isfinite(fitted.motion).all(axis=1)
    scale = _pixels_per_nearness(source, parallax)
    kernels.choose_patches(
        fine.image, onto.coefficients, fine.nearness, fitted.patches.windows,
        fitted.patches.ranges, fitted.motion, usable, CHOICE_RADIUS if method.refine else 0,
        (noise**2 + 1) * (scale / MISMATCH) ** 2 if method.refine else 1e30, best, cost,
    )  # fmt: skip
    position = np.empty((*shape, 2), np.float32)
    offset = np.empty(shape, np.float32)
    kernels.blend_patches(
        fitted.patches.windows, fitted.motion, usable, best, AGREEMENT, position, offset
    )
    return best, position, offset


# --- ours: from the previous frame -----------------------------------------------------------

CHANGE_BOX = 5
"""Side of the box over which the difference of two frames is judged, LR pixels."""

CHANGE = 1.5
"""Difference of the smoothed pictures beside the noise that counts as a change, grey levels."""

CHECK_EVERY = 16
"""Frames in which every window that seems to stand still is fitted anew once."""

DRIFTED = 0.3
"""Median displacement of the windows checked beyond which all is registered anew, LR pixels."""


def changed_pixels(now: PreparedView, before: PreparedView, noise: float) -> Changed:
    """Return which pixels have changed between two frames of a view, in picture or in depth."""
    fine, old = now.levels[0], before.levels[0]
    if fine.image.shape != old.image.shape:
        return np.ones(fine.image.shape, bool)
    box = (CHANGE_BOX, CHANGE_BOX)
    difference = fine.image - old.image
    local = cv2.blur(difference * difference, box, borderType=cv2.BORDER_REFLECT)
    # the smoothing before registration lets about a sixth of the noise's power through
    changed = local > 2 * 2.5 * noise**2 / 6 + CHANGE**2
    depth = np.abs(fine.nearness - old.nearness)
    changed |= cv2.blur(depth, box, borderType=cv2.BORDER_REFLECT) > 0.05 * now.depth_range
    return changed


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
    changed = dict(
        zip(
            names,
            map_threads(
                lambda name: changed_pixels(prepared[name], previous.prepared[name], noise), names
            ),
            strict=True,
        )
    )
    for name in names:
        changed[name] |= _due_for_a_check(changed[name].shape, previous.turn)
    old = {
        (target, registration.registered.view_id): registration
        for target in targets
        for registration in previous.registrations[target]
    }
    tasks = [(target, source) for target in targets for source in sources]

    def again(task: tuple[str, str]) -> ViewRegistration:
        target, source = task
        return register_view(
            prepared[source], prepared[target], method, noise=noise, thresholds=thresholds,
            before=(old[task], changed[source], changed[target]),
        )  # fmt: skip

    result: dict[str, list[ViewRegistration]] = {}
    for (target, _), registration in zip(tasks, map_threads(again, tasks), strict=True):
        result.setdefault(target, []).append(registration)
    return result


def _due_for_a_check(shape: tuple[int, ...], turn: int) -> Changed:
    """Return a few spots as if they had changed, others each frame: no drift stays unseen."""
    due = np.zeros(shape, bool)
    pitch = 4 * SPACING
    due[pitch * (turn % 4) // 4 :: pitch, pitch * (turn // 4 % 4) // 4 :: pitch] = True
    return due


def _refit_changed(
    source: PreparedView,
    reference: PreparedView,
    method: RegistrationMethod,
    noise: float,
    before: ViewRegistration,
    changed: Changed,
    reference_changed: Changed,
) -> tuple[FittedMotions, ParallaxMotion] | None:
    """Return the motions of the previous frame, fitted anew where something has changed.

    None where the rig itself seems to have moved: windows that look the same have drifted.
    """
    old, parallax = before.motions, before.parallax
    if old is None or parallax is None:
        return None
    good = (old.status == FITTED) & (old.reliable > 0.5)
    if good.sum() < FEWEST_PATCHES:
        return None
    scale = _pixels_per_nearness(source, parallax)
    cut = cut_windows(
        source.levels[0].nearness,
        spacing=SPACING,
        half=HALF,
        tolerance=PLANE_TOLERANCE / scale if scale > 0 and source.depth_range > 0 else float("inf"),
        min_support=MIN_SUPPORT,
    )
    shift = np.column_stack([old.motion[:, [0, 6]]] * 2).round().astype(np.int32)
    dirty = _any_inside(changed, old.patches.windows)
    dirty |= _any_inside(reference_changed, old.patches.windows + shift)
    keys = _window_keys(old.patches.windows)
    stale = np.unique(keys[dirty])
    keep = ~np.isin(keys, stale)
    fresh = ~np.isin(_window_keys(cut.windows), keys[keep])
    kept = _select_motions(old, keep)
    if not fresh.any():
        return kept, parallax
    patches = _select(cut, fresh)
    directions = motions.parallax_directions(patches, parallax)
    offset = float(np.median(old.motion[good, motions.OFFSET]))
    start = motions.from_parallax(patches, parallax)
    start[:, motions.OFFSET] = offset
    refitted = start
    for passes, along, linear in ((COARSE_PASSES, 2.0, 4.0), (FINE_PASSES, 1.0, 50.0)):
        prior = FitPrior(
            along=along, across=0.1, linear=linear, quadratic=16.0,
            offset_mean=offset, offset_sigma=2.0,
        )  # fmt: skip
        found = motions.fit_motions(
            source, reference, patches, refitted, passes, prior, directions,
            model=method.model, noise=noise, min_support=MIN_SUPPORT,
        )  # fmt: skip
        refitted = found.motion
    if _drifted(old, found):
        return None
    return _joined(kept, found), parallax


def _drifted(old: FittedMotions, found: FittedMotions) -> bool:
    """Return whether windows of one surface, fitted in both frames, moved for the most part."""
    before, keys = _window_keys(old.patches.windows), _window_keys(found.patches.windows)
    common, first, second = np.intersect1d(before, keys, return_indices=True)
    sure = (old.status[first] == FITTED) & (found.status[second] == FITTED)
    sure &= (old.reliable[first] > 0.5) & (found.reliable[second] > 0.5)
    if common.size < FEWEST_PATCHES or not sure.any():
        return False
    away = old.motion[first][:, [0, 6]] - found.motion[second][:, [0, 6]]
    return float(np.median(np.linalg.norm(away[sure], axis=1))) > DRIFTED


def _window_keys(windows: npt.NDArray[np.int32]) -> npt.NDArray[np.int64]:
    """Return a number (P,) for each window's place."""
    return (windows[:, 1].astype(np.int64) + windows[:, 3]) << 24 | (windows[:, 0] + windows[:, 2])


def _any_inside(
    mask: npt.NDArray[np.bool_], windows: npt.NDArray[np.int32]
) -> npt.NDArray[np.bool_]:
    """Return, for each window (x0, y0, x1, y1), whether the mask holds anywhere in it."""
    height, width = mask.shape
    counts = cv2.integral(mask.astype(np.uint8))
    x0, x1 = (np.clip(windows[:, side], 0, width) for side in (0, 2))
    y0, y1 = (np.clip(windows[:, side], 0, height) for side in (1, 3))
    return counts[y1, x1] - counts[y0, x1] - counts[y1, x0] + counts[y0, x0] > 0


def _select(patches: Patches, chosen: npt.NDArray) -> Patches:
    return Patches(
        windows=patches.windows[chosen], ranges=patches.ranges[chosen],
        planes=patches.planes[chosen], support=patches.support[chosen],
    )  # fmt: skip


def _select_motions(fitted: FittedMotions, chosen: npt.NDArray) -> FittedMotions:
    return FittedMotions(
        patches=_select(fitted.patches, chosen), motion=fitted.motion[chosen],
        status=fitted.status[chosen], scale=fitted.scale[chosen], reliable=fitted.reliable[chosen],
    )  # fmt: skip


def _joined(first: FittedMotions, second: FittedMotions) -> FittedMotions:
    """Return the patches of both, ordered by window as if they had been cut together."""

    def both(name: str, of: Callable = lambda item: item) -> npt.NDArray:
        return np.concatenate([getattr(of(first), name), getattr(of(second), name)])

    def cut(item: FittedMotions) -> Patches:
        return item.patches

    together = FittedMotions(
        patches=Patches(
            windows=both("windows", cut), ranges=both("ranges", cut),
            planes=both("planes", cut), support=both("support", cut),
        ),
        motion=both("motion"), status=both("status"), scale=both("scale"),
        reliable=both("reliable"),
    )  # fmt: skip
    order = np.lexsort((together.patches.ranges[:, 0], _window_keys(together.patches.windows)))
    return _select_motions(together, order)


# --- the thesis': layers and strips ----------------------------------------------------------


def _register_strips(
    source: PreparedView, reference: PreparedView, method: RegistrationMethod, noise: float
) -> tuple[FittedMotions, npt.NDArray[np.int32], Positions, npt.NDArray[np.float32]]:
    """Register by L layers × R strips: Table 1's methods."""
    nearness = source.levels[0].nearness
    thresholds = layer_thresholds(nearness, method.num_layers, min_support=MIN_SUPPORT)
    whole = layer_strips(nearness, thresholds, 1)
    patches = layer_strips(nearness, thresholds, method.num_subregions)
    parent = np.repeat(np.arange(len(whole.windows)), method.num_subregions)
    margin = 0.1 * source.depth_range if method.destination_support else None

    def fit(of: Patches, start: motions.Motions, passes: Sequence[Pass]) -> FittedMotions:
        return motions.fit_motions(
            source, reference, of, start, passes, FREE, motions.parallax_directions(of, None),
            model=method.model, noise=noise, min_support=MIN_SUPPORT, destination_margin=margin,
        )  # fmt: skip

    whole_start = motions.no_motion(whole)
    if method.initialisation is Initialisation.CALIBRATION:
        whole_start = motions.from_parallax(whole, _calibrated(source, reference))
        if method.model is MotionModel.TRANSLATION:
            whole_start[:, [1, 2, 7, 8]] = 0.0
    inherits = method.initialisation in (Initialisation.LAYER, Initialisation.CALIBRATION)
    layers = None
    if inherits or method.best_of_layer_and_patch:
        # a start that is nearly right must not be thrown away at the coarse levels
        near = method.initialisation is Initialisation.CALIBRATION
        layers = fit(whole, whole_start, STRIP_PASSES[-2:] if near else STRIP_PASSES)
    if inherits and layers is not None:
        start = motions.from_parents(patches, whole, layers.motion, parent)
        fitted = fit(patches, start, STRIP_PASSES[-2:])
    else:
        fitted = fit(patches, motions.no_motion(patches), STRIP_PASSES)
    edges = np.linspace(0, nearness.shape[1], method.num_subregions + 1).round()
    strip = np.searchsorted(edges[1:-1], np.arange(nearness.shape[1]), side="right")
    labels = layer_labels(nearness, thresholds) * method.num_subregions + strip[None, :]
    labels = labels.astype(np.int32)
    position, offset = _follow(fitted, labels)
    if method.best_of_layer_and_patch and layers is not None:
        parent_position, parent_offset = _follow(layers, parent[labels].astype(np.int32))
        luma, onto = source.view.luma, reference.raw_coefficients
        own = np.abs(registration_weights(onto, position, luma, offset))
        other = np.abs(registration_weights(onto, parent_position, luma, parent_offset))
        take = (other < own) | (np.isnan(own) & np.isfinite(other))
        position = np.where(take[..., None], parent_position, position)
        offset = np.where(take, parent_offset, offset)
    return fitted, labels, np.ascontiguousarray(position), np.ascontiguousarray(offset)


def _follow(
    fitted: FittedMotions, labels: npt.NDArray[np.int32]
) -> tuple[Positions, npt.NDArray[np.float32]]:
    """Return where each pixel lands by the motion of its patch; NaN where that was not fitted."""
    position = np.empty((*labels.shape, 2), np.float32)
    offset = np.empty(labels.shape, np.float32)
    kernels.follow_patches(
        fitted.patches.windows, fitted.motion, fitted.status == FITTED, labels, position, offset
    )
    return position, offset
