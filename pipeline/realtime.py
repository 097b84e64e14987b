"""Holding a rate: what is left out of a frame so that the next one is begun in time.

:class:`Controller` is a state machine without a clock. Whoever has the frames tells it how late
each one is begun and what it cost, and does what it says::

    controller = Controller(rate=15.0, num_views=8)
    for frame in frames:                       # as they arrive
        choice = controller.begin(late)        # seconds since the frame was due
        if choice.drop:
            continue                           # show the last picture again
        targets = (left, right) if choice.both_eyes else (left,)
        begin = time.perf_counter()
        result = worker.take(frame, targets=targets, effort=choice.effort)
        ...                                    # an eye that is not made shows its last picture
        controller.end(choice, time.perf_counter() - begin)
    print(controller.account.sentence())

What a frame costs must include whatever it waits for behind it (a full queue to an encoder), and
not what it waits for before it (a camera). One controller belongs to one stream, as a
:class:`pipeline.worker.Worker` does. :func:`paced` does all of this for an iterator of frames.

The order in which quality goes is the ladder's (:func:`ladder`): first fewer steps of the solver,
then fewer views (those that stand farthest from the eyes), then registration every second and
every fourth frame, last the second eye every other frame. A rung down is taken as soon as frames
cost more than there is time for, several at once where it is much more; a rung up only after a
long calm, longer each time that it had to be taken back. A frame that would be begun too late is
dropped, and counted.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

from pipeline.effort import Effort
from pipeline.errors import ConfigurationError

Item = TypeVar("Item")

STEPS = (12, 8, 5, 3, 2)
"""Most steps of the solver, rung by rung."""

REGISTER_EVERY = (2, 4)
"""Frames from one registration to the next, rung by rung."""

JUDGED = 3
"""Frames whose median cost decides on a rung down: one slow frame alone does not. Where frames
had to be dropped, two slow ones in a row are enough."""

TOO_MUCH = 1.0
"""Share of the budget above which quality goes down."""

LITTLE = 0.75
"""Share of the budget below which a frame is calm."""

CALM, LONGEST_CALM = 16, 256
"""Calm frames in a row before quality goes up, at first and at most."""

TRIAL = 16
"""Frames within which a rung up that has to be taken back counts as a mistake."""

PATIENCE = 2.0
"""Frame times by which a frame may be late before it is dropped."""


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One step of the ladder: how much goes into a frame."""

    steps: int | None = None
    """Most steps of the solver; None: as many as it needs."""
    views: int | None = None
    """Views observed; None: all."""
    register_every: int = 1
    """Frames from one registration to the next."""
    second_eye_every: int = 1
    """Frames from one picture of the second eye to the next."""

    def __str__(self) -> str:
        parts = []
        if self.steps is not None:
            parts.append(f"{self.steps} steps")
        if self.views is not None:
            parts.append(f"{self.views} views")
        if self.register_every > 1:
            parts.append(f"registration every {self.register_every} frames")
        if self.second_eye_every > 1:
            parts.append("second eye at half rate")
        return ", ".join(parts) or "full quality"


def ladder(num_views: int, num_eyes: int = 2) -> tuple[Rung, ...]:
    """Return the rungs from full quality downwards, each with less than the one above it.

    >>> [str(rung) for rung in ladder(3)][-4:-2]
    ['2 steps, 2 views', '2 steps, 2 views, registration every 2 frames']
    """
    rungs = [Rung(), *(Rung(steps=steps) for steps in STEPS)]
    fewest = None
    for views in range(num_views - 1, num_eyes - 1, -1):
        fewest = views
        rungs.append(Rung(steps=STEPS[-1], views=views))
    for every in REGISTER_EVERY:
        rungs.append(Rung(steps=STEPS[-1], views=fewest, register_every=every))
    if num_eyes > 1:
        rungs.append(
            Rung(
                steps=STEPS[-1], views=fewest, register_every=REGISTER_EVERY[-1],
                second_eye_every=2,
            )
        )  # fmt: skip
    return tuple(rungs)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What is to be done with one frame."""

    drop: bool
    """Not computed at all: it would be begun too late."""
    level: int
    """Rung, 0 for full quality."""
    rung: Rung
    effort: Effort
    both_eyes: bool
    """False: the first eye only."""
    late: float
    """Seconds after its time."""


@dataclass(frozen=True, kw_only=True)
class Account:
    """What came of a stream so far."""

    rate: float
    """Frames a second to be held."""
    dropped: int
    frames_by_rung: Mapping[str, int]
    """Frames computed, by the rung's words, from full quality downwards."""

    def sentence(self) -> str:
        """Return the account in plain words."""
        computed = sum(self.frames_by_rung.values())
        said = (
            f"Real time at {self.rate:g} frames a second: {computed} of "
            f"{computed + self.dropped} frames computed, {self.dropped} dropped"
        )
        parts = [f"{count} with {rung}" for rung, count in self.frames_by_rung.items()]
        return f"{said}; {'; '.join(parts)}." if parts else f"{said}."


