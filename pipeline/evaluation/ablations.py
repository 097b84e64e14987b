"""What each piece of the method is worth: taken away in turn, in dB and in processor time.

The left eye at one degradation. The pieces are switched where they are joined, by the
functions that :func:`pipeline.superresolve.superresolve` itself calls.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np

from pipeline.config import Settings
from pipeline.degradation import Degradation, DegradedFrame
from pipeline.evaluate import BORDER, settings_of
from pipeline.evaluation.elements import Chapter, Figure
from pipeline.evaluation.methods import Accounted, accounted, middle_views
from pipeline.evaluation.plots import lines, spread_bars
from pipeline.evaluation.subjects import Subject
from pipeline.evaluation.tables import Table, number, signed
from pipeline.frames import MultiViewFrame, RegisteredView
from pipeline.metrics import psnr
from pipeline.noise import estimate_noise_of_views
from pipeline.reconstruction.fused import FusedTuning, finished, fuse
from pipeline.registration.method import METHODS, MotionModel, RegistrationMethod
from pipeline.registration.register import prepare_views, register_views
from pipeline.superresolve import (
    chosen_filters,
    default_residual_threshold,
    given_psf,
    terms_of,
)
from pipeline.worker import Worker

DEGRADATION = Degradation(psf_sigma=1.0, noise_sigma=2.0)
"""Aliasing and noise: there is something to gain from the other views."""

WHOLE = "everything"
STRIPS = "strips for windows"
"""The thesis' best layout."""
LONGEST_BAR = 3.0
"""Of the plot of losses, dB; longer ones are cut off, and say how long they are."""
NO_LIMIT = 1e6
"""Prediction error that is tolerated where weights are off, grey levels."""


@dataclass(frozen=True, kw_only=True)
class Variant:
    """The method with one piece changed."""

    name: str
    method: RegistrationMethod = METHODS["default"]
    tuning: FusedTuning = field(default_factory=FusedTuning)
    trust_all: bool = False
    """Every pixel that has a motion counts as verified."""
    calibration: bool = True
    """False: the cameras' calibration is withheld."""
    filters: str = "learned"
    """As of the settings."""
    num_views: int | None = None
    """So many views around the stereo pair; None: all. 1: the left eye alone."""


@dataclass(frozen=True, kw_only=True)
class AblationRow:
    """One variant on one scene."""

    scene: str
    group: str
    """What is varied: piece, views, or patches."""
    name: str
    psnr: float
    """Left eye, dB."""
    cpu_seconds: float
    """Of all threads."""


def pieces() -> list[Variant]:
    """Return the method whole, and with each piece off."""
    strips, tuning = METHODS["h"], FusedTuning()
    return [
        Variant(name=WHOLE),
        Variant(
            name="no agreement weights", tuning=replace(tuning, agreement=(NO_LIMIT, 0.0))
        ),
        Variant(name="no learned filters", filters="none"),
        Variant(name="landing points not corrected", tuning=replace(tuning, corrections=0)),
        Variant(name="no prior", tuning=replace(tuning, prior_strength=1e-6)),
        Variant(
            name="no prior, stopped early",
            tuning=replace(tuning, prior_strength=1e-6, alone=3.0, together=4, stretch=None),
        ),
        Variant(name="no verification", trust_all=True),
        Variant(
            name="no weights, no verification", trust_all=True,
            tuning=replace(tuning, agreement=(NO_LIMIT, 0.0)),
        ),
        Variant(name=STRIPS, method=strips),
        Variant(
            name=f"{STRIPS}, translation for affine",
            method=replace(strips, model=MotionModel.TRANSLATION),
        ),
        Variant(
            name="translation for affine",
            method=replace(METHODS["default"], model=MotionModel.TRANSLATION),
        ),
        Variant(name="no calibration", calibration=False),
    ]  # fmt: skip


def cuts() -> list[Variant]:
    """Return the thesis' strips at several L and R (method h of Table 1: by layer, then patch)."""
    base = METHODS["h"]
    return [
        Variant(
            name=f"L = {layers}, R = {strips}",
            method=replace(base, num_layers=layers, num_subregions=strips),
        )
        for layers in (1, 4, 11, 22)
        for strips in (1, 3, 6)
    ]


