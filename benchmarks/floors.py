"""The floors of speed and memory, and whether measured numbers reach them.

Pure functions: numbers in, verdicts out. What was not measured is not judged.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from pipeline.evaluation.floors import Verdict, at_most
from pipeline.evaluation.tables import number, signed

COLD_FRAME = 2000.0
"""Largest time of a cold frame, multiples of the unit."""

SOLVER_RATIO = 8.0
"""Least factor by which the default solver is faster than ``pocs`` at eight sweeps."""

EXPONENT = 1.1
"""Largest exponent of the growth with views and with pixels."""

MEMORY_MIB = (900.0, 2560.0)
"""Largest peak memory, at 8 views of 512×384 and of 1024×768 LR pixels."""


def fitted_exponent(sizes: Sequence[float], costs: Sequence[float]) -> float:
    """Return p of cost ∝ size^p, by least squares of the logarithms; NaN for fewer than two.

    >>> round(fitted_exponent([1, 2, 4], [3, 6, 12]), 6)
    1.0
    """
    pairs = [
        (math.log(size), math.log(cost))
        for size, cost in zip(sizes, costs, strict=True)
        if size > 0 and cost > 0
    ]
    if len({x for x, _ in pairs}) < 2:
        return math.nan
    mean_x = sum(x for x, _ in pairs) / len(pairs)
    mean_y = sum(y for _, y in pairs) / len(pairs)
    along = sum((x - mean_x) ** 2 for x, _ in pairs)
    return sum((x - mean_x) * (y - mean_y) for x, y in pairs) / along


@dataclass(frozen=True, kw_only=True)
class SpeedFigures:
    """What the floors of speed and memory ask for; NaN where not measured."""

    cold_frame: float = math.nan
    """Multiples of the unit."""
    solver_ratio: float = math.nan
    """Time of ``pocs`` over that of the default, reconstruction alone."""
    psnr_default: float = math.nan
    """dB."""
    psnr_pocs: float = math.nan
    """dB."""
    exponent_views: float = math.nan
    exponent_pixels: float = math.nan
    memory_mib: tuple[float, float] = (math.nan, math.nan)
    crowded: frozenset[str] = frozenset()
    """Of "cold frame", "solver ratio", "growth with pixels" and "growth with views" those that
    were measured while others used the machine."""


def speed_floors(figures: SpeedFigures) -> list[Verdict]:
    """Return the floors of speed and memory, each met or not."""
    ratio, ours, theirs = figures.solver_ratio, figures.psnr_default, figures.psnr_pocs
    known = not any(math.isnan(value) for value in (ratio, ours, theirs))
    cold_frame = at_most(
        f"cold frame ≤ {COLD_FRAME:.0f} × bicubic", figures.cold_frame, COLD_FRAME,
        digits=0, unit=" ×",
    )  # fmt: skip
    solvers = Verdict(
        floor=f"default ≥ {SOLVER_RATIO:.0f} × faster than pocs at eight sweeps, PSNR no lower",
        measured=f"{number(ratio)} × faster, PSNR {signed(ours - theirs)} dB",
        met=ratio >= SOLVER_RATIO and ours >= theirs if known else None,
    )
    views = at_most(f"growth with views: exponent ≤ {EXPONENT:g}", figures.exponent_views, EXPONENT)
    pixels = at_most(
        f"growth with pixels: exponent ≤ {EXPONENT:g}", figures.exponent_pixels, EXPONENT
    )
    memory = (
        at_most(
            f"peak memory, 8 × 512×384 → 1024×768, ≤ {MEMORY_MIB[0]:.0f} MiB",
            figures.memory_mib[0], MEMORY_MIB[0], digits=0, unit=" MiB",
        ),
        at_most(
            f"peak memory, 8 × 1024×768 → 2048×1536, ≤ {MEMORY_MIB[1] / 1024:g} GiB",
            figures.memory_mib[1] / 1024, MEMORY_MIB[1] / 1024, unit=" GiB",
        ),
    )  # fmt: skip
    crowded = figures.crowded
    return [
        # others can only have made it slower: what was fast enough all the same is
        _doubted(cold_frame, "cold frame" in crowded and cold_frame.met is not True),
        _doubted(solvers, "solver ratio" in crowded),
        _doubted(views, "growth with views" in crowded),
        _doubted(pixels, "growth with pixels" in crowded),
        *memory,
    ]


def _doubted(verdict: Verdict, crowded: bool) -> Verdict:
    """Return the verdict, or none where others used the machine meanwhile."""
    if not crowded:
        return verdict
    return replace(verdict, measured=f"{verdict.measured}; the machine was busy", met=None)
