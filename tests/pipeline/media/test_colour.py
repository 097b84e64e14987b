"""Luma and chroma and back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.colour import picture_from_grey, picture_from_rgb, to_grey, to_rgb

SHAPES = st.tuples(st.integers(1, 7), st.integers(1, 9))


@given(SHAPES.flatmap(lambda shape: arrays(np.uint8, (*shape, 3))))
def test_8_bit_rgb_comes_back_bit_for_bit(rgb):
    picture = picture_from_rgb(rgb, 255.0)
    assert picture.luma.shape == rgb.shape[:2]
    assert picture.luma.dtype == picture.chroma.dtype == np.float32
    np.testing.assert_array_equal(to_rgb(picture.luma, picture.chroma, 8), rgb)


@given(SHAPES.flatmap(lambda shape: arrays(np.uint16, (*shape, 3))))
def test_16_bit_rgb_comes_back_bit_for_bit(rgb):
    picture = picture_from_rgb(rgb, 65535.0)
    back = to_rgb(picture.luma, picture.chroma, 16)
    assert back.dtype == np.uint16
    np.testing.assert_array_equal(back, rgb)


@pytest.mark.parametrize(("dtype", "peak", "depth"), [("u1", 255, 8), ("u2", 65535, 16)])
def test_every_grey_value_comes_back(dtype, peak, depth):
    samples = np.arange(peak + 1).astype(dtype).reshape(2, -1)
    luma = picture_from_grey(samples, peak).luma
    assert luma.max() == pytest.approx(255)
    np.testing.assert_array_equal(to_grey(luma, depth), samples)


def test_10_bit_grey_is_written_on_the_full_16_bit_scale():
    samples = np.arange(1024, dtype=np.uint16).reshape(4, 256)
    stored = to_grey(picture_from_grey(samples, 1023.0).luma, 10)
    np.testing.assert_array_equal(stored, np.rint(samples * (65535 / 1023)))


def test_luma_is_opencv_s_before_its_rounding():
    rgb = np.random.default_rng(3).integers(0, 256, (31, 17, 3), dtype=np.uint8)
    rounded = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    difference = picture_from_rgb(rgb, 255.0).luma - rounded
    assert np.abs(difference).max() < 0.51
    assert np.abs(difference).max() > 0.3  # it is not rounded


def test_chroma_of_grey_is_128_and_of_primaries_is_jpeg_s():
    rgb = np.array([[[90, 90, 90], [0, 0, 255], [255, 0, 0]]], np.uint8)
    chroma = picture_from_rgb(rgb, 255.0).chroma
    np.testing.assert_allclose(chroma[0, 0], [128, 128], atol=1e-4)
    np.testing.assert_allclose(chroma[0, 1], [255.5, 107.27], atol=0.01)
    np.testing.assert_allclose(chroma[0, 2], [84.97, 255.5], atol=0.01)


def test_values_out_of_range_are_clipped():
    luma = np.array([[-3.0, 260.0, 12.4]], np.float32)
    np.testing.assert_array_equal(to_grey(luma, 8), [[0, 255, 12]])
    np.testing.assert_array_equal(to_rgb(luma, None, 16)[0, :, 1], [0, 65535, 3187])
