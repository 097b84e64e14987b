"""The unit in which times are told: what plain enlargement of the same stereo pair takes.

OpenCV's ``INTER_CUBIC`` of both eyes' 8-bit luma on one thread, median of 30. It is
measured anew before and after everything that is timed, so that a machine that slows
down slows down the unit too.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np

from pipeline.frames import GreyImage

REPETITIONS = 30


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

    def multiple(self, stage: str | None = None) -> float:
        """Return the time, or that of a stage, in units."""
        return (self.seconds if stage is None else self.stages[stage]) / self.unit


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Several runs of the same work; figures are medians."""

    runs: tuple[Timed, ...]

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


def timed(unit: BicubicUnit, work: Callable[[], Mapping[str, float]]) -> Timed:
    """Return how long the work took, the unit measured before and after.

    Parameters
    ----------
    work : callable
        Returns the seconds of its stages.
    """
    before = unit.seconds()
    begin, begin_cpu = time.perf_counter(), time.process_time()
    stages = work()
    seconds, cpu_seconds = time.perf_counter() - begin, time.process_time() - begin_cpu
    return Timed(
        seconds=seconds,
        cpu_seconds=cpu_seconds,
        unit=(before + unit.seconds()) / 2,
        stages=dict(stages),
    )


def measure(
    unit: BicubicUnit,
    work: Callable[[], Mapping[str, float]],
    *,
    repeats: int,
    budget: float,
) -> Measured:
    """Return some runs of the work: so many, or fewer once they have taken the budget.

    Parameters
    ----------
    repeats : int
        Runs at most, ≥ 1.
    budget : float
        Seconds after which no further run is begun.
    """
    runs = [timed(unit, work)]
    while len(runs) < repeats and sum(run.seconds for run in runs) < budget:
        runs.append(timed(unit, work))
    return Measured(runs=tuple(runs))
