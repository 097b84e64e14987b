"""What registration computes of a view once: splines that interpolate, gradients, clean depth."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.frames import View
from pipeline.registration import kernels
from pipeline.registration.prepare import prepare, spline_coefficients, spline_gradients

SHAPES = [(1, 1), (1, 9), (7, 1), (3, 5), (24, 37)]


def _picture(height: int, width: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, (height, width)).astype(np.float32)


def _sampled(coefficients: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    x, y = np.broadcast_arrays(x, y)
    points = zip(x.ravel().tolist(), y.ravel().tolist(), strict=True)
    values = [kernels.sample(coefficients, *point)[0] for point in points]
    return np.array(values, np.float32).reshape(x.shape)


def _grid(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(np.arange(shape[1], dtype=float), np.arange(shape[0], dtype=float))
    return x, y


@pytest.mark.parametrize("shape", SHAPES)
def test_sampling_at_whole_pixels_gives_the_pixels(shape):
    """The prefilter inverts the spline; nine of its taps leave 10⁻³ of the range."""
    image = _picture(*shape)
    sampled = _sampled(spline_coefficients(image), *_grid(shape))
    np.testing.assert_allclose(sampled, image, atol=0.25)


@pytest.mark.parametrize("shape", SHAPES)
@given(level=st.floats(0, 255, width=32), x=st.floats(-0.49, 0.49), y=st.floats(-0.49, 0.49))
def test_a_constant_stays_constant_between_pixels_and_has_no_gradient(shape, level, x, y):
    coefficients = spline_coefficients(np.full(shape, level, np.float32))
    at_x, at_y = _grid(shape)
    np.testing.assert_allclose(_sampled(coefficients, at_x + x, at_y + y), level, atol=1e-3)
    np.testing.assert_allclose(spline_gradients(coefficients), 0, atol=1e-3)


def test_a_ramp_is_sampled_where_it_is():
    x, y = _grid((20, 31))
    coefficients = spline_coefficients((40 + 3 * x - 2 * y).astype(np.float32))
    inner = np.s_[6:-6, 6:-6]
    sampled = _sampled(coefficients, x + 0.3, y - 0.45)
    np.testing.assert_allclose(sampled[inner], (40.0 + 3 * (x + 0.3) - 2 * (y - 0.45))[inner],
                               atol=0.02)  # fmt: skip
    gradients = spline_gradients(coefficients)
    np.testing.assert_allclose(gradients[0][inner], 3, atol=0.01)
    np.testing.assert_allclose(gradients[1][inner], -2, atol=0.01)


@given(x=st.floats(3, 30), y=st.floats(2, 15))
def test_the_gradient_is_the_difference_quotient(x, y):
    coefficients = spline_coefficients(_picture(18, 34)).astype(np.float64)
    # away from half pixels, where the second derivative of a quadratic spline jumps
    x, y = (np.floor(place) + 0.1 + 0.8 * (place % 1) - 0.5 for place in (x, y))
    small = 0.01
    value, gradient_x, gradient_y = kernels.sample(coefficients, x, y)
    right, _, _ = kernels.sample(coefficients, x + small, y)
    left, _, _ = kernels.sample(coefficients, x - small, y)
    below, _, _ = kernels.sample(coefficients, x, y + small)
    above, _, _ = kernels.sample(coefficients, x, y - small)
    assert np.isfinite(value)
    assert gradient_x == pytest.approx((right - left) / (2 * small), abs=0.15)
    assert gradient_y == pytest.approx((below - above) / (2 * small), abs=0.15)


@pytest.mark.parametrize("shape", SHAPES)
def test_outside_the_outermost_half_pixel_there_is_no_value(shape):
    coefficients = spline_coefficients(_picture(*shape))
    height, width = shape
    x = np.array([[-0.51, width - 0.49, 0.0, 0.0, np.nan, 0.0, 1e9, -np.inf]])
    y = np.array([[0.0, 0.0, -0.51, height - 0.49, 0.0, np.nan, 0.0, 0.0]])
    assert np.isnan(_sampled(coefficients, x, y)).all()
    x = np.array([[-0.49, width - 0.51]])
    y = np.array([[height - 0.51, -0.49]])
    assert np.isfinite(_sampled(coefficients, x, y)).all()


# --- views -------------------------------------------------------------------------------


def _view(luma: np.ndarray, depth_map: np.ndarray | None = None) -> View:
    return View(view_id="v", luma=luma, depth_map=depth_map)


def test_levels_halve_and_stop_before_nothing_is_left():
    view = prepare(_view(_picture(60, 101)), 5)
    assert [level.image.shape for level in view.levels] == [(60, 101), (30, 51), (15, 26)]
    for level in view.levels:
        assert level.nearness.shape == level.gradient_x.shape == level.image.shape
        height, width = level.image.shape
        assert level.coefficients.shape == (height + 4, width + 4)
    assert view.raw_coefficients.shape == (64, 105)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("depth", [None, "flat", "unknown", "half"])
def test_tiny_views_and_poor_depth_are_prepared(shape, depth):
    depth_map = None if depth is None else np.full(shape, 3.5, np.float32)
    if depth == "unknown":
        depth_map[:] = np.nan
    elif depth == "half":
        depth_map[:, shape[1] // 2 :] = np.nan
    view = prepare(_view(_picture(*shape), depth_map), 5)
    for level in view.levels:
        for array in (level.image, level.coefficients, level.nearness, level.gradient_x):
            assert np.isfinite(array).all()
    assert view.known.sum() == (0 if depth_map is None else np.isfinite(depth_map).sum())
    assert view.depth_range == 0


def test_depth_is_cleaned_of_single_wrong_pixels_but_keeps_its_step():
    depth_map = np.full((30, 40), 20, np.float32)
    depth_map[:, 22:] = 60
    noisy = depth_map.copy()
    noisy[7, 9] = 200
    noisy[20, 33] = 0
    noisy[12:15, 3:5] = np.nan
    view = prepare(_view(_picture(30, 40), noisy), 1)
    np.testing.assert_array_equal(view.fine.nearness, depth_map)
    assert view.depth_range == 40
    assert (~view.known).sum() == 6


def test_coarse_pixels_lie_on_every_second_fine_one():
    """Picture and depth of a level: pixel (i, j) is pixel (2·i, 2·j) of the level before."""
    x, y = _grid((64, 98))
    ramp = (20 + 1.5 * x + 0.7 * y).astype(np.float32)
    view = prepare(_view(ramp, ramp), 3)
    assert len(view.levels) == 3
    for number, level in enumerate(view.levels):
        step = 2**number
        inner = np.s_[4:-4, 4:-4]
        np.testing.assert_allclose(level.image[inner], ramp[::step, ::step][inner], atol=0.02)
        np.testing.assert_allclose(level.nearness[inner], ramp[::step, ::step][inner], atol=0.02)
        np.testing.assert_allclose(level.gradient_x[inner], 1.5 * step, rtol=0.01)
        np.testing.assert_allclose(level.gradient_y[inner], 0.7 * step, rtol=0.01)


def test_the_value_alone_is_that_of_the_whole_sample():
    coefficients = spline_coefficients(_picture(12, 17))
    x, y = np.random.default_rng(3).uniform(-2, 18, (2, 9, 30)).astype(np.float32)
    found = [kernels.value_at(coefficients, *at) for at in zip(x.ravel(), y.ravel(), strict=True)]
    expected = _sampled(coefficients, x, y)
    assert 0.2 < np.isnan(expected).mean() < 0.8
    np.testing.assert_allclose(np.reshape(found, x.shape), expected, rtol=1e-4, atol=1e-3)


def test_smoothing_tames_noise_but_not_the_raw_coefficients():
    luma = np.random.default_rng(5).normal(100, 10, (40, 50)).astype(np.float32)
    view = prepare(_view(luma), 1)
    assert view.fine.image.std() < 0.6 * luma.std()
    raw = _sampled(view.raw_coefficients, *_grid((40, 50)))
    np.testing.assert_allclose(raw, luma, atol=0.25)
    sharp = prepare(_view(luma), 1, smoothing=0.0)
    np.testing.assert_array_equal(sharp.fine.image, luma)


def test_the_view_is_not_modified():
    luma, depth_map = _picture(20, 30), np.full((20, 30), np.nan, np.float32)
    before = luma.copy()
    prepare(_view(luma, depth_map), 4)
    np.testing.assert_array_equal(luma, before)
    assert np.isnan(depth_map).all()
