"""Which pixels to trust, and why not the others: registration weights and verification.

Thesis §2.2, Eq. 3 and Eq. 4. *Deviation*: as printed Eq. 4 zeroes small weights and
small depth differences, the good ones; here the large ones are rejected.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.frames import GreyImage, Positions, Rejection
from pipeline.registration import kernels

EDGE_JUMP = 0.5
"""Difference of adjacent pixels' displacements that makes an edge, LR pixels."""

EDGE_REACH = 4
"""How far from an edge pixels are held to a stricter T_w, LR pixels."""

EDGE_STRICTNESS = 0.5
"""That T_w, as a share of T_w."""


def registration_weights(
    reference_coefficients: npt.NDArray[np.float32],
    position: Positions,
    source: GreyImage,
    offset: npt.NDArray[np.float32],
) -> GreyImage:
    """Return I_W = I_ref(x + u, y + v) − I_n(x, y) + ζ — Eq. (3); NaN where there is none.

    Parameters
    ----------
    reference_coefficients : (H' + 4, W' + 4) float32
        Spline coefficients of the reference's luma.
    position : (H, W, 2) float32
        Landing points, LR pixels of the reference.
    source, offset : (H, W) float32
        Luma of the source and intensity term ζ, grey levels.
    """
    weights = np.empty(source.shape, np.float32)
    kernels.sample_field(reference_coefficients, position, weights)
    weights -= source
    weights += offset
    return weights


@njit(nogil=True, cache=True, error_model="numpy")
def _nearest_landing(position, nearness, nearest):
    """Write the largest nearness that lands on each reference pixel, in place."""
    height, width = nearest.shape
    for row in range(position.shape[0]):
        for column in range(position.shape[1]):
            x, y = position[row, column, 0], position[row, column, 1]
            if not (x > -0.5 and y > -0.5 and x < width - 0.5 and y < height - 0.5):
                continue
            i, j = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
            nearest[i, j] = max(nearest[i, j], nearness[row, column])


@njit(nogil=True, cache=True, error_model="numpy")
def _flag(position, weights, nearness, known, reference, reference_known, nearest, limits, flags):
    """Write the rejection bits of every pixel; limits are T_w², T_D and the z-buffer's margin."""
    height, width = reference.shape
    for row in range(flags.shape[0]):
        for column in range(flags.shape[1]):
            x, y = position[row, column, 0], position[row, column, 1]
            bits = 0
            if not (np.isfinite(x) and np.isfinite(y)):
                flags[row, column] = 1
                continue
            if not (x > -0.5 and y > -0.5 and x < width - 0.5 and y < height - 0.5):
                flags[row, column] = 2
                continue
            i, j = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
            if weights[row, column] > limits[0]:
                bits |= 4  # Eq. (4), first case
            d = nearness[row, column]
            if known[row, column] and reference_known[i, j]:
                away = abs(reference[i, j] - d)
                # a pixel beside an edge may belong to the surface next door
                for di in range(-1, 2):
                    for dj in range(-1, 2):
                        k, m = i + di, j + dj
                        if 0 <= k < height and 0 <= m < width and reference_known[k, m]:
                            away = min(away, abs(reference[k, m] - d))
                if away > limits[1]:
                    bits |= 8  # Eq. (4), second case
            if nearest[i, j] > d + limits[2]:
                bits |= 64
            flags[row, column] = bits


def verify(
    position: Positions,
    weights: GreyImage,
    nearness: npt.NDArray[np.float32],
    known: npt.NDArray[np.bool_],
    reference_nearness: npt.NDArray[np.float32],
    reference_known: npt.NDArray[np.bool_],
    *,
    weight_threshold: float,
    depth_threshold: float,
) -> npt.NDArray[np.uint8]:
    """Return the :class:`Rejection` bits of every pixel — Eq. (4), and occlusion.

    |I_W| is taken as its root mean square over 3 × 3 pixels, so that one noisy pixel
    on a good patch is kept and one lucky pixel on a bad patch is not. Beside a jump of the
    motion a pixel sees two surfaces: next to it none is trusted, and a little farther only
    those that fit well.

    Parameters
    ----------
    position : (H, W, 2) float32
        Landing points, LR pixels of the reference.
    weights : (H, W) float32
        Registration weights, grey levels.
    nearness, reference_nearness : (H, W), (H', W') float32
        Without NaN.
    known, reference_known : bool arrays of those shapes
        Where depth is not a guess.
    weight_threshold : float
        T_w, grey levels.
    depth_threshold : float
        T_D, units of nearness; ∞ leaves depth out.
    """
    reference_shape = reference_nearness.shape
    nearest = np.full(reference_shape, -np.inf, np.float32)
    _nearest_landing(position, nearness, nearest)
    square = np.where(np.isfinite(weights), weights * weights, np.float32(1e6))
    mean_square = cv2.blur(square, (3, 3), borderType=cv2.BORDER_REFLECT)
    flags = np.empty(weights.shape, np.uint8)
    beside = beside_jump(position, EDGE_REACH)
    beside &= mean_square > (EDGE_STRICTNESS * weight_threshold) ** 2
    limits = np.array([weight_threshold**2, depth_threshold, depth_threshold], np.float32)
    _flag(
        position, mean_square, nearness, known, reference_nearness, reference_known, nearest,
        limits, flags,
    )  # fmt: skip
    flags[beside | beside_jump(position, 1)] |= np.uint8(Rejection.EDGE)
    return flags


def beside_jump(position: Positions, reach: int) -> npt.NDArray[np.bool_]:
    """Return which pixels lie within ``reach`` of a jump of the motion, (H, W) bool.

    A jump is a difference of more than ``EDGE_JUMP`` between the displacements of two
    adjacent pixels, so that a slanted surface has none; a pixel without a motion makes one.
    """
    height, width = position.shape[:2]
    x = np.arange(width, dtype=np.float32)[None, :]
    y = np.arange(height, dtype=np.float32)[:, None]
    jumps = np.zeros((height, width), np.uint8)
    for displacement in (position[..., 0] - x, position[..., 1] - y):
        known = np.nan_to_num(displacement, nan=1e4)
        sideways = np.abs(np.diff(known, axis=1)) > EDGE_JUMP
        downwards = np.abs(np.diff(known, axis=0)) > EDGE_JUMP
        jumps[:, 1:] |= sideways
        jumps[:, :-1] |= sideways
        jumps[1:] |= downwards
        jumps[:-1] |= downwards
    # both pixels of a jump are within reach one of it
    side = 2 * (reach - 1) + 1
    return cv2.dilate(jumps, np.ones((side, side), np.uint8)).astype(bool)


def count_rejections(flags: npt.NDArray[np.uint8]) -> dict[str, int]:
    """Return how many pixels carry each reason, by its lower-case name; all reasons listed."""
    return {
        reason.name.lower(): int(np.count_nonzero(flags & reason.value))
        for reason in Rejection
        if reason.name and reason.value
    }
