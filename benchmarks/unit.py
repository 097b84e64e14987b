"""The unit in which times are told: what plain enlargement of the same stereo pair takes.

OpenCV's ``INTER_CUBIC`` of both eyes' 8-bit luma on one thread, median of 30. It is
measured anew before and after everything that is timed, so that a machine that slows
down slows down the unit too. What other programs take of the processor meanwhile is
noted: the unit is too short to feel it.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from pipeline.frames import GreyImage

REPETITIONS = 30

CROWDED = 0.1
"""Share of the processor taken by others from which a run is not trusted."""


class BicubicUnit:
    """Measures the unit.

    Parameters
    ----------
    eyes : sequence of (H, W) images, 0..255
        Left and right.
    magnification : int
    """

    def __init__(self, eyes: Sequence[GreyImage], magnification: int = 2) -> None:
        self._eyes = [np.clip(np.rint(eye), 0, 255).astype(np.uint8) for eye in eyes]
        height, width = self._eyes[0].shape
        self._size = (magnification * width, magnification * height)

    def seconds(self) -> float:
        """Return what both eyes take just now."""
        threads = cv2.getNumThreads()
        cv2.setNumThreads(1)
        try:
            times = []
            for _ in range(REPETITIONS):
                begin = time.perf_counter()
                for eye in self._eyes:
                    cv2.resize(eye, self._size, interpolation=cv2.INTER_CUBIC)
                times.append(time.perf_counter() - begin)
        finally:
            cv2.setNumThreads(threads)
        return statistics.median(times)


@dataclass(frozen=True, kw_only=True)
class Timed:
    """One timed run of some work."""

    seconds: float
    """Wall clock."""
    cpu_seconds: float
    """Processor time of all threads."""
    unit: float
    """Seconds: mean of the unit before and after."""
    stages: Mapping[str, float] = field(default_factory=dict)
    """Seconds by stage."""
    others: float = 0.0
    """Share of the processor that others took, see :func:`share_of_others`."""

    @property
    def crowded(self) -> bool:
        """Whether others took too much for the time to be trusted."""
        return self.others > CROWDED

    def multiple(self, stage: str | None = None) -> float:
        """Return the time, or that of a stage, in units."""
        return (self.seconds if stage is None else self.stages[stage]) / self.unit


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Several runs of the same work; figures are medians over those that were not crowded.

    Over all of them where all were crowded.
    """

    all_runs: tuple[Timed, ...]

    @property
    def runs(self) -> tuple[Timed, ...]:
        """The runs that count."""
        return tuple(run for run in self.all_runs if not run.crowded) or self.all_runs

    @property
    def crowded(self) -> bool:
        """Whether there was no run without others."""
        return all(run.crowded for run in self.all_runs)

    @property
    def others(self) -> float:
        """Share of the processor that others took."""
        return statistics.median(run.others for run in self.runs)

    def seconds(self, stage: str | None = None) -> float:
        """Return the time, or that of a stage."""
        return statistics.median(
            run.seconds if stage is None else run.stages[stage] for run in self.runs
        )

    def multiple(self, stage: str | None = None) -> float:
        """Return the time, or that of a stage, in units."""
        return statistics.median(run.multiple(stage) for run in self.runs)

    @property
    def cpu_seconds(self) -> float:
        """Processor time of all threads."""
        return statistics.median(run.cpu_seconds for run in self.runs)


def busy_seconds() -> float:
    """Return the processor time that all programs together have taken so far; NaN if unknown."""
    table = Path("/proc/stat")
    if not table.is_file():
        return float("nan")
    fields = [int(text) for text in table.read_text(encoding="ascii").split("\n")[0].split()[1:]]
    idle = sum(fields[3:5])  # and waiting for disks; guests count twice
    return (sum(fields[:8]) - idle) / os.sysconf("SC_CLK_TCK")


def share_of_others(busy: float, own: float, seconds: float, cores: int, threads: int) -> float:
    """Return the share of the processor that others took from our threads, at most, 0..1.

    Parameters
    ----------
    busy, own : float
        Processor time of all programs together and of this one.
    seconds : float
        Wall clock.
    cores, threads : int
        Cores beyond those that our threads need are free for others.

    >>> share_of_others(busy=3.0, own=2.0, seconds=2.0, cores=2, threads=2)
    0.25
    """
    left_to_others = max(0, cores - threads) * seconds
    wanted = max(1, min(cores, threads)) * seconds
    taken = busy - own - left_to_others
    return min(1.0, taken / wanted) if taken > 0 < wanted else 0.0


def timed(unit: BicubicUnit, work: Callable[[], Mapping[str, float]], threads: int) -> Timed:
    """Return how long the work took, the unit measured before and after.

    Parameters
    ----------
    work : callable
        Returns the seconds of its stages.
    threads : int
        That it uses.
    """
    before, begin_busy = unit.seconds(), busy_seconds()
    begin, begin_cpu = time.perf_counter(), time.process_time()
    stages = work()
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - begin_cpu
    others = share_of_others(
        busy_seconds() - begin_busy, cpu_seconds, seconds, os.cpu_count() or 1, threads
    )
    return Timed(
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        unit=(before + unit.seconds()) / 2,
        stages=dict(stages),
        others=others,
    )


def measure(
    unit: BicubicUnit,
    work: Callable[[], Mapping[str, float]],
    *,
    threads: int,
    repeats: int,
    budget: float,
) -> Measured:
    """Return some runs of the work: so many uncrowded ones, or fewer once the budget is taken.

    Parameters
    ----------
    threads : int
        That the work uses.
    repeats : int
        Uncrowded runs at most, ≥ 1.
    budget : float
        Seconds after which no further run is begun.
    """
    runs = [timed(unit, work, threads)]
    while (
        sum(not run.crowded for run in runs) < repeats and sum(run.seconds for run in runs) < budget
    ):
        runs.append(timed(unit, work, threads))
    return Measured(all_runs=tuple(runs))
