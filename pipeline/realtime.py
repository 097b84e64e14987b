"""Holding a rate: what is left out of a frame so that the next one is begun in time.

:class:`Controller` is a state machine without a clock. Whoever has the frames tells it how late
each one is begun and what it cost, and does what it says::

    controller = Controller(rate=15.0, num_views=8)
    for frame in frames:                       # as they arrive
        choice = controller.begin(late)        # seconds since the frame was due
        if choice.drop:
            continue                           # show the last picture again
        begin = time.perf_counter()
        result = worker.take(frame, effort=choice.rung.effort)
        worked = time.perf_counter() - begin
        show(result)
        controller.end(choice, time.perf_counter() - begin, worked)
    print(controller.account.sentence())

What a frame costs must include whatever it waits for behind it (a full queue to an encoder), and
not what it waits for before it (a camera). What of it the worker took is what a rung decides on;
the rest is the same on every rung, and no reason to go farther down than helps. One controller
belongs to one stream, as a :class:`pipeline.worker.Worker` does. :func:`paced` does all of this for
an iterator of frames.

The order in which quality goes is the ladder's (:func:`ladder`): first fewer steps of the solver,
then the motions of each view found anew more seldom, then fewer views for what changes (those that
stand farthest from the eyes go first), then motions that are kept as they are, of one eye in turn,
which the other one follows, then each eye of itself alone where it changes, then nothing followed
that moves, then no view but the eyes, last nothing but where they change. As soon as frames cost
more than there is time for, the controller goes down to the rung whose frames, by what these cost
and by the work of either rung, have time enough: at once where the first frame of a rung costs a
multiple of its time. It goes up only after a calm: to the rung that should have time enough, or,
where a way up had to be taken back, to the next one, after a longer calm each time; until what that
rung takes is there, frames are made on the one below. Where nobody waits for a frame, time is used
to the full: a rung may cost a little too much, and whenever that has made a frame late, two are
made on one that catches up. A frame that would be begun too late is dropped, and counted.

Where a cut has left motions that are those of another picture, these are found anew between frames
(:func:`find_motions`), a few each time: those of one frame, all of which is read for that.
"""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, TypeVar

from pipeline.effort import FULL, SWIFT, Effort
from pipeline.errors import ConfigurationError

Item = TypeVar("Item")

STEPS = (3, 2)
"""Most steps of the solver, rung by rung."""

REGISTER_EVERY = (2, 4, 8)
"""Frames from one registration of a view to the next, rung by rung."""

VIEWS = (0.75, 0.5)
"""Shares of the views that are observed, rung by rung."""

BASE, PER_VIEW, PER_STEP = 0.22, 0.08, 0.035
"""Work of a frame: what is always done, what each view adds and what each step, of the work of a
frame of eight views; from processor times on the rendered rig."""

REGISTRATION = 0.7
"""Share of a view's work that is registration."""

CHANGED_ALONE, REFRESH_PER_VIEW = 0.083, 0.103
"""Work of a frame whose eyes are made of themselves alone where they change, and what each view
adds if all that stands still is refreshed."""

REFRESHED_SELDOM = 0.6
"""Share of that where an eye is alone or one of two has its turn: most of it has had it before."""

KEPT, KEPT_PER_VIEW, KEPT_PER_STEP = 0.062, 0.005, 0.005
"""What is added where what changes is made by kept motions, by each view that it is made of and by
each step."""

FOLLOWED = 0.055
"""What is added where what has changed is looked for in the frame before and the other eye."""

IN_TURN = 0.6
"""Share of what other views add where they are asked for one eye, in turn, and that is followed."""

LANDED_PER_VIEW = 0.015
"""What each view adds besides where that lands by its depth."""

READ_PER_VIEW, DEPTH_PER_VIEW = 0.004, 0.009
"""Work of reading a view, and its depth map, where views other than the eyes are looked at."""

ALONE = 0.07
"""The same of one whose eyes are made of themselves alone."""

BY_DEPTH_STEPS = 3
"""Steps where what changes lands by its depth and all views are too much."""

KEPT_STEPS = 2
"""Steps where motions are kept and all views are too much: a view costs less than a step, and gives
more."""

REFRESH_EVERY = 8
"""Frames within which what stands still is made again, low on the ladder."""

REFRESH_ALONE_EVERY = 16
"""The same where no view but the eyes is looked at."""

