"""How fast: cold frame, its stages, the solvers, growth with size, views and K; peak memory.

The input is the rendered scene, as real cameras and a stereo matcher would deliver it:
noise 1, ragged 8-bit depth with holes, no calibration. Kernels are compiled before.
"""

from __future__ import annotations

import math
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.floors import SpeedFigures, fitted_exponent, speed_floors
from benchmarks.latency import StreamPlan, measure_stream, remark
from benchmarks.memory import bench_settings, peak_of, save_frame
from benchmarks.unit import BicubicUnit, Measured, Timed, measure
from pipeline.config import Settings, Solver
from pipeline.evaluation import tables
from pipeline.evaluation.floors import Verdict
from pipeline.evaluation.methods import middle_views
from pipeline.frames import GreyImage, MultiViewFrame
from pipeline.machine import load_average
from pipeline.metrics import psnr
from pipeline.results import FrameResult
from pipeline.superresolve import superresolve
from pipeline.synthetic import SampleScene
from pipeline.threads import set_threads
from service.streams.latency import KEEP

Size = tuple[int, int]
"""(width, height), LR pixels."""

NOISE = 1.0
"""Of the rendered cameras, grey levels."""

BORDER = 24
"""HR pixels left out when measuring."""

SWEEPS = 8
"""Of pocs."""

TURNS_BUDGET = 3
"""Row budgets after which the two solvers take no further turns."""

STAGES = ("registration", "reconstruction")
"""The stages that are told; preparation (pyramids, noise) is the rest."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What is measured, and how often."""

    size: Size = (512, 384)
    """Of the cold frame and of the unit."""
    num_views: int = 8
    sizes: tuple[Size, ...] = ((256, 192), (512, 384), (724, 544), (1024, 768))
    """For the growth with pixels."""
    views: tuple[int, ...] = (2, 4, 8, 16)
    magnifications: tuple[int, ...] = (2, 3, 4)
    memory_sizes: tuple[Size, ...] = ((512, 384), (1024, 768))
    repeats: int = 5
    """Runs of a row, at most, that had the machine for themselves; figures are their medians."""
    turns: int = 11
    """The same of two solvers that take turns: their ratio is told, and the first runs of a process
    take longer."""
    row_budget: float = 12.0
    """Seconds after which a row is not repeated."""
    threads: int = 2
    """The floors are for two cores."""
    streams: tuple[StreamPlan, ...] = (
        StreamPlan(size=(256, 192), num_views=4, rate=10, seconds=15),
        StreamPlan(size=(512, 384), num_views=8, rate=5, seconds=20),
    )
    """Live streams whose latency is told."""


QUICK = Plan(
    size=(96, 72),
    num_views=3,
    sizes=((64, 48), (96, 72)),
    views=(2, 3),
    magnifications=(2, 3),
    memory_sizes=((96, 72),),
    repeats=1,
    turns=1,
    row_budget=0,
    streams=(StreamPlan(size=(48, 36), num_views=3, rate=5, seconds=2),),
)
"""A few seconds: whether the benchmark itself works."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One line of the table."""

    section: str
    name: str
    size: str = ""
    seconds: float = math.nan
    multiple: float = math.nan
    """Of the unit."""
    cpu_seconds: float = math.nan
    """Processor time of all threads."""
    others: float = math.nan
    """Share of the processor that other programs took, 0..1."""
    memory_mib: float = math.nan
    runs: int = 0
    remark: str = ""


