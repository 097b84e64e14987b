from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pipeline.degradation import Degradation, degrade_image
from pipeline.frames import RegisteredView, Rejection
from pipeline.grid import Grid, Sampling
from pipeline.reconstruction.pocs import PocsResult, StopReason, pocs
from pipeline.reconstruction.psf import GaussianPsf

PSF = GaussianPsf(sigma=1.0, support=7)
ROUNDING = 2e-3
"""What float32 leaves of a residual that should be zero, grey levels."""


def _grid(along_x: int = 2, along_y: int = 2, sampling: Sampling = Sampling.AREA) -> Grid:
    return Grid(magnification_x=along_x, magnification_y=along_y, sampling=sampling)


def _view(observed, shift=(0.0, 0.0), *, position=None, flags=None) -> RegisteredView:
    """A view whose pixels land ``shift`` LR pixels (x, y) from where they are."""
    observed = np.asarray(observed, np.float32)
    rows, columns = observed.shape
    if position is None:
        x, y = np.meshgrid(np.arange(columns), np.arange(rows))
        position = np.stack([x + shift[0], y + shift[1]], axis=-1)
    return RegisteredView(
        view_id="v",
        observed=observed,
        position=np.asarray(position, np.float32),
        registration_weights=np.zeros_like(observed),
        flags=np.zeros(observed.shape, np.uint8) if flags is None else flags,
        confidence=np.ones_like(observed),
    )


def _one_pixel(value: float, x: float, y: float) -> RegisteredView:
    """A single constraint at an LR point of the reference view."""
    return _view([[value]], position=[[[x, y]]])


def _solve(views, grid, estimate, *, psf_x=PSF, psf_y=PSF, **options) -> PocsResult:
    estimate = np.asarray(estimate, np.float32)
    numbers = {
        "sweeps": 1, "residual_bound": 0.0, "residual_threshold": math.inf, "simplified": False,
    }  # fmt: skip
    return pocs(views, grid, estimate.shape, psf_x, psf_y, estimate, **(numbers | options))


