"""Robust fits of parametric motion: known motions come back, whatever a quarter of them does."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.frames import View
from pipeline.registration import kernels
from pipeline.registration.kernels import FITTED, TOO_FEW
from pipeline.registration.method import MotionModel
from pipeline.registration.motions import (
    MOTION_SIZE,
    OFFSET,
    FitPrior,
    Pass,
    centres,
    fit_motions,
    from_parallax,
    from_parents,
    no_motion,
    parallax_directions,
)
from pipeline.registration.parallax import ParallaxMotion, identity
from pipeline.registration.patches import Patches
from pipeline.registration.prepare import PreparedView, prepare

HEIGHT, WIDTH = 64, 92
FREE = FitPrior(along=1e3, across=1e3, linear=1.0, quadratic=1.0)
PASSES = (Pass(level=2, iterations=8), Pass(level=1, iterations=8), Pass(level=0, iterations=12))
X, Y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))


def _texture(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A smooth picture of sinusoids, known at every point, grey levels."""
    rng = np.random.default_rng(21)
    total = np.full(x.shape, 125.0)
    for _ in range(24):
        period, angle, phase = rng.uniform(6, 40), rng.uniform(0, np.pi), rng.uniform(0, 7)
        along = x * np.cos(angle) + y * np.sin(angle)
        total += 9 * np.sin(2 * np.pi * along / period + phase)
    return total


def _prepared(luma: np.ndarray, depth_map: np.ndarray | None = None) -> PreparedView:
    return prepare(View(view_id="v", luma=luma.astype(np.float32), depth_map=depth_map), 4)


def _patch(*windows, low=-np.inf, high=np.inf) -> Patches:
    windows = np.array(windows or [(0, 0, WIDTH, HEIGHT)], np.int32)
    count = len(windows)
    return Patches(
        windows=windows,
        ranges=np.tile(np.array([low, high], np.float32), (count, 1)),
        planes=np.zeros((count, 3)),
        support=np.zeros(count, np.int32),
    )


def _fit(source, reference, patches=None, start=None, *, prior=FREE, passes=PASSES, **options):
    patches = patches or _patch()
    return fit_motions(
        source, reference, patches, no_motion(patches) if start is None else start, passes, prior,
        parallax_directions(patches, None),
        **({"model": MotionModel.AFFINE, "noise": 0.5, "min_support": 40} | options),
    )  # fmt: skip


def _displacements(patches: Patches, motion: np.ndarray, index: int = 0) -> np.ndarray:
    """(h, w, 2): the displacement of every pixel of a patch's window."""
    x0, y0, x1, y1 = patches.windows[index]
    return np.array(
        [
            [kernels.displacement_at(patches.windows, motion, index, x, y) for x in range(x0, x1)]
            for y in range(y0, y1)
        ]
    )


def _true_motion(model: MotionModel) -> np.ndarray:
    """(1, 13) motion of the whole image, up to four pixels, unequal along x and y."""
    motion = np.zeros((1, MOTION_SIZE))
    motion[0, [0, 6]] = 2.3, -1.4
    if model >= MotionModel.AFFINE:
        motion[0, [1, 2, 7, 8]] = 0.7, -0.35, 0.2, 0.5
    if model >= MotionModel.QUADRATIC:
        motion[0, [3, 4, 5, 9, 10, 11]] = 0.3, -0.2, 0.15, -0.1, 0.2, -0.25
    return motion


def _moved(model: MotionModel, *, offset=0.0, noise=0.0, elsewhere=0.0):
    """Source and reference with that motion between them; a share of the source goes elsewhere."""
    patches = _patch()
    truth = _true_motion(model)
    shift = _displacements(patches, truth)
    luma = _texture(X + shift[..., 0], Y + shift[..., 1]) + offset
    if elsewhere:
        side = round(elsewhere * WIDTH)
        luma[:, 30 : 30 + side] = (_texture(X + 5.2, Y - 3.7) + offset)[:, 30 : 30 + side]
    rng = np.random.default_rng(6)
    reference = _texture(X, Y) + rng.normal(0, noise, X.shape)
    luma = luma + rng.normal(0, noise, X.shape)
    return _prepared(luma), _prepared(reference), shift


# --- fits --------------------------------------------------------------------------------


