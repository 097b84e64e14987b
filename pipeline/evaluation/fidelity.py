"""Table 2: every method against the truth, both eyes, over PSFs, noises and seeds (Set 1)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from pipeline.degradation import Degradation
from pipeline.evaluate import BORDER, DEFAULT, SINGLE_VIEW
from pipeline.evaluation import plots
from pipeline.evaluation.elements import Chapter, Comparison, Figure
from pipeline.evaluation.methods import MethodRun, fidelity
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import NOT_MEASURED, Table, number, signed
from pipeline.metrics import binocular_psnr

METHODS = (
    "nearest", "bilinear", "bicubic", "lanczos", SINGLE_VIEW, "pocs", "pocs-simplified", DEFAULT,
)  # fmt: skip
"""All baselines of Table 2, and the thesis' own solvers."""

SEED_METHODS = ("bicubic", SINGLE_VIEW, DEFAULT)
"""Measured at further seeds."""

GALLERY = ("bicubic", SINGLE_VIEW, DEFAULT)
"""Shown in the gallery, the truth beside them."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One method on one scene under one degradation, both eyes."""

    scene: str
    num_views: int
    psf_sigma: float
    """HR pixels."""
    noise: float
    """Grey levels."""
    seed: int
    method: str
    psnr: tuple[float, float]
    """Left and right, dB."""
    ssim: tuple[float, float]
    ms_ssim: tuple[float, float]
    binocular: float
    """Left and right together (:func:`pipeline.metrics.binocular_psnr`), dB."""
    cpu_seconds: float
    """Of all threads; both eyes, one after the other."""
    memory_mib: float

    @property
    def mean_psnr(self) -> float:
        """Mean of the eyes, dB."""
        return sum(self.psnr) / 2


@dataclass(frozen=True, kw_only=True)
class Condition:
    """One column of the study."""

    psf_sigma: float
    noise: float
    seeds: Sequence[int] = (1,)


def measure_rows(
    subject: Subject,
    conditions: Iterable[Condition],
    *,
    methods: Sequence[str] = METHODS,
    note: Callable[[str], None] = lambda _: None,
    keep: Callable[[Condition, MethodRun], None] = lambda condition, run: None,
) -> list[Row]:
    """Return a row for each condition, seed and method.

    Parameters
    ----------
    keep : callable
        Given every run at the first seed, for pictures.
    """
    rows = []
    for condition in conditions:
        for position, seed in enumerate(condition.seeds):
            degradation = Degradation(
                psf_sigma=condition.psf_sigma, noise_sigma=condition.noise, seed=seed
            )
            truth = subject.degraded(degradation).truth
            for method in methods if position == 0 else SEED_METHODS:
                note(
                    f"{subject.name}, σ_psf {condition.psf_sigma:g}, noise "
                    f"{condition.noise:g}, seed {seed}: {method}"
                )
                runs = [subject.run(method, degradation, eye) for eye in subject.eyes]
                if position == 0:
                    for run in runs:
                        keep(condition, run)
                rows.append(_row(subject, condition, seed, method, runs, truth))
    return rows


def _row(
    subject: Subject,
    condition: Condition,
    seed: int,
    method: str,
    runs: Sequence[MethodRun],
    truth: Mapping[str, np.ndarray],
) -> Row:
    found = [fidelity(run.image, truth[run.view_id], BORDER) for run in runs]
    left, right = (run.image.astype(np.float32) - truth[run.view_id] for run in runs)
    between = subject.between_eyes
    return Row(
        scene=subject.name,
        num_views=len(subject.view_ids),
        psf_sigma=condition.psf_sigma,
        noise=condition.noise,
        seed=seed,
        method=method,
        psnr=(found[0].psnr, found[1].psnr),
        ssim=(found[0].ssim, found[1].ssim),
        ms_ssim=(found[0].ms_ssim, found[1].ms_ssim),
        binocular=binocular_psnr((left, right), between.position, between.seen, border=BORDER),
        cpu_seconds=sum(run.cpu_seconds for run in runs),
        memory_mib=max(run.memory_mib for run in runs),
    )


def chapter(rows: Sequence[Row], comparisons: Sequence[Comparison] = ()) -> Chapter:
    """Return Table 2, what its rows say in words, and its plots."""
    first_seed = [row for row in rows if row.seed == min(r.seed for r in rows)]
    return Chapter(
        key="fidelity",
        title="How close to the truth (Table 2)",
        question="Is it better than anything simpler, and by how much?",
        answer=_answer(first_seed),
        tables=[
            ("Every scene and condition, first seed", _full_table(first_seed)),
            ("Mean and worst over the scenes", _summary_table(first_seed)),
            ("Over the seeds of the noise: gain of the default, 95 % interval", _seed_table(rows)),
        ],
        figures=[_gain_figure(first_seed)],
        comparisons=comparisons,
        data={"rows": list(rows)},
    )


def _cells(rows: Sequence[Row]) -> dict[tuple[str, float, float], dict[str, Row]]:
    """Return the rows by (scene, σ_psf, noise), then method."""
    cells: dict[tuple[str, float, float], dict[str, Row]] = {}
    for row in rows:
        cells.setdefault((row.scene, row.psf_sigma, row.noise), {})[row.method] = row
    return cells


