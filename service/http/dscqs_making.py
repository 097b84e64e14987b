"""Operators make tests: stimuli under the roots, templates, plans tried before they are kept."""

from __future__ import annotations

import dataclasses
import io
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import segno
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from dscqs.errors import DscqsError
from dscqs.plan import DIMENSIONS, RANGES, STAGES, Plan, Timing, plan_to_dict
from dscqs.templates import TEMPLATES, make_plan
from service.http.dscqs import Asked, Name
from service.http.dscqs_access import Operating
from service.http.dscqs_folders import folder_of
from service.http.problems import ProblemError, responses
from service.plan_files import find_stimuli
from service.stimuli import MANIFEST

router = APIRouter(prefix="/dscqs/api/operator", tags=["subjective tests: operators"])

DEEPEST = 4
"""Folders below a root that are searched for stimuli."""

MOST = 200
"""Folders that are listed."""


class Number(BaseModel):
    """A number of a plan: as it usually is, its least and most, and whether it is whole."""

    usual: float
    least: float
    most: float
    whole: bool


class Making(BaseModel):
    """What tests can be made of."""

    templates: dict[str, dict[str, Any]]
    dimensions: list[str]
    stages: list[str]
    numbers: dict[str, Number]
    displays: dict[str, str]
    calibrated: list[str]
    folders: list[dict[str, Any]]


class Wanted(Asked):
    """A plan as the operator describes it; what is left out is as usual."""

    folder: Annotated[str, Field(max_length=1024)]
    template: Name
    name: Annotated[str, Field(max_length=200)] = ""
    training: list[Name] = Field(default_factory=list)
    fields: dict[str, Any] = Field(default_factory=dict)


class Planned(BaseModel):
    """A plan, and how long a session of it lasts."""

    plan: dict[str, Any]
    presentations: int
    minutes: float


class Text(Asked):
    """What a code says."""

    text: Annotated[str, Field(min_length=1, max_length=500)]


@router.get("/making", responses=responses(401))
def making(request: Request, name: Operating) -> Making:
    """List templates, dimensions, displays, and the folders of stimuli under the roots."""
    profiles = request.app.state.desks.real.displays.all()
    return Making(
        templates={
            key: {
                "title": one.title, "reference": one.reference, "conditions": list(one.conditions),
            }
            for key, one in TEMPLATES.items()
        },
        dimensions=list(DIMENSIONS),
        stages=list(STAGES),
        numbers=_numbers(),
        displays={key: profile.title for key, profile in profiles.items()},
        calibrated=[key for key, profile in profiles.items() if profile.calibrated],
        folders=[
            found
            for root in request.app.state.config.roots
            for found in _folders_of(root.resolve())
        ][:MOST],
    )  # fmt: skip


@router.post("/plans", responses=responses(400, 401))
def try_plan(request: Request, name: Operating, asked: Wanted) -> Planned:
    """Return the plan that a template gives over a folder; nothing is stored."""
    template = TEMPLATES.get(asked.template)
    if template is None:
        raise ProblemError("bad-request", f"template: must be one of {', '.join(TEMPLATES)}")
    folder = folder_of(request.app.state.config, asked.folder)
    kind, stimuli = find_stimuli(folder)
    fields = {
        "reference": template.reference, "conditions": list(template.conditions), "kind": kind,
        "folder": str(folder), "name": asked.name or template.title, **asked.fields,
    }  # fmt: skip
    conditions, reference = fields.pop("conditions"), fields.pop("reference")
    plan = make_plan(
        stimuli, reference=reference, conditions=conditions, training=asked.training, **fields
    )
    return Planned(
        plan=plan_to_dict(plan), presentations=plan.presentations,
        minutes=round(plan.session_s / 60, 1),
    )  # fmt: skip


@router.post(
    "/codes",
    response_class=Response,
    responses={200: {"content": {"image/svg+xml": {}}}, **responses(400, 401)},
)
def code(name: Operating, asked: Text) -> Response:
    """Return a link as a QR code, for telephones."""
    drawn = io.BytesIO()
    segno.make(asked.text, error="m").save(drawn, kind="svg", scale=4, border=4, light="white")
    return Response(drawn.getvalue(), media_type="image/svg+xml")


def _numbers() -> dict[str, Number]:
    usual: dict[str, Any] = {item.name: item.default for item in dataclasses.fields(Plan)}
    usual |= {f"timing.{item.name}": item.default for item in dataclasses.fields(Timing)}
    return {
        name: Number(usual=usual[name], least=least, most=most, whole=isinstance(least, int))
        for name, (least, most) in RANGES.items()
    }


def _folders_of(root: Path) -> Iterator[dict[str, Any]]:
    for where, names, files in os.walk(root):
        folder = Path(where)
        names[:] = sorted(name for name in names if not name.startswith("."))
        if len(folder.relative_to(root).parts) >= DEEPEST:
            names[:] = []
        named = any("--" in name and name.endswith((".png", ".webm")) for name in files)
        if MANIFEST not in files and not named:
            continue
        try:
            kind, stimuli = find_stimuli(folder)
        except (DscqsError, OSError):  # a folder that cannot be used is not offered
            continue
        yield {
            "folder": str(folder),
            "label": folder.relative_to(root.parent).as_posix(),
            "kind": kind,
            "contents": _firsts(key.split("/")[0] for key in stimuli),
            "conditions": _firsts(key.split("/")[1] for key in stimuli),
        }


def _firsts(names: Iterator[str]) -> list[str]:
    return list(dict.fromkeys(names))
