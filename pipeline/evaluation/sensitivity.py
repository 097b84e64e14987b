"""Figures 17 and 18: what a wrong PSF costs, and how well the scene itself tells the right one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pipeline import drawing
from pipeline.config import Settings
from pipeline.debug_pictures import crops_picture
from pipeline.degradation import Degradation, DegradedFrame
from pipeline.evaluate import BORDER, settings_of
from pipeline.evaluation.elements import Chapter, Figure
from pipeline.evaluation.floors import PSF_LOSS, PSF_OFF, PsfEstimate
from pipeline.evaluation.plots import lines, png
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import Table, number, signed
from pipeline.metrics import psnr
from pipeline.psf_search import search_psf
from pipeline.superresolve import superresolve

FACTORS = (0.5, 0.7, 0.85, 1.0, 1.15, 1.35, 1.6)
"""Assumed σ over the true one."""

SUPPORTS = (3, 5, 7, 9, 11)
"""Assumed supports, HR pixels; the true one is among them."""


@dataclass(frozen=True, kw_only=True)
class SigmaCurve:
    """PSNR over the σ that is assumed, at one true σ and one noise, the left eye."""

    scene: str
    true_sigma: float
    noise: float
    sigmas: tuple[float, ...]
    """Assumed, HR pixels."""
    psnr: tuple[float, ...]
    """dB."""
    supports: tuple[int, ...]
    psnr_of_supports: tuple[float, ...]
    """At the true σ, dB."""
    found: PsfEstimate
    """What the scene itself tells."""


def measure_estimate(subject: Subject, degradation: Degradation) -> PsfEstimate:
    """Return what ``--psf auto`` finds, and how good the left eye is with it.

    The support is that of the degradation, and given.
    """
    degraded = subject.degraded(degradation)
    base = settings_of(degradation, subject.settings)
    found = search_psf(degraded.frame, replace(base, psf="auto", psf_sigma=None))[0]
    left = subject.eyes[0]
    true_psnr, of_found = (
        psnr(_eight_bit(degraded, settings, left), degraded.truth[left], border=BORDER)
        for settings in (base, replace(base, psf_sigma=found.sigma))
    )
    return PsfEstimate(
        scene=subject.name, true_sigma=degradation.psf_sigma, noise=degradation.noise_sigma,
        sigma=found.sigma, true_psnr=true_psnr, psnr=of_found, remark=found.remark,
    )  # fmt: skip


def remark_of_one_view(subject: Subject, degradation: Degradation) -> str:
    """Return what the search for the PSF says of the left view alone."""
    frame = subject.degraded(degradation).frame
    alone = replace(frame, views=(frame.view(subject.eyes[0]),))
    settings = replace(settings_of(degradation, subject.settings), psf="auto", psf_sigma=None)
    return search_psf(alone, settings)[0].remark


def _eight_bit(degraded: DegradedFrame, settings: Settings, eye: str) -> npt.NDArray[np.float32]:
    result = superresolve(degraded.frame, settings, targets=(eye,))
    return np.clip(np.rint(result.images[eye].luma), 0, 255)


def measure_curve(
    subject: Subject,
    degradation: Degradation,
    *,
    note: Callable[[str], None] = lambda _: None,
    factors: Sequence[float] = FACTORS,
    supports: Sequence[int] = SUPPORTS,
) -> tuple[SigmaCurve, Figure]:
    """Return the curve of one scene and degradation, and crops along it."""
    degraded = subject.degraded(degradation)
    base = settings_of(degradation, subject.settings)
    left = subject.eyes[0]
    truth = degraded.truth[left]
    pictures: dict[str, npt.NDArray] = {}

    def measured(settings: Settings, name: str | None = None) -> float:
        eight_bit = _eight_bit(degraded, settings, left)
        if name is not None:
            pictures[name] = eight_bit
        return psnr(eight_bit, truth, border=BORDER)

    sigma = degradation.psf_sigma
    values = []
    for factor in factors:
        note(f"{subject.name}: true σ_psf {sigma:g}, assumed {factor * sigma:.2f}")
        shown = f"assumed σ {factor * sigma:.2f}" if factor in _shown(factors) else None
        values.append(measured(replace(base, psf_sigma=factor * sigma), shown))
    of_supports = [measured(replace(base, psf_support=support)) for support in supports]
    note(f"{subject.name}: true σ_psf {sigma:g}, estimated")
    curve = SigmaCurve(
        scene=subject.name,
        true_sigma=sigma,
        noise=degradation.noise_sigma,
        sigmas=tuple(factor * sigma for factor in factors),
        psnr=tuple(values),
        supports=tuple(supports),
        psnr_of_supports=tuple(of_supports),
        found=measure_estimate(subject, degradation),
    )
    pictures["original"] = truth
    height, width = truth.shape
    crop = (height // 2 - 32, width // 2 - 40, 64, 80)
    figure = Figure(
        caption=f"{subject.name}, true σ_psf {sigma:g}, noise {degradation.noise_sigma:g}: one "
        "crop with a PSF assumed too narrow, right, and too wide (Figure 17).",
        content=png(drawing.framed(crops_picture(pictures, [crop], factor=3), 0)),
        kind="png",
    )
    return curve, figure


def _shown(factors: Sequence[float]) -> tuple[float, float, float]:
    return min(factors), min(factors, key=lambda factor: abs(factor - 1)), max(factors)


def chapter(curves: Sequence[SigmaCurve], crops: Sequence[Figure]) -> Chapter:
    """Return Figures 17 and 18, and how well the PSF is estimated."""
    met = [curve for curve in curves if curve.found.met]
    answer = [
        f"The PSF that the scene tells lies within {PSF_OFF:g} HR pixels of the true σ and "
        f"within {PSF_LOSS:g} dB of the result with it in {len(met)} of {len(curves)} cases."
    ]
    for found in (curve.found for curve in curves):
        if not found.met:
            answer.append(
                f"Not so on {found.scene} (true σ {found.true_sigma:g}, noise {found.noise:g}): "
                f"found {found.sigma:.2f}, {found.loss:.2f} dB lost."
                + (f" {found.remark}." if found.remark else "")
            )
    figures = [
        Figure(
            caption=f"{scene}: PSNR of the left eye over the σ that is assumed (Figure 18); "
            "broken lines mark the σ that --psf auto finds for the curve of their colour.",
            content=lines(
                {_name(curve): (curve.sigmas, curve.psnr) for curve in curves
                 if curve.scene == scene},
                x_label="assumed σ_psf, HR pixels", y_label="PSNR, dB",
                marks_of_curves=[curve.found.sigma for curve in curves if curve.scene == scene],
            ),
        )
        for scene in dict.fromkeys(curve.scene for curve in curves)
    ]  # fmt: skip
    return Chapter(
        key="psf",
        title="The point spread function (Figures 17 and 18)",
        question="What does a wrong PSF cost, and can the scene tell the right one?",
        answer=answer,
        tables=[
            ("PSF found by the scene itself", _estimate_table([curve.found for curve in curves])),
            ("PSNR over the support that is assumed, true σ, dB", _support_table(curves)),
        ],
        figures=[*figures, *crops],
        data={"curves": list(curves)},
    )


def _name(curve: SigmaCurve) -> str:
    return f"true σ {curve.true_sigma:g}, noise {curve.noise:g}"


def _estimate_table(estimates: Sequence[PsfEstimate]) -> Table:
    return Table(
        head=("scene", "true σ", "noise", "found σ", "off by", "PSNR, true σ", "PSNR, found σ",
              "loss dB", ""),
        rows=tuple(
            (
                found.scene, f"{found.true_sigma:g}", f"{found.noise:g}", number(found.sigma),
                signed(found.off), number(found.true_psnr), number(found.psnr),
                number(found.loss), "met" if found.met else "not met",
            )
            for found in estimates
        ),
        left=("",),
    )  # fmt: skip


def _support_table(curves: Sequence[SigmaCurve]) -> Table:
    supports = curves[0].supports if curves else ()
    return Table(
        head=("scene", "true σ", "noise", *(str(support) for support in supports)),
        rows=tuple(
            (
                curve.scene, f"{curve.true_sigma:g}", f"{curve.noise:g}",
                *(number(value) for value in curve.psnr_of_supports),
            )
            for curve in curves
        ),
    )  # fmt: skip
