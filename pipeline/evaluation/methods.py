"""One method on one view, with what it cost; choices of views that the studies share."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.degradation import DegradedFrame
from pipeline.evaluate import run_method
from pipeline.frames import MultiViewFrame
from pipeline.metrics import ms_ssim, psnr, ssim
from pipeline.results import FrameReport

Result = TypeVar("Result")
Other = TypeVar("Other")

REFERENCES = Path("/proc/self/clear_refs")


@dataclass(frozen=True, kw_only=True, eq=False)
class MethodRun:
    """What one method made of one view."""

    method: str
    view_id: str
    image: npt.NDArray[np.uint8]
    """(K·H, K·W), rounded and clipped, as it would be stored."""
    report: FrameReport | None
    """None for plain enlargement."""
    seconds: float
    """Wall clock."""
    cpu_seconds: float
    """Of all threads."""
    memory_mib: float
    """Largest resident memory above that before the call; NaN where the system does not tell."""


@dataclass(frozen=True, kw_only=True)
class Fidelity:
    """How close a picture comes to the truth."""

    psnr: float
    """dB."""
    ssim: float
    ms_ssim: float


@dataclass(frozen=True, kw_only=True)
class Accounted(Generic[Result]):
    """What a call gave, and what it cost."""

    result: Result
    seconds: float
    """Wall clock."""
    cpu_seconds: float
    """Of all threads."""
    memory_mib: float
    """Largest resident memory above that before the call; NaN where the system does not tell."""

    def giving(self, result: Other) -> Accounted[Other]:
        """Return what was made of the result, at the same cost."""
        return Accounted(
            result=result, seconds=self.seconds, cpu_seconds=self.cpu_seconds,
            memory_mib=self.memory_mib,
        )  # fmt: skip


def accounted(call: Callable[[], Result]) -> Accounted[Result]:
    """Call, and account for it."""
    before = _resident_mib()
    begin, cpu = time.perf_counter(), time.process_time()
    result = call()
    seconds, cpu = time.perf_counter() - begin, time.process_time() - cpu
    return Accounted(
        result=result, seconds=seconds, cpu_seconds=cpu,
        memory_mib=peak_mib() - before,
    )  # fmt: skip


def timed_run(method: str, degraded: DegradedFrame, settings: Settings, view_id: str) -> MethodRun:
    """Run a method of :data:`pipeline.evaluate.METHODS` or a baseline, and account for it."""
    made = accounted(lambda: run_method(method, degraded, settings, view_id))
    image, report = made.result
    return MethodRun(
        method=method,
        view_id=view_id,
        image=np.clip(np.rint(image), 0, 255).astype(np.uint8),
        report=report,
        seconds=made.seconds,
        cpu_seconds=made.cpu_seconds,
        memory_mib=made.memory_mib,
    )


def fidelity(image: npt.NDArray[np.uint8], truth: npt.NDArray[np.uint8], border: int) -> Fidelity:
    """Return the full-reference measures of a picture, a border left out."""
    return Fidelity(
        psnr=psnr(image, truth, border=border),
        ssim=ssim(image, truth, border=border),
        ms_ssim=ms_ssim(image, truth, border=border),
    )


def middle_views(frame: MultiViewFrame, count: int) -> MultiViewFrame:
    """Return the frame with so many of its views, those around the stereo pair."""
    names = [view.view_id for view in frame.views]
    middle = (names.index(frame.left) + names.index(frame.right)) / 2
    order = sorted(range(len(names)), key=lambda number: abs(number - middle))
    kept = sorted(order[:count])
    return replace(frame, views=tuple(frame.views[number] for number in kept))


def peak_mib(process: int | str = "self") -> float:
    """Return the peak of resident memory, MiB; NaN where the system does not tell.

    Parameters
    ----------
    process : int or "self"
        Number of the process.
    """
    try:
        status = Path(f"/proc/{process}/status").read_text(encoding="ascii", errors="replace")
    except OSError:
        return float("nan")
    for line in status.splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    return float("nan")


def _resident_mib() -> float:
    """Return resident memory, MiB, and have the peak begin there; NaN as above.

    Linux forgets the peak when 5 is written to ``clear_refs``.
    """
    try:
        REFERENCES.write_text("5", encoding="ascii")
    except OSError:
        return float("nan")
    return peak_mib()
