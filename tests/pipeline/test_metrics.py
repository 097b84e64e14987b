from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.metrics import psnr, ssim, ssim_map


def _picture(shape: tuple[int, int], seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, shape)


def test_psnr_by_hand():
    reference = np.zeros((2, 3))
    image = np.array([[0, 0, 0], [0, 6, 0]], dtype=float)  # mean squared error 36 / 6 = 6
    assert psnr(image, reference) == pytest.approx(10 * math.log10(255**2 / 6))
    assert psnr(image, reference, peak=10) == pytest.approx(10 * math.log10(100 / 6))


def test_psnr_of_identical_images_is_infinite():
    assert psnr(_picture((5, 7)), _picture((5, 7))) == math.inf


def test_border_is_left_out_on_all_four_sides():
    reference = np.zeros((7, 9))
    image = np.full((7, 9), 200.0)
    image[2:5, 2:7] = 1.0
    assert psnr(image, reference, border=2) == pytest.approx(20 * math.log10(255))
    assert psnr(image, reference, border=1) < 20


def test_eight_bit_images_do_not_wrap_around():
    assert psnr(np.full((3, 4), 255, np.uint8), np.zeros((3, 4), np.uint8)) == pytest.approx(0)


@given(offset=st.floats(0.5, 100), scale=st.integers(2, 5))
def test_psnr_falls_by_twenty_decades_of_the_error(offset: float, scale: int):
    reference = _picture((6, 8))
    once, more = psnr(reference + offset, reference), psnr(reference + scale * offset, reference)
    assert once - more == pytest.approx(20 * math.log10(scale), abs=1e-9)


def test_shapes_must_agree_and_the_border_must_leave_something():
    with pytest.raises(ValueError, match="differ in shape"):
        psnr(np.zeros((3, 4)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match="leaves nothing"):
        psnr(np.zeros((6, 40)), np.zeros((6, 40)), border=3)
    with pytest.raises(ValueError, match="11×11"):
        ssim(np.zeros((10, 40)), np.zeros((10, 40)))


def test_ssim_of_identical_images_is_one_and_is_symmetric():
    first, second = _picture((20, 31)), _picture((20, 31), seed=4)
    assert ssim(first, first) == pytest.approx(1.0)
    assert ssim(first, second) == pytest.approx(ssim(second, first))
    assert ssim(first, second) < 0.2


def test_ssim_of_constant_images_by_hand():
    # No variance: (2ab + c1) / (a² + b² + c1), with c1 = (0.01 · 255)².
    c1 = (0.01 * 255) ** 2
    expected = (2 * 100 * 110 + c1) / (100**2 + 110**2 + c1)
    assert ssim(np.full((11, 14), 100.0), np.full((11, 14), 110.0)) == pytest.approx(expected)


def test_ssim_window_by_hand():
    """One window, summed explicitly with the 11×11 Gaussian of Wang 2004."""
    first, second = _picture((11, 11)), _picture((11, 11), seed=9)
    y, x = np.mgrid[-5:6, -5:6]
    window = np.exp(-(x**2 + y**2) / (2 * 1.5**2))
    window /= window.sum()
    mean_1, mean_2 = (window * first).sum(), (window * second).sum()
    variance_1 = (window * first**2).sum() - mean_1**2
    variance_2 = (window * second**2).sum() - mean_2**2
    covariance = (window * first * second).sum() - mean_1 * mean_2
    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    expected = ((2 * mean_1 * mean_2 + c1) * (2 * covariance + c2)) / (
        (mean_1**2 + mean_2**2 + c1) * (variance_1 + variance_2 + c2)
    )
    assert ssim(first, second) == pytest.approx(expected)


def test_ssim_map_covers_the_valid_region_only():
    assert ssim_map(_picture((20, 31)), _picture((20, 31))).shape == (10, 21)


def test_ssim_border_is_cut_before_the_windows_are_laid():
    first, second = _picture((30, 41)), _picture((30, 41), seed=8)
    expected = ssim(first[4:-4, 4:-4], second[4:-4, 4:-4])
    assert ssim(first, second, border=4) == pytest.approx(expected)
