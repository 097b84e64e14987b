"""Plans of subjective tests as files: YAML or JSON, checked when read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import yaml

from dscqs.errors import PlanError, StimulusError
from dscqs.plan import Plan, plan_from_dict, plan_to_dict
from dscqs.stimulus import digest
from pipeline.media.files import write_atomic
from service.stimuli import MANIFEST, read_manifest

HEAD = (
    "# A subjective test (DSCQS). What the fields mean: docs/dscqs.md.\n"
    "# {presentations} presentations, {minutes:.1f} minutes.\n"
)


def read_plan(path: Path) -> Plan:
    """Return the plan of a file, its folder made absolute.

    Raises
    ------
    PlanError
        If the file cannot be read, or a field is wrong; the message names both.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise PlanError(f"{path}: cannot be read: {' '.join(str(error).split())}") from None
    if isinstance(data, Mapping):
        data = {**data, "folder": str((path.parent / str(data.get("folder", "."))).resolve())}
    try:
        return plan_from_dict(data)
    except PlanError as error:
        raise PlanError(f"{path}: {error}") from None


def format_plan(plan: Plan) -> str:
    """Return a plan as YAML; what is as everybody's is left out."""
    said = plan_to_dict(plan)
    usual = {item.name: item.default for item in fields(Plan)}
    timing = {
        item.name: said["timing"][item.name]
        for item in fields(plan.timing)
        if said["timing"][item.name] != item.default
    }
    kept: dict[str, Any] = {
        name: value
        for name, value in {**said, "timing": timing}.items()
        if value not in ({}, []) and getattr(plan, name) != usual[name]
    }
    head = HEAD.format(presentations=plan.presentations, minutes=plan.session_s / 60)
    return head + yaml.safe_dump(kept, sort_keys=False, allow_unicode=True, width=100)


def write_plan(path: Path, plan: Plan) -> None:
    """Write a plan, whole or not at all."""
    write_atomic(path, format_plan(plan).encode())


def find_stimuli(folder: Path) -> tuple[str, dict[str, dict[str, Any]]]:
    """Return the kind of the stimuli of a folder, and what there is by ``content/condition``.

    From ``stimuli.json`` where there is one; otherwise from the names of the files:
    ``CONTENT--CONDITION.png`` (``.webm``), or ``CONTENT/CONDITION.png``.

    Raises
    ------
    StimulusError
        If there is none, or of both kinds.
    """
    if (folder / MANIFEST).exists():
        said = read_manifest(folder)
        return said["kind"], said["stimuli"]
    if not folder.is_dir():
        raise StimulusError(f"{folder}: is no folder")
    found: dict[str, dict[str, Any]] = {}
    suffixes = set()
    for path in sorted([*folder.glob("*--*.*"), *folder.glob("*/*.*")]):
        content, _, condition = path.stem.rpartition("--")
        if not content:
            content, condition = path.parent.name, path.stem
        if path.suffix in (".png", ".webm"):
            suffixes.add(path.suffix)
            name = path.relative_to(folder).as_posix()
            found[f"{content}/{condition}"] = {"file": name, "sha256": digest(path.read_bytes())}
    if len(suffixes) != 1:
        what = "PNG and WebM files" if suffixes else "no CONTENT--CONDITION.png or .webm"
        raise StimulusError(f"{folder}: holds {what}")
    return "still" if suffixes == {".png"} else "video", found
