"""What is said of a frame: of each view and target, and what its user should know."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.config import Settings, Solver
from pipeline.effort import Effort
from pipeline.frames import GreyImage, MultiViewFrame, RegisteredView
from pipeline.reconstruction.fused import some_rows
from pipeline.reconstruction.median import median_magnitude
from pipeline.registration.method import Layout, RegistrationMethod
from pipeline.registration.verification import count_rejections
from pipeline.results import StartChoice, TargetReport, ViewReport

SEES_NOTHING = 0.02
"""Trusted share of a view below which it is said to see nothing."""

NOTHING_NEW = 5.0
"""Phase coverage gained, per cent, below which views are said to bring nothing new."""


def view_report(
    view: RegisteredView,
    flags: npt.NDArray[np.uint8],
    weight: GreyImage,
    misfit: float,
) -> ViewReport:
    """Return what is said of a view seen from a target."""
    rejections = count_rejections(flags)
    return ViewReport(
        view_id=view.view_id,
        registered_fraction=1 - rejections["no_motion"] / flags.size,
        verified_fraction=1 - np.count_nonzero(flags) / flags.size,
        weight_fraction=cv2.mean(weight)[0],
        rejections=rejections,
        median_absolute_weight=median_magnitude(some_rows(view.registration_weights)),
        residual_rms=misfit,
    )


def report_restored(
    target: str, settings: Settings, effort: Effort, warm_share: float
) -> TargetReport:
    """Return the report of a target for which nothing was registered.

    Parameters
    ----------
    warm_share : float
        Of the target, what stays as it was.
    """
    own = 100.0 / (settings.grid.magnification_x * settings.grid.magnification_y)
    return TargetReport(
        view_id=target,
        views=(),
        phase_coverage=own,
        phase_coverage_reference=own,
        remark="No other view was looked at."
        if effort.refresh_every is None
        else "No view was registered: what changes lands by its depth."
        if effort.by_depth
        else "No view was registered: motions are those of an earlier frame.",
        solver=settings.solver,
        iterations=0,
        stop_reason="alone" if effort.alone else "kept",
        residuals=(),
        start=StartChoice(warm_share=warm_share, is_cut=False),
    )


def remark_of(
    reports: Sequence[ViewReport], registered: Sequence[RegisteredView], gained: float
) -> str:
    """Return a plain sentence about what the other views bring; empty where all is well."""
    others = [
        report for report, view in zip(reports, registered, strict=True) if not view.is_reference
    ]
    if not others:
        return "Only the reference view itself was used."
    blind = [report.view_id for report in others if report.verified_fraction < SEES_NOTHING]
    sentences = []
    if len(blind) == len(others):
        return "No other view sees what this one sees: the result is that of one view."
    if blind:
        sentences.append(f"Nothing of {', '.join(blind)} could be verified.")
    if gained < NOTHING_NEW:
        sentences.append(
            "The other views bring hardly any new sub-pixel positions: they average noise, "
            "but add no detail."
        )
    return " ".join(sentences)


def unused_settings(settings: Settings, method: RegistrationMethod) -> tuple[str, ...]:
    """Return what was asked for and has no effect beside the other settings."""
    is_cut = settings.layers is not None or settings.subregions is not None
    is_fused = settings.solver == Solver.FUSED
    said = {
        f"--layers and --subregions have no effect on --registration {settings.registration}, "
        "which cuts windows; they shape the methods a to l":
            is_cut and method.layout is not Layout.STRIPS,
        "--sweeps has no effect on --solver fused": is_fused and settings.sweeps != Settings.sweeps,
        f"--residual-bound has no effect on --solver {settings.solver}":
            settings.residual_bound is not None and settings.solver != Solver.POCS,
        "--psf-per-layer has no effect without --psf auto":
            settings.psf_per_layer and settings.psf != "auto",
        "--rate has no effect without --realtime":
            settings.rate is not None and not settings.realtime,
    }  # fmt: skip
    return tuple(text for text, is_so in said.items() if is_so)


def warnings_of(frame: MultiViewFrame, sources: Sequence[str]) -> tuple[str, ...]:
    """Return what the user should know of this frame's input."""
    warnings = []
    for view_id in sources:
        view = frame.view(view_id)
        depth = None if view.depth_map is None else _two_values(view.depth_map)
        if view.depth_map is None:
            warnings.append(f"view {view_id} has no depth: it is taken as one layer")
        elif depth is None:
            warnings.append(f"view {view_id}: all of its depth is unknown; taken as one layer")
        elif depth[0] == depth[1]:
            warnings.append(f"view {view_id}: its depth is constant, one layer")
        luma = _two_values(view.luma)
        if luma is not None and luma[0] == luma[1]:
            warnings.append(f"view {view_id} is one flat tone: it brings nothing")
    return tuple(warnings)


def _two_values(image: GreyImage) -> tuple[float, float] | None:
    """Return known values of an image, unequal ones if it has any; None where none is known."""
    found = None
    # nearly always, a few of its pixels tell
    for some in (image[::16, ::16], image):
        known = some[np.isfinite(some)]
        if known.size:
            found = float(known.min()), float(known.max())
            if found[0] < found[1]:
                break
    return found
