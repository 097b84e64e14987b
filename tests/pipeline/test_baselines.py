from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.baselines import BASELINES, bicubic, bilinear, lanczos, nearest
from pipeline.grid import Grid, Sampling


def _grid(x: int, y: int, sampling: Sampling) -> Grid:
    return Grid(magnification_x=x, magnification_y=y, sampling=sampling)


def _noise(shape: tuple[int, ...]) -> np.ndarray:
    return np.random.default_rng(5).uniform(0, 255, shape).astype(np.float32)


@pytest.mark.parametrize(("along_x", "along_y"), [(2, 2), (3, 3), (4, 4), (2, 1)])
@pytest.mark.parametrize(
    ("method", "flag"),
    [
        (nearest, cv2.INTER_NEAREST),
        (bilinear, cv2.INTER_LINEAR),
        (bicubic, cv2.INTER_CUBIC),
        (lanczos, cv2.INTER_LANCZOS4),
    ],
)
def test_area_phase_is_opencv_resize(method, flag, along_x, along_y):
    image = _noise((13, 17))
    expected = cv2.resize(image, None, fx=along_x, fy=along_y, interpolation=flag)
    result = method(image, _grid(along_x, along_y, Sampling.AREA))
    assert result.shape == (13 * along_y, 17 * along_x)
    np.testing.assert_allclose(result, expected, atol=1e-3)


@pytest.mark.parametrize("name", BASELINES)
@pytest.mark.parametrize("magnification", [2, 3, 4])
def test_decimation_phase_keeps_the_samples(name, magnification):
    image = _noise((7, 11))
    grid = _grid(magnification, magnification, Sampling.DECIMATION)
    result = BASELINES[name](image, grid)
    np.testing.assert_allclose(result[::magnification, ::magnification], image, atol=1e-3)


def _ramp(shape: tuple[int, int]) -> np.ndarray:
    """A linear image, of unequal slope along x and y."""
    return np.add.outer(3.0 * np.arange(shape[0]), 2.0 * np.arange(shape[1])).astype(np.float32)


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize(
    ("name", "tolerance"), [("bilinear", 1e-4), ("bicubic", 0.13), ("lanczos", 0.1)]
)
def test_ramp_lies_where_the_grid_says(name, tolerance, sampling):
    # OpenCV's bicubic (a = −0.75) and normalised Lanczos do not keep a slope exactly,
    # they are off by up to 0.05 times the slope; half a pixel would be off by 1.0 and 1.5.
    grid = _grid(4, 3, sampling)
    result = BASELINES[name](_ramp((19, 23)), grid)
    rows = (np.arange(19 * 3) - grid.offset_y) / 3
    columns = (np.arange(23 * 4) - grid.offset_x) / 4
    expected = np.add.outer(3.0 * rows, 2.0 * columns)
    inner = (slice(15, -18), slice(20, -24))
    assert np.abs(result - expected)[inner].max() <= tolerance * 2.5


@pytest.mark.parametrize("name", BASELINES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (6, 1), (3, 5), (3, 5, 2)])
def test_constant_stays_constant_on_the_smallest_images(name, shape):
    result = BASELINES[name](np.full(shape, 77, np.float32), _grid(2, 3, Sampling.DECIMATION))
    assert result.shape == (shape[0] * 3, shape[1] * 2, *shape[2:])
    np.testing.assert_allclose(result, 77, atol=1e-3)


def test_channels_are_enlarged_alike():
    chroma = _noise((5, 8, 2))
    grid = _grid(2, 2, Sampling.AREA)
    both = bicubic(chroma, grid)
    np.testing.assert_allclose(both[..., 1], bicubic(chroma[..., 1], grid), atol=1e-4)
