"""From an HR image to what a low-resolution camera delivers, and a stereo matcher's depth.

The Gaussian point spread function is evaluated at the exact sampling position,
which for area sampling at even K lies between HR pixels.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.grid import Grid

DEPTH_LEVELS = 255
"""Stored depth runs from 1 to here; 0 is unknown."""


def sampling_taps(sigma: float, support: int, phase: float) -> tuple[int, npt.NDArray[np.float64]]:
    """Return the first whole offset and the unit-sum taps of a Gaussian at a fractional position.

    Parameters
    ----------
    sigma : float
        HR pixels.
    support : int
        Width of the window, HR pixels, odd; a tap right on the window's end counts half.
    phase : float
        The sampling position's fraction of an HR pixel, 0 ≤ phase < 1.
    """
    half = support / 2
    first = int(np.ceil(phase - half))
    offsets = np.arange(first, int(np.floor(phase + half)) + 1)
    distance = np.abs(offsets - phase)
    taps = np.exp(-0.5 * (distance / sigma) ** 2) * np.where(distance >= half - 1e-9, 0.5, 1.0)
    return first, taps / taps.sum()


def blur_and_sample(
    hr_image: npt.NDArray, grid: Grid, psf_sigma: float, psf_support: int
) -> npt.NDArray[np.float64]:
    """Return the LR image of an HR image, before noise and rounding, float64.

    The border reflects about the centre of the outermost pixel. ``hr_image``
    is (K·H, K·W) or (K·H, K·W, C).
    """
    out = np.asarray(hr_image, dtype=np.float64)
    steps = ((grid.magnification_y, grid.offset_y), (grid.magnification_x, grid.offset_x))
    for axis, (step, offset) in enumerate(steps):
        count = out.shape[axis] // step
        whole = int(np.floor(offset))
        first, taps = sampling_taps(psf_sigma, psf_support, offset - whole)
        margin = max(psf_support, step) + 1
        padding = [(0, 0)] * out.ndim
        padding[axis] = (margin, margin)
        padded = np.pad(out, padding, mode="reflect" if out.shape[axis] > 1 else "edge")
        total = np.zeros(())
        for number, tap in enumerate(taps):
            start = margin + whole + first + number
            piece = [slice(None)] * out.ndim
            piece[axis] = slice(start, start + step * (count - 1) + 1, step)
            total = total + tap * padded[tuple(piece)]
        out = total
    return out


def degraded_depth(
    nearness: npt.NDArray[np.float64],
    occluded: npt.NDArray[np.bool_],
    depth_range: tuple[float, float],
    noise: np.random.Generator,
    *,
    edge_error: float = 2.5,
    noise_levels: float = 2.0,
) -> npt.NDArray[np.uint8]:
    """Return depth as a stereo matcher delivers it: 8 bit, noisy, ragged, with holes.

    Parameters
    ----------
    nearness : (H, W) float64
        True inverse depth at LR pixel centres.
    occluded : (H, W) bool
        Where the matcher's other view does not see the surface.
    depth_range : (float, float)
        Inverse depths of the stored levels 1 and 255.
    noise : Generator
    edge_error : float
        How far foreground grows over its edges, and how far edges are displaced, LR pixels.
    noise_levels : float
        Standard deviation of the blocky error, stored levels.

    Returns
    -------
    (H, W) uint8
        Stored levels, 0 where unknown.
    """
    height, width = nearness.shape
    near = nearness.astype(np.float32)

    def smooth_noise(cell: int) -> npt.NDArray[np.float32]:
        lattice = noise.standard_normal((height // cell + 3, width // cell + 3))
        full = cv2.resize(
            lattice.astype(np.float32), None, fx=cell, fy=cell, interpolation=cv2.INTER_CUBIC
        )
        return full[cell : cell + height, cell : cell + width]

    # edges are displaced irregularly, and the foreground grows by a changing amount
    y, x = np.mgrid[:height, :width].astype(np.float32)
    shift = np.float32(0.45 * edge_error)
    moved = cv2.remap(
        near, x + shift * smooth_noise(5), y + shift * smooth_noise(5),
        cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    growth = np.clip(edge_error * (0.35 + 0.5 * smooth_noise(9)), 0, None)
    grown = moved
    for radius in range(1, int(np.ceil(edge_error)) + 1):
        kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
        grown = np.where(growth >= radius - 0.5, cv2.dilate(moved, kernel), grown)

    low, high = depth_range
    levels = 1 + (grown - low) / (high - low) * (DEPTH_LEVELS - 1)
    blocks = noise.standard_normal((height // 6 + 1, width // 6 + 1)).astype(np.float32)
    blocky = np.repeat(np.repeat(blocks, 6, axis=0), 6, axis=1)[:height, :width]
    levels = levels + noise_levels * blocky + 0.4 * noise.standard_normal((height, width))
    stored = np.clip(np.rint(levels), 1, DEPTH_LEVELS).astype(np.uint8)

    ragged = cv2.remap(
        occluded.astype(np.uint8), x + smooth_noise(4), y + smooth_noise(4),
        cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip
    holes = np.where(smooth_noise(7) < 1.0, ragged, 0)
    for _ in range(max(1, height * width // 6000)):
        centre = (int(noise.integers(width)), int(noise.integers(height)))
        axes = (int(noise.integers(1, 6)), int(noise.integers(1, 5)))
        cv2.ellipse(holes, centre, axes, float(noise.uniform(0, 180)), 0, 360, 1, -1)
    stored[holes > 0] = 0
    return stored
