"""MS-SSIM, and the measure of two eyes together."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pipeline.metrics import binocular_psnr, ms_ssim, psnr, ssim

SHAPE = (190, 230)


def _picture(seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    coarse = random.uniform(40, 215, (12, 15))
    return np.kron(coarse, np.ones((16, 16)))[: SHAPE[0], : SHAPE[1]]


def _identity() -> np.ndarray:
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.stack((columns, rows), axis=-1).astype(np.float32)


def test_ms_ssim_of_identical_pictures_is_one_and_falls_with_noise():
    picture = _picture(1)
    noise = np.random.default_rng(2).normal(0, 1, SHAPE)
    assert ms_ssim(picture, picture) == pytest.approx(1)
    values = [ms_ssim(picture + scale * noise, picture) for scale in (2, 8, 32)]
    assert 1 > values[0] > values[1] > values[2] > 0


def test_ms_ssim_forgives_fine_noise_more_than_ssim_does():
    picture = _picture(3)
    noisy = picture + np.random.default_rng(4).normal(0, 12, SHAPE)
    assert ms_ssim(noisy, picture) > ssim(noisy, picture)


def test_ms_ssim_of_a_small_picture_uses_the_scales_that_fit():
    small = _picture(5)[:13, :17]
    assert ms_ssim(small, small) == pytest.approx(1)
    noisy = small + np.random.default_rng(6).normal(0, 8, small.shape)
    one_scale = ssim(noisy, small)
    assert ms_ssim(noisy, small) == pytest.approx(one_scale ** (0.0448 + 0.2856 + 0.3001 + 0.2363
                                                              + 0.1333))  # fmt: skip


def test_errors_common_to_both_eyes_are_not_seen_and_independent_ones_cost_three_db():
    random = np.random.default_rng(7)
    left, right = random.normal(0, 4, (2, *SHAPE)).astype(np.float32)
    everywhere = np.ones(SHAPE, bool)
    assert binocular_psnr((left, left), _identity(), everywhere) == math.inf
    apart = binocular_psnr((left, right), _identity(), everywhere)
    alone = psnr(left, np.zeros(SHAPE))
    assert apart == pytest.approx(alone - 10 * math.log10(2), abs=0.1)


def test_the_eyes_are_compared_at_the_same_surface_point():
    error = np.random.default_rng(8).normal(0, 4, SHAPE).astype(np.float32)
    shifted = np.roll(error, (2, 5), axis=(0, 1))  # the right eye's copy, 5 to the right, 2 down
    position = _identity() + np.array([5, 2], np.float32)
    seen = np.ones(SHAPE, bool)
    assert binocular_psnr((error, shifted), position, seen, border=8) == math.inf
    assert binocular_psnr((error, shifted), _identity(), seen, border=8) < 45


def test_without_a_common_pixel_there_is_no_figure():
    error = np.zeros(SHAPE, np.float32)
    assert math.isnan(binocular_psnr((error, error), _identity(), np.zeros(SHAPE, bool)))
