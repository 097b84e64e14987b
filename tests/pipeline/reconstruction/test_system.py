"""The gathered normal equations: adjoint to simulation, symmetric, and they solve the problem."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.grid import Grid, Sampling
from pipeline.reconstruction import kernels, sweeps
from pipeline.reconstruction.psf import GaussianPsf, SeparableTaps, psf_taps, sampling_taps
from pipeline.reconstruction.simd import TOGETHER
from pipeline.reconstruction.system import (
    LEAST_DENSITY,
    NormalEquations,
    bands,
    half_taps,
    low_pass,
    sample,
    simulate,
    spline_coefficients,
)
from pipeline.reconstruction.tables import table_of
from pipeline.threads import set_threads, thread_count

PSF = GaussianPsf(sigma=1.0, support=7)
GRID = Grid(magnification_x=2, magnification_y=2, sampling=Sampling.AREA)
TAPS = sampling_taps(PSF, GRID)
NO_SHARPENING = SeparableTaps(x=np.ones(1), y=np.ones(1))
"""Turns the preconditioner off."""
HR_SHAPE = (22, 34)
"""(KH, KW) of most tests."""


def _image(shape=HR_SHAPE, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 255, shape).astype(np.float32)


def _observations(shape=HR_SHAPE, count=(9, 14), seed: int = 1, *, anywhere: bool = False):
    """Points in the HR image and a little outside, with values and weights.

    They lie on the half-pixel lattice, where the system is exact, or anywhere.
    """
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1.5, shape[1] + 0.5, count).astype(np.float32)
    y = rng.uniform(-1.5, shape[0] + 0.5, count).astype(np.float32)
    if not anywhere:
        x, y = _on_lattice(x, shape[1]), _on_lattice(y, shape[0])
    value = rng.uniform(0, 255, count).astype(np.float32)
    weight = rng.uniform(0.05, 1, count).astype(np.float32)
    weight[rng.random(count) < 0.2] = 0
    return x, y, value, weight


def _on_lattice(points: np.ndarray, size: int) -> np.ndarray:
    """Coordinates moved to the nearest place of the half-pixel lattice, those inside."""
    inside = (points >= -0.5) & (points < size - 0.5)
    return np.where(inside, np.clip(np.rint(2 * points) / 2, 0, size - 1), points)


def _no_prior(shape=HR_SHAPE) -> np.ndarray:
    return np.zeros((4, shape[0] + 1, sweeps.pitch_of(shape[1])), np.uint16)


def _system(
    *observations, shape=HR_SHAPE, taps=TAPS, sharpening=None, local=None, cell=(1, 1), gain=None,
    short=False,
) -> NormalEquations:  # fmt: skip
    system = NormalEquations(
        shape, taps, sharpening or psf_taps(PSF, GRID), local=local, cell=cell, gain=gain,
        short=short,
    )  # fmt: skip
    system.gather(observations)
    return system


def _weights_at(system: NormalEquations, estimate: np.ndarray, scale: float) -> np.ndarray:
    """The prior's weights at an estimate."""
    prior = system._room_for_weights()
    for band in system._bands:
        sweeps.weigh_prior(0.0, estimate, estimate, scale, system._local, *band, prior)
    return prior


def _data_times(system: NormalEquations, image: np.ndarray) -> np.ndarray:
    """BᵀMB times the image, as :meth:`NormalEquations.descend` has it."""
    out = np.empty_like(image)
    system._turn(image, 0.0, image, _no_prior(system.shape), 0.0, out)
    return out


def _prior_times(image: np.ndarray, prior: np.ndarray, scale: float) -> np.ndarray:
    """P times the image: what the prior pulls it by, of a preconditioner that does nothing."""
    nothing, pull = np.zeros_like(image), np.empty_like(image)
    system = NormalEquations(image.shape, TAPS, NO_SHARPENING)
    unit = 1 / (scale * sweeps.TOP)
    system._look(
        0.0, image.copy(), nothing, nothing.copy(), nothing, False, prior, scale, unit, 1.0,
        system._balance(), pull,
    )  # fmt: skip
    return -pull


def _times(system: NormalEquations, image, prior, scale: float, strength: float) -> np.ndarray:
    """(BᵀMB + λ P) times the image."""
    return _data_times(system, image) + np.float32(strength) * _prior_times(image, prior, scale)


def _seen(image, x, y, taps=TAPS) -> np.ndarray:
    """What is observed at the points; zero outside, as the system has it."""
    return np.nan_to_num(simulate(image, taps, x, y)).astype(float)


def _seen_between(image, x, y) -> np.ndarray:
    """The same, interpolated between the four places of the lattice around each point."""
    inside = np.isfinite(simulate(image, TAPS, x, y))
    across, along = (
        np.where(inside, np.clip(2 * points, 0, 2 * size - 2), 0)
        for points, size in zip((y, x), image.shape, strict=True)
    )
    total = np.zeros(x.shape)
    for row in (np.floor(across), np.floor(across) + 1):
        for column in (np.floor(along), np.floor(along) + 1):
            share = (1 - np.abs(across - row)) * (1 - np.abs(along - column))
            places = (np.float32(column / 2), np.float32(row / 2))
            total += np.where(share > 0, share * _seen(image, *places), 0)
    return np.where(inside, total, 0)


