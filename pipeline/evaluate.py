"""Set 1: how far super-resolution comes on a real scene, against everything simpler.

METHOD §4. The truth is a real view; the input is what :mod:`pipeline.degradation`
makes of all views. Every method sees the same grey LR frame and the PSF that was
used; nothing else is told, nothing is tuned to the scene. The two baselines that
matter are *bicubic* and *single-view*, the same solver given the reference view
alone: the second separates what the other views bring from what deblurring brings.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from pipeline.baselines import BASELINES
from pipeline.config import Settings
from pipeline.degradation import Degradation, DegradedFrame, degrade_frame
from pipeline.errors import ConfigurationError
from pipeline.frames import MultiViewFrame
from pipeline.media.depth_estimation import estimate_missing_depth
from pipeline.metrics import SSIM_WINDOW, psnr, ssim
from pipeline.results import FrameReport
from pipeline.superresolve import superresolve

BORDER = 24
"""HR pixels left out at each border when measuring."""

SINGLE_VIEW = "single-view"
SOLVER_METHODS = ("pocs", "pocs-simplified")
DEFAULT = "default"

METHODS = ("bicubic", "lanczos", SINGLE_VIEW, *SOLVER_METHODS, DEFAULT)
"""The methods of a Set 1 run, in the order of its table."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """One method on one view."""

    view_id: str
    method: str
    psnr: float
    """dB; infinite where identical."""
    ssim: float
    """−1..1."""
    seconds: float
    """Wall-clock time of the whole method."""
    gain_over_bicubic: float = math.nan
    """dB; NaN where bicubic was not run."""
    gain_over_single_view: float = math.nan
    """dB; NaN where single-view was not run."""


@dataclass(frozen=True, kw_only=True)
class Set1Result:
    """All methods on all views asked for."""

    scene: str
    frame_index: int
    magnification: str
    psf_sigma: float
    psf_support: int
    noise: float
    seed: int
    border: int
    """HR pixels."""
    hr_shape: tuple[int, int]
    """(height, width) of the truth."""
    scores: tuple[Score, ...]
    reports: tuple[tuple[str, str, FrameReport], ...] = ()
    """(view id, method, report) of the methods that are super-resolution."""

    def score(self, view_id: str, method: str) -> Score:
        """Return the score of that view and method; KeyError where it was not run."""
        for score in self.scores:
            if (score.view_id, score.method) == (view_id, method):
                return score
        raise KeyError((view_id, method))

    def as_json(self) -> dict[str, Any]:
        """Return everything as a record for JSON."""
        table = dict(vars(self))
        table["reports"] = [
            {"view_id": view_id, "method": method, "report": report}
            for view_id, method, report in self.reports
        ]
        return table


def evaluate_set1(
    frame: MultiViewFrame,
    degradation: Degradation,
    *,
    scene: str = "",
    views: Sequence[str] | None = None,
    methods: Sequence[str] = METHODS,
    settings: Settings | None = None,
    border: int = BORDER,
    neighbours: Sequence[MultiViewFrame] = (),
    on_method: Callable[[str, str], None] = lambda view_id, method: None,
    superresolve: Callable[..., Any] = superresolve,
) -> Set1Result:
    """Degrade the frame, run every method, and compare with the truth.

    Parameters
    ----------
    frame : MultiViewFrame
        The HR frame.
    degradation : Degradation
        Grid, PSF and noise.
    scene : str
        Name for the table.
    views : sequence of str, optional
        Reference views to reconstruct, one after another; default: the left.
    methods : sequence of str
        Out of :data:`METHODS` and :data:`pipeline.baselines.BASELINES`.
    settings : Settings, optional
        Settings other than grid and PSF (which the degradation fixes).
    border : int
        HR pixels cut at each border before measuring.
    neighbours : sequence of MultiViewFrame
        HR frames before and after, degraded likewise; the default method is given them.
    on_method : callable
        Called with view id and method before each is run.
    superresolve : callable
        The super-resolution; another one in tests.

    Raises
    ------
    ConfigurationError
        If a method or view is unknown, or the image too small for the border.
    """
    targets = tuple(views) if views else (frame.left,)
    known = [view.view_id for view in frame.views]
    for view_id in targets:
        if view_id not in known:
            raise ConfigurationError(
                f"--view: {view_id!r} is not a view of the scene ({', '.join(known)})"
            )
    for method in methods:
        if method not in METHODS and method not in BASELINES:
            choices = ", ".join(dict.fromkeys((*METHODS, *BASELINES)))
            raise ConfigurationError(f"--methods: {method!r} is not one of {choices}")
    degraded = degraded_input(frame, degradation)
    grid = degradation.grid
    hr_shape = grid.hr_shape(degraded.frame.lr_shape)
    if min(hr_shape) - 2 * border < SSIM_WINDOW:
        raise ConfigurationError(
            f"the scene is {hr_shape[1]}×{hr_shape[0]}: too small to leave out a border of "
            f"{border} HR pixels and measure"
        )
    base = settings_of(degradation, settings or Settings())
    around = tuple(degraded_input(other, degradation).frame for other in neighbours)
    scores: list[Score] = []
    reports: list[tuple[str, str, FrameReport]] = []
    for view_id in targets:
        truth = degraded.truth[view_id]
        of_view: list[Score] = []
        for method in methods:
            on_method(view_id, method)
            begin = time.perf_counter()
            image, report = run_method(
                method, degraded, base, view_id, neighbours=around, superresolve=superresolve
            )
            seconds = time.perf_counter() - begin
            eight_bit = np.clip(np.rint(image), 0, 255)
            of_view.append(
                Score(
                    view_id=view_id,
                    method=method,
                    psnr=psnr(eight_bit, truth, border=border),
                    ssim=ssim(eight_bit, truth, border=border),
                    seconds=seconds,
                )
            )
            if report is not None:
                reports.append((view_id, method, report))
        scores += [
            replace(
                score,
                gain_over_bicubic=_gain(score, of_view, "bicubic"),
                gain_over_single_view=_gain(score, of_view, SINGLE_VIEW),
            )
            for score in of_view
        ]
    return Set1Result(
        scene=scene,
        frame_index=frame.frame_index,
        magnification=base.magnification,
        psf_sigma=degradation.psf_sigma,
        psf_support=degradation.psf_support,
        noise=degradation.noise_sigma,
        seed=degradation.seed,
        border=border,
        hr_shape=hr_shape,
        scores=tuple(scores),
        reports=tuple(reports),
    )


def format_table(result: Set1Result) -> str:
    """Return the scores as an aligned table of text."""
    head = ("view", "method", "PSNR dB", "SSIM", "over bicubic", "over single-view", "seconds")
    rows = [
        (
            score.view_id,
            score.method,
            f"{score.psnr:.2f}",
            f"{score.ssim:.4f}",
            _signed(score.gain_over_bicubic),
            _signed(score.gain_over_single_view),
            f"{score.seconds:.2f}",
        )
        for score in result.scores
    ]
    widths = [max(len(row[column]) for row in (head, *rows)) for column in range(len(head))]
    lines = [
        f"Set 1: {result.scene or 'scene'}, frame {result.frame_index}, K = "
        f"{result.magnification}, σ_psf {result.psf_sigma:g}, support {result.psf_support}, "
        f"noise {result.noise:g}, seed {result.seed}, "
        f"{result.hr_shape[1]}×{result.hr_shape[0]}, border {result.border}"
    ]
    for row in (head, *rows):
        cells = [
            cell.ljust(width) if column < 2 else cell.rjust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def format_frames(results: Sequence[Set1Result]) -> str:
    """Return the PSNR of several frames as an aligned table of text, and their mean."""
    keys = [(score.view_id, score.method) for score in results[0].scores]
    head = ("PSNR dB", *(f"{view_id} {method}" for view_id, method in keys))
    columns = [[result.score(*key).psnr for result in results] for key in keys]
    rows = [
        (f"frame {result.frame_index}", *(f"{column[place]:.3f}" for column in columns))
        for place, result in enumerate(results)
    ]
    rows.append(("mean", *(f"{sum(column) / len(column):.3f}" for column in columns)))
    widths = [max(len(row[place]) for row in (head, *rows)) for place in range(len(head))]
    return "\n".join(
        "  ".join(cell.rjust(width) for cell, width in zip(row, widths, strict=True))
        for row in (head, *rows)
    )


def degraded_input(frame: MultiViewFrame, degradation: Degradation) -> DegradedFrame:
    """Return the LR frame of Set 1 and its truth; missing depth is estimated from the LR views."""
    degraded = degrade_frame(frame, degradation)
    if all(view.depth_map is not None for view in degraded.frame.views):
        return degraded
    lr_views = estimate_missing_depth(
        list(degraded.frame.views), depth_is_metric=frame.depth_is_metric
    )
    return replace(degraded, frame=replace(degraded.frame, views=tuple(lr_views)))


def settings_of(degradation: Degradation, settings: Settings) -> Settings:
    """Return the settings with the grid and the PSF of the degradation."""
    return replace(
        settings,
        magnification=_magnification(degradation),
        sampling="decimation",
        psf="given",
        psf_sigma=degradation.psf_sigma,
        psf_support=degradation.psf_support,
    )


def run_method(
    method: str,
    degraded: DegradedFrame,
    settings: Settings,
    view_id: str,
    *,
    neighbours: tuple[MultiViewFrame, ...] = (),
    superresolve: Callable[..., Any] = superresolve,
) -> tuple[npt.NDArray[np.float32], FrameReport | None]:
    """Return what a method makes of one view, (K·H, K·W), and its report if it has one."""
    if method in BASELINES:
        return BASELINES[method](degraded.frame.view(view_id).luma, settings.grid), None
    observed_views = (view_id,) if method == SINGLE_VIEW else None
    if method in SOLVER_METHODS:
        settings = replace(settings, solver=method)
    more: dict[str, Any] = {"neighbours": neighbours} if neighbours and method == DEFAULT else {}
    result = superresolve(
        degraded.frame, settings, targets=(view_id,), observed_views=observed_views, **more
    )
    return result.images[view_id].luma, result.report


def _magnification(degradation: Degradation) -> str:
    along_x, along_y = degradation.magnification_x, degradation.magnification_y
    return f"{along_x}" if along_x == along_y else f"{along_x}x{along_y}"


def _gain(score: Score, of_view: Sequence[Score], base: str) -> float:
    """Return the difference to the base method, dB; NaN where that was not run."""
    psnr_of_base = next((other.psnr for other in of_view if other.method == base), math.nan)
    return 0.0 if score.psnr == psnr_of_base else score.psnr - psnr_of_base


def _signed(value: float) -> str:
    return "" if np.isnan(value) else f"{round(value, 2) + 0.0:+.2f}"