def _image(height: int = 18, width: int = 26, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(20, 230, (height, width)).astype(np.float32)


def _taps(psf: GaussianPsf | None, position: float, size: int) -> np.ndarray:
    """(size,) float64: the PSF along one axis, reflected about the edges."""
    centre = math.floor(position + 0.5)
    if psf is None:
        centre = math.floor(position)
        entries = {centre: 1 - (position - centre), centre + 1: position - centre}
    else:
        reach = psf.support // 2
        entries = dict(enumerate(psf.taps_at(position - centre), start=centre - reach))
    row = np.zeros(size)
    for at, tap in entries.items():
        at %= 2 * size
        row[at if at < size else 2 * size - 1 - at] += tap
    return row


def _kernel(grid, hr_shape, x, y, psf_x=PSF, psf_y=PSF) -> np.ndarray:
    """(KH, KW) float64: h_psf of one LR point on the whole HR image."""
    along_x = _taps(psf_x, x * grid.magnification_x + grid.offset_x, hr_shape[1])
    along_y = _taps(psf_y, y * grid.magnification_y + grid.offset_y, hr_shape[0])
    return np.outer(along_y, along_x)


def _simulate(image, grid, shape, shift, psf_x=PSF, psf_y=PSF) -> np.ndarray:
    """What a view shifted by (x, y) LR pixels shows of an HR image, (H, W) float32."""
    columns = [
        _taps(psf_x, (c + shift[0]) * grid.magnification_x + grid.offset_x, image.shape[1])
        for c in range(shape[1])
    ]
    rows = [
        _taps(psf_y, (r + shift[1]) * grid.magnification_y + grid.offset_y, image.shape[0])
        for r in range(shape[0])
    ]
    return (np.array(rows) @ image.astype(np.float64) @ np.array(columns).T).astype(np.float32)


def _by_hand(views, grid, estimate, bound, threshold, simplified, psf_x=PSF, psf_y=PSF):
    """One sweep with a kernel as large as the image: Eq. 8, 9 and 10 as they are written."""
    estimate = estimate.astype(np.float64)
    squares, beyond = [], []
    for view in views:
        for row, column in np.ndindex(view.observed.shape):
            x, y = view.position[row, column].astype(np.float64)
            if view.flags[row, column]:
                continue
            h = _kernel(grid, estimate.shape, x, y, psf_x, psf_y)
            residual = view.observed[row, column] - (h * estimate).sum()
            if abs(residual) > threshold:
                beyond.append((row, column))
                continue
            squares.append(residual**2)
            if simplified:
                estimate += residual * h
            elif residual > bound:
                estimate += (residual - bound) / (h**2).sum() * h
            elif residual < -bound:
                estimate += (residual + bound) / (h**2).sum() * h
    return estimate, math.sqrt(np.mean(squares)), beyond


SHIFTS = st.integers(-31, 31).map(lambda number: number / 64)
"""LR pixels, exact in float32."""

SEEDS = st.integers(0, 2**16)


@pytest.mark.parametrize("simplified", [False, True])
@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize(
    ("magnification", "psf_x", "psf_y"),
    [
        ((2, 2), PSF, PSF),
        ((3, 3), GaussianPsf(sigma=1.7, support=13), GaussianPsf(sigma=1.7, support=13)),
        ((2, 1), GaussianPsf(sigma=1.0, support=9), None),
        ((1, 2), None, GaussianPsf(sigma=0.4, support=5)),
        ((2, 2), GaussianPsf(sigma=0.8, support=1), GaussianPsf(sigma=0.6, support=17)),
    ],
)
def test_a_sweep_is_the_equations_as_written(magnification, psf_x, psf_y, sampling, simplified):
    grid = _grid(*magnification, sampling)
    rng = np.random.default_rng(3)
    shape = (4, 7)
    start = _image(*grid.hr_shape(shape), seed=1)
    views = []
    for shift in ((0, 0), (0.3, -0.2), (-0.45, 0.1)):
        view = _view(rng.uniform(0, 255, shape), shift)
        x = (view.position[..., 0] * grid.magnification_x + grid.offset_x) / start.shape[1]
        y = (view.position[..., 1] * grid.magnification_y + grid.offset_y) / start.shape[0]
        inside = (x > -0.4 / start.shape[1]) & (y > -0.4 / start.shape[0]) & (x < 1) & (y < 1)
        view.flags[~inside] = Rejection.OUTSIDE
        view.flags[rng.uniform(size=shape) < 0.1] = Rejection.WEIGHT
        views.append(view)
    expected, rms, beyond = _by_hand(views, grid, start, 6.0, 90.0, simplified, psf_x, psf_y)
    found = _solve(
        views, grid, start, psf_x=psf_x, psf_y=psf_y,
        residual_bound=6.0, residual_threshold=90.0, simplified=simplified,
    )  # fmt: skip
    np.testing.assert_allclose(found.estimate, expected, atol=2e-2)
    assert found.residuals == pytest.approx([rms], rel=1e-4)
    assert sum(found.dropped) == len(beyond) > 0
    assert sum(found.active) + sum(found.dropped) == sum((v.flags == 0).sum() for v in views)


@given(x=SHIFTS, y=SHIFTS, level=st.floats(1, 254, width=32), simplified=st.booleans())
def test_a_constant_image_stays_constant(x, y, level, simplified):
    grid = _grid(2, 3)
    level = np.float32(level)
    views = [_view(np.full((5, 8), level), (x, y)), _view(np.full((5, 8), level), (-x, y / 2))]
    result = _solve(views, grid, np.full(grid.hr_shape((5, 8)), level), simplified=simplified)
    np.testing.assert_allclose(result.estimate, level, atol=ROUNDING)
    assert result.residuals[-1] < ROUNDING


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize("simplified", [False, True])
def test_without_magnification_and_blur_the_view_itself_comes_out(sampling, simplified):
    observed = _image(7, 12)
    result = _solve(
        [_view(observed)], _grid(1, 1, sampling), np.zeros_like(observed),
        psf_x=None, psf_y=None, simplified=simplified,
    )  # fmt: skip
    np.testing.assert_allclose(result.estimate, observed, atol=1e-4)


def test_an_axis_without_blur_takes_a_row_from_its_own_row_only():
    grid = _grid(2, 1)
    start = np.zeros((5, 16), np.float32)
    result = _solve([_view([[100.0]], position=[[[4.0, 2.0]]])], grid, start, psf_y=None)
    touched = np.flatnonzero(result.estimate.any(axis=1))
    assert touched.tolist() == [2]
    assert (result.estimate[2] != 0).sum() == PSF.support


@given(x=st.floats(-0.24, 8.2), y=st.floats(-0.24, 5.2), value=st.floats(0, 255))
@example(x=0.0, y=0.0, value=255.0)
def test_projecting_twice_is_projecting_once(x, y, value):
    """A projection is idempotent: Eq. 9, one constraint."""
    constraint = _one_pixel(value, x, y)
    for bound in (0.0, 3.0):
        once = _solve([constraint], _grid(), _image(12, 18), residual_bound=bound)
        twice = _solve([constraint], _grid(), once.estimate, residual_bound=bound)
        assert twice.residuals[0] <= bound + ROUNDING
        np.testing.assert_allclose(twice.estimate, once.estimate, atol=2 * ROUNDING)


@given(x=st.floats(-0.24, 8.2), y=st.floats(-0.24, 5.2), value=st.floats(0, 255))
def test_the_simplified_step_is_a_share_of_the_exact_one(x, y, value):
    """Eq. 10 moves by Σh² of Eq. 9 with δ₀ = 0, in the same direction."""
    start = _image(12, 18)
    constraint = _one_pixel(value, x, y)
    exact = _solve([constraint], _grid(), start).estimate - start
    short = _solve([constraint], _grid(), start, simplified=True).estimate - start
    x, y = constraint.position[0, 0].astype(np.float64)
    energy = (_kernel(_grid(), start.shape, x, y) ** 2).sum()
    np.testing.assert_allclose(short, energy * exact, atol=2e-4)


def test_far_from_the_border_that_share_is_the_energy_of_the_psf():
    start = np.zeros((30, 40), np.float32)
    constraint = _one_pixel(100.0, 7.0, 6.0)
    grid = _grid(sampling=Sampling.DECIMATION)
    exact = _solve([constraint], grid, start).estimate
    short = _solve([constraint], grid, start, simplified=True).estimate
    assert short[12, 14] / exact[12, 14] == pytest.approx(PSF.energy, rel=1e-5)


@given(x=SHIFTS, y=SHIFTS, error=st.floats(-5, 5))
def test_within_the_bound_the_estimate_is_left_untouched(x, y, error):
    grid = _grid()
    truth = _image(10, 14)
    observed = _simulate(truth, grid, (5, 7), (0, 0)) + np.float32(error)
    bound = abs(error) + 0.01
    result = _solve([_view(observed)], grid, truth, residual_bound=bound)
    np.testing.assert_array_equal(result.estimate, truth)
    assert result.residuals[0] == pytest.approx(abs(error), abs=ROUNDING)
    there = float(_simulate(truth, grid, (5, 7), (x, y))[2, 3])
    inner = _one_pixel(there + 20, 3 + x, 2 + y)
    moved = _solve([inner], grid, truth, residual_bound=0.5).estimate
    assert np.abs(moved - truth).max() > 0


@pytest.mark.parametrize("simplified", [False, True])
@given(x=SHIFTS, y=SHIFTS, seed=SEEDS)
def test_no_step_leads_away_from_an_image_that_meets_all_constraints(simplified, x, y, seed):
    """Sets are convex and the image is in all of them: every projection comes nearer (Fejér)."""
    grid = _grid()
    truth = _image(12, 16, seed)
    shape = (6, 8)
    interior = np.full(shape, np.uint8(Rejection.OUTSIDE))
    interior[1:-1, 1:-1] = 0
    views = [
        _view(_simulate(truth, grid, shape, shift), shift, flags=interior.copy())
        for shift in ((x, y), (-y, x), (0.5 * y, -x))
    ]
    estimate = np.full_like(truth, 128)
    distances = [np.linalg.norm(estimate - truth)]
    for view in views * 2:
        estimate = _solve([view], grid, estimate, simplified=simplified).estimate
        distances.append(np.linalg.norm(estimate - truth))
    assert all(later <= earlier + ROUNDING for earlier, later in pairwise(distances))
    assert distances[-1] < distances[0]


@pytest.mark.parametrize("simplified", [False, True])
def test_residuals_fall_over_the_sweeps_and_the_truth_comes_nearer(simplified):
    grid = _grid(sampling=Sampling.DECIMATION)
    y, x = np.mgrid[:40, :60]
    truth = (128 + 60 * np.sign(np.sin(x / 3.1) * np.cos(y / 4.3))).astype(np.float32)
    shifts = [(0, 0), (0.5, 0), (0, 0.5), (0.45, 0.4)]
    views = [_view(_simulate(truth, grid, (20, 30), s), s) for s in shifts]
    start = np.kron(views[0].observed, np.ones((2, 2), np.float32))
    result = _solve(views, grid, start, simplified=simplified, sweeps=6)
    assert all(later < earlier for earlier, later in pairwise(result.residuals))
    assert result.residuals[-1] < 0.35 * result.residuals[0]
    inner = np.s_[4:-4, 4:-4]
    before, after = (
        np.abs(image[inner] - truth[inner]).mean() for image in (start, result.estimate)
    )
    assert after < 0.85 * before


def test_the_exact_step_converges_faster_than_the_simplified_one():
    grid = _grid()
    truth = _image(20, 28)
    view = _view(_simulate(truth, grid, (10, 14), (0, 0)))
    start = np.full_like(truth, 125)
    exact, short = (
        _solve([view], grid, start, simplified=simplified, sweeps=4).residuals[-1]
        for simplified in (False, True)
    )
    assert exact < 0.5 * short


def test_it_undoes_set_1():
    """The solver's PSF and phase are those of the degradation: the truth is a fixed point."""
    truth = np.kron(np.random.default_rng(2).integers(30, 220, (9, 13)), np.ones((4, 4)))
    truth = truth.astype(np.uint8)
    degradation = Degradation(magnification_x=2, magnification_y=2, psf_sigma=1.0, psf_support=7)
    view = _view(degrade_image(truth, degradation))
    flags = np.full(view.observed.shape, np.uint8(Rejection.OUTSIDE))
    flags[2:-2, 2:-2] = 0  # the border reflects otherwise there
    view = _view(view.observed, flags=flags)
    result = _solve([view], degradation.grid, truth.astype(np.float32), residual_bound=0.51)
    np.testing.assert_array_equal(result.estimate, truth)
    assert 0.2 < result.residuals[0] < 0.4  # the rounding to 8 bit


@pytest.mark.parametrize("simplified", [False, True])
def test_a_gross_outlier_is_skipped_and_flagged(simplified):
    grid = _grid()
    truth = _image(12, 20) * np.float32(0.1) + np.float32(100)
    observed = _simulate(truth, grid, (6, 10), (0, 0))
    observed[2, 7] += 90
    observed[4, 1] = np.nan
    view = _view(observed)
    result = _solve([view], grid, truth, residual_threshold=30.0, simplified=simplified)
    np.testing.assert_allclose(result.estimate, truth, atol=ROUNDING)
    expected = np.zeros((6, 10), np.uint8)
    expected[2, 7] = expected[4, 1] = Rejection.RESIDUAL
    np.testing.assert_array_equal(result.flags[0], expected)
    assert (result.active, result.dropped) == ((58,), (2,))
    assert view.flags.max() == 0, "the view itself is not changed"
    trusting = _solve([_view(np.nan_to_num(observed))], grid, truth, simplified=simplified)
    assert np.abs(trusting.estimate - truth).max() > 5


def test_a_pixel_beyond_the_threshold_is_tried_again_in_the_next_sweep():
    """Its neighbours pull the estimate to where it agrees: the last sweep has no flag."""
    start = np.zeros((12, 20), np.float32)
    steps = [_view([[20.0 * n]], position=[[[5.0, 3.0]]]) for n in (4, 1, 2, 3)]
    result = _solve(steps, _grid(), start, residual_threshold=25.0, sweeps=1)
    assert result.dropped == (1, 0, 0, 0)
    result = _solve(steps, _grid(), start, residual_threshold=25.0, sweeps=2)
    assert result.dropped == (0, 1, 1, 0)
    assert [int(flags[0, 0]) for flags in result.flags] == [
        0, Rejection.RESIDUAL, Rejection.RESIDUAL, 0,
    ]  # fmt: skip


def test_flagged_pixels_are_no_constraints_and_keep_their_flags():
    grid = _grid()
    flags = np.full((5, 9), np.uint8(Rejection.DEPTH | Rejection.RESIDUAL))
    start = _image(10, 18)
    result = _solve([_view(np.zeros((5, 9)), flags=flags)], grid, start, sweeps=3)
    np.testing.assert_array_equal(result.estimate, start)
    np.testing.assert_array_equal(result.flags[0], flags)
    assert result.stop_reason is StopReason.NO_CONSTRAINTS
    assert result.sweeps_done == 1
    assert math.isnan(result.residuals[0])


def test_positions_that_are_nowhere_are_ignored_and_flagged():
    grid = _grid()
    shape = (4, 6)
    view = _view(np.full(shape, 200.0))
    view.position[0, 1] = np.nan
    view.position[1, 2, 1] = np.nan
    view.position[2, 3] = (-0.6, 1)
    view.position[2, 4] = (5.6, 1)
    view.position[3, 5] = (1e30, np.inf)
    start = np.full(grid.hr_shape(shape), 100, np.float32)
    result = _solve([view], grid, start)
    expected = np.zeros(shape, np.uint8)
    expected[0, 1] = expected[1, 2] = Rejection.NO_MOTION
    expected[2, 3] = expected[2, 4] = expected[3, 5] = Rejection.OUTSIDE
    np.testing.assert_array_equal(result.flags[0], expected)
    assert result.active == (19,)
    assert np.isfinite(result.estimate).all()


@given(
    x=st.floats(-3, 9, width=32),
    y=st.floats(-3, 7, width=32),
    sigma=st.floats(0.2, 4),
    reach=st.integers(0, 10),
    blurred=st.tuples(st.booleans(), st.booleans()),
)
@example(x=-0.25, y=-0.25, sigma=0.2, reach=10, blurred=(True, True))
@example(x=6.24, y=3.24, sigma=4.0, reach=10, blurred=(True, False))
def test_wherever_a_pixel_lands_it_is_met_or_left_out(x, y, sigma, reach, blurred):
    """Windows wider than the image included; the taps' sum is one everywhere."""
    psf = GaussianPsf(sigma=sigma, support=2 * reach + 1)
    grid = _grid()
    start = np.full((8, 14), 80, np.float32)
    options = {"psf_x": psf if blurred[0] else None, "psf_y": psf if blurred[1] else None}
    once = _solve([_one_pixel(140.0, x, y)], grid, start, **options)
    again = _solve([_one_pixel(140.0, x, y)], grid, once.estimate, **options)
    assert np.isfinite(once.estimate).all()
    if once.active == (1,):
        assert once.residuals[0] == pytest.approx(60, abs=ROUNDING)
        assert again.residuals[0] < 10 * ROUNDING
    else:
        assert once.flags[0][0, 0] == Rejection.OUTSIDE
        np.testing.assert_array_equal(once.estimate, start)


def test_half_a_pixel_apart_the_two_phases_differ_by_a_shift():
    """Decimation at LR x is the area phase at x − (K − 1) / 2K."""
    start = _image(12, 18)
    by_decimation = _solve(
        [_one_pixel(99.0, 4.25, 3.0)], _grid(sampling=Sampling.DECIMATION), start
    ).estimate
    by_area = _solve([_one_pixel(99.0, 4.0, 2.75)], _grid(), start).estimate
    np.testing.assert_allclose(by_decimation, by_area, atol=ROUNDING)


def test_the_sweeps_end_when_the_residual_has_settled():
    grid = _grid()
    truth = _image(12, 20)
    views = [_view(_simulate(truth, grid, (6, 10), (0, 0)) + 8.0 * sign) for sign in (-1, 1)]
    result = _solve(views, grid, np.full_like(truth, 128), sweeps=200, simplified=True)
    assert result.stop_reason is StopReason.SETTLED
    assert 2 < result.sweeps_done < 200
    assert len(result.residuals) == result.sweeps_done
    *_, before, last = result.residuals
    assert abs(before - last) <= 1e-3 * before
    assert last > 1, "the two views contradict each other"


def test_the_sweeps_end_when_they_are_done():
    grid = _grid()
    view = _view(_simulate(_image(12, 20), grid, (6, 10), (0, 0)))
    start = np.full((12, 20), 128, np.float32)
    result = _solve([view], grid, start, sweeps=3)
    assert (result.sweeps_done, result.stop_reason) == (3, StopReason.SWEEPS)
    nothing = _solve([view], grid, start, sweeps=0)
    assert (nothing.sweeps_done, nothing.residuals) == (0, ())
    np.testing.assert_array_equal(nothing.estimate, start)


def test_the_caller_may_stop_it_between_sweeps():
    grid = _grid()
    view = _view(_simulate(_image(12, 20), grid, (6, 10), (0, 0)))
    start = np.full((12, 20), 128, np.float32)
    answers = iter([False, False, True])
    result = _solve([view], grid, start, sweeps=50, stop=lambda: next(answers))
    assert (result.sweeps_done, result.stop_reason) == (2, StopReason.STOPPED)
    np.testing.assert_array_equal(result.estimate, _solve([view], grid, start, sweeps=2).estimate)


def test_it_is_repeatable_and_changes_none_of_its_input():
    grid = _grid()
    views = [_view(_image(6, 10, seed), (0.1 * seed, -0.2)) for seed in range(3)]
    start = _image(12, 20, 9)
    kept = start.copy(), [view.flags.copy() for view in views]
    first, second = (_solve(views, grid, start, sweeps=3) for _ in range(2))
    np.testing.assert_array_equal(first.estimate, second.estimate)
    np.testing.assert_array_equal(start, kept[0])
    for view, flags in zip(views, kept[1], strict=True):
        np.testing.assert_array_equal(view.flags, flags)
    with pytest.raises(ValueError, match="read-only"):
        first.estimate[0, 0] = 0


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"sweeps": -1}, "sweeps"),
        ({"residual_bound": -0.1}, "residual_bound"),
        ({"residual_bound": math.nan}, "residual_bound"),
        ({"residual_threshold": 0.0}, "residual_threshold"),
        ({"residual_threshold": math.nan}, "residual_threshold"),
        ({"psf_x": GaussianPsf(sigma=0.05, support=3)}, "use None"),
    ],
)
def test_what_is_out_of_range_is_refused(changed, says):
    with pytest.raises(ValueError, match=says):
        _solve([_view(np.zeros((3, 4)))], _grid(), np.zeros((6, 8)), **changed)


def test_what_does_not_fit_is_refused():
    view = _view(np.zeros((3, 4)))
    start = np.zeros((6, 8), np.float32)
    numbers = {
        "sweeps": 1, "residual_bound": 0.0, "residual_threshold": 9.0, "simplified": False,
    }  # fmt: skip
    with pytest.raises(ValueError, match="initial estimate"):
        pocs([view], _grid(), (6, 9), PSF, PSF, start, **numbers)
    start[2, 2] = np.nan
    with pytest.raises(ValueError, match="finite"):
        pocs([view], _grid(), (6, 8), PSF, PSF, start, **numbers)
    start[2, 2] = 0
    wrong = _view(np.zeros((3, 4)), position=np.zeros((4, 3, 2)))
    with pytest.raises(ValueError, match="do not fit"):
        pocs([wrong], _grid(), (6, 8), PSF, PSF, start, **numbers)