FULL_STEPS = 4
"""Steps of a warm frame at full quality, about."""

JUDGED = 3
"""Frames whose median cost decides on a rung down: one slow frame alone does not, nor does the
first one that a rung ever had, which loads its kernels. Where frames had to be dropped, two slow
ones in a row are enough."""

TOO_MUCH = 1.0
"""Share of the budget above which quality goes down."""

HARDLY_TOO_MUCH, JUDGED_LONGER = 1.15, 9
"""Share of the budget up to which so many frames decide: what they are late in all is less than
they may be, and a machine whose frames scatter by a tenth does not lose a rung to three of them."""

BARELY_TOO_MUCH, LATE = 1.05, 1.0
"""Share of the budget up to which a rung is kept for as long as its frames are not later than so
many frame times."""

FAR_TOO_MUCH = 2.0
"""The same for the first frame of a rung that was not climbed to; and what a frame counts for at
most where calm is judged: one does not say how others will be."""

FILLING = 0.03
"""Seconds of the first frame that a rung ever has in which caches are filled, about; kernels are
loaded in a rehearsal."""

AIM = 0.97
"""Share of the budget that a frame of the rung gone to should cost, at most."""

MIXED = 1.1
"""The same where two rungs are mixed."""

LEFT, LEFT_AT_ONCE = 1.25, 1.5
"""Share of the budget from which a rung is left then, by as many frames as are judged longest:
mixed with one that costs so much less, it loses more than the next one below it does; and the
share from which fewer decide, before frames are dropped."""

CATCHING_UP = 2
"""Frames that are made on a rung that catches up then, once one is later than ``LATE``: of two eyes
that have their turn, neither more often than the other."""

IN_A_ROW = 12
"""Frames in a row on such a rung after which the stream goes down to it; or further, once two of
them take more than their time."""

IN_VAIN = 0.05
"""Share of a frame's cost that going farther down must spare where no rung has time enough."""

COLD = 2.2
"""What the first frame of a stream costs, which starts cold, over what the next ones do: a hint,
measured after a rehearsal, so that no kernel is loaded in it."""

LITTLE = 0.75
"""Share of the budget below which there is calm, by the mean of so many frames as are judged
longest, since some of a stream cost more than others (one a second is a key frame); and so there
is where the rung above should cost no more than ``AIM``."""

CALM, LONGEST_CALM = 16, 256
"""Frames of calm before quality goes up, at first and at most."""

LONGEST_CALM_MIXED = 32
"""The latter where two rungs are mixed and the rung above should not be too much: one that is
takes no frame away, since another makes good for it."""

ANEW = 3
"""Frames of a picture that stands, but is another one than that whose motions are kept, until it is
begun to find these anew."""

SELDOM = 8
"""Frames after which one that ends in time is followed by a step of that, even if the next one is
later than ``LATE`` by it."""

GOES_ON = 96
"""Frames of a camera that moves up to which the time that is left where motions are missing is no
calm: of one that goes on none can be found, but frames may be registered if there is time."""

TRIAL = 16
"""Frames within which a rung up that has to be taken back counts as a mistake."""

