"""The bars of quality, all of them, measured in one go."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.config import Settings
from pipeline.degradation import Degradation
from pipeline.errors import ConfigurationError
from pipeline.evaluation import cells, rendered
from pipeline.evaluation.floors import (
    PSF_SCENES,
    Verdict,
    psf_floors,
    rendered_floors,
    set1_floors,
)
from pipeline.evaluation.sensitivity import measure_estimate, remark_of_one_view
from pipeline.evaluation.subjects import SAMPLE, open_subject
from pipeline.report import versions

FORMAT = "depthsr-bars/1"
"""Value of the key ``format`` of the JSON file."""


def measure_bars(
    folder: Path,
    settings: Settings,
    *,
    note: Callable[[str], None] = lambda _: None,
    scenes: Sequence[str] = cells.SCENES,
    cases: Sequence[rendered.Case] = rendered.CASES,
    psf_scenes: Sequence[str] = PSF_SCENES,
) -> list[Verdict]:
    """Return a verdict for each bar; aims, which are no bars, are left out.

    Parameters
    ----------
    folder : Path
        Of the real scenes.
    settings : Settings
        Only grid and PSF are set here.

    Raises
    ------
    ConfigurationError
        If a scene is missing.
    """
    missing = [scene for scene in scenes if not (folder / scene).is_dir()]
    if missing:
        raise ConfigurationError(f"{folder}: holds no scene {', '.join(missing)}")
    found = []
    for scene in scenes:
        frame = cells.read_scene(folder, scene)
        for sigma, noise in cells.conditions():
            note(f"{scene}, σ_psf {sigma:g}, noise {noise:g}")
            found.append(cells.measure_cell(frame, scene, sigma, noise, settings))
    verdicts = set1_floors(found)
    for case in cases:
        measured = rendered.measure_case(case, case.scene(), settings, note)
        verdicts += rendered_floors(measured.judged, case.counts)
    verdicts += _psf_verdicts(folder, settings, psf_scenes, note)
    return [verdict for verdict in verdicts if not verdict.floor.startswith("aim:")]


def _psf_verdicts(
    folder: Path, settings: Settings, scenes: Sequence[str], note: Callable[[str], None]
) -> list[Verdict]:
    found = []
    subjects = [open_subject(s if s == SAMPLE else str(folder / s), settings) for s in scenes]
    for subject in subjects:
        for sigma, noise in cells.conditions():
            note(f"{subject.name}, σ_psf {sigma:g}, noise {noise:g}, estimated")
            degradation = Degradation(psf_sigma=sigma, noise_sigma=noise)
            found.append(measure_estimate(subject, degradation))
    return psf_floors(found, remark_of_one_view(subjects[0], degradation))


def bars_record(verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return the verdicts as a record for JSON."""
    return {
        "format": FORMAT,
        "versions": versions(),
        "met": all(verdict.met for verdict in verdicts),
        "bars": [asdict(verdict) for verdict in verdicts],
    }
