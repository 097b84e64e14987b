"""Patches: windows cover the image and are cut at depth steps; strips are the thesis' L x R."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.registration.layers import layer_thresholds
from pipeline.registration.patches import (
    MAX_PARTS,
    Patches,
    cut_windows,
    fill_unknown,
    layer_strips,
)

OPTIONS = {"spacing": 10, "half": 10, "tolerance": 1.0, "min_support": 40}


def _members(patches: Patches, index: int, nearness: np.ndarray) -> np.ndarray:
    """(H, W) bool: the pixels that belong to a patch, by its window and its range."""
    x0, y0, x1, y1 = patches.windows[index]
    low, high = patches.ranges[index]
    inside = np.zeros(nearness.shape, bool)
    block = nearness[y0:y1, x0:x1]
    inside[y0:y1, x0:x1] = (low <= block) & (block < high)
    return inside


def _step(shape=(32, 54), at=27, far=10.0, near=40.0) -> np.ndarray:
    nearness = np.full(shape, far, np.float32)
    nearness[:, at:] = near
    return nearness


SIZES = st.tuples(st.integers(1, 37), st.integers(1, 43))


@given(size=SIZES, seed=st.integers(0, 99), spread=st.sampled_from([0.0, 0.3, 20.0]))
@example(size=(1, 43), seed=0, spread=20.0)
@example(size=(3, 5), seed=0, spread=20.0)
def test_windows_cover_the_image_and_parts_of_a_window_share_no_pixel(size, seed, spread):
    nearness = np.random.default_rng(seed).normal(50, spread, size).astype(np.float32)
    patches = cut_windows(nearness, **OPTIONS)
    covered = np.zeros(size, int)
    windows = np.zeros(size, int)
    for index in range(len(patches.windows)):
        members = _members(patches, index, nearness)
        assert members.sum() == patches.support[index] > 0
        covered += members
    for x0, y0, x1, y1 in np.unique(patches.windows, axis=0):
        assert 0 <= x0 < x1 <= size[1]
        assert 0 <= y0 < y1 <= size[0]
        windows[y0:y1, x0:x1] += 1
    assert covered.min() >= 1
    np.testing.assert_array_equal(covered, windows)


def test_a_window_over_a_depth_step_is_cut_there():
    nearness = _step()
    patches = cut_windows(nearness, **OPTIONS)
    over_step = (patches.windows[:, 0] < 27 - 2) & (patches.windows[:, 2] > 27 + 2)
    assert over_step.any()
    for index in np.flatnonzero(over_step):
        members = _members(patches, index, nearness)
        assert np.ptp(nearness[members]) == 0
        assert patches.planes[index, 0] == pytest.approx(nearness[members].mean(), abs=1e-3)
        np.testing.assert_allclose(patches.planes[index, 1:], 0, atol=1e-3)
    both = np.unique(patches.windows[over_step], axis=0)
    assert over_step.sum() == 2 * len(both)


def test_a_cut_lies_in_the_middle_of_the_gap():
    """Depth maps are noisy: a threshold close to one surface would tear pixels off it."""
    patches = cut_windows(_step(far=10.0, near=40.0), **OPTIONS)
    cuts = patches.ranges[np.isfinite(patches.ranges)]
    assert cuts.size > 0
    np.testing.assert_allclose(cuts, 25.0, atol=1.0)


def test_a_slanted_plane_is_not_cut_and_its_slope_is_known():
    y, x = np.mgrid[:35, :48].astype(np.float32)
    nearness = 30 + np.float32(0.4) * x - np.float32(0.2) * y
    patches = cut_windows(nearness, **OPTIONS)
    assert len(np.unique(patches.windows, axis=0)) == len(patches.windows)
    assert np.isinf(patches.ranges).all()
    whole = patches.support == 400
    assert whole.any()
    x0, y0, x1, y1 = patches.windows[whole].T
    xc, yc = 0.5 * (x0 + x1 - 1), 0.5 * (y0 + y1 - 1)
    np.testing.assert_allclose(patches.planes[whole, 0], 30 + 0.4 * xc - 0.2 * yc, atol=1e-3)
    # ten pixels are one unit of X and Y; a small ridge shortens the slope a little
    np.testing.assert_allclose(patches.planes[whole, 1], 4.0, rtol=0.1)
    np.testing.assert_allclose(patches.planes[whole, 2], -2.0, rtol=0.1)


def test_a_steep_plane_is_not_cut_either():
    _, x = np.mgrid[:40, :40].astype(np.float32)
    patches = cut_windows(np.float32(9.0) * x, **OPTIONS)
    assert len(np.unique(patches.windows, axis=0)) == len(patches.windows)


def test_filled_depth_may_be_written_to_whatever_came_in():
    """Read-only input must not reach the kernels as such: each kind is compiled apart."""
    whole = np.ones((3, 5), np.float32)
    whole.flags.writeable = False
    assert fill_unknown(whole).flags.writeable


def test_three_surfaces_make_three_parts_and_no_more():
    nearness = np.full((20, 20), 10, np.float32)
    nearness[:, 6:13] = 40
    nearness[:, 13:] = 90
    options = OPTIONS | {"spacing": 20}
    patches = cut_windows(nearness, **options)
    assert sorted(patches.support.tolist()) == [120, 140, 140]
    assert sorted(patches.planes[:, 0].round(3).tolist()) == [10, 40, 90]
    chaos = np.random.default_rng(1).uniform(0, 1000, (20, 20)).astype(np.float32)
    assert len(cut_windows(chaos, **options).windows) == MAX_PARTS


def test_no_part_is_smaller_than_the_support_asked_for():
    nearness = _step(shape=(20, 20), at=18)
    patches = cut_windows(nearness, **OPTIONS | {"spacing": 20, "min_support": 40})
    assert sorted(patches.support.tolist()) == [40, 360]
    patches = cut_windows(nearness, **OPTIONS | {"spacing": 20, "min_support": 41})
    assert patches.support.tolist() == [400], "40 pixels are too few: not cut"


def test_below_the_tolerance_depth_is_left_whole():
    assert np.isinf(cut_windows(_step(near=10.5), **OPTIONS).ranges).all()
    assert np.isinf(cut_windows(_step(), **OPTIONS | {"tolerance": float("inf")}).ranges).all()


@pytest.mark.parametrize("num_subregions", [1, 3, 4])
def test_strips_are_layers_times_subregions_in_that_order(num_subregions):
    nearness = np.random.default_rng(2).uniform(0, 100, (18, 31)).astype(np.float32)
    thresholds = np.array([-np.inf, 25.0, 60.0, np.inf])
    patches = layer_strips(nearness, thresholds, num_subregions)
    assert len(patches.windows) == 3 * num_subregions
    number = np.full(nearness.shape, -1)
    for index in range(len(patches.windows)):
        members = _members(patches, index, nearness)
        assert (number[members] == -1).all(), "no pixel is in two patches"
        assert patches.support[index] == members.sum()
        number[members] = index
    assert (number >= 0).all()
    layer = (nearness >= 25).astype(int) + (nearness >= 60)
    np.testing.assert_array_equal(number // num_subregions, layer)
    strip = number % num_subregions
    assert (np.diff(strip, axis=1)[np.diff(layer, axis=1) == 0] >= 0).all()
    widths = patches.windows[:num_subregions, 2] - patches.windows[:num_subregions, 0]
    assert np.ptp(widths) <= 1
    assert widths.sum() == 31


def test_an_empty_strip_keeps_its_number():
    nearness = _step(shape=(6, 12), at=6)
    patches = layer_strips(nearness, layer_thresholds(nearness, 2), 2)
    assert patches.support.tolist() == [36, 0, 0, 36]
    assert patches.planes[:, 0].tolist() == [10, 0, 0, 40]


# --- unknown depth -----------------------------------------------------------------------

MAPS = hnp.arrays(
    np.float32,
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=9),
    elements=st.one_of(st.just(np.nan), st.floats(0, 100, width=32)),
)


def _filled_by_hand(row: np.ndarray, column: int) -> float:
    left = row[:column][np.isfinite(row[:column])]
    right = row[column + 1 :][np.isfinite(row[column + 1 :])]
    return min([*left[-1:], *right[:1]])


@given(depth_map=MAPS)
def test_what_is_known_stays_and_what_is_not_takes_the_farther_neighbour_of_its_row(depth_map):
    known = np.isfinite(depth_map)
    filled = fill_unknown(depth_map)
    assert filled.dtype == np.float32
    assert filled.shape == depth_map.shape
    assert np.isfinite(filled).all()
    np.testing.assert_array_equal(filled[known], depth_map[known])
    for row, column in np.argwhere(~known & known.any(axis=1, keepdims=True)):
        assert filled[row, column] == _filled_by_hand(depth_map[row], column)


@given(depth_map=MAPS)
def test_filling_invents_no_depth_and_a_second_time_does_nothing(depth_map):
    filled = fill_unknown(depth_map)
    known = depth_map[np.isfinite(depth_map)]
    assert np.isin(filled, known).all() if known.size else not filled.any()
    np.testing.assert_array_equal(fill_unknown(filled), filled)


@given(depth_map=MAPS)
def test_filling_does_not_care_which_way_the_row_runs(depth_map):
    mirrored = fill_unknown(np.ascontiguousarray(depth_map[:, ::-1]))
    np.testing.assert_array_equal(mirrored[:, ::-1], fill_unknown(depth_map))


def test_a_row_without_depth_takes_the_nearest_row():
    nan = np.nan
    depth_map = np.array([[nan] * 3, [nan, 5, 3], [nan] * 3, [nan] * 3, [8, nan, 7]], np.float32)
    assert fill_unknown(depth_map).tolist() == [
        [5, 5, 3], [5, 5, 3], [5, 5, 3], [8, 7, 7], [8, 7, 7],
    ]  # fmt: skip


def test_infinite_depth_counts_as_unknown():
    depth_map = np.array([[np.inf, 4, -np.inf]], np.float32)
    assert fill_unknown(depth_map).tolist() == [[4, 4, 4]]
