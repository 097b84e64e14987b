"""Assessors: their link, their session, and nothing but their own next presentation.

The protocol is described in ``docs/dscqs-api.md``.
"""

from __future__ import annotations

import base64
import hashlib
import json
from functools import cached_property
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Request, Response
from fastapi import Path as InPath
from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from dscqs.desk import Desk
from dscqs.displays import DisplayProfile, profile_from_dict
from dscqs.plan import Timing
from service.desks import Desks
from service.http import dscqs_examples as examples
from service.http.files import BYTES
from service.http.problems import responses

router = APIRouter(prefix="/dscqs", tags=["subjective tests: assessors"])

COOKIE = "dscqs_assessor"
LARGEST = 65536
"""Of what a page may say of a form, a showing or an event [bytes of JSON]."""

STIMULUS = "/dscqs/api/assessor/stimulus/"

ENTRY = "/dscqs/pages/enter.html#"
"""Before the secret of a link. What follows the # is sent to nobody: the page sends it, when the
assessor says so, so that programs that look at links ahead use none up."""

Secret = Annotated[
    str,
    InPath(
        max_length=64,
        description="as `sides` of the presentation says",
        examples=["ShzQ8_IXqppFVdkEvkXC6TXleCSw5wMR"],
    ),
]
Name = Annotated[str, Field(max_length=64)]


class Asked(BaseModel):
    """What a page sends; a field that is not known is an error."""

    model_config = ConfigDict(extra="forbid", strict=True)


class Entry(Asked):
    """A link that is opened, and a secret by which its browser is known again."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "link": examples.LINK.partition("#")[2],
                    "browser": "8027f0b37a6d462f8d25ba6acd85bd67",
                }
            ]
        }
    )

    link: Name
    browser: Annotated[str, Field(min_length=16, max_length=64)]


class Continue(Asked):
    """Which stage is left."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"stage": "instructions"}]})

    stage: Name


def _small(value: dict[str, Any]) -> dict[str, Any]:
    if len(json.dumps(value)) > LARGEST:
        raise ValueError(f"has more than {LARGEST} bytes")
    return value


Said = Annotated[dict[str, Any], AfterValidator(_small)]


class Form(Asked):
    """The answers of a form."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "stage": "screening",
                    "answers": {
                        "correction": "glasses",
                        "acuity": {"by": "operator", "decimal": 1.0},
                        "colour": {"by": "nobody"},
                    },
                }
            ]
        }
    )

    stage: Name
    answers: Said


class HowShown(Asked):
    """How a presentation went."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"ticket": examples.TICKET, "outcome": "ok", "log": examples.LOG}]
        }
    )

    ticket: Name
    outcome: Literal["ok", "failed"]
    log: Said = {}


class GradesSent(Asked):
    """A vote."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "ticket": examples.TICKET,
                    "submission": examples.SUBMISSION,
                    "grades": examples.GRADES,
                }
            ]
        }
    )

    ticket: Name
    submission: Name
    grades: Said


class NoteSent(Asked):
    """Something for the audit trail."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"kind": "display", "detail": {"codes": ["odd-ratio"]}}]}
    )

    kind: Name
    detail: Said = {}


class State(BaseModel):
    """Where the session stands."""

    model_config = ConfigDict(extra="allow", json_schema_extra={"examples": [examples.STATE]})

    stage: str
    index: int
    total: int
    language: str
    display: str
    dimensions: list[str]
    variant: str
    showings: int
    role: str


class Presentation(BaseModel):
    """A presentation to show."""

    model_config = ConfigDict(json_schema_extra={"examples": [examples.PRESENTATION]})

    ticket: str
    kind: str
    layout: str
    sides: dict[str, str] = Field(description="addresses, each of which works once")
    variant: str
    grey: int
    captions: bool
    timing: Timing
    dimensions: list[str]
    labels: list[str] = Field(description="of the fifths of the scale, best first")