PATIENCE = 2.0
"""Frame times by which a frame may be late before it is dropped."""


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One step of the ladder: how much goes into a frame."""

    effort: Effort = FULL

    def work(self, num_views: int) -> float:
        """Return about how much a frame of so many views costs, in no unit."""
        effort = self.effort
        if effort.refresh_every is None:
            return ALONE
        views = num_views if effort.views is None else effort.views
        steps = FULL_STEPS if effort.steps is None else effort.steps
        if not effort.registers:
            refresh = num_views * REFRESH_PER_VIEW / effort.refresh_every
            is_seldom = effort.alone or effort.in_turn
            work = CHANGED_ALONE + refresh * (REFRESHED_SELDOM if is_seldom else 1.0)
            if effort.alone:
                return work + FOLLOWED * effort.follow
            landed = LANDED_PER_VIEW if effort.by_depth else 0.0
            others = KEPT + views * (KEPT_PER_VIEW + landed) + steps * KEPT_PER_STEP
            return work + (IN_TURN * others + FOLLOWED if effort.in_turn else others)
        of_view = PER_VIEW * (1 - REGISTRATION + REGISTRATION / effort.register_every)
        return BASE + views * of_view + steps * PER_STEP

    def reading(self, num_views: int) -> float:
        """Return about how much it costs besides to read what the eyes are not, in that unit."""
        effort = self.effort
        views = num_views if effort.looks_around else 0
        deep = num_views if effort.registers or not effort.views else effort.views
        return views * READ_PER_VIEW + effort.needs_depth * deep * DEPTH_PER_VIEW

    @property
    def keeps_motions(self) -> bool:
        """Whether what was registered of earlier frames is used, and nothing is registered."""
        return not self.effort.registers and self.effort.refresh_every is not None

    def __str__(self) -> str:
        effort = self.effort
        if effort.alone:
            followed = ", followed" if effort.follow else ""
            if effort.looks_around:
                return f"what changes alone{followed}"
            kept = "" if effort.refresh_every is None else ", what stands still made again"
            return f"each eye alone{followed}{kept}"
        parts = []
        if effort.steps is not None:
            parts.append(f"{effort.steps} steps")
        if not effort.register:
            parts.append("what changes lands by its depth" if effort.by_depth else "motions kept")
        if effort.register_every > 1:
            parts.append(f"views registered every {effort.register_every} frames")
        if effort.views is not None:
            parts.append(f"{effort.views} views for what changes")
        if effort.in_turn:
            parts.append("of one eye in turn")
        return ", ".join(parts) or "full quality"


def ladder(num_views: int, num_eyes: int = 2, *, has_depth: bool = False) -> tuple[Rung, ...]:
    """Return the rungs from full quality downwards, each with less than the one above it.

    Where all views have depth maps, what changes lands by them, of all views and then of those
    nearest to the eyes, in place of views being registered more and more seldom and of motions
    kept, which cost more and give less.

    >>> for rung in ladder(8):
    ...     print(rung)
    full quality
    3 steps
    2 steps
    2 steps, views registered every 2 frames
    2 steps, views registered every 4 frames
    2 steps, views registered every 8 frames
    2 steps, views registered every 8 frames, 6 views for what changes
    2 steps, views registered every 8 frames, 4 views for what changes
    motions kept
    2 steps, motions kept, 6 views for what changes, of one eye in turn
    2 steps, motions kept, 4 views for what changes, of one eye in turn
    what changes alone, followed
    what changes alone
    each eye alone, what stands still made again
    each eye alone

    >>> for rung in ladder(8, has_depth=True)[2:7]:
    ...     print(rung)
    2 steps
    what changes lands by its depth
    3 steps, what changes lands by its depth, 6 views for what changes, of one eye in turn
    2 steps, motions kept, 6 views for what changes, of one eye in turn
    2 steps, motions kept, 4 views for what changes, of one eye in turn
    """
    efforts = [FULL, *(Effort(steps=steps) for steps in STEPS)]
    shares = (max(2, num_eyes, round(share * num_views)) for share in VIEWS)
    few = [count for count in dict.fromkeys(shares) if count < num_views]
    if num_views > 1 and has_depth:
        landed = replace(SWIFT, steps=BY_DEPTH_STEPS, in_turn=num_eyes > 1)
        efforts.append(SWIFT)
        efforts.append(replace(landed, views=few[0]) if few else landed)
    elif num_views > 1:
        efforts += [replace(efforts[-1], register_every=every) for every in REGISTER_EVERY]
        efforts += [replace(efforts[-1], views=views) for views in few]
        efforts.append(Effort(register=False))
    if num_views > 1:
        if num_eyes > 1:
            kept = Effort(
                register=False, steps=KEPT_STEPS, refresh_every=REFRESH_EVERY, in_turn=True
            )
            efforts += [replace(kept, views=views) for views in few if views > num_eyes]
        alone = Effort(alone=True, refresh_every=REFRESH_EVERY)
        efforts += [alone, replace(alone, follow=False)]
        efforts.append(
            replace(efforts[-1], refresh_every=REFRESH_ALONE_EVERY, others=False)
        )  # fmt: skip
    efforts.append(Effort(alone=True, refresh_every=None, follow=False))
    return tuple(Rung(effort=effort) for effort in efforts)


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What is to be done with one frame."""

    drop: bool
    """Not computed at all: it would be begun too late."""
    level: int
    """Rung, 0 for full quality."""
    rung: Rung
    late: float
    """Seconds after its time."""
    waited: float = 0.0
    """Seconds that were waited for it beyond its time: what it comes from is too slow."""
    catches_up: bool = False
    """Whether it is made on a lower rung than the stream is on, since the last ones cost more than
    their time."""
    begins_anew: bool = False
    """Whether motions are missing, and are found anew of this frame: all of it is to be read."""


