"""The controller of real time: what it leaves out, when, and that it does not swing."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import ConfigurationError
from pipeline.realtime import (
    AIM,
    BARELY_TOO_MUCH,
    CALM,
    COLD,
    FAR_TOO_MUCH,
    FILLING,
    HARDLY_TOO_MUCH,
    IN_A_ROW,
    IN_VAIN,
    JUDGED,
    JUDGED_LONGER,
    LATE,
    LEFT,
    LITTLE,
    LONGEST_CALM,
    PATIENCE,
    TOO_MUCH,
    Controller,
    account_of,
    ladder,
    paced,
)  # fmt: skip

RATE = 10.0
BUDGET = 1 / RATE


def _controller(num_views=8, *, mixes=False):
    return Controller(rate=RATE, num_views=num_views, mixes=mixes)


def _run(controller, costs):
    """Feed frames that are in time; return the level of each."""
    levels = []
    for cost in costs:
        choice = controller.begin(0.0)
        levels.append(choice.level)
        controller.end(choice, cost)
    return levels


def _watched(loads, *, first, count=60, mixes=False):
    """Return the controller and the choices of a stream whose frames cost by their rung.

    Parameters
    ----------
    loads : sequence of float
        By rung: the share of the budget that a frame costs.
    first : float
        The same of the first frame.
    """
    clock, controller, choices = Clock(), _controller(mixes=mixes), []
    for number, choice in paced(range(count), controller, clock):
        choices.append(choice)
        if not choice.drop:
            clock.now += BUDGET * (loads[choice.level] if number else first)
    return controller, choices


def _parts(num_views=8):
    """Return the work of the rungs and their reading, of a frame at full quality."""
    rungs = ladder(num_views)
    parts = [(rung.work(num_views), rung.reading(num_views)) for rung in rungs]
    return [(work / sum(parts[0]), reading / sum(parts[0])) for work, reading in parts]


def _works(num_views=8):
    """Return what the rungs cost of a frame at full quality."""
    return [sum(both) for both in _parts(num_views)]


class Clock:
    """A clock that work moves on."""

    def __init__(self):
        self.now = 0.0

    def __call__(self):
        return self.now


@pytest.mark.parametrize("num_views", [1, 2, 3, 8])
@pytest.mark.parametrize("num_eyes", [1, 2])
@pytest.mark.parametrize("has_depth", [False, True])
def test_each_rung_has_less_than_the_one_above_in_the_stated_order(num_views, num_eyes, has_depth):
    rungs = ladder(num_views, num_eyes, has_depth=has_depth)
    assert str(rungs[0]) == "full quality"
    infinite = float("inf")

    def wealth(rung):
        effort = rung.effort
        return (
            not effort.alone, effort.refresh_every is not None, effort.others, effort.follow,
            effort.register, effort.by_depth, not effort.in_turn,
            effort.views or infinite, -effort.register_every, effort.steps or infinite,
        )  # fmt: skip

    assert list(map(wealth, rungs)) == sorted(map(wealth, rungs), reverse=True)
    assert len(set(rungs)) == len(rungs)
    assert all(
        rung.effort.views is None or num_eyes <= rung.effort.views < num_views for rung in rungs
    )
    assert str(rungs[-1]) == "each eye alone"
    works = [rung.work(num_views) for rung in rungs]
    assert works == sorted(works, reverse=True)


def test_frames_that_cost_too_much_lower_quality_and_one_slow_frame_does_not():
    controller = _controller()
    assert set(_run(controller, [0.5 * BUDGET] * 5 + [5 * BUDGET] + [0.5 * BUDGET] * 5)) == {0}
    levels = _run(controller, [1.2 * BUDGET] * 30)
    assert levels == sorted(levels)
    assert levels[-1] >= 5


def test_it_goes_down_as_far_as_frames_cost_too_much():
    works = _works()
    for load in (1.01 * BARELY_TOO_MUCH, 1.5, 2.0):
        controller = _controller()
        count = JUDGED if load > HARDLY_TOO_MUCH else JUDGED_LONGER
        _run(controller, [load * BUDGET] * (1 + count))
        assert load * works[controller.level] <= AIM < load * works[controller.level - 1]


def test_frames_that_scatter_about_less_than_their_time_keep_their_rung():
    """Three slow ones in a row are no reason: the machine has time for the others."""
    shares = [0.9, 0.8, 0.9, 0.9, 0.8, 0.9, 1.1, 1.1, 1.1] * 30
    assert set(_run(_controller(), [share * BUDGET for share in shares])) == {0}


def test_frames_that_cost_hardly_too_much_lower_quality_before_one_is_dropped():
    loads = [HARDLY_TOO_MUCH * work for work in _works()]
    controller, choices = _watched(loads, first=0.0, count=1 + JUDGED_LONGER)
    assert {choice.level for choice in choices} == {0} != {controller.level}
    assert not any(choice.drop for choice in choices)


@given(st.floats(1.01, BARELY_TOO_MUCH))
def test_frames_that_cost_barely_too_much_lower_quality_once_they_are_late(load):
    loads = [load * work for work in _works()]
    controller, choices = _watched(loads, first=0.0, count=400)
    kept = [choice for choice in choices if choice.level == 0]
    late = [choice.late / BUDGET for choice in kept]
    assert LATE < late[-1] <= LATE + JUDGED_LONGER * (load - 1), "as long as it may"
    assert controller.level > 0
    assert controller.dropped == 0


@given(st.floats(0.5, BARELY_TOO_MUCH - 0.001))
def test_frames_in_time_that_cost_barely_too_much_keep_their_rung(load):
    assert set(_run(_controller(), [load * BUDGET] * 100)) == {0}


def test_the_first_frame_of_a_rung_says_little_of_those_that_follow():
    """It loads its kernels: where it counted, two of three would decide."""
    slow, usual = 1.9 * BUDGET, 0.7 * BUDGET
    controller = _controller()
    _run(controller, [0.5 * BUDGET] * 3)
    while controller.level == 0:
        _run(controller, [1.5 * BUDGET])
    assert len(set(_run(controller, [slow, slow, usual, usual]))) == 1


@pytest.mark.parametrize(("times", "is_left"), [(0.9, False), (1.1, True)])
def test_caches_that_are_filled_are_not_taken_for_what_a_rung_costs(times, is_left):
    """The first frame of a rung that was gone down to decides alone by the rest of its cost."""
    controller = _controller()
    _run(controller, [0.5 * BUDGET] * 3)
    while controller.level == 0:
        _run(controller, [1.5 * BUDGET])
    level = controller.level
    _run(controller, [FAR_TOO_MUCH * BUDGET + times * FILLING])
    assert (controller.level > level) == is_left


@given(st.floats(1.01 * FAR_TOO_MUCH, AIM / _works()[-1]))
def test_a_first_frame_says_where_to_begin_so_that_none_is_dropped(load):
    loads = [load * work for work in _works()]
    controller, choices = _watched(loads, first=COLD * load, count=10)
    assert not any(choice.drop for choice in choices)
    level = choices[1].level
    assert loads[level] <= 1.001 * AIM < 1.002 * loads[level - 1]
    assert controller.level == level


@pytest.mark.parametrize("load", [2.5, 3.5])
def test_without_that_hint_the_first_frame_that_costs_a_multiple_is_enough(load):
    """A moving picture, not three frames at full quality first."""
    loads = [load * work for work in _works()]
    controller, choices = _watched(loads, first=0.0, count=20)
    assert choices[1].level == 0
    assert all(choice.level > 0 for choice in choices[2:])
    assert controller.dropped <= load - PATIENCE + 1


@given(st.floats(FAR_TOO_MUCH * COLD, 10_000), st.floats(0.05, 0.8))
def test_a_first_frame_that_compiled_does_not_cost_quality_for_long(first, load):
    loads = [load * work for work in _works()]
    controller, choices = _watched(loads, first=first, count=4)
    assert choices[1].level > 0
    assert controller.level == choices[2].level == 0
    assert not any(choice.drop for choice in choices)


@given(
    st.lists(st.floats(0.5, 2.0), min_size=len(_works()), max_size=len(_works())),
    st.floats(0.1, 20),
)
def test_it_settles_however_wrong_the_work_of_the_rungs_is_estimated(factors, load):
    """It comes to a rung that fits, or the last one, and hardly turns back."""
    works = [work * factor for work, factor in zip(_works(), factors, strict=True)]
    controller = _controller()
    levels = _run(controller, [load * BUDGET])
    for _ in range(JUDGED * len(works)):
        choice = controller.begin(0.0)
        levels.append(choice.level)
        controller.end(choice, load * works[choice.level] * BUDGET)
    last = len(works) - 1
    assert any(load * works[level] <= BARELY_TOO_MUCH or level == last for level in levels)
    ups = [there for here, there in itertools.pairwise(levels) if there < here]
    assert len(ups) <= 1 + len(levels) // CALM


def _settled(load, beside, count, controller=None):
    """Return the levels of frames in time whose rung decides on work and reading only.

    Parameters
    ----------
    load, beside : float
        Shares of the budget: of what a rung decides on at full quality, and of the rest.
    """
    controller, parts, levels = controller or _controller(), _parts(), []
    for _ in range(count):
        choice = controller.begin(0.0)
        levels.append(choice.level)
        worked, read = (load * part * BUDGET for part in parts[choice.level])
        controller.end(choice, worked + read + beside * BUDGET, worked)
    return levels


@given(st.floats(0.1, 20), st.floats(0.0, 0.8))
def test_it_goes_at_once_where_the_rest_of_a_frame_leaves_time_for(load, beside):
    """What no rung changes is told, and not taken for what one does."""
    works = _works()
    levels = _settled(load, beside, JUDGED_LONGER + 3)
    fits = [beside + load * work <= AIM for work in works]
    hardly = [
        beside + load * work <= (1 + 1.01 * IN_VAIN) * (beside + load * works[-1])
        for work in works
    ]  # fmt: skip
    if load + beside > 1:
        # the rung that is guessed from the first frame is left only where it is too much
        is_guessed = levels[1] == levels[-1]
        most = BARELY_TOO_MUCH if is_guessed else AIM  # they are in time
        has_time = beside + load * works[levels[-1]] <= most
        assert has_time or hardly[levels[-1]]
        assert not any(fits[: levels[-1]]), "no farther than it must"
    else:
        assert set(levels) == {0}


@given(st.floats(0.01, 0.04), st.floats(1.05, 3.0))
def test_quality_does_not_go_down_in_vain(load, beside):
    assert set(_settled(load, beside, 60)) == {0}


@given(st.floats(0.1, 20), st.floats(0.0, 0.8))
def test_it_is_never_above_its_budget_for_long_and_seldom_changes(load, beside):
    works = _works()
    levels = _settled(load, beside, 1500)[500:]
    lasts = beside + load * works[-1] > 1
    # they are in time, by which a rung is kept that is barely too much
    above = sum(beside + load * works[level] > BARELY_TOO_MUCH for level in levels)
    changes = sum(here != there for here, there in itertools.pairwise(levels))
    assert lasts or above <= JUDGED_LONGER * (1000 / LONGEST_CALM + 2)
    assert changes <= 2 * (1000 / LONGEST_CALM + 2)


@given(st.floats(1.2, 20), st.floats(0.0, 0.5))
def test_it_recovers_once_there_is_time_again(load, beside):
    controller = _controller()
    _settled(load, beside, 50, controller)
    levels = _settled(0.2, 0.2, 2 * CALM * (len(controller.rungs) + 1), controller)
    assert levels == sorted(levels, reverse=True)
    assert controller.level == 0


def test_quality_comes_back_after_a_calm():
    controller = _controller()
    _run(controller, [2 * BUDGET] * 4)
    low = controller.level
    assert low > 1
    _run(controller, [BUDGET])
    _run(controller, [0.5 * BUDGET] * (CALM - 1))
    assert controller.level == low
    _run(controller, [0.5 * BUDGET] * (CALM * low))
    assert controller.level == 0


def test_a_restless_frame_now_and_then_does_not_keep_quality_down():
    controller = _controller()
    _run(controller, [2 * BUDGET] * 4)
    low = controller.level
    _run(controller, ([0.5 * BUDGET] * 9 + [0.95 * BUDGET]) * 6)
    assert controller.level < low


@pytest.mark.parametrize("every", [3, 5, 15])
def test_a_dear_frame_a_second_does_not_keep_quality_down(every):
    """A key frame at few frames a second, by which alone no rung up had time enough."""
    controller = _controller()
    _run(controller, [100 * BUDGET] * 4)
    low, works = controller.level, _works()
    levels = []
    for number in range(4 * CALM):
        choice = controller.begin(0.0)
        levels.append(choice.level)
        beside = 0.3 + 0.5 * (number % every == 0)
        worked = 0.05 * works[choice.level] / works[low]
        controller.end(choice, (beside + worked) * BUDGET, worked * BUDGET)
    assert all(0.3 + 0.5 / every + 0.05 * works[level] / works[low] < 1 for level in levels)
    assert min(levels[: CALM + JUDGED_LONGER]) < low


@given(st.floats(0.05, 1.5))
def test_it_goes_back_at_once_to_where_there_is_time_enough(load):
    """Not rung by rung: with few frames a second a viewer would wait for a minute."""
    controller, works = _controller(), _works()
    _run(controller, [100 * BUDGET] * 4)
    levels = [len(works) - 1]
    _run(controller, [(TOO_MUCH + 0.01) * BUDGET])
    for _ in range(2 * CALM):
        choice = controller.begin(0.0)
        levels.append(choice.level)
        controller.end(choice, load * works[choice.level] * BUDGET)
    # what rungs should cost is estimated, and rounded
    best = next(level for level, work in enumerate(works) if load * work <= 0.999 * AIM)
    assert levels[CALM + 2] <= best
    assert len(set(levels)) <= 3


def test_after_a_way_up_that_was_a_mistake_it_goes_rung_by_rung():
    controller = _controller()
    _run(controller, [100 * BUDGET] * 4)
    last = len(controller.rungs) - 1
    levels = [last]
    for _ in range(40 * CALM):
        choice = controller.begin(0.0)
        levels.append(choice.level)
        controller.end(choice, (0.1 if choice.level >= last - 2 else 1.5) * BUDGET)
    ups = [(here, there) for here, there in itertools.pairwise(levels) if there < here]
    guessed, tried, *later = ups
    assert max(guessed[1], tried[1]) < last - 2, "what frames cost promised more"
    assert all(there == here - 1 for here, there in later)
    assert sum(level >= last - 2 for level in levels) > 0.9 * len(levels)


@given(st.floats(0.76, 0.9))
def test_quality_comes_back_where_the_rung_above_hardly_costs_more(cost):
    """A frame that leaves little time is calm where more than that is not asked for."""
    controller = _controller()
    rungs = controller.rungs
    level = len(rungs) - 2
    above, here = _parts()[level - 1 : level + 1]
    controller.level = level
    worked = 0.3
    needed = cost + worked * (sum(above) - sum(here)) / here[0]
    for _ in range(2 * CALM):
        choice = controller.begin(0.0)
        is_up = choice.level < level
        controller.end(choice, (needed if is_up else cost) * BUDGET, worked * BUDGET)
    assert (controller.level < level) == (needed <= AIM)


@given(st.floats(0.1, 0.2), st.floats(0.35, 0.5))
def test_a_rung_up_that_should_be_too_much_is_seldom_tried(worked, beside):
    """From the last rung, whose work is little more than half of that of the one above it."""
    controller = _controller()
    last = len(controller.rungs) - 1
    _run(controller, [100 * BUDGET] * 4)
    ups = 0
    for _ in range(LONGEST_CALM + CALM):
        choice = controller.begin(0.0)
        factor = _works()[choice.level] / _works()[last]
        cost = (beside + 2 * worked * factor) * BUDGET
        controller.end(choice, cost, 2 * worked * factor * BUDGET)
        ups += controller.level < choice.level
    fits = beside + 2 * worked * _works()[last - 1] / _works()[last] <= 1
    is_calm = beside + 2 * worked < LITTLE
    assert ups >= 1 if fits and is_calm else ups <= 1


def test_a_load_between_two_rungs_does_not_make_it_swing():
    """Rung 3 fits and rung 2 does not: trials become rarer and rarer."""
    controller = _controller()
    changes, level = [], 0
    for number in range(3000):
        choice = controller.begin(0.0)
        controller.end(choice, (0.7 if choice.level >= 3 else 1.1) * BUDGET)
        if controller.level != level:
            changes.append(number)
            level = controller.level
    in_first, in_last = (
        sum(first <= change < first + 1000 for change in changes) for first in (0, 2000)
    )
    assert in_last <= 2 * (1000 / LONGEST_CALM + 1)
    assert in_first > in_last


def test_late_frames_are_dropped_and_counted():
    controller = _controller()
    assert not controller.begin(PATIENCE * BUDGET).drop
    assert controller.begin(PATIENCE * BUDGET + 0.001).drop
    assert controller.account.dropped == controller.dropped == 1


@given(
    st.lists(st.tuples(st.floats(-1, 1), st.floats(0, 3)), max_size=300),
    st.integers(1, 9), st.integers(1, 2),
)  # fmt: skip
def test_whatever_happens_it_stays_on_the_ladder_and_counts_every_frame(happened, views, eyes):
    controller = Controller(rate=RATE, num_views=views, num_eyes=eyes)
    records, ups = [], 0
    for late, seconds in happened:
        before = controller.level
        choice = controller.begin(late)
        assert 0 <= choice.level < len(controller.rungs)
        assert choice.drop == (late > PATIENCE * BUDGET)
        assert choice.rung == controller.rungs[choice.level]
        records.append((choice.drop, str(choice.rung)))
        if not choice.drop:
            controller.end(choice, seconds)
            ups += controller.level < before
    assert ups <= 1 + len(happened) // CALM, "up after a calm, but once what frames cost is known"
    account = controller.account
    assert account.dropped + sum(account.frames_by_rung.values()) == len(happened)
    assert account_of(RATE, records).frames_by_rung == account.frames_by_rung
    again = Controller(rate=RATE, num_views=views, num_eyes=eyes)
    for late, seconds in happened:
        choice = again.begin(late)
        if not choice.drop:
            again.end(choice, seconds)
    assert again == controller, "nothing but its input decides"


@given(st.floats(0.1, 20), st.integers(1, 200))
def test_whatever_a_frame_costs_the_stream_does_not_fall_behind(load, count):
    """The stream ends in time, but for the first frame and the last."""
    clock, controller = Clock(), _controller()
    for _, choice in paced(range(count), controller, clock):
        if not choice.drop:
            clock.now += load * BUDGET * 0.8**choice.level
    assert clock.now <= (load + count + PATIENCE + load) * BUDGET + 1e-6
    assert controller.dropped + sum(controller.account.frames_by_rung.values()) == count


@given(st.floats(1.01, 0.99 * LEFT))
def test_two_rungs_share_what_neither_fills_by_itself(load):
    """What costs a little too much is kept; frames that are made late by it make good for it."""
    works = _works()
    controller, choices = _watched(
        [load * work for work in works], first=0.0, count=600, mixes=True
    )
    kept = [choice for choice in choices if choice.level == 0]
    others = [choice for choice in choices if choice.level > 0]
    assert controller.level == 0
    assert controller.dropped == 0
    assert max(choice.late for choice in choices) <= (LATE + load) * BUDGET
    assert all(choice.catches_up for choice in others)
    cheap = max(load * works[choice.level] for choice in others)
    assert load * len(kept) + cheap * len(others) > len(choices) * 0.97, "no time is left over"
    # of two eyes that have their turn, either as often
    odd = sum(number % 2 for number, choice in enumerate(choices) if choice.level == 0)
    assert abs(odd / len(kept) - 0.5) < 0.1


def test_where_somebody_waits_for_frames_none_catches_up():
    _, choices = _watched([1.1 * work for work in _works()], first=0.0, count=200)
    assert not any(choice.catches_up for choice in choices)


def test_where_frames_do_not_catch_up_the_next_ones_are_made_farther_down():
    """What the rung below should cost was wrong: it takes as long."""
    loads = [1.2] * 6 + [0.5] * 20
    controller, choices = _watched(loads, first=0.0, count=300, mixes=True)
    assert controller.level > 0
    assert not any(choice.drop for choice in choices[20:])
    caught_up = [
        list(run) for up, run in itertools.groupby(choices, lambda c: c.catches_up) if up
    ]  # fmt: skip
    assert max(map(len, caught_up)) <= IN_A_ROW
    assert sum(loads[choice.level] for choice in choices) > 0.95 * len(choices)


def test_where_no_rung_catches_up_the_stream_goes_down():
    loads = [1.2] * 26
    controller, choices = _watched(loads, first=0.0, count=100, mixes=True)
    assert controller.level == len(controller.rungs) - 1
    runs = itertools.groupby(choices[1:], lambda choice: choice.catches_up)
    assert max(sum(1 for _ in run) for up, run in runs if up) <= IN_A_ROW


@pytest.mark.parametrize("times", [1.2, 2.4])
def test_others_that_begin_to_use_the_machine_cost_no_frame(times):
    """What catches up is told by the frame before it, too, and not by those before they began."""
    clock, controller = Clock(), _controller(mixes=True)
    works, dropped = _works(), 0
    for number, choice in paced(range(80), controller, clock):
        dropped += choice.drop
        load = 0.8 * (times if number > 40 else 1.0) if number else 0.0
        clock.now += 0.0 if choice.drop else load * works[choice.level] * BUDGET
    assert dropped == 0
    assert (controller.level > 0) == (times > 1.5)


@given(st.floats(0.1, 20), st.integers(1, 200))
def test_a_stream_that_mixes_rungs_does_not_fall_behind(load, count):
    clock, controller = Clock(), _controller(mixes=True)
    for _, choice in paced(range(count), controller, clock):
        if not choice.drop:
            clock.now += load * BUDGET * 0.8**choice.level
    assert clock.now <= (load + count + PATIENCE + load) * BUDGET + 1e-6
    assert controller.dropped + sum(controller.account.frames_by_rung.values()) == count


@pytest.mark.parametrize("spacing", [0.3, 1.0, 2.0])
def test_waiting_for_frames_is_not_being_late_but_is_told(spacing):
    clock, controller = Clock(), _controller()
    waited = []

    def camera():
        for number in range(50):
            clock.now = max(clock.now, number * spacing * BUDGET)
            yield number

    for _, choice in paced(camera(), controller, clock):
        assert not choice.drop
        waited.append(choice.waited)
        clock.now += 0.5 * BUDGET
    assert controller.level == 0
    # before the first frame nothing is due, and after it everything is
    assert waited[0] == 0
    assert waited[1] == pytest.approx(max(0, spacing - 0.5) * BUDGET)
    assert waited[2:] == pytest.approx([max(0, spacing - 1) * BUDGET] * 48)
    account = account_of(RATE, [(False, "full quality")] * 50, waited=sum(waited))
    assert ("the input came 5.0 s too late in all." in account.sentence()) == (spacing > 1)


def test_time_left_over_is_not_saved_up():
    clock, controller = Clock(), _controller()
    late = []
    for number, choice in paced(range(60), controller, clock):
        late.append(choice.late)
        clock.now += BUDGET * (0.1 if number < 50 else 1.0 if choice.drop else 4.0)
    assert late[52] > 0, "fifty quick frames do not excuse slow ones"


def test_the_first_frame_may_take_its_time():
    controller, choices = _watched([0.5] * 20, first=0.99 * COLD * TOO_MUCH, count=5)
    assert not any(choice.drop for choice in choices)
    assert controller.account.sentence() == (
        "Real time at 10 frames a second: 5 of 5 frames computed, 0 dropped; 5 with full quality."
    )


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_that_is_none_is_refused(rate):
    with pytest.raises(ConfigurationError, match="--rate"):
        Controller(rate=rate, num_views=2)


def _climbed():
    """Return a controller that has just gone a rung up from the last one."""
    controller = _controller()
    _run(controller, [100 * BUDGET] * 4)
    last = len(controller.rungs) - 1
    assert controller.level == last
    _run(controller, [0.89 * BUDGET] + [0.45 * BUDGET] * CALM)
    assert controller.level == last - 1
    return controller, last


def test_a_frame_is_made_on_no_higher_rung_than_there_is_something_for():
    controller = _controller()
    assert controller.begin(0.0, highest=3).level == 3
    assert str(controller.begin(0.0, highest=3).rung) == str(controller.rungs[3])
    _run(controller, [100 * BUDGET] * 4)
    assert controller.begin(0.0, highest=3).level == controller.level > 3


@given(st.integers(1, 400))
def test_it_does_not_climb_by_frames_that_were_made_on_a_lower_rung(count):
    controller, last = _climbed()
    level = controller.level
    for _ in range(count):
        choice = controller.begin(0.0, highest=last)
        assert choice.level == last
        controller.end(choice, 0.05 * BUDGET)
    assert controller.level == level
    assert controller.account.frames_by_rung[str(controller.rungs[last])] >= count


def test_a_rung_up_is_taken_back_where_not_even_the_wait_for_it_fits():
    controller, last = _climbed()
    for _ in range(JUDGED):
        controller.end(controller.begin(0.0, highest=last), 1.2 * BUDGET)
    assert controller.level == last
    levels = _run(controller, [0.05 * BUDGET] * CALM)
    assert set(levels) == {last}, "and it waits longer for the next"
    assert controller.level == last
