"""The motion of a whole view: calibrated it is projection, fitted it withstands wrong matches."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.frames import Calibration
from pipeline.registration import parallax_kernels
from pipeline.registration.parallax import (
    MIN_MATCHES,
    ParallaxMotion,
    fit_parallax,
    from_calibration,
    identity,
    match_points,
)

WIDTH, HEIGHT = 320, 200


def _rotation(x: float, y: float, z: float) -> np.ndarray:
    """A rotation about the three axes, radians."""
    cx, sx, cy, sy, cz, sz = (f(a) for a in (x, y, z) for f in (np.cos, np.sin))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x


def _camera(angles=(0.0, 0.0, 0.0), at=(0.0, 0.0, 0.0), focal=350.0) -> Calibration:
    pose = np.eye(4)
    pose[:3, :3] = _rotation(*angles)
    pose[:3, 3] = -pose[:3, :3] @ np.array(at)
    intrinsics = np.array([[focal, 0.4, 158.0], [0, 1.03 * focal, 103.0], [0, 0, 1]])
    return Calibration(intrinsics=intrinsics, world_to_camera=pose)


def _project(camera: Calibration, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (N, 2) and depths (N,) of world points (N, 3)."""
    seen = (camera.projection @ np.column_stack([points, np.ones(len(points))]).T).T
    return seen[:, :2] / seen[:, 2:], seen[:, 2]


SMALL = st.floats(-0.05, 0.05)
AWAY = st.floats(-0.4, 0.4)


@given(
    angles=st.tuples(SMALL, SMALL, SMALL), at=st.tuples(AWAY, AWAY, AWAY), seed=st.integers(0, 99)
)
def test_from_calibration_is_projection_of_points_in_space(angles, at, seed):
    source = _camera((0.02, -0.01, 0.03), (0.1, 0.0, -0.2))
    reference = _camera(angles, at, focal=370.0)
    points = np.random.default_rng(seed).uniform([-1, -1, 3], [1, 1, 8], (40, 3))
    here, depth = _project(source, points)
    there, _ = _project(reference, points)
    landed = from_calibration(source, reference).land(here[:, 0], here[:, 1], 1 / depth)
    np.testing.assert_allclose(landed, there, atol=1e-7)


def test_the_way_back_is_the_way_back():
    source, reference = _camera((0.01, 0.02, -0.03)), _camera((0, 0.01, 0.02), (0.3, 0.05, -0.1))
    points = np.random.default_rng(5).uniform([-1, -1, 3], [1, 1, 8], (40, 3))
    here, depth = _project(source, points)
    there, depth_there = _project(reference, points)
    onto = from_calibration(source, reference).land(here[:, 0], here[:, 1], 1 / depth)
    back = from_calibration(reference, source).land(onto[:, 0], onto[:, 1], 1 / depth_there)
    np.testing.assert_allclose(onto, there, atol=1e-8)
    np.testing.assert_allclose(back, here, atol=1e-8)


def test_a_camera_onto_itself_and_the_identity_move_nothing():
    camera = _camera((0.1, 0.2, 0.3), (1, 2, 3))
    x, y = np.meshgrid(np.arange(5.0), np.arange(3.0))
    for motion in (from_calibration(camera, camera), identity()):
        landed = motion.land(x, y, 0.3)
        assert landed.shape == (3, 5, 2)
        np.testing.assert_allclose(landed, np.stack([x, y], axis=-1), atol=1e-9)
        np.testing.assert_allclose(motion.parallax(x, y, 0.3), 0, atol=1e-9)


@given(x=st.floats(0, WIDTH), y=st.floats(0, HEIGHT), nearness=st.floats(0.1, 0.4))
def test_parallax_is_the_derivative_of_landing(x, y, nearness):
    motion = from_calibration(_camera(), _camera((0.02, -0.03, 0.01), (0.3, -0.1, 0.2)))
    small = 1e-5
    difference = (motion.land(x, y, nearness + small) - motion.land(x, y, nearness - small)) / (
        2 * small
    )
    np.testing.assert_allclose(motion.parallax(x, y, nearness), difference, rtol=1e-5, atol=1e-5)


# --- fitting -----------------------------------------------------------------------------