@dataclass(frozen=True, kw_only=True)
class SpeedResult:
    """The table and what the floors say of it."""

    plan: Plan
    unit_seconds: float
    """Median over the whole run."""
    rows: tuple[Row, ...]
    figures: SpeedFigures
    verdicts: tuple[Verdict, ...]
    seconds: float
    """Of the whole benchmark."""
    load: tuple[float, float]
    """Load average of the minute before it began and before it ended, itself included."""

    def table(self) -> tables.Table:
        """Return the one table."""
        return tables.Table(
            head=(
                "",
                "measured",
                "size",
                "seconds",
                "× bicubic",
                "CPU s",
                "others %",
                "MiB",
                "runs",
                "remark",
            ),
            rows=tuple(
                (
                    row.section,
                    row.name,
                    row.size,
                    _seconds(row.seconds),
                    tables.number(row.multiple, 0 if row.multiple >= 10 else 2),
                    tables.number(row.cpu_seconds),
                    tables.number(100 * row.others, 0),
                    tables.number(row.memory_mib, 0),
                    str(row.runs or tables.NOT_MEASURED),
                    row.remark,
                )
                for row in self.rows
            ),
            left=("measured", "size", "remark"),
        )


class _Frames:
    """The frames that are measured, each rendered once."""

    def __init__(self, note: Callable[[str], None]) -> None:
        self._note = note
        self._kept: dict[tuple[Size, int], tuple[MultiViewFrame, tuple[GreyImage, GreyImage]]] = {}

    def __call__(self, size: Size, num_views: int) -> MultiViewFrame:
        return self._get(size, num_views)[0]

    def truth(self, size: Size, num_views: int) -> tuple[GreyImage, GreyImage]:
        """Return the HR luma of both eyes."""
        return self._get(size, num_views)[1]

    def _get(
        self, size: Size, num_views: int
    ) -> tuple[MultiViewFrame, tuple[GreyImage, GreyImage]]:
        key = (size, num_views)
        if key not in self._kept:
            self._note(f"rendering {num_views} views of {tables.size(size)}")
            scene = SampleScene(width=size[0], height=size[1], num_views=num_views)
            frame = scene.frame(0, noise_sigma=NOISE, depth="stereo")
            luma = scene.truth(0).hr_luma
            left, right = scene.reference_views
            self._kept[key] = frame, (luma[left], luma[right])
        return self._kept[key]


def run_speed(plan: Plan, note: Callable[[str], None] = lambda _: None) -> SpeedResult:
    """Measure everything of the plan.

    Parameters
    ----------
    note : callable
        Told what is being done.
    """
    begin, load = time.perf_counter(), load_average()
    set_threads(plan.threads)
    frames = _Frames(note)
    note("compiling, or loading what is compiled")
    _warm_up(plan)
    base = frames(plan.size, plan.num_views)
    unit = BicubicUnit([base.view(base.left).luma, base.view(base.right).luma])
    bench = _Bench(plan, frames, unit, note)
    rows = list(bench.rows())
    unit_seconds = statistics.median(bench.units)
    height, width = base.lr_shape
    unit_row = Row(
        section="unit",
        name="bicubic of both eyes",
        size=f"{tables.size((width, height))} → {tables.size((2 * width, 2 * height))}",
        seconds=unit_seconds,
        multiple=1.0,
        runs=len(bench.units),
        remark=f"{1e3 * min(bench.units):.2f} to {1e3 * max(bench.units):.2f} ms in the course "
        "of the run",
    )
    verdicts = speed_floors(bench.figures)
    if replace(plan, threads=Plan.threads) != Plan():  # not what the floors are about
        verdicts = [replace(verdict, met=None) for verdict in verdicts]
    return SpeedResult(
        plan=plan,
        unit_seconds=unit_seconds,
        rows=(unit_row, *rows),
        figures=bench.figures,
        verdicts=tuple(verdicts),
        seconds=time.perf_counter() - begin,
        load=(load, load_average()),
    )


def _warm_up(plan: Plan) -> None:
    """Compile or load every kernel that is timed, on a very small frame."""
    frame = SampleScene(width=96, height=72, num_views=3).frame(0, noise_sigma=1, depth="stereo")
    for magnification in plan.magnifications:
        _superresolve(frame, bench_settings(plan.threads, magnification))
    _superresolve(frame, _pocs(bench_settings(plan.threads), sweeps=1))


def _superresolve(frame: MultiViewFrame, settings: Settings) -> FrameResult:
    return superresolve(frame, settings, targets=(frame.left, frame.right))


