"""The default registration of a view: small overlapping windows, cut where depth jumps.

The view's parallax motion starts the windows; their robust fits correct it; what it then
explains is held more firmly in the next fit. Last, every pixel takes the motion of the window
that explains it best, blended with those that agree.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.errors import SceneError
from pipeline.frames import Mask, Positions
from pipeline.registration import choice_kernels, motions, parallax_kernels
from pipeline.registration.kernels import FITTED
from pipeline.registration.method import Initialisation, MotionModel, RegistrationMethod
from pipeline.registration.motions import FitPrior, FittedMotions, Pass
from pipeline.registration.parallax import (
    ParallaxMotion,
    fit_parallax,
    from_calibration,
    identity,
    match_points,
)
from pipeline.registration.patches import Windows, cut_windows
from pipeline.registration.prepare import PreparedView
from pipeline.registration.records import ViewRegistration
from pipeline.registration.window_fits import (
    Samples,
    fit_windows,
    take_samples,
    windows_of,
)
from pipeline.threads import map_threads, shares

MATCH_WIDTH = 110
"""Sparse matches are searched at the coarsest level at least this wide, pixels."""

SPACING, HALF = 13, 12
"""Side of the cells and half that of the windows around them, LR pixels."""

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

HELD = 1e9
"""Factor on the precision of linear terms that a model does not have."""

COARSE_PASSES = (Pass(level=1, iterations=4),)
MIDDLE_PASSES = (Pass(level=0, iterations=3, stride=2),)
LAST_PASSES = (Pass(level=0, iterations=3),)

SMALLEST_ACROSS, LARGEST_ACROSS = 0.01, 0.5
"""Bounds of the prior across the parallax, LR pixels."""

FEWEST_PATCHES = 30
"""Fitted patches below which the view's parallax motion is not refitted."""

LEAST_PARALLAX = 1.0
"""Displacement between the nearest and the farthest from which landing points tell depth, LR
pixels."""

OTHER_UNIT = 0.2
"""Share of the range of depth by which the depth map may differ from what motions tell, at its
middle and ends, before it counts as one in another unit."""

PATCHES_ASKED = 200
"""About so many windows are asked for that, where there are more."""

