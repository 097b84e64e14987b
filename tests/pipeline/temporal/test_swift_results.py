"""Swift frames as results: as good as cold ones each by itself, and no ghosts of what has gone."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import SWIFT, Effort, nearest_views
from pipeline.errors import ConfigurationError
from pipeline.metrics import psnr
from pipeline.superresolve.restore import REGISTER_EVERY
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker

NOISE = 2.0
SCENE = SampleScene(width=128, height=96, num_views=4)
TARGETS = tuple(SCENE.view_ids[number] for number in SCENE.reference_views)
FIRST = 4
"""The first frame of a chain that is not registered."""
SIDE, STEP = 6, 24
"""Of the small fast thing: its side, and how far it goes from one frame to the next, LR pixels."""


@pytest.fixture(scope="module")
def quiet():
    """Frames without noise: what stands still comes out as it does cold. At first all does."""
    still = SCENE.frame(0)
    frames = [replace(still, frame_index=number) for number in range(FIRST)]
    return frames + [replace(SCENE.frame(n), frame_index=FIRST + n) for n in range(4)]


@pytest.fixture(scope="module")
def standing():
    """The same of a scene whose light stands still, too."""
    still = SCENE.frame(0)
    return [replace(still, frame_index=number) for number in range(FIRST + 4)]


def _worker(temporal="swift", **others):
    settings = Settings(
        psf_sigma=1.0, noise_sigma=NOISE, sampling="decimation", temporal=temporal, **others
    )
    return Worker(settings, targets=TARGETS)


def _is_swift(result):
    return result.report.effort.by_depth


def _with_views(frame, change):
    return replace(frame, views=tuple(map(change, frame.views)))


def _with_luma(frame, change):
    """Return the frame with every view's picture changed."""
    return _with_views(
        frame,
        lambda view: replace(
            view, luma=np.clip(change(view.luma.copy()), 0, 255).astype(np.float32)
        ),
    )


def _both(frames, effort=None):
    """Return the last of the frames, at the end of a chain of all of them, and cold.

    Parameters
    ----------
    effort : Effort, optional
        Of the frames from the first one on that need not be registered; default: swift ones.
    """
    worker = _worker() if effort is None else _worker("warm")
    for number, frame in enumerate(frames):
        held = effort is not None and number >= FIRST
        ours = worker.take(frame, effort=effort) if held else worker.take(frame)
    return ours, _worker("cold").take(frames[-1])


IN_TURN = replace(SWIFT, views=3, steps=3, in_turn=True)


@pytest.mark.parametrize("depth", ["true", "stereo"])
def test_both_eyes_are_as_good_as_cold_in_every_frame(depth):
    swift, cold = _worker(), _worker("cold")
    quick = []
    for number in range(REGISTER_EVERY + 6):
        frame = SCENE.frame(number, noise_sigma=NOISE, depth=depth)
        ours, other = swift.take(frame), cold.take(frame)
        quick.append(_is_swift(ours))
        for target, place in zip(TARGETS, SCENE.reference_views, strict=True):
            picture = SCENE.render_hr(place, number / SCENE.fps)
            truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
            scores = [psnr(one.images[target].luma, truth, border=8) for one in (ours, other)]
            assert scores[0] > scores[1] - 0.05, number
    assert quick == [
        number >= FIRST and number != REGISTER_EVERY for number in range(REGISTER_EVERY + 6)
    ]


def test_where_a_rate_is_held_one_registered_frame_is_enough():
    swift, cold = _worker("warm"), _worker("cold")
    swift.take(SCENE.frame(0, noise_sigma=NOISE))
    for number in range(1, 6):
        frame = SCENE.frame(number, noise_sigma=NOISE)
        ours, other = swift.take(frame, effort=SWIFT), cold.take(frame)
        assert _is_swift(ours)
        assert ours.report.effort == SWIFT
        for target, place in zip(TARGETS, SCENE.reference_views, strict=True):
            picture = SCENE.render_hr(place, number / SCENE.fps)
            truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
            scores = [psnr(one.images[target].luma, truth, border=8) for one in (ours, other)]
            assert scores[0] > scores[1] - 0.05, number


def test_what_changed_while_motions_were_kept_lands_by_its_depth_afterwards():
    """It is there at once, and stands still from then on."""
    first = SCENE.frame(0, noise_sigma=NOISE)
    later = [
        replace(SCENE.frame(20, noise_sigma=NOISE, noise_seed=number), frame_index=number)
        for number in range(1, 11)
    ]
    found = []
    for effort in (SWIFT, Effort(register=False)):
        worker = _worker("warm")
        worker.take(first)
        worker.take(later[0], effort=effort)
        found.append([worker.take(frame, effort=SWIFT) for frame in later[1:]][-1])
    at_once, afterwards = found
    for target in TARGETS:
        assert psnr(at_once.images[target].luma, afterwards.images[target].luma) > 48


