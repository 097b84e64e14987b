"""What of a target is made again: all of it in its turn."""

from __future__ import annotations

import numpy as np

from pipeline.reconstruction.fused import FusedTuning
from pipeline.superresolve.due import MOVED, SELDOM, in_turn, in_turn_or_seldom

SHAPE, EVERY = (50, 71), 4


def test_all_that_is_wanted_has_its_turn_once():
    wanted = np.random.default_rng(0).random(SHAPE) < 0.7
    parts = [in_turn(wanted, EVERY, number) for number in range(7, 7 + EVERY)]
    np.testing.assert_array_equal(np.sum(parts, axis=0), wanted)


def test_what_is_begun_before_it_is_known_how_many_views_there_are_is_the_same():
    usual = FusedTuning()
    assert (MOVED.alone, MOVED.prior_detail) == (usual.alone, usual.prior_detail)


def test_what_is_ripe_has_every_turn_and_the_rest_one_of_a_few():
    wanted, ripe = np.random.default_rng(1).random((2, *SHAPE)) < 0.5
    numbers = range(EVERY, EVERY * (1 + SELDOM))
    parts = [in_turn_or_seldom(wanted, ripe.__getitem__, EVERY, number) for number in numbers]
    count = np.sum(parts, axis=0)
    np.testing.assert_array_equal(count[wanted & ripe], SELDOM)
    np.testing.assert_array_equal(count[wanted & ~ripe], 1)
    assert not count[~wanted].any()
    shares = [part[wanted & ~ripe].sum() for part in parts]
    assert max(shares) < 1.5 * np.mean(shares), "no frame costs much more than the others"