@pytest.mark.parametrize("model", list(MotionModel))
def test_a_view_does_not_move_against_itself(model):
    view = _prepared(_texture(X, Y))
    fitted = _fit(view, view, _patch((3, 2, 43, 30), (40, 20, 90, 64)), model=model)
    assert fitted.status.tolist() == [FITTED, FITTED]
    np.testing.assert_allclose(fitted.motion, 0, atol=1e-3)
    assert fitted.reliable.min() > 0.99


@pytest.mark.parametrize("elsewhere", [0.0, 0.25])
@pytest.mark.parametrize("model", list(MotionModel))
def test_a_known_motion_comes_back(model, elsewhere):
    source, reference, truth = _moved(model, elsewhere=elsewhere)
    fitted = _fit(source, reference, model=model)
    assert fitted.status.tolist() == [FITTED]
    away = np.linalg.norm(_displacements(_patch(), fitted.motion) - truth, axis=-1)
    assert np.median(away) < 0.02
    if not elsewhere:
        assert away.max() < 0.06
        assert fitted.reliable[0] > 0.85
    else:
        assert 0.5 < fitted.reliable[0] < 0.85


@pytest.mark.parametrize("model", list(MotionModel))
def test_noise_of_two_grey_levels_moves_a_fit_by_hundredths(model):
    source, reference, truth = _moved(model, noise=2.0)
    fitted = _fit(source, reference, model=model, noise=2.0)
    away = np.linalg.norm(_displacements(_patch(), fitted.motion) - truth, axis=-1)
    assert np.median(away) < 0.02
    assert fitted.scale[0] == pytest.approx(np.sqrt(2) * 2.0, rel=0.7)


def test_a_poorer_model_takes_the_mean_motion():
    source, reference, truth = _moved(MotionModel.AFFINE)
    fitted = _fit(source, reference, model=MotionModel.TRANSLATION)
    assert (fitted.motion[0, [1, 2, 3, 4, 5, 7, 8, 9, 10, 11]] == 0).all()
    np.testing.assert_allclose(fitted.motion[0, [0, 6]], truth.mean(axis=(0, 1)), atol=0.25)


@pytest.mark.parametrize("offset", [-6.0, 4.5])
def test_the_intensity_offset_is_found(offset):
    """ζ is what has to be added to reference − source; it is the source that is brighter here."""
    source, reference, truth = _moved(MotionModel.AFFINE, offset=offset)
    fitted = _fit(source, reference)
    assert fitted.motion[0, OFFSET] == pytest.approx(offset, abs=0.1)
    away = np.linalg.norm(_displacements(_patch(), fitted.motion) - truth, axis=-1)
    assert np.median(away) < 0.02