def _answer(rows: Sequence[Row]) -> list[str]:
    sentences = []
    for base, meaning in (
        ("bicubic", "plain enlargement"), (SINGLE_VIEW, "the same solver with one view"),
    ):  # fmt: skip
        gains = {
            cell: methods[DEFAULT].mean_psnr - methods[base].mean_psnr
            for cell, methods in _cells(rows).items()
            if DEFAULT in methods and base in methods
        }
        if not gains:
            continue
        worst, best = min(gains, key=gains.__getitem__), max(gains, key=gains.__getitem__)
        won = sum(gain > 0 for gain in gains.values())
        sentences.append(
            f"Against {base} ({meaning}) the default wins {won} of {len(gains)} cells, by "
            f"{signed(sum(gains.values()) / len(gains))} dB in the mean; least "
            f"{signed(gains[worst])} dB on {_named(worst)}, most {signed(gains[best])} dB on "
            f"{_named(best)}."
        )
    together = [
        (methods[DEFAULT].binocular - methods[SINGLE_VIEW].binocular)
        for methods in _cells(rows).values()
        if DEFAULT in methods and SINGLE_VIEW in methods
    ]
    together = [gain for gain in together if math.isfinite(gain)]
    if together:
        sentences.append(
            "Of the two eyes together (errors that only one eye has), the default is "
            f"{signed(sum(together) / len(together))} dB from one view alone in the mean, "
            f"{signed(min(together))} dB at worst."
        )
    return sentences


def _named(cell: tuple[str, float, float]) -> str:
    return f"{cell[0]} (σ_psf {cell[1]:g}, noise {cell[2]:g})"


def _full_table(rows: Sequence[Row]) -> Table:
    return Table(
        head=(
            "scene", "σ_psf", "noise", "method", "PSNR left", "PSNR right", "SSIM left",
            "SSIM right", "MS-SSIM left", "MS-SSIM right", "both eyes dB", "CPU s", "MiB",
        ),
        rows=tuple(
            (
                row.scene, f"{row.psf_sigma:g}", f"{row.noise:g}", row.method,
                *(number(value) for value in row.psnr),
                *(number(value, 4) for value in row.ssim),
                *(number(value, 4) for value in row.ms_ssim),
                number(row.binocular), number(row.cpu_seconds), number(row.memory_mib, 0),
            )
            for row in rows
        ),
        left=("method",),
    )  # fmt: skip


def _summary_table(rows: Sequence[Row]) -> Table:
    table = []
    for sigma, noise in dict.fromkeys((row.psf_sigma, row.noise) for row in rows):
        cells = [methods for (_, s, n), methods in _cells(rows).items() if (s, n) == (sigma, noise)]
        for method in dict.fromkeys(row.method for row in rows):
            values = [methods[method] for methods in cells if method in methods]
            over = [
                [
                    methods[method].mean_psnr - methods[base].mean_psnr
                    for methods in cells
                    if method in methods and base in methods
                ]
                for base in ("bicubic", SINGLE_VIEW)
            ]
            table.append(
                (
                    f"{sigma:g}", f"{noise:g}", method,
                    number(float(np.mean([row.mean_psnr for row in values]))),
                    number(min(row.mean_psnr for row in values)),
                    *(
                        signed(float(measure(gains))) if gains else NOT_MEASURED
                        for gains in over
                        for measure in (np.mean, np.min)
                    ),
                    number(float(np.mean([np.mean(row.ssim) for row in values])), 4),
                    number(float(np.mean([np.mean(row.ms_ssim) for row in values])), 4),
                    number(float(np.mean([row.binocular for row in values]))),
                )
            )  # fmt: skip
    return Table(
        head=(
            "σ_psf", "noise", "method", "PSNR mean", "worst", "over bicubic mean", "worst",
            "over single-view mean", "worst", "SSIM", "MS-SSIM", "both eyes dB",
        ),
        rows=tuple(table),
        left=("noise", "method"),
    )  # fmt: skip


def _seed_table(rows: Sequence[Row]) -> Table:
    """Return the gains of the default over the seeds, where there are two seeds or more."""
    table = []
    by_seed: dict[tuple[str, float, float], dict[int, dict[str, Row]]] = {}
    for row in rows:
        cell = by_seed.setdefault((row.scene, row.psf_sigma, row.noise), {})
        cell.setdefault(row.seed, {})[row.method] = row
    for (scene, sigma, noise), seeds in by_seed.items():
        for base in ("bicubic", SINGLE_VIEW):
            gains = [
                methods[DEFAULT].mean_psnr - methods[base].mean_psnr
                for methods in seeds.values()
                if DEFAULT in methods and base in methods
            ]
            if len(gains) < 2:
                continue
            half = (
                stats.t.ppf(0.975, len(gains) - 1) * np.std(gains, ddof=1) / math.sqrt(len(gains))
            )
            table.append(
                (
                    scene, f"{sigma:g}", f"{noise:g}", f"over {base}", str(len(gains)),
                    signed(float(np.mean(gains)), 3), f"± {half:.3f}",
                )
            )  # fmt: skip
    return Table(
        head=("scene", "σ_psf", "noise", "gain", "seeds", "mean dB", "95 % (Student t)"),
        rows=tuple(table),
        left=("gain",),
    )


def _gain_figure(rows: Sequence[Row]) -> Figure:
    cells = _cells(rows)
    scenes = list(dict.fromkeys(row.scene for row in rows))
    conditions = list(dict.fromkeys((row.psf_sigma, row.noise) for row in rows))
    values = {}
    for sigma, noise in conditions:
        heights = []
        for scene in scenes:
            methods = cells.get((scene, sigma, noise), {})
            known = DEFAULT in methods and SINGLE_VIEW in methods
            heights.append(
                methods[DEFAULT].mean_psnr - methods[SINGLE_VIEW].mean_psnr if known else math.nan
            )
        values[f"σ {sigma:g}, noise {noise:g}"] = heights
    return Figure(
        caption="What the other views bring: PSNR of the default over that of one view alone.",
        content=plots.bars(scenes, values, y_label="gain over one view, dB"),
    )
