"""How a running job is asked to stop: a flag that the work polls between its steps.

Whoever wants to stop the work (a signal handler, another thread, the service)
sets the flag. Long computations of the main thread can allow a signal handler
to break them off instead of waiting for the next poll.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from pipeline.errors import Interrupted


class StopFlag:
    """A flag that stays set once it is set."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self._may_break_off = False

    def set(self) -> None:
        """Ask the work to stop; returns at once."""
        self._event.set()

    @property
    def is_set(self) -> bool:
        """True once somebody has asked."""
        return self._event.is_set()

    def check(self) -> None:
        """Raise :class:`Interrupted` if the work was asked to stop."""
        if self.is_set:
            raise Interrupted

    @contextmanager
    def breakable(self) -> Iterator[None]:
        """Mark a stretch of pure computation in the main thread that may be broken off."""
        self.check()
        self._may_break_off = True
        try:
            yield
        finally:
            self._may_break_off = False
        self.check()

    def from_signal(self, *_: object) -> None:
        """Handle a signal: set the flag, and break off what may be broken off.

        Python runs signal handlers in the main thread, so that raising here
        leaves the computation that runs there.
        """
        self._event.set()
        if self._may_break_off:
            self._may_break_off = False
            raise Interrupted
