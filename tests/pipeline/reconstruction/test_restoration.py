"""One view enlarged and sharpened by a linear filter: in its place, and better than bicubic."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.baselines import bicubic
from pipeline.grid import Grid, Sampling
from pipeline.metrics import psnr
from pipeline.reconstruction.parts import on_hr_grid
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.reconstruction.restoration import restoration_of, restored
from pipeline.threads import set_threads, thread_count
from tests.support.views import LR_SHAPE, PHASES, make_grid, make_truth, observe


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_it_is_better_than_bicubic(magnification, sampling, noise):
    grid = make_grid(*magnification, sampling)
    psf = GaussianPsf.of(0.5 * max(magnification))
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    observed = observe(truth, grid, LR_SHAPE, (0.0, 0.0), psf, noise)
    found = restored(observed, grid, psf, noise)
    assert found.shape == truth.shape
    assert psnr(found, truth, border=8) > psnr(bicubic(observed, grid), truth, border=8) + 0.5


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
def test_a_ramp_lies_where_the_grid_says(magnification, sampling):
    grid = make_grid(*magnification, sampling)
    y, x = np.mgrid[:16, :22].astype(np.float32)
    at_x, at_y = grid.to_hr(np.stack([x, y], axis=-1))
    height, width = grid.hr_shape(x.shape)
    row, column = np.mgrid[:height, :width]
    found = restored(2 * at_x + at_y, grid, GaussianPsf.of(1.0), 0.0)
    inner = np.s_[5 * magnification[1] : -5 * magnification[1],
                  5 * magnification[0] : -5 * magnification[0]]  # fmt: skip
    np.testing.assert_allclose(found[inner], (2 * column + row)[inner], atol=0.3)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (3, 4)])
def test_a_constant_stays_whatever_the_size(shape):
    grid = Grid(magnification_x=3, magnification_y=2, sampling=Sampling.AREA)
    found = restored(np.full(shape, 71, np.float32), grid, GaussianPsf.of(1.5), 1.0)
    np.testing.assert_allclose(found, 71, rtol=1e-5)


def test_the_more_noise_the_smoother():
    grid = make_grid()
    psf = GaussianPsf.of(1.0)
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    observed = observe(truth, grid, LR_SHAPE, (0.0, 0.0), psf, 4.0)
    rough = [np.abs(np.diff(restored(observed, grid, psf, noise))).mean() for noise in (0, 2, 6)]
    assert rough == sorted(rough, reverse=True)


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
def test_it_knows_how_rough_noise_becomes(magnification, sampling):
    grid, psf = make_grid(*magnification, sampling), GaussianPsf.of(1.0)
    noise = np.random.default_rng(2).normal(0, 3, (150, 200)).astype(np.float32)
    restoration = restoration_of(100 + noise, grid, psf, 2.0)
    made = restoration.apply(noise, grid)
    inner = made[20:-20, 20:-20]
    found = np.mean([np.square(np.diff(inner, axis=axis)).mean() for axis in (0, 1)])
    assert found == pytest.approx(9 * restoration.roughness, rel=0.05)


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
@pytest.mark.parametrize("box", [np.s_[0:40, 0:53], np.s_[0:1, 52:53], np.s_[9:31, 2:50]])
def test_a_part_is_what_the_whole_has_there(magnification, sampling, box):
    grid, view = make_grid(*magnification, sampling), make_truth((40, 53))
    restoration = restoration_of(view, grid, GaussianPsf.of(1.0), 2.0)
    expected = restoration.apply(view, grid)[on_hr_grid(box, grid)]
    np.testing.assert_array_equal(restoration.apply(view, grid, box), expected)


def test_one_thread_or_two_give_the_same_bits():
    observed = make_truth((150, 40))
    before = thread_count()
    try:
        results = []
        for threads in (1, 2):
            set_threads(threads)
            results.append(restored(observed, make_grid(), GaussianPsf.of(1.0), 1.0))
    finally:
        set_threads(before)
    np.testing.assert_array_equal(*results)
