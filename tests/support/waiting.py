"""Waiting for what comes about in other processes and threads."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
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
