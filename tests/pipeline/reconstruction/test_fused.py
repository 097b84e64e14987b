"""The default solver: gains by true views, no harm by false ones, and everything in its place."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from pipeline.baselines import bicubic
from pipeline.frames import RegisteredView, Rejection
from pipeline.grid import Sampling
from pipeline.metrics import psnr
from pipeline.reconstruction.fused import (
    SMALLEST_NOISE,
    FusedResult,
    FusedTuning,
    fuse,
    initial_estimate,
    landing_points,
    local_strength,
    prior_strength,
    settled_share,
    weigh_by_agreement,
)
from pipeline.reconstruction.kernels import SMALLEST_WEIGHT
from pipeline.reconstruction.psf import GaussianPsf, sampling_taps
from pipeline.reconstruction.restoration import restored
from pipeline.reconstruction.system import simulate
from pipeline.reconstruction.tables import table_of
from pipeline.threads import set_threads, thread_count
from tests.support.views import LR_SHAPE, PHASES, PSF, make_grid, make_truth, make_view, observe

SHIFTS = ((0.0, 0.0), (0.5, 0.25), (-0.3, 0.5), (0.25, -0.45))
"""Of the views, LR pixels; the first is the reference."""

BORDER = 8
"""HR pixels left out when measuring."""


def _views(truth, grid, *, count=4, noise=0.0, lr_shape=LR_SHAPE, psf=PSF) -> list[RegisteredView]:
    return [
        make_view(
            observe(truth, grid, lr_shape, shift, psf, noise, seed=index), shift,
            is_reference=index == 0,
        )
        for index, shift in enumerate(SHIFTS[:count])
    ]  # fmt: skip


def _fuse(views, grid, *, psf=PSF, noise=0.3, threshold=30.0, **options) -> FusedResult:
    lr_shape = next(view for view in views if view.is_reference).observed.shape
    return fuse(views, grid, lr_shape, psf, noise=noise, residual_threshold=threshold, **options)


def _score(result: FusedResult, truth: np.ndarray) -> float:
    return psnr(result.estimate, truth, border=BORDER)


# --- what views bring --------------------------------------------------------------------


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize("magnification", [(2, 2), (3, 3), (4, 4), (2, 1)])
def test_a_single_view_is_better_than_bicubic(magnification, sampling):
    grid = make_grid(*magnification, sampling)
    psf = GaussianPsf.of(0.5 * magnification[0])
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid, count=1, psf=psf)
    gain = _score(_fuse(views, grid, psf=psf), truth) - psnr(
        bicubic(views[0].observed, grid), truth, border=BORDER
    )
    assert gain > 0.8


@pytest.mark.parametrize(("noise", "gain"), [(0.0, 3.0), (2.0, 1.5)])
@pytest.mark.parametrize("sampling", list(Sampling))
def test_more_views_are_better(sampling, noise, gain):
    grid = make_grid(sampling=sampling)
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    scores = [
        _score(_fuse(_views(truth, grid, count=count, noise=noise), grid, noise=noise), truth)
        for count in (1, 2, 4)
    ]
    assert scores[0] < scores[1] < scores[2]
    assert scores[2] > scores[0] + gain


@pytest.mark.parametrize("magnification", [(3, 3), (4, 4), (2, 1), (3, 2)])
def test_more_views_are_better_at_other_magnifications(magnification):
    grid = make_grid(*magnification, Sampling.AREA)
    psf = GaussianPsf.of(0.5 * magnification[0])
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid, psf=psf)
    alone = _score(_fuse(views[:1], grid, psf=psf), truth)
    assert _score(_fuse(views, grid, psf=psf), truth) > alone + 0.8


@pytest.mark.parametrize("away", [(3.0, 0.0), (-1.0, 3.0), (0.7, -0.6), (25.0, 9.0)])
@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_misregistered_view_does_no_harm(noise, away):
    """Its pixels lie ``away`` LR pixels from where they are said to be; nothing tells but Eq. 8."""
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    own, other, *_ = _views(truth, grid, noise=noise)
    said = (SHIFTS[1][0] + away[0], SHIFTS[1][1] + away[1])
    lost = make_view(other.observed, said)
    alone, with_lost = (_fuse(views, grid, noise=noise) for views in ([own], [own, lost]))
    assert _score(with_lost, truth) > _score(alone, truth) - 0.02
    assert with_lost.weights[1].mean() < 0.15


def test_a_misregistered_view_does_not_spoil_what_good_ones_bring():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid, noise=1.0)
    lost = make_view(views[1].observed, (SHIFTS[1][0] + 3, SHIFTS[1][1] - 2))
    good = _fuse(views, grid, noise=1.0)
    with_lost = _fuse([*views, lost], grid, noise=1.0)
    assert _score(with_lost, truth) > _score(good, truth) - 0.1
    assert good.weights[1].mean() > 4 * with_lost.weights[4].mean()


def test_the_same_view_again_adds_nothing_but_does_not_harm():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    own = _views(truth, grid, count=1)[0]
    twice = _fuse([own, make_view(own.observed)], grid)
    assert _score(twice, truth) > _score(_fuse([own], grid), truth) - 0.02


def test_the_order_of_views_does_not_matter():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid)
    forth, back = _fuse(views, grid), _fuse(views[::-1], grid)
    # what is added up in another order is rounded to sixteen bits in every sweep
    np.testing.assert_allclose(back.estimate, forth.estimate, atol=0.1)
    np.testing.assert_allclose(back.weights[::-1], forth.weights, atol=1e-3)


# --- noise -------------------------------------------------------------------------------


def test_noise_raises_the_prior_and_a_wide_psf_lowers_it():
    tuning = FusedTuning()
    strengths = [prior_strength(noise, 1.0, tuning) for noise in (0.5, 1.0, 2.0, 8.0)]
    assert strengths == sorted(strengths)
    assert strengths[0] < strengths[-1]
    widths = (0.5, 0.8, 0.999, 1.001, 1.7)
    strengths = [prior_strength(1.0, sigma, tuning) for sigma in widths]
    assert strengths == sorted(strengths, reverse=True)
    assert strengths[2] == pytest.approx(strengths[3], rel=0.01)
    assert prior_strength(0.0, 1.0, tuning) == prior_strength(SMALLEST_NOISE, 1.0, tuning) > 0


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
def test_the_prior_says_less_the_more_detail_there_is_around(magnification, sampling):
    grid, tuning = make_grid(*magnification, sampling), FusedTuning()
    shape = grid.hr_shape((30, 60))
    texture = np.random.default_rng(5).normal(0, 1, shape).astype(np.float32)
    texture[:, : shape[1] // 2] = 0
    local = [
        local_strength(100 + contrast * texture, grid, 1.0, tuning) for contrast in (0, 0.5, 1, 2)
    ]
    assert all(one.shape == shape and one.dtype == np.float32 for one in local)
    np.testing.assert_array_equal(local[0], 1)
    left, right = (np.s_[:, : shape[1] // 4], np.s_[:, -shape[1] // 4 :])
    for less, more in pairwise(local):
        np.testing.assert_allclose(more[left], 1, atol=1e-3)
        assert more[right].max() < less[right].min()
    much = local_strength(100 + 60 * texture, grid, 1.0, tuning)
    np.testing.assert_allclose(much[right], tuning.prior_detail[1], rtol=1e-5)
    without_noise = local_strength(100 + texture, grid, SMALLEST_NOISE, tuning)
    assert without_noise[right].min() > local[2][right].max()


def test_noise_that_is_left_over_is_no_detail():
    noise = np.random.default_rng(6).normal(0, 4, (80, 120)).astype(np.float32)
    rough = np.square(np.diff(noise, axis=1)).mean()
    known, unknown = (
        local_strength(noise, make_grid(), 4.0, FusedTuning(), left).mean() for left in (rough, 0.0)
    )
    assert known > unknown + 0.2


@pytest.mark.parametrize("is_halved", [False, True])
@pytest.mark.parametrize("lr_shape", [(1, 1), (1, 7), (5, 1)])
def test_the_smallest_pictures_have_a_local_strength(lr_shape, is_halved):
    grid = make_grid()
    flat = np.full(grid.hr_shape(lr_shape), 9, np.float32)
    local = local_strength(flat, grid, 1.0, FusedTuning(), is_halved=is_halved)
    np.testing.assert_array_equal(local, 1)


@pytest.mark.parametrize("lr_shape", [(48, 64), (47, 65)])
def test_detail_averaged_on_half_of_the_rows_and_columns_is_nearly_the_same(lr_shape):
    grid, tuning = make_grid(), FusedTuning()
    picture = np.full(grid.hr_shape(lr_shape), 100, np.float32)
    # an edge, and texture of another contrast in each quarter
    rng, (height, width) = np.random.default_rng(8), picture.shape
    for number, (rows, columns) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        part = picture[rows * height // 2 :, columns * width // 2 :]
        part += rng.normal(0, number, part.shape).astype(np.float32) + 20 * rows
    whole = local_strength(picture, grid, 1.0, tuning)
    halved = local_strength(picture, grid, 1.0, tuning, is_halved=True)
    assert whole.std() > 0.1
    away = np.abs(halved - whole)
    assert away.max() < 0.03
    assert away.mean() < 0.005


def test_a_descent_goes_on_longest_where_aliasing_or_blur_is_to_be_undone():
    tuning = FusedTuning()
    shares = [settled_share(1.0, sigma, tuning) for sigma in (0.5, 0.8, 0.999, 1.001, 1.7)]
    assert shares[:3] == sorted(shares[:3])
    assert shares[2] == pytest.approx(shares[3], rel=0.01)
    assert shares[4] < shares[3]


def test_told_of_noise_the_result_is_smoother_and_better():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid, noise=5.0)
    told, untold = _fuse(views, grid, noise=5.0), _fuse(views, grid, noise=0.0)
    roughness = [np.abs(np.diff(result.estimate)).mean() for result in (told, untold)]
    assert roughness[0] < 0.9 * roughness[1]
    assert _score(told, truth) > _score(untold, truth) + 0.5


def test_noise_is_tolerated_by_the_weights():
    """True views keep their weight whatever the noise, if it is known."""
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    for noise in (1.0, 4.0, 8.0):
        views = _views(truth, grid, noise=noise)
        assert np.mean(_fuse(views, grid, noise=noise).weights[1:]) > 0.5


def _agreement(error: np.ndarray, others: int = 0) -> np.ndarray:
    """The weights of pixels that are predicted wrongly by so much, at noise 1."""
    flags, agreeing = np.zeros(error.shape, np.uint8), np.zeros(1)
    zero, weights, predicted = np.zeros_like(error), np.empty_like(error), error.copy()
    table = table_of([(zero, zero, predicted, weights, zero, flags)])
    weigh_by_agreement(table, (0, 1), -1, 1.0, others, FusedTuning(), np.inf, agreeing)
    expected = _agreement(error).mean() if others else weights.mean()
    assert agreeing[0] == pytest.approx(expected)
    return weights


def test_agreement_weights_fall_with_the_error_and_are_zero_where_there_is_nothing():
    error = np.zeros((20, 31), np.float32)
    error[:, 20:] = 12.0
    error[4, 5] = np.nan
    weights = _agreement(error)
    assert weights.dtype == np.float32
    assert weights[4, 5] == 0
    assert weights[10, 3] == 1
    assert weights[10, 28] < 0.2
    assert 0 <= weights.min() <= weights.max() <= 1
    falling = [
        float(_agreement(np.full((9, 9), level, np.float32))[4, 4])
        for level in (0, 2, 4, 8, 16, 1000)
    ]
    assert falling == sorted(falling, reverse=True)
    assert falling[0] == 1
    assert falling[-1] < 0.05
    assert _agreement(-error)[10, 28] == weights[10, 28]


def test_a_view_that_is_often_wrong_is_believed_less_where_it_seems_right():
    right = np.zeros((20, 40), np.float32)
    np.testing.assert_array_equal(_agreement(right, others=7), 1)
    weights = []
    for share in (0.25, 0.5):
        error = right.copy()
        error[:, : round(40 * share)] = 12.0
        weights.append([float(_agreement(error, others)[10, 35]) for others in (0, 1, 3, 7)])
    assert weights[0][0] == weights[1][0] == 1
    for often in weights:
        assert often == sorted(often, reverse=True)
        assert often[-1] > 0.2
    assert weights[1][1] < weights[0][1] < 1
    assert weights[1][3] < weights[0][3]
    # nothing to compare tells nothing of the rest
    error = right.copy()
    error[:, :20] = np.nan
    np.testing.assert_array_equal(_agreement(error, others=7)[:, 20:], 1)


# --- flags -------------------------------------------------------------------------------


def test_pixels_beyond_the_residual_threshold_are_flagged_and_left_out():
    grid = make_grid()
    truth = np.full(grid.hr_shape(LR_SHAPE), 100, np.float32)
    own, other, *_ = _views(truth, grid)
    observed = other.observed.copy()
    observed[11, 23] += 90
    outlier = replace(other, observed=observed)
    result = _fuse([own, outlier], grid, threshold=40.0)
    flagged = np.argwhere(result.flags[1] & Rejection.RESIDUAL)
    assert flagged.tolist() == [[11, 23]]
    assert result.weights[1][11, 23] == 0
    assert not (outlier.flags & Rejection.RESIDUAL).any(), "the input is not changed"
    np.testing.assert_allclose(result.estimate, 100, atol=0.1)
    lenient = _fuse([own, outlier], grid, threshold=120.0)
    assert not (lenient.flags[1] & Rejection.RESIDUAL).any()


@pytest.mark.parametrize("reason", [reason for reason in Rejection if reason])
def test_reasons_that_exclude_and_reasons_that_are_suspicions(reason):
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid, count=2)
    views[1].flags[10:20, 10:30] = np.uint8(reason)
    result = _fuse(views, grid)
    excluded = result.weights[1][10:20, 10:30] == 0
    suspicion = reason in (Rejection.WEIGHT, Rejection.EDGE)
    assert excluded.all() == excluded.any() == (not suspicion)
    np.testing.assert_array_equal(result.flags[1][10:20, 10:30] & reason, reason)


def test_pixels_without_a_place_are_left_out():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    own, other = _views(truth, grid, count=2)
    position, flags = other.position.copy(), other.flags.copy()
    position[5:30] = np.nan
    flags[5:30] = Rejection.NO_MOTION
    result = _fuse([own, replace(other, position=position, flags=flags)], grid)
    assert not result.weights[1][5:30].any()
    assert np.isfinite(result.estimate).all()
    nowhere = replace(other, position=np.full_like(position, np.nan), flags=np.full_like(flags, 1))
    alone = _fuse([own], grid)
    assert _score(_fuse([own, nowhere], grid), truth) > _score(alone, truth) - 0.02


# --- where things land -------------------------------------------------------------------


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
def test_a_ramp_lies_where_the_grid_says(magnification, sampling):
    grid = make_grid(*magnification, sampling)
    psf = GaussianPsf.of(0.5 * max(magnification))
    height, width = grid.hr_shape((16, 22))
    y, x = np.mgrid[:height, :width]
    truth = (20 + 2.0 * x + 1.1 * y).astype(np.float32)
    views = []
    for index, shift in enumerate(SHIFTS):
        column, row = np.meshgrid(np.arange(22) + shift[0], np.arange(16) + shift[1])
        seen = (
            20
            + 2.0 * (grid.magnification_x * column + grid.offset_x)
            + 1.1 * (grid.magnification_y * row + grid.offset_y)
        )
        views.append(make_view(seen, shift, is_reference=index == 0))
    inner = (slice(5 * magnification[1], -5 * magnification[1]),
             slice(5 * magnification[0], -5 * magnification[0]))  # fmt: skip
    for chosen in (views[:1], views):
        estimate = _fuse(chosen, grid, psf=psf).estimate
        np.testing.assert_allclose(estimate[inner], truth[inner], atol=0.35)
        assert abs((estimate - truth)[inner].mean()) < 0.03


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
def test_the_initial_estimate_is_bicubic_at_the_phase_of_the_grid(magnification, sampling):
    grid = make_grid(*magnification, sampling)
    observed = make_truth((14, 19))
    np.testing.assert_allclose(initial_estimate(observed, grid), bicubic(observed, grid), atol=1e-3)


@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
def test_a_bright_pixel_lies_where_the_grid_says(magnification, sampling):
    grid = make_grid(*magnification, sampling)
    psf = GaussianPsf.of(0.5 * max(magnification))
    observed = np.full((15, 21), 60, np.float32)
    observed[6, 11] = 200
    estimate = _fuse([make_view(observed, is_reference=True)], grid, psf=psf).estimate - 60
    height, width = estimate.shape
    centre_x = grid.magnification_x * 11 + grid.offset_x
    centre_y = grid.magnification_y * 6 + grid.offset_y
    mass = np.where(estimate > 50, estimate, 0)  # beyond what rings around it
    assert (mass.sum(axis=0) @ np.arange(width)) / mass.sum() == pytest.approx(centre_x, abs=0.15)
    assert (mass.sum(axis=1) @ np.arange(height)) / mass.sum() == pytest.approx(centre_y, abs=0.15)


def test_a_constant_stays_constant():
    grid = make_grid(3, 2, Sampling.AREA)
    views = [
        make_view(np.full((9, 14), 77), shift, is_reference=shift == (0, 0)) for shift in SHIFTS
    ]
    result = _fuse(views, grid)
    np.testing.assert_allclose(result.estimate, 77, atol=0.01)
    for view, weight in zip(views, result.weights, strict=True):
        assert (weight[view.flags == 0] == 1).all()


def test_where_a_view_sees_more_its_detail_goes_there():
    """Other views of the left half alone: the right half is no worse than of one view."""
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid)
    for view in views[1:]:
        view.flags[:, 27:] |= np.uint8(Rejection.OCCLUDED)
    alone, together = _fuse(views[:1], grid).estimate, _fuse(views, grid).estimate
    errors = [np.abs(estimate - truth)[BORDER:-BORDER] for estimate in (alone, together)]
    left, right = np.s_[:, BORDER:46], np.s_[:, 64:-BORDER]
    assert errors[1][left].mean() < 0.8 * errors[0][left].mean()
    assert errors[1][right].mean() <= 1.02 * errors[0][right].mean()
    assert together.shape == (80, 108)


# --- the record --------------------------------------------------------------------------


def test_the_record_says_what_was_done():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid)
    result = _fuse(views, grid)
    assert result.estimate.shape == result.density.shape == truth.shape
    assert result.estimate.dtype == np.float32
    assert result.iterations > 0
    assert result.stop_reason == "iterations"
    assert len(result.residuals) >= 1
    assert 0 < result.residuals[-1] < 3
    assert (result.density >= 0).all()
    observed = sum(float(weight[weight > SMALLEST_WEIGHT].sum()) for weight in result.weights)
    assert observed * 0.9 < result.density.sum() < observed * 1.0001, "but for what lands outside"
    taps = sampling_taps(PSF, grid)
    for view, weight, flags, misfit in zip(
        views, result.weights, result.flags, result.misfits, strict=True
    ):
        simulated = simulate(result.estimate, taps, *landing_points(view, grid))
        assert weight.shape == flags.shape == simulated.shape == LR_SHAPE
        trusted = (flags == 0) & np.isfinite(simulated)
        rms = np.sqrt(((simulated - view.observed)[trusted] ** 2).mean())
        assert misfit == pytest.approx(rms, rel=1e-4)
        assert 0 <= weight.min() <= weight.max() <= 1
        assert (flags >= view.flags).all()
        inside = np.isfinite(simulated)
        assert inside[1:-1, 1:-1].all()
        assert (weight[~inside] == 0).all()
        assert np.abs(simulated - view.observed)[inside].mean() < 2
    assert (result.weights[0] == 1).all()
    assert not result.flags[0].any(), "the reference itself is always trusted"


def test_one_thread_or_two_give_the_same_bits():
    grid = make_grid(3, 2, Sampling.AREA)
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid, noise=1.0)
    before = thread_count()
    try:
        results = []
        for threads in (1, 2, 1):
            set_threads(threads)
            results.append(_fuse(views, grid, noise=1.0))
    finally:
        set_threads(before)
    for other in results[1:]:
        np.testing.assert_array_equal(other.estimate, results[0].estimate)
        np.testing.assert_array_equal(other.weights, results[0].weights)
        assert other.residuals == results[0].residuals


def test_stop_ends_the_work_early():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = _views(truth, grid)
    polls = []

    def stop() -> bool:
        polls.append(None)
        return True

    result = _fuse(views, grid, stop=stop)
    assert result.stop_reason == "stopped"
    assert result.iterations == 0
    assert len(polls) >= 1
    start = restored(views[0].observed, grid, PSF, 0.3)
    np.testing.assert_array_equal(result.estimate, start)


def test_a_better_start_is_used():
    grid = make_grid()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    own = _views(truth, grid, count=1)
    warm = _fuse(own, grid, start=truth)
    assert _score(warm, truth) > _score(_fuse(own, grid), truth) + 1
    np.testing.assert_array_equal(truth, make_truth(grid.hr_shape(LR_SHAPE))), "it is not modified"


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 2), (3, 5)])
@pytest.mark.parametrize(("magnification", "sampling"), PHASES)
def test_tiny_images_and_wide_psfs(shape, magnification, sampling):
    grid = make_grid(*magnification, sampling)
    psf = GaussianPsf.of(2.0)
    truth = np.random.default_rng(1).uniform(90, 130, grid.hr_shape(shape))
    views = _views(truth, grid, count=2, lr_shape=shape, psf=psf)
    result = _fuse(views, grid, psf=psf)
    assert result.estimate.shape == grid.hr_shape(shape)
    assert np.isfinite(result.estimate).all()
    assert 40 < result.estimate.min() <= result.estimate.max() < 180
