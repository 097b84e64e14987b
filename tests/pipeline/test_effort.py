"""What a controller may leave out of a frame, and that the report says what was left out."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import SWIFT, Effort, depth_looked_at, looked_at, nearest_views
from pipeline.errors import ConfigurationError
from pipeline.metrics import psnr
from pipeline.reconstruction.fused import initial_estimate
from pipeline.superresolve import Memory, superresolve
from pipeline.synthetic import SampleScene

SCENE = SampleScene(width=112, height=80, num_views=5)
TARGETS = tuple(SCENE.view_ids[number] for number in SCENE.reference_views)
ALONE = {"alone": True, "refresh_every": None}
EYES = {"alone": True, "refresh_every": 2, "others": False}
TURN = {"register": False, "in_turn": True, "views": 4, "steps": 2, "refresh_every": 2}
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


def _scores(result, number):
    """Return those of both eyes."""
    pictures = (SCENE.render_hr(place, number / SCENE.fps) for place in SCENE.reference_views)
    truths = [cv2.cvtColor(one, cv2.COLOR_RGB2GRAY).astype(np.float32) for one in pictures]
    return np.array(
        [
            psnr(result.images[target].luma, truth, border=12)
            for target, truth in zip(TARGETS, truths, strict=True)
        ]
    )


def test_depth_is_looked_at_of_the_views_that_need_it():
    ids, targets = ("a", "b", "c", "d", "e", "f"), ("c", "d")
    few = replace(SWIFT, views=4)
    assert depth_looked_at(Effort(), ids, targets) == depth_looked_at(SWIFT, ids, targets) == ids
    assert depth_looked_at(Effort(views=2), ids, targets) == ids, "all are registered"
    assert depth_looked_at(few, ids, targets) == ("b", "c", "d", "e")
    assert set(looked_at(few, ids, targets, 1)) > {"b", "c", "d", "e"}
    assert depth_looked_at(Effort(register=False), ids, targets) == ()


@pytest.mark.parametrize("wrong", [{"by_depth": True}, {"in_turn": True}])
@pytest.mark.parametrize("where", [{}, {"alone": True, "register": False}])
def test_what_is_of_kept_motions_is_refused_elsewhere(wrong, where):
    with pytest.raises(ConfigurationError, match="of motions that are kept"):
        Effort(**wrong, **where)


@pytest.mark.parametrize(
    "wrong",
    [
        {"steps": 0}, {"views": 0}, {"steps": -3}, {"register_every": 0}, {"refresh_every": 0},
        {"refresh_every": None}, {"refresh_every": None, "register": False}, {"others": False},
    ],
)  # fmt: skip
def test_an_effort_of_nothing_is_refused(wrong):
    with pytest.raises(ConfigurationError, match="must be"):
        Effort(**wrong)


def test_every_other_view_is_looked_at_in_its_turn_and_the_targets_always():
    names, targets = ("a", "b", "c", "d", "e"), ("c", "d")
    in_turn, alone = Effort(alone=True), Effort(alone=True, refresh_every=None)
    found = [looked_at(in_turn, names, targets, number) for number in range(3)]
    assert all(set(targets) < set(views) and len(views) == 3 for views in found)
    assert set().union(*found) == set(names)
    assert looked_at(in_turn, targets, targets, 0) == targets
    assert looked_at(alone, names, targets, 1) == targets
    assert looked_at(Effort(alone=True, others=False), names, targets, 1) == targets
    for every in (Effort(), Effort(views=2), Effort(register=False)):
        assert looked_at(every, names, targets, 1) == names
    nearest = Effort(register=False, views=3)
    assert [looked_at(nearest, names, targets, number) for number in range(2)] == [
        ("a", "b", "c", "d"), ("b", "c", "d", "e"),
    ]  # fmt: skip


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
    memory, alone = Memory(), Memory()
    for one in (memory, alone):
        _take(frames[0], one)
    motions = memory.previous
    for number in (1, 2, 3):
        without_depth = tuple(replace(view, depth_map=None) for view in frames[number].views)
        kept = _take(replace(frames[number], views=without_depth), memory, register=False)
        assert memory.previous is motions
        assert _score(kept, number) > _score(_take(frames[number]), number) - 0.5
        less = _take(frames[number], alone, **ALONE)
        assert _score(kept, number) > _score(less, number) + 0.2
    _take(frames[4], memory)
    assert memory.previous is not motions


def test_one_eye_in_turn_is_made_of_other_views_and_the_other_one_follows_it(frames):
    """Both are better in every frame than where each is made alone and followed."""
    turn, alone = Memory(), Memory()
    for number, frame in enumerate(frames):
        results = [
            _take(frame, memory, **(effort if number else {}))
            for memory, effort in ((turn, TURN), (alone, {"alone": True, "refresh_every": 2}))
        ]
        if number > 0:
            ours, theirs = (_scores(result, number) for result in results)
            assert (ours > theirs + 0.1).all()


def test_of_one_eye_in_turn_what_waits_is_made_up_for(frames):
    """What changed in a frame in which an eye followed is made of other views in the next one."""
    memory = Memory()
    _take(frames[0], memory)
    for number, frame in enumerate(frames[1:4], 1):
        _take(frame, memory, **TURN)
        order = TARGETS if number % 2 == 0 else TARGETS[::-1]
        ahead, behind = (memory.restored(name) for name in order)
        assert not ahead.waiting.any()
        assert behind.waiting[memory.seen.still[order[1]].touched].all()


def test_without_motions_that_could_be_kept_each_eye_is_made_alone(frames):
    result, alone = _take(frames[0], Memory(), register=False), _take(frames[0], **ALONE)
    for eye in TARGETS:
        np.testing.assert_array_equal(result.images[eye].luma, alone.images[eye].luma)


def test_what_another_solver_has_made_is_not_refreshed_by_the_fused_one(frames):
    settings = replace(SETTINGS, solver="pocs", sweeps=1)
    found = []
    for effort in (Effort(register=False), Effort(**ALONE, follow=False)):
        memory = Memory()
        for frame, less in zip(frames[:2], (Effort(), effort), strict=True):
            result = superresolve(frame, settings, targets=TARGETS, memory=memory, effort=less)
        found.append(result.images[TARGETS[0]].luma)
    np.testing.assert_array_equal(*found)


def test_views_that_come_back_are_registered(frames):
    memory = Memory()
    _take(frames[0], memory, views=3)
    back = _take(frames[1], memory)
    assert len(back.report.targets[0].views) == 5


def test_views_that_come_back_in_turn_are_registered_one_by_one(frames):
    memory = Memory()
    counts = [
        len(_take(frame, memory, views=3, register_every=5).report.targets[0].views)
        for frame in frames[:6]
    ]
    assert counts[0] == 3
    assert counts[-1] == 5
    assert all(now - before in (0, 1) for before, now in itertools.pairwise(counts))


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


def test_fewer_views_for_what_changes_leave_what_stands_still_to_all(frames):
    few, eyes = Memory(), Memory()
    for number, frame in enumerate(frames[:5]):
        result = _take(frame, few, **({"views": 2} if number else {}))
        pair = replace(frame, views=tuple(frame.view(target) for target in TARGETS))
        less = _take(pair, eyes)
        assert len(result.report.targets[0].views) == 5
    still = few.seen.still[TARGETS[0]].count.repeat(2, 0).repeat(2, 1) >= 4
    errors = [one.images[TARGETS[0]].luma[still] - _truth(4)[still] for one in (result, less)]
    ours, theirs = (np.square(error).mean() for error in errors)
    assert ours < theirs


def _scores_of(frames, *efforts):
    """Return the scores of the last frame of chains whose first is whole."""
    scores = []
    for effort in efforts:
        memory = Memory()
        _take(frames[0], memory)
        for frame in frames[1:]:
            result = _take(frame, memory, **effort)
        scores.append(_score(result, len(frames) - 1))
    return scores


def test_what_stands_still_is_refreshed_where_changes_are_made_alone(frames):
    """An eye of itself alone remembers, and forgets piece by piece; with a turn it learns."""
    alone, eyes, turn = _scores_of(
        frames, ALONE, EYES, {"alone": True, "refresh_every": 2}
    )  # fmt: skip
    assert turn > alone + 0.2
    assert turn > eyes > alone + 0.05


@pytest.mark.parametrize("step", [0.1, 0.5, 2.0])
def test_other_views_as_they_were_do_no_harm_where_the_light_grows(frames, step):
    brighter = [
        replace(
            frame,
            views=tuple(
                replace(view, luma=view.luma + np.float32(step * number)) for view in frame.views
            ),
        )
        for number, frame in enumerate(frames)
    ]

    def error(effort):
        memory = Memory()
        for number, frame in enumerate(brighter):
            result = _take(frame, memory, **(effort if number else {}))
        away = result.images[TARGETS[0]].luma - _truth(number) - np.float32(step * number)
        return np.square(away[12:-12, 12:-12]).mean()

    assert error(EYES) < 1.01 * error(ALONE)


def _enlarged(frame):
    return initial_estimate(frame.view(TARGETS[0]).luma, SETTINGS.grid)


def test_an_eye_of_itself_alone_keeps_what_stands_still_and_no_ghost_of_what_moves(frames):
    memory = Memory()
    before = _take(frames[0], memory)
    for number in (1, 2, 3):
        result = _take(frames[number], memory, **ALONE)
        assert result.report.effort.alone
        now, last = (item.images[TARGETS[0]].luma for item in (result, before))
        changed = memory.seen.still[TARGETS[0]].changed.repeat(2, 0).repeat(2, 1)
        moves = changed & (np.abs(now - last) > 1)
        assert 0 < moves.mean() < 0.5
        far = cv2.dilate(changed.astype(np.uint8), None, iterations=6) == 0
        assert (now == last)[far].mean() > 0.8
        cold = _take(frames[number], **ALONE).images[TARGETS[0]].luma
        assert np.abs(now - cold)[moves].mean() < 0.2 * np.abs(last - cold)[moves].mean()
        assert _score(result, number) > psnr(_enlarged(frames[number]), _truth(number), border=12)
        before = result


@pytest.mark.parametrize("less", [{"register": False}, TURN, {"alone": True}, EYES, ALONE], ids=str)
def test_what_was_made_with_less_is_made_with_all_again(frames, less):
    memory, whole = Memory(), Memory()
    for number, frame in enumerate(frames):
        expected = _take(frame, whole)
        result = _take(frame, memory, **(less if number in (1, 2, 3) else {}))
    assert _score(result, 6) > _score(expected, 6) - 0.2


@pytest.mark.parametrize("less", [{"register": False}, TURN, {"alone": True}, EYES, ALONE], ids=str)
def test_a_cut_is_seen_through_where_nothing_is_registered(frames, less):
    memory = Memory()
    _take(frames[0], memory)
    turned = replace(
        frames[1],
        views=tuple(replace(view, luma=view.luma[::-1, ::-1].copy()) for view in frames[1].views),
    )
    result, cold = _take(turned, memory, **less), _take(turned, **less)
    smaller = SampleScene(width=96, height=72, num_views=5).frame(2)
    assert _take(smaller, memory, **less).images[TARGETS[0]].luma.shape == (144, 192)
    assert _take(smaller, memory).images[TARGETS[0]].luma.shape == (144, 192)
    for eye in TARGETS:
        away = np.abs(result.images[eye].luma - cold.images[eye].luma)
        assert np.mean(away > 2) < 0.05