ACROSS_THROUGH = 0.1
"""The prior across the parallax where it was composed of two others, LR pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowFit:
    """The windows of a view fitted onto a reference."""

    fitted: FittedMotions
    parallax: ParallaxMotion
    prior: FitPrior
    samples: Samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Landed:
    """What pixels take from their windows."""

    labels: npt.NDArray[np.int32]
    """(H, W): the patch chosen, −1 where none."""
    position: Positions
    offset: npt.NDArray[np.float32]
    """(H, W): ζ, grey levels."""


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
    nearness = view.fine.nearness
    column = np.clip(np.rint(points[:, 0]).astype(int), 0, nearness.shape[1] - 1)
    row = np.clip(np.rint(points[:, 1]).astype(int), 0, nearness.shape[0] - 1)
    return nearness[row, column].astype(float)


def pixels_per_nearness(source: PreparedView, parallax: ParallaxMotion) -> float:
    """Return how far one unit of nearness moves a point, LR pixels, median over the view."""
    height, width = source.fine.nearness.shape
    # in front of the camera it grows with nearness or falls, so that its median is at the median
    return parallax.speed(width / 2, height / 2, source.middle_nearness)


def pixels_of(cells: Mask, shape: tuple[int, ...]) -> Mask:
    """Return the pixels of cells, (H, W)."""
    out = np.empty(shape, np.bool_)
    choice_kernels.spread(cells, SPACING, out)
    return out


def cut_view(source: PreparedView, parallax: ParallaxMotion, cells: Mask | None = None) -> Windows:
    """Return the windows of a view, or those of some cells of it, cut where its depth jumps."""
    scale = pixels_per_nearness(source, parallax)
    says_depth = scale > 0 and source.depth_range > 0
    return cut_windows(
        source.fine.nearness, spacing=SPACING, half=HALF,
        tolerance=PLANE_TOLERANCE / scale if says_depth else float("inf"),
        min_support=MIN_SUPPORT, wanted=cells,
    )  # fmt: skip


def register_windows(
    source: PreparedView,
    reference: PreparedView,
    method: RegistrationMethod,
    noise: float,
    through: tuple[ViewRegistration, ViewRegistration] | None,
    parallax: ParallaxMotion | None = None,
) -> WindowFit:
    """Return the windows of a view fitted onto a reference.

    Parameters
    ----------
    through : (source onto another reference, that reference onto this one), optional
        Where given, motions start from the composition of the two.
    parallax : ParallaxMotion, optional
        That of the previous frame.
    """
    model = method.model
    composed = None if through is None else _start_through(*through, model)
    if composed is not None:
        fitted, parallax = composed
        across = ACROSS_THROUGH
    else:
        if method.initialisation is Initialisation.CALIBRATION:
            parallax = calibrated_parallax(source, reference)
        elif parallax is None:
            parallax = view_parallax(source, reference)
        patches = cut_view(source, parallax)
        start = motions.from_parallax(patches, parallax, model)
        if not method.refine:
            return _unrefined(source, reference, patches, start, parallax)
        fitted, _ = fit_windows(
            source, reference, patches, start, COARSE_PASSES, _limited(LOOSE, model),
            motions.parallax_directions(patches, parallax), noise=noise, min_support=MIN_SUPPORT,
        )  # fmt: skip
        fitted, parallax, across = _refit_parallax(source, fitted, parallax, model)
    fitted, prior = _fitted_with(source, reference, fitted, parallax, across, noise, model)
    fitted, parallax, across = _refit_parallax(source, fitted, parallax, model)
    prior = replace(prior, across=across)
    final, samples = fit_windows(
        source, reference, windows_of(fitted), fitted.motion, LAST_PASSES, prior,
        motions.parallax_directions(fitted.patches, parallax), noise=noise,
        min_support=MIN_SUPPORT,
    )  # fmt: skip
    return WindowFit(fitted=final, parallax=parallax, prior=prior, samples=samples)


def _fitted_with(
    source: PreparedView, reference: PreparedView, fitted: FittedMotions,
    parallax: ParallaxMotion, across: float, noise: float, model: MotionModel,
) -> tuple[FittedMotions, FitPrior]:  # fmt: skip
    """Return motions fitted again with a prior that knows the view's intensity term."""
    good = well_fitted(fitted)
    offset = float(np.median(fitted.motion[good, motions.OFFSET])) if good.any() else 0.0
    start = fitted.motion.copy()
    start[:, motions.OFFSET] = np.clip(start[:, motions.OFFSET], offset - 4.0, offset + 4.0)
    prior = FitPrior(
        along=1.0, across=across, linear=50.0, quadratic=16.0, offset_mean=offset, offset_sigma=2.0
    )
    prior = _limited(prior, model)
    found, _ = fit_windows(
        source, reference, windows_of(fitted), start, MIDDLE_PASSES, prior,
        motions.parallax_directions(fitted.patches, parallax), noise=noise,
        min_support=MIN_SUPPORT,
    )  # fmt: skip
    return found, prior


def _limited(prior: FitPrior, model: MotionModel) -> FitPrior:
    """Return a prior that leaves a motion only the terms that its model has."""
    return replace(prior, linear=HELD) if model is MotionModel.TRANSLATION else prior


def _unrefined(
    source: PreparedView, reference: PreparedView, patches: Windows, start: motions.Motions,
    parallax: ParallaxMotion,
) -> WindowFit:  # fmt: skip
    """Return the start itself as the motions: calibration and depth alone."""
    count = len(start)
    return WindowFit(
        fitted=FittedMotions(
            patches=patches, motion=start, status=np.full(count, FITTED, np.int32),
            scale=np.ones(count, np.float32), reliable=np.ones(count, np.float32),
        ),
        parallax=parallax,
        prior=LOOSE,
        samples=take_samples(source, reference, patches, start),
    )  # fmt: skip


def calibrated_parallax(source: PreparedView, reference: PreparedView) -> ParallaxMotion:
    """Return the parallax motion that calibration gives.

    Raises
    ------
    SceneError
        If there is none.
    """
    here, there = source.view.calibration, reference.view.calibration
    if here is None or there is None or not (source.metric and reference.metric):
        raise SceneError(
            "this registration method needs calibrated views with metric depth; "
            "choose another --registration",
            view=source.view.view_id,
        )
    return from_calibration(here, there)


