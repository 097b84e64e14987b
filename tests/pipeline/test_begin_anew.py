"""Motions that a cut has made those of another picture: they are noticed, and found anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import Effort
from pipeline.metrics import psnr
from pipeline.realtime import ANEW, LONGEST_CALM, Controller, paced
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker

RATE = 10.0
BUDGET = 1 / RATE
KEPT = Effort(register=False, steps=2, refresh_every=8, in_turn=True)
EYES = ("cam1", "cam2")
CUT = 4
"""First frame of the other picture."""


@pytest.fixture(scope="module")
def frames():
    scenes = [SampleScene(width=96, height=72, num_views=4, seed=seed) for seed in (0, 5)]
    assert tuple(scenes[0].view_ids[place] for place in scenes[0].reference_views) == EYES
    return [
        scenes[number >= CUT].frame(number, noise_sigma=2.0) for number in range(CUT + 8)
    ]  # fmt: skip


def _worker():
    settings = Settings(psf_sigma=1.0, sampling="decimation", temporal="warm", threads=1)
    return Worker(settings, targets=EYES)


def test_a_cut_leaves_motions_that_are_missing_until_they_are_found_anew(frames):
    worker, told = _worker(), []
    for number, frame in enumerate(frames):
        worker.take(frame, effort=KEPT if number else Effort())
        told.append(worker.lacks_motions)
    assert not any(told[: CUT + 1]), "while most of it changes it does not stand"
    assert all(told[CUT + 1 :])
    worker.begin_again()
    assert not worker.lacks_motions
    worker.take(replace(frames[-1], frame_index=len(frames)))
    assert not worker.lacks_motions


def test_what_is_begun_anew_is_as_good_as_what_was_there_before_the_cut(frames):
    scene = SampleScene(width=96, height=72, num_views=4, seed=5)
    quality = {}
    for begins_anew in (False, True):
        worker = _worker()
        for number, frame in enumerate(frames):
            is_anew = begins_anew and number == CUT + 3
            if is_anew:
                worker.begin_again()
            result = worker.take(frame, effort=Effort() if is_anew or not number else KEPT)
        luma = result.images[EYES[0]].luma
        hr = scene.render_hr(scene.reference_views[0], frames[-1].frame_index / scene.fps)
        truth = hr @ np.array([0.299, 0.587, 0.114])
        quality[begins_anew] = psnr(luma, truth.astype(np.float32), border=12)
    assert quality[True] > quality[False] + 0.5


class _Stream:
    """A stream whose motions are missing from some frames on until they are found anew."""

    def __init__(self, *, cuts, full=6.0, kept=0.9, without=0.4):
        self.controller = Controller(rate=RATE, num_views=8, has_depth=True, mixes=True)
        self.cuts, self.full, self.kept, self.without = cuts, full, kept, without
        self.now, self.is_lacking = 0.0, False
        self.choices = []

    def run(self, count):
        controller = self.controller
        frames = paced(
            range(count), controller, lambda: self.now,
            highest=lambda _: controller.level_to_read_for,
        )  # fmt: skip
        for number, choice in frames:
            self.is_lacking |= number in self.cuts
            self.choices.append(choice)
            if choice.drop:
                continue
            if choice.level == 0:
                self.is_lacking = False
            # so that the stream is on the first rung that keeps motions
            dear = {0: self.full, 1: self.full, 2: self.full, 3: 1.7, 4: 1.6}
            cheap = self.without if self.is_lacking else self.kept
            self.now += BUDGET * dear.get(choice.level, cheap * 0.9 ** (choice.level - 5))
            controller.lacks_motions = self.is_lacking and number not in self.cuts
        return self.choices


def test_after_a_cut_one_frame_is_made_in_full_and_the_stream_goes_on_where_it_was():
    stream = _Stream(cuts={100})
    choices = stream.run(300)
    anew = [number for number, choice in enumerate(choices) if choice.begins_anew]
    assert anew == [100 + ANEW + 1], "not before it is told that the picture stands"
    assert choices[anew[0]].level == 0
    before = choices[anew[0] - 1].level
    assert stream.controller.rungs[before].keeps_motions
    dropped = [number for number, choice in enumerate(choices) if choice.drop]
    assert all(anew[0] < number < anew[0] + 8 for number in dropped if number > 50)
    assert {choice.level for choice in choices[anew[0] + 20 :]} <= set(range(before, before + 4))


def test_while_motions_are_missing_the_time_that_is_left_is_no_calm():
    stream = _Stream(cuts={100})
    choices = stream.run(100 + ANEW)
    assert {choice.level for choice in choices[100:]} == {choices[100].level}


def test_what_is_cut_again_and_again_is_begun_anew_more_and_more_seldom():
    stream = _Stream(cuts=set(range(60, 1500, 60)))
    choices = stream.run(1500)
    anew = [number for number, choice in enumerate(choices) if choice.begins_anew]
    assert 1 <= len(anew) <= 1 + 1500 / LONGEST_CALM
    stream = _Stream(cuts={60, 60 + 2 * LONGEST_CALM})
    anew = [number for number, choice in enumerate(stream.run(700)) if choice.begins_anew]
    assert anew == [60 + ANEW + 1, 60 + 2 * LONGEST_CALM + ANEW + 1]


def test_where_nobody_tells_of_missing_motions_nothing_is_begun_anew():
    stream = _Stream(cuts=set())
    assert not any(choice.begins_anew for choice in stream.run(400))
    assert stream.controller.level_to_read_for == stream.controller.level
