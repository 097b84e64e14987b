"""Operators: tests, links, progress, actions on sessions, downloads."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Body, Query, Request, Response
from fastapi import Path as InPath
from pydantic import BaseModel, ConfigDict, Field

from dscqs.displays import DisplayProfile, profile_from_dict
from dscqs.plan import plan_from_dict
from dscqs.record import session_log, test_document, vote_table, votes_csv
from dscqs.store import SessionStore, TestRecord
from service.http import dscqs_examples as examples
from service.http.dscqs import ENTRY, Asked, Name
from service.http.dscqs_access import COOKIE, COOKIE_SECONDS, Operating
from service.http.dscqs_folders import folder_of
from service.http.files import BYTES
from service.http.problems import ProblemError, responses

router = APIRouter(prefix="/dscqs/api/operator", tags=["subjective tests: operators"])

TestId = Annotated[str, InPath(max_length=64, examples=[examples.TEST])]
SessionId = Annotated[
    str,
    InPath(
        max_length=64,
        description="its id, or its assessor where they have one session only",
        examples=[examples.SESSION],
    ),
]
DisplayName = Annotated[str, InPath(max_length=64, examples=["polarised"])]


class Login(Asked):
    """What lets an operator in."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"token": "wmqBfg2OPnGU3BwAruLZm5-fkLdUCQO_Vx-6LeiQOH0"}]}
    )

    token: Annotated[str, InPath(max_length=512)]


class Operator(BaseModel):
    """Who is logged in."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"name": "operator"}]})

    name: str


class Invitation(Asked):
    """Whom a link is for."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"assessor": "a1", "display": "polarised", "language": "en"}]
        }
    )

    assessor: Name
    display: Name
    language: Name = "en"


class Invited(BaseModel):
    """A link, which is shown this once."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"link": examples.LINK, "session": examples.SESSION, "dry": False}]
        }
    )

    link: str
    session: str
    dry: bool = False


class GroupInvitation(Asked):
    """Who sits before one screen."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"assessors": ["p1", "p2"], "display": "polarised", "language": "en"}]
        }
    )

    assessors: Annotated[list[Name], Field(max_length=100)]
    display: Name
    language: Name = "en"


class GroupInvited(BaseModel):
    """Links, which are shown this once."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "screen": "/dscqs/pages/enter.html#ATUh08da2zPlP7c66L_zY1XYUW_yWJ1U",
                    "phones": {
                        "p1": "/dscqs/pages/enter.html#UOEXm-MLAU1Aw0ixOIYEG5YYthn7PP-K",
                        "p2": "/dscqs/pages/enter.html#Gbwg0WA2QPi9oVTd09SFLfgO28noOawO",
                    },
                }
            ]
        }
    )

    screen: str
    phones: dict[str, str]


class Made(BaseModel):
    """A test that was made."""

    model_config = ConfigDict(json_schema_extra={"examples": [{"test": examples.TEST}]})

    test: str


class Summary(BaseModel):
    """A test at a glance."""

    model_config = ConfigDict(json_schema_extra={"examples": [examples.SUMMARY]})

    test: str
    name: str
    created: float = Field(description="seconds since the epoch")
    displays: list[str]
    presentations: int
    minutes: float = Field(description="length of a session")


class WithPlan(Summary):
    """A test with its plan."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{**examples.SUMMARY, "plan": examples.PLAN}]}
    )

    plan: dict[str, Any]


class Note(BaseModel):
    """What the page of a session said."""

    at: float = Field(description="seconds since the epoch")
    kind: str
    reason: str


class Progress(BaseModel):
    """Where a session stands."""

    model_config = ConfigDict(json_schema_extra={"examples": [examples.PROGRESS]})

    session: str
    assessor: str
    display: str
    language: str
    role: str
    group: str | None = Field(description="session of the screen")
    stage: str = Field(description="what is shown; `paused` and `withdrawn` among them")
    step: str = Field(description="where it goes on")
    index: int
    total: int
    failed: int = Field(description="showings that failed")
    joined: bool
    last: float | None = Field(description="when something happened [seconds since the epoch]")
    notes: list[Note] = Field(description="the latest")


