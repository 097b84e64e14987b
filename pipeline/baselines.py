"""Plain enlargement, at the sampling phase asked for: what super-resolution is held against.

OpenCV's own ``resize`` knows the area-centred phase only, and its warps round
positions to 1/32 pixel, so the kernels are applied here phase by phase: for an
enlargement by whole K there are K of them along each axis, and each is one
separable filter of the LR image. The kernels themselves are OpenCV's.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.grid import Grid

BICUBIC_A = -0.75
"""Slope parameter of OpenCV's bicubic kernel."""

LANCZOS_LOBES = 4
"""Half-width of OpenCV's Lanczos4 kernel, LR pixels."""


def nearest(image: npt.NDArray, grid: Grid) -> npt.NDArray[np.float32]:
    """Return the image enlarged by repetition; a tie goes to the left and upper pixel."""
    height, width = image.shape[:2]
    rows = _nearest_index(height, grid.magnification_y, grid.offset_y)
    columns = _nearest_index(width, grid.magnification_x, grid.offset_x)
    return np.ascontiguousarray(image[rows][:, columns], dtype=np.float32)


def bilinear(image: npt.NDArray, grid: Grid) -> npt.NDArray[np.float32]:
    """Return the image enlarged by linear interpolation along each axis."""
    return _enlarge(image, grid, lambda distance: np.clip(1 - np.abs(distance), 0, None), 1)


def bicubic(image: npt.NDArray, grid: Grid) -> npt.NDArray[np.float32]:
    """Return the image enlarged with OpenCV's bicubic kernel (a = −0.75)."""
    return _enlarge(image, grid, _cubic, 2)


def bicubic_taps(magnification: int, offset: float) -> npt.NDArray[np.float32]:
    """Return the taps of that kernel for each phase along an axis, on LR offsets −2 … 2, (K, 5)."""
    taps = np.array(_phase_taps(magnification, offset, _cubic, 2), np.float32)
    return np.ascontiguousarray(taps[:, 1:-1])  # beyond them all are zero


def lanczos(image: npt.NDArray, grid: Grid) -> npt.NDArray[np.float32]:
    """Return the image enlarged with OpenCV's Lanczos4 kernel, weights made to sum to one."""
    return _enlarge(image, grid, _lanczos, LANCZOS_LOBES)


BASELINES: dict[str, Callable[[npt.NDArray, Grid], npt.NDArray[np.float32]]] = {
    "nearest": nearest,
    "bilinear": bilinear,
    "bicubic": bicubic,
    "lanczos": lanczos,
}
"""By the name in the evaluation table. Input (H, W) or (H, W, C), borders replicated."""


def _cubic(distance: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    x, a = np.abs(distance), BICUBIC_A
    inner = ((a + 2) * x - (a + 3)) * x * x + 1
    outer = ((a * x - 5 * a) * x + 8 * a) * x - 4 * a
    return np.where(x <= 1, inner, np.where(x < 2, outer, 0.0))


def _lanczos(distance: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    inside = np.abs(distance) < LANCZOS_LOBES
    return np.where(inside, np.sinc(distance) * np.sinc(distance / LANCZOS_LOBES), 0.0)


def _phase_taps(
    magnification: int,
    offset: float,
    kernel: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]],
    reach: int,
) -> list[npt.NDArray[np.float64]]:
    """Return, for each of the K phases, the taps on LR offsets −reach−1 … reach+1."""
    taps_at = np.arange(-reach - 1.0, reach + 2.0)
    result = []
    for phase in range(magnification):
        taps = kernel(taps_at - (phase - offset) / magnification)
        result.append(taps / taps.sum())
    return result


def _enlarge(
    image: npt.NDArray,
    grid: Grid,
    kernel: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.float64]],
    reach: int,
) -> npt.NDArray[np.float32]:
    source = np.ascontiguousarray(image, dtype=np.float32)
    height, width = grid.hr_shape(source.shape[:2])
    result = np.empty((height, width, *source.shape[2:]), np.float32)
    taps_x = _phase_taps(grid.magnification_x, grid.offset_x, kernel, reach)
    taps_y = _phase_taps(grid.magnification_y, grid.offset_y, kernel, reach)
    for y, along_y in enumerate(taps_y):
        for x, along_x in enumerate(taps_x):
            filtered = cv2.sepFilter2D(
                source, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_REPLICATE
            )
            result[y :: grid.magnification_y, x :: grid.magnification_x] = filtered
    return result


def _nearest_index(size: int, magnification: int, offset: float) -> npt.NDArray[np.intp]:
    position = (np.arange(size * magnification) - offset) / magnification
    index = [math.ceil(value - 0.5) for value in position]
    return np.clip(np.array(index, dtype=np.intp), 0, size - 1)
