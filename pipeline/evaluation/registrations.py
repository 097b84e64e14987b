"""Table 1 and Figure 12: what each way of registering gives on a scene.

All views are registered onto the left eye, at one degradation. Where motion is truly
known, end-point errors say it all; elsewhere the share that is verified and the residual
do. Which L and R serve the scene is read from the numbers, never written in advance.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pipeline import drawing
from pipeline.config import Settings
from pipeline.degradation import Degradation
from pipeline.evaluation.elements import Chapter, Figure
from pipeline.evaluation.plots import png, spread_bars
from pipeline.evaluation.rendered import Errors, pooled_errors
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import NOT_MEASURED, Table, number
from pipeline.frames import MultiViewFrame
from pipeline.noise import estimate_noise_of_views
from pipeline.registration.method import METHODS, Initialisation, Layout
from pipeline.registration.register import (
    ViewRegistration,
    prepare_views,
    register_views,
)
from pipeline.superresolve import terms_of

DEGRADATION = Degradation(psf_sigma=1.0, noise_sigma=1.0)
"""Some aliasing and some noise, as cameras have."""

SHOWN = ("a", "f", "j", "l", "calibration-only", "default")
"""Methods whose weights are shown."""

WEIGHT_LIMIT = 20.0
"""Registration weight drawn in the strongest colour, grey levels."""

ENOUGH_BETTER = 1.02
"""Ratio of median |weights| from which one method counts as better than another."""


@dataclass(frozen=True, kw_only=True)
class MethodRow:
    """One method on one scene, all views onto the left eye, pooled."""

    scene: str
    method: str
    layers: int | None
    """L; None where the method cuts windows."""
    subregions: int | None
    """R."""
    verified: float
    """Share of pixels that are trusted, 0..1."""
    registered: float
    """Share of pixels that have a motion, 0..1."""
    median_weight: float
    """Median |registration weight|, grey levels."""
    rms_weight: float
    """Root mean square of the registration weights, cut at 50 grey levels."""
    cpu_seconds: float
    """Of all threads."""
    errors: Errors | None
    """Where motion is truly known."""


def measure_methods(
    subject: Subject, *, note: Callable[[str], None] = lambda _: None
) -> tuple[list[MethodRow], list[Figure]]:
    """Return a row for each method that the scene allows, and pictures of the weights."""
    degraded = subject.degraded(DEGRADATION)
    frame = degraded.frame
    left = subject.eyes[0]
    noise = estimate_noise_of_views(frame.views)
    calibrated = frame.depth_is_metric and all(view.calibration for view in frame.views)
    rows, panels = [], []
    for name, method in METHODS.items():
        if method.initialisation is Initialisation.CALIBRATION and not calibrated:
            continue
        note(f"{subject.name}: registration {name}")
        begin = time.process_time()
        prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
        terms = replace(terms_of(Settings(), noise), method=method)
        found = register_views(prepared, [left], list(subject.view_ids), terms)[left]
        cpu_seconds = time.process_time() - begin
        strips = method.layout is Layout.STRIPS
        others = [item for item in found if not item.registered.is_reference]
        rows.append(
            _row(subject, name, method.num_layers if strips else None,
                 method.num_subregions if strips else None, others, cpu_seconds)
        )  # fmt: skip
        if name in SHOWN:
            panels.append((name, _weights_picture(frame, others)))
    pictures = [drawing.titled(canvas, name) for name, canvas in panels]
    figure = Figure(
        caption=f"{subject.name}: registration weights (Figure 12) of the view farthest from the "
        f"left eye; white fits, blue and red are off by {WEIGHT_LIMIT:g} grey levels and more, "
        "grey has no motion.",
        content=png(drawing.tiled(pictures, min(3, len(pictures)))),
        kind="png",
        scene=subject.name,
    )
    return rows, [figure]


def _row(
    subject: Subject,
    name: str,
    layers: int | None,
    subregions: int | None,
    others: Sequence[ViewRegistration],
    cpu_seconds: float,
) -> MethodRow:
    weights = np.concatenate([item.registered.registration_weights.ravel() for item in others])
    weights = weights[np.isfinite(weights)]
    positions = [item.registered.position for item in others]
    return MethodRow(
        scene=subject.name,
        method=name,
        layers=layers,
        subregions=subregions,
        verified=float(np.mean([item.registered.verification_map.mean() for item in others])),
        registered=float(np.mean([np.isfinite(p[..., 0]).mean() for p in positions])),
        median_weight=float(np.median(np.abs(weights))) if weights.size else float("nan"),
        rms_weight=float(np.sqrt(np.mean(np.clip(weights, -50, 50) ** 2)))
        if weights.size
        else float("nan"),
        cpu_seconds=cpu_seconds,
        errors=_errors(subject, others) if subject.is_rendered else None,
    )


def _errors(subject: Subject, others: Sequence[ViewRegistration]) -> Errors:
    truth, number_of = subject.sample_truth, subject.view_ids.index
    left = number_of(subject.eyes[0])
    error, visible, verified = [], [], []
    for item in others:
        motion = truth.motion(number_of(item.registered.view_id), left)
        apart = item.registered.position - motion.position
        error.append(np.hypot(apart[..., 0], apart[..., 1]).ravel())
        visible.append(motion.visible.ravel())
        verified.append(item.registered.verification_map.ravel())
    return pooled_errors(np.concatenate(error), np.concatenate(visible), np.concatenate(verified))


def _weights_picture(frame: MultiViewFrame, others: Sequence[ViewRegistration]) -> drawing.Canvas:
    names = [view.view_id for view in frame.views]
    left = names.index(frame.left)
    farthest = max(others, key=lambda item: abs(names.index(item.registered.view_id) - left))
    canvas = drawing.diverging(farthest.registered.registration_weights, WEIGHT_LIMIT)
    return drawing.fitted(canvas, 380, 300)


def chapter(rows: Sequence[MethodRow], figures: Sequence[Figure]) -> Chapter:
    """Return Table 1 with its conclusion, and the pictures."""
    plots = [
        Figure(
            scene=scene,
            caption=f"{scene}: share of pixels that are verified.",
            content=spread_bars(
                [row.method for row in rows if row.scene == scene],
                [100 * row.verified for row in rows if row.scene == scene],
                x_label="verified, per cent",
                marked=[row.method == "default" for row in rows if row.scene == scene],
            ),
        )
        for scene in dict.fromkeys(row.scene for row in rows)
    ]
    return Chapter(
        key="registration",
        title="Ways to register (Table 1, Figure 12)",
        question="Which way of cutting and fitting serves these scenes?",
        answer=[
            *_over_scenes(rows),
            *(sentence for scene in dict.fromkeys(row.scene for row in rows)
              for sentence in conclusion([row for row in rows if row.scene == scene])),
        ],
        tables=[("All views onto the left eye; σ_psf 1, noise 1", _table(rows))],
        figures=[*plots, *figures],
        data={"rows": list(rows)},
    )  # fmt: skip


def _over_scenes(rows: Sequence[MethodRow]) -> list[str]:
    """Return how often the default leaves least and verifies most; nothing for one scene."""
    scenes = dict.fromkeys(row.scene for row in rows)
    if len(scenes) < 2:
        return []
    counts = {"least": 0, "most": 0}
    for scene in scenes:
        found = [row for row in rows if row.scene == scene]
        counts["least"] += min(found, key=lambda row: row.median_weight).method == "default"
        counts["most"] += max(found, key=lambda row: row.verified).method == "default"
    return [
        f"The default leaves the least residual on {counts['least']} of {len(scenes)} scenes, and "
        f"verifies most on {counts['most']}."
    ]


def conclusion(rows: Sequence[MethodRow]) -> list[str]:
    """Return, in words, what the rows of one scene say of L, of R and of the default."""
    by_name = {row.method: row for row in rows}
    scene = rows[0].scene
    sentences = []

    def better(first: str, second: str) -> float:
        """Return by what factor the second leaves the larger residual."""
        return by_name[second].median_weight / max(by_name[first].median_weight, 1e-9)

    if {"a", "c", "f", "j"} <= by_name.keys():
        layers, strips = better("f", "a"), better("c", "a")
        both = better("j", "a")
        sentences.append(
            f"{scene}: {_effect('eleven layers', layers)}, {_effect('three strips', strips)}, "
            f"and {_effect('both together', both)}, against one patch for all."
        )
        family = [name for name in "abcdefghjkl" if name in by_name]
        best = min(family, key=lambda name: by_name[name].median_weight)
        row = by_name[best]
        sentences.append(
            f"{scene}: of the thesis' methods {best} leaves the least residual "
            f"(median {row.median_weight:.2f} grey levels): L = {row.layers}, R = {row.subregions} "
            "serve it best."
        )
        if "default" in by_name:
            sentences.append(
                f"{scene}: the default leaves {by_name['default'].median_weight:.2f} and verifies "
                f"{100 * by_name['default'].verified:.1f} % where {best} verifies "
                f"{100 * row.verified:.1f} %."
            )
    if "calibration-only" in by_name and "e" in by_name:
        sentences.append(
            f"{scene}: fitting after calibration (e) takes the residual from "
            f"{by_name['calibration-only'].median_weight:.2f} to "
            f"{by_name['e'].median_weight:.2f} grey levels."
        )
    return sentences


def _effect(what: str, factor: float) -> str:
    if factor > ENOUGH_BETTER:
        return f"{what} lower the residual by {100 * (1 - 1 / factor):.0f} %"
    if factor < 1 / ENOUGH_BETTER:
        return f"{what} raise it by {100 * (1 / factor - 1):.0f} %"
    return f"{what} change it by less than 2 %"


def _table(rows: Sequence[MethodRow]) -> Table:
    return Table(
        head=(
            "scene", "method", "L", "R", "verified %", "with motion %", "median |weight|",
            "RMS weight", "median error px", "95 % error px", "wrong %", "CPU s",
        ),
        rows=tuple(
            (
                row.scene, row.method,
                NOT_MEASURED if row.layers is None else str(row.layers),
                NOT_MEASURED if row.subregions is None else str(row.subregions),
                number(100 * row.verified, 1), number(100 * row.registered, 1),
                number(row.median_weight), number(row.rms_weight),
                *_error_cells(row.errors),
                number(row.cpu_seconds),
            )
            for row in rows
        ),
        left=("method",),
    )  # fmt: skip


def _error_cells(errors: Errors | None) -> tuple[str, str, str]:
    if errors is None:
        return NOT_MEASURED, NOT_MEASURED, NOT_MEASURED
    return (
        number(errors.median_visible, 3), number(errors.error_95, 3),
        number(100 * errors.wrong, 2),
    )  # fmt: skip
