"""What a controller may leave out of a frame, and that the report says what was left out."""

from __future__ import annotations

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import Effort, nearest_views
from pipeline.errors import ConfigurationError
from pipeline.metrics import psnr
from pipeline.reconstruction.fused import initial_estimate
from pipeline.superresolve import Memory, superresolve
from pipeline.synthetic import SampleScene

SCENE = SampleScene(width=112, height=80, num_views=5)
TARGETS = tuple(SCENE.view_ids[number] for number in SCENE.reference_views)
SETTINGS = Settings(psf_sigma=1.0, noise_sigma=1.0, sampling="decimation", temporal="warm")


@pytest.fixture(scope="module")
def frames():
    return [SCENE.frame(number, noise_sigma=1.0) for number in range(7)]


def _take(frame, memory=None, **effort):
    return superresolve(
        frame, SETTINGS, targets=TARGETS, memory=memory, effort=Effort(**effort)
    )  # fmt: skip


@functools.cache
def _truth(number):
    picture = SCENE.render_hr(SCENE.reference_views[0], number / SCENE.fps)
    return cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)


def _score(result, number):
    return psnr(result.images[TARGETS[0]].luma, _truth(number), border=12)


@pytest.mark.parametrize(
    "wrong", [{"steps": 0}, {"views": 0}, {"steps": -3}, {"register_every": 0}]
)
def test_an_effort_of_nothing_is_refused(wrong):
    with pytest.raises(ConfigurationError, match="must be 1 or more"):
        Effort(**wrong)


def test_the_nearest_views_are_kept_and_the_targets_always():
    names = ["a", "b", "c", "d", "e", "f"]
    assert nearest_views(names, ("c", "d"), None) == tuple(names)
    assert nearest_views(names, ("c", "d"), 4) == ("b", "c", "d", "e")
    assert nearest_views(names, ("a",), 3) == ("a", "b", "c")
    assert nearest_views(names, ("c", "d"), 1) == ("c", "d")


def test_fewer_steps_and_views_are_taken_and_said(frames):
    whole, less = _take(frames[0]), _take(frames[0], steps=2, views=3)
    assert whole.report.effort.is_full
    assert less.report.effort == Effort(steps=2, views=3)
    for full, short in zip(whole.report.targets, less.report.targets, strict=True):
        assert len(full.views) == 5
        assert len(short.views) == 3
        assert short.iterations < full.iterations
    assert _score(less, 0) < _score(whole, 0) + 0.1


def test_motions_are_kept_where_they_need_not_be_found_again(frames):
    memory = Memory()
    first = _take(frames[0], memory, register=False)
    assert not first.report.motions_are_kept, "there is nothing to keep"
    kept = [_take(frame, memory, register=False) for frame in frames[1:3]]
    assert all(result.report.motions_are_kept for result in kept)
    for result, number in zip(kept, (1, 2), strict=True):
        assert _score(result, number) > _score(_take(frames[number]), number) - 0.5
    again = _take(frames[1], memory)
    assert not again.report.motions_are_kept


def test_views_that_come_back_are_registered(frames):
    memory = Memory()
    _take(frames[0], memory, views=3)
    back = _take(frames[1], memory, register=False)
    assert not back.report.motions_are_kept
    assert len(back.report.targets[0].views) == 5


def _by_view(memory):
    return {
        (target, one.registered.view_id): one
        for target, found in memory.previous.registrations.items()
        for one in found
    }


def test_views_are_registered_in_turn_and_what_they_missed_is_made_up_for(frames):
    memory, every, seen = Memory(), 3, []
    _take(frames[0], memory)
    for frame in frames[1:5]:
        before = _by_view(memory)
        _take(frame, memory, register_every=every)
        now = _by_view(memory)
        kept = {view for target, view in now if now[target, view].missed is not None}
        seen.append(set(SCENE.view_ids) - kept)
        for pair, registration in now.items():
            if pair[1] in kept:
                assert registration.motions is before[pair].motions
                assert 0 <= registration.missed[1].max() < 4 * frame.views[0].luma.size
    assert seen[0] | seen[1] | seen[2] == set(SCENE.view_ids)
    assert seen[3] == seen[0] != seen[1]
    assert any(one.missed is not None and one.missed[1].any() for one in now.values())
    for frame in frames[5:]:
        _take(frame, memory)
    assert all(one.missed is None for one in _by_view(memory).values())


def test_views_registered_in_turn_are_worth_nearly_as_much(frames):
    often, seldom = Memory(), Memory()
    for number, frame in enumerate(frames[:5]):
        here, there = _take(frame, often), _take(frame, seldom, register_every=4)
        assert _score(there, number) > _score(here, number) - 0.5


def test_motions_of_views_that_are_left_out_for_a_while_are_kept(frames):
    memory = Memory()
    _take(frames[0], memory)
    few = _take(frames[1], memory, views=3)
    assert len(few.report.targets[0].views) == 3
    back = _take(frames[2], memory, register=False)
    assert back.report.motions_are_kept
    assert len(back.report.targets[0].views) == 5


def _enlarged(frame):
    return initial_estimate(frame.view(TARGETS[0]).luma, SETTINGS.grid)


def test_an_eye_of_itself_alone_keeps_what_stands_still_and_no_ghost_of_what_moves(frames):
    memory = Memory()
    before = _take(frames[0], memory)
    for number in (1, 2, 3):
        result = _take(frames[number], memory, alone=True)
        assert result.report.effort.alone
        now, last = (item.images[TARGETS[0]].luma for item in (result, before))
        changed = memory.still[TARGETS[0]].changed.repeat(2, 0).repeat(2, 1)
        moves = changed & (np.abs(now - last) > 1)
        assert 0 < moves.mean() < 0.5
        far = cv2.dilate(changed.astype(np.uint8), None, iterations=6) == 0
        assert (now == last)[far].mean() > 0.8
        cold = _take(frames[number], alone=True).images[TARGETS[0]].luma
        assert np.abs(now - cold)[moves].mean() < 0.2 * np.abs(last - cold)[moves].mean()
        assert _score(result, number) > psnr(_enlarged(frames[number]), _truth(number), border=12)
        before = result


def test_what_was_made_of_an_eye_alone_is_made_of_all_views_again(frames):
    memory, whole = Memory(), Memory()
    for number, frame in enumerate(frames):
        expected = _take(frame, whole)
        result = _take(frame, memory, alone=number in (1, 2, 3))
    assert _score(result, 6) > _score(expected, 6) - 0.2


def test_a_cut_is_seen_through_by_an_eye_alone(frames):
    memory = Memory()
    _take(frames[0], memory)
    turned = replace(
        frames[1],
        views=tuple(replace(view, luma=view.luma[::-1, ::-1].copy()) for view in frames[1].views),
    )
    result, cold = _take(turned, memory, alone=True), _take(turned, alone=True)
    smaller = SampleScene(width=96, height=72, num_views=5).frame(2)
    assert _take(smaller, memory, alone=True).images[TARGETS[0]].luma.shape == (144, 192)
    assert _take(smaller, memory).images[TARGETS[0]].luma.shape == (144, 192)
    for eye in TARGETS:
        away = np.abs(result.images[eye].luma - cold.images[eye].luma)
        assert np.mean(away > 2) < 0.05
