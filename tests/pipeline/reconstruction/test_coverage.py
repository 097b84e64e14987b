"""How many sub-pixel phases the observations fill."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.grid import Grid, Sampling
from pipeline.reconstruction.coverage import phase_coverage

LR_SHAPE = (6, 11)


def _grid(along_x: int = 2, along_y: int = 2, sampling: Sampling = Sampling.DECIMATION) -> Grid:
    return Grid(magnification_x=along_x, magnification_y=along_y, sampling=sampling)


def _position(shift=(0.0, 0.0), shape=LR_SHAPE) -> np.ndarray:
    x, y = np.meshgrid(np.arange(shape[1]) + shift[0], np.arange(shape[0]) + shift[1])
    return np.stack([x, y], axis=-1).astype(np.float32)


def _covered(positions, grid, trusted=None) -> float:
    trusted = trusted or [np.ones(LR_SHAPE, bool)] * len(positions)
    return phase_coverage(positions, trusted, grid, LR_SHAPE)


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize("magnification", [(2, 2), (3, 2), (4, 4), (2, 1), (1, 1)])
def test_a_single_view_fills_one_phase(magnification, sampling):
    grid = _grid(*magnification, sampling)
    assert _covered([_position()], grid) == pytest.approx(1 / (magnification[0] * magnification[1]))


@pytest.mark.parametrize("magnification", [(2, 2), (3, 2), (2, 1)])
def test_a_view_for_each_phase_fills_them_all(magnification):
    shifts = [
        (i / magnification[0], j / magnification[1])
        for i in range(magnification[0])
        for j in range(magnification[1])
    ]
    assert _covered([_position(shift) for shift in shifts], _grid(*magnification)) == 1


def test_a_second_view_at_the_same_phase_adds_nothing():
    grid = _grid()
    once = _covered([_position()], grid)
    assert _covered([_position(), _position((0.02, -0.03))], grid) == once
    assert _covered([_position(), _position((1.0, 0.0))], grid) == pytest.approx(once)
    assert _covered([_position(), _position((0.5, 0.0))], grid) > 1.8 * once


def test_only_trusted_pixels_count():
    grid = _grid()
    half = np.zeros(LR_SHAPE, bool)
    half[:3] = True
    positions = [_position(), _position((0.5, 0.5))]
    full = np.ones(LR_SHAPE, bool)
    assert _covered(positions, grid, [full, half]) == pytest.approx(0.375)
    assert _covered(positions, grid, [~full, ~full]) == 0
    nan = np.full_like(positions[1], np.nan)
    assert _covered([positions[0], nan], grid) == pytest.approx(0.25)
    assert _covered([positions[0], nan], grid, [full, ~full]) == pytest.approx(0.25)


def test_what_lands_outside_does_not_count():
    grid = _grid(sampling=Sampling.AREA)
    assert _covered([_position((100.0, 0.0))], grid) == 0
    assert _covered([_position((0.0, -7.0))], grid) == 0
    assert _covered([_position((1e9, 1e9))], grid) == 0


@given(
    shifts=st.lists(st.tuples(st.floats(-3, 3), st.floats(-3, 3)), min_size=1, max_size=5),
    sampling=st.sampled_from(list(Sampling)),
)
def test_coverage_is_a_share_and_another_view_never_lowers_it(shifts, sampling):
    grid = _grid(3, 2, sampling)
    positions = [_position(shift) for shift in shifts]
    shares = [_covered(positions[: n + 1], grid) for n in range(len(positions))]
    assert 0 <= shares[0] <= 1 / 6 + 1e-9
    assert all(later >= earlier for earlier, later in pairwise(shares))
    assert shares[-1] <= 1