# --- adjoint -----------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(1, 1), (1, 8), (6, 1), (2, 2), (3, 10), HR_SHAPE])
@given(seed=st.integers(0, 99))
def test_the_energy_of_an_image_is_that_of_its_samples(shape, seed):
    """<BᵀMB f, f> = Σ w (sample of B f)², for points inside the image."""
    x, y, value, weight = _observations(shape, seed=seed)
    system = _system((x, y, value, weight), shape=shape)
    image = _image(shape, seed)
    applied = _data_times(system, image)
    energy = np.vdot(applied.astype(float), image)
    expected = (weight * _seen(image, x, y) ** 2).sum()
    assert energy == pytest.approx(expected, rel=2e-4, abs=1.0)


@given(seed=st.integers(0, 99))
def test_points_between_places_have_nearly_the_energy_of_their_samples(seed):
    """It is interpolated between those of the four places around them."""
    x, y, value, weight = _observations(seed=seed, anywhere=True)
    system = _system((x, y, value, weight))
    image = _smooth(HR_SHAPE, seed) - np.float32(120)
    energy = np.vdot(_data_times(system, image).astype(float), image)
    exact = (weight * _seen(image, x, y) ** 2).sum()
    assert energy == pytest.approx(exact, rel=0.03)


@given(seed=st.integers(0, 99))
def test_the_right_hand_side_is_adjoint_to_what_the_matrix_samples(seed):
    """<Bᵀ b, f> = Σ w y (sample of B f, between those of the four places around), anywhere."""
    x, y, value, weight = _observations(seed=seed, anywhere=True)
    system = _system((x, y, value, weight), sharpening=NO_SHARPENING)
    # one step of steepest descent from zero goes along Bᵀ b
    start = np.zeros(HR_SHAPE, np.float32)
    step = system.descend(start, 1.0, 0.0, 1)
    rhs = step.astype(float) / np.abs(step).max()
    image = _image(seed=seed + 1)
    products = {
        "image": (np.vdot(rhs, image), (weight * value * _seen_between(image, x, y)).sum()),
        "one": (rhs.sum(), (weight * value * _seen_between(np.ones_like(image), x, y)).sum()),
    }
    assert products["image"][0] / products["one"][0] == pytest.approx(
        products["image"][1] / products["one"][1], rel=1e-3
    )


@given(seed=st.integers(0, 99), strength=st.floats(0, 2))
def test_the_matrix_is_symmetric_and_positive(seed, strength):
    system = _system(_observations(seed=seed))
    prior = _weights_at(system, _image(seed=seed + 5), 8.0)
    first, second = (_image(seed=seed + k) - np.float32(100) for k in range(2))
    applied = [_times(system, image, prior, 8.0, strength) for image in (first, second)]
    one = np.vdot(applied[0].astype(float), second)
    two = np.vdot(applied[1].astype(float), first)
    assert abs(one - two) < 1e-5 * np.linalg.norm(applied[0]) * np.linalg.norm(second)
    assert np.vdot(applied[0].astype(float), first) > 0


def test_the_matrix_is_linear():
    system = _system(_observations())
    prior = _weights_at(system, _image(seed=7), 8.0)
    first, second = _image(seed=1), _image(seed=2)
    both, one, two = (
        _times(system, image, prior, 8.0, 0.3) for image in (2 * first - second, first, second)
    )
    apart = 2 * one - two
    np.testing.assert_allclose(both, apart, atol=0.02 * np.abs(apart).max() * 0.01 + 0.01)


# --- gathering ---------------------------------------------------------------------------


def test_views_add_up():
    first, second = _observations(seed=1), _observations(count=(4, 5), seed=2)
    together, *apart = _system(first, second), _system(first), _system(second)
    image = _image()
    applied = sum(_data_times(system, image) for system in apart)
    found = _data_times(together, image)
    np.testing.assert_allclose(found, applied, atol=2e-4 * np.abs(found).max())
    np.testing.assert_allclose(together.density, sum(system.density for system in apart), atol=1e-4)


def test_gathering_takes_the_place_of_what_was_gathered_before():
    first, second = _observations(seed=1), _observations(count=(4, 5), seed=2)
    system = _system(first)
    system.gather([second])
    image = _image()
    found, expected = (_data_times(one, image) for one in (system, _system(second)))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize("magnification", [(2, 2), (3, 3), (2, 1), (4, 4)])
def test_the_pixels_of_a_reference_lie_on_the_lattice(magnification, sampling):
    """So that a system of one view alone is exact."""
    grid = Grid(magnification_x=magnification[0], magnification_y=magnification[1],
                sampling=sampling)  # fmt: skip
    for points, size in zip(_points(grid, (9, 13)), grid.hr_shape((9, 13))[::-1], strict=True):
        np.testing.assert_array_equal(points, _on_lattice(points, size))


def test_a_plain_at_the_level_about_which_is_worked_stays_exactly():
    """Weights are rounded to 16 bits: only the difference to the level feels it."""
    observations = [_observations(count=(20, 30), seed=seed) for seed in range(6)]
    plain = np.full(HR_SHAPE, 255, np.float32)
    about_plain = NormalEquations(HR_SHAPE, TAPS, psf_taps(PSF, GRID), level=255.0)
    about_plain.gather([(x, y, np.full_like(value, 255), w) for x, y, value, w in observations])
    assert np.abs(about_plain.descend(plain, 1.0, 0.0, 1) - 255).max() == 0