def _refit_parallax(
    source: PreparedView, fitted: FittedMotions, parallax: ParallaxMotion, model: MotionModel
) -> tuple[FittedMotions, ParallaxMotion, float]:
    """Return motions restarted from a parallax motion refitted to them, and its accuracy.

    The view's parallax motion is refitted to the landing points of the patches' centres,
    their depth being corrected along the parallax; what remains across it (median
    absolute deviation) tells how firmly the next fit may be held.
    """
    patches = fitted.patches
    scale = pixels_per_nearness(source, parallax)
    points, landed = motions.landed_centres(fitted)
    good = well_fitted(fitted)
    if good.sum() < FEWEST_PATCHES:
        return fitted, parallax, LARGEST_ACROSS
    nearness = patches.planes[:, 0].copy()
    moves = scale * source.depth_range > 1.0
    for _ in range(3):
        directions = None
        if moves:
            nearness = along_parallax(points, landed, nearness, parallax)
            directions = motions.parallax_directions(patches, parallax)[good]
        better = fit_parallax(
            points[good], landed[good], nearness[good], start=parallax, directions=directions,
            tolerance=3.0, rounds=4,
        )  # fmt: skip
        if better is None:
            break
        parallax = better
    nearness = along_parallax(points, landed, nearness, parallax)
    spread = spread_across(fitted, parallax, nearness)
    nearness = np.where(fitted.status == FITTED, nearness, patches.planes[:, 0])
    planes = np.column_stack([nearness, patches.planes[:, 1:]])
    moved = replace(patches, planes=planes)
    start = motions.from_parallax(moved, parallax, model)
    start[:, motions.OFFSET] = fitted.motion[:, motions.OFFSET]
    return (
        replace(fitted, patches=moved, motion=start),
        parallax,
        float(np.clip(spread, SMALLEST_ACROSS, LARGEST_ACROSS)),
    )


def spread_across(
    fitted: FittedMotions, parallax: ParallaxMotion, nearness: npt.NDArray[np.float64]
) -> float:
    """Return how far fitted patches land from where the parallax motion may send them.

    Across the parallax, in LR pixels: median absolute deviation, as a standard deviation.

    Parameters
    ----------
    nearness : (P,) float64
        Of the patches' centres.
    """
    points, landed = motions.landed_centres(fitted)
    direction = motions.parallax_directions(fitted.patches, parallax)
    across = np.empty(len(points))
    parallax_kernels.across_all(parallax.matrix, points, landed, nearness, direction, across)
    return 1.4826 * float(np.median(np.abs(across[well_fitted(fitted)])))


def well_fitted(fitted: FittedMotions) -> npt.NDArray[np.bool_]:
    """Return which patches were fitted, and from pixels that agree for the most part, (P,)."""
    return (fitted.status == FITTED) & (fitted.reliable > 0.5)


def along_parallax(
    points: npt.NDArray, landed: npt.NDArray, nearness: npt.NDArray, parallax: ParallaxMotion
) -> npt.NDArray:
    """Return the nearness (M,) at which the parallax motion comes closest to ``landed``."""
    found = np.empty(len(points))
    parallax_kernels.nearness_all(
        parallax.matrix, points, landed, np.ascontiguousarray(nearness, float), found
    )
    return found