def _mean_score(result, number):
    truths = (
        cv2.cvtColor(SCENE.render_hr(place, number / SCENE.fps), cv2.COLOR_RGB2GRAY)
        for place in SCENE.reference_views
    )
    return np.mean(
        [
            psnr(result.images[target].luma, truth.astype(np.float32), border=8)
            for target, truth in zip(TARGETS, truths, strict=True)
        ]
    )


def test_of_the_nearest_views_alone_what_changes_is_better_by_depth_than_by_kept_motions():
    frames = [SCENE.frame(number, noise_sigma=NOISE) for number in range(7)]
    scores = []
    few = replace(IN_TURN, in_turn=False)
    for effort in (SWIFT, few, replace(few, by_depth=False), IN_TURN):
        worker = _worker("warm")
        worker.take(frames[0])
        results = [worker.take(frame, effort=effort) for frame in frames[1:]]
        assert all(result.report.effort == effort for result in results)
        scores.append([_mean_score(result, n) for n, result in enumerate(results, 1)])
    of_all, of_few, kept, of_one = np.array(scores)
    assert (of_few > of_all - 0.7).all()
    assert (of_few > kept).all()
    assert (of_one > kept).all()


def test_depth_is_asked_of_no_view_that_what_changes_is_not_made_of():
    worker = _worker("warm")
    worker.take(SCENE.frame(0, noise_sigma=NOISE))
    effort = replace(SWIFT, views=3)
    near = nearest_views(SCENE.view_ids, TARGETS, 3)
    for number in range(1, 4):
        frame = _with_views(
            SCENE.frame(number, noise_sigma=NOISE),
            lambda view: view if view.view_id in near else replace(view, depth_map=None),
        )
        assert worker.take(frame, effort=effort).report.effort == effort
    whole = worker.take(SCENE.frame(4, noise_sigma=NOISE), effort=SWIFT)
    assert _is_swift(whole), "the others land again"
    cold = _worker("cold").take(SCENE.frame(4, noise_sigma=NOISE))
    assert _mean_score(whole, 4) > _mean_score(cold, 4) - 0.05


def test_where_a_rate_is_held_and_nothing_is_known_a_frame_is_registered(quiet):
    worker = _worker("warm")
    found = worker.take(_turned(quiet[4]), effort=SWIFT)
    assert found.report.effort.is_full
    assert _is_swift(worker.take(_turned(quiet[5]), effort=SWIFT))


def test_where_a_rate_is_held_a_frame_after_a_cut_is_made_of_each_view_alone(quiet):
    worker, alone = _worker("warm"), _worker("warm")
    worker.take(quiet[0])
    turned = _turned(replace(quiet[4], frame_index=1))
    found = worker.take(turned, effort=SWIFT)
    assert not found.report.effort.registers
    assert not _is_swift(found)
    assert worker.lacks_motions
    wanted = alone.take(turned, effort=Effort(alone=True))
    for name, image in found.images.items():
        away = np.abs(image.luma - wanted.images[name].luma)
        # the little that has not changed by chance stays
        assert away.mean() < 0.02


def _small_and_fast(quiet, number):
    """Return a frame of a thing that jumps by four of its sides, and where it is, LR pixels."""
    left, top = 10 + STEP * (number - FIRST), 40

    def change(luma):
        if number >= FIRST:
            luma[top : top + SIDE, left : left + SIDE] = 250
        return luma

    around = (
        slice(2 * (top - 2), 2 * (top + SIDE + 2)),
        slice(2 * (left - 2), 2 * (left + SIDE + 2)),
    )
    return _with_luma(quiet[number], change), around


def test_a_small_fast_thing_leaves_no_ghost_and_is_all_there(standing):
    """Nothing of it may stay behind, nothing of it be missing."""
    frames, places = zip(
        *(_small_and_fast(standing, number) for number in range(FIRST + 4)), strict=True
    )
    ours, other = _both(frames)
    assert _is_swift(ours)
    for target in TARGETS:
        difference = np.abs(ours.images[target].luma - other.images[target].luma)
        for number in range(FIRST, FIRST + 4):
            here = difference[places[number]]
            assert here.mean() < 2.5, f"where it was in frame {number}"
            assert here.max() < 30.0
        assert psnr(ours.images[target].luma, other.images[target].luma) > 40


def test_of_one_eye_in_turn_no_more_is_left_of_it_than_where_each_is_made_alone(quiet):
    """Neither where it was nor where it is, in the eye that leads and in the one that follows."""
    frames, places = zip(
        *(_small_and_fast(quiet, number) for number in range(FIRST + 4)), strict=True
    )
    for count in (0, 1):
        shown = frames[: len(frames) - count]
        (ours, other), (alone, _) = (
            _both(shown, effort) for effort in (IN_TURN, Effort(alone=True, follow=False))
        )
        assert _is_swift(ours)
        for target in TARGETS:
            for around in places[FIRST : len(shown)]:
                left, most = (
                    np.abs(one.images[target].luma - other.images[target].luma)[around].mean()
                    for one in (ours, alone)
                )
                assert left < most


