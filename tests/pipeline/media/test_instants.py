"""Pictures of one instant find each other, whatever the network does to them."""

from __future__ import annotations

import itertools
import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.media.instants import FORGOTTEN, KEPT, LATE, Instants, SteadyClock

MS = 1_000_000


def test_the_clock_is_as_steady_as_the_camera_s():
    chance, clock = random.Random(1), SteadyClock()
    came = [40 * n * MS + 7 * MS + chance.randrange(30) * MS for n in range(200)]
    taken = [clock.taken(40 * n * MS, at) for n, at in enumerate(came)]
    later = taken[100:]
    assert {b - a for a, b in itertools.pairwise(later)} == {40 * MS}
    assert later[0] - 100 * 40 * MS == min(at - 40 * n * MS for n, at in enumerate(came))


def test_the_clock_begins_anew_where_time_stamps_do():
    clock = SteadyClock()
    clock.taken(5_000 * MS, 9_000 * MS)
    assert clock.taken(0, 9_040 * MS) == 9_040 * MS
    assert clock.taken(40 * MS, 9_081 * MS) == 9_080 * MS


def test_what_the_network_held_up_was_taken_when_it_was():
    clock = SteadyClock()
    clock.taken(0, 7 * MS)
    held = [clock.taken(40 * n * MS, 2_000 * MS + n) for n in range(1, 50)]
    assert held == [40 * n * MS + 7 * MS for n in range(1, 50)]


def test_the_clock_forgets_and_so_follows_one_that_drifts():
    clock = SteadyClock()
    for n in range(0, 3 * FORGOTTEN, 100 * MS):
        taken = clock.taken(n, n + n // 10_000)  # a hundred parts in a million slow
    assert n + n // 10_000 - taken <= FORGOTTEN // 10_000


def paired(instants, now):
    return [(item.taken // MS, dict(item.pictures)) for item in instants.ready(now * MS)]


def test_the_nearest_picture_of_each_camera_belongs_to_an_instant():
    instants = Instants(["a", "b", "c"], period=100 * MS, patience=150 * MS)
    for at, name in ((0, "a0"), (100, "a1")):
        instants.add("a", at * MS, at * MS, name)
    for at, name in ((-30, "b0"), (20, "b1"), (90, "b2")):
        instants.add("b", at * MS, at * MS, name)
    instants.add("c", -45 * MS, 0, "c0")
    assert paired(instants, 149) == []
    instants.add("c", 60 * MS, 60 * MS, "c1")
    assert paired(instants, 110) == [(0, {"a": "a0", "b": "b1", "c": "c0"})]
    # b has nothing after 100 yet, so that one nearer may come
    assert paired(instants, 240) == []
    assert paired(instants, 250) == [(100, {"a": "a1", "b": "b2", "c": "c1"})]


def test_a_camera_that_is_away_holds_nobody_up_for_longer_than_said():
    instants = Instants(["a", "b"], period=100 * MS, patience=150 * MS)
    instants.add("a", 0, 5 * MS, "a0")
    assert paired(instants, 154) == []
    assert paired(instants, 155) == [(0, {"a": "a0"})]
    instants.add("b", 51 * MS, 200 * MS, "b0")
    instants.add("a", 100 * MS, 100 * MS, "a1")
    assert paired(instants, 300) == [(100, {"a": "a1", "b": "b0"})]


@pytest.mark.parametrize(("of_camera", "asked", "share"), [(30, 15, 2), (30, 30, 1), (60, 15, 4)])
def test_a_lower_rate_takes_every_nth_picture(of_camera, asked, share):
    instants = Instants(["a"], period=10**9 // asked, patience=0)
    found = []
    for n in range(60):
        taken = n * 10**9 // of_camera + (n % 3 - 1) * MS
        instants.add("a", taken, taken, n)
        found += [item.pictures["a"] for item in instants.ready(taken)]
    assert found == list(range(0, 60, share))


def test_a_rate_that_is_no_divisor_is_kept_on_the_whole():
    instants = Instants(["a"], period=10**9 // 15, patience=0)
    count = 0
    for n in range(250):
        instants.add("a", n * 40 * MS, n * 40 * MS, n)
        count += len(list(instants.ready(n * 40 * MS)))
    assert count == 150


def test_what_nobody_takes_is_not_kept_for_ever():
    instants = Instants(["a", "b"], period=MS, patience=0)
    for n in range(10 * KEPT):
        instants.add("a", n * MS, n * MS, n)
        instants.add("b", n * MS, n * MS, n)
    assert len(list(instants.ready(10 * KEPT * MS))) == KEPT
    assert instants.left_out == 9 * KEPT


def test_what_could_have_been_taken_away_long_ago_is_left_out_and_counted():
    instants = Instants(["a"], period=100 * MS, patience=0)
    for n in range(10):
        instants.add("a", 100 * n * MS, 100 * n * MS, n)
    taken = [item.pictures["a"] for item in instants.ready(LATE + 400 * MS)]
    assert (taken, instants.left_out) == ([4, 5, 6, 7, 8, 9], 4)


def test_the_pace_goes_on_after_a_gap_and_after_a_clock_set_back():
    instants = Instants(["a"], period=100 * MS, patience=0)
    for at in (0, 100, 5000, 5100, 40, 140):
        instants.add("a", at * MS, at * MS, at)
    assert [item.pictures["a"] for item in instants.ready(0)] == [0, 100, 5000, 5100, 40, 140]


@given(
    st.lists(st.integers(-40, 40), min_size=10, max_size=40),
    st.lists(st.integers(0, 60), min_size=10, max_size=40),
)
def test_pictures_that_are_taken_nearly_at_once_are_never_torn_apart(shifts, delays):
    """Whatever the delays, an instant holds the two pictures of its number, or the first alone."""
    instants = Instants(["a", "b"], period=100 * MS, patience=200 * MS)
    events = []
    for n, (shift, delay) in enumerate(zip(shifts, delays, strict=False)):
        events.append((100 * n, "a", 100 * n, n))
        events.append((100 * n + shift + delay, "b", 100 * n + shift, n))
    # each camera's pictures come in order
    events.sort(key=lambda event: (event[0], event[1]))
    found = []
    for came, camera, taken, n in events:
        if camera == "b" and any(m > n for c, m in found if c == "b"):
            continue
        found.append((camera, n))
        instants.add(camera, taken * MS, came * MS, n)
        for instant in instants.ready(came * MS):
            assert set(instant.pictures.values()) == {instant.taken // (100 * MS)}
