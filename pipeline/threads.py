"""A small ordered thread pool for the numeric rooms, whose kernels release the GIL.

Results come back in the order of the items whatever the number of threads, so
that sums over them are the same on every machine. For the same reason numpy's linear
algebra runs on one thread, always: how its sums are split depends on their number.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

import cv2
import threadpoolctl
from numba.core import event

from pipeline.errors import Interrupted
from pipeline.machine import available_cores, keep_memory

Item = TypeVar("Item")
Result = TypeVar("Result")

_state = threading.local()
_lock = threading.Lock()
_size = 0
_pool: ThreadPoolExecutor | None = None


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
            # who holds the old pool finishes with it; its threads end when nobody does
            _pool = None
            _size = wanted
            threadpoolctl.threadpool_limits(1, user_api="blas")
            keep_memory()
    cv2.setNumThreads(wanted)
    return wanted


def thread_count() -> int:
    """Return the number of threads in use, ≥ 1."""
    return _size or set_threads(0)


def thread_pool() -> ThreadPoolExecutor:
    """Return the shared pool, made on first use; who waits for it works, too."""
    global _pool
    count = thread_count()
    with _lock:
        if _pool is None:
            _pool = ThreadPoolExecutor(max_workers=max(1, count - 1), thread_name_prefix="depthsr")
        return _pool


@contextmanager
def stoppable(stop: Callable[[], bool] | None) -> Iterator[None]:
    """Let what this thread does end early, and what :func:`map_threads` does for it.

    ``stop`` is asked before each item of :func:`map_threads`, and before each pass of numba's
    where a kernel has to be compiled first, which takes seconds.

    Raises
    ------
    Interrupted
        Out of the body, once ``stop`` says so.
    """
    before = getattr(_state, "stop", None)
    _state.stop = stop or before
    try:
        with event.install_listener("numba:run_pass", _PassListener()):
            yield
    finally:
        _state.stop = before


class _PassListener(event.Listener):
    """Ends a compilation of a thread that is to stop."""

    def on_start(self, event: object) -> None:
        _check_stop()

    def on_end(self, event: object) -> None:
        """A pass that has ended is none to be left out."""


def _check_stop() -> None:
    """Raise Interrupted where what this thread does is no longer wanted."""
    stop = getattr(_state, "stop", None)
    if stop is not None and stop():
        raise Interrupted


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
        found = []
        for item in work:
            _check_stop()
            found.append(function(item))
        return found
    waiting = deque(enumerate(work))
    results: dict[int, Result] = {}
    failures: dict[int, BaseException] = {}
    stop = getattr(_state, "stop", None)

    def take() -> None:
        """Work on items, one after another, as long as there are any."""
        with _inside(stop):
            while waiting:
                try:
                    number, item = waiting.popleft()
                except IndexError:  # another thread was quicker
                    return
                try:
                    _check_stop()
                    results[number] = function(item)
                except BaseException as failure:
                    failures[number] = failure
                    waiting.clear()

    # this thread works, too: one thread less to wake, and none to wait for where it takes all
    takers = [thread_pool().submit(take) for _ in range(limit - 1)]
    try:
        take()
    finally:
        waiting.clear()
        for taker in takers:
            if not taker.cancel():
                taker.result()
    if failures:
        raise failures[min(failures)]
    return [results[number] for number in range(len(work))]


def begin(function: Callable[[], Result]) -> Callable[[], Result]:
    """Begin what is wanted later, where a thread has nothing else to do; return what gives it.

    To be asked once. Who asks before it was begun does it himself, as where there is one thread.

    Parameters
    ----------
    function : callable
        As for :func:`map_threads`; its failure is raised where it is asked for.
    """
    if thread_count() == 1 or getattr(_state, "inside", False):
        return function
    stop = getattr(_state, "stop", None)

    def work() -> Result:
        with _inside(stop):
            _check_stop()
            return function()

    begun = thread_pool().submit(work)

    def result() -> Result:
        return function() if begun.cancel() else begun.result()

    return result


@contextmanager
def _inside(stop: Callable[[], bool] | None) -> Iterator[None]:
    """Let this thread work for another one: nothing in it is split, and it stops as that does."""
    before = getattr(_state, "stop", None)
    _state.inside, _state.stop = True, stop
    try:
        yield
    finally:
        _state.inside, _state.stop = False, before


def shares(size: int) -> list[slice]:
    """Return so many rows in one part for each thread that :func:`map_threads` has here.

    For what is worked on row by row, so that nothing depends on how many parts there are.

    >>> set_threads(2), shares(5)
    (2, [slice(0, 2, None), slice(2, 5, None)])
    """
    count = 1 if getattr(_state, "inside", False) else max(1, min(thread_count(), size))
    return [slice(size * part // count, size * (part + 1) // count) for part in range(count)]