@router.post("/login", responses=responses(400, 401))
def login(request: Request, response: Response, asked: Login) -> Operator:
    """Turn a token into a cookie that scripts cannot read."""
    operators = request.app.state.operators
    name = operators.name_of(asked.token.strip())
    if name is None:
        raise ProblemError("unauthorized", "the token lets no operator in")
    response.set_cookie(
        COOKIE, operators.cookie(name), httponly=True, samesite="strict", max_age=COOKIE_SECONDS,
        secure=request.url.scheme == "https", path="/dscqs",
    )  # fmt: skip
    return Operator(name=name)


@router.post("/logout", status_code=204)
def logout(response: Response) -> None:
    """Forget the cookie."""
    response.delete_cookie(COOKIE, httponly=True, samesite="strict", path="/dscqs")


@router.get("/whoami", responses=responses(401))
def whoami(name: Operating) -> Operator:
    """Tell who is logged in."""
    return Operator(name=name)


@router.get(
    "/displays",
    responses={
        200: {"content": {"application/json": {"example": examples.DISPLAYS}}},
        **responses(401),
    },
)
def displays(request: Request, name: Operating) -> dict[str, DisplayProfile]:
    """Return the profiles of displays: those that ship, and those calibrated."""
    return dict(request.app.state.desks.real.displays.all())


@router.put(
    "/displays/{display}",
    responses={
        200: {"content": {"application/json": {"example": examples.CALIBRATED}}},
        **responses(400, 401),
    },
)
def calibrate(
    request: Request,
    name: Operating,
    display: DisplayName,
    profile: Annotated[dict[str, Any], Body(examples=[examples.CALIBRATED])],
) -> DisplayProfile:
    """Store the profile of a display; sessions made from now on have it."""
    checked = profile_from_dict(profile)
    request.app.state.desks.real.displays.put(display, checked)
    return checked


@router.get("/tests", responses=responses(401))
def tests(request: Request, name: Operating) -> list[Summary]:
    """List the tests, newest first."""
    records = request.app.state.desks.real.store.tests()
    return [_summary(record) for record in reversed(records)]


@router.post("/tests", status_code=201, responses=responses(400, 401))
def make_test(
    request: Request,
    name: Operating,
    plan: Annotated[dict[str, Any], Body(examples=[examples.PLAN])],
) -> Made:
    """Make a test of a plan; its stimuli are copied, checked and hashed."""
    checked = plan_from_dict(plan)
    source = folder_of(request.app.state.config, checked.folder)
    return Made(test=request.app.state.desks.real.make_test(checked, source).id)


@router.get("/tests/{test}", responses=responses(401, 404))
def show_test(request: Request, name: Operating, test: TestId) -> WithPlan:
    """Return a test with its plan."""
    record = request.app.state.desks.real.store.test(test)
    return WithPlan(**_summary(record).model_dump(), plan=dict(record.plan))


@router.post("/tests/{test}/links", status_code=201, responses=responses(400, 401, 404))
def invite(request: Request, name: Operating, test: TestId, asked: Invitation) -> Invited:
    """Return a link into the session of an assessor; the order is stored here.

    A second link for the same assessor and display goes on with the same session.
    """
    desk = request.app.state.desks.real
    record, link = desk.invite(test, asked.assessor, asked.display, asked.language)
    return Invited(link=f"{ENTRY}{link}", session=record.id)


@router.post("/tests/{test}/groups", status_code=201, responses=responses(400, 401, 404, 409))
def invite_group(
    request: Request, name: Operating, test: TestId, asked: GroupInvitation
) -> GroupInvited:
    """Return links for a group before one screen: the screen's, and each telephone's."""
    desk = request.app.state.desks.real
    screen, phones = desk.invite_group(test, asked.assessors, asked.display, asked.language)
    return GroupInvited(
        screen=f"{ENTRY}{screen}",
        phones={assessor: f"{ENTRY}{link}" for assessor, link in phones.items()},
    )


@router.post(
    "/tests/{test}/dry-run",
    status_code=201,
    responses={
        201: {"content": {"application/json": {"example": examples.DRY_RUN}}},
        **responses(400, 401, 404),
    },
)
def dry_run(request: Request, name: Operating, test: TestId, asked: Invitation) -> Invited:
    """Return a link into a session of which nothing is stored."""
    record, link = request.app.state.desks.dry_run(
        test, asked.assessor, asked.display, asked.language
    )
    return Invited(link=f"{ENTRY}{link}", session=record.id, dry=True)


