"""The curve a PSF estimate was read from: text, plot, record (thesis Figures 17 and 18)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from pipeline import drawing
from pipeline.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class PsfCurve:
    """How well each σ explains a view (or one depth layer of it), and the σ chosen."""

    view_id: str
    sigmas: tuple[float, ...]
    """The σ tried, HR pixels, increasing."""
    misfits: tuple[float, ...]
    """How much less likely each σ makes the edges' widths than the best one does: difference of
    the logarithm of the likelihood, per edge, ≥ 0; NaN where nothing was measured."""
    sigma: float
    """The σ chosen, HR pixels; may lie between two that were tried."""
    support: int
    """The support that goes with it, HR pixels, odd."""
    layer: int | None = None
    """Depth layer, 0-based; None: the whole view."""
    remark: str = ""
    """Why the views could not tell and σ is an assumption; empty where they could."""

    def __post_init__(self) -> None:
        if len(self.sigmas) != len(self.misfits) or not self.sigmas:
            raise ConfigurationError("a PSF curve needs one misfit for each σ tried")

    @property
    def title(self) -> str:
        """What it is the curve of."""
        of_layer = "" if self.layer is None else f", depth layer {self.layer}"
        assumed = " (assumed)" if self.remark else ""
        return (
            f"{self.view_id}{of_layer}: σ = {self.sigma:.2f} HR pixels{assumed}, "
            f"support {self.support}"
        )


def format_psf(curves: Sequence[PsfCurve]) -> str:
    """Return the curves as text: the choice, then an aligned table, if anything was measured."""
    lines = []
    for curve in curves:
        lines.append(curve.title)
        if curve.remark:
            lines.append(curve.remark)
        if all(math.isnan(misfit) for misfit in curve.misfits):
            continue
        lines.append("     σ  misfit")
        chosen = min(curve.sigmas, key=lambda sigma: abs(sigma - curve.sigma))
        for sigma, misfit in zip(curve.sigmas, curve.misfits, strict=True):
            mark = "  ←" if sigma == chosen and not curve.remark else ""
            lines.append(f"{sigma:6.2f}  {misfit:6.3f}{mark}")
    return "\n".join(lines)


def psf_picture(curves: Sequence[PsfCurve]) -> drawing.Canvas:
    """Return the curves as plots, one below another."""
    return drawing.framed(
        drawing.below(
            [
                drawing.curve_plot(
                    curve.sigmas,
                    curve.misfits,
                    title=curve.title,
                    x_label="σ of the PSF, HR pixels",
                    y_label="misfit per edge, log of the likelihood",
                    marked=curve.sigma,
                )
                for curve in curves
            ]
        )
    )
