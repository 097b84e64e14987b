"""The registration methods of thesis Table 1, and ours, as one table of switches."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum, StrEnum


class MotionModel(IntEnum):
    """The parametric motion of a patch (thesis Eq. 2); the value is its degree."""

    TRANSLATION = 0
    """Two parameters: c."""
    AFFINE = 1
    """Six parameters: c and a."""
    QUADRATIC = 2
    """Twelve parameters: c, a and q."""


class Initialisation(StrEnum):
    """Where a patch's fit starts."""

    NONE = "none"
    """No motion."""
    LAYER = "layer"
    """The motion of its whole layer, itself fitted from no motion ("subregion-init")."""
    CALIBRATION = "calibration"
    """The camera matrices and the mean depth; then the layer, then the patch (Figure 5)."""
    PARALLAX = "parallax"
    """The parallax motion of the whole view: from calibration, or fitted to matches."""


class Layout(StrEnum):
    """How a view is cut into patches."""

    STRIPS = "strips"
    """L depth layers × R strips side by side (the thesis)."""
    WINDOWS = "windows"
    """Small overlapping windows, cut where depth jumps (not in the thesis)."""


@dataclass(frozen=True, kw_only=True)
class RegistrationMethod:
    """One way to register a view onto a reference."""

    layout: Layout
    num_layers: int = 11
    """L, of the strips."""
    num_subregions: int = 3
    """R, of the strips."""
    model: MotionModel = MotionModel.AFFINE
    """Of a patch; windows are affine at most."""
    initialisation: Initialisation = Initialisation.NONE
    best_of_layer_and_patch: bool = False
    """Choose for each pixel between its layer's and its patch's motion by registration weight
    ("Global+Subregion")."""
    refine: bool = True
    """False: pixels are mapped by calibration and depth alone."""
    destination_support: bool = False
    """Only reference pixels of similar depth take part in a fit (Figure 4)."""


_THESIS = RegistrationMethod(layout=Layout.STRIPS)

METHODS: dict[str, RegistrationMethod] = {
    "default": RegistrationMethod(layout=Layout.WINDOWS, initialisation=Initialisation.PARALLAX),
    "a": replace(_THESIS, num_layers=1, num_subregions=1),
    "b": replace(
        _THESIS, num_subregions=1, model=MotionModel.TRANSLATION, best_of_layer_and_patch=True
    ),
    "c": replace(_THESIS, num_layers=1),
    "d": replace(_THESIS, model=MotionModel.TRANSLATION),
    "e": replace(_THESIS, initialisation=Initialisation.CALIBRATION),
    "f": replace(_THESIS, num_subregions=1),
    "g": replace(_THESIS, model=MotionModel.TRANSLATION, best_of_layer_and_patch=True),
    "h": replace(_THESIS, initialisation=Initialisation.LAYER),
    "j": _THESIS,
    "k": replace(_THESIS, best_of_layer_and_patch=True),
    "l": replace(_THESIS, initialisation=Initialisation.LAYER, best_of_layer_and_patch=True),
    "calibration-only": RegistrationMethod(
        layout=Layout.WINDOWS, initialisation=Initialisation.CALIBRATION, refine=False
    ),
}
"""By the name of the preset; a…l are the rows of Table 1 (it has no row i)."""
