"""Threads that give way to others of this process: they run where a core is free.

Where a rate is held, reading and encoding go on beside the loops of the method, which all wait for
the slowest of them. A thread that gives way takes what these leave of the cores.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")

BEHIND = 10
"""By how much less urgent it is (``nice``): beside a thread of the method it gets a tenth of a
core; more, and beside another program's it would get next to none."""

LEAST = 19
"""That of what is least urgent."""


def give_way() -> None:
    """Let this thread, and those that it begins, give way to the others; it is not undone.

    Nothing happens where the system knows priorities of processes only.
    """
    if sys.platform == "linux":
        thread = threading.get_native_id()
        now = os.getpriority(os.PRIO_PROCESS, thread)
        os.setpriority(os.PRIO_PROCESS, thread, min(now + BEHIND, LEAST))


def giving_way(function: Callable[[], Result]) -> Result:
    """Return what a function does in a thread that gives way, as do those that it leaves behind."""
    with ThreadPoolExecutor(max_workers=1, initializer=give_way) as behind:
        return behind.submit(function).result()
