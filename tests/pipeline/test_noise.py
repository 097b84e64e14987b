from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.degradation import Degradation, degrade_image
from pipeline.frames import View
from pipeline.noise import estimate_noise, estimate_noise_of_views

ROUNDING = 12**-0.5
"""Standard deviation of rounding to whole grey levels."""


def _texture(height: int = 301, width: int = 423, amplitude: float = 45.0) -> np.ndarray:
    """Smooth ground with sharp-edged squares of every size and fine stripes: aliases if decimated.

    Some of it, the lower left, is smooth.
    """
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:height, :width].astype(np.float32)
    image = 110 + amplitude * np.sin(x / 61) * np.cos(y / 43)
    for _ in range(400):
        side = int(rng.integers(2, 40))
        top, left = int(rng.integers(-10, height)), int(rng.integers(width // 4, width))
        cell = image[max(top, 0) : top + side, left : left + side]
        cell += rng.uniform(-amplitude, amplitude)
    image[: height // 4, width // 2 :] += (
        0.5 * amplitude * np.sign(np.sin(1.9 * x + 0.7 * y)[: height // 4, width // 2 :])
    )
    return image


def _observed(sigma_psf: float, noise: float, seed: int = 1) -> np.ndarray:
    truth = np.clip(np.rint(_texture(602, 846)), 0, 255).astype(np.uint8)
    degradation = Degradation(psf_sigma=sigma_psf, psf_support=7, noise_sigma=noise)
    return degrade_image(truth, degradation, np.random.default_rng(seed))


@pytest.mark.parametrize("sigma_psf", [1.0, 1.7])
@pytest.mark.parametrize("noise", [1.0, 2.0, 4.0, 10.0])
def test_noise_on_an_aliased_texture_is_found_within_a_tenth(sigma_psf, noise):
    found = estimate_noise(_observed(sigma_psf, noise))
    assert found == pytest.approx(np.hypot(noise, ROUNDING), rel=0.1)


@pytest.mark.parametrize("sigma_psf", [1.0, 1.7])
def test_without_noise_little_more_than_the_rounding_is_found(sigma_psf):
    assert ROUNDING / 2 < estimate_noise(_observed(sigma_psf, 0.0)) < 0.6


def test_pure_noise_is_unbiased():
    found = [
        estimate_noise(np.random.default_rng(seed).normal(120, 3, (205, 310)).astype(np.float32))
        for seed in range(12)
    ]
    assert np.mean(found) == pytest.approx(3, rel=0.03)
    assert np.std(found) < 0.15


@given(
    gain=st.floats(0.25, 2), offset=st.floats(-20, 20), flip=st.booleans(), transpose=st.booleans()
)
def test_scales_with_the_image_and_knows_neither_offset_nor_side(gain, offset, flip, transpose):
    image = np.random.default_rng(3).normal(0, 3, (90, 131)).astype(np.float32)
    turned = image.T if transpose else image
    turned = np.ascontiguousarray(turned[:, ::-1] if flip else turned)
    expected = gain * estimate_noise(np.float32(120) + image)
    found = estimate_noise(np.float32(gain) * turned + np.float32(120 + offset))
    assert found == pytest.approx(expected, rel=2e-2)


def test_more_noise_is_never_found_to_be_less():
    found = [estimate_noise(_observed(1.0, noise)) for noise in (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 6.0)]
    assert found == sorted(found)


def test_clipped_sky_and_black_border_do_not_count():
    image = np.maximum(_texture(), 30) + np.random.default_rng(2).normal(0, 2, (301, 423))
    image[:90] = 300.0  # burnt out
    image[250:] = 16.0  # video black, without noise
    image[:, 400:] = -4.0
    clipped = np.clip(np.rint(image), 0, 255).astype(np.float32)
    assert estimate_noise(clipped) == pytest.approx(np.hypot(2, ROUNDING), rel=0.1)


def test_noise_clipped_at_black_is_measured_where_it_is_not():
    ground = np.full((240, 310), 1.0)
    ground[:, 60:] = np.linspace(60, 200, 250)
    noisy = ground + np.random.default_rng(7).normal(0, 3, ground.shape)
    assert estimate_noise(np.clip(noisy, 0, 255).astype(np.float32)) == pytest.approx(3, rel=0.1)


def test_flat_parts_of_a_noise_free_drawing_count():
    drawing = np.full((120, 200), 128, np.float32)
    drawing[40:80, 50:150] = np.random.default_rng(1).integers(0, 256, (40, 100))
    assert estimate_noise(drawing) == 0


@pytest.mark.parametrize("level", [0.0, 0.3, 77.25, 255.0])
@pytest.mark.parametrize("shape", [(40, 63), (8, 8), (3, 5), (1, 9), (9, 1), (1, 1), (2, 2)])
def test_a_constant_image_has_none(level, shape):
    assert estimate_noise(np.full(shape, level, np.float32)) == 0


def test_two_tones_without_noise_have_none():
    image = np.kron(np.indices((6, 9)).sum(axis=0) % 2, np.full((20, 20), 255)).astype(np.float32)
    assert estimate_noise(image) == 0


def test_pixels_without_a_value_are_passed_over():
    image = np.random.default_rng(4).normal(100, 2, (150, 210)).astype(np.float32)
    image[30:90, 40:180] = np.nan
    image[0, 0] = np.inf
    assert estimate_noise(image) == pytest.approx(2, rel=0.15)
    assert estimate_noise(np.full((20, 30), np.nan, np.float32)) == 0


@pytest.mark.parametrize("shape", [(3, 5), (1, 400), (400, 1), (7, 60), (8, 8), (5, 3)])
def test_small_images_fall_back(shape):
    rng = np.random.default_rng(6)
    found = [estimate_noise(rng.normal(90, 4, shape).astype(np.float32)) for _ in range(40)]
    assert np.median(found) == pytest.approx(4, rel=0.2)


@given(
    arrays(
        np.float32,
        st.tuples(st.integers(1, 12), st.integers(1, 12)),
        elements=st.floats(0, 255, width=32),
    )
)
def test_any_image_has_a_finite_noise(image):
    before = image.copy()
    assert 0 <= estimate_noise(image) < 400
    np.testing.assert_array_equal(image, before)


def test_large_images_are_sampled_not_cut():
    """Noise in the upper half only; the smooth lower half is smoothest, and without noise."""
    image = np.random.default_rng(8).normal(100, 5, (1200, 1501)).astype(np.float32)
    assert estimate_noise(image) == pytest.approx(5, rel=0.05)
    image[700:] = cv2.GaussianBlur(image[700:], (0, 0), 4)
    assert estimate_noise(image) < 1


def test_median_over_views():
    rng = np.random.default_rng(9)
    views = [
        View(view_id=str(sigma), luma=rng.normal(120, sigma, (80, 120)).astype(np.float32))
        for sigma in (1.0, 2.0, 30.0)
    ]
    assert estimate_noise_of_views(views) == estimate_noise(views[1].luma)
    with pytest.raises(ValueError, match="no views"):
        estimate_noise_of_views([])


@pytest.mark.parametrize(
    ("name", "largest"),
    [("art/view1.png", 0.6), ("cones/im2.png", 0.9), ("kitti/image_l/*.png", 0.6)],
)
def test_real_scenes(scenes_dir, name, largest):
    """Noise added to a photograph is found; the photographs' own noise is not known."""
    path = sorted(scenes_dir.glob(name))[0]
    grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    height, width = grey.shape
    truth = grey[: height - height % 2, : width - width % 2]
    found = {
        noise: estimate_noise(
            degrade_image(
                truth, Degradation(psf_sigma=1.0, noise_sigma=noise), np.random.default_rng(1)
            )
        )
        for noise in (0.0, 2.0)
    }
    assert found[0.0] < largest
    assert found[2.0] == pytest.approx(np.hypot(2, found[0.0]), rel=0.15)