def test_weights_scale_what_they_weigh_and_zero_leaves_out():
    x, y, value, weight = _observations()
    image = _image()
    once, thrice = (
        _data_times(_system((x, y, value, np.float32(factor) * weight)), image) for factor in (1, 3)
    )
    np.testing.assert_allclose(thrice, 3 * once, rtol=1e-3, atol=1e-2)
    nothing = _system((x, y, value, 0 * weight))
    assert not nothing.density.any()
    value[weight == 0] = np.nan
    x[weight == 0] = np.nan
    again = _data_times(_system((x, y, value, weight)), image)
    np.testing.assert_array_equal(again, once)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e9, 1e9])
def test_points_outside_the_image_bring_nothing(bad):
    x, y, value, weight = (array.copy() for array in _observations(count=(2, 3)))
    x[:], weight[:] = bad, 1
    system = _system((x, y, value, weight))
    assert not system.density.any()
    assert not _data_times(system, _image()).any()


def test_density_is_where_the_observations_are():
    one = np.ones((1, 1), np.float32)
    system = _system((20 * one, 5 * one, one, one))
    at = np.unravel_index(np.argmax(system.density), HR_SHAPE)
    assert at == (5, 20)
    assert system.density.sum() == pytest.approx(1)
    twice = _system((20 * one, 5 * one, one, 2 * one))
    np.testing.assert_allclose(twice.density, 2 * system.density, rtol=1e-6)


@pytest.mark.parametrize("height", [1, 2, 3, 7, 22, 401])
def test_bands_cover_every_row_once(height):
    rows = [row for low, high in bands(height) for row in range(low, high)]
    assert rows == list(range(height))
    assert all(low < high for low, high in bands(height))


def _gathered(views, rows, tile):
    """Masses and right-hand side of HR_SHAPE, gathered in bands and in tiles of so many rows."""
    system = NormalEquations(HR_SHAPE, TAPS, psf_taps(PSF, GRID))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipeline.reconstruction.system.bands", lambda _: list(pairwise(rows)))
        patch.setattr("pipeline.reconstruction.system.TILE", tile * HR_SHAPE[1])
        system.gather(views)
    return system._masses[..., : HR_SHAPE[1]] * system._units[:, None, None], system._rhs


@given(
    seed=st.integers(0, 20),
    cuts=st.lists(st.integers(1, HR_SHAPE[0] - 1), max_size=4),
    tile=st.integers(1, HR_SHAPE[0]),
)
def test_gathering_by_bands_and_tiles_is_gathering_at_once(seed, cuts, tile):
    views = [
        _observations(count=count, seed=seed + number, anywhere=True)
        for number, count in enumerate(((11, 17), (5, 6)))
    ]
    masses, rhs = _gathered(views, [0, HR_SHAPE[0]], 2 * HR_SHAPE[0])
    by_tiles, rhs_by_tiles = _gathered(views, [0, *sorted(set(cuts)), HR_SHAPE[0]], tile)
    np.testing.assert_allclose(by_tiles, masses, atol=2e-5 * masses.max())
    np.testing.assert_allclose(rhs_by_tiles, rhs, rtol=1e-5, atol=1e-3)


@given(seed=st.integers(0, 20))
def test_each_observation_is_shared_by_four_places_around_it(seed):
    """By its distance to them, and all of it: sums and centres of weights are kept."""
    x, y, value, weight = _observations(count=(1, 1), seed=seed, anywhere=True)
    weight[:] = 1
    masses, _ = _gathered([(x, y, value, weight)], [0, HR_SHAPE[0]], 24)
    inside = -0.5 <= x[0, 0] < HR_SHAPE[1] - 0.5 and -0.5 <= y[0, 0] < HR_SHAPE[0] - 0.5
    assert masses.sum() == pytest.approx(float(inside), abs=1e-4)
    if inside:
        rows, places, columns = np.nonzero(masses)
        at_x, at_y = columns + places % 2 / 2, rows + places // 2 / 2
        share = masses[rows, places, columns]
        assert (share * at_x).sum() == pytest.approx(np.clip(x[0, 0], 0, HR_SHAPE[1] - 1), abs=1e-3)
        assert (share * at_y).sum() == pytest.approx(np.clip(y[0, 0], 0, HR_SHAPE[0] - 1), abs=1e-3)
        assert max(np.ptp(at_x), np.ptp(at_y)) <= 0.5


def test_long_rows_are_gathered_and_sampled_stretch_by_stretch():
    """As two halves are, apart from each other."""
    shape = (6, 3 * TOGETHER)
    x, y, value, weight = _observations(shape, (5, TOGETHER + 9))
    half = TOGETHER // 2
    whole = _system((x, y, value, weight), shape=shape)
    parts = [
        tuple(np.ascontiguousarray(array[:, part]) for array in (x, y, value, weight))
        for part in (slice(None, half), slice(half, None))
    ]
    np.testing.assert_allclose(whole.density, _system(*parts, shape=shape).density, atol=1e-4)
    image = _image(shape)
    seen = simulate(image, TAPS, x, y)
    np.testing.assert_array_equal(
        seen, np.hstack([simulate(image, TAPS, x, y) for x, y, _, _ in parts])
    )