def measure_ablations(
    subject: Subject, *, note: Callable[[str], None] = lambda _: None
) -> list[AblationRow]:
    """Return the rows of one scene."""
    degraded = subject.degraded(DEGRADATION)
    settings = settings_of(DEGRADATION, subject.settings)
    calibrated = all(view.calibration is not None for view in degraded.frame.views)
    counts = [count for count in (1, 2, 4, 8) if count <= len(subject.view_ids)]
    if len(subject.view_ids) > counts[-1]:
        counts.append(len(subject.view_ids))
    groups = {
        "piece": [v for v in pieces() if calibrated or v.calibration],
        "views": [Variant(name=str(count), num_views=count) for count in counts],
        "patches": cuts(),
    }
    rows = []
    left = subject.eyes[0]
    registrations: dict[object, Accounted[_Registered]] = {}
    for group, variants in groups.items():
        for variant in variants:
            note(f"{subject.name}: {variant.name}" + (" views" if group == "views" else ""))
            frame = _seen_by(degraded.frame, variant, left)
            alike = (variant.method, variant.calibration, len(frame.views))
            if alike not in registrations:
                registrations[alike] = accounted(partial(_registered, frame, left, variant.method))
            registered = registrations[alike]
            made = accounted(partial(_fused, registered.result, settings, variant))
            eight_bit = np.clip(np.rint(made.result), 0, 255)
            rows.append(
                AblationRow(
                    scene=subject.name, group=group, name=variant.name,
                    psnr=psnr(eight_bit, degraded.truth[left], border=BORDER),
                    cpu_seconds=registered.cpu_seconds + made.cpu_seconds,
                )
            )  # fmt: skip
    return rows