def test_only_the_pixels_of_the_patch_take_part():
    """Two surfaces that move apart in one window, told from each other by their nearness."""
    near = (X // 12 + Y // 12) % 2 == 0
    luma = np.where(near, _texture(X + 3.1, Y - 0.6), _texture(X - 1.2, Y + 0.8))
    depth_map = np.where(near, 50, 10).astype(np.float32)
    source, reference = _prepared(luma, depth_map), _prepared(_texture(X, Y), depth_map)
    for low, high, expected in ((30, np.inf, (3.1, -0.6)), (-np.inf, 30, (-1.2, 0.8))):
        start = no_motion(_patch())
        start[0, [0, 6]] = expected[0] + 0.8, expected[1] - 0.5
        fitted = _fit(
            source, reference, _patch(low=low, high=high), start, passes=PASSES[2:],
            model=MotionModel.TRANSLATION,
        )  # fmt: skip
        np.testing.assert_allclose(fitted.motion[0, [0, 6]], expected, atol=0.05)


def test_destination_support_leaves_out_what_lands_on_another_depth():
    """The reference shows another surface in the right part; it says so by its depth (Fig. 4)."""
    hidden = X > 50
    depth_map = np.full(X.shape, 10, np.float32)
    covered = np.where(hidden, 50, 10).astype(np.float32)
    luma = _texture(X + 1.3, Y - 0.4)
    reference = np.where(hidden, _texture(X - 1.0, Y + 1.0), _texture(X, Y))
    patches = _patch(low=5, high=15)
    options = {"model": MotionModel.TRANSLATION, "passes": PASSES[2:]}
    source, target = _prepared(luma, depth_map), _prepared(reference, covered)
    with_support = _fit(source, target, patches, destination_margin=2.0, **options)
    np.testing.assert_allclose(with_support.motion[0, [0, 6]], [1.3, -0.4], atol=0.02)
    assert with_support.status.tolist() == [FITTED]
    elsewhere = _prepared(reference, np.full(X.shape, 50, np.float32))
    nothing = _fit(source, elsewhere, patches, destination_margin=2.0, **options)
    assert nothing.status.tolist() == [TOO_FEW]
    np.testing.assert_array_equal(nothing.motion, 0)


# --- fits that fail keep their start -----------------------------------------------------


def _start(patches: Patches, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-1, 1, (len(patches.windows), MOTION_SIZE))


def test_too_small_a_support_is_not_fitted_and_keeps_its_start():
    source, reference, _ = _moved(MotionModel.AFFINE)
    patches = _patch((10, 10, 16, 15), (0, 0, 40, 40))
    start = _start(patches)
    before = start.copy()
    fitted = _fit(source, reference, patches, start, min_support=200, passes=PASSES[2:])
    assert fitted.status[0] == TOO_FEW
    assert fitted.status[1] != TOO_FEW
    np.testing.assert_array_equal(fitted.motion[0], start[0])
    np.testing.assert_array_equal(start, before), "the start itself is not modified"


def test_a_patch_that_lands_outside_keeps_its_start():
    view = _prepared(_texture(X, Y))
    start = no_motion(_patch())
    start[0, [0, 6]] = 300.0, -10.0
    fitted = _fit(view, view, start=start)
    assert fitted.status.tolist() == [TOO_FEW]
    np.testing.assert_array_equal(fitted.motion, start)


@pytest.mark.parametrize(
    ("prior", "tolerance"), [(FitPrior(along=2.0, across=0.5), 1e-4), (FREE, 0.02)]
)
def test_without_texture_a_patch_stays_at_its_start(prior, tolerance):
    flat = _prepared(np.full(X.shape, 90.0))
    patches = _patch((0, 0, 40, 30))
    start = no_motion(patches)
    start[0, [0, 1, 6, 8]] = 1.7, 0.2, -0.9, 0.1
    fitted = _fit(flat, flat, patches, start, prior=prior)
    np.testing.assert_allclose(fitted.motion, start, atol=tolerance)


def test_along_an_edge_a_patch_stays_at_its_start_and_moves_across():
    """Stripes: the motion along them cannot be seen, and the prior keeps it."""
    stripes, moved = (_prepared(120 + 50 * np.sin((X + shift) / 3)) for shift in (0.0, 0.8))
    patches = _patch((20, 10, 60, 50))
    start = no_motion(patches)
    start[0, 6] = 0.6
    prior = FitPrior(along=2.0, across=2.0)
    fitted = _fit(moved, stripes, patches, start, prior=prior, model=MotionModel.TRANSLATION)
    assert fitted.motion[0, 0] == pytest.approx(0.8, abs=0.02)
    assert fitted.motion[0, 6] == pytest.approx(0.6, abs=0.02)


def test_a_firm_prior_holds_the_direction_it_names():
    source, reference, _ = _moved(MotionModel.TRANSLATION)
    patches = _patch()
    directions = np.array([[1.0, 0.0]])
    fitted = fit_motions(
        source, reference, patches, no_motion(patches), PASSES[:2],
        FitPrior(along=100.0, across=1e-4), directions,
        model=MotionModel.TRANSLATION, noise=1.0, min_support=40,
    )  # fmt: skip
    assert abs(fitted.motion[0, 6]) < 0.05, "across: held"
    assert abs(fitted.motion[0, 0]) > 0.3, "along: free"


@pytest.mark.parametrize("shape", [(1, 30), (30, 1), (3, 5), (1, 1)])
def test_tiny_images_neither_crash_nor_run_away(shape):
    luma = np.random.default_rng(2).uniform(0, 255, shape).astype(np.float32)
    patches = _patch((0, 0, shape[1], shape[0]))
    fitted = _fit(_prepared(luma), _prepared(luma), patches)
    assert fitted.status.tolist() == [FITTED if luma.size == 30 else TOO_FEW]
    np.testing.assert_allclose(fitted.motion, 0, atol=1e-3)


def test_levels_that_the_pyramid_lacks_are_left_out():
    source, reference, truth = _moved(MotionModel.TRANSLATION)
    passes = (Pass(level=9, iterations=5), *PASSES)
    fitted = _fit(source, reference, passes=passes, model=MotionModel.TRANSLATION)
    np.testing.assert_allclose(fitted.motion[0, [0, 6]], truth[0, 0], atol=0.02)


def test_fits_do_not_depend_on_their_neighbours():
    source, reference, _ = _moved(MotionModel.AFFINE)
    windows = [(0, 0, 40, 30), (30, 10, 80, 60), (50, 30, 92, 64)]
    together = _fit(source, reference, _patch(*windows)).motion
    alone = [_fit(source, reference, _patch(window)).motion[0] for window in windows]
    np.testing.assert_array_equal(together, alone)


# --- starts ------------------------------------------------------------------------------

COORDINATE = st.integers(0, 40)
WINDOW = st.tuples(COORDINATE, COORDINATE, st.integers(1, 30), st.integers(1, 30)).map(
    lambda w: (w[0], w[1], w[0] + w[2], w[1] + w[3])
)


@given(parent=WINDOW, child=WINDOW, seed=st.integers(0, 99))
def test_a_child_inherits_exactly_the_motion_of_its_parent(parent, child, seed):
    parents, children = _patch(parent, (0, 0, 9, 9)), _patch(child)
    motion = _start(parents, seed)
    inherited = from_parents(children, parents, motion, np.array([0]))
    for x, y in ((child[0], child[1]), (child[2] - 1, child[1]), (7.3, -2.0)):
        expected = kernels.displacement_at(parents.windows, motion, 0, x, y)
        found = kernels.displacement_at(children.windows, inherited, 0, x, y)
        np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-7)
    assert inherited[0, OFFSET] == motion[0, OFFSET]