def test_one_thread_or_two_gather_and_solve_the_same_bits():
    before = thread_count()
    results = []
    try:
        for threads in (1, 2):
            set_threads(threads)
            system = _system(_observations(count=(30, 40)))
            prior = _weights_at(system, _image(), 5.0)
            found = system.descend(np.zeros(HR_SHAPE, np.float32), 5.0, 0.1, 4)
            results.append((system.density.copy(), prior, found))
    finally:
        set_threads(before)
    for one, two in zip(*results, strict=True):
        np.testing.assert_array_equal(one, two)


def _kept(image: np.ndarray, short: bool) -> np.ndarray:
    return image.astype(np.float16).view(np.uint16) if short else image


@given(
    cuts=st.lists(st.integers(1, HR_SHAPE[0] - 1), max_size=4), gain=st.sampled_from([None, 20.0]),
    short=st.booleans(),
)  # fmt: skip
def test_sweeps_by_bands_are_the_same_bits(cuts, gain, short):
    system = _system(_observations(), cell=(2, 3), gain=gain)
    balance = system._balance()
    image = _image()
    x, y, _, _ = _observations(count=(HR_SHAPE[0], 7))
    results = []
    for split in ([0, HR_SHAPE[0]], [0, *sorted(set(cuts)), HR_SHAPE[0]]):
        system._bands = list(pairwise(split))
        prior = _weights_at(system, _image(seed=3), 5.0)
        applied = _times(system, image, prior, 5.0, 0.7)
        looked = []
        for renew in (False, True):
            direction, residual, matrix = (_kept(_image(seed=seed), short) for seed in (5, 6, 7))
            looking, sharpened = image.copy(), np.empty_like(residual)
            system._look(
                0.3, looking, direction, residual, matrix, renew, prior, 5.0, 0.7, 0.04, balance,
                sharpened,
            )  # fmt: skip
            looked += [looking, residual, sharpened, prior.copy()]
        turned = [direction, np.empty_like(direction)]
        system._turn(_kept(image, short), 0.4, direction, prior, 0.7, turned[1], writes=True)
        samples = np.empty(x.shape, np.float32)
        for low, high in pairwise(split):
            kernels.sample_spline(np.pad(image, 2), x, y, low, high, samples)
        results.append((applied, *looked, *turned, samples))
    for once, by_bands in zip(*results, strict=True):
        np.testing.assert_array_equal(once, by_bands)


def test_the_prior_weighed_on_the_way_is_that_weighed_before():
    shape = 2 * sweeps.WEIGHED + 9, 21
    system = _system(_observations(shape), shape=shape)
    looked = []
    for on_the_way in (False, True):
        image, direction, residual, matrix = (_image(shape, seed) for seed in (4, 5, 6, 7))
        prior, sharpened = system._room_for_weights(), np.empty_like(image)
        if not on_the_way:
            sweeps.weigh_prior(0.3, image, direction, 5.0, system._local, 0, shape[0], prior)
        system._look(
            0.3, image, direction, residual, matrix, on_the_way, prior, 5.0, 0.7, 0.04,
            system._balance(), sharpened,
        )  # fmt: skip
        looked.append((image, residual, sharpened, prior))
    for before, now in zip(*looked, strict=True):
        np.testing.assert_array_equal(before, now)


# --- prior -------------------------------------------------------------------------------


def test_a_constant_image_has_no_prior_energy():
    prior = _weights_at(_system(), _image(), 6.0)
    flat = np.full(HR_SHAPE, 77, np.float32)
    np.testing.assert_allclose(_prior_times(flat, prior, 6.0), 0, atol=1e-4)


NEIGHBOURS = ((0, 0, 1, 1.0), (1, 1, -1, 0.5), (2, 1, 0, 1.0), (3, 1, 1, 0.5))
"""Plane, rows down, columns right, and factor of the prior's couplings."""


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (6, 9)])
def test_the_prior_is_the_sum_over_neighbours_of_weighted_squares(shape):
    """fᵀ P f = Σ w (f_i − f_j)² over right, below and the two diagonals (half as strong)."""
    at, image = _image(shape, 4), _image(shape, 5).astype(float)
    system = _system(shape=shape)
    scale = 6.0
    prior = _weights_at(system, at, scale)
    applied = _prior_times(image.astype(np.float32), prior, scale)
    expected = 0.0
    height, width = shape
    for row, column in np.ndindex(shape):
        for plane, down, right, factor in NEIGHBOURS:
            k, m = row + down, column + right
            weight = prior[plane, row + 1, sweeps.LEAD + column] / (scale * sweeps.TOP)
            if k < height and 0 <= m < width:
                expected += factor * weight * (image[k, m] - image[row, column]) ** 2
            else:
                assert weight == 0
    assert np.vdot(applied.astype(float), image) == pytest.approx(expected, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (5, 1), (12, 20), (6, 700)])