def _flashing(quiet):
    """Return frames of which a quarter of the last but one flashes."""

    def flash(luma):
        luma[:, 96:] += 70
        return luma

    return [*quiet[: FIRST + 1], _with_luma(quiet[FIRST + 1], flash), quiet[FIRST + 2]]


def test_a_flash_in_a_part_of_the_picture_does_not_stay(standing):
    """A quarter of the picture flashes in one frame and is as before in the next."""
    flashing = _flashing(standing)
    for count in (1, 0):
        ours, other = _both(flashing[: len(flashing) - count])
        assert _is_swift(ours)
        for target in TARGETS:
            difference = ours.images[target].luma - other.images[target].luma
            assert abs(difference[:, 200:].mean()) < 0.3
            assert psnr(ours.images[target].luma, other.images[target].luma) > 40


def test_of_one_eye_in_turn_a_flash_does_not_stay_either(quiet):
    flashing = _flashing(quiet)
    for count in (1, 0):
        shown = flashing[: len(flashing) - count]
        (ours, other), (alone, _) = (
            _both(shown, effort) for effort in (IN_TURN, Effort(alone=True, follow=False))
        )
        assert _is_swift(ours)
        for target in TARGETS:
            difference = ours.images[target].luma - other.images[target].luma
            assert abs(difference[:, 200:].mean()) < 0.3
            left, most = (
                psnr(one.images[target].luma, other.images[target].luma) for one in (ours, alone)
            )
            assert left > most


def _turned(frame):
    return _with_views(
        frame,
        lambda view: replace(
            view,
            luma=np.ascontiguousarray(view.luma[::-1]),
            depth_map=np.ascontiguousarray(view.depth_map[::-1]),
        ),
    )


def test_after_a_cut_and_one_back_nothing_of_the_other_scene_is_seen(quiet):
    """The frame of a cut is the cold one, and another chain begins with it."""
    frames = [*quiet[: FIRST + 1], _turned(quiet[FIRST + 1]), quiet[FIRST + 2]]
    for count in (1, 0):
        ours, other = _both(frames[: len(frames) - count])
        assert all(target.start.is_cut for target in ours.report.targets)
        for target in TARGETS:
            assert np.array_equal(ours.images[target].luma, other.images[target].luma)


def test_a_flash_of_all_is_a_cut_and_leaves_nothing(quiet):
    flashed = _with_luma(quiet[FIRST + 1], lambda luma: luma + 60)
    ours, other = _both([*quiet[: FIRST + 1], flashed, quiet[FIRST + 2]])
    for target in TARGETS:
        assert np.array_equal(ours.images[target].luma, other.images[target].luma)


def test_a_camera_that_moves_does_what_it_does_warm():
    """Every frame shows the scene from another place: each is registered."""
    wide = SampleScene(width=192, height=120, num_views=2)

    def moved(number):
        def cut(view):
            column = 6 * number
            return replace(
                view,
                luma=np.ascontiguousarray(view.luma[:, column : column + 128]),
                depth_map=np.ascontiguousarray(view.depth_map[:, column : column + 128]),
            )

        return _with_views(wide.frame(number, noise_sigma=NOISE), cut)

    settings = Settings(psf_sigma=1.0, noise_sigma=NOISE, sampling="decimation")
    swift, warm = (
        Worker(replace(settings, temporal=kind), targets=wide.view_ids)
        for kind in ("swift", "warm")
    )
    for number in range(FIRST + 3):
        ours, other = (worker.take(moved(number)) for worker in (swift, warm))
        assert not _is_swift(ours)
        for target in wide.view_ids:
            assert np.array_equal(ours.images[target].luma, other.images[target].luma)


def test_without_depth_that_is_right_frames_are_warm_ones(quiet):
    """Nothing is landed by a depth map that says nothing."""

    def blind(frame):
        return _with_views(frame, lambda view: replace(view, depth_map=None))

    swift, warm = _worker(), _worker("warm")
    for frame in quiet[: FIRST + 2]:
        ours, other = swift.take(blind(frame)), warm.take(blind(frame))
        assert not _is_swift(ours)
        for target in TARGETS:
            assert np.array_equal(ours.images[target].luma, other.images[target].luma)


def test_what_a_frame_tried_in_vain_saw_is_forgotten(quiet):
    """A frame of which half changes is registered as if nobody had looked at it before."""

    def negative(luma):
        luma[:, :70] = 255 - luma[:, :70]
        return luma

    changed = _with_luma(quiet[FIRST], negative)
    swift, warm = _worker(), _worker("warm")
    for frame in [*quiet[:FIRST], changed]:
        ours, other = swift.take(frame), warm.take(frame)
    assert not _is_swift(ours)
    for target in TARGETS:
        assert np.array_equal(ours.images[target].luma, other.images[target].luma)


def test_frames_around_it_are_not_for_swift_ones():
    with pytest.raises(ConfigurationError, match="--temporal-window: must be 0 with --temporal sw"):
        Settings(temporal="swift", temporal_window=1)
