"""How good on the rendered scene, where everything is known: motion, visibility, the HR picture.

The input is what a real rig would give: noise 1, depth as a stereo matcher delivers it, and
either no calibration or the true one. Both eyes are reconstructed and measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.baselines import bicubic
from pipeline.config import Settings
from pipeline.evaluation.floors import RenderedCase, views_method
from pipeline.evaluation.methods import middle_views
from pipeline.evaluation.tables import Table, number, signed
from pipeline.frames import GreyImage, MultiViewFrame, RegisteredView, Rejection
from pipeline.metrics import psnr
from pipeline.reconstruction.fused import finished, fuse
from pipeline.results import FrameResult
from pipeline.superresolve import (
    chosen_filters,
    default_residual_threshold,
    given_psf,
    superresolve,
)
from pipeline.synthetic import SampleScene, SampleTruth

NOISE = 1.0
"""Grey levels."""

PSF_SIGMA, PSF_SUPPORT = 1.0, 7
"""HR pixels."""

BORDER = 24
"""HR pixels left out when measuring."""

WRONG = 0.5
"""End-point error from which a pixel is wrong, LR pixels."""

EYES = ("left", "right")


@dataclass(frozen=True, kw_only=True)
class Case:
    """One kind of input."""

    max_disparity: float | None = None
    """Largest displacement from the left eye, LR pixels; None: the scene's own."""
    rotation_degrees: float = 1.5
    calibration: bool = False
    width: int = 512
    """LR pixels."""
    height: int = 384
    """LR pixels."""
    num_views: int = 8

    def scene(self) -> SampleScene:
        """Return the scene; the same one for the cases with and without calibration."""
        return SampleScene(
            width=self.width, height=self.height, num_views=self.num_views,
            max_disparity=self.max_disparity, rotation_degrees=self.rotation_degrees,
        )  # fmt: skip

    @property
    def counts(self) -> tuple[int, ...]:
        """1, 2, 4 … all views."""
        doubled = [2**power for power in range(8) if 2**power < self.num_views]
        return (*doubled, self.num_views)

    @property
    def name(self) -> str:
        """What tells this case from the others."""
        disparity = "" if self.max_disparity is None else f"disparity {self.max_disparity:g}, "
        known = "with" if self.calibration else "no"
        return f"{disparity}rotation {self.rotation_degrees:g}°, {known} calibration"


CASES = tuple(
    Case(max_disparity=disparity, rotation_degrees=rotation, calibration=calibration)
    for disparity, rotation in ((None, 1.5), (80.0, 2.0))
    for calibration in (False, True)
)


@dataclass(frozen=True, kw_only=True)
class Errors:
    """End-point errors of some views, pooled; LR pixels and shares 0..1."""

    registered: float
    """Share of truly visible pixels that have a motion."""
    verified: float
    """Share of truly visible pixels that are trusted in the end."""
    median_visible: float
    """Of truly visible pixels that have a motion."""
    median_verified: float
    error_95: float
    """95th percentile of verified pixels."""
    wrong: float
    """Share of verified pixels that are more than half a pixel off."""
    hidden: float
    """Share of verified pixels that are not visible in the reference view."""


@dataclass(frozen=True, kw_only=True)
class _Pixels:
    """One view on one eye: what was estimated and what is true, flat."""

    view_id: str
    eye: str
    error: npt.NDArray[np.float64]
    """NaN where there is no motion."""
    visible: npt.NDArray[np.bool_]
    verified: npt.NDArray[np.bool_]


def pooled_errors(
    error: npt.NDArray[np.float64],
    visible: npt.NDArray[np.bool_],
    verified: npt.NDArray[np.bool_],
) -> Errors:
    """Return the figures of pixels: end-point error (NaN: no motion), true visibility, verdict."""
    has_motion = np.isfinite(error)
    seen, trusted = error[visible & has_motion], error[verified & has_motion]

    def share(of: npt.NDArray[np.bool_], among: npt.NDArray[np.bool_]) -> float:
        return float(of[among].mean()) if among.any() else float("nan")

    def middle(values: npt.NDArray[np.float64], percentile: float = 50) -> float:
        return float(np.percentile(values, percentile)) if values.size else float("nan")

    return Errors(
        registered=share(has_motion, visible),
        verified=share(verified, visible),
        median_visible=middle(seen),
        median_verified=middle(trusted),
        error_95=middle(trusted, 95),
        wrong=float((trusted > WRONG).mean()) if trusted.size else float("nan"),
        hidden=share(~visible, verified),
    )


