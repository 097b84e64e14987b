"""What can be checked without a truth (Set 2), and the views that no camera took.

A view is left out. What is made of the others is asked to predict it: each of its pixels,
by the place where registration finds it in the left eye. A picture that is only sharper
predicts no better; one that is right does. Pixels that are clipped at black or white are not
asked: how bright they were the camera did not say.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from pipeline import drawing
from pipeline.baselines import bicubic
from pipeline.config import Settings
from pipeline.debug_pictures import choose_crops, crops_picture
from pipeline.degradation import Degradation
from pipeline.evaluate import BORDER, settings_of
from pipeline.evaluation.elements import Chapter, Figure
from pipeline.evaluation.plots import png
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import NOT_MEASURED, Table, number, signed
from pipeline.frames import (
    Calibration,
    GreyImage,
    Mask,
    MultiViewFrame,
    RegisteredView,
    Rejection,
)
from pipeline.freeview import IntermediateView, between
from pipeline.metrics import psnr
from pipeline.noise import estimate_noise_of_views
from pipeline.psf_search import search_psf
from pipeline.reconstruction.psf import GaussianPsf, sampling_taps
from pipeline.reconstruction.system import simulate
from pipeline.registration.parallax import match_points
from pipeline.registration.register import prepare_views, register_views
from pipeline.superresolve import superresolve, terms_of
from pipeline.view_at import neighbour_of

GEOMETRY = np.uint8(Rejection.NO_MOTION | Rejection.OUTSIDE | Rejection.OCCLUDED | Rejection.DEPTH)
"""Reasons that keep a pixel out of the comparison. Its registration weight is none: it compares
with the left eye interpolated, so that choosing by it would favour interpolation."""

LARGEST_ERROR = 20.0
"""Prediction errors are cut off here, grey levels: what is larger is a wrong correspondence,
the same for every method."""

CLIPPED = (0.5, 254.5)
"""Grey levels beyond which a pixel says only that it was darker or brighter."""

CLIPPED_REACH = 2
"""LR pixels around a clipped one that a PSF mixes with it."""

MATCH_WIDTH = 200
"""Matches for the pose are searched in pictures of about this width, pixels."""

FEWEST_MATCHES = 8
"""Matches below which the pose is left alone."""


@dataclass(frozen=True, kw_only=True)
class Prediction:
    """How well a view that was left out is predicted, over the same pixels for all."""

    scene: str
    left_out: str
    num_views: int
    """Views that were used."""
    psf_sigma: float
    """HR pixels; found by the scene, or assumed."""
    psf_remark: str
    pixels: float
    """Share of the left-out view that could be compared, 0..1."""
    bicubic: float
    """PSNR of the prediction from the left eye enlarged, dB."""
    single_view: float
    """The same from the left eye super-resolved alone, dB."""
    default: float
    """The same from all views but the one left out, dB."""


@dataclass(frozen=True, kw_only=True)
class FreeView:
    """How close a view that was left out is met by one rendered between its neighbours."""

    scene: str
    left_out: str
    left: str
    right: str
    at: float
    """Place between the neighbours, 0..1."""
    seen: float
    """Share of pixels that a neighbour sees."""
    of_bicubic: float
    """PSNR where the neighbours are enlarged by bicubic interpolation, dB."""
    of_default: float
    """PSNR where the neighbours are super-resolved, dB."""


def measure_prediction(
    subject: Subject, *, note: Callable[[str], None] = lambda _: None
) -> tuple[Prediction, Figure]:
    """Return how the scene's own pixels are predicted, and crops (thesis Figure 16)."""
    frame = _as_filmed(subject)
    left = subject.eyes[0]
    gone = _nearest_other(frame)
    rest = tuple(view.view_id for view in frame.views if view.view_id != gone)
    settings = replace(subject.settings, magnification="2", sampling="area")
    note(f"{subject.name}: the PSF it was filmed with")
    curve = search_psf(frame, replace(settings, psf="auto"))[0]
    psf = GaussianPsf.of(curve.sigma, None)
    note(f"{subject.name}: without {gone}")
    kept = replace(frame, views=tuple(view for view in frame.views if view.view_id in rest))
    if frame.right not in rest:
        kept = replace(kept, right=left)
    told = replace(settings, psf_sigma=curve.sigma)
    fused = superresolve(kept, told, targets=(left,)).images[left].luma
    alone = superresolve(kept, told, targets=(left,), observed_views=(left,)).images[left].luma
    plain = bicubic(frame.view(left).luma, settings.grid)
    view = _registered(frame, gone, left)
    pictures = {"bicubic": plain, "one view": alone}
    if len(rest) > 1:
        pictures[f"{len(rest)} views"] = fused
    lr_pictures = (frame.view(gone).luma, frame.view(left).luma)
    values, share = _predicted(view, lr_pictures, (alone, fused), settings, psf)
    crops = choose_crops(plain, fused)
    figure = Figure(
        caption=f"{subject.name} as it was filmed, enlarged twice (Figure 16): no truth exists.",
        content=png(drawing.framed(crops_picture(pictures, crops), 0)),
        kind="png",
        scene=subject.name,
    )
    prediction = Prediction(
        scene=subject.name, left_out=gone, num_views=len(rest), psf_sigma=curve.sigma,
        psf_remark=curve.remark, pixels=share,
        bicubic=values[0], single_view=values[1], default=values[2],
    )  # fmt: skip
    return prediction, figure


