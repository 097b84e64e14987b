"""Compile what a job needs in processes of its own, beside other work.

In one process numba compiles one kernel at a time; what it has compiled goes from process to
process through its cache on disk. So the two halves of the work are compiled side by side, each
by doing it for a small frame of noise.
"""

from __future__ import annotations

import gc
import multiprocessing
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import cv2
import numpy as np

from pipeline.compile_notice import compile_notice
from pipeline.config import Settings
from pipeline.frames import MultiViewFrame, View
from pipeline.superresolve import reconstruct_frame, register_frame
from pipeline.threads import thread_count

WIDTH, HEIGHT = 96, 72
"""Of the small frame, LR pixels: large enough for patches, pyramids and a PSF."""

LEFT, RIGHT = "left", "right"


def compile_registration() -> None:
    """Register a small frame."""
    register_frame(_frame(), Settings(threads=1), targets=(LEFT, RIGHT))


def compile_reconstruction() -> None:
    """Reconstruct a small frame from one view, and from one more that is made up."""
    alone = register_frame(_frame(), Settings(threads=1), targets=(LEFT,), observed_views=(LEFT,))
    own = alone.registrations[LEFT][0]
    other = replace(
        own.registered,
        view_id=RIGHT,
        observed=own.registered.observed.copy(),
        position=own.registered.position + np.float32(0.25),
        is_reference=False,
    )
    reconstruct_frame(alone)
    views = (LEFT, RIGHT)
    # either eye of the same two: what is compiled does not ask
    both = {view: [own, replace(own, registered=other)] for view in views}
    reconstruct_frame(replace(alone, targets=views, sources=views, near=views, registrations=both))


HALVES: tuple[Callable[[], None], ...] = (compile_registration, compile_reconstruction)


@contextmanager
def compiling_beside() -> Iterator[None]:
    """Compile the halves beside the body, from when it compiles something, and end with them.

    Where nothing is compiled, as all is known, or one thread is to do everything, nothing is
    started. While something is compiled no garbage is collected: see :func:`_alone`.
    """
    collecting = gc.isenabled()
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_alone, args=(half,), daemon=True) for half in HALVES]

    def start() -> None:
        gc.disable()
        if thread_count() > 1:
            for process in processes:
                process.start()

    try:
        with compile_notice(start):
            yield
        for process in processes:
            if process.pid is not None:
                process.join()
    finally:
        if collecting:
            gc.enable()
        for process in processes:
            if process.pid is not None:
                process.terminate()
                process.join()


def _alone(half: Callable[[], None]) -> None:
    """Compile a half, in a process of its own.

    A compiler makes much that lives as long as it does: to look through all that again and again
    for garbage takes a sixth of its time, and finds little.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who started this process ends it
    gc.disable()
    half()


def _frame() -> MultiViewFrame:
    """Return two views of noise in two depths."""
    noise = np.random.default_rng(0).normal(128, 300, (HEIGHT, WIDTH + 8)).astype(np.float32)
    texture = np.clip(cv2.GaussianBlur(noise, (0, 0), 1.5), 0, 255)
    depth = np.repeat(np.array([0.25, 0.75], np.float32), WIDTH // 2)[None].repeat(HEIGHT, axis=0)

    def view(name: str, shift: int) -> View:
        return View(
            view_id=name,
            luma=texture[:, shift : shift + WIDTH].copy(),
            chroma=np.zeros((HEIGHT, WIDTH, 2), np.float32),
            depth_map=depth.copy(),
        )

    return MultiViewFrame(
        frame_index=0, views=(view(LEFT, 0), view(RIGHT, 2)), left=LEFT, right=RIGHT
    )
