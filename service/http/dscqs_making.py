"""Operators make tests: stimuli under the roots, templates, plans tried before they are kept."""

from __future__ import annotations

import dataclasses
import io
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import segno
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, ConfigDict, Field

from dscqs.displays import DisplayProfile, shipped_profiles
from dscqs.errors import DscqsError
from dscqs.plan import DIMENSIONS, RANGES, STAGES, Plan, Timing, plan_to_dict
from dscqs.templates import TEMPLATES, Template, make_plan
from service.http import dscqs_examples as examples
from service.http.dscqs import Asked, Name
from service.http.dscqs_access import Operating
from service.http.dscqs_folders import folder_of
from service.http.files import BYTES
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


class Stimuli(BaseModel):
    """A folder of stimuli under a root."""

    folder: str
    label: str
    kind: str
    contents: list[str]
    conditions: list[str]


class Making(BaseModel):
    """What tests can be made of."""

    templates: dict[str, Template]
    dimensions: list[str]
    stages: list[str]
    numbers: dict[str, Number]
    displays: dict[str, str]
    calibrated: list[str]
    folders: list[Stimuli]


class Wanted(Asked):
    """A plan as the operator describes it; what is left out is as usual."""

    model_config = ConfigDict(json_schema_extra={"examples": [examples.WANTED]})

    folder: Annotated[str, Field(max_length=1024)]
    template: Name
    name: Annotated[str, Field(max_length=200)] = ""
    training: list[Name] = Field(default_factory=list)
    fields: dict[str, Any] = Field(default_factory=dict)


class Planned(BaseModel):
    """A plan, and how long a session of it lasts."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"plan": examples.PLAN, **examples.LENGTH}]}
    )

    plan: dict[str, Any]
    presentations: int
    minutes: float


class Text(Asked):
    """What a code says."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"text": f"https://lab.example{examples.LINK}"}]}
    )

    text: Annotated[str, Field(min_length=1, max_length=500)]


def _making(profiles: Mapping[str, DisplayProfile], folders: list[Stimuli]) -> Making:
    return Making(
        templates=dict(TEMPLATES),
        dimensions=list(DIMENSIONS),
        stages=list(STAGES),
        numbers=_numbers(),
        displays={key: profile.title for key, profile in profiles.items()},
        calibrated=[key for key, profile in profiles.items() if profile.calibrated],
        folders=folders,
    )


def _numbers() -> dict[str, Number]:
    usual: dict[str, Any] = {item.name: item.default for item in dataclasses.fields(Plan)}
    usual |= {f"timing.{item.name}": item.default for item in dataclasses.fields(Timing)}
    return {
        name: Number(usual=usual[name], least=least, most=most, whole=isinstance(least, int))
        for name, (least, most) in RANGES.items()
    }


EXAMPLE = _making(shipped_profiles(), [Stimuli(**examples.STIMULI)]).model_dump(mode="json")


@router.get(
    "/making",
    responses={
        200: {"content": {"application/json": {"example": EXAMPLE}}},
        **responses(401),
    },
)
def making(request: Request, name: Operating) -> Making:
    """List templates, dimensions, displays, and the folders of stimuli under the roots."""
    folders = (
        found for root in request.app.state.config.roots for found in _folders_of(root.resolve())
    )
    profiles = request.app.state.desks.real.displays.all()
    return _making(profiles, list(folders)[:MOST])


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
    responses={
        200: {"description": "The picture", "content": {"image/svg+xml": BYTES}},
        **responses(400, 401),
    },
)
def code(name: Operating, asked: Text) -> Response:
    """Return a link as a QR code, for telephones."""
    drawn = io.BytesIO()
    segno.make(asked.text, error="m").save(drawn, kind="svg", scale=4, border=4, light="white")
    return Response(drawn.getvalue(), media_type="image/svg+xml")


def _folders_of(root: Path) -> Iterator[Stimuli]:
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
        yield Stimuli(
            folder=str(folder),
            label=folder.relative_to(root.parent).as_posix(),
            kind=kind,
            contents=_firsts(key.split("/")[0] for key in stimuli),
            conditions=_firsts(key.split("/")[1] for key in stimuli),
        )


def _firsts(names: Iterator[str]) -> list[str]:
    return list(dict.fromkeys(names))