@dataclass(frozen=True, kw_only=True)
class CaseResult:
    """What was measured of one case."""

    case: Case
    largest_disparity: float
    """True, horizontal, of visible pixels; LR pixels."""
    errors: Errors
    """Of all views but the eye itself, both eyes."""
    by_view: Mapping[str, Mapping[str, Errors]]
    """By eye, then view."""
    psnr: Mapping[str, Mapping[str, float]]
    """dB, by method, then eye."""

    @property
    def judged(self) -> RenderedCase:
        """What the floors ask for."""
        return RenderedCase(
            name=self.case.name,
            psnr=self.psnr,
            median_error=self.errors.median_visible,
            error_95=self.errors.error_95,
            wrong_share=self.errors.wrong,
        )


def measure_case(
    case: Case,
    scene: SampleScene,
    settings: Settings,
    note: Callable[[str], None] = lambda _: None,
) -> CaseResult:
    """Measure one case.

    Parameters
    ----------
    scene : SampleScene
        That of the case; handed over so that it is rendered once.
    settings : Settings
        Only grid and PSF are set here.
    """
    settings = replace(
        settings, magnification=str(scene.magnification), sampling="decimation",
        psf_sigma=PSF_SIGMA, psf_support=PSF_SUPPORT,
    )  # fmt: skip
    note(f"rendered scene, {case.name}: rendering")
    frame = scene.frame(
        0, psf_sigma=PSF_SIGMA, psf_support=PSF_SUPPORT, noise_sigma=NOISE, depth="stereo",
        calibration=case.calibration,
    )  # fmt: skip
    truth = scene.truth(0)
    eyes = dict(zip(EYES, (frame.left, frame.right), strict=True))
    values: dict[str, dict[str, float]] = {}

    def score(method: str, eye: str, image: GreyImage) -> None:
        picture = truth.hr_luma[scene.view_ids.index(eyes[eye])]
        border = min(BORDER, min(picture.shape) // 4)
        eight_bit = np.clip(np.rint(image), 0, 255)
        values.setdefault(method, {})[eye] = psnr(eight_bit, picture, border=border)

    for eye, view_id in eyes.items():
        score("bicubic", eye, bicubic(frame.view(view_id).luma, settings.grid))
        note(f"rendered scene, {case.name}: {eye} eye alone")
        alone = superresolve(frame, settings, targets=(view_id,), observed_views=(view_id,))
        score(views_method(1), eye, alone.images[view_id].luma)
    for count in case.counts[1:]:
        note(f"rendered scene, {case.name}: {count} views")
        chosen = tuple(view.view_id for view in middle_views(frame, count).views)
        result = superresolve(
            frame, settings, targets=tuple(eyes.values()), observed_views=chosen,
            keep_intermediates=count == len(frame.views),
        )  # fmt: skip
        for eye, view_id in eyes.items():
            score(views_method(count), eye, result.images[view_id].luma)
    note(f"rendered scene, {case.name}: true motion")
    for eye, view_id in eyes.items():
        known = true_registration(frame, truth, view_id)
        score("true motion", eye, _fused(frame, known, settings, result.report.noise_sigma))
    pixels = _compared(result, truth, eyes)
    return CaseResult(
        case=case,
        largest_disparity=_largest_disparity(truth),
        errors=_pooled(pixels),
        by_view={
            eye: {item.view_id: _pooled([item]) for item in pixels if item.eye == eye}
            for eye in EYES
        },
        psnr=values,
    )


def true_registration(
    frame: MultiViewFrame, truth: SampleTruth, reference: str
) -> list[RegisteredView]:
    """Return every view registered by its true motion and verified by its true visibility."""
    view_ids = truth.scene.view_ids
    registered = []
    for view_index, view in enumerate(frame.views):
        motion = truth.motion(view_index, view_ids.index(reference), psf_support=PSF_SUPPORT)
        shape = view.luma.shape
        own = view.view_id == reference
        flags = np.where(motion.visible, 0, int(Rejection.OCCLUDED)).astype(np.uint8)
        registered.append(
            RegisteredView(
                view_id=view.view_id,
                observed=view.luma,
                position=motion.position.astype(np.float32),
                registration_weights=np.zeros(shape, np.float32),
                flags=np.zeros(shape, np.uint8) if own else flags,
                confidence=np.ones(shape, np.float32),
                is_reference=own,
            )
        )
    return registered


def _fused(
    frame: MultiViewFrame, registered: Sequence[RegisteredView], settings: Settings, noise: float
) -> GreyImage:
    """Return what the default solver makes of registered views, as ``superresolve`` calls it."""
    psf = given_psf(settings)
    learned = chosen_filters(settings, psf, noise)
    result = fuse(
        registered, settings.grid, frame.lr_shape, psf, noise=noise,
        residual_threshold=default_residual_threshold(noise), learned=learned,
    )  # fmt: skip
    return finished(result, learned)


def _compared(result: FrameResult, truth: SampleTruth, eyes: Mapping[str, str]) -> list[_Pixels]:
    """Return what every view but the eye itself was found to do, beside what is true."""
    view_ids = truth.scene.view_ids
    compared = []
    for eye, reference in eyes.items():
        for view in result.debug[reference].registered:
            if view.is_reference:
                continue
            motion = truth.motion(view_ids.index(view.view_id), view_ids.index(reference))
            difference = view.position - motion.position
            compared.append(
                _Pixels(
                    view_id=view.view_id,
                    eye=eye,
                    error=np.hypot(difference[..., 0], difference[..., 1]).ravel(),
                    visible=motion.visible.ravel(),
                    verified=view.verification_map.ravel(),
                )
            )
    return compared


def _pooled(pixels: Sequence[_Pixels]) -> Errors:
    return pooled_errors(
        np.concatenate([item.error for item in pixels]),
        np.concatenate([item.visible for item in pixels]),
        np.concatenate([item.verified for item in pixels]),
    )


def _largest_disparity(truth: SampleTruth) -> float:
    """Return the largest horizontal displacement from any view to the left eye, LR pixels."""
    left = truth.scene.reference_views[0]
    largest = 0.0
    for view_index in range(truth.scene.num_views):
        motion = truth.motion(view_index, left)
        along_x = np.abs(motion.displacement[..., 0])[motion.visible]
        largest = max(largest, float(along_x.max(initial=0.0)))
    return largest


# --- tables ----------------------------------------------------------------------------------


def error_table(results: Sequence[CaseResult]) -> Table:
    """Return the end-point errors of all cases."""
    return Table(
        head=(
            "case", "largest disparity", "visible registered %", "visible verified %",
            "median, visible", "median, verified", "95 %, verified", "verified wrong %",
            "verified hidden %",
        ),
        rows=tuple(
            (
                result.case.name,
                number(result.largest_disparity, 0),
                *_cells(result.errors),
            )
            for result in results
        ),
    )  # fmt: skip


def view_table(result: CaseResult) -> Table:
    """Return the end-point errors of one case, view by view."""
    return Table(
        head=(
            "view", "onto", "visible registered %", "visible verified %", "median, visible",
            "median, verified", "95 %, verified", "verified wrong %", "verified hidden %",
        ),
        rows=tuple(
            (view_id, eye, *_cells(errors))
            for eye, views in result.by_view.items()
            for view_id, errors in views.items()
        ),
        left=("onto",),
    )  # fmt: skip


def _cells(errors: Errors) -> tuple[str, ...]:
    return (
        number(100 * errors.registered, 1),
        number(100 * errors.verified, 1),
        number(errors.median_visible, 4),
        number(errors.median_verified, 4),
        number(errors.error_95, 3),
        number(100 * errors.wrong, 2),
        number(100 * errors.hidden, 2),
    )


def gain_table(results: Sequence[CaseResult]) -> Table:
    """Return PSNR by the number of views, the gains over one, and the loss to true motion, dB."""
    counts = results[0].case.counts
    names = [views_method(count) for count in counts]
    rows = []
    for result in results:
        for eye in EYES:
            value = {method: eyes[eye] for method, eyes in result.psnr.items()}
            rows.append(
                (
                    result.case.name,
                    eye,
                    number(value["bicubic"]),
                    *(number(value[name]) for name in names),
                    number(value["true motion"]),
                    *(signed(value[name] - value[names[0]]) for name in names[1:]),
                    number(value["true motion"] - value[names[-1]]),
                )
            )
    gains = tuple(f"gain {count}" for count in counts[1:])
    return Table(
        head=("case", "eye", "bicubic", *names, "true motion", *gains, "loss"),
        rows=tuple(rows),
        left=("eye",),
    )


def case_from_json(record: Mapping[str, Any]) -> CaseResult:
    """Return what was measured before, from its plain form."""

    def errors(fields: Mapping[str, Any]) -> Errors:
        return Errors(
            **{key: float("nan") if value is None else value for key, value in fields.items()}
        )

    return CaseResult(
        case=Case(**record["case"]),
        largest_disparity=record["largest_disparity"],
        errors=errors(record["errors"]),
        by_view={
            eye: {view_id: errors(fields) for view_id, fields in views.items()}
            for eye, views in record["by_view"].items()
        },
        psnr=record["psnr"],
    )