@dataclass(frozen=True, kw_only=True)
class Account:
    """What came of a stream so far."""

    rate: float
    """Frames a second to be held."""
    dropped: int
    frames_by_rung: Mapping[str, int]
    """Frames computed, by the rung's words, from full quality downwards."""
    waited: float = 0.0
    """Seconds that were waited for frames beyond their time, in all."""

    def sentence(self) -> str:
        """Return the account in plain words."""
        computed = sum(self.frames_by_rung.values())
        said = (
            f"Real time at {self.rate:g} frames a second: {computed} of "
            f"{computed + self.dropped} frames computed, {self.dropped} dropped"
        )
        parts = [f"{count} with {rung}" for rung, count in self.frames_by_rung.items()]
        if self.waited * self.rate > 1:
            parts.append(f"the input came {self.waited:.1f} s too late in all")
        return f"{said}; {'; '.join(parts)}." if parts else f"{said}."


def account_of(rate: float, records: Iterable[tuple[bool, str]], waited: float = 0.0) -> Account:
    """Return the account of frames, each (dropped, the rung's words), in any order."""
    dropped = 0
    counts: dict[str, int] = {}
    for was_dropped, words in records:
        if was_dropped:
            dropped += 1
        else:
            counts[words] = counts.get(words, 0) + 1
    return Account(rate=rate, dropped=dropped, frames_by_rung=counts, waited=waited)


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
    has_depth : bool
        Whether all views have depth maps.
    mixes : bool
        Whether frames may be late by ``LATE`` and more, so that two rungs can share the time;
        False: somebody waits for each.

    Raises
    ------
    ConfigurationError
        If the rate is not above 0.
    """

    rate: float
    num_views: int
    num_eyes: int = 2
    has_depth: bool = False
    mixes: bool = False
    level: int = field(default=0, init=False)
    """Rung of the next frame."""
    lacks_motions: bool = field(default=False, init=False)
    """Whether the picture has been another one since motions were found, by the last frame; told by
    whoever has the frames."""
    stands: bool = field(default=False, init=False)
    """Whether that picture stands, and motions of it can be found; told likewise."""
    finds_motions: bool = field(default=False, init=False)
    """Whether they are being found anew; told likewise."""
    dropped: int = field(default=0, init=False)
    _rungs: tuple[Rung, ...] = field(init=False)
    _frames: list[int] = field(init=False)
    _costs: list[float] = field(default_factory=list, init=False)
    """Shares of the budget that the last frames took, all of the rung ``_made``."""
    _made: int = field(default=0, init=False)
    _beside: list[float] = field(default_factory=list, init=False)
    """Likewise, what they took beside the work of the rung."""
    _latest: tuple[int, float] | None = field(default=None, init=False)
    """Rung of the last frame and what it took of the budget, beside caches that it filled."""
    _standing: int = field(default=0, init=False)
    """Frames in a row that were made without motions that their rung keeps, most of whose picture
    stood."""
    _moving: int = field(default=0, init=False)
    """The same where it did not."""
    _unfound: int = field(default=0, init=False)
    """Frames since the last step by which they are found."""
    _step: float = field(default=0.0, init=False)
    """Seconds of the longest of these steps since it was begun."""
    _calm: int = field(default=0, init=False)
    _calm_needed: int = field(default=CALM, init=False)
    _since_up: int = field(default=TRIAL, init=False)
    _late: float = field(default=0.0, init=False)
    """Frame times by which the last frame was begun too late."""
    _has_dropped: bool = field(default=False, init=False)
    """Since the last change of level."""
    _has_climbed: bool = field(default=False, init=False)
    """Whether the last change of level was a rung up."""
    _catching_up: int = field(default=0, init=False)
    """Frames that are still to be made on a rung that catches up."""
    _in_a_row: int = field(default=0, init=False)
    """Frames that have been made on it since the last one that was not."""
    _in_vain: int = field(default=0, init=False)
    """How many of the last of these took more than their time."""
    _guesses: int = field(default=1, init=False)
    """How many frames that fit into their time are still to tell what frames cost."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.rate) and self.rate > 0):
            raise ConfigurationError(f"--rate: must be above 0 frames a second, not {self.rate}")
        self._rungs = ladder(self.num_views, self.num_eyes, has_depth=self.has_depth)
        self._frames = [0] * len(self._rungs)
        if self.mixes:
            self._guesses = JUDGED

    @property
    def budget(self) -> float:
        """Seconds a frame may cost."""
        return 1.0 / self.rate

    @property
    def rung(self) -> Rung:
        """That of the next frame."""
        return self._rungs[self.level]

    @property
    def level_to_read_for(self) -> int:
        """Number of the rung that has what the next frame may need: the first to begin anew."""
        begins = self.lacks_motions and self._standing >= ANEW and not self.finds_motions
        return 0 if begins else self.level

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

    def begin(self, late: float, highest: int = 0) -> Choice:
        """Choose what to do with the next frame.

        Parameters
        ----------
        late : float
            Seconds since it was due; 0 or less where it is in time.
        highest : int
            Number of the highest rung for which all that it takes is there.
        """
        drop = late > PATIENCE * self.budget
        if drop:
            self.dropped += 1
            self._has_dropped = True
        begins_anew = self.level_to_read_for < self.level and highest == 0 and not drop
        if self.mixes and late > LATE * self.budget and not self._catching_up:
            self._catching_up = CATCHING_UP
        own = max(self.level, highest)
        level = own
        if self._catching_up and not drop:
            self._catching_up -= 1
            level = max(own, self._level_that_catches_up())
        return Choice(
            drop=drop, level=level, rung=self._rungs[level], late=late, catches_up=level > own,
            begins_anew=begins_anew,
        )  # fmt: skip

    def end(self, choice: Choice, seconds: float, worked: float | None = None) -> None:
        """Learn what a frame cost that was not dropped.

        The first one fills caches and starts cold: it says no more than where to begin, and the
        first frames that fit into their time put that right.

        Parameters
        ----------
        seconds : float
            From its beginning until the next one could begin.
        worked : float, optional
            Those of them that the worker took; of the others the rung decides on the reading alone.
            Default: it decides on all.
        """
        if choice.begins_anew:
            self._standing, self._unfound, self._step = 0, 0, 0.0
            self._frames[choice.level] += 1
            return  # more of it was read than of others
        is_lacking = self.lacks_motions and choice.rung.keeps_motions
        self._standing = self._standing + 1 if is_lacking and self.stands else 0
        self._moving = self._moving + 1 if is_lacking and not self.stands else 0
        filling = FILLING if not self._frames[choice.level] else 0.0
        self._latest = (choice.level, (seconds - filling) / self.budget)
        if choice.catches_up:
            self._end_of_one_that_catches_up(*self._latest)
            return
        self._in_a_row = self._in_vain = 0
        if choice.level != self._made:
            self._costs, self._beside, self._made = [], [], choice.level
        if worked is not None:
            beside = max(0.0, seconds - worked) / self.budget
            self._beside = [*self._beside, beside][-JUDGED_LONGER:]
        is_first = not any(self._frames)
        self._frames[choice.level] += 1
        self._late = choice.late / self.budget
        cost = seconds / self.budget
        if is_first:
            if cost / COLD > TOO_MUCH:
                self._move(self._level_for(cost / COLD, self.level, self.level))
            return
        # the first frame of all on a rung fills its caches
        earlier = self._costs if self._frames[choice.level] > 2 else []
        self._costs = [*earlier, cost][-JUDGED_LONGER:]
        if choice.level > self.level:
            if self._load() > TOO_MUCH:
                self._down(self._load(), choice.level)
            return
        self._since_up += 1
        mean = statistics.fmean(min(cost, FAR_TOO_MUCH) for cost in self._costs)
        is_calm = mean < LITTLE or self._above(mean) <= self._aim
        is_calm &= not is_lacking or self._moving > GOES_ON
        self._calm = self._calm + 1 if is_calm else 0
        load = self._load()
        tells = cost <= TOO_MUCH and self._guesses > 0
        self._guesses -= tells
        if tells and self._level_for(cost, self.level, 0) < self.level:
            self._move(self._level_for(cost, self.level, 0), climbs=True)
        elif load > TOO_MUCH:
            self._down(load, self.level)
        elif self.level > 0 and self._calm >= self._calm_before_up(mean):
            self._move(self._higher(mean), climbs=True)
            self._since_up = 0

    def look_at(self, finder: Finder) -> None:
        """Be told of motions that are missing; before each :meth:`end`."""
        self.lacks_motions = finder.lacks_motions
        self.stands = finder.stands
        self.finds_motions = finder.finds_motions

    def may_find(self, left: float) -> bool:
        """Return whether some motions may be found anew before the next frame is begun.

        Parameters
        ----------
        left : float
            Seconds until that is due; to be asked after each frame that was made.
        """
        self._unfound += 1
        is_due = self._unfound >= SELDOM and left >= 0
        return is_due or self._step - left <= LATE * self.budget

    def may_find_more(self, left: float) -> bool:
        """Return whether another step is likely to end before the next frame is due.

        Parameters
        ----------
        left : float
            Seconds until then.
        """
        return self._step <= left

    def has_found(self, seconds: float) -> None:
        """Learn what a step of finding them took."""
        self._unfound, self._step = 0, max(self._step, seconds)

    def _end_of_one_that_catches_up(self, level: int, cost: float) -> None:
        self._frames[level] += 1
        self._since_up += 1
        self._in_a_row += 1
        self._in_vain = self._in_vain + 1 if cost > TOO_MUCH else 0
        if self._in_vain >= CATCHING_UP or self._in_a_row >= IN_A_ROW:
            self._down(cost, level)

    def _load(self) -> float:
        """Return the share of the budget that frames take; 0 where it is too early to tell."""
        if len(self._costs) >= JUDGED:
            load = statistics.median(self._costs[-JUDGED:])
            at_once = LEFT_AT_ONCE if self.mixes else HARDLY_TOO_MUCH
            if self._has_dropped or not TOO_MUCH < load <= at_once:
                return load
            longer = statistics.median(self._costs)
            most = LEFT if self.mixes else BARELY_TOO_MUCH
            is_kept = longer <= most and (self.mixes or self._late <= LATE)
            is_told = len(self._costs) == JUDGED_LONGER and not is_kept
            return longer if is_told else TOO_MUCH
        if len(self._costs) == 1 and not self._has_climbed:
            is_new = self._frames[self._made] == 1
            lasting = self._costs[0] - FILLING / self.budget * is_new
            return lasting if lasting > FAR_TOO_MUCH else 0.0
        return min(self._costs) if self._has_dropped and len(self._costs) > 1 else 0.0

    def _down(self, load: float, level: int) -> None:
        """Go down from a rung on which frames take so much of the budget."""
        if self._since_up < TRIAL:
            longest = LONGEST_CALM_MIXED if self.mixes else LONGEST_CALM
            self._calm_needed = min(2 * self._calm_needed, longest)
        elif self._since_up > LONGEST_CALM:
            self._calm_needed = CALM
        # not below one that would not be left
        most = LEFT if self._is_mixing else AIM
        self._move(self._level_for(load, level, level, most))

    def _level_for(self, load: float, level: int, highest: int, most: float | None = None) -> int:
        """Return the first rung from ``highest`` whose frames have time enough.

        Where none has, the first that costs hardly more than the last one.

        Parameters
        ----------
        load : float
            Share of the budget that frames take at the rung ``level``.
        most : float, optional
            That which they may take; default: as for a rung gone up to.
        """
        costs = self._expected(load, level)
        bound = max(most or self._aim, (1 + IN_VAIN) * costs[-1])
        return next(level for level in range(highest, len(costs)) if costs[level] <= bound)

    @property
    def _is_mixing(self) -> bool:
        """Whether a rung may cost a little too much: not once that has cost a frame."""
        return self.mixes and not self._has_dropped

    @property
    def _aim(self) -> float:
        """Share of the budget that a frame of a rung gone up to should cost, at most."""
        return MIXED if self._is_mixing else AIM

    def _level_that_catches_up(self) -> int:
        """Return the next rung whose frames should leave time over; this one, if not known.

        By what frames took, and by what the last one did: others of the machine may have begun.
        """
        told = [] if self._latest is None else [self._latest]
        if self._costs:
            told.append((self._made, statistics.median(self._costs[-JUDGED:])))
        expected = [self._expected(cost, level) for level, cost in told]
        levels = range(self.level, len(self._rungs))
        fitting = (
            level for level in levels if all(costs[level] <= AIM for costs in expected)
        )  # fmt: skip
        return next(fitting, levels[-1])

    def _expected(self, load: float, level: int) -> list[float]:
        """Return the share of the budget that frames should take on each rung."""
        works = [rung.work(self.num_views) for rung in self._rungs]
        readings = [rung.reading(self.num_views) for rung in self._rungs]
        if not self._beside:
            of_one = load / (works[level] + readings[level])
            return [of_one * sum(both) for both in zip(works, readings, strict=True)]
        beside = min(load, statistics.median(self._beside[-JUDGED:]))
        of_one = (load - beside) / works[level]
        rest = beside - of_one * readings[level]
        return [
            of_one * work + max(0.0, rest + of_one * reading)
            for work, reading in zip(works, readings, strict=True)
        ]

    def _above(self, load: float) -> float:
        """Return the share of the budget that frames should take on the rung above."""
        return self._expected(load, self.level)[max(0, self.level - 1)]

    def _calm_before_up(self, load: float) -> int:
        """Return how many calm frames are asked for: most where a rung up should be too much."""
        return LONGEST_CALM if self._above(load) > max(TOO_MUCH, self._aim) else self._calm_needed

    def _higher(self, load: float) -> int:
        """Return the rung to go up to: the next one, or the highest that should have time enough.

        The next one where a way up had to be taken back: what rungs should cost is wrong here.
        """
        if self._calm_needed > CALM:
            return self.level - 1
        return min(self.level - 1, self._level_for(load, self.level, 0))

    def _move(self, level: int, *, climbs: bool = False) -> None:
        self.level, self._costs, self._calm = level, [], 0
        self._has_dropped, self._has_climbed = False, climbs
        self._catching_up = self._in_a_row = self._in_vain = 0


