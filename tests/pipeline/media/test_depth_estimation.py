"""Depth from neighbouring views, against scenes whose depth is known."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.frames import Calibration, View
from pipeline.media.depth_estimation import (
    chosen_pairs,
    estimate_missing_depth,
    fitted_scale,
    merged,
)
from pipeline.media.source import open_scene
from pipeline.media.stereo_matching import match_pair

HEIGHT, WIDTH = 120, 200


def row_of_views(positions, *, near=9.0, far=2.0, make_texture, seed=0) -> list[View]:
    """Return pictures of a near square before a far wall from cameras at those x positions.

    A surface of nearness n is shifted to the left by n · position pixels.
    """
    wall = make_texture((HEIGHT, 2 * WIDTH), seed).astype(np.float32)
    square = make_texture((50, 70), seed + 1).astype(np.float32)
    views = []
    for index, position in enumerate(positions):
        columns = np.arange(WIDTH, dtype=np.float32)[None, :].repeat(HEIGHT, 0)
        rows = np.arange(HEIGHT, dtype=np.float32)[:, None].repeat(WIDTH, 1)
        luma = cv2.remap(
            wall, columns + np.float32(far * position + WIDTH / 2), rows, cv2.INTER_CUBIC
        )
        at = columns + np.float32(near * position - 60)
        inside = (at >= 0) & (at <= 69) & (rows >= 30) & (rows < 80)
        over = cv2.remap(square, at, rows - 30, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        luma = np.where(inside, over, luma).astype(np.float32)
        depth_map = np.where(inside, near, far).astype(np.float32)
        views.append(View(view_id=str(index), luma=luma, depth_map=depth_map))
    return views


def bare(views, indices=None) -> list[View]:
    return [
        replace(view, depth_map=None) if indices is None or index in indices else view
        for index, view in enumerate(views)
    ]


def errors(estimated: View, truth: View) -> np.ndarray:
    difference = np.abs(estimated.depth_map - truth.depth_map)
    return difference[np.isfinite(difference)]


@pytest.mark.parametrize(("near", "far"), [(9.0, 2.0), (24.0, 11.0), (3.0, -5.0), (-2.0, -9.0)])
def test_disparities_of_either_sign_are_found(make_texture, near, far):
    views = row_of_views((0, 1), near=near, far=far, make_texture=make_texture)
    for estimated, truth in zip(
        estimate_missing_depth(bare(views), depth_is_metric=False), views, strict=True
    ):
        assert estimated.depth_is_estimated
        found = errors(estimated, truth)
        assert found.size > 0.75 * HEIGHT * WIDTH
        assert np.median(found) < 0.15
        assert (found > 1).mean() < 0.06


def test_small_parallax_is_found_between_views_further_apart(make_texture):
    positions = np.arange(7) * 0.1
    views = row_of_views(positions, near=9.0, far=-4.0, make_texture=make_texture)
    estimated = estimate_missing_depth(bare(views), depth_is_metric=False)
    for view, truth in zip(estimated, views, strict=True):
        both = np.isfinite(view.depth_map)
        assert both.mean() > 0.7
        fit = np.polyfit(view.depth_map[both], truth.depth_map[both], 1)
        assert fit[0] > 0
        residual = np.abs(np.polyval(fit, view.depth_map[both]) - truth.depth_map[both])
        assert np.median(residual) < 0.05 * 13
    near = [np.median(view.depth_map[45:65, 70:110]) for view in estimated]
    assert np.ptp(near) < 0.1 * max(near)  # all on one scale


def test_unequal_spacing_gives_one_scale(make_texture):
    views = row_of_views((0, 1, 3.5, 4.2), make_texture=make_texture)
    estimated = estimate_missing_depth(bare(views), depth_is_metric=False)
    near = [np.nanmedian(view.depth_map[truth.depth_map == 9])
            for view, truth in zip(estimated, views, strict=True)]  # fmt: skip
    far = [np.nanmedian(view.depth_map[truth.depth_map == 2])
           for view, truth in zip(estimated, views, strict=True)]  # fmt: skip
    np.testing.assert_allclose(near, near[0], rtol=0.04)
    np.testing.assert_allclose(far, far[0], rtol=0.08)


def test_an_estimate_takes_the_units_of_given_depth(make_texture):
    views = row_of_views((0, 1, 2), make_texture=make_texture)
    given_units = [replace(view, depth_map=0.03 * view.depth_map + 5) for view in views]
    for missing in (0, 1, 2):
        estimated = estimate_missing_depth(bare(given_units, {missing}), depth_is_metric=False)
        for index, (view, truth) in enumerate(zip(estimated, given_units, strict=True)):
            assert view.depth_is_estimated == (index == missing)
            if index != missing:
                assert view is not None
                assert view.depth_map is truth.depth_map or np.array_equal(
                    view.depth_map, truth.depth_map
                )
        assert np.median(errors(estimated[missing], given_units[missing])) < 0.01


def test_calibrated_views_on_an_arc_give_metric_depth(make_texture):
    """A slanted wall, seen by two cameras that turn inwards and roll, against its equation."""
    intrinsics = np.array([[220.0, 0, 100.0], [0, 222.0, 61.0], [0, 0, 1]])
    normal, distance = np.array([0.25, -0.1, 1.0]), 12.0  # plane: normal · X = distance
    texture = make_texture((600, 800), 4).astype(np.float32)
    views = []
    for side, angle, roll in ((-0.6, 0.05, 0.01), (0.6, -0.05, -0.015)):
        turn, _ = cv2.Rodrigues(np.array([0, angle, 0.0]))
        rolled, _ = cv2.Rodrigues(np.array([0.02, 0, roll]))
        motion = np.eye(4)
        motion[:3, :3] = rolled @ turn
        motion[:3, 3] = -motion[:3, :3] @ [side, 0.1 * side, 0.2 * side]
        camera = Calibration(intrinsics=intrinsics, world_to_camera=motion)
        x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
        rays = np.linalg.inv(intrinsics) @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
        world_rays = motion[:3, :3].T @ rays
        depth = (distance - normal @ camera.centre) / (normal @ world_rays)
        points = camera.centre[:, None] + depth * world_rays
        luma = cv2.remap(
            texture,
            (400 + 22 * points[0]).reshape(x.shape).astype(np.float32),
            (300 + 22 * points[1]).reshape(x.shape).astype(np.float32),
            cv2.INTER_CUBIC,
        )
        views.append(
            View(
                view_id=str(side),
                luma=luma,
                depth_map=(1 / depth).reshape(x.shape).astype(np.float32),
                calibration=camera,
            )
        )
    for estimated, truth in zip(
        estimate_missing_depth(bare(views), depth_is_metric=True), views, strict=True
    ):
        known = np.isfinite(estimated.depth_map)
        assert known.mean() > 0.6
        relative = (estimated.depth_map / truth.depth_map)[known]
        assert abs(np.median(relative) - 1) < 0.005
        assert (np.abs(relative - 1) > 0.05).mean() < 0.05


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (3, 5), (11, 300), (12, 12), (13, 17)])
def test_tiny_pictures_do_not_crash(make_texture, shape):
    views = [View(view_id=str(i), luma=make_texture(shape, i).astype(np.float32)) for i in range(3)]
    for view in estimate_missing_depth(views, depth_is_metric=False):
        assert view.depth_map.shape == shape
        if min(shape) < 12:
            assert np.isnan(view.depth_map).all()


def test_pictures_of_nothing_have_no_depth():
    views = [View(view_id=str(i), luma=np.full((60, 90), 16, np.float32)) for i in range(2)]
    for view in estimate_missing_depth(views, depth_is_metric=False):
        assert view.depth_is_estimated
        assert np.isnan(view.depth_map).all()


def test_cameras_in_one_place_or_in_line_have_no_depth(make_texture):
    picture = make_texture((40, 60), 1).astype(np.float32)
    for shift in ([0, 0, 0], [0, 0, 1.0]):
        views = []
        for index in range(2):
            motion = np.eye(4)
            motion[:3, 3] = index * np.array(shift)
            camera = Calibration(
                intrinsics=np.array([[50.0, 0, 30], [0, 50, 20], [0, 0, 1]]), world_to_camera=motion
            )
            views.append(View(view_id=str(index), luma=picture, calibration=camera))
        for view in estimate_missing_depth(views, depth_is_metric=True):
            assert np.isnan(view.depth_map).all()


def test_the_result_does_not_depend_on_the_number_of_threads(make_texture):
    left, right = row_of_views((0, 1), make_texture=make_texture)
    before = cv2.getNumThreads()
    results = []
    try:
        for threads in (1, 2, 3):
            cv2.setNumThreads(threads)
            results.append(match_pair(left.luma, right.luma).left)
    finally:
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[0], results[2])


@given(st.integers(2, 12), st.integers(1, 14), st.data())
def test_every_view_without_depth_gets_a_partner(num_views, step, data):
    missing = sorted(data.draw(st.sets(st.integers(0, num_views - 1), min_size=1)))
    pairs = chosen_pairs(num_views, missing, step)
    assert pairs == sorted(set(pairs))
    assert all(0 <= left < right < num_views for left, right in pairs)
    assert set(missing) <= {view for pair in pairs for view in pair}
    if len(missing) == num_views:  # then all must hang together, to be on one scale
        joined = {0}
        for _ in range(num_views):
            joined |= {view for pair in pairs if joined & set(pair) for view in pair}
        assert joined == set(range(num_views))


@given(st.floats(0.01, 50), st.floats(-20, 20), st.integers(0, 1000))
def test_a_change_of_units_is_recovered_in_spite_of_outliers(factor, offset, seed):
    rng = np.random.default_rng(seed)
    measured = rng.uniform(-3, 9, (30, 40)).astype(np.float32)
    wanted = (factor * measured + offset).astype(np.float32)
    wanted[rng.random(wanted.shape) < 0.1] = 1e3
    measured[rng.random(wanted.shape) < 0.2] = np.nan
    scale = fitted_scale(measured, wanted)
    assert scale.factor == pytest.approx(factor, rel=0.01)
    assert scale.offset == pytest.approx(offset, abs=0.05 * factor + 0.01)


def test_maps_that_share_too_little_have_no_common_scale():
    measured = np.full((30, 40), np.nan, np.float32)
    assert fitted_scale(measured, np.ones((30, 40), np.float32)) is None


def test_maps_are_merged_where_they_agree():
    first = np.array([[1.0, 2.0, np.nan, 4.0, np.nan]], np.float32)
    second = np.array([[1.1, np.nan, 3.0, 9.0, np.nan]], np.float32)
    np.testing.assert_allclose(merged([first, second]), [[1.05, 2.0, 3.0, np.nan, np.nan]])


# the real scenes: measured against the depth they come with


REAL = {"cones": (0.25, 0.06, 0.8), "art": (0.4, 0.15, 0.65), "kitti": (0.2, 0.03, 0.85)}


@pytest.mark.parametrize("name", REAL)
def test_real_pairs_are_matched_like_their_ground_truth(scenes_dir, name):
    median, wrong, known = REAL[name]
    with open_scene(scenes_dir / name) as source:
        frame = source.read(0)
    for view, truth in zip(
        estimate_missing_depth(bare(frame.views), depth_is_metric=False), frame.views, strict=True
    ):
        found = errors(view, truth)
        assert np.isfinite(view.depth_map).mean() > known
        assert np.median(found) < median  # pixels
        assert (found > 1).mean() < wrong


def test_a_real_calibrated_pair_gives_metric_depth(scenes_dir):
    with open_scene(scenes_dir / "flower", views=["image003", "image004"]) as source:
        frame = source.read(0)
    for view, truth in zip(
        estimate_missing_depth(bare(frame.views), depth_is_metric=True), frame.views, strict=True
    ):
        both = np.isfinite(view.depth_map)
        assert both.mean() > 0.8
        ratio = (view.depth_map / truth.depth_map)[both]
        assert abs(np.median(ratio) - 1) < 0.02
        assert (np.abs(ratio - 1) > 0.2).mean() < 0.1