def test_each_child_has_its_own_parent():
    parents, children = _patch((0, 0, 8, 8), (8, 0, 16, 8)), _patch(*[(0, 0, 8, 8)] * 3)
    motion = no_motion(parents)
    motion[:, 0] = 1.0, 2.0
    inherited = from_parents(children, parents, motion, np.array([1, 0, 1]))
    assert inherited[:, 0].tolist() == [2, 1, 2]


PARALLAX = ParallaxMotion(
    homography=np.array([[1.01, 0.02, -3.0], [-0.01, 0.99, 2.0], [0, 0, 1.0]]),
    epipole=np.array([6.0, -1.5, 0.0]),
)
"""An affine camera: planes then move affinely, without a remainder."""


def test_from_parallax_moves_the_points_of_a_plane_as_the_parallax_does():
    patches = _patch((10, 4, 50, 30), (0, 40, 17, 64))
    patches.planes[:] = [[0.5, 0.1, -0.05], [0.9, -0.2, 0.07]]
    motion = from_parallax(patches, PARALLAX)
    for index in range(2):
        xc, yc, size = (values[index] for values in centres(patches))
        x0, y0, x1, y1 = patches.windows[index]
        x, y = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
        along_x, along_y = (x - xc) / size, (y - yc) / size
        plane = np.tensordot(patches.planes[index], [np.ones(x.shape), along_x, along_y], axes=1)
        expected = PARALLAX.land(x, y, plane) - np.stack([x, y], axis=-1)
        np.testing.assert_allclose(_displacements(patches, motion, index), expected, atol=1e-9)
    assert not motion[:, [3, 4, 5, 9, 10, 11, OFFSET]].any()


def test_the_parallax_directions_are_unit_vectors_along_the_epipole():
    patches = _patch((10, 4, 50, 30), (0, 40, 17, 64))
    directions = parallax_directions(patches, PARALLAX)
    expected = np.array([6.0, -1.5]) / np.hypot(6.0, 1.5)
    np.testing.assert_allclose(directions, [expected, expected], atol=1e-12)
    for nowhere in (None, identity()):
        np.testing.assert_array_equal(parallax_directions(patches, nowhere), [[1, 0], [1, 0]])
