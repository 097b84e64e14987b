"""Which pixels to trust, and why not the others: registration weights and verification.

Thesis §2.2, Eq. 3 and Eq. 4. *Deviation*: as printed Eq. 4 zeroes small weights and
small depth differences, the good ones; here the large ones are rejected.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.frames import GreyImage, Mask, Positions, Rejection
from pipeline.registration import kernels

_NO_MOTION, _OUTSIDE, _WEIGHT, _DEPTH, _EDGE, _OCCLUDED = (
    int(Rejection.NO_MOTION), int(Rejection.OUTSIDE), int(Rejection.WEIGHT),
    int(Rejection.DEPTH), int(Rejection.EDGE), int(Rejection.OCCLUDED),
)  # fmt: skip
"""The bits as compiled loops know them."""

NO_WEIGHT = 1e6
"""Square that stands for a registration weight that there is none of, grey levels²."""

EDGE_JUMP = 0.5
"""Difference of adjacent pixels' displacements that makes an edge, LR pixels."""

EDGE_REACH = 4
"""How far from an edge pixels are held to a stricter T_w, LR pixels."""

EDGE_STRICTNESS = 0.5
"""That T_w, as a share of T_w."""

_REASONS = {
    reason.name.lower(): reason.value for reason in Rejection if reason.name and reason.value
}

_HAS_REASON = np.arange(256)[:, None] & np.array(list(_REASONS.values())) != 0
"""(256, reasons) bool: of each value of the flags, which reasons it holds."""


