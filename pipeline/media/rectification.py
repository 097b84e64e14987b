"""Nearness between two calibrated views: turn both so that rows correspond, match, turn back.

Both cameras are turned (in software) to look the same way, at right angles to the line between
their centres; then a point lies on the same row in both, and its disparity is
f · B / Z plus a constant.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import Calibration, DepthMap, GreyImage
from pipeline.media.stereo_matching import PairMatch, disparity_range, match_pair

STEEPEST = 0.85
"""Cosine between baseline and line of sight above which a pair is given up."""

LARGEST_GROWTH = 2.0
"""A turned picture may be this many times as wide or high as the original."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RectifiedPair:
    """How two views are turned so that rows correspond."""

    homographies: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
    """(3, 3) each: pixel of the view to pixel of its turned picture."""
    rays: tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
    """(3,) each: product with (x, y, 1) is Z of the turned camera over z of the camera."""
    size: tuple[int, int]
    """(width, height) of both turned pictures, pixels."""
    focal_baseline: float
    """f · B: disparity less ``disparity_offset``, times Z; pixels · scene units."""
    disparity_offset: float
    """Disparity of a point at infinity, pixels."""


def rectify(left: Calibration, right: Calibration, shape: tuple[int, int]) -> RectifiedPair | None:
    """Return the turn of both cameras that makes rows correspond.

    Parameters
    ----------
    left, right : Calibration
        x right, y down, z forward; pixels of the colour image.
    shape : tuple of int
        (H, W) of both pictures.

    Returns
    -------
    RectifiedPair or None
        None where the cameras stand in one place or behind one another, or look too
        differently.
    """
    baseline = right.centre - left.centre
    length = float(np.linalg.norm(baseline))
    forward = left.world_to_camera[2, :3] + right.world_to_camera[2, :3]
    if length < 1e-12 or np.linalg.norm(forward) < 1e-6:
        return None
    axis_x = baseline / length
    forward /= np.linalg.norm(forward)
    if abs(axis_x @ forward) > STEEPEST:
        return None
    axis_y = np.cross(forward, axis_x)
    axis_y /= np.linalg.norm(axis_y)
    rotation = np.stack([axis_x, axis_y, np.cross(axis_x, axis_y)])
    focal = float(np.mean([left.intrinsics[1, 1], right.intrinsics[1, 1]]))
    height, width = shape
    corners = np.array(
        [[0, width - 1, 0, width - 1], [0, 0, height - 1, height - 1], [1, 1, 1, 1]], np.float64
    )
    turns = []
    for camera in (left, right):
        turn = rotation @ camera.world_to_camera[:3, :3].T @ np.linalg.inv(camera.intrinsics)
        turns.append(turn)
    seen = [turn @ corners for turn in turns]
    if min(points[2].min() for points in seen) < 0.1:
        return None
    spans = [focal * points[:2] / points[2] for points in seen]
    top = min(points[1].min() for points in spans)
    bottom = max(points[1].max() for points in spans)
    lefts = [points[0].min() for points in spans]
    breadth = max(points[0].max() - edge for points, edge in zip(spans, lefts, strict=True))
    size = (int(np.ceil(breadth)) + 1, int(np.ceil(bottom - top)) + 1)
    if size[0] > LARGEST_GROWTH * width + 16 or size[1] > LARGEST_GROWTH * height + 16:
        return None
    homographies = tuple(
        np.array([[focal, 0, -edge], [0, focal, -top], [0, 0, 1]]) @ turn
        for turn, edge in zip(turns, lefts, strict=True)
    )
    return RectifiedPair(
        homographies=(homographies[0], homographies[1]),
        rays=(turns[0][2], turns[1][2]),
        size=size,
        focal_baseline=focal * length,
        disparity_offset=float(lefts[1] - lefts[0]),
    )


def match_calibrated_pair(
    left: GreyImage, right: GreyImage, left_camera: Calibration, right_camera: Calibration
) -> PairMatch:
    """Return metric nearness of both views of a calibrated pair.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), float32
        Luma, 0..255.
    left_camera, right_camera : Calibration
        Of these pictures.

    Returns
    -------
    PairMatch
        1 / z along each view's own axis, in inverse units of the calibration, on each view's
        own grid; NaN where unknown, everywhere if the pair cannot be rectified.
    """
    pair = rectify(left_camera, right_camera, (left.shape[0], left.shape[1]))
    if pair is None:
        unknown = np.full(left.shape, np.nan, np.float32)
        return PairMatch(left=unknown, right=unknown.copy())
    match = match_pair(*_turned(pair, left, right))
    maps = [
        _turned_back(disparity, pair, side, (left.shape[0], left.shape[1]))
        for side, disparity in enumerate((match.left, match.right))
    ]
    return PairMatch(left=maps[0], right=maps[1])


def calibrated_disparity_range(
    left: GreyImage, right: GreyImage, left_camera: Calibration, right_camera: Calibration
) -> tuple[float, float] | None:
    """Return the lowest and highest disparity of the rectified pair, less that at infinity.

    Parameters and units are those of :func:`match_calibrated_pair`; pixels, or None where
    nothing can be matched.
    """
    pair = rectify(left_camera, right_camera, (left.shape[0], left.shape[1]))
    if pair is None:
        return None
    span = disparity_range(*_turned(pair, left, right))
    if span is None:
        return None
    return span[0] - pair.disparity_offset, span[1] - pair.disparity_offset


def _turned(pair: RectifiedPair, left: GreyImage, right: GreyImage) -> tuple[GreyImage, GreyImage]:
    first, second = (
        np.asarray(
            cv2.warpPerspective(
                image,
                homography,
                pair.size,
                flags=cv2.INTER_CUBIC,
                borderMode=cv2.BORDER_REPLICATE,
            ),
            np.float32,
        )
        for image, homography in zip((left, right), pair.homographies, strict=True)
    )
    return np.clip(first, 0, 255), np.clip(second, 0, 255)


def _turned_back(
    disparity: DepthMap, pair: RectifiedPair, side: int, shape: tuple[int, int]
) -> DepthMap:
    """Return the nearness of a view from the disparity of its turned picture."""
    height, width = shape
    x, y = np.meshgrid(np.arange(width, dtype=np.float64), np.arange(height, dtype=np.float64))
    a = pair.homographies[side]
    depth_ratio = a[2, 0] * x + a[2, 1] * y + a[2, 2]
    at_x = ((a[0, 0] * x + a[0, 1] * y + a[0, 2]) / depth_ratio).astype(np.float32)
    at_y = ((a[1, 0] * x + a[1, 1] * y + a[1, 2]) / depth_ratio).astype(np.float32)
    nan = float("nan")
    nearest, linear = (
        cv2.remap(
            disparity, at_x, at_y, method, borderMode=cv2.BORDER_CONSTANT, borderValue=nan
        ).reshape(shape)
        for method in (cv2.INTER_NEAREST, cv2.INTER_LINEAR)
    )
    with np.errstate(invalid="ignore"):
        sampled = np.where(np.abs(linear - nearest) <= 0.5, linear, nearest)
        inverse_z = (sampled - pair.disparity_offset) / pair.focal_baseline
        ray = pair.rays[side]
        nearness = inverse_z * (ray[0] * x + ray[1] * y + ray[2])
        return np.where(nearness > 0, nearness, np.nan).astype(np.float32)
