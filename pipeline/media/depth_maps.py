"""From stored depth values to nearness on the colour image's grid.

Nearness grows towards the camera and is proportional to inverse depth; NaN is unknown. Maps
of another size than the colour image are resampled without inventing values between surfaces.
"""

from __future__ import annotations

import functools

import numpy as np
import numpy.typing as npt

from pipeline.errors import SceneError
from pipeline.frames import Calibration, DepthMap
from pipeline.media.scene import DepthEncoding, DepthKind

AGREEMENT = 0.03
"""Neighbours that differ by no more than this share of a map's range are one surface."""

_RANGE_STRIDE = 3
_SMALL_MAP = 64 * 64


def nearness_from_stored(stored: npt.NDArray, encoding: DepthEncoding) -> DepthMap:
    """Return nearness from the numbers of a depth file.

    Parameters
    ----------
    stored : ndarray of shape (H, W), uint8, uint16 or float32
        As in the file. Infinite means unknown.
    encoding : DepthEncoding
        What the numbers mean; ``unknown`` is compared with the stored value.

    Returns
    -------
    ndarray of shape (H, W), float32
        New array. ``disparity`` and ``inverse_depth`` as they are, ``depth`` as 1 / z; NaN
        where unknown, and where z ≤ 0.

    Raises
    ------
    SceneError
        If a floating-point map holds NaN: unknown has its own value.
    """
    if np.issubdtype(stored.dtype, np.unsignedinteger) and stored.itemsize <= 2:
        return _of_every_number(stored.dtype.name, encoding)[stored]
    return _computed(stored, encoding)


@functools.lru_cache(maxsize=8)
def _of_every_number(dtype: str, encoding: DepthEncoding) -> DepthMap:
    """Return nearness by the number stored."""
    return _computed(np.arange(np.iinfo(dtype).max + 1, dtype=dtype), encoding)


def _computed(stored: npt.NDArray, encoding: DepthEncoding) -> DepthMap:
    known = np.ones(stored.shape, bool)
    if np.issubdtype(stored.dtype, np.floating):
        undefined = np.isnan(stored)
        if undefined.any():
            row, column = np.argwhere(undefined)[0]
            raise SceneError(
                f"NaN in the depth map at row {row}, column {column} ({int(undefined.sum())} in "
                "all); unknown depth is marked by the value of the key 'unknown', or infinite"
            )
        known = np.isfinite(stored)
    if encoding.unknown is not None:
        known &= stored != encoding.unknown
    value = np.full(stored.shape, np.nan, np.float64)
    np.multiply(stored, encoding.scale, out=value, where=known, dtype=np.float64)
    value += encoding.offset
    if encoding.kind is DepthKind.DEPTH:
        with np.errstate(divide="ignore", invalid="ignore"):
            value = np.where(value > 0, 1.0 / value, np.nan)
    nearness = value.astype(np.float32)
    nearness[~np.isfinite(nearness)] = np.nan
    return nearness


def resampled(nearness: DepthMap, shape: tuple[int, int]) -> DepthMap:
    """Return a map on another grid of the same field of view.

    Pixel areas are aligned: the centre of column x of W lies at (x + ½) · w / W − ½ of w.
    Where the four samples around a point belong to one surface (they agree within
    :data:`AGREEMENT` of the map's range) they are interpolated linearly; elsewhere the nearest
    sample is taken as it is, known or unknown. So no value is made that lies between two
    surfaces, and none is mixed with an unknown one.

    Parameters
    ----------
    nearness : ndarray of shape (h, w), float32
        NaN where unknown.
    shape : tuple of int
        (H, W) wanted.

    Returns
    -------
    ndarray of shape (H, W), float32
        The same array where the shape is the same, else a new one.
    """
    if nearness.shape == tuple(shape):
        return nearness
    row0, row1, down = _positions(nearness.shape[0], shape[0])
    column0, column1, across = _positions(nearness.shape[1], shape[1])
    nearest = nearness.take(np.where(down < 0.5, row0, row1), axis=0)
    nearest = nearest.take(np.where(across < 0.5, column0, column1), axis=1)
    top, bottom = nearness.take(row0, axis=0), nearness.take(row1, axis=0)
    low, high = np.minimum(top, bottom), np.maximum(top, bottom)
    low = np.minimum(low.take(column0, axis=1), low.take(column1, axis=1))
    high = np.maximum(high.take(column0, axis=1), high.take(column1, axis=1))
    bottom -= top
    bottom *= down[:, None]
    bottom += top
    linear, right = bottom.take(column0, axis=1), bottom.take(column1, axis=1)
    right -= linear
    right *= across
    linear += right
    with np.errstate(invalid="ignore"):
        one_surface = high - low <= np.float32(AGREEMENT * _range_of(nearness))
    np.copyto(nearest, np.clip(linear, low, high, out=linear), where=one_surface)
    return nearest


def camera_nearness(world_nearness: DepthMap, calibration: Calibration) -> DepthMap:
    """Return nearness along the camera's axis from nearness along the world's z axis.

    A pixel's ray is C + s · d with C the camera's centre and d = Rᵀ K⁻¹ (x, y, 1)ᵀ, whose
    third camera coordinate is 1, so that s is the depth wanted: s = (z_world − C_z) / d_z.

    Parameters
    ----------
    world_nearness : ndarray of shape (H, W), float32
        1 / z_world, on the colour image's grid; NaN where unknown.
    calibration : Calibration
        Of that view.

    Returns
    -------
    ndarray of shape (H, W), float32
        New array, 1 / s; NaN where unknown or behind the camera.
    """
    height, width = world_nearness.shape
    along_z = calibration.world_to_camera[:3, 2] @ np.linalg.inv(calibration.intrinsics)
    ray_z = (
        along_z[0] * np.arange(width)[None, :] + along_z[1] * np.arange(height)[:, None]
    ) + along_z[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        nearness = ray_z / (1.0 / world_nearness.astype(np.float64) - calibration.centre[2])
        nearness[~(np.isfinite(nearness) & (nearness > 0))] = np.nan
    return nearness.astype(np.float32)


def _positions(
    size: int, wanted: int
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], npt.NDArray[np.float32]]:
    at = np.clip((np.arange(wanted) + 0.5) * (size / wanted) - 0.5, 0, size - 1)
    before = np.floor(at).astype(np.intp)
    return before, np.minimum(before + 1, size - 1), (at - before).astype(np.float32)


def _range_of(nearness: DepthMap) -> float:
    sample = nearness
    if nearness.size > _SMALL_MAP:
        sample = nearness[::_RANGE_STRIDE, ::_RANGE_STRIDE]
    known = sample[np.isfinite(sample)]
    return float(np.ptp(known)) if known.size else 0.0