def registration_weights(
    reference_coefficients: npt.NDArray[np.float32],
    position: Positions,
    source: GreyImage,
    offset: npt.NDArray[np.float32],
    *,
    before: tuple[GreyImage, Mask] | None = None,
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
    before : (weights, pixels to renew), optional
        Where only some are wanted: what the others keep.
    """
    weights, renewed = before or (np.empty(source.shape, np.float32), np.ones(source.shape, bool))
    weights = weights.copy()
    _weigh(reference_coefficients, position, source, offset, renewed, weights)
    return weights


@njit(nogil=True, cache=True, error_model="numpy")
def _weigh(reference, position, source, offset, renewed, weights):
    """Write the registration weights of some pixels."""
    for row in range(weights.shape[0]):
        for column in range(weights.shape[1]):
            if renewed[row, column]:
                value = kernels.value_at(
                    reference, position[row, column, 0], position[row, column, 1]
                )
                weights[row, column] = value - source[row, column] + offset[row, column]


@njit(nogil=True, cache=True, error_model="numpy")
def _nearest_landing(position, nearness, nearest):
    """Write the largest nearness that lands on each reference pixel, in place."""
    half, zero = np.float32(0.5), np.float32(0.0)
    height, width = np.float32(nearest.shape[0]), np.float32(nearest.shape[1])
    for row in range(position.shape[0]):
        for column in range(position.shape[1]):
            x, y = position[row, column, 0] + half, position[row, column, 1] + half
            if not (x > zero and y > zero and x < width and y < height):
                continue
            # not negative, and unsigned numbers need no check that they are
            i, j = np.uint64(y), np.uint64(x)
            nearest[i, j] = max(nearest[i, j], nearness[row, column])


@njit(nogil=True, cache=True, error_model="numpy")
def _flag(
    position, squares, nearness, known, reference, reference_known, nearest, jumps, beside, limits,
    renewed, flags,
):  # fmt: skip
    """Write the rejection bits of some pixels.

    ``squares`` are the mean squares of the weights around each; ``jumps`` and ``beside`` say
    which pixels are next to a jump and which within reach of one; limits are T_w², T_D, the
    z-buffer's margin and the stricter T_w² beside jumps.
    """
    height, width = reference.shape
    for row in range(flags.shape[0]):
        for column in range(flags.shape[1]):
            if not renewed[row, column]:
                continue
            x, y = position[row, column, 0], position[row, column, 1]
            square = squares[row, column]
            bits = 0
            if jumps[row, column] or (beside[row, column] and square > limits[3]):
                bits = _EDGE
            if not (np.isfinite(x) and np.isfinite(y)):
                flags[row, column] = bits | _NO_MOTION
                continue
            if not (x > -0.5 and y > -0.5 and x < width - 0.5 and y < height - 0.5):
                flags[row, column] = bits | _OUTSIDE
                continue
            i, j = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
            if square > limits[0]:
                bits |= _WEIGHT  # Eq. (4), first case
            d = nearness[row, column]
            says = known[row, column] and reference_known[i, j]
            if says and abs(reference[i, j] - d) > limits[1]:
                # a pixel beside an edge may belong to the surface next door
                away = np.inf
                for k in range(max(i - 1, 0), min(i + 2, height)):
                    for m in range(max(j - 1, 0), min(j + 2, width)):
                        if reference_known[k, m]:
                            away = min(away, abs(reference[k, m] - d))
                if away > limits[1]:
                    bits |= _DEPTH  # Eq. (4), second case
            if nearest[i, j] > d + limits[2]:
                bits |= _OCCLUDED
            flags[row, column] = bits


@njit(nogil=True, cache=True, error_model="numpy")
def _jumps(position, limit, wanted, jumps):
    """Mark both pixels of adjacent ones whose displacements differ by more than the limit.

    A pixel without a motion makes a jump to one that has. ``wanted`` are the pixels that are
    compared with those to their right and below.
    """
    height, width = jumps.shape
    for row in range(height):
        for column in range(width):
            if not wanted[row, column]:
                continue
            x = position[row, column, 0] - column
            y = position[row, column, 1] - row
            here = np.isfinite(x) and np.isfinite(y)
            for side in range(2):
                k = row + side
                m = column + 1 - side
                if k >= height or m >= width:
                    continue
                u = position[k, m, 0] - m
                v = position[k, m, 1] - k
                there = np.isfinite(u) and np.isfinite(v)
                if here != there or (here and (abs(u - x) > limit or abs(v - y) > limit)):
                    jumps[row, column] = 1
                    jumps[k, m] = 1


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
    before: tuple[npt.NDArray[np.uint8], Mask] | None = None,
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
    before : (bits, pixels to renew), optional
        Where only some are wanted: what the others keep.
    """
    nearest = np.full(reference_nearness.shape, -np.inf, np.float32)
    _nearest_landing(position, nearness, nearest)
    limits = np.array(
        [
            weight_threshold**2, depth_threshold, depth_threshold,
            (EDGE_STRICTNESS * weight_threshold) ** 2,
        ],
        np.float32,
    )  # fmt: skip
    flags, renewed = before or (np.empty(weights.shape, np.uint8), np.ones(weights.shape, bool))
    flags = flags.copy()
    side = 2 * EDGE_REACH + 1
    near = cv2.dilate(renewed.astype(np.uint8), np.ones((side, side), np.uint8)).astype(bool)
    jumps = jumps_of_motion(position, near)
    _flag(
        position, mean_squares(weights), nearness, known, reference_nearness, reference_known,
        nearest, jumps, within_reach(jumps, EDGE_REACH), limits, renewed, flags,
    )  # fmt: skip
    return flags


def mean_squares(weights: GreyImage) -> npt.NDArray[np.float32]:
    """Return the mean of the squares of 3 × 3 weights, those beyond the sides as those at them."""
    squares = np.empty(weights.shape, np.float32)
    _square(weights, np.float32(NO_WEIGHT), squares)
    return cv2.blur(squares, (3, 3), borderType=cv2.BORDER_REPLICATE)


@njit(nogil=True, cache=True, error_model="numpy")
def _square(weights, nothing, out):
    """Write the squares of weights, and something large where there is none."""
    for row in range(weights.shape[0]):
        for column in range(weights.shape[1]):
            square = weights[row, column] * weights[row, column]
            out[row, column] = square if square < np.inf else nothing


def jumps_of_motion(position: Positions, wanted: Mask | None = None) -> npt.NDArray[np.uint8]:
    """Return which pixels lie at a jump of the motion, (H, W), 1 where they do.

    A jump is a difference of more than ``EDGE_JUMP`` between the displacements of two
    adjacent pixels, so that a slanted surface has none; a pixel without a motion makes one.
    Looked for at pixels wanted, by default at all.
    """
    jumps = np.zeros(position.shape[:2], np.uint8)
    if wanted is None:
        wanted = np.ones(jumps.shape, np.bool_)
    _jumps(position, EDGE_JUMP, wanted, jumps)
    return jumps


def within_reach(jumps: npt.NDArray[np.uint8], reach: int) -> npt.NDArray[np.uint8]:
    """Return which pixels lie within reach of a jump; both pixels of it are within reach one."""
    side = 2 * (reach - 1) + 1
    return cv2.dilate(jumps, np.ones((side, side), np.uint8))


def count_rejections(flags: npt.NDArray[np.uint8]) -> dict[str, int]:
    """Return how many pixels carry each reason, by its lower-case name; all reasons listed."""
    counts = np.zeros((4, 256), np.int64)
    _count(np.ascontiguousarray(flags).reshape(-1), counts)
    sums = (counts.sum(axis=0) @ _HAS_REASON).tolist()
    return dict(zip(_REASONS, sums, strict=True))


@njit(nogil=True, cache=True, error_model="numpy")
def _count(flags, counts):
    """Count bytes, in place; in four tables, since equal ones beside each other would wait."""
    for index in range(flags.size):
        counts[index & 3, flags[index]] += 1
