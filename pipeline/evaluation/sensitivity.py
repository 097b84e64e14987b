"""Figures 17 and 18: what a wrong PSF costs, and how well the scene itself tells the right one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pipeline import drawing
from pipeline.debug_pictures import crops_picture
from pipeline.degradation import Degradation
from pipeline.evaluate import BORDER, settings_of
from pipeline.evaluation.elements import Chapter, Figure
from pipeline.evaluation.floors import (
    PSF_LOSS,
    PSF_OFF,
    PSF_SCENES,
    PsfEstimate,
    psf_floors,
    verdict_table,
)
from pipeline.evaluation.plots import lines, png
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import Table, number, signed
from pipeline.metrics import psnr
from pipeline.psf_search import search_psf
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.superresolve import RegisteredFrame, reconstruct_frame

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


def measure_estimate(
    subject: Subject, degradation: Degradation, registered: RegisteredFrame | None = None
) -> PsfEstimate:
    """Return what ``--psf auto`` finds, and how good the left eye is with it.

    The support is that of the degradation, and given. The views are registered here unless
    they are handed over registered.
    """
    degraded = subject.degraded(degradation)
    settings = settings_of(degradation, subject.settings)
    found = search_psf(degraded.frame, replace(settings, psf="auto", psf_sigma=None))[0]
    registered = registered or subject.registered(degradation)
    truth = degraded.truth[subject.eyes[0]]
    true_psnr, of_found = (
        psnr(_eight_bit(registered, sigma, degradation.psf_support), truth, border=BORDER)
        for sigma in (degradation.psf_sigma, found.sigma)
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


def _eight_bit(registered: RegisteredFrame, sigma: float, support: int) -> npt.NDArray[np.float32]:
    """Return the left eye as that PSF makes it; where views land does not depend on the PSF."""
    assumed = replace(registered, psf=GaussianPsf.of(sigma, support))
    (made,) = reconstruct_frame(assumed).images.values()
    return np.clip(np.rint(made.luma), 0, 255)


def measure_curve(
    subject: Subject,
    degradation: Degradation,
    *,
    note: Callable[[str], None] = lambda _: None,
    factors: Sequence[float] = FACTORS,
    supports: Sequence[int] = SUPPORTS,
) -> tuple[SigmaCurve, Figure]:
    """Return the curve of one scene and degradation, and crops along it."""
    truth = subject.degraded(degradation).truth[subject.eyes[0]]
    registered = subject.registered(degradation)
    pictures: dict[str, npt.NDArray] = {}

    def measured(sigma: float, support: int, name: str | None = None) -> float:
        eight_bit = _eight_bit(registered, sigma, support)
        if name is not None:
            pictures[name] = eight_bit
        return psnr(eight_bit, truth, border=BORDER)

    sigma, support = degradation.psf_sigma, degradation.psf_support
    values = []
    ends = {min(supports), max(supports)} - {support}
    for factor in factors:
        note(f"{subject.name}: true σ_psf {sigma:g}, assumed {factor * sigma:.2f}")
        shown = f"σ {factor * sigma:.2f}" if factor in _shown(factors) else None
        values.append(measured(factor * sigma, support, shown))
    of_supports = [
        measured(sigma, assumed, f"support {assumed}" if assumed in ends else None)
        for assumed in supports
    ]
    note(f"{subject.name}: true σ_psf {sigma:g}, estimated")
    curve = SigmaCurve(
        scene=subject.name,
        true_sigma=sigma,
        noise=degradation.noise_sigma,
        sigmas=tuple(factor * sigma for factor in factors),
        psnr=tuple(values),
        supports=tuple(supports),
        psnr_of_supports=tuple(of_supports),
        found=measure_estimate(subject, degradation, registered),
    )
    pictures["original"] = truth
    height, width = truth.shape
    crop = (height // 2 - 32, width // 2 - 40, 64, 80)
    figure = Figure(
        caption=f"{subject.name}, true σ_psf {sigma:g}, noise {degradation.noise_sigma:g}: one "
        f"crop with a σ assumed too small, right, and too large (Figure 17), and with the right σ "
        f"cut off elsewhere than at the true support of {support}.",
        content=png(drawing.framed(crops_picture(pictures, [crop], factor=2), 0)),
        kind="png",
        scene=subject.name,
    )
    return curve, figure


def _shown(factors: Sequence[float]) -> tuple[float, float, float]:
    return min(factors), min(factors, key=lambda factor: abs(factor - 1)), max(factors)


def chapter(
    curves: Sequence[SigmaCurve], crops: Sequence[Figure], of_one_view: str = ""
) -> Chapter:
    """Return Figures 17 and 18, and how well the PSF is estimated.

    ``of_one_view`` is what the search remarked when it was given one view alone.
    """
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
    judged = [curve.found for curve in curves if curve.scene in PSF_SCENES]
    figures = []
    for scene in dict.fromkeys(curve.scene for curve in curves):
        of_scene = [curve for curve in curves if curve.scene == scene]
        of_sigma = {_name(curve): (curve.sigmas, curve.psnr) for curve in of_scene}
        of_support = {_name(curve): (curve.supports, curve.psnr_of_supports) for curve in of_scene}
        figures.append(
            Figure(
                scene=scene,
                caption=f"{scene}: PSNR of the left eye over the σ that is assumed (Figure 18); "
                "broken lines mark the σ that --psf auto finds for the curve of their colour.",
                content=lines(
                    of_sigma,
                    x_label="assumed σ_psf, HR pixels",
                    y_label="PSNR, dB",
                    marks_of_curves=[curve.found.sigma for curve in of_scene],
                ),
            )
        )
        figures.append(
            Figure(
                scene=scene,
                caption=f"{scene}: the same over the support that is assumed, at the true σ.",
                content=lines(of_support, x_label="assumed support, HR pixels", y_label="PSNR, dB"),
            )
        )
    return Chapter(
        key="psf",
        title="The point spread function (Figures 17 and 18)",
        question="What does a wrong PSF cost, and can the scene tell the right one?",
        answer=answer,
        tables=[
            (
                "The bars of --psf auto, on " + ", ".join(dict.fromkeys(f.scene for f in judged)),
                verdict_table(psf_floors(judged, of_one_view) if judged else ()),
            ),
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
