"""A small ordered thread pool for the numeric rooms, whose kernels release the GIL.

Results come back in the order of the items whatever the number of threads, so
that sums over them are the same on every machine.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")

_state = threading.local()
_lock = threading.Lock()
_size = 0
_pool: ThreadPoolExecutor | None = None


def available_cores() -> int:
    """Return the number of cores this process may use, ≥ 1."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


def set_threads(threads: int) -> int:
    """Set the number of threads of the hot loops and of OpenCV; 0 means one a core.

    Returns
    -------
    int
        The number in use from now on, ≥ 1.
    """
    global _size, _pool
    wanted = threads if threads > 0 else available_cores()
    with _lock:
        if wanted != _size:
            if _pool is not None:
                _pool.shutdown(wait=False)
            _pool = None
            _size = wanted
    cv2.setNumThreads(wanted)
    return wanted


def thread_count() -> int:
    """Return the number of threads in use, ≥ 1."""
    return _size or set_threads(0)


def thread_pool() -> ThreadPoolExecutor:
    """Return the shared pool, made on first use."""
    global _pool
    count = thread_count()
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(max_workers=count, thread_name_prefix="depthsr")
        return _pool


def map_threads(
    function: Callable[[Item], Result], items: Iterable[Item], threads: int = 0
) -> list[Result]:
    """Apply the function to every item, several at a time; results in the order of the items.

    Parameters
    ----------
    function : callable
        Should spend its time where the GIL is released.
    items : iterable
        What to apply it to.
    threads : int
        Items in work at once; 0: as many as :func:`set_threads` said.

    Notes
    -----
    Called from inside such a function it runs serially, so that nesting can
    neither deadlock nor multiply threads. An exception is raised here, that
    of the first item in order; items not yet begun are dropped.
    """
    work = list(items)
    limit = min(threads or thread_count(), thread_count(), len(work))
    if limit <= 1 or getattr(_state, "inside", False):
        return [function(item) for item in work]

    def guarded(item: Item) -> Result:
        _state.inside = True
        try:
            return function(item)
        finally:
            _state.inside = False

    pool = thread_pool()
    if limit >= thread_count():
        futures = [pool.submit(guarded, item) for item in work]
        try:
            return [future.result() for future in futures]
        except BaseException:
            for future in futures:
                future.cancel()
            raise
    with ThreadPoolExecutor(max_workers=limit) as small:
        return list(small.map(guarded, work))