def some_landed(
    before: ViewRegistration, fewest: int, asked: int
) -> tuple[npt.NDArray, npt.NDArray] | None:
    """Return centres of well fitted windows and where they land, x and y, (M, 2) each, LR pixels.

    None where there are fewer than ``fewest``; about ``asked`` of them where there are more.
    """
    fitted = before.motions
    if fitted is None:
        return None
    good = np.flatnonzero(well_fitted(fitted))
    if len(good) < fewest:
        return None
    some = good[:: max(1, len(good) // asked)]
    points, landed = motions.landed_centres(fitted)
    return points[some], landed[some]


def depth_fits(source: PreparedView, before: ViewRegistration) -> bool:
    """Return whether a view's depth map is in the unit of the frame before's parallax motion.

    Compared are the middle and the ends of what the depth map says at the centres of that frame's
    windows, and of what their motions tell. True where that frame tells nothing.
    """
    parallax = before.parallax
    if parallax is None or source.depth_range == 0:
        return True
    found = some_landed(before, FEWEST_PATCHES, PATCHES_ASKED)
    if found is None:
        return True
    points, landed = found
    said = _nearness_at(source, points)
    told = along_parallax(points, landed, said, parallax)
    ends = [np.percentile(nearness, (10, 50, 90)) for nearness in (said, told)]
    extent = max(np.ptp(end) for end in ends)
    moves = pixels_per_nearness(source, parallax) * extent
    return bool(moves < LEAST_PARALLAX or np.abs(ends[0] - ends[1]).max() < OTHER_UNIT * extent)


def _start_through(
    first: ViewRegistration, bridge: ViewRegistration, model: MotionModel
) -> tuple[FittedMotions, ParallaxMotion] | None:
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
    points, landed = motions.landed_centres(fitted)
    nearness = along_parallax(points, landed, patches.planes[:, 0], onto_first)
    nearness = np.where(fitted.status == FITTED, nearness, patches.planes[:, 0])
    moved = replace(patches, planes=np.column_stack([nearness, patches.planes[:, 1:]]))
    where = landed.astype(np.float32)[:, None, :]
    nowhere = (np.nan, np.nan)
    position = cv2.remap(
        bridge.registered.position, where, None, cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_CONSTANT, borderValue=nowhere,
    )[:, 0]  # fmt: skip
    flags = cv2.remap(bridge.registered.flags, where, None, cv2.INTER_NEAREST, borderValue=255)
    good = well_fitted(fitted) & (flags[:, 0] == 0) & np.isfinite(position).all(axis=1)
    parallax = fit_parallax(points[good], position[good].astype(float), nearness[good], rounds=6)
    if parallax is None or parallax.num_inliers < max(FEWEST_PATCHES, good.sum() // 2):
        return None
    start = motions.from_parallax(moved, parallax, model)
    start[:, motions.OFFSET] = 0.0
    return replace(fitted, patches=moved, motion=start), parallax


def land(
    source: PreparedView,
    reference: PreparedView,
    fit: WindowFit,
    noise: float,
    method: RegistrationMethod,
    *,
    before: tuple[Landed, Mask] | None = None,
) -> Landed:
    """Return the chosen patch, the landing point and the intensity term of every pixel.

    Parameters
    ----------
    before : (landed, cells to renew), optional
        Where only some patches have been fitted: what the others' pixels keep.
    """
    fine, onto, patches = source.fine, reference.fine, windows_of(fit.fitted)
    motion, samples = fit.fitted.motion, fit.samples
    candidates = np.asarray(np.isfinite(motion).all(axis=1))
    shape = fine.image.shape
    reach = patches.windows
    if before is None:
        renewed = np.ones(shape, bool)
        best = patches.owners.copy()
        position = np.empty((*shape, 2), np.float32)
        offset = np.empty(shape, np.float32)
    else:
        old, fresh = before
        reach = np.empty_like(patches.windows)
        choice_kernels.reach_of_windows(patches.windows, fresh, SPACING, reach)
        candidates &= (reach[:, 2] > reach[:, 0]) & (reach[:, 3] > reach[:, 1])
        renewed = pixels_of(fresh, shape)
        best = np.where(renewed, patches.owners, old.labels)
        position, offset = old.position.copy(), old.offset.copy()
    # unrefined motions are chosen by depth alone, and by pixel
    radius = CHOICE_RADIUS if method.refine else 0
    scale = pixels_per_nearness(source, fit.parallax)
    mismatch = (noise**2 + 1) * (scale / MISMATCH) ** 2 if method.refine else 1e30
    energy = np.minimum(samples.residual * samples.residual, choice_kernels.LARGEST_ENERGY)
    box = (2 * radius + 1, 2 * radius + 1)
    cost = cv2.blur(energy, box, borderType=cv2.BORDER_REFLECT)
    if before is not None:
        sampled = cv2.blur(renewed.astype(np.float32), box, borderType=cv2.BORDER_REFLECT)
        cost /= np.maximum(sampled, np.float32(1e-3))

    def choose(some: tuple[Mask, npt.NDArray[np.int32], npt.NDArray[np.float32]]) -> None:
        of, chosen, least = some
        choice_kernels.choose_windows(
            fine.image, onto.coefficients, fine.nearness, patches.windows, reach, patches.ranges,
            motion, of, renewed, AGREEMENT, radius, mismatch, *samples.planes, chosen, least,
        )  # fmt: skip

    first, *rest = _parts(candidates)
    others = [(part, best.copy(), cost.copy()) for part in rest]
    map_threads(choose, [(first, best, cost), *others])
    for _, chosen, least in others:  # of equals the window before, as where all are one part
        is_better = least < cost
        np.copyto(best, chosen, where=is_better)
        np.copyto(cost, least, where=is_better)
    best[renewed & (cost > NO_CHOICE_COST)] = -1

    def blend(rows: slice) -> None:
        choice_kernels.blend_windows(
            patches.windows, reach, motion, candidates, patches.owners, best, renewed,
            samples.move_u, samples.move_v, AGREEMENT, rows.start, rows.stop, position, offset,
        )  # fmt: skip

    map_threads(blend, shares(shape[0]))
    return Landed(labels=best, position=position, offset=offset)


def _parts(candidates: Mask) -> list[Mask]:
    """Return the candidates in one part for each thread, in their order."""
    numbers, parts = np.flatnonzero(candidates), []
    for share in shares(numbers.size):
        part = np.zeros_like(candidates)
        part[numbers[share]] = True
        parts.append(part)
    return parts
