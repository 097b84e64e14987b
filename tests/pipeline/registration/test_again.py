"""Registering again: what stands still is kept, what has moved is found, drift is repaired."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.registration.again import AGAIN
from pipeline.registration.kernels import FITTED
from pipeline.registration.method import METHODS, MotionModel
from pipeline.registration.register import (
    Previous,
    Terms,
    Thresholds,
    ViewRegistration,
    prepare_views,
    register_views,
)
from pipeline.synthetic import SampleScene

THRESHOLDS = Thresholds(weight=6.0, depth=0.1)
METHOD = METHODS["default"]

LATER = max(AGAIN) + 1
"""A frame of a chain in which nothing is fitted that has not changed."""


@pytest.fixture(scope="module")
def frame():
    return SampleScene(width=192, height=144, num_views=3).frame(0, noise_sigma=1.0)


@pytest.fixture(scope="module")
def cold(frame):
    return _previous(frame, None)


def _previous(frame, previous: Previous | None, turn: int = LATER, method=METHOD) -> Previous:
    prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
    names = [view.view_id for view in frame.views]
    terms = Terms(method=method, noise=1.0, thresholds=THRESHOLDS)
    found = register_views(prepared, (frame.left,), names, terms, previous=previous)
    return Previous(prepared=prepared, registrations=found, turn=turn)


def _other(previous: Previous, frame) -> ViewRegistration:
    """The registration of the last view, which is not the reference."""
    return previous.registrations[frame.left][-1]


def _with_a_change(frame):
    """The frame with a patch of its last view inverted."""
    views = list(frame.views)
    luma = views[-1].luma.copy()
    luma[60:80, 90:110] = 255 - luma[60:80, 90:110]
    views[-1] = replace(views[-1], luma=luma)
    return replace(frame, views=tuple(views))


def _with_part(frame, width, change):
    """The frame with its last view changed from the left edge on."""
    views = list(frame.views)
    luma = views[-1].luma.copy()
    luma[:, :width] = change(luma)[:, :width]
    views[-1] = replace(views[-1], luma=luma)
    return replace(frame, views=tuple(views))


def _chance(seed):
    """Return a change into a picture of nothing."""
    return lambda luma: np.random.default_rng(seed).normal(128, 40, luma.shape)


def _moved(previous: Previous, shift: np.ndarray) -> Previous:
    """The same with the motions it remembers shifted by so many pixels each, (P,) along x."""

    def wrong(one: ViewRegistration) -> ViewRegistration:
        if one.motions is None:
            return one
        motion = one.motions.motion.copy()
        motion[:, 0] += shift[: len(motion)]
        return replace(one, motions=replace(one.motions, motion=motion))

    found = {
        target: [wrong(one) for one in registrations]
        for target, registrations in previous.registrations.items()
    }
    return replace(previous, registrations=found)


def test_where_nothing_changes_nothing_is_computed_again(frame, cold):
    again = _other(_previous(frame, cold), frame)
    before = _other(cold, frame)
    assert again.registered.position is before.registered.position
    assert again.registered.flags is before.registered.flags
    assert again.renewed is not None
    assert not again.renewed.any()
    np.testing.assert_allclose(again.registered.observed, before.registered.observed, atol=1e-4)


@pytest.mark.parametrize("turn", AGAIN)
def test_early_in_a_chain_every_cell_is_fitted_anew(frame, cold, turn):
    again = _other(_previous(frame, replace(cold, turn=turn)), frame)
    before = _other(cold, frame)
    assert again.renewed is not None
    assert again.renewed.all()
    trusted = (again.registered.flags == 0) & (before.registered.flags == 0)
    away = np.linalg.norm(again.registered.position - before.registered.position, axis=-1)
    assert 0 < np.median(away[trusted]) < 0.02


def test_only_what_is_near_a_change_is_renewed_and_well(frame, cold):
    again = _other(_previous(_with_a_change(frame), cold), frame)
    before = _other(cold, frame)
    assert again.renewed is not None
    assert again.renewed[60:80, 90:110].all()
    assert again.renewed.mean() < 0.4
    still = ~again.renewed
    np.testing.assert_array_equal(
        again.registered.position[still], before.registered.position[still]
    )
    # an inverted patch fits nothing
    assert (again.registered.flags[65:75, 95:105] != 0).mean() > 0.9


def test_what_is_renewed_has_the_motion_model_of_the_rest(frame):
    method = replace(METHOD, model=MotionModel.TRANSLATION)
    cold = _previous(frame, None, method=method)
    again = _other(_previous(_with_a_change(frame), cold, method=method), frame)
    assert again.renewed is not None
    assert again.renewed.any()
    assert again.motions is not None
    assert np.abs(again.motions.motion[:, [1, 2, 7, 8]]).max() < 1e-3


def test_what_lies_where_the_rig_does_not_say_is_registered_as_from_scratch(frame, cold):
    """Three pixels across the parallax: few steps from where the rig says do not reach it."""
    other = _with_part(frame, 96, lambda luma: np.roll(luma, 3, axis=0))
    ours, alone = (_other(_previous(other, before), frame) for before in (cold, None))
    assert ours.renewed is None
    part = np.s_[10:-10, 10:76]
    trusted = (ours.registered.flags == 0)[part], (alone.registered.flags == 0)[part]
    assert trusted[0].mean() > trusted[1].mean() - 0.02


def test_what_nothing_explains_is_not_tried_from_scratch_in_each_frame(frame, cold):
    """Until it misfits by much more than when that was tried."""
    first = _previous(_with_part(frame, 40, _chance(0)), cold)
    again = _other(first, frame)
    assert again.renewed is not None
    assert not again.renewed.all()
    assert again.misfit > 3
    second = _previous(_with_part(frame, 40, _chance(1)), first)
    assert _other(second, frame).misfit == again.misfit
    assert _other(_previous(frame, second), frame).misfit == 0, "what fits is forgotten"


def test_a_rig_that_has_drifted_is_registered_anew(frame, cold):
    before = _other(cold, frame)
    assert before.motions is not None
    drifted = _moved(cold, np.full(len(before.motions.motion) * 4, 0.4))
    again = _other(_previous(frame, drifted), frame)
    assert again.renewed is None
    away = np.linalg.norm(again.registered.position - before.registered.position, axis=-1)
    assert np.nanmedian(away) < 0.03


def test_a_cell_that_has_drifted_is_repaired_when_it_is_probed(frame, cold):
    before = _other(cold, frame)
    assert before.motions is not None
    motions = before.motions
    wanted = (motions.status == FITTED) & (motions.reliable > 0.9)
    wanted &= motions.patches.support > 500
    patch = int(np.flatnonzero(wanted)[len(np.flatnonzero(wanted)) // 2])
    shift = np.zeros(len(motions.motion) * 4)
    shift[patch] = 0.6
    previous = _moved(cold, shift)
    repaired = []
    for turn in range(LATER, LATER + 23):
        previous = _previous(frame, replace(previous, turn=turn), turn)
        again = _other(previous, frame)
        assert again.motions is not None
        away = abs(again.motions.motion[patch, 0] - motions.motion[patch, 0])
        if away < 0.1:
            repaired.append(turn)
            break
        assert away == pytest.approx(0.6)
    assert repaired


@pytest.mark.parametrize("unit", [0.7, 1.4, 5.0])
def test_depth_in_another_unit_is_registered_as_from_scratch(frame, cold, unit):
    """The motions of before and their parallax are told by depth in the old one."""
    views = [replace(view, depth_map=unit * view.depth_map + 0.1) for view in frame.views]
    other = replace(frame, views=tuple(views))
    ours, alone = (_other(_previous(other, before), frame) for before in (cold, None))
    np.testing.assert_array_equal(ours.registered.position, alone.registered.position)
    again = _other(_previous(frame, cold), frame)
    assert again.parallax is _other(cold, frame).parallax, "depth in the same unit is no reason"
