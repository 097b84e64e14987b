from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import threading
from pathlib import Path

import cv2
import pytest
import threadpoolctl
from numba import njit
from numba.core import event

from pipeline.config import Settings
from pipeline.errors import Interrupted
from pipeline.machine import available_cores
from pipeline.superresolve import superresolve
from pipeline.synthetic import SampleScene
from pipeline.threads import (
    begin,
    map_threads,
    set_threads,
    stoppable,
    thread_count,
)
from tests.support.waiting import PATIENCE


@pytest.fixture(autouse=True)
def restore_threads():
    yield
    set_threads(0)


@pytest.mark.parametrize("threads", [1, 2, 5])
def test_results_come_in_the_order_of_the_items(threads):
    set_threads(threads)
    gates = [threading.Event() for _ in range(threads)]

    def last_first(number: int) -> int:
        """The first items of a batch end only after the last has begun."""
        gates[number % threads].set()
        gates[-1 if number < threads - 1 else number % threads].wait(5)
        return number * number

    assert map_threads(last_first, range(threads)) == [n * n for n in range(threads)]


def test_set_threads_reaches_opencv_and_zero_means_all():
    assert set_threads(3) == thread_count() == 3
    assert cv2.getNumThreads() == 3
    assert set_threads(0) == available_cores()


def test_linear_algebra_stays_on_one_thread():
    set_threads(3)
    counts = [p["num_threads"] for p in threadpoolctl.threadpool_info() if p["user_api"] == "blas"]
    assert counts
    assert set(counts) == {1}


def digest_of_a_frame() -> str:
    """Return the SHA-256 of a frame large enough for numpy to share out its sums."""
    frame = SampleScene(width=200, height=150, num_views=3).frame(noise_sigma=2.0)
    luma = superresolve(frame, Settings(), targets=(frame.left,)).images[frame.left].luma
    return hashlib.sha256(luma.tobytes()).hexdigest()


def test_how_many_threads_numpy_was_given_changes_no_bit():
    program = "from tests.pipeline.test_threads import digest_of_a_frame as d; print(d())"
    alone = subprocess.run(
        [sys.executable, "-c", program], check=True, timeout=PATIENCE, text=True,
        stdout=subprocess.PIPE, cwd=Path(__file__).parents[2],
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"},
    )  # fmt: skip
    assert alone.stdout.strip() == digest_of_a_frame()


def test_nested_use_neither_deadlocks_nor_multiplies():
    set_threads(2)
    names = set()

    def inner(number: int) -> int:
        names.add(threading.current_thread().name)
        return number

    result = map_threads(lambda n: sum(map_threads(inner, range(n))), range(8))
    assert result == [sum(range(n)) for n in range(8)]
    assert len(names) <= 2


def test_the_first_failure_is_raised():
    set_threads(2)

    def fail(number: int) -> int:
        if number >= 3:
            raise ValueError(f"item {number}")
        return number

    with pytest.raises(ValueError, match="item 3"):
        map_threads(fail, range(6))
    assert map_threads(fail, range(3)) == [0, 1, 2]


@pytest.mark.parametrize("threads", [1, 2])
def test_what_is_begun_is_given_where_it_is_asked_for_and_so_is_its_failure(threads):
    set_threads(threads)

    def fail():
        raise ValueError("begun in vain")

    wanted, failing = begin(lambda: map_threads(lambda n: n * n, range(5))), begin(fail)
    assert map_threads(lambda n: -n, range(3)) == [0, -1, -2]
    assert wanted() == [0, 1, 4, 9, 16]
    with pytest.raises(ValueError, match="begun in vain"):
        failing()


def test_what_no_thread_has_begun_is_done_by_who_asks_for_it():
    set_threads(2)
    has_begun, may_end, names = threading.Event(), threading.Event(), []

    def wait():
        has_begun.set()
        assert may_end.wait(PATIENCE)

    busy = begin(wait)
    assert has_begun.wait(PATIENCE)
    wanted = begin(lambda: names.append(threading.current_thread().name))
    assert map_threads(lambda n: n, range(4)) == [0, 1, 2, 3], "without the thread that is busy"
    wanted()
    may_end.set()
    busy()
    assert names == [threading.current_thread().name]


def test_what_is_begun_and_no_longer_wanted_is_not_done():
    set_threads(2)
    has_begun, may_end, done = threading.Event(), threading.Event(), []

    def wait():
        has_begun.set()
        assert may_end.wait(PATIENCE)

    with stoppable(may_end.is_set):
        busy = begin(wait)
        assert has_begun.wait(PATIENCE)
        wanted = begin(lambda: done.append(True))
        may_end.set()
        busy()
        # by one thread or the other
        with pytest.raises(Interrupted):
            map_threads(lambda _: wanted(), [0])
    assert not done


def test_a_limit_below_the_pool_is_kept():
    set_threads(4)
    running, most = [], []

    def busy(number: int) -> None:
        running.append(number)
        most.append(len(running))
        running.remove(number)

    map_threads(busy, range(40), threads=2)
    assert max(most) <= 2
    assert len(most) == 40


@pytest.mark.parametrize("threads", [1, 2])
def test_a_stop_ends_a_compilation_and_the_next_call_compiles(threads):
    """Compiled whole, kernels keep whoever has asked to stop waiting for many seconds."""
    set_threads(threads)
    stop, passes = threading.Event(), []

    class StopsAtThird(event.Listener):
        def on_start(self, event):
            passes.append(event.data["name"])
            if len(passes) == 3:
                stop.set()

        def on_end(self, event):
            pass

    @njit
    def kernel(number):
        return number + 1

    with event.install_listener("numba:run_pass", StopsAtThird()):
        with pytest.raises(Interrupted), stoppable(stop.is_set):
            map_threads(kernel, range(threads))
        assert len(passes) < 6
        stop.clear()
        with stoppable(stop.is_set):
            assert map_threads(kernel, range(2)) == [1, 2]


def test_what_is_not_asked_to_stop_compiles_beside_what_is():
    @njit
    def kernel(number):
        return number - 1

    found = []
    with stoppable(lambda: True):
        other = threading.Thread(target=lambda: found.append(kernel(3)))
        other.start()
        other.join()
    assert found == [2]
