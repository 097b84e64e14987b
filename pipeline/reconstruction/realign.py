"""Landing points corrected by what is predicted of them: steps of Lucas and Kanade.

Registration compares two LR pictures, both aliased. What the solver starts from is neither, and
predicts each pixel of another view; where the predictions are wrong by what a shift would explain,
the landing points are moved by that shift (B. D. Lucas, T. Kanade, An Iterative Image Registration
Technique, IJCAI 1981), the less so the less certain it is.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage
from pipeline.grid import Grid
from pipeline.reconstruction import kernels

ROUNDS = 2
"""Steps, each from where the one before it has come to."""

CELL = 3
"""Side of the cells over which is summed, LR pixels."""

WINDOW = 0.6
"""σ of the window over cells, cells."""

ERROR = (6.0, 3.0)
"""Error at which a pixel counts a quarter: constant, and factor on the noise, grey levels."""

CERTAINTY = 4.0
"""Squared gradient by which shifts are drawn to nothing, times 1 + noise², (grey / LR pixel)²."""

FARTHEST = 0.6
"""Largest correction along each axis, LR pixels."""


def realigned(
    coefficients: GreyImage,
    points: tuple[GreyImage, GreyImage],
    observed: GreyImage,
    noise: float,
    grid: Grid,
    *,
    rounds: int = ROUNDS,
    share: float = 1.0,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return a view's landing points x and y, HR pixels, corrected.

    Parameters
    ----------
    coefficients : (K·H + 4, K·W + 4) float32
        Of the estimate, see ``system.spline_coefficients``.
    points : (H, W), (H, W) float32
        Landing points, HR pixels.
    observed : (H, W) float32
        Grey levels.
    noise : float
        Grey levels.
    rounds : int
        Steps.
    share : float
        How much of the correction is made, 0..1.
    """
    x, y = points
    pixels = np.array(observed)  # a writable copy, for one compilation
    height, width = observed.shape
    scale = np.float32(ERROR[0] + ERROR[1] * noise)
    least = CERTAINTY * (1 + noise**2) * CELL**2
    for _ in range(rounds):
        sums = np.zeros((5, -(-height // CELL), -(-width // CELL)), np.float32)
        kernels.sum_gradients(coefficients, x, y, pixels, scale, CELL, sums)
        xx, xy, yy, xe, ye = (cv2.GaussianBlur(plane, (3, 3), WINDOW) for plane in sums)
        xx += least / grid.magnification_x**2
        yy += least / grid.magnification_y**2
        determinant = xx * yy - xy * xy
        x = x + _fine((yy * xe - xy * ye) / determinant, grid.magnification_x)[:height, :width]
        y = y + _fine((xx * ye - xy * xe) / determinant, grid.magnification_y)[:height, :width]
    part = np.float32(share)
    return points[0] + part * (x - points[0]), points[1] + part * (y - points[1])


def _fine(step: GreyImage, magnification: int) -> GreyImage:
    """Return the steps of cells, HR pixels, bounded, for each of their pixels."""
    farthest = FARTHEST * magnification
    bounded = np.clip(step, -farthest, farthest)
    return cv2.resize(bounded, None, fx=CELL, fy=CELL, interpolation=cv2.INTER_LINEAR)
