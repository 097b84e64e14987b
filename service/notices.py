"""Wakes whoever waits in the event loop for news of a job, from any thread."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Notices:
    """Who waits for which job; ``stopping`` wakes everybody for the last time."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: dict[str, set[tuple[asyncio.AbstractEventLoop, asyncio.Event]]] = {}
        self.stopping = False

    @contextmanager
    def listen(self, job_id: str) -> Iterator[asyncio.Event]:
        """Yield an event that is set whenever the job has changed; clear it before looking."""
        item = (asyncio.get_running_loop(), asyncio.Event())
        with self._lock:
            self._waiting.setdefault(job_id, set()).add(item)
        try:
            yield item[1]
        finally:
            with self._lock:
                self._waiting[job_id].discard(item)
                if not self._waiting[job_id]:
                    del self._waiting[job_id]

    def tell(self, job_id: str) -> None:
        """Wake who waits for the job."""
        with self._lock:
            items = list(self._waiting.get(job_id, ()))
        _wake(items)

    def stop(self) -> None:
        """Wake everybody: the service ends. May be called from a signal handler."""
        self.stopping = True
        _wake([item for items in list(self._waiting.values()) for item in list(items)])


def _wake(items: list[tuple[asyncio.AbstractEventLoop, asyncio.Event]]) -> None:
    for loop, event in items:
        if not loop.is_closed():
            loop.call_soon_threadsafe(event.set)
