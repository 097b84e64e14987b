from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.grid import Grid, Sampling


def test_hr_shape_is_height_then_width():
    grid = Grid(magnification_x=3, magnification_y=2, sampling=Sampling.AREA)
    assert grid.hr_shape((5, 7)) == (10, 21)


@pytest.mark.parametrize("magnification", [1, 2, 3, 4])
def test_decimation_puts_the_first_pixel_on_the_first_pixel(magnification):
    grid = Grid(magnification_x=magnification, magnification_y=1, sampling=Sampling.DECIMATION)
    assert (grid.offset_x, grid.offset_y) == (0, 0)


@given(x=st.integers(1, 5), y=st.integers(1, 5))
def test_area_puts_an_lr_pixel_at_the_mean_of_those_it_covers(x: int, y: int):
    grid = Grid(magnification_x=x, magnification_y=y, sampling=Sampling.AREA)
    assert grid.offset_x == pytest.approx(np.mean(np.arange(x)))
    assert grid.offset_y == pytest.approx(np.mean(np.arange(y)))


@given(size=st.integers(1, 50), magnification=st.integers(1, 4))
def test_area_centres_the_grids_on_each_other(size: int, magnification: int):
    grid = Grid(magnification_x=magnification, magnification_y=1, sampling=Sampling.AREA)
    lr_centre = (size - 1) / 2
    hr_centre = (size * magnification - 1) / 2
    assert lr_centre * magnification + grid.offset_x == pytest.approx(hr_centre)