def test_weights_of_the_prior_follow_the_mean_square_around_in_sixteen_bits(shape):
    at, scale = _image(shape, 4), 6.0
    local = _image(shape, 8) / np.float32(255)
    prior = _weights_at(_system(shape=shape, local=local), at, scale)
    height, width = shape
    for plane, down, right, _ in NEIGHBOURS:
        inside = np.zeros(shape, bool)
        inside[: height - down, max(0, -right) : width - max(0, right)] = True
        share = scale**2 / (_mean_around(_squares(at, down, right)) + scale**2)
        there = np.pad(local, 1, mode="edge")
        exact = sweeps.TOP * _mean_around(there * (sweeps.FLOOR + (1 - sweeps.FLOOR) * share))
        found = prior[plane, 1:, sweeps.LEAD : sweeps.LEAD + width]
        np.testing.assert_allclose(found[inside], exact[inside], atol=0.6, rtol=1e-5)
        assert not found[~inside].any()


def _squares(image, down, right):
    """Squared differences to a neighbour, (H + 4, W + 4), zero outside."""
    image = image.astype(float)
    height, width = image.shape
    there = np.s_[: height - down, max(0, -right) : width - max(0, right)]
    square = np.zeros((height, width))
    square[there] = (np.roll(image, (-down, -right), (0, 1)) - image)[there] ** 2
    return np.pad(square, 2)


def _mean_around(values):
    """Mean over 3 × 3 values, weighted 1 2 1 along both axes, where all nine are there."""
    for _ in range(2):
        values = (values[:-2] + 2 * values[1:-1] + values[2:]).T / 4
    return values


def test_the_prior_smooths_flat_parts_and_lets_edges_be():
    step = np.full((12, 20), 50, np.float32)
    step[:, 10:] = 200
    weights = _weights_at(_system(shape=step.shape), step, 5.0)
    right, below = weights[0, 1:, sweeps.LEAD :], weights[2, 1:, sweeps.LEAD :]
    assert right[3, 4] == pytest.approx(sweeps.TOP, rel=1e-3)
    assert right[3, 9] < 0.01 * sweeps.TOP
    assert below[3, 9] == pytest.approx(sweeps.TOP, rel=1e-3), "along the edge all is smooth"
    assert not right[:, 19:].any(), "no neighbour outside"


def test_a_noisy_pixel_is_no_edge():
    """An edge goes on; a pixel that stands out alone is smoothed away more strongly."""
    edge, pixel = (np.full((9, 9), 50, np.float32) for _ in range(2))
    edge[:, 4] = pixel[4, 4] = 80
    of_edge, of_pixel = (
        float(_weights_at(_system(shape=(9, 9)), image, 5.0)[0, 5, sweeps.LEAD + 4])
        for image in (edge, pixel)
    )
    assert of_pixel > 1.5 * of_edge


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize("magnification", [(2, 2), (3, 3), (2, 1), (1, 2), (4, 4), (4, 2)])
@pytest.mark.parametrize("tile", [1, 5, 400])
def test_what_lies_as_the_grid_is_gathered_and_sampled_as_what_lies_anywhere(
    magnification, sampling, tile, monkeypatch
):
    grid = Grid(magnification_x=magnification[0], magnification_y=magnification[1],
                sampling=sampling)  # fmt: skip
    lr_shape = (70, 83)
    shape = grid.hr_shape(lr_shape)
    monkeypatch.setattr("pipeline.reconstruction.system.TILE", tile * shape[1])
    x, y = _points(grid, lr_shape)
    values, ones = _image(lr_shape), np.ones(lr_shape, np.float32)
    # another view lands on some of the same places, and between them
    other = tuple(map(np.ascontiguousarray, (x + 0.3, y - 0.6, values[::-1], 0.4 * ones)))
    table = table_of([other, (x, y, values, ones)])
    to_hr = tuple(map(np.float32, (magnification[0], grid.offset_x, magnification[1],
                                   grid.offset_y)))  # fmt: skip
    level = float(values.mean())
    found = []
    for regular in (-1, 1):
        system = NormalEquations(shape, sampling_taps(PSF, grid), psf_taps(PSF, grid), level)
        system.gather_table(table, None, regular, to_hr)
        found.append((system._masses[..., : shape[1]] * system._units[:, None, None], system._rhs))
    (masses, rhs), (regular_masses, regular_rhs) = found
    np.testing.assert_allclose(regular_masses, masses, atol=2e-5 * masses.max())
    np.testing.assert_allclose(regular_rhs, rhs, atol=1e-5 * np.abs(rhs).max())
    coefficients = spline_coefficients(_image(shape), sampling_taps(PSF, grid))
    samples = np.empty(lr_shape, np.float32)
    kernels.sample_regular(coefficients, *to_hr, samples)
    np.testing.assert_allclose(samples, sample(coefficients, x, y), rtol=1e-5)


@pytest.mark.parametrize("moved", [None, (0, 0), (4, 6), (3, 2)])
def test_points_lie_as_the_grid_where_none_of_them_lies_elsewhere(moved):
    points = np.stack(np.meshgrid(np.arange(7), np.arange(5)), axis=-1).astype(np.float32)
    if moved is not None:
        points[moved][1] += 0.25
    assert kernels.lies_as_itself(points) == (moved is None)


# --- solving -----------------------------------------------------------------------------


def _points(grid: Grid, lr_shape: tuple[int, int], shift=(0.0, 0.0)):
    x, y = np.meshgrid(np.arange(lr_shape[1]) + shift[0], np.arange(lr_shape[0]) + shift[1])
    at_x, at_y = grid.to_hr(np.stack([x, y], axis=-1).astype(np.float32))
    return np.ascontiguousarray(at_x), np.ascontiguousarray(at_y)