@router.get("/tests/{test}/progress", responses=responses(401, 404))
def progress(request: Request, name: Operating, test: TestId) -> list[Progress]:
    """Tell where every session stands, and what its page warned of."""
    return [Progress(**view) for view in request.app.state.desks.real.progress(test)]


@router.post("/tests/{test}/sessions/{session}/{action}", responses=responses(400, 401, 404, 409))
def act(
    request: Request,
    name: Operating,
    test: TestId,
    session: SessionId,
    action: Literal["pause", "resume", "withdraw", "erase"],
) -> Progress:
    """Pause, resume or withdraw a session, or erase its forms; the grades stay."""
    desk = request.app.state.desks.real
    return Progress(**desk.act(desk.of_test(test, session), action))


@router.get(
    "/tests/{test}/export",
    response_class=Response,
    responses={
        200: {
            "description": "The file",
            "content": {
                "text/csv": {"schema": {"type": "string"}, "example": examples.VOTES},
                "application/json": {
                    "schema": {"type": "object"},
                    "examples": {
                        "json": {"value": examples.EVERYTHING},
                        "scores": {"value": examples.SCORES},
                        "sujson": {"value": examples.SUJSON},
                        "sureal": {"value": examples.SUREAL},
                    },
                },
                "text/html": BYTES,
                "application/pdf": BYTES,
            },
        },
        **responses(400, 401, 404, 409),
    },
)
def export(
    request: Request,
    name: Operating,
    test: TestId,
    format: Literal["csv", "json", "scores", "html", "pdf", "sujson", "sureal"] = "csv",
    display: Annotated[str | None, Query(max_length=64, examples=["polarised"])] = None,
    dimension: Annotated[str | None, Query(max_length=64, examples=["quality"])] = None,
) -> Response:
    """Return the votes (``csv``, ``sujson``, ``sureal``), everything (``json``), or the scores.

    A dataset of sureal holds one display and one dimension, which have to be named where there
    are several.
    """
    store = request.app.state.desks.real.store
    if format in ("sujson", "sureal"):
        content, ending, media_type = _exchanged(store, test, format, display, dimension)
    else:
        content, ending, media_type = _exported(store, test, format)
    disposition = f'attachment; filename="{test}-{ending}"'
    return Response(content, media_type=media_type, headers={"Content-Disposition": disposition})


def _exported(store: SessionStore, test: str, format: str) -> tuple[str | bytes, str, str]:
    """Return content, end of the file's name, and media type."""
    if format == "csv":
        return votes_csv(store, test), "votes.csv", "text/csv; charset=utf-8"
    if format == "json":
        said = json.dumps(test_document(store, test), indent=1, ensure_ascii=False)
        return said, "everything.json", "application/json"
    from dscqs.report import html_report, json_report, pdf_report

    record = store.test(test)
    table = vote_table(store, record)
    if format == "scores":
        return json_report(table), "scores.json", "application/json"
    log = session_log(test_document(store, test))
    if format == "html":
        report = html_report(table, title=record.name, subtitle=test, log=log)
        return report, "report.html", "text/html; charset=utf-8"
    report = pdf_report(table, title=record.name, subtitle=test, log=log)
    return report, "report.pdf", "application/pdf"


def _exchanged(
    store: SessionStore, test: str, format: str, display: str | None, dimension: str | None
) -> tuple[str | bytes, str, str]:
    """Return content, end of the file's name, and media type, in a format of others."""
    from dscqs.exchange.files import Format, format_scores

    record = store.test(test)
    table = vote_table(store, record)
    said = format_scores(table, Format(format), display=display, dimension=dimension)
    which = "".join(f"{one}-" for one in (display, dimension) if one)
    return said, f"{which}{format}.json", "application/json"


def _summary(record: TestRecord) -> Summary:
    plan = plan_from_dict(record.plan)
    return Summary(
        test=record.id,
        name=record.name,
        created=record.created,
        displays=list(plan.displays),
        presentations=plan.presentations,
        minutes=round(plan.session_s / 60, 1),
    )
