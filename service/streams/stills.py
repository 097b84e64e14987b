"""When a stream's newest picture is made a still for browsers: only when somebody wants it.

A machine without I/O and without a clock: frames and wishes come, :class:`Stills` says whether a
still is to be made of the newest frame. A wish is a word of the service: ``still`` is for one
picture, ``stills`` for a lease, within which they follow the frames; whoever looks on renews it.
Times are seconds.
"""

from __future__ import annotations

import math
from enum import StrEnum

STILL_INTERVAL = 0.2
"""Stills follow frames at most this often, seconds."""

LEASE = 3.0
"""How long they follow frames after the last word that they shall, seconds."""


class Wish(StrEnum):
    """What is wanted."""

    ONE = "still"
    """The newest picture, now."""
    MORE = "stills"
    """The newest picture, and those that follow."""


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
        self._until = self._made_at = -math.inf
        self._is_new = False

    def come(self) -> None:
        """There is a newer frame."""
        self._is_new = True

    def is_due(self, now: float) -> bool:
        """Tell whether the newest frame is to be shown to those who look on."""
        looked_at = now < self._until and now - self._made_at >= STILL_INTERVAL
        return looked_at and self._made(now)

    def wish(self, wish: Wish, now: float) -> bool:
        """Tell whether the newest frame is to be shown; if not, it has been, or there is none."""
        if wish is Wish.ONE:
            return self._made(now)
        self._until = now + LEASE
        return self.is_due(now)

    def end(self, now: float) -> bool:
        """Tell whether the newest frame is to be shown, since none follows."""
        return self._made(now)

    def _made(self, now: float) -> bool:
        was_new, self._is_new = self._is_new, False
        if was_new:
            self._made_at = now
        return was_new