def _pocs(settings: Settings, sweeps: int = SWEEPS) -> Settings:
    return replace(settings, solver=Solver.POCS.value, sweeps=sweeps)


def _psnr(result: FrameResult, frame: MultiViewFrame, truth: Sequence[GreyImage]) -> float:
    """Return the mean PSNR of both eyes, dB."""
    border = min(BORDER, min(truth[0].shape) // 4)
    values = [
        psnr(np.clip(np.rint(result.images[eye].luma), 0, 255), picture, border=border)
        for eye, picture in zip((frame.left, frame.right), truth, strict=True)
    ]
    return float(np.mean(values))


class _Bench:
    """Measures one section after another; ``units`` and ``figures`` fill on the way."""

    def __init__(
        self, plan: Plan, frames: _Frames, unit: BicubicUnit, note: Callable[[str], None]
    ) -> None:
        self._plan, self._frames, self._unit, self._note = plan, frames, unit, note
        self._settings = bench_settings(plan.threads)
        self._cold: dict[tuple[Size, int], Measured] = {}
        self.units: list[float] = []
        self.figures = SpeedFigures()

    def rows(self) -> Iterator[Row]:
        """Yield all rows."""
        yield from self._solvers()
        yield from self._pixels()
        yield from self._views()
        yield from self._magnifications()
        yield from self._memory()
        yield from self._streams()

    # --- timing ------------------------------------------------------------------------

    def _measure(self, what: str, work: Callable[[], FrameResult]) -> Measured:
        return self._repeat(what, work, self._plan.repeats, self._plan.row_budget)

    def _repeat(
        self, what: str, work: Callable[[], FrameResult], repeats: int, budget: float
    ) -> Measured:
        self._note(what)
        measured = measure(
            self._unit, lambda: work().report.timings,
            threads=self._plan.threads, repeats=repeats, budget=budget,
        )  # fmt: skip
        self.units += [run.unit for run in measured.all_runs]
        return measured

    def _crowd(self, figure: str, *measured: Measured) -> None:
        """Note a figure as not to be trusted where one of its rows had no run to itself."""
        if any(item.crowded for item in measured):
            self.figures = replace(self.figures, crowded=self.figures.crowded | {figure})

    def _cold_frame(self, size: Size, num_views: int) -> Measured:
        key = (size, num_views)
        if key not in self._cold:
            frame = self._frames(size, num_views)
            self._cold[key] = self._measure(
                f"cold frame, {num_views} views of {tables.size(size)}",
                partial(_superresolve, frame, self._settings),
            )
        return self._cold[key]

    # --- sections ----------------------------------------------------------------------

    def _solvers(self) -> Iterator[Row]:
        plan = self._plan
        frame = self._frames(plan.size, plan.num_views)
        truth = self._frames.truth(plan.size, plan.num_views)
        kept: dict[str, FrameResult] = {}

        def solve(name: str, settings: Settings) -> FrameResult:
            kept[name] = _superresolve(frame, settings)
            return kept[name]

        # turn by turn, so that what slows one down slows the other down too
        runs: dict[str, list[Timed]] = {"fused": [], "pocs": []}
        end = time.perf_counter() + TURNS_BUDGET * plan.row_budget
        while True:
            for name, settings in (("fused", self._settings), ("pocs", _pocs(self._settings))):
                work = partial(solve, name, settings)
                runs[name] += self._repeat(f"cold frame with {name}", work, 1, 0.0).all_runs
            alone = min(sum(not run.crowded for run in found) for found in runs.values())
            if alone >= plan.turns or time.perf_counter() > end:
                break
        ours, theirs = (Measured(all_runs=tuple(runs[name])) for name in ("fused", "pocs"))
        self._cold[(plan.size, plan.num_views)] = ours
        place = _scaled(plan.size, plan.num_views)
        self._crowd("cold frame", ours)
        self._crowd("solver ratio", ours, theirs)
        yield _row("cold frame", "superresolve()", place, ours)
        for stage in ours.runs[0].stages:
            yield _row("", stage, "", ours, stage)
        quality = {name: _psnr(result, frame, truth) for name, result in kept.items()}
        ratio = theirs.multiple("reconstruction") / ours.multiple("reconstruction")
        yield _row(
            "reconstruction", "default (fused)", place, ours, "reconstruction",
            remark=f"PSNR {quality['fused']:.2f} dB",
        )  # fmt: skip
        sweeps = max(target.iterations for target in kept["pocs"].report.targets)
        yield _row(
            "", f"pocs, {sweeps} sweeps", place, theirs, "reconstruction",
            remark=f"PSNR {quality['pocs']:.2f} dB; {ratio:.2f} × the time of the default at "
            f"{tables.signed(quality['pocs'] - quality['fused'])} dB",
        )  # fmt: skip
        self.figures = replace(
            self.figures, cold_frame=ours.multiple(), solver_ratio=ratio,
            psnr_default=quality["fused"], psnr_pocs=quality["pocs"],
        )  # fmt: skip

    def _pixels(self) -> Iterator[Row]:
        plan = self._plan
        found = {size: self._cold_frame(size, plan.num_views) for size in plan.sizes}
        for number, (size, measured) in enumerate(found.items()):
            yield _growth_row(
                "growth with pixels" if number == 0 else "",
                f"{size[0] * size[1] / 1e6:.2g} Mpx a view",
                _scaled(size, plan.num_views),
                measured,
            )
        sizes = [size[0] * size[1] for size in plan.sizes]
        exponent, row = _exponents(sizes, list(found.values()))
        self.figures = replace(self.figures, exponent_pixels=exponent)
        self._crowd("growth with pixels", *found.values())
        yield row

    def _views(self) -> Iterator[Row]:
        """The views are the middle ones of the widest row."""
        plan = self._plan
        widest = self._frames(plan.size, max(plan.views))
        found = []
        for number, count in enumerate(plan.views):
            frame = middle_views(widest, count)
            work = partial(_superresolve, frame, self._settings)
            measured = self._measure(f"cold frame, {count} views", work)
            found.append(measured)
            yield _growth_row(
                "growth with views" if number == 0 else "", f"{count} views",
                _scaled(plan.size, count), measured,
            )  # fmt: skip
        exponent, row = _exponents(plan.views, found)
        self.figures = replace(self.figures, exponent_views=exponent)
        self._crowd("growth with views", *found)
        yield row

    def _magnifications(self) -> Iterator[Row]:
        """The same LR frame for all K: its PSF is half an LR pixel whatever K."""
        plan = self._plan
        frame = self._frames(plan.size, plan.num_views)
        found = []
        for number, factor in enumerate(plan.magnifications):
            settings = bench_settings(plan.threads, factor)
            if settings == self._settings:
                measured = self._cold_frame(plan.size, plan.num_views)
            else:
                work = partial(_superresolve, frame, settings)
                measured = self._measure(f"cold frame, K = {factor}", work)
            found.append(measured)
            yield _growth_row(
                "growth with K" if number == 0 else "", f"K = {factor}",
                _scaled(plan.size, plan.num_views, factor), measured,
            )  # fmt: skip
        yield _exponents(plan.magnifications, found)[1]

    def _streams(self) -> Iterator[Row]:
        unit = statistics.median(self.units)
        for number, plan in enumerate(self._plan.streams):
            size = f"{plan.num_views} × {tables.size(plan.size)}, {plan.rate} a second"
            self._note(f"live stream, {size}")
            status = measure_stream(plan, self._plan.threads)
            for place, (stage, times) in enumerate(reversed(status["latency"].items())):
                told = f"95 %: {times['p95_ms']:g} ms"
                yield Row(
                    section="stream latency" if number == place == 0 else "",
                    name=stage,
                    size=size if place == 0 else "",
                    seconds=times["median_ms"] / 1000,
                    multiple=times["median_ms"] / 1000 / unit,
                    runs=min(status["frames_done"], KEEP),
                    remark=f"{told}; {remark(status)}" if place == 0 else told,
                )

    def _memory(self) -> Iterator[Row]:
        plan = self._plan
        peaks = []
        with tempfile.TemporaryDirectory(prefix="depthsr-bench-") as folder:
            for number, size in enumerate(plan.memory_sizes):
                frame = self._frames(size, plan.num_views)
                path = Path(folder) / f"{number}.npz"
                save_frame(path, frame)
                self._note(f"peak memory, {tables.size(size)}")
                peaks.append(peak_of(path, plan.threads))
                path.unlink()
                yield Row(
                    section="peak memory" if number == 0 else "", name="a fresh process",
                    size=_scaled(size, plan.num_views), memory_mib=peaks[-1], runs=1,
                    remark=f"{peaks[-1] / 1024:.2f} GiB",
                )  # fmt: skip
        first, second, *_ = (*peaks, math.nan, math.nan)
        self.figures = replace(self.figures, memory_mib=(first, second))


def _seconds(value: float) -> str:
    """Return seconds with three digits or so."""
    return tables.number(value, 5 if value < 0.05 else 3 if value < 10 else 2)


# --- rows ------------------------------------------------------------------------------------


def _scaled(size: Size, num_views: int, magnification: int = 2) -> str:
    """Return 8 × 512×384 → 1024×768."""
    larger = (magnification * size[0], magnification * size[1])
    return f"{num_views} × {tables.size(size)} → {tables.size(larger)}"


def _row(
    section: str,
    name: str,
    size: str,
    measured: Measured,
    stage: str | None = None,
    *,
    remark: str = "",
) -> Row:
    return Row(
        section=section, name=name, size=size, seconds=measured.seconds(stage),
        multiple=measured.multiple(stage), runs=len(measured.runs), remark=remark,
        cpu_seconds=measured.cpu_seconds if stage is None else math.nan,
        others=measured.others if stage is None else math.nan,
    )  # fmt: skip


def _growth_row(section: str, name: str, size: str, measured: Measured) -> Row:
    stages = ", ".join(f"{stage} {measured.seconds(stage):.2f} s" for stage in STAGES)
    return _row(section, name, size, measured, remark=stages)


def _exponents(sizes: Sequence[float], found: Sequence[Measured]) -> tuple[float, Row]:
    """Return the exponent of the cold frame, and a row with those of the stages too.

    Fitted to the multiples of the unit: these follow the speed of the machine. That of the
    processor time is told too: it hardly depends on what else the machine does.
    """
    exponent = fitted_exponent(sizes, [measured.multiple() for measured in found])
    of_cpu = fitted_exponent(sizes, [measured.cpu_seconds for measured in found])
    of_stages = ", ".join(
        f"{stage} {fitted_exponent(sizes, [item.multiple(stage) for item in found]):.2f}"
        for stage in STAGES
    )
    return exponent, Row(
        section="",
        name="fitted exponent",
        remark=f"cold frame {exponent:.2f} (CPU s {of_cpu:.2f}), {of_stages}",
    )


def stderr_note(begin: float) -> Callable[[str], None]:
    """Return a function that says what is being done, with the time since the beginning."""

    def note(what: str) -> None:
        print(f"[{time.perf_counter() - begin:5.0f} s] {what}", file=sys.stderr, flush=True)

    return note


def as_json(result: SpeedResult, facts: Mapping[str, str], date: str) -> dict[str, Any]:
    """Return everything as a record for JSON."""
    return {
        "format": "depthsr-benchmark/1",
        "date": date,
        "machine": dict(facts),
        "plan": result.plan,
        "unit_seconds": result.unit_seconds,
        "seconds": result.seconds,
        "load": result.load,
        "rows": result.rows,
        "figures": result.figures,
        "floors": [{**vars(item), "verdict": item.word} for item in result.verdicts],
    }
