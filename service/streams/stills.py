"""What a stream makes for browsers only when somebody wants it.

Machines without I/O and without a clock. A wish is a word of the service: ``still`` is for one
picture; ``stills`` and ``before`` are for a lease, within which pictures follow the frames, and
whoever looks on renews it. Frames and wishes come, :class:`Stills` says whether a still is to be
made of the newest frame. Times are seconds.
"""

from __future__ import annotations

import math
from enum import StrEnum

STILL_INTERVAL = 0.2
"""Stills follow frames at most this often, seconds."""

LEASE = 3.0
"""How long pictures follow frames after the last word that they shall, seconds."""


class Wish(StrEnum):
    """What is wanted."""

    ONE = "still"
    """The newest picture, now."""
    MORE = "stills"
    """The newest picture, and those that follow."""
    BEFORE = "before"
    """The video of the observed pictures."""


class Lease:
    """Runs for a while; see the module."""

    def __init__(self) -> None:
        self._until = -math.inf

    def renew(self, now: float) -> None:
        """Let it run on."""
        self._until = now + LEASE

    def runs(self, now: float) -> bool:
        """Tell whether it has not run out."""
        return now < self._until


class Stills:
    """Says when; see the module.

    Examples
    --------
    >>> stills = Stills()
    >>> stills.come()
    >>> stills.is_due(0.0), stills.wish(Wish.ONE, 0.0), stills.wish(Wish.ONE, 0.0)
    (False, True, False)
    >>> stills.come()
    >>> stills.wish(Wish.MORE, 1.0), stills.is_due(1.0)
    (True, False)
    """

    def __init__(self) -> None:
        self._lease = Lease()
        self._made_at = -math.inf
        self._is_new = False

    def come(self) -> None:
        """There is a newer frame."""
        self._is_new = True

    def is_due(self, now: float) -> bool:
        """Tell whether the newest frame is to be shown to those who look on."""
        looked_at = self._lease.runs(now) and now - self._made_at >= STILL_INTERVAL
        return looked_at and self._made(now)

    def wish(self, wish: Wish, now: float) -> bool:
        """Tell whether the newest frame is to be shown; if not, it has been, or there is none."""
        if wish is Wish.ONE:
            return self._made(now)
        self._lease.renew(now)
        return self.is_due(now)

    def end(self, now: float) -> bool:
        """Tell whether the newest frame is to be shown, since none follows."""
        return self._made(now)

    def _made(self, now: float) -> bool:
        was_new, self._is_new = self._is_new, False
        if was_new:
            self._made_at = now
        return was_new