def _seen_by(frame: MultiViewFrame, variant: Variant, left: str) -> MultiViewFrame:
    if variant.num_views == 1:
        frame = replace(frame, views=(frame.view(left),))
    elif variant.num_views is not None:
        frame = middle_views(frame, variant.num_views)
    if variant.calibration:
        return frame
    bare = tuple(replace(view, calibration=None) for view in frame.views)
    return replace(frame, views=bare, depth_is_metric=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Registered:
    """All views of a frame onto the left eye."""

    views: Sequence[RegisteredView]
    lr_shape: tuple[int, int]
    noise: float


def _registered(frame: MultiViewFrame, left: str, method: RegistrationMethod) -> _Registered:
    noise = estimate_noise_of_views(frame.views)
    prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
    found = register_views(
        prepared,
        [left],
        [view.view_id for view in frame.views],
        replace(terms_of(Settings(), noise), method=method),
    )[left]
    return _Registered(
        views=[item.registered for item in found], lr_shape=frame.lr_shape, noise=noise
    )


def _fused(registered: _Registered, settings: Settings, variant: Variant) -> np.ndarray:
    noise = registered.noise
    views = registered.views
    if variant.trust_all:
        views = [_believed(view) for view in views]
    psf = given_psf(settings)
    learned = chosen_filters(replace(settings, filters=variant.filters), psf, noise)
    result = fuse(
        views, settings.grid, registered.lr_shape, psf, noise=noise,
        residual_threshold=NO_LIMIT if variant.trust_all else default_residual_threshold(noise),
        tuning=variant.tuning, learned=learned,
    )  # fmt: skip
    return finished(result, learned)


def _believed(view: RegisteredView) -> RegisteredView:
    """Return the view with every pixel trusted that has a motion."""
    has_motion = np.isfinite(view.position).all(axis=-1)
    return replace(view, flags=np.where(has_motion, 0, view.flags).astype(np.uint8))


@dataclass(frozen=True, kw_only=True)
class WarmRow:
    """One frame of a video, cold and from the frame before."""

    scene: str
    frame_index: int
    cold_psnr: float
    warm_psnr: float
    """Left eye, dB."""
    cold_cpu_seconds: float
    warm_cpu_seconds: float
    """Of all threads."""


def measure_warm(
    name: str,
    frames: Sequence[DegradedFrame],
    settings: Settings,
    eyes: tuple[str, str],
    *,
    note: Callable[[str], None] = lambda _: None,
) -> list[WarmRow]:
    """Return a row for each frame after the first: both eyes, each way."""
    workers = {
        way: Worker(replace(settings, temporal=way), targets=eyes) for way in ("cold", "warm")
    }
    rows = []
    for degraded in frames:
        values, seconds = {}, {}
        for way, worker in workers.items():
            note(f"{name}, frame {degraded.frame.frame_index}: {way}")
            begin = time.process_time()
            result = worker.take(degraded.frame)
            seconds[way] = time.process_time() - begin
            eight_bit = np.clip(np.rint(result.images[eyes[0]].luma), 0, 255)
            values[way] = psnr(eight_bit, degraded.truth[eyes[0]], border=BORDER)
        rows.append(
            WarmRow(
                scene=name, frame_index=degraded.frame.frame_index,
                cold_psnr=values["cold"], warm_psnr=values["warm"],
                cold_cpu_seconds=seconds["cold"], warm_cpu_seconds=seconds["warm"],
            )
        )  # fmt: skip
    return rows[1:]


def chapter(rows: Sequence[AblationRow], warm: Sequence[WarmRow]) -> Chapter:
    """Return what each piece is worth."""
    tables = [
        ("Each piece off in turn: PSNR of the left eye, σ_psf 1, noise 2", _piece_table(rows)),
        ("Number of views", _pivot(rows, "views", "views")),
        ("The thesis' strips (method h): layers and sub-regions", _pivot(rows, "patches", "")),
    ]
    if warm:
        tables.append(("Warm start: each frame from the one before", _warm_table(warm)))
    figures = []
    for scene in dict.fromkeys(row.scene for row in rows):
        whole = next(row for row in rows if row.scene == scene and row.name == WHOLE)
        off = [
            row for row in rows if row.scene == scene and row.group == "piece" and row.name != WHOLE
        ]
        figures.append(
            Figure(
                scene=scene,
                caption=f"{scene}: what is lost without a piece.",
                content=spread_bars(
                    [row.name for row in off], [whole.psnr - row.psnr for row in off],
                    x_label="lost, dB (left of zero: gained)", longest=LONGEST_BAR,
                ),
            )
        )  # fmt: skip
    by_views = {
        scene: (
            [float(row.name) for row in rows if row.scene == scene and row.group == "views"],
            [row.psnr for row in rows if row.scene == scene and row.group == "views"],
        )
        for scene in dict.fromkeys(row.scene for row in rows)
    }
    figures.append(
        Figure(
            caption="PSNR of the left eye over the number of views.",
            content=lines(by_views, x_label="views", y_label="PSNR, dB"),
        )
    )
    return Chapter(
        key="ablations",
        title="What each piece is worth",
        question="Why is it better, and what would be lost without?",
        answer=_answer(rows),
        tables=tables,
        figures=figures,
        data={"rows": list(rows), "warm": list(warm)},
    )


def _answer(rows: Sequence[AblationRow]) -> list[str]:
    sentences = []
    changes: dict[str, list[float]] = {}
    whole_of = {row.scene: row.psnr for row in rows if row.name == WHOLE}
    for row in rows:
        if row.group == "piece" and row.name != WHOLE:
            changes.setdefault(row.name, []).append(row.psnr - whole_of[row.scene])
    if len(whole_of) > 1:
        means = sorted((float(np.mean(found)), name) for name, found in changes.items())
        named = "; ".join(f"{name} {signed(mean)}" for mean, name in means)
        sentences.append(f"In the mean over the scenes that allow it, in dB: {named}.")
    for scene in dict.fromkeys(row.scene for row in rows):
        of_scene = [row for row in rows if row.scene == scene]
        whole = next(row for row in of_scene if row.name == WHOLE)
        lost = {
            row.name: whole.psnr - row.psnr
            for row in of_scene
            if row.group == "piece" and row.name != WHOLE
        }
        if lost:
            dearest_first = sorted(lost, key=lambda name: -lost[name])
            named = "; ".join(f"{name} {signed(-lost[name])}" for name in dearest_first)
            sentences.append(f"{scene}: what a change makes of {whole.psnr:.2f} dB: {named}.")
        views = [row for row in of_scene if row.group == "views"]
        if len(views) > 1:
            steps = ", ".join(
                f"{few.name} → {many.name}: {signed(many.psnr - few.psnr)}"
                for few, many in pairwise(views)
            )
            sentences.append(f"{scene}: more views bring, in dB, {steps}.")
    return sentences


def _piece_table(rows: Sequence[AblationRow]) -> Table:
    found = [row for row in rows if row.group == "piece"]
    whole = {row.scene: row for row in found if row.name == WHOLE}
    return Table(
        head=("scene", "variant", "PSNR dB", "against everything", "CPU s"),
        rows=tuple(
            (
                row.scene, row.name, number(row.psnr), signed(row.psnr - whole[row.scene].psnr),
                number(row.cpu_seconds),
            )
            for row in found
        ),
        left=("variant",),
    )  # fmt: skip


def _pivot(rows: Sequence[AblationRow], group: str, noun: str) -> Table:
    """Return PSNR and processor time with a scene a row and a variant a column."""
    found = [row for row in rows if row.group == group]
    names = list(dict.fromkeys(row.name for row in found))
    by_key = {(row.scene, row.name): row for row in found}
    scenes = list(dict.fromkeys(row.scene for row in found))
    heads = [f"{name} {noun}".strip() if name != "1" or not noun else "1 view" for name in names]
    return Table(
        head=("scene", *heads),
        rows=tuple(
            (
                scene,
                *(
                    f"{row.psnr:.2f} dB, {row.cpu_seconds:.1f} s" if row is not None else "–"
                    for row in (by_key.get((scene, name)) for name in names)
                ),
            )
            for scene in scenes
        ),
    )


def _warm_table(rows: Sequence[WarmRow]) -> Table:
    return Table(
        head=("scene", "frame", "cold dB", "warm dB", "difference", "cold CPU s", "warm CPU s"),
        rows=tuple(
            (
                row.scene, str(row.frame_index), number(row.cold_psnr), number(row.warm_psnr),
                signed(row.warm_psnr - row.cold_psnr, 3), number(row.cold_cpu_seconds),
                number(row.warm_cpu_seconds),
            )
            for row in rows
        ),
    )  # fmt: skip