def _as_filmed(subject: Subject) -> MultiViewFrame:
    """Return the scene's own pictures; those of the rendered scene have noise."""
    if subject.sample is not None:
        from pipeline.grid import Sampling

        return subject.sample.frame(
            0, psf_sigma=1.0, noise_sigma=1.0, depth="stereo", sampling=Sampling.AREA
        )
    assert subject.frame is not None
    return subject.frame


def _nearest_other(frame: MultiViewFrame) -> str:
    """Return the view nearest to the left eye that is no eye; the right eye of two views."""
    names = [view.view_id for view in frame.views]
    left = names.index(frame.left)
    others = [name for name in names if name not in (frame.left, frame.right)]
    return min(others, key=lambda name: abs(names.index(name) - left)) if others else frame.right


def _registered(frame: MultiViewFrame, source: str, reference: str) -> RegisteredView:
    noise = estimate_noise_of_views(frame.views)
    prepared = prepare_views(
        [frame.view(source), frame.view(reference)], metric=frame.depth_is_metric
    )
    found = register_views(prepared, [reference], [source], terms_of(Settings(), noise))
    return found[reference][0].registered


def _unclipped(image: GreyImage) -> Mask:
    """Return the pixels with none in the reach of a PSF that is clipped at black or white."""
    clipped = (image < CLIPPED[0]) | (image > CLIPPED[1])
    side = 2 * CLIPPED_REACH + 1
    return cv2.dilate(clipped.astype(np.uint8), np.ones((side, side), np.uint8)) == 0