def _smooth(shape, seed: int = 0) -> np.ndarray:
    """A picture without the finest detail, which no PSF lets through."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    rng = np.random.default_rng(seed)
    total = np.full(shape, 120.0)
    for _ in range(12):
        period, angle, phase = rng.uniform(5, 20), rng.uniform(0, np.pi), rng.uniform(0, 7)
        along = x * np.cos(angle) + y * np.sin(angle)
        total += 9 * np.sin(2 * np.pi * along / period + phase)
    return total.astype(np.float32)


def test_without_magnification_and_blur_the_image_comes_back():
    grid = Grid(magnification_x=1, magnification_y=1, sampling=Sampling.AREA)
    taps = sampling_taps(PSF, grid)
    truth = _image((13, 21))
    ones = np.ones_like(truth)
    system = _system((*_points(grid, truth.shape), truth, ones), shape=truth.shape, taps=taps)
    found = system.descend(np.zeros_like(truth), 1.0, 0.0, 25)
    np.testing.assert_allclose(found, truth, atol=0.5)


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize("magnification", [(2, 2), (3, 2), (2, 1)])
def test_all_phases_without_noise_give_the_truth(magnification, sampling):
    """K² views, one for each sub-pixel phase: the information is there, the solver finds it."""
    grid = Grid(magnification_x=magnification[0], magnification_y=magnification[1],
                sampling=sampling)  # fmt: skip
    psf = GaussianPsf(sigma=0.8, support=7)
    taps = sampling_taps(psf, grid)
    lr_shape = (11, 15)
    truth = _smooth(grid.hr_shape(lr_shape))
    observations = []
    for j in range(magnification[1]):
        for i in range(magnification[0]):
            x, y = _points(grid, lr_shape, (i / magnification[0], j / magnification[1]))
            value = simulate(truth, taps, x, y)
            weight = np.isfinite(value).astype(np.float32)
            observations.append((x, y, np.nan_to_num(value), weight))
    system = _system(shape=truth.shape, taps=taps, sharpening=psf_taps(psf, grid))
    found = np.full_like(truth, 120)
    # where points do not lie on the lattice, the matrix is not quite that of their samples: what is
    # left to explain is asked again
    for _ in range(4):
        beyond = [
            (x, y, value - _seen(found, x, y, taps).astype(np.float32), weight)
            for x, y, value, weight in observations
        ]
        system.gather(beyond, found)
        # a trace of prior: pixels sampled half-way between them do not show their finest detail
        found = system.descend(found, 10.0, 0.002, 80, hold=80)
    error = (found - truth)[4:-4, 4:-4]
    assert np.sqrt((error**2).mean()) < 0.3
    assert np.abs(error).max() < 1.0


def test_residuals_of_the_normal_equations_fall():
    system = _system(_observations(count=(20, 30)))
    start = np.zeros(HR_SHAPE, np.float32)
    prior = _weights_at(system, start, 5.0)
    solution = system.descend(start, 5.0, 0.1, 200, hold=200)
    distances = []
    for steps in (0, 1, 3, 6, 12, 25):
        away = system.descend(start, 5.0, 0.1, steps, hold=200) - solution
        distances.append(np.vdot(away, _times(system, away, prior, 5.0, 0.1)))
    assert all(later < earlier for earlier, later in pairwise(distances))
    assert distances[-1] < 1e-2 * distances[0]


def test_the_preconditioner_converges_faster_to_the_same_solution():
    blocks = np.kron(_image((8, 12)), np.ones((3, 3)))[: HR_SHAPE[0], : HR_SHAPE[1]]
    views = []
    for shift in ((0, 0), (0.5, 0), (0, 0.5), (0.5, 0.5)):
        x, y = _points(GRID, (11, 17), shift)
        value = simulate(blocks.astype(np.float32), TAPS, x, y)
        views.append((x, y, np.nan_to_num(value), np.isfinite(value).astype(np.float32)))
    start = np.full(HR_SHAPE, 120, np.float32)
    without, sharpened = _system(*views, sharpening=NO_SHARPENING), _system(*views)
    solution = without.descend(start, 5.0, 0.05, 200, hold=200)
    away = [
        np.abs(system.descend(start, 5.0, 0.05, 6, hold=200) - solution).mean()
        for system in (without, sharpened)
    ]
    assert away[1] < 0.7 * away[0]
    np.testing.assert_allclose(
        sharpened.descend(start, 5.0, 0.05, 200, hold=200), solution, atol=0.1
    )


@pytest.mark.parametrize("gain", [None, 8.0, 20.0])
def test_the_preconditioner_is_symmetric_and_positive(gain):
    system = _system(_observations(count=(20, 30)), cell=(2, 2), gain=gain)
    balance = system._balance()
    prior = _weights_at(system, _image(), 5.0)
    unit = 1 / (5.0 * sweeps.TOP)

    def sharpened(gradient):
        nothing, out = np.zeros(HR_SHAPE, np.float32), np.empty(HR_SHAPE, np.float32)
        system._look(
            0.0, nothing, nothing, gradient.copy(), nothing, False, prior, 5.0, unit, 0.03,
            balance, out,
        )  # fmt: skip
        return out

    first, second = (_image(seed=seed) - np.float32(128) for seed in (5, 6))
    size = np.linalg.norm(first) * np.linalg.norm(second)
    there, back = np.vdot(sharpened(first), second), np.vdot(first, sharpened(second))
    assert abs(there - back) < 1e-5 * size
    assert np.vdot(first, sharpened(first)) > 0.1 * np.vdot(first, first)


def test_a_balanced_descent_goes_by_how_much_is_observed():
    # one view sees all, seven more the left half
    shifts = [(dx / 4, dy / 4) for dx in (0, 1, 2, 3) for dy in (0, 2)]
    observations = []
    for number, shift in enumerate(shifts):
        x, y = (
            _on_lattice(points, size)
            for points, size in zip(_points(GRID, (11, 17), shift), HR_SHAPE[::-1], strict=True)
        )
        value = simulate(_image(), TAPS, x, y)
        weight = np.isfinite(value) & ((number == 0) | (x < HR_SHAPE[1] / 2))
        observations.append((x, y, np.nan_to_num(value), weight.astype(np.float32)))
    plain, balanced = (_system(*observations, cell=(2, 2), gain=gain) for gain in (None, 20.0))
    (ones, _), (lines, rows) = plain._balance(), balanced._balance()
    assert rows == 2
    assert (ones == 1).all()
    few, many = (lines[2:-2, first : first + 8].mean() for first in (HR_SHAPE[1] - 12, 4))
    assert few == pytest.approx(1 / np.sqrt(0.25 + LEAST_DENSITY), rel=0.05)
    assert many == pytest.approx(1 / np.sqrt(2 + LEAST_DENSITY), rel=0.05)
    start = np.full(HR_SHAPE, 120, np.float32)
    solution = plain.descend(start, 5.0, 0.05, 300, hold=300)
    away = [
        np.abs(system.descend(start, 5.0, 0.05, 4, hold=300) - solution).mean()
        for system in (plain, balanced)
    ]
    assert away[1] < 0.8 * away[0]


@pytest.mark.parametrize("sigma", [0.5, 1.0, 1.7])
@pytest.mark.parametrize("gain", [8.0, 20.0])
def test_the_low_pass_undoes_a_blur_as_far_as_its_gain_goes(sigma, gain):
    half = half_taps(psf_taps(GaussianPsf(sigma=sigma, support=9), GRID).x)
    taps = low_pass(half, gain)
    assert taps.shape == half.shape
    frequencies = np.linspace(0, np.pi, 100)
    blur, passed = (
        t[0] + 2 * sum(t[k] * np.cos(k * frequencies) for k in range(1, t.size))
        for t in (half, taps)
    )
    assert passed[0] == pytest.approx(1, abs=1e-4)
    asked = np.minimum(blur**-2.0, 1 + gain)
    kept = 1 + gain * (1 - passed) ** 2
    assert np.abs(np.log(kept / asked)).max() < np.log(2)


def _objective(system, image, observations, scale, strength, local) -> float:
    """Σ w (s·Bf − y)² + λ / scale · Σ m (f ⟨d²⟩ + (1 − f) scale² log(1 + ⟨d²⟩ / scale²))."""
    x, y, value, weight = observations
    inside = np.isfinite(simulate(image, TAPS, x, y))
    total = (weight * (_seen(image, x, y) - value) ** 2)[inside].sum()
    for _, down, right, factor in NEIGHBOURS:
        square = _squares(image, down, right)
        around = _mean_around(square)
        edges = scale**2 * np.log1p(around / scale**2)
        penalty = sweeps.FLOOR * around + (1 - sweeps.FLOOR) * edges
        total += strength / scale * factor * (np.pad(local, 1, mode="edge") * penalty).sum()
    return total


@pytest.mark.parametrize("hold", [1, 3])
def test_weighing_the_prior_anew_goes_down_to_where_the_penalty_is_least(hold):
    observations = _observations(count=(20, 30))
    local = np.linspace(0.4, 1, HR_SHAPE[1], dtype=np.float32) * np.ones(HR_SHAPE, np.float32)
    system = _system(observations, local=local)
    start = np.full(HR_SHAPE, 120, np.float32)

    def objective(image):
        return _objective(system, image, observations, 5.0, 2.0, local)

    falling = [
        objective(system.descend(start, 5.0, 2.0, n, hold=hold)) for n in (0, 1, 2, 4, 8, 16)
    ]
    assert falling == sorted(falling, reverse=True)
    best = system.descend(start, 5.0, 2.0, 300, hold=hold)
    least = objective(best)
    for seed in range(4):
        other = best + np.float32(0.3) * (_image(seed=seed) - np.float32(127)) / np.float32(127)
        assert objective(other) > least


def test_a_last_step_that_is_not_measured_goes_on_from_the_one_before_it():
    system = _system(_observations(count=(20, 30)))
    start = np.full(HR_SHAPE, 120, np.float32)

    def after(steps, **options):
        return system.descend(start, 5.0, 0.3, steps, hold=20, **options)

    solution = after(200)

    def away(image):
        return np.abs(image - solution).mean()

    assert away(after(6)) < away(after(6, stretch=1.0)) < away(after(5))
    # in proportion to the stretch, along what the gradient and the steps before tell
    once, twice = (after(6, stretch=stretch) - after(5) for stretch in (1.0, 2.0))
    np.testing.assert_allclose(twice, 2 * once, atol=1e-3)
    measured = after(6) - after(5)
    along = float((once * measured).sum())
    assert along > 0.999 * np.linalg.norm(once) * np.linalg.norm(measured)
    np.testing.assert_array_equal(after(1, stretch=2.0), after(1))


def test_a_descent_that_has_come_far_enough_ends():
    system = _system(_observations(count=(20, 30)))
    start = np.full(HR_SHAPE, 120, np.float32)
    found = system.descend(start, 5.0, 0.3, 40, settled=0.1)
    assert 1 < system.steps < 20
    before = system.steps
    np.testing.assert_array_equal(system.descend(start, 5.0, 0.3, before), found)
    system.steps = before
    system.descend(start, 5.0, 0.3, 40, stop=lambda: system.steps > 0)
    assert system.steps == before


def test_a_descent_that_has_nearly_come_far_enough_ends_with_a_step_that_is_not_measured():
    system = _system(_observations(count=(20, 30)))
    start = np.full(HR_SHAPE, 120, np.float32)

    def after(steps, **options):
        system.steps = 0
        return system.descend(start, 5.0, 0.0, steps, **options), system.steps

    found, steps = after(40, settled=0.1, stretch=2.0)
    assert 1 < steps < 20
    np.testing.assert_array_equal(found, after(steps, stretch=2.0)[0])
    assert after(40, settled=0.1)[1] <= steps <= after(40, settled=0.05)[1] + 1


def test_what_is_observed_beyond_a_prediction_leads_where_the_whole_does():
    x, y, value, weight = _observations(count=(20, 30))
    predicting, other = _image(seed=3), _image(seed=8)
    whole, beyond = _system((x, y, value, weight)), _system()
    beyond.gather([(x, y, value - simulate(predicting, TAPS, x, y), weight)], predicting)
    for start in (predicting, other, predicting.copy()):
        expected = whole.descend(start, 5.0, 0.3, 4)
        # weights are rounded, which the whole grey levels feel
        np.testing.assert_allclose(beyond.descend(start, 5.0, 0.3, 4), expected, atol=0.3)


@pytest.mark.parametrize("gain", [None, 20.0])
def test_numbers_of_few_bits_lead_where_others_do(gain):
    shape, start = (45, 83), _image((45, 83), seed=3)
    seen = _observations(shape, (20, 40))
    exact, short = (
        _system(seen, shape=shape, gain=gain, cell=(2, 2), short=short) for short in (False, True)
    )
    for steps in (1, 4, 12):
        expected = exact.descend(start, 5.0, 0.3, steps)
        found = short.descend(start, 5.0, 0.3, steps)
        away = np.linalg.norm(found - expected) / np.linalg.norm(expected - start)
        assert 0 < away < 1e-2, steps
    assert np.isfinite(short.descend(1e3 * start, 5.0, 0.3, 2)).all(), "beyond their range"


def test_the_start_is_not_modified_and_a_solution_stays():
    truth = _smooth(HR_SHAPE)
    x, y = _points(GRID, (11, 17))
    system = _system((x, y, simulate(truth, TAPS, x, y), np.ones(x.shape, np.float32)))
    start = truth.copy()
    found = system.descend(start, 1.0, 0.0, 5)
    np.testing.assert_array_equal(start, truth)
    np.testing.assert_allclose(simulate(found, TAPS, x, y), simulate(truth, TAPS, x, y), atol=0.05)
    zero = _system()
    np.testing.assert_array_equal(zero.descend(start, 1.0, 0.0, 5), start)


def test_simulation_keeps_a_constant_and_follows_a_ramp():
    x, y = _points(GRID, (11, 17), (0.3, -0.2))
    flat = simulate(np.full(HR_SHAPE, 99, np.float32), TAPS, x, y)
    np.testing.assert_allclose(flat[np.isfinite(flat)], 99, rtol=1e-5)
    at_y, at_x = np.mgrid[: HR_SHAPE[0], : HR_SHAPE[1]].astype(np.float32)
    ramp = simulate(3 * at_x - 2 * at_y, TAPS, x, y)
    inner = np.s_[4:-4, 5:-5]
    np.testing.assert_allclose(ramp[inner], (3 * x - 2 * y)[inner], atol=2e-3)


def test_simulation_has_no_value_outside_the_image():
    x = np.array([[-0.6, 33.6, 3, 3, np.nan, -0.4, 33.4]], np.float32)
    y = np.array([[5, 5, -0.6, 21.6, 5, -0.4, 21.4]], np.float32)
    seen = simulate(_image(), TAPS, x, y)
    assert np.isfinite(seen).tolist() == [[False, False, False, False, False, True, True]]


def test_taps_of_another_kind_work_as_well():
    """The system asks nothing of the taps but symmetry."""
    box = SeparableTaps(x=np.full(3, 1 / 3), y=np.ones(1))
    x, y, value, weight = _observations()
    system = _system((x, y, value, weight), taps=box)
    image = _image()
    energy = np.vdot(_data_times(system, image).astype(float), image)
    expected = (weight * _seen(image, x, y, box) ** 2).sum()
    assert energy == pytest.approx(expected, rel=2e-4)
