"""What registration needs of one view, computed once: pyramid, splines, gradients, clean depth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import View
from pipeline.registration.kernels import PAD, spline_gradient
from pipeline.registration.patches import fill_unknown

SMOOTHING = 0.7
"""σ of the Gaussian that tames aliasing and noise before registration, LR pixels."""

_POLE = np.sqrt(8.0) - 3.0
_PREFILTER = (_POLE ** np.abs(np.arange(-4, 5))).astype(np.float32)
_PREFILTER /= _PREFILTER.sum()


def spline_coefficients(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return quadratic B-spline coefficients of an image, padded by ``PAD`` (Unser 1999)."""
    coefficients = cv2.sepFilter2D(
        image, cv2.CV_32F, _PREFILTER, _PREFILTER, borderType=cv2.BORDER_REFLECT
    )
    return cv2.copyMakeBorder(coefficients, PAD, PAD, PAD, PAD, cv2.BORDER_REFLECT)


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
    levels: tuple[Level, ...]
    """Finest first."""
    raw_coefficients: npt.NDArray[np.float32]
    """(H + 4, W + 4), spline coefficients of the luma as it is (for Eq. 3)."""
    known: npt.NDArray[np.bool_]
    """(H, W), where depth was known."""
    depth_range: float
    """Range of known nearness, 2nd to 98th percentile; 0 where depth says nothing."""
    metric: bool
    """Whether nearness is 1 / depth in the units of the calibration."""


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
        nearness = fill_unknown(view.depth_map)
        if min(nearness.shape) >= 5:
            nearness = cv2.medianBlur(nearness, 5)
        values = nearness[known]
        depth_range = float(np.subtract(*np.percentile(values, [98, 2]))) if values.size else 0.0
    levels = []
    image = luma
    for index in range(num_levels):
        if index > 0:
            if min(image.shape) < 16:
                break
            image = cv2.pyrDown(image)
            nearness = np.ascontiguousarray(nearness[::2, ::2])
        smooth = cv2.GaussianBlur(image, (0, 0), smoothing) if smoothing > 0 else image
        coefficients = spline_coefficients(smooth)
        gradient_x = np.empty_like(smooth)
        gradient_y = np.empty_like(smooth)
        spline_gradient(coefficients, gradient_x, gradient_y)
        levels.append(
            Level(
                image=smooth,
                coefficients=coefficients,
                gradient_x=gradient_x,
                gradient_y=gradient_y,
                nearness=nearness,
            )
        )
    return PreparedView(
        view=view,
        levels=tuple(levels),
        raw_coefficients=spline_coefficients(luma),
        known=known,
        depth_range=depth_range,
        metric=metric,
    )