def _predicted(
    view: RegisteredView,
    lr_pictures: tuple[GreyImage, GreyImage],
    hr_pictures: Sequence[GreyImage],
    settings: Settings,
    psf: GaussianPsf,
) -> tuple[tuple[float, ...], float]:
    """Return PSNR of the predictions, bicubic's first, and the share of pixels compared.

    Parameters
    ----------
    view : RegisteredView
        The left-out view onto the left eye.
    lr_pictures : (left-out view, left eye)
        As they were filmed.
    hr_pictures : sequence of (K·H, K·W)
        What was made of the left eye.
    """
    lr_gone, lr_left = lr_pictures
    grid = settings.grid
    x, y = (np.ascontiguousarray(axis) for axis in grid.to_hr(view.position))
    place = np.nan_to_num(view.position, nan=-9.0)
    made = [
        cv2.remap(np.asarray(lr_left), place[..., 0], place[..., 1], cv2.INTER_CUBIC,
                  borderMode=cv2.BORDER_REPLICATE),
        *(simulate(np.asarray(picture), sampling_taps(psf, grid), x, y) for picture in hr_pictures),
    ]  # fmt: skip
    landed = cv2.remap(
        _unclipped(lr_left).astype(np.uint8), place[..., 0], place[..., 1], cv2.INTER_NEAREST,
        borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    use = ((view.flags & GEOMETRY) == 0) & _unclipped(lr_gone) & (landed > 0)
    use &= np.logical_and.reduce([np.isfinite(item) for item in made])
    if not use.any():
        return tuple(math.nan for _ in made), 0.0
    values = []
    for item in made:
        apart = item[use].astype(float) - view.observed[use]
        error = float(np.mean(np.minimum(np.abs(apart), LARGEST_ERROR) ** 2))
        values.append(10 * math.log10(255**2 / max(error, 1e-12)))
    return tuple(values), float(use.mean())


def measure_free_view(
    subject: Subject, *, note: Callable[[str], None] = lambda _: None
) -> tuple[FreeView, Figure] | None:
    """Return how well a camera is replaced by its neighbours, and crops.

    None with fewer than three views.

    Set 1 at σ_psf 1 and noise 1: the HR picture of the view that is left out is the truth.
    """
    names = subject.view_ids
    if len(names) < 3:
        return None
    degradation = Degradation(psf_sigma=1.0, noise_sigma=1.0)
    degraded = subject.degraded(degradation)
    settings = settings_of(degradation, subject.settings)
    middle = min(max(1, names.index(subject.eyes[0])), len(names) - 2)
    left, gone, right = names[middle - 1 : middle + 2]
    note(f"{subject.name}: {gone} from {left} and {right}")
    frame = replace(
        degraded.frame, left=left, right=right,
        views=tuple(view for view in degraded.frame.views if view.view_id != gone),
    )  # fmt: skip
    at = _place_between(subject, left, gone, right)
    result = superresolve(frame, settings, targets=(left, right), keep_intermediates=True)
    truth = degraded.truth[gone]
    onto = {
        (view.view_id, target): view
        for target, debug in result.debug.items()
        for view in debug.registered
    }
    values = {}
    shown: dict[str, npt.NDArray] = {}
    seen = 0.0
    for method in ("bicubic", "default"):
        pictures = {
            name: bicubic(frame.view(name).luma, settings.grid)
            if method == "bicubic"
            else np.asarray(result.images[name].luma)
            for name in (left, right)
        }
        neighbours = [
            neighbour_of(frame, here, pictures[here], None, onto[(here, there)], settings.grid)
            for here, there in ((left, right), (right, left))
        ]
        made = between(neighbours[0], neighbours[1], at)
        if method == "bicubic":
            pose = _pose(made.luma, truth)
        shown[method] = _moved(made, truth, pose)
        values[method] = _psnr_from_pose(shown[method], truth, pose)
        seen = float(made.seen.mean())
    crops = choose_crops(shown["bicubic"], shown["default"])
    named = {"of bicubic": shown["bicubic"], "of super-resolution": shown["default"]}
    figure = Figure(
        caption=f"{subject.name}: the view of {gone}, rendered from {left} and {right}, beside "
        "what the camera there saw.",
        content=png(drawing.framed(crops_picture({**named, "camera": truth}, crops), 0)),
        kind="png",
        scene=subject.name,
    )
    free_view = FreeView(
        scene=subject.name, left_out=gone, left=left, right=right, at=at, seen=seen,
        of_bicubic=values["bicubic"], of_default=values["default"],
    )  # fmt: skip
    return free_view, figure


def _pose(made: GreyImage, truth: npt.NDArray[np.uint8]) -> npt.NDArray[np.float64]:
    """Return the homography (3, 3) from the real camera's picture to the rendered one.

    A camera between two others is not where a straight line puts it: it is turned a little,
    and a turn is a homography. It is found from matches, once, and serves every method.
    """
    factor = max(1, round(truth.shape[1] / MATCH_WIDTH))
    small = [
        cv2.resize(
            np.asarray(picture, np.float32), None, fx=1 / factor, fy=1 / factor,
            interpolation=cv2.INTER_AREA,
        )
        for picture in (truth, made)
    ]  # fmt: skip
    points, landed = match_points(small[0], small[1])
    if len(points) < FEWEST_MATCHES:
        return np.eye(3)
    coarse, _ = cv2.findHomography(points * factor, landed * factor, cv2.RANSAC, 1.5 * factor)
    if coarse is None:
        return np.eye(3)
    try:
        _, fine = cv2.findTransformECC(
            truth,
            np.clip(made, 0, 255).astype(np.uint8),
            coarse.astype(np.float32),
            cv2.MOTION_HOMOGRAPHY,
            (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-6),
        )
    except cv2.error:  # it did not converge: the matches must do
        return np.asarray(coarse)
    return np.asarray(fine, float)


def _moved(
    made: IntermediateView, truth: npt.NDArray[np.uint8], pose: npt.NDArray[np.float64]
) -> npt.NDArray[np.uint8]:
    """Return the rendered view seen from the real camera."""
    height, width = truth.shape
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    moved = cv2.warpPerspective(np.asarray(made.luma), pose, (width, height), flags=flags)
    return np.clip(np.rint(moved), 0, 255).astype(np.uint8)


def _psnr_from_pose(
    moved: npt.NDArray[np.uint8], truth: npt.NDArray[np.uint8], pose: npt.NDArray[np.float64]
) -> float:
    """Return PSNR of a rendered view, seen from the real camera, where both show something."""
    height, width = truth.shape
    inside = cv2.warpPerspective(
        np.full((height, width), 255, np.uint8), pose, (width, height),
        flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
    )  # fmt: skip
    inside[:BORDER], inside[-BORDER:], inside[:, :BORDER], inside[:, -BORDER:] = 0, 0, 0, 0
    use = cv2.erode(inside, np.ones((2 * BORDER + 1,) * 2, np.uint8)) > 0
    if not use.any():
        return math.nan
    return psnr(moved[use][None], truth[use][None])


def _place_between(subject: Subject, left: str, gone: str, right: str) -> float:
    """Return where the view lies between its neighbours: by calibration, else by registration."""
    cameras: list[Calibration | None] = []
    if subject.sample is not None:
        cameras = [
            subject.sample_truth.calibration[subject.view_ids.index(name)]
            for name in (left, gone, right)
        ]
    elif subject.frame is not None:
        cameras = [subject.frame.view(name).calibration for name in (left, gone, right)]
    centres = [camera.centre for camera in cameras if camera is not None]
    if len(centres) == 3:
        first, middle, last = centres
        line = last - first
        return float(np.clip((middle - first) @ line / (line @ line), 0, 1))
    frame = subject.degraded(Degradation(psf_sigma=1.0)).frame
    moved = [
        np.nanmedian(_registered(frame, left, name).position[..., 0]
                     - np.arange(frame.lr_shape[1]))
        for name in (gone, right)
    ]  # fmt: skip
    return float(np.clip(moved[0] / moved[1], 0, 1)) if moved[1] else 0.5


def chapter(
    predictions: Sequence[Prediction], free_views: Sequence[FreeView], crops: Sequence[Figure]
) -> Chapter:
    """Return Set 2 and the free view."""
    answer = []
    gains = [item.default - item.bicubic for item in predictions if math.isfinite(item.default)]
    if len(gains) > 1:
        won = sum(gain > 0 for gain in gains)
        answer.append(
            f"The left-out view is predicted better than by bicubic interpolation on {won} of "
            f"{len(gains)} scenes, by {signed(sum(gains) / len(gains))} dB in the mean."
        )
    answer += [
        f"{item.scene}: the left-out view {item.left_out} is predicted at {item.default:.2f} dB by "
        + ("one view" if item.num_views == 1 else f"{item.num_views} views")
        + f" super-resolved: {signed(item.default - item.bicubic)} dB against bicubic "
        f"interpolation, {signed(item.default - item.single_view)} dB against one view alone."
        for item in predictions
        if math.isfinite(item.default)
    ]
    answer += [
        f"{item.scene}: a view rendered in the place of {item.left_out} comes to "
        f"{item.of_default:.2f} dB, {signed(item.of_default - item.of_bicubic)} dB over one "
        "rendered from enlarged neighbours."
        for item in free_views
    ]
    return Chapter(
        key="left-out",
        title="Without a truth (Figure 16), and views that no camera took",
        question="Does the result explain a picture that it has not seen?",
        answer=answer,
        tables=[
            (
                "The scene as filmed, K = 2: PSNR of the left-out view predicted, dB, "
                "away from clipped pixels",
                Table(
                    head=("scene", "left out", "views used", "σ_psf", "compared %", "bicubic",
                          "one view", "all others"),
                    rows=tuple(
                        (
                            item.scene, item.left_out, str(item.num_views),
                            number(item.psf_sigma), number(100 * item.pixels, 1),
                            number(item.bicubic), number(item.single_view), number(item.default),
                        )
                        for item in predictions
                    ),
                    left=("left out",),
                ),
            ),
            (
                "Free view: PSNR against the camera that was left out, σ_psf 1, noise 1, dB",
                Table(
                    head=("scene", "left out", "between", "at", "seen %", "of bicubic",
                          "of super-resolution"),
                    rows=tuple(
                        (
                            item.scene, item.left_out, f"{item.left}, {item.right}",
                            number(item.at), number(100 * item.seen, 1),
                            number(item.of_bicubic), number(item.of_default),
                        )
                        for item in free_views
                    )
                    or (("–",) + (NOT_MEASURED,) * 6,),
                    left=("left out", "between"),
                ),
            ),
        ],
        figures=crops,
        data={"predictions": list(predictions), "free_views": list(free_views)},
    )  # fmt: skip