class Assessor:
    """Who asks: the desk that conducts their session, and which session their cookie lets in.

    Dry runs have a desk of their own.
    """

    def __init__(self, request: Request) -> None:
        self._cookie = request.cookies.get(COOKIE)
        self.desk: Desk = request.app.state.desks.of(self._cookie or "")

    @cached_property
    def session(self) -> str:
        """Id of the session; asked for in the thread of the request, since the disk may know it."""
        return self.desk.identify(self._cookie)


async def _assessor(request: Request) -> Assessor:
    return Assessor(request)


Asking = Annotated[Assessor, Depends(_assessor)]


@router.post("/api/assessor/enter", status_code=204, responses=responses(400, 404, 410))
def enter(request: Request, response: Response, asked: Entry) -> None:
    """Open a link: it works in one browser, and sets the cookie of the session."""
    desks: Desks = request.app.state.desks
    cookie = desks.cookie(asked.link, asked.browser)
    desks.of(asked.link).enter(asked.link, cookie)
    response.set_cookie(
        COOKIE, cookie, httponly=True, samesite="strict", secure=request.url.scheme == "https",
        path="/dscqs",
    )  # fmt: skip


@router.get("/api/assessor/state", responses=responses(401))
def state(asking: Asking) -> State:
    """Tell where the session stands."""
    return State(**asking.desk.state(asking.session))


@router.get(
    "/api/assessor/display",
    responses={
        200: {"content": {"application/json": {"example": examples.DISPLAY}}},
        **responses(401),
    },
)
def display(asking: Asking) -> DisplayProfile:
    """Return the profile of the session's display, as it was when the session was made."""
    return profile_from_dict(asking.desk.display(asking.session))


@router.post("/api/assessor/continue", responses=responses(400, 401, 409))
def proceed(asking: Asking, asked: Continue) -> State:
    """Leave a stage that asks for nothing more."""
    return State(**asking.desk.proceed(asking.session, asked.stage))


@router.post("/api/assessor/forms", responses=responses(400, 401, 409))
def fill(asking: Asking, asked: Form) -> State:
    """Store the answers of a form and go on."""
    return State(**asking.desk.fill(asking.session, asked.stage, asked.answers))


@router.get("/api/assessor/presentation", responses=responses(401, 409, 500))
def present(asking: Asking) -> Presentation:
    """Give out the presentation to show, under a new ticket; earlier tickets end."""
    view = asking.desk.present(asking.session)
    sides = {side: f"{STIMULUS}{token}" for side, token in view["sides"].items()}
    return Presentation(**{**view, "sides": sides})


@router.get(
    "/api/assessor/stimulus/{token}",
    response_class=Response,
    responses={
        200: {
            "description": "The picture or the clip",
            "content": {"image/png": BYTES, "video/webm": BYTES},
            "headers": {
                "Repr-Digest": {
                    "schema": {"type": "string"},
                    "description": "SHA-256 of the bytes (RFC 9530)",
                }
            },
        },
        **responses(401, 410),
    },
)
def stimulus(asking: Asking, token: Secret) -> Response:
    """Return the bytes of one side, once; no two answers have the same bytes."""
    data, media_type = asking.desk.side(asking.session, token)
    digest = base64.b64encode(hashlib.sha256(data).digest()).decode()
    return Response(data, media_type=media_type, headers={"Repr-Digest": f"sha-256=:{digest}:"})


@router.post("/api/assessor/shown", responses=responses(400, 401, 409))
def shown(asking: Asking, asked: HowShown) -> State:
    """Store how a presentation went; one that failed is offered again."""
    return State(**asking.desk.shown(asking.session, asked.ticket, asked.outcome, asked.log))


@router.post("/api/assessor/grades", responses=responses(400, 401, 409))
def grade(asking: Asking, asked: GradesSent) -> State:
    """Store a vote; the answer comes when it is on the disk."""
    return State(**asking.desk.grade(asking.session, asked.ticket, asked.submission, asked.grades))


@router.post("/api/assessor/events", status_code=204, responses=responses(400, 401))
def note(asking: Asking, asked: NoteSent) -> None:
    """Add to the audit trail."""
    asking.desk.note(asking.session, asked.kind, asked.detail)
