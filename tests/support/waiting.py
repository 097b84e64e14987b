"""Waiting for what comes about in other processes and threads."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

PATIENCE = 600.0
"""Seconds for anything: a busy machine may have to compile everything first. It costs nothing
where all goes well."""


def until(check: Callable[[], Any]) -> Any:
    """Wait until something is so, and return it."""
    deadline = time.monotonic() + PATIENCE
    pause = threading.Event()
    while not (found := check()):
        assert time.monotonic() < deadline, "it never came about"
        pause.wait(0.05)
    return found


@contextlib.contextmanager
def limited(end: Callable[[], object], within: float = PATIENCE) -> Iterator[None]:
    """Call what ends a wait that has no limit of its own, once it takes too long, seconds."""
    timer = threading.Timer(within, end)
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
