"""The PSF, and the one blur that serves every sub-pixel position."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from pipeline.degradation import gaussian_taps
from pipeline.grid import Grid, Sampling
from pipeline.reconstruction.psf import (
    BicubicPsf,
    GaussianPsf,
    SeparableTaps,
    blur,
    coefficient_taps,
    psf_axes,
    sampling_taps,
)
from pipeline.reconstruction.system import simulate

SIGMAS = st.floats(0.3, 4.0)
SUPPORTS = st.integers(0, 10).map(lambda half: 2 * half + 1)


def _grid(along_x: int = 2, along_y: int = 2) -> Grid:
    return Grid(magnification_x=along_x, magnification_y=along_y, sampling=Sampling.AREA)


def _image(shape=(23, 34), seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, shape).astype(np.float32)


# --- the PSF itself ----------------------------------------------------------------------


@given(sigma=SIGMAS, support=SUPPORTS, fraction=st.floats(-0.5, 0.5))
def test_taps_sum_to_one_and_fall_off_from_the_centre(sigma, support, fraction):
    taps = GaussianPsf(sigma=sigma, support=support).taps_at(fraction)
    assert taps.shape == (support,)
    assert taps.sum() == pytest.approx(1)
    assert taps.min() >= 0
    assert np.argmax(taps) == support // 2 or abs(fraction) == pytest.approx(0.5, abs=1e-9)


@given(sigma=SIGMAS, support=SUPPORTS, fraction=st.floats(-0.5, 0.5))
def test_a_psf_to_the_right_is_the_mirror_of_one_to_the_left(sigma, support, fraction):
    psf = GaussianPsf(sigma=sigma, support=support)
    np.testing.assert_allclose(psf.taps_at(fraction), psf.taps_at(-fraction)[::-1], atol=1e-12)


def test_the_centre_of_mass_is_where_the_fraction_says():
    psf = GaussianPsf.of(1.7)
    for fraction in (-0.4, 0.0, 0.25):
        taps = psf.taps_at(fraction)
        assert taps @ (np.arange(psf.support) - psf.support // 2) == pytest.approx(
            fraction, abs=0.01
        )


@given(sigma=SIGMAS)
def test_the_support_left_out_is_odd_and_holds_six_sigma(sigma):
    psf = GaussianPsf.of(sigma)
    assert psf.support % 2 == 1
    assert 6 * sigma <= psf.support < 6 * sigma + 3
    assert GaussianPsf.of(sigma, 7).support == 7


def test_at_whole_pixels_it_is_the_psf_of_set_1():
    np.testing.assert_allclose(
        GaussianPsf(sigma=1.7, support=7).taps_at(0.0), gaussian_taps(1.7, 7), atol=1e-12
    )


def test_energy_is_the_sum_of_squares_of_the_kernel_in_the_plane():
    psf = GaussianPsf(sigma=1.3, support=9)
    kernel = np.outer(psf.taps_at(0.0), psf.taps_at(0.0))
    assert psf.energy == pytest.approx((kernel**2).sum())


# --- the PSF of antialiased bicubic reduction ---------------------------------------------


@pytest.mark.parametrize("magnification", [2, 3, 4])
def test_bicubic_reduction_is_seen_through_its_own_psf(magnification):
    """Pillow's, which is somebody else's: an LR pixel covers K HR pixels, K even or odd."""
    image = _image((12 * magnification, 17 * magnification))
    small = np.asarray(
        Image.fromarray(image).resize((17, 12), Image.Resampling.BICUBIC), dtype=np.float64
    )
    psf = BicubicPsf(magnification=magnification)
    middle = (magnification - 1) / 2
    nearest = math.floor(middle + 0.5)
    taps = psf.taps_at(middle - nearest)
    blurred = cv2.sepFilter2D(image, cv2.CV_64F, taps, taps, borderType=cv2.BORDER_REFLECT)
    found = blurred[nearest::magnification, nearest::magnification]
    np.testing.assert_allclose(found[3:-3, 3:-3], small[3:-3, 3:-3], atol=0.01)


@pytest.mark.parametrize("magnification", [2, 3, 4])
def test_its_sigma_is_that_of_the_gaussian_that_passes_frequencies_most_alike(magnification):
    psf = BicubicPsf(magnification=magnification)
    frequencies = np.linspace(0, 0.5, 257)
    waves = np.cos(2 * np.pi * (np.arange(psf.support) - psf.support // 2)[:, None] * frequencies)
    passed = psf.taps_at(0.0) @ waves
    sigmas = np.arange(0.3, 2.5, 0.01)
    off = [((np.exp(-2 * (np.pi * s * frequencies) ** 2) - passed) ** 2).sum() for s in sigmas]
    assert sigmas[int(np.argmin(off))] == pytest.approx(psf.sigma, rel=0.03)


# --- the spline's prefilter --------------------------------------------------------------


@given(sigma=SIGMAS, support=SUPPORTS)
def test_coefficient_taps_are_symmetric_and_sum_to_one(sigma, support):
    taps = coefficient_taps(GaussianPsf(sigma=sigma, support=support).taps_at(0.0))
    assert taps.size > support
    assert taps.size % 2 == 1
    assert taps.sum() == pytest.approx(1)
    np.testing.assert_allclose(taps, taps[::-1], atol=1e-12)


def test_sampling_the_coefficients_at_whole_pixels_gives_the_blurred_pixels():
    """The nine taps of the spline undo the prefilter; what is left is the blur alone."""
    psf = GaussianPsf(sigma=1.2, support=7)
    image = _image()
    y, x = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    sampled = simulate(image, sampling_taps(psf, _grid()), x, y)
    taps = psf.taps_at(0.0)
    expected = cv2.sepFilter2D(image, cv2.CV_32F, taps, taps, borderType=cv2.BORDER_REFLECT)
    np.testing.assert_allclose(sampled, expected, atol=0.05)


def test_between_pixels_it_is_near_the_psf_sampled_there():
    """Thesis §3.1.1 evaluates the PSF at the fractional position; one blur does nearly that."""
    psf = GaussianPsf(sigma=1.0, support=9)
    image = cv2.GaussianBlur(_image((40, 60)), (0, 0), 1.0)
    taps = sampling_taps(psf, _grid())
    for fraction_x, fraction_y in ((0.25, -0.4), (0.5, 0.5), (-0.3, 0.1)):
        x, y = np.float32(31 + fraction_x), np.float32(18 + fraction_y)
        found = simulate(image, taps, np.full((1, 1), x), np.full((1, 1), y))[0, 0]
        kernel = np.outer(psf.taps_at(fraction_y), psf.taps_at(fraction_x))
        expected = (kernel * image[14:23, 27:36]).sum()
        assert found == pytest.approx(expected, abs=0.2)


# --- axes --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("magnification", "blurred"),
    [((2, 2), (True, True)), ((2, 1), (True, False)), ((1, 3), (False, True))],
)
def test_an_axis_that_is_not_enlarged_is_not_blurred(magnification, blurred):
    psf = GaussianPsf(sigma=1.0, support=7)
    grid = _grid(*magnification)
    assert psf_axes(psf, grid) == tuple(psf if flag else None for flag in blurred)
    taps = sampling_taps(psf, grid)
    unit = coefficient_taps(np.ones(1))
    for along, flag in zip((taps.x, taps.y), blurred, strict=True):
        assert (along.size > unit.size) == flag


# --- the blur ----------------------------------------------------------------------------

SHAPES = [(1, 1), (1, 9), (8, 1), (2, 3), (5, 4), (23, 34)]


@pytest.mark.parametrize("shape", SHAPES)
@given(sigma=SIGMAS, support=SUPPORTS, seed=st.integers(0, 99))
def test_the_blur_is_its_own_adjoint(shape, sigma, support, seed):
    """<B a, b> = <a, B b>: conjugate gradients rely on it, also where the kernel is wider."""
    taps = sampling_taps(GaussianPsf(sigma=sigma, support=support), _grid(2, 1))
    first, second = (_image(shape, seed + k) - np.float32(128) for k in range(2))
    one = np.vdot(blur(first, taps).astype(float), second)
    two = np.vdot(first.astype(float), blur(second, taps))
    scale = np.linalg.norm(first) * np.linalg.norm(second)
    assert abs(one - two) < 1e-6 * scale


@pytest.mark.parametrize("shape", SHAPES)
@given(level=st.floats(0, 255, width=32), support=SUPPORTS)
def test_a_constant_stays_constant(shape, level, support):
    taps = sampling_taps(GaussianPsf(sigma=1.7, support=support), _grid())
    blurred = blur(np.full(shape, level, np.float32), taps)
    assert blurred.dtype == np.float32
    np.testing.assert_allclose(blurred, level, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_blur_keeps_the_sum_and_the_input(shape):
    image = _image(shape)
    before = image.copy()
    blurred = blur(image, sampling_taps(GaussianPsf(sigma=1.7, support=9), _grid()))
    assert blurred.sum() == pytest.approx(image.sum(), rel=1e-5)
    np.testing.assert_array_equal(image, before)


def test_wide_kernels_reflect_like_narrow_ones():
    """Both borders are the same reflection: a narrow kernel padded by zeros is the narrow one."""
    image = _image((6, 9))
    narrow = np.array([0.25, 0.5, 0.25])
    wide = np.pad(narrow, 6)
    np.testing.assert_allclose(
        blur(image, SeparableTaps(x=wide, y=wide)), blur(image, SeparableTaps(x=narrow, y=narrow)),
        atol=1e-4,
    )  # fmt: skip
