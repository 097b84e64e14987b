"""What is made before the first frame where a rate is held: all that frames may need, once."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import pytest

from pipeline.config import Settings
from pipeline.effort import FULL
from pipeline.errors import Interrupted
from pipeline.realtime import ladder
from pipeline.registration.again import AGAIN
from pipeline.rehearsal import HEIGHT, WIDTH, as_far_as_it_goes, rehearse, small_frames, small_scene

SETTINGS = Settings(temporal="warm", realtime=True, rate=5.0)


def _efforts(num_views: int, num_eyes: int = 2, *, has_depth: bool = True):
    return [rung.effort for rung in ladder(num_views, num_eyes, has_depth=has_depth)]


def test_each_effort_has_its_frame_after_some_that_are_whole():
    scene, efforts = small_scene(3), _efforts(3)
    frames = list(small_frames(scene, efforts, lambda place: place in scene.reference_views))
    before = max(AGAIN) + 2
    assert [frame.effort for frame in frames] == [FULL] * before + efforts + [FULL]
    for frame in frames:
        assert [picture.shape for picture in frame.pictures] == [(HEIGHT, WIDTH, 3)] * 3
        assert [stored.shape for stored in frame.depth] == [(HEIGHT, WIDTH)] * 3
    moved = [(a.pictures[0].astype(int) - b.pictures[0]).std() for a, b in pairwise(frames)]
    assert max(moved[: before - 1]) < 3, "nothing but noise while all is whole"
    assert min(moved[before:]) > 10, "then something changes in each frame"


@pytest.mark.parametrize(
    ("num_views", "num_eyes", "has_depth", "settings"),
    [
        (8, 2, True, SETTINGS),
        (2, 2, False, SETTINGS),
        (2, 1, True, replace(SETTINGS, magnification="2x1")),
        (1, 1, False, replace(SETTINGS, magnification="3", psf="auto")),
    ],
)
def test_scenes_of_any_kind_can_be_rehearsed(num_views, num_eyes, has_depth, settings):
    rehearse(
        settings, _efforts(num_views, num_eyes, has_depth=has_depth), num_views=num_views,
        num_eyes=num_eyes, has_depth=has_depth,
    )  # fmt: skip


def test_it_stops_when_told_to():
    with pytest.raises(Interrupted):
        rehearse(SETTINGS, _efforts(4), num_views=4, num_eyes=2, has_depth=True, stop=lambda: True)


def test_a_rehearsal_that_fails_is_told_and_harms_nothing(caplog):
    with as_far_as_it_goes():
        raise ValueError("too small")
    assert "too small" in caplog.text
    for passed_on in (Interrupted, MemoryError):
        with pytest.raises(passed_on), as_far_as_it_goes():
            raise passed_on
