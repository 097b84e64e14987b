"""A camera that moves: told from a cut, and cheaper than one, no worse and without ghosts."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import Effort
from pipeline.metrics import psnr
from pipeline.registration.register import Previous, prepare_views, register_views
from pipeline.superresolve import terms_of
from pipeline.superresolve.due import MOVED
from pipeline.synthetic import SampleScene
from pipeline.temporal.initial import match_blocks
from pipeline.temporal.moving import FEWEST, FOUND, found_again, has_moved
from pipeline.threads import set_threads, thread_count
from pipeline.worker import Worker

NOISE = 2.0
SCENE = SampleScene(width=256, height=144, num_views=2)
EYES = tuple(SCENE.view_ids[place] for place in SCENE.reference_views)
PAN, WIDTH = 12, 208
"""How far the camera turns from frame to frame, and what it sees, LR pixels."""


@pytest.fixture(scope="module")
def wide():
    return SCENE.frame(0, noise_sigma=0.0)


def _panned(wide, number, change=lambda luma, number: luma):
    """Return what a camera sees that turns past a scene at rest, with noise of its own."""
    chance = np.random.default_rng(number)
    part = slice(PAN * number, PAN * number + WIDTH)

    def seen(view):
        luma = change(view.luma[:, part].copy(), number)
        luma = luma + chance.normal(0, NOISE, luma.shape)
        return replace(
            view,
            luma=np.clip(luma, 0, 255).astype(np.float32),
            depth_map=np.ascontiguousarray(view.depth_map[:, part]),
            chroma=None, calibration=None,
        )  # fmt: skip

    return replace(wide, frame_index=number, views=tuple(seen(view) for view in wide.views))


def _settings(temporal="warm"):
    return Settings(psf_sigma=1.0, noise_sigma=NOISE, sampling="decimation", temporal=temporal)


def _warm(frames):
    """Return the results of the frames, each started from the one before."""
    worker = Worker(_settings(), targets=EYES)
    return [worker.take(frame) for frame in frames]


def _cold(frame):
    return Worker(_settings("cold"), targets=EYES).take(frame)


def _truth(place, number):
    picture = SCENE.render_hr(place, 0.0)[:, 2 * PAN * number : 2 * (PAN * number + WIDTH)]
    return cv2.cvtColor(np.ascontiguousarray(picture), cv2.COLOR_RGB2GRAY).astype(np.float32)


def test_no_frame_is_worse_than_cold_and_the_report_says_what_happened(wide):
    frames = [_panned(wide, number) for number in range(4)]
    for number, ours in enumerate(_warm(frames)):
        other = _cold(frames[number]) if number else ours
        for eye, place in zip(EYES, SCENE.reference_views, strict=True):
            truth = _truth(place, number)
            scores = [psnr(one.images[eye].luma, truth, border=8) for one in (ours, other)]
            assert scores[0] > scores[1] - 0.05
        for target in ours.report.targets:
            assert target.start.has_moved == (number > 0)
            assert not target.start.is_cut
            assert target.start.warm_share == 0
            assert number == 0 or target.iterations <= MOVED.together


def test_on_another_number_of_threads_no_pixel_changes(wide):
    frames, before, results = [_panned(wide, number) for number in range(2)], thread_count(), []
    try:
        for threads in (1, 2):
            worker = Worker(replace(_settings(), threads=threads), targets=EYES)
            results.append([worker.take(frame) for frame in frames][1])
    finally:
        set_threads(before)
    assert all(target.start.has_moved for target in results[0].report.targets)
    for eye in EYES:
        np.testing.assert_array_equal(*(result.images[eye].luma for result in results))


def test_a_small_fast_thing_before_a_moving_camera_leaves_no_ghost(wide):
    side, top = 6, 60

    def left(number):
        return 40 + 24 * number

    def shown(luma, number):
        luma[top : top + side, left(number) : left(number) + side] = 250
        return luma

    frames = [_panned(wide, number, shown) for number in range(3)]
    warm, cold = _warm(frames)[2], _cold(frames[2])
    for eye in EYES:
        away = warm.images[eye].luma - cold.images[eye].luma
        for number in range(3):
            # where it was, as seen from where the camera is now
            x = left(number) - PAN * (2 - number)
            here = away[2 * (top - 2) : 2 * (top + side + 2), 2 * (x - 2) : 2 * (x + side + 2)]
            if number < 2:
                assert np.abs(here).mean() < 2.0, f"where it was in frame {number}"
            else:
                assert abs(here.mean()) < 2.0, "it is all there, be its edges softer or harder"


def test_after_a_cut_nothing_is_kept(wide):
    def turned(frame):
        views = tuple(
            replace(
                view,
                luma=np.ascontiguousarray(view.luma[::-1]),
                depth_map=np.ascontiguousarray(view.depth_map[::-1]),
            )
            for view in frame.views
        )
        return replace(frame, views=views)

    frames = [_panned(wide, 0), _panned(wide, 1), turned(_panned(wide, 2))]
    warm, cold = _warm(frames)[2], _cold(frames[2])
    assert all(target.start.is_cut for target in warm.report.targets)
    assert not any(target.start.has_moved for target in warm.report.targets)
    for eye in EYES:
        np.testing.assert_array_equal(warm.images[eye].luma, cold.images[eye].luma)


def test_motions_of_another_place_are_not_kept_to_save_time(wide):
    kept, alone = (Worker(_settings(), targets=EYES) for _ in range(2))
    for worker in (kept, alone):
        worker.take(_panned(wide, 0))
    result = kept.take(_panned(wide, 1), effort=Effort(register=False))
    expected = alone.take(_panned(wide, 1), effort=Effort(alone=True, refresh_every=None))
    for eye in EYES:
        np.testing.assert_array_equal(result.images[eye].luma, expected.images[eye].luma)
    # the camera stands where it was when nothing was registered
    again, cold = kept.take(_panned(wide, 1)), _cold(_panned(wide, 1))
    for eye, place in zip(EYES, SCENE.reference_views, strict=True):
        scores = [psnr(one.images[eye].luma, _truth(place, 1), border=8) for one in (again, cold)]
        assert scores[0] > scores[1] - 0.05


@pytest.mark.parametrize("shift", [(5, 0), (14, 3), (-9.5, -4.25)])
def test_what_has_moved_is_found_again_unless_a_flash_lights_it(wide, shift):
    matrix = np.array([[1, 0, shift[0]], [0, 1, shift[1]]], float)
    luma = wide.views[0].luma
    moved = cv2.warpAffine(luma, matrix, luma.shape[::-1], borderMode=cv2.BORDER_REFLECT)
    assert has_moved(moved, luma)
    assert has_moved(moved + 6, luma)
    assert not has_moved(moved + 40, luma)


def test_something_else_is_not_found_again(wide):
    luma = wide.views[0].luma
    for other in (luma[::-1], luma[:, ::-1], luma[::-1, ::-1], SCENE.frame(0).views[0].luma.T):
        share, count = found_again(np.ascontiguousarray(other), luma)
        assert share < FOUND / 2
        assert count >= FEWEST or share == 0
        assert not has_moved(np.ascontiguousarray(other), luma)


def test_of_a_plain_picture_nothing_is_said():
    plain = np.full((96, 128), 90, np.float32)
    assert found_again(plain, plain) == (0.0, 0)
    assert not has_moved(plain, plain)


def test_a_picture_in_which_hardly_a_block_matches_matches_nowhere(wide):
    luma = wide.views[0].luma
    assert not match_blocks(np.ascontiguousarray(luma[::-1]), luma, NOISE).matched.any()
    assert match_blocks(luma, luma, NOISE).matched.all()


# --- registration ----------------------------------------------------------------------------


def _registered(frame, previous=None):
    prepared = prepare_views(frame.views, metric=False)
    terms = terms_of(Settings(), NOISE)
    found = register_views(prepared, EYES, EYES, terms, previous=previous)
    return prepared, found


def _seen_by_the_panned(found):
    """Return registrations with the parallax motions that hold in the crop of the next frame.

    A crop has other pixels at the same place; a camera that has moved has not.
    """
    there = np.array([[1.0, 0, -PAN], [0, 1, 0], [0, 0, 1]])

    def seen(one):
        parallax = replace(
            one.parallax,
            homography=there @ one.parallax.homography @ np.linalg.inv(there),
            epipole=there @ one.parallax.epipole,
        )
        return replace(one, parallax=parallax)

    return {eye: [seen(one) for one in views] for eye, views in found.items()}


def _pairs(first, second):
    for eye in EYES:
        for one, other in zip(first[eye], second[eye], strict=True):
            if not one.registered.is_reference:
                yield one, other


def test_a_rig_seen_from_elsewhere_registers_as_from_scratch(wide):
    prepared, found = _registered(_panned(wide, 0))
    found = _seen_by_the_panned(found)
    previous = Previous(prepared=prepared, registrations=found, turn=1, has_moved=True)
    _, moved = _registered(_panned(wide, 1), previous)
    _, fresh = _registered(_panned(wide, 1))
    olds = dict(zip(EYES, (pair for pair, _ in _pairs(found, found)), strict=True))
    for eye, (one, other) in zip(EYES, _pairs(moved, fresh), strict=True):
        assert one.parallax is olds[eye].parallax
        away = np.linalg.norm(one.registered.position - other.registered.position, axis=-1)
        trusted = other.registered.flags == 0
        assert np.nanmedian(away[trusted]) < 0.05
        assert np.mean(one.registered.flags == 0) > trusted.mean() - 0.02


def test_on_another_number_of_threads_no_bit_of_it_changes(wide):
    prepared, found = _registered(_panned(wide, 0))
    previous = Previous(
        prepared=prepared, registrations=_seen_by_the_panned(found), turn=1, has_moved=True
    )
    before, results = thread_count(), []
    try:
        for threads in (1, 2, 3):
            set_threads(threads)
            results.append(_registered(_panned(wide, 1), previous)[1])
    finally:
        set_threads(before)
    for one, other in (pair for more in results[1:] for pair in _pairs(results[0], more)):
        for name in ("position", "flags", "observed", "registration_weights"):
            np.testing.assert_array_equal(
                getattr(one.registered, name), getattr(other.registered, name)
            )


def test_a_rig_whose_cameras_have_moved_to_one_another_is_registered_from_scratch(wide):
    prepared, found = _registered(_panned(wide, 0))
    found = _seen_by_the_panned(found)
    previous = Previous(prepared=prepared, registrations=found, turn=1, has_moved=True)
    frame = _panned(wide, 1)
    matrix = np.array([[1, 0, 0], [0, 1, 0.8]])
    lower = cv2.warpAffine(
        frame.views[1].luma, matrix, frame.views[1].luma.shape[::-1], borderMode=cv2.BORDER_REFLECT
    )
    bent = replace(frame, views=(frame.views[0], replace(frame.views[1], luma=lower)))
    _, moved = _registered(bent, previous)
    _, fresh = _registered(bent)
    for one, other in _pairs(moved, fresh):
        np.testing.assert_array_equal(one.registered.position, other.registered.position)
        np.testing.assert_array_equal(one.registered.flags, other.registered.flags)
