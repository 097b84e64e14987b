"""What registration gives, and what it keeps from frame to frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, Mask, RegisteredView
from pipeline.registration.method import RegistrationMethod
from pipeline.registration.motions import FitPrior, FittedMotions
from pipeline.registration.parallax import ParallaxMotion
from pipeline.registration.prepare import PreparedView


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """The limits of Eq. 4."""

    weight: float
    """T_w, grey levels."""
    depth: float
    """T_D, fraction of the scene's depth range."""


@dataclass(frozen=True, kw_only=True)
class Terms:
    """On which terms views are registered: the same for all of a frame."""

    method: RegistrationMethod
    noise: float
    """Standard deviation, grey levels."""
    thresholds: Thresholds


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewRegistration:
    """One view registered onto one reference, with what later stages and pictures may ask."""

    registered: RegisteredView
    motions: FittedMotions | None
    """None for the reference view itself, and where the reference was fitted onto the view."""
    parallax: ParallaxMotion | None
    prior: FitPrior | None = None
    """How firmly the last fit was held; None where there was none."""
    patch_labels: npt.NDArray[np.int32]
    """(H, W): number of the patch whose motion each pixel took, −1 where none."""
    offset: GreyImage
    """(H, W): intensity term ζ, grey levels."""
    renewed: Mask | None = None
    """(H, W): pixels whose landing point or verdict is not simply that of the previous frame;
    None where all have been registered anew."""
    fresh: Mask | None = None
    """(rows, columns): cells whose patches are not those of the previous frame; None where all
    have been registered anew."""
    misfit: float = 0.0
    """Median misfit of what was fitted anew when a fit from scratch was last tried in vain, grey
    levels; 0 where none was, or what is fitted anew fits."""
    missed: tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]] | None = None
    """(H + 1, W + 1) each, in the view and in the reference: how many pixels above and to the left
    have changed in frames in which it was kept as it is; None where there was none such."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Previous:
    """What the previous frame leaves to the registration of the next."""

    prepared: Mapping[str, PreparedView]
    registrations: Mapping[str, Sequence[ViewRegistration]]
    turn: int
    """Frames since the chain began: says which windows are checked for drift now."""
    has_moved: bool = False
    """Whether the next frame shows it from another place: of the registrations, only how the views
    stand to one another holds."""
    lagging: Mapping[str, Mask] = field(default_factory=dict)
    """By view, (H, W): pixels that have changed little by little, and are fitted anew."""
