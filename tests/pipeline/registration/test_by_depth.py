"""What a depth map has to be corrected by is learned from fits, and then says where pixels land."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.frames import Rejection
from pipeline.registration.by_depth import landed_by_depth, learn_law
from pipeline.registration.register import prepare_views, register_view
from pipeline.superresolve import terms_of
from pipeline.synthetic import SampleScene

SCENE = SampleScene(width=192, height=144, num_views=3)
SOURCE, REFERENCE = 2, 0


@pytest.fixture(scope="module")
def prepared():
    return prepare_views(SCENE.frame(0, noise_sigma=1.0).views, metric=False)


@pytest.fixture(scope="module")
def registration(prepared):
    source, reference = (prepared[SCENE.view_ids[place]] for place in (SOURCE, REFERENCE))
    return register_view(source, reference, terms_of(Settings(), 1.0))


def _nearness(prepared):
    return prepared[SCENE.view_ids[SOURCE]].fine.nearness


def test_what_moves_lands_where_it_does(prepared, registration):
    """Learned in one frame, right in another, in which other things are there."""
    law = learn_law(registration, _nearness(prepared))
    assert law is not None
    assert law.spread < 0.15
    later = prepare_views(SCENE.frame(6).views, metric=False)
    changed = np.ones(SCENE.frame(0).lr_shape, np.bool_)
    landed = landed_by_depth(registration, law, _nearness(later), changed, changed.shape)
    truth = SCENE.true_motion(SOURCE, REFERENCE, 6)
    sure = truth.visible & ~truth.near_edge
    away = np.linalg.norm(landed.registered.position - truth.position, axis=-1)[sure]
    assert np.median(away) < 0.1
    assert np.mean(away < 0.3) > 0.95
    position = truth.position
    outside = (position < -1).any(axis=-1) | (position[..., 0] > SCENE.width)
    assert np.all(landed.registered.flags[outside & ~truth.near_edge] == Rejection.OUTSIDE)


def test_the_unit_of_depth_does_not_matter(prepared, registration):
    """Depth of another origin and unit is corrected by another law, to the same landing points."""
    laws = [
        learn_law(registration, scale * _nearness(prepared) + at)
        for scale, at in ((1, 0), (3, -0.2))
    ]
    changed = np.ones(_nearness(prepared).shape, np.bool_)
    places = [
        landed_by_depth(
            registration, law, scale * _nearness(prepared) + np.float32(at), changed, changed.shape
        )
        for law, (scale, at) in zip(laws, ((np.float32(1), 0), (np.float32(3), -0.2)), strict=True)
    ]
    apart = np.abs(places[0].registered.position - places[1].registered.position)
    assert np.median(apart) < 0.01


def test_what_has_not_changed_keeps_its_place(prepared, registration):
    law = learn_law(registration, _nearness(prepared))
    nothing = np.zeros(_nearness(prepared).shape, np.bool_)
    landed = landed_by_depth(registration, law, _nearness(prepared), nothing, nothing.shape)
    for name in ("position", "flags"):
        before, after = (getattr(one.registered, name) for one in (registration, landed))
        assert np.array_equal(before, after, equal_nan=name == "position")


@pytest.mark.parametrize("share", [0.02, 0.5])
def test_what_has_changed_lands_alike_whatever_has_beside_it(prepared, registration, share):
    """Many pixels of a row are worked on at once, some of which have not changed."""
    nearness = _nearness(prepared)[:, :-3]
    before = replace(
        registration,
        offset=registration.offset[:, :-3].copy(),
        registered=replace(
            registration.registered,
            position=registration.registered.position[:, :-3].copy(),
            flags=registration.registered.flags[:, :-3].copy(),
        ),
    )
    law = learn_law(registration, _nearness(prepared))
    changed = np.random.default_rng(0).random(nearness.shape) < share
    every = np.ones_like(changed)
    alone, beside = (
        landed_by_depth(before, law, nearness, wanted, (SCENE.height, SCENE.width))
        for wanted in (changed, every)
    )
    for name in ("position", "flags"):
        old, new, all_new = (getattr(one.registered, name) for one in (before, alone, beside))
        assert np.array_equal(new[changed], all_new[changed])
        assert np.array_equal(new[~changed], old[~changed], equal_nan=name == "position")
    assert np.array_equal(alone.offset[changed], beside.offset[changed])
    assert np.array_equal(alone.offset[~changed], before.offset[~changed])


def test_depth_that_says_nothing_is_far_off(prepared, registration):
    flat = np.zeros_like(_nearness(prepared))
    law = learn_law(registration, flat)
    assert law is None or law.spread > 0.5
    assert learn_law(replace(registration, motions=None), flat) is None
