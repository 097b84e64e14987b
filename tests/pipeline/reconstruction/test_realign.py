"""Landing points corrected: a shift is found again, and where nothing tells, nothing moves."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from pipeline.learned_filters import learned_filters
from pipeline.metrics import psnr
from pipeline.reconstruction.fused import FusedTuning, fuse
from pipeline.reconstruction.psf import sampling_taps
from pipeline.reconstruction.realign import FARTHEST, realigned
from pipeline.reconstruction.system import spline_coefficients
from tests.support.views import LR_SHAPE, PSF, make_grid, make_truth, make_view, observe

TAPS = sampling_taps(PSF, make_grid())


def _points(shift: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    y, x = np.mgrid[: LR_SHAPE[0], : LR_SHAPE[1]].astype(np.float32)
    return 2 * (x + np.float32(shift[0])), 2 * (y + np.float32(shift[1]))


@pytest.mark.parametrize("noise", [0.3, 2.0])
@pytest.mark.parametrize("away", [(0.15, 0.0), (-0.1, 0.2), (0.0, -0.25)])
def test_a_shift_is_found_again(noise, away):
    truth = make_truth(make_grid().hr_shape(LR_SHAPE))
    shift = (0.4, -0.3)
    observed = observe(truth, make_grid(), LR_SHAPE, shift, noise=noise)
    points = _points((shift[0] + away[0], shift[1] + away[1]))
    found = realigned(spline_coefficients(truth, TAPS), points, observed, noise, make_grid())
    inner = np.s_[4:-4, 4:-4]
    for place, said, right in zip(found, points, _points(shift), strict=True):
        before, after = (np.abs(a - right)[inner].mean() for a in (said, place))
        assert after < max(0.25 * before, 0.03)


def test_points_that_are_right_stay():
    truth = make_truth(make_grid().hr_shape(LR_SHAPE))
    observed = observe(truth, make_grid(), LR_SHAPE, (0.4, -0.3), noise=2.0)
    points = _points((0.4, -0.3))
    found = realigned(spline_coefficients(truth, TAPS), points, observed, 2.0, make_grid())
    for place, said in zip(found, points, strict=True):
        assert np.abs(place - said)[4:-4, 4:-4].mean() < 0.06


def test_where_nothing_tells_nothing_moves():
    flat = np.full(make_grid().hr_shape(LR_SHAPE), 90, np.float32)
    observed = 90 + np.random.default_rng(1).normal(0, 3, LR_SHAPE).astype(np.float32)
    points = _points((0.2, 0.1))
    found = realigned(spline_coefficients(flat, TAPS), points, observed, 3.0, make_grid())
    for place, said in zip(found, points, strict=True):
        np.testing.assert_allclose(place, said, atol=1e-3)


def test_a_share_of_the_correction_is_made():
    truth = make_truth(make_grid().hr_shape(LR_SHAPE))
    observed = observe(truth, make_grid(), LR_SHAPE, (0.4, -0.3))
    points = _points((0.2, -0.3))
    none, half, full = (
        realigned(spline_coefficients(truth, TAPS), points, observed, 0.3, make_grid(), share=share)
        for share in (0.0, 0.5, 1.0)
    )
    for said, at_none, at_half, at_full in zip(points, none, half, full, strict=True):
        np.testing.assert_array_equal(at_none, said)
        np.testing.assert_allclose(at_half, (said + at_full) / 2, atol=1e-4)


def test_points_without_a_place_keep_none_and_the_others_do_not_care():
    truth = make_truth(make_grid().hr_shape(LR_SHAPE))
    observed = observe(truth, make_grid(), LR_SHAPE, (0.0, 0.0))
    x, y = _points((0.1, 0.0))
    x[10:14] = y[10:14] = np.nan
    found = realigned(spline_coefficients(truth, TAPS), (x, y), observed, 0.3, make_grid())
    assert np.isnan(found[0][10:14]).all()
    assert np.isfinite(np.delete(found[0], np.s_[10:14], axis=0)).all()


def test_no_step_is_longer_than_allowed():
    truth = make_truth(make_grid().hr_shape(LR_SHAPE))
    observed = observe(truth, make_grid(), LR_SHAPE, (3.0, 2.0))
    points = _points((0.0, 0.0))
    found = realigned(spline_coefficients(truth, TAPS), points, observed, 0.3, make_grid())
    for place, said in zip(found, points, strict=True):
        assert np.nanmax(np.abs(place - said)) <= 2 * 2 * FARTHEST + 1e-4


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (7, 2)])
def test_tiny_views(shape):
    truth = make_truth((2 * shape[0], 2 * shape[1]))
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32)
    found = realigned(
        spline_coefficients(truth, TAPS), (2 * x, 2 * y), truth[::2, ::2].copy(), 0.3, make_grid()
    )
    assert found[0].shape == shape
    assert np.isfinite(found[0]).all()


def test_a_view_that_agrees_badly_is_aligned_before_it_is_fused_and_judged():
    truth = make_truth(make_grid().hr_shape(LR_SHAPE))
    views = [
        make_view(observe(truth, make_grid(), LR_SHAPE, (0.0, 0.0), noise=1.0), is_reference=True)
    ]
    for number, shift in enumerate(((0.5, 0.25), (-0.3, 0.5), (0.25, -0.45)), start=1):
        seen = observe(truth, make_grid(), LR_SHAPE, shift, noise=1.0, seed=number)
        views.append(make_view(seen, (shift[0] + 0.3, shift[1] - 0.2)))
    learned = learned_filters(make_grid(), PSF.sigma, 1.0)
    aligned, as_said = (
        fuse(
            views, make_grid(), LR_SHAPE, PSF, noise=1.0, residual_threshold=60.0, learned=learned,
            tuning=replace(FusedTuning(), **tuning),
        )
        for tuning in ({"agreeing": (1.1, 1.0)}, {"corrections": 0})
    )  # fmt: skip
    assert psnr(aligned.estimate, truth, border=8) > psnr(as_said.estimate, truth, border=8) + 0.5
    assert np.less(aligned.misfits[1:], as_said.misfits[1:]).all()


def test_the_more_a_view_disagrees_the_more_of_its_correction_is_made():
    truth = make_truth(make_grid().hr_shape(LR_SHAPE))
    seen = [
        observe(truth, make_grid(), LR_SHAPE, shift, noise=1.0, seed=number)
        for number, shift in enumerate(((0.0, 0.0), (0.5, 0.25)))
    ]
    views = [make_view(seen[0], is_reference=True), make_view(seen[1], (0.8, 0.05))]
    learned = learned_filters(make_grid(), PSF.sigma, 1.0)

    def estimate(enough: float) -> np.ndarray:
        return fuse(
            views, make_grid(), LR_SHAPE, PSF, noise=1.0, residual_threshold=60.0, learned=learned,
            tuning=FusedTuning(agreeing=(enough, enough - 0.2)),
        ).estimate  # fmt: skip

    made = [estimate(enough) for enough in np.arange(-0.1, 1.3, 0.05)]
    steps = [np.abs(after - before).mean() for before, after in itertools.pairwise(made)]
    assert steps[0] == steps[-1] == 0
    assert 0 < max(steps) < 0.5 * np.abs(made[-1] - made[0]).mean()
