"""Learned filters: nothing is invented where there is nothing, mirror images come out mirrored."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.learned_filters import learned_filters
from pipeline.metrics import psnr
from pipeline.reconstruction.fused import (
    FusedTuning,
    begun_alone,
    estimate_alone,
    finished,
    fuse,
)
from pipeline.reconstruction.learned import (
    BAND,
    FilterBank,
    LearnedFilters,
    kinds_of,
    num_classes,
    views_seen,
)
from pipeline.reconstruction.parts import covering_boxes, on_hr_grid
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.reconstruction.restoration import restored
from pipeline.synthetic import SampleScene
from pipeline.threads import set_threads, thread_count
from tests.support.views import LR_SHAPE, PSF, make_grid, make_truth, make_view, observe

MIRRORINGS = (
    lambda image: image[:, ::-1], lambda image: image[::-1], lambda image: image.T,
    lambda image: image[::-1, ::-1],
)  # fmt: skip


def _filters(noise: float = 2.0) -> LearnedFilters:
    found = learned_filters(make_grid(), PSF.sigma, noise)
    assert found is not None
    return found


@pytest.mark.parametrize("noise", [1.0, 3.0, 20.0])
@pytest.mark.parametrize("magnification", [2, 3, 4])
def test_the_restoration_and_the_result_come_nearer_to_the_truth(magnification, noise):
    """On a scene that they were not learned from."""
    scene = SampleScene(
        width=256 // magnification, height=192 // magnification, num_views=2, seed=11,
        magnification=magnification,
    )  # fmt: skip
    grid, psf = make_grid(magnification, magnification), GaussianPsf.of(0.5 * magnification)
    frame = scene.frame(psf_sigma=psf.sigma, psf_support=psf.support, noise_sigma=noise)
    truth, observed = scene.truth(0).hr_luma[0], frame.views[0].luma
    learned = learned_filters(grid, psf.sigma, noise)
    assert learned is not None
    start = restored(observed, grid, psf, noise)
    corrected = learned.of_one.apply(start)
    assert psnr(corrected, truth, border=8) > psnr(start, truth, border=8) + 0.02
    made = fuse(
        [make_view(observed, is_reference=True)], grid, observed.shape, psf,
        noise=noise, residual_threshold=30.0,
    )  # fmt: skip
    finished = learned.finished(made.estimate, made.density)
    assert psnr(finished, truth, border=8) > psnr(made.estimate, truth, border=8) + 0.02


@given(
    grey=st.floats(0, 255, width=32),
    height=st.integers(1, 12),
    width=st.integers(1, 12),
)
def test_a_constant_stays_constant(grey, height, width):
    flat = np.full((height, width), grey, np.float32)
    for bank in (_filters().of_one, _filters().of_all):
        views = None if bank is _filters().of_one else np.ones_like(flat)
        np.testing.assert_allclose(bank.apply(flat, views), flat, atol=2e-3)


@pytest.mark.parametrize("mirrored", MIRRORINGS)
def test_a_mirrored_picture_comes_out_mirrored(mirrored):
    image = make_truth((40, 54))
    turned = np.ascontiguousarray(mirrored(image))
    bank = _filters().of_one
    found, expected = bank.apply(turned), mirrored(bank.apply(image))
    # where the sums of a window round over a limit between classes, another filter is taken
    assert np.mean(np.abs(found - expected) < 0.01) > 0.995


def test_filters_that_are_zero_change_nothing():
    image = make_truth((30, 41))
    bank = FilterBank(np.zeros((num_classes(False), 24), np.float32))
    np.testing.assert_array_equal(bank.apply(image), image)


def test_taps_stand_where_the_picture_shows_them():
    """A bank whose only tap is that of the pixel two rows up and one to the left."""
    taps = np.zeros((num_classes(False), 24), np.float32)
    taps[:, (3 - 2) * 7 + (3 - 1)] = 1.0
    image = make_truth((30, 41))
    count = num_classes(False)
    mirroring = kinds_of(image, None, (0, 30)) // count
    y, x = np.mgrid[5:25, 5:36]
    down, right = np.full(y.shape, 2), np.full(y.shape, 1)
    kind = mirroring[5:25, 5:36]
    down, right = np.where(kind % 2, right, down), np.where(kind % 2, down, right)
    right = np.where(kind >= 2, -right, right)
    expected = image[y - down, x - right] + image[y + down, x + right] - image[y, x]
    found = FilterBank(taps).apply(image)[5:25, 5:36]
    assert set(np.unique(mirroring)) == {0, 1, 2, 3}
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize("box", [np.s_[0:30, 0:41], np.s_[0:1, 40:41], np.s_[9:22, 7:30]])
def test_a_part_is_what_the_whole_has_there(box):
    image, views = make_truth((30, 41)), make_truth((30, 41)) / 50
    bank = _filters().of_all
    found = bank.apply(image, views, inner=box)
    np.testing.assert_array_equal(found, bank.apply(image, views)[box])


def test_the_more_views_the_higher_the_class():
    image = make_truth((30, 41))
    classes = [
        kinds_of(image, np.full_like(image, views), (0, 30)) % num_classes(True)
        for views in (1.0, 2.0, 3.0, 6.0)
    ]
    steps = np.diff(classes, axis=0)
    np.testing.assert_array_equal(steps, np.broadcast_to([[[2]], [[1]], [[2]]], steps.shape))


def test_views_are_counted():
    observed = observe(
        make_truth(make_grid().hr_shape(LR_SHAPE)), make_grid(), LR_SHAPE, (0.0, 0.0)
    )
    shown = [make_view(observed, is_reference=True), *[make_view(observed) for _ in range(3)]]
    for count in (1, 4):
        made = fuse(shown[:count], make_grid(), LR_SHAPE, PSF, noise=0.3, residual_threshold=30.0)
        np.testing.assert_allclose(views_seen(made.density, 2)[20:-20, 20:-20], count, rtol=0.1)


def test_between_the_nodes_it_lies_between_and_beyond_them_nothing_changes():
    low, middle, high = (
        learned_filters(make_grid(), 1.0, noise).of_one.taps for noise in (1.0, 1.5, 2.0)
    )
    np.testing.assert_allclose(middle, (low + high) / 2, atol=1e-6)
    ends = [learned_filters(make_grid(), 9.0, noise).of_all.taps for noise in (8.0, 60.0)]
    np.testing.assert_array_equal(*ends)


def test_the_less_noise_the_less_a_result_is_corrected():
    shares = [_filters(noise).trust for noise in (0.0, 0.5, 1.0, 2.0, 9.0)]
    np.testing.assert_allclose(np.array(shares) / shares[-1], (0.0, 0.25, 0.5, 1.0, 1.0))


@pytest.mark.parametrize("magnification", [(2, 1), (5, 5)])
def test_there_are_none_for_other_magnifications(magnification):
    assert learned_filters(make_grid(*magnification), 1.0, 1.0) is None


def test_one_thread_or_two_give_the_same_bits():
    image = make_truth((3 * BAND + 5, 40))
    before = thread_count()
    try:
        results = []
        for threads in (1, 2):
            set_threads(threads)
            results.append(_filters().of_all.apply(image, np.ones_like(image)))
    finally:
        set_threads(before)
    np.testing.assert_array_equal(*results)


def test_bands_join_without_a_seam():
    image = make_truth((2 * BAND + 9, 40))
    whole = kinds_of(image, None, (0, len(image)))
    part = kinds_of(image, None, (BAND, 2 * BAND))
    np.testing.assert_array_equal(whole[BAND : 2 * BAND], part)


def _wanted(shape: tuple[int, int]) -> np.ndarray:
    wanted = np.zeros(shape, bool)
    wanted[3:9, 2:7] = wanted[-12:-4, -9:] = True
    return wanted


@pytest.mark.parametrize("learned", [None, _filters()])
@pytest.mark.parametrize("magnification", [2, 3])
def test_the_start_is_the_same_where_only_some_of_it_is_wanted(magnification, learned):
    grid = make_grid(magnification, magnification)
    reference = np.random.default_rng(3).uniform(0, 255, (70, 90)).astype(np.float32)
    wanted = _wanted(reference.shape)
    fine = wanted.repeat(magnification, 0).repeat(magnification, 1)
    whole = estimate_alone(reference, grid, PSF, 2.0, learned)
    some = estimate_alone(reference, grid, PSF, 2.0, learned, wanted)
    assert np.array_equal(some[fine], whole[fine])
    assert not some[30 * magnification : 40 * magnification].any()


@pytest.mark.parametrize("noise", [0.5, 2.0])
def test_what_was_begun_before_is_gone_on_with_as_if_it_were_begun_now(noise):
    grid, learned, tuning = make_grid(), _filters(noise), FusedTuning()
    truth = make_truth(grid.hr_shape(LR_SHAPE))
    views = [
        make_view(
            observe(truth, grid, LR_SHAPE, shift, noise=noise), shift,
            is_reference=shift == (0.0, 0.0),
        )
        for shift in ((0.0, 0.0), (0.5, 0.25))
    ]  # fmt: skip
    options = {"noise": noise, "residual_threshold": 30.0, "learned": learned}
    begun = begun_alone(views[0].observed, grid, PSF, noise, learned, tuning)
    now, before = (
        fuse(views, grid, LR_SHAPE, PSF, begun=some, **options) for some in (None, begun)
    )
    np.testing.assert_array_equal(before.estimate, now.estimate)
    assert before.residuals == now.residuals


def test_what_is_finished_in_boxes_is_what_is_finished_at_once():
    grid, learned = make_grid(), _filters()
    reference = np.random.default_rng(3).uniform(0, 255, (70, 90)).astype(np.float32)
    before, after = (
        fuse(
            [make_view(picture, is_reference=True)], grid, reference.shape, PSF,
            noise=2.0, residual_threshold=30.0,
        )
        for picture in (reference, 255 - reference)
    )  # fmt: skip
    boxes = covering_boxes(_wanted(reference.shape))
    shown, whole = finished(before, learned), finished(after, learned)
    some = finished(after, learned, (shown, boxes, grid))
    made = np.zeros(some.shape, bool)
    for box in boxes:
        made[on_hr_grid(box, grid)] = True
    assert np.allclose(some[made], whole[made], atol=1e-3)
    assert np.array_equal(some[~made], shown[~made])
