"""Motions that a cut has made those of another picture: noticed, and found anew step by step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import SWIFT, Effort
from pipeline.metrics import psnr
from pipeline.realtime import ANEW, GOES_ON, PATIENCE, SELDOM, Controller, find_motions, paced
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker

RATE = 10.0
BUDGET = 1 / RATE
KEPT = Effort(register=False, steps=2, refresh_every=8, in_turn=True)
BY_DEPTH = replace(SWIFT, steps=3, views=3, in_turn=True)
EYES = ("cam1", "cam2")
CUT = 4
"""First frame of the other picture."""


@pytest.fixture(scope="module")
def frames():
    scenes = [SampleScene(width=96, height=72, num_views=4, seed=seed) for seed in (0, 5)]
    assert tuple(scenes[0].view_ids[place] for place in scenes[0].reference_views) == EYES
    return [
        scenes[number >= CUT].frame(number, noise_sigma=2.0) for number in range(CUT + 12)
    ]  # fmt: skip


def _worker(temporal="warm"):
    settings = Settings(psf_sigma=1.0, sampling="decimation", temporal=temporal, threads=1)
    return Worker(settings, targets=EYES)


def _quality(result, frame):
    scene = SampleScene(width=96, height=72, num_views=4, seed=5)
    hr = scene.render_hr(scene.reference_views[0], frame.frame_index / scene.fps)
    truth = (hr @ np.array([0.299, 0.587, 0.114])).astype(np.float32)
    return psnr(result.images[EYES[0]].luma, truth, border=12)


def test_a_cut_leaves_motions_that_are_missing_until_they_are_found_anew(frames):
    worker, told, stands = _worker(), [], []
    for number, frame in enumerate(frames[: CUT + 4]):
        worker.take(frame, effort=KEPT if number else Effort())
        told.append(worker.lacks_motions)
        stands.append(worker.stands)
    assert told == [False] * CUT + [True] * 4
    assert not stands[CUT], "most of it changes"
    assert all(stands[CUT + 1 :])
    worker.begin_anew(frames[CUT + 3], KEPT)
    steps = 0
    while worker.finds_motions:
        assert worker.lacks_motions
        worker.find_more()
        steps += 1
    assert steps > 3, "none takes long"
    assert not worker.lacks_motions


@pytest.mark.parametrize("effort", [SWIFT, BY_DEPTH])
def test_where_what_changes_lands_by_its_depth_a_cut_registers_no_frame_in_full(frames, effort):
    worker, told, made = _worker(), [], []
    for number, frame in enumerate(frames):
        result = worker.take(frame, effort=effort if number else Effort())
        told.append(worker.lacks_motions)
        made.append(result.report.effort)
        if number == CUT + 3:
            worker.begin_anew(frame, effort)
        if worker.finds_motions:
            worker.find_more()
            worker.find_more()
    found = told.index(False, CUT)
    assert told == [CUT <= number < found for number in range(len(frames))]
    assert found < len(frames) - 2
    assert made[1:CUT] == [effort] * (CUT - 1)
    assert made[CUT:found] == [replace(effort, by_depth=False)] * (found - CUT)
    assert made[found:] == [effort] * (len(frames) - found), "of motions found anew"
    full = _worker()
    for number, frame in enumerate(frames[CUT:], CUT):
        wanted = full.take(frame, effort=effort if number > CUT else Effort())
    assert _quality(result, frames[-1]) > _quality(wanted, frames[-1]) - 0.3


def test_what_is_found_step_by_step_is_what_is_found_in_one_go(frames):
    found = []
    for targets in (EYES, EYES[:1]):
        settings = Settings(psf_sigma=1.0, temporal="warm", threads=1, noise_sigma=2.0)
        worker, fresh = (Worker(settings, targets=targets) for _ in range(2))
        for number, frame in enumerate(frames[: CUT + 3]):
            worker.take(frame, effort=KEPT if number else Effort())
        worker.begin_anew(frames[CUT + 2], KEPT)
        while worker.finds_motions:
            worker.find_more()
        fresh.take(frames[CUT + 2])
        for one, other in ((worker, fresh),):
            for target in targets:
                pairs = zip(
                    one._memory.previous.registrations[target],
                    other._memory.previous.registrations[target],
                    strict=True,
                )
                for here, there in pairs:
                    assert here.registered.view_id == there.registered.view_id
                    np.testing.assert_array_equal(
                        here.registered.position, there.registered.position
                    )
                    found.append(here)
    assert len(found) == 4 * 3


def test_with_motions_found_anew_frames_are_better_than_without(frames):
    quality = {}
    for finds in (False, True):
        worker = _worker()
        for number, frame in enumerate(frames):
            result = worker.take(frame, effort=KEPT if number else Effort())
            if finds and number == CUT + 2:
                worker.begin_anew(frame, KEPT)
            if worker.finds_motions:
                worker.find_more()
                worker.find_more()
        assert worker.lacks_motions == (not finds)
        quality[finds] = _quality(result, frames[-1])
    assert quality[True] > quality[False] + 0.5


def test_what_is_being_found_is_given_up_where_the_picture_is_another_one_again(frames):
    worker = _worker()
    for number, frame in enumerate(frames[: CUT + 3]):
        worker.take(frame, effort=KEPT if number else Effort())
    worker.begin_anew(frames[CUT + 2], KEPT)
    worker.find_more()
    worker.take(replace(frames[0], frame_index=CUT + 3), effort=KEPT)
    assert worker.lacks_motions
    assert not worker.finds_motions
    worker.take(replace(frames[1], frame_index=CUT + 4), effort=KEPT)
    worker.begin_anew(replace(frames[1], frame_index=CUT + 4), KEPT)
    assert worker.finds_motions
    worker.take(replace(frames[2], frame_index=CUT + 5))
    assert not worker.lacks_motions, "registered in full"
    assert not worker.finds_motions


def test_nothing_is_found_anew_where_frames_stand_alone(frames):
    worker = _worker("cold")
    worker.take(frames[0])
    worker.begin_anew(frames[0], Effort())
    assert not any((worker.lacks_motions, worker.finds_motions, worker.stands))


class _Stream:
    """A stream whose motions are missing from some frames on until they are found anew."""

    def __init__(self, *, cuts=(), moves=(), kept=0.9, without=0.4, step=0.7, rate_of=1.0):
        self.controller = Controller(rate=RATE, num_views=8, has_depth=True, mixes=True)
        self.cuts, self.moves = set(cuts), set(moves)
        self.kept, self.without, self.step = kept, without, step
        self.now, self.lacks_motions, self.stands, self.left = 0.0, False, True, 0
        self.choices, self.steps = [], []

    @property
    def finds_motions(self):
        return self.left > 0

    def find_more(self):
        self.now += BUDGET * self.step
        self.left -= 1
        self.lacks_motions = self.left > 0
        self.steps.append(len(self.choices) - 1)

    def run(self, count):
        controller = self.controller
        frames = paced(
            range(count), controller, lambda: self.now,
            highest=lambda _: controller.level_to_read_for,
            between=lambda left: find_motions(self, controller, left, lambda: self.now),
        )  # fmt: skip
        for number, choice in frames:
            self.stands = not ({number} & (self.cuts | self.moves))
            if not self.stands:
                self.lacks_motions, self.left = True, 0
            self.choices.append(choice)
            if choice.drop:
                continue
            if not choice.rung.keeps_motions:
                self.lacks_motions, self.left = False, 0
            # so that the stream is on the first rung that keeps motions
            dear = {0: 6.0, 1: 6.0, 2: 6.0, 3: 1.7, 4: 1.6}
            if self.lacks_motions:
                dear |= {3: self.without, 4: self.without}
            cheap = self.without if self.lacks_motions else self.kept
            self.now += BUDGET * dear.get(choice.level, cheap * 0.9 ** (choice.level - 5))
            controller.look_at(self)
            if choice.begins_anew:
                self.left = 8
        return self.choices


def test_after_a_cut_motions_are_found_in_time_that_is_left_and_no_frame_is_dropped():
    stream = _Stream(cuts={100})
    choices = stream.run(300)
    (anew,) = [number for number, choice in enumerate(choices) if choice.begins_anew]
    assert anew == 100 + ANEW + 1, "not before it is told that the picture stands"
    before = choices[anew - 1].level
    assert stream.controller.rungs[before].keeps_motions
    assert choices[anew].level == before, "it is made as the others are"
    assert len(stream.steps) == 8
    assert stream.steps[-1] < anew + 20
    assert not any(choice.drop for choice in choices[50:])
    assert max(choice.late for choice in choices[50:]) < PATIENCE * BUDGET / 2
    assert {choice.level for choice in choices[anew + 20 :]} <= set(range(before, before + 4))


def test_where_much_time_is_left_several_steps_follow_one_frame_and_none_is_late_by_it():
    stream = _Stream(cuts={100}, without=0.3, step=0.3)
    choices = stream.run(300)
    assert len(stream.steps) == 8
    assert len(set(stream.steps)) <= 5
    assert max(choice.late for choice in choices[50:]) <= 1e-9


def test_where_no_time_is_left_motions_are_found_all_the_same_but_seldom():
    stream = _Stream(cuts={100}, without=0.95, step=1.2)
    choices = stream.run(300)
    assert len(stream.steps) == 8
    assert stream.steps[-1] > 100 + 4 * SELDOM
    assert not any(choice.drop for choice in choices[50:])


def test_while_motions_are_missing_the_time_that_is_left_is_no_calm():
    stream = _Stream(moves=set(range(100, 100 + GOES_ON)))
    choices = stream.run(100 + GOES_ON)
    assert {choice.level for choice in choices[100:]} == {choices[100].level}
    assert not any(choice.begins_anew for choice in choices), "it does not stand"


def test_a_camera_that_goes_on_moving_may_be_registered_in_each_frame_where_there_is_time():
    stream = _Stream(moves=set(range(100, 600)))
    choices = stream.run(600)
    assert any(not choice.rung.keeps_motions for choice in choices[100 + GOES_ON :])


def test_what_is_cut_again_and_again_drops_no_frame():
    stream = _Stream(cuts=set(range(60, 1500, 10)))
    choices = stream.run(1500)
    assert sum(choice.begins_anew for choice in choices) > 50
    assert not any(choice.drop for choice in choices[50:])


def test_where_no_motions_are_missing_nothing_is_begun_anew():
    stream = _Stream()
    assert not any(choice.begins_anew for choice in stream.run(400))
    assert stream.controller.level_to_read_for == stream.controller.level
