"""The controller over long streams: frames that scatter, cuts, late depth, others at work."""

from __future__ import annotations

import itertools
import math
import random
from dataclasses import dataclass

import pytest

from pipeline.realtime import LONGEST_CALM_MIXED, Choice, Controller, paced

WORK = (250.0, 246.0, 240.0, 104.0, 82.0, 61.5, 57.0, 43.0, 34.5, 27.0, 16.0)
"""Milliseconds of the method by rung, eight views of the rig with depth, two cores."""

BESIDE = 2.0
"""Milliseconds of a frame beside that."""

FIRST = 600.0
"""The same of the first frame."""

DEEP = 4
"""Last rung that looks at depth."""

KEY_FRAMES = 12
"""Frames from one to the next of depth maps, which are taken up again at these alone."""

CUTS = 48
"""Frames from one cut to the next."""

FRAMES = 1000


@dataclass(kw_only=True)
class Machine:
    """What frames cost: the times of a machine that other programs use now and then."""

    slow: float = 1.0
    """By how much slower than the one that was measured."""
    bursts: float = 0.0
    """How often frames begin to be slowed down, by others, for a while; a share."""
    seed: int = 0
    now: float = 0.0
    """Seconds on its clock."""
    worked: float = 0.0
    """Seconds that the method took of the last frame."""

    def __post_init__(self) -> None:
        self._random = random.Random(self.seed)
        self._seen: set[int] = set()
        self._deviation = self._drift = 0.0
        self._burst, self._busy = 0, 1.0
        self._depth_from: int | None = None

    def clock(self) -> float:
        """Return the time."""
        return self.now

    def highest(self, number: int, level: int) -> int:
        """Return the highest rung for which there is depth where the stream is on that level."""
        if level > DEEP:
            self._depth_from = None
            return level
        if self._depth_from is None:
            self._depth_from = -(-number // KEY_FRAMES) * KEY_FRAMES
        return level if number >= self._depth_from else max(level, DEEP + 1)

    def take(self, number: int, choice: Choice) -> None:
        """Let the clock go on by what a frame costs."""
        uniform, normal = self._random.random, self._random.gauss
        if self._burst:
            self._burst -= 1
        elif uniform() < self.bursts:
            self._burst, self._busy = self._random.randint(8, 60), 1.15 + 0.45 * uniform()
        self._deviation = 0.35 * self._deviation + 0.937 * normal(0, 1)
        self._drift = 0.95 * self._drift + 0.02 * normal(0, 1)
        factor = self.slow * math.exp(0.1 * self._deviation + self._drift)
        factor *= self._busy if self._burst else 1.0
        work = FIRST * self.slow if number == 0 else WORK[choice.level] * factor
        work += max(normal(0, 3), -0.3 * work)
        if number >= CUTS and number % CUTS < 3:
            work *= 1.25
        if uniform() < 0.01:
            work *= 1.5
        if choice.level not in self._seen:
            self._seen.add(choice.level)
            work += 30.0  # its caches are filled
        self.worked = work / 1000
        beside = (BESIDE + 8.0 * (number % 32 == 31)) * factor
        self.now += (work + beside) / 1000

    def watched(self, rate: float, count: int = FRAMES) -> list[Choice]:
        """Return the choices of a recording that is held to a rate."""
        controller = Controller(rate=rate, num_views=8, has_depth=True, mixes=True)
        assert len(controller.rungs) == len(WORK)
        choices = []
        frames = paced(
            range(count), controller, self.clock, lambda: self.worked,
            lambda number: self.highest(number, controller.level),
        )  # fmt: skip
        for number, choice in frames:
            choices.append(choice)
            if not choice.drop:
                self.take(number, choice)
        return choices

    def best(self, rate: float) -> int:
        """Return the first rung that has time enough in the mean; the last one, if none has."""
        times = [self.slow * (work + BESIDE) for work in WORK]
        fitting = (level for level, time in enumerate(times) if time <= 1000 / rate)
        return next(fitting, len(WORK) - 1)


def _changes(choices):
    """Return how often the rung of the stream changes, but for frames that catch up."""
    levels = [choice.level for choice in choices if not (choice.drop or choice.catches_up)]
    return sum(here != there for here, there in itertools.pairwise(levels))


def _share(choices, best):
    """Return the share of frames that are made on that rung or a better one."""
    return sum(not choice.drop and choice.level <= best for choice in choices) / len(choices)


@pytest.mark.parametrize("slow", [0.9, 1.0, 1.1, 1.2])
@pytest.mark.parametrize("rate", [6, 8, 12, 15])
def test_a_long_stream_with_cuts_keeps_the_rung_that_it_has_time_for(rate, slow):
    machine = Machine(slow=slow)
    choices = machine.watched(rate)
    # one in a hundred takes half as much again: when others have just made it late, it is too much
    assert sum(choice.drop for choice in choices) <= 1
    assert _share(choices, machine.best(rate)) > 0.75
    assert _changes(choices) <= 20 * FRAMES / 1000, "it does not swing"


@pytest.mark.parametrize("slow", [0.9, 1.0, 1.1, 1.2])
@pytest.mark.parametrize("seed", range(2))
def test_other_programs_now_and_then_cost_no_frame_and_no_quality_for_long(slow, seed):
    machine = Machine(slow=slow, bursts=0.005, seed=seed)
    choices = machine.watched(15)
    assert sum(choice.drop for choice in choices) <= 1
    # of the frames a seventh are slowed down, by 1.4 in the mean
    assert _share(choices, machine.best(15)) > 0.55
    assert _changes(choices) <= 20 * FRAMES / 1000


@pytest.mark.parametrize("rate", [8, 12, 15])
def test_what_was_lost_to_a_busy_hour_is_come_back_to(rate):
    """At once, or a rung at a time, each after a calm that has a bound."""
    machine = Machine()
    usual = machine.watched(rate)
    again = Machine(seed=1)
    take, busy, count = again.take, range(600, 700), 100

    def slowed(number, choice):
        again.slow = 1.8 if number in busy else 1.0
        take(number, choice)

    again.take = slowed
    choices = again.watched(rate)
    assert _share(choices[: busy.start], again.best(rate)) > 0.8
    later = choices[busy.stop + 3 * LONGEST_CALM_MIXED :]
    assert _share(later, again.best(rate)) > 0.9 * _share(usual, again.best(rate))
    assert sum(choice.drop for choice in choices[: busy.start]) == 0
    assert sum(choice.drop for choice in choices) < 0.05 * count


@pytest.mark.parametrize("slow", [2.5, 3.0])
def test_a_machine_that_has_time_for_the_last_rungs_alone_settles_there(slow):
    machine = Machine(slow=slow)
    choices = machine.watched(15)
    settled = choices[50:]
    assert not any(choice.drop for choice in settled)
    assert {choice.level for choice in settled} <= set(range(machine.best(15) - 1, len(WORK)))
    assert _share(settled, machine.best(15)) > 0.7
    assert _changes(settled) <= 25 * FRAMES / 1000


def test_a_machine_that_is_too_slow_for_every_rung_stays_on_the_last_one():
    machine = Machine(slow=6.0)
    choices = machine.watched(15)
    made = [choice for choice in choices[50:] if not choice.drop]
    assert {choice.level for choice in made} == {len(WORK) - 1}
    # all of its time is used for frames
    assert len(made) / len(choices[50:]) == pytest.approx(
        1000 / 15 / (6 * (WORK[-1] + BESIDE)), abs=0.05
    )