class Finder(Protocol):
    """What finds motions anew: a :class:`pipeline.worker.Worker`."""

    @property
    def lacks_motions(self) -> bool:
        """Whether motions are missing."""

    @property
    def stands(self) -> bool:
        """Whether the picture is one whose motions can be found."""

    @property
    def finds_motions(self) -> bool:
        """Whether they are being found."""

    def find_more(self) -> None:
        """Find some of them."""


def find_motions(
    finder: Finder, controller: Controller, left: float, clock: Callable[[], float]
) -> None:
    """Find some motions anew after a frame, if any are missing and there is time.

    Further steps follow as long as each should end before the next frame is due.

    Parameters
    ----------
    left : float
        Seconds until the next frame is due.
    clock : callable
        Seconds.
    """
    if finder.finds_motions and controller.may_find(left):
        end = clock()
        due = end + left
        while True:
            begin = end
            finder.find_more()
            end = clock()
            controller.has_found(end - begin)
            if not (finder.finds_motions and controller.may_find_more(due - end)):
                break
    controller.look_at(finder)


def paced(
    frames: Iterable[Item],
    controller: Controller,
    clock: Callable[[], float],
    worked: Callable[[], float | None] = lambda: None,
    highest: Callable[[Item], int] = lambda _: 0,
    between: Callable[[float], None] = lambda _: None,
) -> Iterator[tuple[Item, Choice]]:
    """Yield frames with the choices of a controller, which learns what each of them cost.

    A frame costs the time until the next one is asked for. The time begins with the end of the
    first frame. A frame that has to be waited for is not late, but the choice says how long that
    was beyond its time; time that is left over is not saved up.

    Parameters
    ----------
    clock : callable
        Seconds.
    worked : callable
        Asked after each frame that is not dropped: see :meth:`Controller.end`.
    highest : callable
        Asked before each frame: see :meth:`Controller.begin`.
    between : callable
        Called after each frame that is not dropped with the seconds until the next one is due. What
        it takes is no cost of the frame, but may make the next one late.
    """
    due: float | None = None
    asked, spare = clock(), math.inf
    for frame in frames:
        begin = clock()
        if due is not None:
            due += begin - asked
        choice = controller.begin(0.0 if due is None else begin - due, highest(frame))
        choice = replace(choice, waited=max(0.0, begin - asked - spare))
        yield frame, choice
        asked = clock()
        if not choice.drop:
            controller.end(choice, asked - begin, worked())
            between(0.0 if due is None else due + controller.budget - asked)
            asked = clock()
        spare = 0.0 if due is None else max(0.0, due + controller.budget - asked)
        due = asked if due is None else min(due + controller.budget, asked)
