"""What one reference tells of a view, carried to another: depth is the same for both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.registration import motions
from pipeline.registration.again import AGAIN
from pipeline.registration.carried import carry_motions, carry_pixels
from pipeline.registration.register import (
    Previous,
    ViewRegistration,
    prepare_views,
    register_views,
)
from pipeline.registration.windows import Landed
from pipeline.superresolve import terms_of
from pipeline.synthetic import SampleScene

SCENE = SampleScene(width=192, height=144, num_views=4)
NAMES = SCENE.view_ids
NEAR, FAR = (NAMES[number] for number in SCENE.reference_views)
SOURCE = NAMES[0]

LATER = max(AGAIN) + 1
"""Which frame of a chain frame 0 stands for: from here on, only what has changed is fitted."""


def _registered(number: int, targets: tuple[str, ...], previous: Previous | None) -> Previous:
    frame = SCENE.frame(number, noise_sigma=1.0)
    prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
    found = register_views(prepared, targets, NAMES, terms_of(Settings(), 1.0), previous=previous)
    return Previous(prepared=prepared, registrations=found, turn=LATER + number)


def _of(found: Previous, target: str) -> ViewRegistration:
    (one,) = (one for one in found.registrations[target] if one.registered.view_id == SOURCE)
    return one


@pytest.fixture(scope="module")
def cold():
    return _registered(0, (NEAR, FAR), None)


@pytest.fixture(scope="module")
def warm(cold):
    return _registered(1, (NEAR, FAR), cold)


def test_pixels_land_where_their_true_depth_puts_them(cold):
    """The depth map is wrong; where the pixels landed on the first reference is right."""
    source, lead, other = cold.prepared[SOURCE], _of(cold, FAR), _of(cold, NEAR)
    shape = lead.offset.shape
    y, x = np.mgrid[: shape[0], : shape[1]]
    wrong = source.fine.nearness
    right = wrong + 0.02 * source.depth_range * np.sin(x / 9)
    onto = other.parallax
    landed = lead.parallax.land(x, y, right).astype(np.float32)
    lead = replace(lead, registered=replace(lead.registered, position=landed))
    believed = replace(lead.motions, reliable=np.ones_like(lead.motions.reliable))
    lead = replace(lead, motions=replace(believed, status=np.ones_like(believed.status)))
    kept = Landed(labels=other.patch_labels, position=landed, offset=lead.offset)
    renewed = x > 50
    found = carry_pixels(source, lead, onto, 1.5, kept, renewed)
    expected = onto.land(x, y, right)
    has_patch = renewed & (lead.patch_labels >= 0)
    assert has_patch.mean() > 0.6
    np.testing.assert_allclose(found.position[has_patch], expected[has_patch], atol=1e-3)
    np.testing.assert_allclose(found.offset[has_patch], lead.offset[has_patch] + 1.5, atol=1e-5)
    np.testing.assert_array_equal(found.position[~renewed], landed[~renewed])
    assert np.isnan(found.position[renewed & (lead.patch_labels < 0)]).all()


def test_patches_move_as_their_planes_do(cold):
    """Motions onto one reference that are those of planes are so onto the other."""
    lead, onto = _of(cold, FAR), _of(cold, NEAR).parallax
    patches = lead.motions.patches
    exact = motions.from_parallax(patches, lead.parallax)
    found = carry_motions(replace(lead, motions=replace(lead.motions, motion=exact)), onto, 0.0)
    expected = motions.from_parallax(patches, onto)
    np.testing.assert_allclose(found.motion[:, :9], expected[:, :9], atol=0.01)


def test_a_view_is_carried_as_well_as_it_is_fitted(cold, warm):
    """What has moved lands on the nearer reference where a fit of its own puts it."""
    carried, fitted = _of(warm, NEAR), _of(_registered(1, (NEAR,), cold), NEAR)
    renewed = carried.renewed & fitted.renewed
    trusted = renewed & (carried.registered.flags == 0) & (fitted.registered.flags == 0)
    assert trusted.sum() > 0.7 * (renewed & (fitted.registered.flags == 0)).sum() > 500
    away = np.linalg.norm(carried.registered.position - fitted.registered.position, axis=-1)
    assert 0 < np.median(away[trusted]) < 0.04


def test_a_lead_that_starts_afresh_leaves_the_other_to_be_fitted(cold):
    """Motions that have drifted on the one are no reason to believe it on the other."""
    lead = _of(cold, FAR)
    motion = lead.motions.motion.copy()
    motion[:, 0] += 0.5
    drifted = replace(lead, motions=replace(lead.motions, motion=motion))
    found = {
        target: [drifted if one is lead else one for one in registrations]
        for target, registrations in cold.registrations.items()
    }
    again = _registered(0, (NEAR, FAR), replace(cold, registrations=found))
    assert _of(again, FAR).renewed is None
    away = np.linalg.norm(
        _of(again, NEAR).registered.position - _of(cold, NEAR).registered.position, axis=-1
    )
    assert np.nanmedian(away) < 0.01
