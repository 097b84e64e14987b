"""Compiling beside other work: it knows what a job needs, and leaves nobody behind."""

from __future__ import annotations

import functools
import gc
import multiprocessing
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest

from pipeline import compile_beside
from pipeline.compile_beside import compiling_beside
from pipeline.threads import set_threads

WHAT_A_JOB_COMPILES = """
import gc
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from pipeline.compile_beside import HALVES, LEFT, RIGHT, _frame
from pipeline.config import Settings
from pipeline.superresolve import superresolve

kernels = [
    kernel
    for kernel in gc.get_objects()
    if isinstance(kernel, Dispatcher) and kernel.__module__.startswith("pipeline.")
]

for half in HALVES:
    half()
known = [kernel.signatures for kernel in kernels]
superresolve(_frame(), Settings(), targets=(LEFT, RIGHT))
for kernel, before in zip(kernels, known, strict=True):
    name = kernel.__name__
    assert kernel.signatures == before, f"{name} is compiled for a job only"
    assert len(before) <= 1, f"{name} is compiled for {before}"
    if before:
        line = kernel.py_func.__code__.co_firstlineno
        kept = list(Path(kernel.stats.cache_path).glob(f"*.{name}-{line}.*.nbc"))
        assert kept
        assert not any(b"unicode" in path.read_bytes() for path in kept), (
            f"{name} makes up the text of an error"
        )
assert sum(map(len, known)) > 20
"""


@pytest.fixture
def two_threads():
    set_threads(2)
    yield
    set_threads(0)


def test_the_halves_compile_all_that_a_job_needs_and_each_kernel_once():
    """In a process of its own: other tests give kernels what no job does."""
    subprocess.run(
        [sys.executable, "-c", WHAT_A_JOB_COMPILES], check=True, timeout=900,
        cwd=Path(__file__).parents[2],
    )  # fmt: skip


def test_where_nothing_is_compiled_nothing_is_started(two_threads):
    with compiling_beside():
        assert multiprocessing.active_children() == []


def test_the_body_ends_with_what_is_compiled_beside_it(two_threads, monkeypatch, tmp_path):
    marks = [tmp_path / "one", tmp_path / "other"]
    halves = [functools.partial(Path.touch, mark) for mark in marks]
    monkeypatch.setattr(compile_beside, "HALVES", halves)
    with compiling_beside():
        numba.njit(lambda x: x)(1)
    assert all(mark.exists() for mark in marks)
    assert multiprocessing.active_children() == []


def test_garbage_is_collected_again_after_compiling(two_threads, monkeypatch):
    monkeypatch.setattr(compile_beside, "HALVES", [])
    with compiling_beside():
        assert gc.isenabled()
        numba.njit(lambda x: x)(1)
        assert not gc.isenabled()
    assert gc.isenabled()


def test_an_error_in_the_body_ends_what_is_compiled_beside_it(two_threads, monkeypatch):
    monkeypatch.setattr(compile_beside, "HALVES", [functools.partial(time.sleep, 600)])

    def body():
        with compiling_beside():
            numba.njit(lambda x: x)(1)
            assert len(multiprocessing.active_children()) == 1
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        body()
    assert multiprocessing.active_children() == []
    assert gc.isenabled()


def test_one_thread_is_not_helped():
    set_threads(1)
    try:
        with compiling_beside():
            numba.njit(lambda x: x)(1)
            assert multiprocessing.active_children() == []
    finally:
        set_threads(0)
