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
    """
    for _ in range(ROUNDS):
        points = _step(coefficients, points, np.array(observed), noise, grid)
    return points


def _step(
    coefficients: GreyImage,
    points: tuple[GreyImage, GreyImage],
    observed: GreyImage,
    noise: float,
    grid: Grid,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    x, y = points
    height, width = observed.shape
    sums = np.zeros((5, -(-height // CELL), -(-width // CELL)), np.float32)
    scale = np.float32(ERROR[0] + ERROR[1] * noise)
    kernels.sum_gradients(coefficients, x, y, observed, scale, CELL, sums)
    along = grid.magnification_x, grid.magnification_y
    xx, xy, yy, xe, ye = (cv2.GaussianBlur(plane, (3, 3), WINDOW) for plane in sums)
    least = CERTAINTY * (1 + noise**2) * CELL**2
    xx += least / along[0] ** 2
    yy += least / along[1] ** 2
    determinant = xx * yy - xy * xy
    moved = []
    for place, step, unit in (
        (x, (yy * xe - xy * ye) / determinant, along[0]),
        (y, (xx * ye - xy * xe) / determinant, along[1]),
    ):
        step = np.clip(step, -FARTHEST * unit, FARTHEST * unit)
        fine = cv2.resize(step, None, fx=CELL, fy=CELL, interpolation=cv2.INTER_LINEAR)
        moved.append(place + fine[:height, :width])
    return moved[0], moved[1]
