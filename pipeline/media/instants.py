"""Pictures of several cameras, put together by when they were taken. No clock, no network.

The first camera sets the pace: each of its pictures makes an instant, with the picture of every
other camera that was taken nearest to it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

T = TypeVar("T")

KEPT = 32
"""Most pictures of a camera that wait for their instant."""

LATE = 1_000_000_000
"""An instant that could have been taken away for so long is left out, nanoseconds: who is too slow
for the cameras is never further behind them."""

FORGOTTEN = 10_000_000_000
"""How long the least delay of a picture is remembered, nanoseconds."""

JUMP = 1_000_000_000
"""Time stamps that jump by more than this, and not since so much time has gone by, begin the clock
anew, nanoseconds. Pictures that come so much later with stamps that go on were held up."""


class SteadyClock:
    """Tells when pictures were taken by when they came, without the network's jitter.

    A camera's own time stamps are steady, but count from anywhere; what came with the least delay
    of late says where from.

    Examples
    --------
    >>> clock = SteadyClock()
    >>> [clock.taken(stamp, came) for stamp, came in ((0, 70), (40, 150), (80, 155), (120, 190))]
    [70, 110, 150, 190]
    """

    def __init__(self) -> None:
        self._delays: deque[tuple[int, int]] = deque()
        """(when it came, delay), delays growing."""
        self._stamp = 0
        """The last one."""

    def taken(self, stamp: int, came: int) -> int:
        """Return when a picture was taken, give or take what is the same for all, nanoseconds.

        Parameters
        ----------
        stamp : int
            The camera's time stamp, nanoseconds.
        came : int
            When it came, nanoseconds of any clock.
        """
        delay = came - stamp
        delays = self._delays
        if delays and min(abs(stamp - self._stamp), abs(delay - delays[0][1])) > JUMP:
            delays.clear()
        self._stamp = stamp
        while delays and delays[-1][1] >= delay:
            delays.pop()
        delays.append((came, delay))
        while came - delays[0][0] > FORGOTTEN:
            delays.popleft()
        return stamp + delays[0][1]


@dataclass(frozen=True, kw_only=True)
class Instant(Generic[T]):
    """What the cameras saw at once."""

    taken: int
    """When the first camera's picture was taken, nanoseconds."""
    pictures: Mapping[str, T]
    """By camera; one that has none near enough is left out."""


@dataclass(frozen=True)
class _Waiting(Generic[T]):
    taken: int
    came: int
    picture: T


class Instants(Generic[T]):
    """Puts pictures together.

    Parameters
    ----------
    cameras : sequence of str
        Names; the first sets the pace.
    period : int
        Of the instants, nanoseconds: pictures of the first camera that come more often are left
        out.
    patience : int
        How long an instant waits for the others after its own picture came, nanoseconds.

    Attributes
    ----------
    left_out : int
        Instants that nobody took in time.
    """

    def __init__(self, cameras: Sequence[str], *, period: int, patience: int) -> None:
        self._first, *self._others = cameras
        self._period, self._patience = period, patience
        self._kept: dict[str, deque[_Waiting[T]]] = {
            camera: deque(maxlen=KEPT) for camera in cameras
        }
        self._due: int | None = None
        self.left_out = 0

    def add(self, camera: str, taken: int, came: int, picture: T) -> None:
        """Take a picture; those of one camera come in order."""
        if camera == self._first:
            if self._due is None or abs(taken - self._due) >= 2 * self._period:
                self._due = taken
            # an eighth early is on time: rates are seldom exact
            if taken < self._due - self._period // 8:
                return
            self._due += self._period
            self.left_out += len(self._kept[camera]) == KEPT
        self._kept[camera].append(_Waiting(taken, came, picture))

    def ready(self, now: int) -> Iterator[Instant[T]]:
        """Yield, in order, what need not wait any longer.

        Parameters
        ----------
        now : int
            By the clock of ``came``.
        """
        pace = self._kept[self._first]
        while pace and (self._is_whole(pace[0]) or now - pace[0].came >= self._patience):
            first = pace.popleft()
            if now - first.came > self._patience + LATE:
                self.left_out += 1
            else:
                yield self._instant(first)

    def _is_whole(self, first: _Waiting[T]) -> bool:
        """Tell whether every other camera has gone past the instant: nothing nearer will come."""
        return all(
            kept and kept[-1].taken >= first.taken
            for kept in (self._kept[camera] for camera in self._others)
        )

    def _instant(self, first: _Waiting[T]) -> Instant[T]:
        pictures = {self._first: first.picture}
        for camera in self._others:
            kept = self._kept[camera]
            while len(kept) > 1 and abs(kept[1].taken - first.taken) <= abs(
                kept[0].taken - first.taken
            ):
                kept.popleft()
            if kept and abs(kept[0].taken - first.taken) <= self._period // 2:
                pictures[camera] = kept[0].picture
        return Instant(taken=first.taken, pictures=pictures)