TRUE_MOTION = ParallaxMotion(
    homography=np.array([[1.01, 0.02, -9.0], [-0.015, 0.995, 4.0], [2e-5, -3e-5, 1.0]]),
    epipole=np.array([60.0, -7.0, 0.02]),
)


def _matches(*, count=200, noise=0.15, wrong=0.4, seed=3, motion=TRUE_MOTION):
    """Points, where they land, their nearness; a share of them lands anywhere within 40 px."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([0, 0], [WIDTH, HEIGHT], (count, 2))
    nearness = np.where(rng.random(count) < 0.5, 0.2, 0.7) + rng.normal(0, 0.05, count)
    landed = motion.land(points[:, 0], points[:, 1], nearness) + rng.normal(0, noise, (count, 2))
    lost = rng.random(count) < wrong
    landed[lost] += rng.uniform(-40, 40, (lost.sum(), 2))
    return points, landed, nearness


def _errors(found: ParallaxMotion, motion=TRUE_MOTION) -> np.ndarray:
    """How far the two motions differ over the image and the depths, pixels."""
    x, y, d = np.meshgrid(
        np.linspace(0, WIDTH, 9), np.linspace(0, HEIGHT, 7), np.array([0.2, 0.45, 0.7])
    )
    return np.linalg.norm(found.land(x, y, d) - motion.land(x, y, d), axis=-1)


@pytest.mark.parametrize("seed", [3, 4, 5])
def test_a_fit_finds_the_motion_among_forty_per_cent_of_wrong_matches(seed):
    points, landed, nearness = _matches(seed=seed)
    found = fit_parallax(points, landed, nearness)
    assert np.median(_errors(found)) < 0.08
    assert _errors(found).max() < 0.4
    right = np.linalg.norm(TRUE_MOTION.land(*points.T, nearness) - landed, axis=1) < 0.6
    assert 0.9 * right.sum() <= found.num_inliers <= 1.1 * right.sum()
    assert 0.05 < found.residual < 0.3


def test_exact_matches_give_the_exact_motion():
    found = fit_parallax(*_matches(noise=0.0, wrong=0.0))
    assert _errors(found).max() < 0.02
    assert found.num_inliers == 200


def test_an_offset_and_a_factor_on_nearness_do_not_matter():
    """Stored depth is nearness times a factor plus an offset: the homography absorbs it."""
    points, landed, nearness = _matches()
    stored = 255 * nearness + 40
    found = fit_parallax(points, landed, stored)
    direct = fit_parallax(points, landed, nearness)
    np.testing.assert_allclose(
        found.land(points[:, 0], points[:, 1], stored),
        direct.land(points[:, 0], points[:, 1], nearness), atol=0.02,
    )  # fmt: skip


def test_a_start_replaces_the_sampling():
    points, landed, nearness = _matches(wrong=0.6)
    near = ParallaxMotion(
        homography=TRUE_MOTION.homography + np.array([[0, 0, 1.0], [0, 0, -0.7], [0, 0, 0]]),
        epipole=TRUE_MOTION.epipole,
    )
    found = fit_parallax(points, landed, nearness, start=near, tolerance=3.0)
    assert np.median(_errors(found)) < 0.1
    far = ParallaxMotion(homography=np.eye(3), epipole=np.array([0.0, 300.0, 0.0]))
    assert fit_parallax(points[:50], landed[:50], nearness[:50], start=far, tolerance=1.0) is None


def test_constant_nearness_leaves_a_homography():
    points, _, _ = _matches()
    flat = np.full(len(points), 0.4)
    there = TRUE_MOTION.land(points[:, 0], points[:, 1], flat)
    found = fit_parallax(points, there, flat)
    landed = found.land(points[:, 0], points[:, 1], flat)
    assert np.linalg.norm(landed - there, axis=1).max() < 0.05
    moved = found.parallax(points[:, 0], points[:, 1], flat)
    np.testing.assert_allclose(moved, 0, atol=1e-3)


@pytest.mark.parametrize("count", [0, 1, MIN_MATCHES - 1])
def test_too_few_matches_give_no_motion(count):
    points, landed, nearness = _matches(count=200, wrong=0.0)
    assert fit_parallax(points[:count], landed[:count], nearness[:count]) is None


def test_matches_that_agree_on_nothing_do_not_crash():
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 200, (30, 2))
    found = fit_parallax(points, rng.uniform(0, 5000, (30, 2)), rng.uniform(0, 1, 30))
    assert found is None or found.num_inliers < 30


def test_the_same_matches_give_the_same_motion():
    first, again = (fit_parallax(*_matches()) for _ in range(2))
    np.testing.assert_array_equal(first.homography, again.homography)
    np.testing.assert_array_equal(first.epipole, again.epipole)


@given(
    values=st.lists(st.sampled_from([0.0, 1.0, 2.5, -3.0, 7.0]) | st.floats(-9, 9), min_size=1),
    data=st.data(),
)
def test_the_number_of_a_rank_and_the_median_are_those_of_sorting(values, data):
    rank = data.draw(st.integers(0, len(values) - 1))
    room = np.array([*values, -99.0])  # what lies behind the count is left alone
    assert parallax_kernels.of_rank(room, len(values), rank) == sorted(values)[rank]
    np.testing.assert_array_equal(np.sort(room), np.sort([*values, -99.0]))
    assert parallax_kernels.middle_of(room, len(values)) == np.median(values)
    assert room[-1] == -99.0


# --- matching ----------------------------------------------------------------------------


def _texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A picture of sinusoids of periods from 5 to 15 pixels, grey levels."""
    rng = np.random.default_rng(11)
    total = np.full(np.broadcast(x, y).shape, 120.0)
    for _ in range(14):
        period, angle, phase = rng.uniform(5, 15), rng.uniform(0, np.pi), rng.uniform(0, 7)
        along = x * np.cos(angle) + y * np.sin(angle)
        total += 9 * np.sin(2 * np.pi * along / period + phase)
    return total.astype(np.float32)


