"""What registration needs of one view, computed once: pyramid, splines, gradients, clean depth."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import View
from pipeline.registration.kernels import PAD
from pipeline.registration.patches import fill_unknown

SMOOTHING = 0.7
"""σ of the Gaussian that tames aliasing and noise before registration, LR pixels."""

RANGE_LINES = 96
"""The range of depth is taken from so many rows or columns at least, where there are more."""

SMALLEST = 16
"""Pixels along each side that a picture has at least of which a coarser one is made."""

SPECK = 5
"""Side of the box whose median a depth map has, pixels."""

_POLE = np.sqrt(8.0) - 3.0
_PREFILTER = (_POLE ** np.abs(np.arange(-4, 5))).astype(np.float32)
_PREFILTER /= _PREFILTER.sum()

_VALUE = np.array([0.125, 0.75, 0.125], np.float32)
_SLOPE = np.array([-0.5, 0.0, 0.5], np.float32)
"""A quadratic spline and its slope at whole pixels, of three coefficients."""


def spline_coefficients(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return quadratic B-spline coefficients of an image, padded by ``PAD`` (Unser 1999)."""
    coefficients = cv2.sepFilter2D(
        image, cv2.CV_32F, _PREFILTER, _PREFILTER, borderType=cv2.BORDER_REFLECT
    )
    return cv2.copyMakeBorder(coefficients, PAD, PAD, PAD, PAD, cv2.BORDER_REFLECT)


def spline_gradients(
    coefficients: npt.NDArray[np.float32],
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return the spline's gradient along x and y at whole pixels, grey levels a pixel."""
    inner = coefficients[PAD:-PAD, PAD:-PAD]
    along_x = cv2.sepFilter2D(inner, cv2.CV_32F, _SLOPE, _VALUE, borderType=cv2.BORDER_REFLECT)
    along_y = cv2.sepFilter2D(inner, cv2.CV_32F, _VALUE, _SLOPE, borderType=cv2.BORDER_REFLECT)
    return along_x, along_y


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """One pyramid level of a view, 2^level times coarser than the LR image."""

    image: npt.NDArray[np.float32]
    """(h, w), smoothed luma."""
    coefficients: npt.NDArray[np.float32]
    """(h + 4, w + 4), spline coefficients of it."""
    gradient_x: npt.NDArray[np.float32]
    gradient_y: npt.NDArray[np.float32]
    nearness: npt.NDArray[np.float32]
    """(h, w), filled and cleaned."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PreparedView:
    """A view, ready to be registered or to be a reference."""

    view: View
    fine: Level
    """At LR resolution."""
    num_levels: int
    """Pyramid levels, at most."""
    smoothing: float
    """σ of the Gaussian before registration, pixels of each level."""
    known: npt.NDArray[np.bool_]
    """(H, W), where depth was known."""
    depth_range: float
    """Range of known nearness, 2nd to 98th percentile; 0 where depth says nothing."""
    metric: bool
    """Whether nearness is 1 / depth in the units of the calibration."""

    @functools.cached_property
    def raw_coefficients(self) -> npt.NDArray[np.float32]:
        """(H + 4, W + 4), spline coefficients of the luma as it is (for Eq. 3)."""
        return spline_coefficients(np.ascontiguousarray(self.view.luma))

    @functools.cached_property
    def middle_nearness(self) -> float:
        """Median over the view."""
        return float(np.median(self.fine.nearness[::16, ::16]))

    @functools.cached_property
    def levels(self) -> tuple[Level, ...]:
        """The pyramid, finest first, made where it is asked for."""
        found, made = [self.fine], self._half
        while made is not None:
            found.append(made[1])
            made = self._halved(*made) if len(found) < self.num_levels else None
        return tuple(found)

    @functools.cached_property
    def _half(self) -> tuple[npt.NDArray[np.float32], Level] | None:
        """The luma at half its size, and its level, made where it is asked for, as above."""
        luma = np.ascontiguousarray(self.view.luma)
        return self._halved(luma, self.fine) if self.num_levels > 1 else None

    def _halved(
        self, image: npt.NDArray[np.float32], level: Level
    ) -> tuple[npt.NDArray[np.float32], Level] | None:
        """Return a picture at half its size, and its level; None where it is too small."""
        if min(image.shape) < SMALLEST:
            return None
        image = cv2.pyrDown(image)
        nearness = np.ascontiguousarray(level.nearness[::2, ::2])
        return image, _level(image, nearness, self.smoothing)

    def level(self, number: int) -> Level | None:
        """Return a level, 0 being the finest; None where the picture is too small for it."""
        if number == 0:
            return self.fine
        if number == 1:
            return None if self._half is None else self._half[1]
        return self.levels[number] if number < len(self.levels) else None


def _level(
    image: npt.NDArray[np.float32], nearness: npt.NDArray[np.float32], smoothing: float
) -> Level:
    smooth = cv2.GaussianBlur(image, (0, 0), smoothing) if smoothing > 0 else image
    coefficients = spline_coefficients(smooth)
    gradient_x, gradient_y = spline_gradients(coefficients)
    return Level(
        image=smooth,
        coefficients=coefficients,
        gradient_x=gradient_x,
        gradient_y=gradient_y,
        nearness=nearness,
    )


def cleaned(depth_map: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return a depth map filled where it is unknown, and without specks."""
    filled = fill_unknown(depth_map)
    return cv2.medianBlur(filled, SPECK) if min(filled.shape) >= SPECK else filled


def prepare(
    view: View, num_levels: int, *, metric: bool = False, smoothing: float = SMOOTHING
) -> PreparedView:
    """Return the view with its pyramid of ``num_levels`` levels (fewer for tiny images)."""
    luma = np.ascontiguousarray(view.luma)
    if view.depth_map is None:
        nearness = np.zeros(luma.shape, np.float32)
        known = np.zeros(luma.shape, bool)
        depth_range = 0.0
    else:
        known = np.isfinite(view.depth_map)
        nearness = cleaned(view.depth_map)
        step = max(1, min(nearness.shape) // RANGE_LINES)
        values = nearness[::step, ::step][known[::step, ::step]]
        depth_range = float(np.subtract(*np.percentile(values, [98, 2]))) if values.size else 0.0
    return PreparedView(
        view=view,
        fine=_level(luma, nearness, smoothing),
        num_levels=num_levels,
        smoothing=smoothing,
        known=known,
        depth_range=depth_range,
        metric=metric,
    )