def account_of(rate: float, records: Iterable[tuple[bool, str]]) -> Account:
    """Return the account of frames, each (dropped, the rung's words), in any order."""
    dropped = 0
    counts: dict[str, int] = {}
    for was_dropped, words in records:
        if was_dropped:
            dropped += 1
        else:
            counts[words] = counts.get(words, 0) + 1
    return Account(rate=rate, dropped=dropped, frames_by_rung=counts)


@dataclass(kw_only=True)
class Controller:
    """Chooses, frame by frame, what to leave out; see the module.

    Parameters
    ----------
    rate : float
        Frames a second to be held.
    num_views : int
        Views of a frame.
    num_eyes : int
        Eyes that are made, 1 or 2.

    Raises
    ------
    ConfigurationError
        If the rate is not above 0.
    """

    rate: float
    num_views: int
    num_eyes: int = 2
    level: int = field(default=0, init=False)
    """Rung of the next frame."""
    dropped: int = field(default=0, init=False)
    _rungs: tuple[Rung, ...] = field(init=False)
    _frames: list[int] = field(init=False)
    _costs: list[float] = field(default_factory=list, init=False)
    _calm: int = field(default=0, init=False)
    _calm_needed: int = field(default=CALM, init=False)
    _since_up: int = field(default=TRIAL, init=False)
    _turn: int = field(default=0, init=False)
    _has_dropped: bool = field(default=False, init=False)
    """Since the last change of level."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ConfigurationError(f"--rate: must be above 0 frames a second, not {self.rate}")
        self._rungs = ladder(self.num_views, self.num_eyes)
        self._frames = [0] * len(self._rungs)

    @property
    def budget(self) -> float:
        """Seconds a frame may cost."""
        return 1.0 / self.rate

    @property
    def rungs(self) -> Sequence[Rung]:
        """The ladder, full quality first."""
        return self._rungs

    @property
    def account(self) -> Account:
        """What came of the stream so far."""
        pairs = zip(self._rungs, self._frames, strict=True)
        return Account(
            rate=self.rate,
            dropped=self.dropped,
            frames_by_rung={str(rung): count for rung, count in pairs if count},
        )

    def begin(self, late: float) -> Choice:
        """Choose what to do with the next frame.

        Parameters
        ----------
        late : float
            Seconds since it was due; 0 or less where it is in time.
        """
        drop = late > PATIENCE * self.budget
        rung = self._rungs[self.level]
        choice = Choice(
            drop=drop,
            level=self.level,
            rung=rung,
            effort=Effort(
                steps=rung.steps, views=rung.views,
                register=self._turn % rung.register_every == 0,
            ),
            both_eyes=self._turn % rung.second_eye_every == 0,
            late=late,
        )  # fmt: skip
        if drop:
            self.dropped += 1
            self._has_dropped = True
        else:
            self._turn += 1
        return choice

    def end(self, choice: Choice, seconds: float | None) -> None:
        """Learn what a frame cost that was not dropped.

        Parameters
        ----------
        seconds : float or None
            From its beginning until the next one could begin; None: counted, not judged.
        """
        self._frames[choice.level] += 1
        if seconds is None:
            return
        cost = seconds / self.budget
        self._since_up += 1
        self._costs = [*self._costs, cost][-JUDGED:]
        self._calm = self._calm + 1 if cost < LITTLE else 0
        load = self._load()
        if load > TOO_MUCH:
            self._down(load)
        elif self._calm >= self._calm_needed and self.level > 0:
            self._move(self.level - 1)
            self._since_up = 0

    def _load(self) -> float:
        """Return the share of the budget that frames take; 0 where it is too early to tell."""
        if len(self._costs) == JUDGED:
            return statistics.median(self._costs)
        return min(self._costs) if self._has_dropped and len(self._costs) > 1 else 0.0

    def _down(self, load: float) -> None:
        if self._since_up < TRIAL:
            self._calm_needed = min(2 * self._calm_needed, LONGEST_CALM)
        elif self._since_up > LONGEST_CALM:
            self._calm_needed = CALM
        self._move(min(self.level + 1 + int(3 * math.log2(load)), len(self._rungs) - 1))

    def _move(self, level: int) -> None:
        self.level, self._costs, self._calm, self._turn = level, [], 0, 0
        self._has_dropped = False


def paced(
    frames: Iterable[Item], controller: Controller, clock: Callable[[], float]
) -> Iterator[tuple[Item, Choice]]:
    """Yield frames with the choices of a controller, which learns what each of them cost.

    A frame costs the time until the next one is asked for. The time begins with the end of the
    first frame, which compiles, fills caches and starts cold. A frame that has to be waited for
    is not late, and time that is left over is not saved up.

    Parameters
    ----------
    clock : callable
        Seconds.
    """
    due: float | None = None
    asked = clock()
    for frame in frames:
        begin = clock()
        if due is not None:
            due += begin - asked
        choice = controller.begin(0.0 if due is None else begin - due)
        yield frame, choice
        asked = clock()
        if due is None:
            controller.end(choice, None)
            due = asked
            continue
        if not choice.drop:
            controller.end(choice, asked - begin)
        due = min(due + controller.budget, asked)
