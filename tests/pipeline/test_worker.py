"""A chain of frames: cheaper than so many stills, never worse, the same every time."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.errors import Interrupted
from pipeline.noise import estimate_noise_of_views
from pipeline.superresolve import Memory
from pipeline.synthetic import SampleScene
from pipeline.temporal.initial import match_blocks
from pipeline.worker import Worker

NOISE = 2.0
SCENE = SampleScene(width=128, height=96, num_views=4)
TARGETS = tuple(SCENE.view_ids[number] for number in SCENE.reference_views)


@pytest.fixture(scope="module")
def frames():
    return [SCENE.frame(number, noise_sigma=NOISE) for number in range(4)]


def _worker(temporal, **others):
    settings = Settings(
        **{"psf_sigma": 1.0, "noise_sigma": NOISE, "sampling": "decimation"} | others,
        temporal=temporal,
    )
    return Worker(settings, targets=TARGETS)


def _psnr(result, truth):
    view_id, picture = truth
    error = result.images[view_id].luma[8:-8, 8:-8] - picture[8:-8, 8:-8]
    return 10 * np.log10(255**2 / np.mean(error**2))


def _truth(number, scene=SCENE):
    picture = scene.render_hr(scene.reference_views[0], number / scene.fps)
    return TARGETS[0], cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)


def test_warm_frames_take_fewer_iterations_and_are_no_worse():
    scene = replace(SCENE, width=192, height=144)
    warm, cold = _worker("warm"), _worker("cold")
    for number in range(4):
        frame, truth = scene.frame(number, noise_sigma=NOISE), _truth(number, scene)
        ours, other = warm.take(frame), cold.take(frame)
        assert _psnr(ours, truth) > _psnr(other, truth) - 0.05
        if number:
            for here, there in zip(ours.report.targets, other.report.targets, strict=True):
                assert here.start.warm_share > 0.35
                # all is made anew whenever the means are of twice as many frames: in 1 and 3
                share = 2 / 3 if number == 2 else 1
                assert here.iterations <= there.iterations * share


@pytest.mark.parametrize("change", ["cut", "flash"])
def test_a_frame_that_has_nothing_of_the_one_before_is_computed_cold(frames, change):
    def other(view):
        luma = view.luma[::-1, ::-1].copy() if change == "cut" else np.minimum(view.luma + 60, 255)
        depth = view.depth_map[::-1, ::-1].copy() if change == "cut" else view.depth_map
        return replace(view, luma=luma, depth_map=depth)

    after = replace(frames[1], views=tuple(other(view) for view in frames[1].views))
    warm = _worker("warm")
    warm.take(frames[0])
    ours, alone = warm.take(after), _worker("cold").take(after)
    for target in TARGETS:
        assert np.array_equal(ours.images[target].luma, alone.images[target].luma)
    assert all(target.start.is_cut for target in ours.report.targets)


def test_a_small_fast_thing_is_not_shown_where_it_was():
    chance = np.random.default_rng(0)
    ground = cv2.GaussianBlur(chance.uniform(0, 255, (64, 64)).astype(np.float32), (0, 0), 1.5)
    before, now = ground.copy(), ground.copy()
    before[30:34, 10:14] = 255
    now[30:34, 50:54] = 255
    matched = match_blocks(now, before, 0.0).matched
    assert not matched[30 // 8, 10 // 8]
    assert not matched[30 // 8, 50 // 8]
    assert matched.mean() > 0.85


def test_whole_pixel_motion_is_found():
    chance = np.random.default_rng(1)
    before = cv2.GaussianBlur(chance.uniform(0, 255, (64, 96)).astype(np.float32), (0, 0), 1.0)
    match = match_blocks(np.roll(before, (2, -3), (0, 1)), before, 0.0)
    assert match.matched[1:-1, 1:-1].all()
    assert (match.motion[1:-1, 1:-1] == [3, -2]).all()


def test_the_same_frames_give_the_same_bits_whatever_the_threads(frames):
    results = []
    for threads in (1, 2):
        worker = _worker("warm", threads=threads)
        results.append([worker.take(frame).images[TARGETS[0]].luma for frame in frames[:3]])
    assert all(np.array_equal(one, two) for one, two in zip(*results, strict=True))


def test_registering_a_frame_ahead_changes_nothing(frames):
    whole, staged = _worker("warm"), _worker("warm")
    results = [whole.take(frame).images[TARGETS[1]].luma for frame in frames[:3]]
    waiting = [staged.register(frames[0])]
    for number in range(3):
        if number < 2:
            waiting.append(staged.register(frames[number + 1]))
        result = staged.reconstruct(waiting.pop(0))
        assert np.array_equal(result.images[TARGETS[1]].luma, results[number])


def test_a_stop_is_noticed_amid_registration(frames):
    polls = iter([False, False, False, True])
    worker = Worker(
        Settings(psf_sigma=1.0, noise_sigma=NOISE), targets=TARGETS, stop=lambda: next(polls)
    )
    with pytest.raises(Interrupted):
        worker.register(frames[0])


def test_the_noise_of_a_chain_is_followed_view_by_view(frames):
    """All views are looked at in its first frame, then one in each."""
    memory, settings, names = Memory(), Settings(), SCENE.view_ids
    quiet = estimate_noise_of_views(frames[0].views)
    assert memory.seen.noise(frames[0], settings, names) == quiet
    louder = SCENE.frame(0, noise_sigma=1.15 * NOISE)
    found = [
        memory.seen.noise(replace(louder, frame_index=number), settings, names)
        for number in range(1, 1 + len(names))
    ]
    assert found == sorted(found)
    assert found[0] < found[-1] == estimate_noise_of_views(louder.views)
    memory.forget()
    assert memory.seen.noise(frames[0], settings, names) == quiet


def test_of_a_fade_nothing_is_kept():
    """Every block matches within its bounds; the mean and the result of before lag behind."""
    still = SCENE.frame(0)

    def faded(number):
        noise = np.random.default_rng(number)

        def lit(view):
            grain = noise.normal(0.0, NOISE, view.luma.shape)
            return replace(view, luma=(view.luma * 0.95 + number + grain).astype(np.float32))

        return replace(still, frame_index=number, views=tuple(map(lit, still.views)))

    warm = _worker("warm")
    results = [warm.take(faded(number)) for number in range(3)]
    cuts = [result.report.targets[0].start.is_cut for result in results]
    assert cuts == [False, True, True]
    alone = _worker("cold").take(faded(2))
    for target in TARGETS:
        np.testing.assert_array_equal(results[2].images[target].luma, alone.images[target].luma)


@pytest.mark.parametrize(("before", "after"), [(2.0, 8.0), (8.0, 2.0)])
def test_noise_that_jumps_is_known_in_that_frame_and_costs_no_quality(before, after):
    """A camera's gain changes: solved for the noise of before, a frame loses up to 4 dB."""
    first, second = SCENE.frame(0, noise_sigma=before), SCENE.frame(1, noise_sigma=after)
    warm, cold = (_worker(kind, noise_sigma=None) for kind in ("warm", "cold"))
    warm.take(first)
    ours, alone = warm.take(second), cold.take(second)
    assert ours.report.noise_sigma == alone.report.noise_sigma
    assert _psnr(ours, _truth(1)) > _psnr(alone, _truth(1)) - 0.05
    # what is noisier than a frame of its own is no start
    assert all(target.start.is_cut == (after < before) for target in ours.report.targets)


def test_a_view_that_comes_back_is_registered_and_the_others_stay_warm(frames):
    worker = _worker("warm")
    for frame in frames[:2]:
        kept = tuple(view for view in frame.views if view.view_id in ("cam0", *TARGETS))
        result = worker.take(replace(frame, views=kept))
        assert [len(target.views) for target in result.report.targets] == [3, 3]
    result = worker.take(frames[2])
    whole = _worker("warm")
    for frame in frames[:3]:
        expected = whole.take(frame)
    for here, there in zip(result.report.targets, expected.report.targets, strict=True):
        assert len(here.views) == 4
        for ours, other in zip(here.views, there.views, strict=True):
            assert ours.verified_fraction == pytest.approx(other.verified_fraction, abs=0.05)