@pytest.mark.parametrize("shift", [(7.0, 2.0), (-11.4, -1.6), (0.0, 0.0)])
def test_matching_finds_a_shift_unequal_along_x_and_y(shift):
    y, x = np.mgrid[:60, :96].astype(float)
    source, reference = _texture(x, y), _texture(x - shift[0], y - shift[1])
    points, landed = match_points(source, reference)
    assert len(points) > 60
    assert points.dtype == landed.dtype == np.float64
    away = np.abs(landed - points - shift).max(axis=1)
    assert np.median(away) < 0.3, "a start for the fits, no more"
    assert (away < 1.0).mean() > 0.85, "the rest has moved out of the picture"


def test_a_featureless_picture_or_a_tiny_one_gives_no_matches():
    flat = np.full((40, 60), 90, np.float32)
    noise = np.random.default_rng(0).uniform(0, 255, (9, 60)).astype(np.float32)
    for source, reference in ((flat, flat), (noise, noise), (flat[:1], flat[:1])):
        points, landed = match_points(source, reference)
        assert points.shape == landed.shape == (0, 2)


def test_unrelated_pictures_hardly_match():
    rng = np.random.default_rng(1)
    first, second = (
        cv2.GaussianBlur(rng.normal(100, 60, (50, 70)), (0, 0), 1.2).astype(np.float32)
        for _ in range(2)
    )
    points, _ = match_points(first, second)
    related, _ = match_points(first, first)
    assert len(related) > 50
    assert len(points) < 0.4 * len(related)


def test_brightness_and_contrast_do_not_matter_to_matching():
    y, x = np.mgrid[:50, :80].astype(float)
    source, reference = _texture(x, y), _texture(x - 5, y + 1)
    points, landed = match_points(source, (0.6 * reference + 40).astype(np.float32))
    away = np.abs(landed - points - [5, -1]).max(axis=1)
    assert len(points) > 50
    assert np.median(away) < 0.15


def test_the_speed_at_a_point_is_the_length_of_the_derivative():
    parallax = ParallaxMotion(
        homography=np.array([[0.98, 0.02, 5.0], [-0.01, 1.03, -2.0], [1e-4, -2e-4, 1.0]]),
        epipole=np.array([30.0, -4.0, 0.2]),
    )
    for nearness in (-0.5, 0.0, 1.5):
        expected = np.linalg.norm(parallax.parallax(70.0, 40.0, nearness))
        assert parallax.speed(70.0, 40.0, nearness) == pytest.approx(expected)
