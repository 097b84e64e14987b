"""What a controller may leave out of a frame, and that the report says what was left out."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.effort import Effort, nearest_views
from pipeline.errors import ConfigurationError
from pipeline.metrics import psnr
from pipeline.superresolve import Memory, superresolve
from pipeline.synthetic import SampleScene

SCENE = SampleScene(width=112, height=80, num_views=5)
TARGETS = tuple(SCENE.view_ids[number] for number in SCENE.reference_views)
SETTINGS = Settings(psf_sigma=1.0, noise_sigma=1.0, sampling="decimation", temporal="warm")


@pytest.fixture(scope="module")
def frames():
    return [SCENE.frame(number, noise_sigma=1.0) for number in range(3)]


def _take(frame, memory=None, **effort):
    return superresolve(
        frame, SETTINGS, targets=TARGETS, memory=memory, effort=Effort(**effort)
    )  # fmt: skip


def _score(result, number):
    picture = SCENE.render_hr(SCENE.reference_views[0], number / SCENE.fps)
    truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return psnr(result.images[TARGETS[0]].luma, truth, border=12)


@pytest.mark.parametrize("wrong", [{"steps": 0}, {"views": 0}, {"steps": -3}])
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
    kept = [_take(frame, memory, register=False) for frame in frames[1:]]
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
