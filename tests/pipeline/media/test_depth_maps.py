"""Stored depth to nearness, and to another grid."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import SceneError
from pipeline.frames import Calibration
from pipeline.media.depth_maps import (
    AGREEMENT,
    camera_nearness,
    nearness_from_stored,
    resampled,
)
from pipeline.media.scene import DepthEncoding, DepthKind

NAN = np.nan


def test_disparity_is_scaled_and_unknown_is_compared_as_stored():
    stored = np.array([[0, 4, 8]], np.uint8)
    encoding = DepthEncoding(kind=DepthKind.DISPARITY, scale=0.25, offset=-2.0, unknown=0)
    np.testing.assert_array_equal(nearness_from_stored(stored, encoding), [[NAN, -1.0, 0.0]])


def test_depth_becomes_its_inverse_and_what_is_not_in_front_is_unknown():
    stored = np.array([[0, 100, 400, 65535]], np.uint16)
    encoding = DepthEncoding(kind=DepthKind.DEPTH, scale=0.01, unknown=65535)
    nearness = nearness_from_stored(stored, encoding)
    assert nearness.dtype == np.float32
    np.testing.assert_allclose(nearness, [[NAN, 1.0, 0.25, NAN]])


@pytest.mark.parametrize("kind", DepthKind)
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, ">u2", np.int16])
def test_numbers_of_any_type_mean_the_same(kind, dtype):
    encoding = DepthEncoding(kind=kind, scale=0.3, offset=-2.0, unknown=7)
    stored = np.array([[0, 6, 7], [8, 100, 127]], dtype)
    as_float = nearness_from_stored(stored.astype(np.float32), encoding)
    np.testing.assert_array_equal(nearness_from_stored(stored, encoding), as_float)


def test_infinite_is_unknown_in_floating_point_and_nan_is_an_error():
    encoding = DepthEncoding(kind=DepthKind.INVERSE_DEPTH, scale=2.0)
    stored = np.array([[1.5, np.inf], [-np.inf, 2.0]], np.float32)
    np.testing.assert_array_equal(nearness_from_stored(stored, encoding), [[3.0, NAN], [NAN, 4.0]])
    stored[1, 0] = NAN
    with pytest.raises(SceneError, match="NaN in the depth map at row 1, column 0"):
        nearness_from_stored(stored, encoding)


SIZES = st.tuples(st.integers(1, 9), st.integers(1, 11))


@given(SIZES, SIZES, st.integers(0, 2**32 - 1))
def test_resampling_invents_nothing_between_surfaces(size, wanted, seed):
    rng = np.random.default_rng(seed)
    near, far = np.float32(8.0), np.float32(1.0)
    source = rng.choice([near, far, np.float32(NAN)], size=size)
    result = resampled(source, wanted)
    assert result.shape == wanted
    known = result[np.isfinite(result)]
    assert set(known.tolist()) <= set(source[np.isfinite(source)].tolist())


@given(SIZES, SIZES, st.integers(0, 2**32 - 1))
def test_resampling_takes_unknown_and_surface_of_the_nearest_sample(size, wanted, seed):
    rng = np.random.default_rng(seed)
    source = rng.normal(size=size).astype(np.float32)
    source[rng.random(size) < 0.3] = NAN
    result = resampled(source, wanted)
    at = [np.clip((np.arange(n) + 0.5) * s / n - 0.5, 0, s - 1)
          for s, n in zip(size, wanted, strict=True)]  # fmt: skip
    rows, columns = (np.floor(positions + 0.5).astype(int) for positions in at)
    nearest = source[np.ix_(rows, columns)]
    np.testing.assert_array_equal(np.isnan(result), np.isnan(nearest))
    known = source[np.isfinite(source)]
    tolerance = AGREEMENT * (np.ptp(known) if known.size else 0) + 1e-6
    difference = np.abs(result - nearest)[np.isfinite(nearest)]
    assert (difference <= tolerance).all()


def test_a_smooth_slope_is_interpolated_with_centres_aligned():
    height, width = 80, 60
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    slope = (100 + 0.5 * column + 0.25 * row).astype(np.float32)
    fine = resampled(slope, (160, 120))
    x, y = (np.arange(120) + 0.5) / 2 - 0.5, (np.arange(160) + 0.5) / 2 - 0.5
    expected = 100 + 0.5 * x[None, :] + 0.25 * y[:, None]
    np.testing.assert_allclose(fine[2:-2, 2:-2], expected[2:-2, 2:-2], atol=1e-4)
    coarse = resampled(slope, (40, 30))
    x, y = (np.arange(30) + 0.5) * 2 - 0.5, (np.arange(40) + 0.5) * 2 - 0.5
    np.testing.assert_allclose(coarse, 100 + 0.5 * x[None, :] + 0.25 * y[:, None], atol=1e-4)


def test_a_map_of_the_right_size_is_left_alone():
    source = np.ones((3, 5), np.float32)
    assert resampled(source, (3, 5)) is source


def test_world_depth_becomes_depth_along_the_camera_s_axis():
    angle = np.deg2rad(17)
    motion = np.eye(4)
    motion[:3, :3] = [
        [np.cos(angle), 0, -np.sin(angle)],
        [0, 1, 0],
        [np.sin(angle), 0, np.cos(angle)],
    ]
    motion[:3, 3] = [-3, 0.5, 2]
    camera = Calibration(
        intrinsics=np.array([[60.0, 0.5, 11], [0, 58, 7], [0, 0, 1]]), world_to_camera=motion
    )
    height, width = 15, 23
    column, row = np.meshgrid(np.arange(width), np.arange(height))
    depth = 20 + 0.3 * column + 0.1 * row
    rays = np.linalg.inv(camera.intrinsics) @ np.stack(
        [column.ravel(), row.ravel(), np.ones(column.size)]
    )
    points = rays * depth.ravel()
    world = motion[:3, :3].T @ (points - motion[:3, 3:])
    nearness = camera_nearness((1 / world[2]).reshape(depth.shape).astype(np.float32), camera)
    np.testing.assert_allclose(1 / nearness, depth, rtol=1e-4)
