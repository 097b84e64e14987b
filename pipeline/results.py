"""What super-resolving one frame gives: images, and an account of how they came about."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from pipeline.effort import FULL, Effort
from pipeline.frames import ChromaImage, GreyImage, RegisteredView, frozen


class Colour(Protocol):
    """The chroma of an image, made when it is asked for, and no larger than it is wanted."""

    def whole(self) -> ChromaImage:
        """Return it on the HR grid, (K·H, K·W, 2) float32, 0..255."""

    def halved(self) -> ChromaImage | None:
        """Return it as 4:2:0 video has it; None where that would have to be made of the whole.

        (K·H/2, K·W/2, 2) float32, on even HR columns and midway between HR rows.
        """


@dataclass(frozen=True, kw_only=True, eq=False)
class WholeColour:
    """The chroma of an image that there is on the HR grid."""

    chroma: ChromaImage
    """(K·H, K·W, 2) float32."""

    def whole(self) -> ChromaImage:
        """Return it."""
        return self.chroma

    def halved(self) -> None:
        """Return None: there is only the whole."""
        return None


@dataclass(frozen=True, kw_only=True, eq=False)
class SuperResolvedImage:
    """One eye (or view) on the HR grid."""

    view_id: str
    luma: GreyImage
    """(K·H, K·W) float32, 0..255."""
    colour: Colour | None = None
    """Its chroma, or None for grey input."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "luma", frozen(self.luma))

    @functools.cached_property
    def chroma(self) -> ChromaImage | None:
        """(K·H, K·W, 2) float32, or None for grey input."""
        return None if self.colour is None else frozen(self.colour.whole())


@dataclass(frozen=True, kw_only=True)
class ViewReport:
    """What one view brought to one reference view."""

    view_id: str
    registered_fraction: float
    """Share of LR pixels that have a motion, 0..1."""
    verified_fraction: float
    """Share of LR pixels that are trusted, 0..1."""
    weight_fraction: float
    """Mean weight the solver gave the view's pixels, 0..1; 0: it brought nothing."""
    rejections: Mapping[str, int]
    """Pixels by reason (lower-case name of :class:`Rejection`); a pixel may have several."""
    median_absolute_weight: float
    """Median |registration weight| over registered pixels, grey levels; NaN where none."""
    residual_rms: float
    """RMS of observed − simulated over trusted pixels after the solve, grey levels; NaN: none."""


@dataclass(frozen=True, kw_only=True)
class StartChoice:
    """How a frame's reconstruction started."""

    warm_share: float
    """Share of blocks that start from the previous result, 0..1."""
    is_cut: bool
    """Whether too few blocks matched, most of it changed where it was, or the noise has fallen, so
    that the whole frame starts cold."""
    has_moved: bool = False
    """Whether the camera has moved, or the picture goes on changing all over, so that it starts
    cold, in fewer steps, the registration from how the views stood to one another."""


@dataclass(frozen=True, kw_only=True)
class TargetReport:
    """How one reference view was reconstructed."""

    view_id: str
    views: tuple[ViewReport, ...]
    phase_coverage: float
    """Share of the K×K sub-pixel phases that trusted observations fill, per cent,
    mean over LR cells of the reference."""
    phase_coverage_reference: float
    """The same for the reference view alone, per cent."""
    remark: str
    """A plain sentence about what the other views bring; empty where all is well."""
    solver: str
    iterations: int
    """Iterations (fused; of a pixel in the mean, rounded up) or sweeps (pocs)."""
    stop_reason: str
    residuals: tuple[float, ...]
    """RMS residual after each sweep or outer iteration, grey levels."""
    start: StartChoice
    """Where the reconstruction started: the previous frame's result or the reference view."""


@dataclass(frozen=True, kw_only=True)
class FrameReport:
    """The account of one frame."""

    frame_index: int
    noise_sigma: float
    """Noise used, grey levels."""
    noise_is_estimated: bool
    psf_sigma: float
    """HR pixels."""
    psf_support: int
    """HR pixels, odd."""
    psf_is_estimated: bool
    targets: tuple[TargetReport, ...]
    timings: Mapping[str, float]
    """Seconds by stage: registration, reconstruction, chroma, …"""
    effort: Effort = FULL
    """What was allowed to be left out."""
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetDebug:
    """The intermediates of one reference view, for ``--debug-dir``."""

    view_id: str
    registered: tuple[RegisteredView, ...]
    weights: tuple[GreyImage, ...]
    """Per registered view, (H, W) float32 0..1: the weight the solver gave each LR pixel."""
    patch_labels: Mapping[str, npt.NDArray[np.int32]]
    """Per view id, (H, W) int32: patch number, −1 where in none."""
    layer_labels: Mapping[str, npt.NDArray[np.int32]]
    """Per view id, (H, W) int32: depth layer, −1 where in none."""
    contribution_count: npt.NDArray[np.float32]
    """(K·H, K·W) float32: weight of the observations gathered at each HR pixel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameResult:
    """The super-resolved images of one frame, and the account of them."""

    frame_index: int
    images: Mapping[str, SuperResolvedImage]
    """By view id: the targets that were asked for."""
    report: FrameReport
    debug: Mapping[str, TargetDebug] = field(default_factory=dict)
    """By view id; empty unless intermediates were asked for."""
