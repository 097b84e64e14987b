"""Whole frames out of parts that come as they like."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.bus.keys import Part
from service.streams.assembly import ArrivedPart, Assembler, Expected
from service.streams.options import Rule

VIEWS = ("a", "b", "c")
EXPECTED = Expected(
    color=frozenset(VIEWS), depth=frozenset(VIEWS), needed=frozenset("ab"), interval=0.1,
    wait=0.2, window=4, max_bytes=10_000,
)  # fmt: skip
BASE_NS = 1_760_000_000_000_000_000


def part(view, kind, frame, at, *, size=10, capture=None):
    return ArrivedPart(
        view=view,
        part=Part(kind),
        frame_index=frame,
        capture_time_ns=BASE_NS + round(frame * 1e8) if capture is None else capture,
        arrived=at,
        size=size,
    )


def whole(frame, at, *, without=(), **more):
    return [
        part(view, kind, frame, at, **more)
        for view in VIEWS
        for kind in ("color", "depth")
        if (view, kind) not in without
    ]


def feed(machine, parts):
    return [frame for item in parts for frame in machine.take(item)]


def test_a_frame_leaves_with_its_last_part_and_knows_when_that_came():
    machine = Assembler(EXPECTED)
    parts = [replace(item, arrived=0.01 * n) for n, item in enumerate(whole(5, 0.0))]
    assert feed(machine, parts[:-1]) == []
    (frame,) = machine.take(parts[-1])
    assert (frame.frame_index, frame.position, frame.missing) == (5, 0, frozenset())
    assert (frame.first_arrived, frame.last_arrived) == (0.0, 0.05)
    assert len(frame.parts) == 6
    assert machine.deadline is None


def test_frames_that_come_in_disorder_leave_in_order():
    machine = Assembler(EXPECTED)
    first, second = whole(1, 0.0), whole(2, 0.01)
    assert feed(machine, first[:3] + second) == []
    left = feed(machine, [replace(item, arrived=0.02) for item in first[3:]])
    assert [frame.frame_index for frame in left] == [1, 2]
    assert [frame.position for frame in left] == [0, 1]


def test_a_frame_that_stays_incomplete_holds_the_next_up_no_longer_than_allowed():
    machine = Assembler(EXPECTED)
    feed(machine, whole(1, 0.0, without=[("a", "color")]))
    assert feed(machine, whole(2, 0.1)) == []
    assert machine.deadline == pytest.approx(0.2)
    assert machine.tick(0.19) == []
    (frame,) = machine.tick(0.2)
    assert frame.frame_index == 2
    assert machine.counts.frames_incomplete == 1
    assert machine.counts.parts_lost == 5
    assert machine.take(part("a", "color", 1, 0.3)) == []
    assert machine.counts.parts_late == 1


@pytest.mark.parametrize(
    ("without", "rules", "leaves"),
    [
        ([("c", "depth")], {}, True),
        ([("c", "depth")], {"missing_depth": Rule.DROP}, False),
        ([("a", "depth"), ("b", "depth"), ("c", "depth")], {}, True),
        ([("c", "color")], {}, False),
        ([("c", "color")], {"missing_view": Rule.USE}, True),
        ([("c", "color"), ("c", "depth")],
         {"missing_view": Rule.USE, "missing_depth": Rule.DROP}, True),
        ([("b", "color")], {"missing_view": Rule.USE}, False),
    ],
)  # fmt: skip
def test_what_is_missing_decides_with_the_rules(without, rules, leaves):
    machine = Assembler(replace(EXPECTED, **rules))
    assert feed(machine, whole(1, 0.0, without=without)) == []
    left = machine.tick(1.0)
    assert [frame.missing for frame in left] == ([frozenset(without)] if leaves else [])
    counts = machine.counts
    used = counts.frames_without_view + counts.frames_without_depth
    assert (used, counts.frames_incomplete) == ((1, 0) if leaves else (0, 1))


def test_what_comes_twice_or_from_nobody_is_counted():
    machine = Assembler(EXPECTED)
    machine.take(part("a", "color", 1, 0.0))
    machine.take(part("a", "color", 1, 0.0))
    machine.take(part("z", "color", 1, 0.0))
    machine.take(part("b", "color", 1, 0.0, size=20_000))
    counts = machine.counts
    assert (counts.parts_duplicate, counts.parts_unknown, counts.parts_too_large) == (1, 1, 1)


def test_too_many_unfinished_frames_push_the_oldest_out():
    machine = Assembler(EXPECTED)
    for frame in range(1, 7):
        machine.take(part("a", "color", frame, 0.0))
    assert machine.counts.frames_crowded_out == 2
    assert machine.waiting_parts == 4


def test_one_wild_number_spoils_nothing():
    machine = Assembler(EXPECTED)
    machine.take(part("a", "color", 1 << 62, 0.0))
    left = [frame.frame_index for n in range(10) for frame in feed(machine, whole(n, 0.01 * n))]
    assert left == list(range(10))


def test_a_source_that_begins_to_count_anew_is_followed():
    machine = Assembler(EXPECTED)
    before = [frame for n in range(20, 23) for frame in feed(machine, whole(n, 0.1 * n))]
    later = BASE_NS + 10**10
    after = [
        frame for n in range(3) for frame in feed(machine, whole(n, 5 + 0.1 * n, capture=later + n))
    ]
    assert [frame.frame_index for frame in before + after] == [20, 21, 22, 0, 1, 2]
    assert [frame.position for frame in before + after] == list(range(6))
    assert machine.counts.restarts == 1


def test_a_gap_of_the_source_is_a_gap_in_time_but_no_endless_one():
    machine = Assembler(EXPECTED)
    left = [f for n in (0, 3, 1_000_000_000) for f in feed(machine, whole(n, 0.001 * n))]
    assert [frame.position for frame in left] == [0, 3, 4]
    assert machine.counts.frames_missing == 2


@pytest.mark.parametrize(("rule", "leaves"), [(Rule.USE, 1), (Rule.DROP, 0)])
def test_cameras_whose_clocks_disagree_are_counted(rule, leaves):
    machine = Assembler(replace(EXPECTED, skewed=rule))
    parts = whole(1, 0.0)
    parts[0] = replace(parts[0], capture_time_ns=parts[0].capture_time_ns + 60_000_000)
    assert len(feed(machine, parts)) == leaves
    assert machine.counts.frames_skewed == 1


ARRIVALS = st.lists(
    st.tuples(
        st.sampled_from([*VIEWS, "z"]),
        st.sampled_from(["color", "depth"]),
        st.one_of(st.integers(0, 12), st.integers(0, 1 << 62)),
        st.floats(0, 0.15),
        st.integers(0, 6_000),
        st.integers(-(10**9), 10**9),
    ),
    max_size=150,
)


@given(arrivals=ARRIVALS, window=st.integers(1, 5), rule=st.sampled_from(Rule))
def test_whatever_comes_all_is_accounted_for_and_bounded(arrivals, window, rule):
    expected = replace(EXPECTED, window=window, missing_view=rule, skewed=rule)
    machine = Assembler(expected)
    now, position, seen = 0.0, -1, Counter()
    for view, kind, frame, pause, size, skew in arrivals:
        now += pause
        item = part(view, kind, frame, now, size=size, capture=BASE_NS + skew)
        for left in machine.take(item):
            assert left.position > position
            position = left.position
            assert left.missing == expected.parts - set(left.parts)
            assert expected.is_usable(left.missing)
            assert {item.frame_index for item in left.parts.values()} == {left.frame_index}
            assert left.first_arrived <= left.last_arrived <= now
            seen[id(left.parts)] += 1
        assert len(machine._waiting) <= window
        assert machine.waiting_bytes <= expected.max_bytes
        assert machine.deadline is None or machine.deadline > now
        counts = machine.counts
        assert counts.parts_received == (
            counts.parts_used + counts.parts_duplicate + counts.parts_late + counts.parts_unknown
            + counts.parts_too_large + counts.parts_lost + machine.waiting_parts
        )  # fmt: skip
    machine.tick(now + 1)
    assert machine.waiting_parts == 0
    assert max(seen.values(), default=1) == 1


@given(
    order=st.permutations(range(12)),
    lost=st.sets(st.integers(0, 11), max_size=3),
)
def test_small_disorder_and_loss_cost_only_what_is_lost(order, lost):
    """Parts of two frames in any order: whatever is whole comes out."""
    parts = whole(1, 0.0) + whole(2, 0.0)
    machine = Assembler(replace(EXPECTED, missing_depth=Rule.DROP))
    left = feed(machine, [parts[number] for number in order if number not in lost])
    left += machine.tick(1.0)
    expected = [n for n in (1, 2) if not any(parts[item].frame_index == n for item in lost)]
    assert [frame.frame_index for frame in left] == expected
