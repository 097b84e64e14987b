"""Operators: tests, links, progress, actions on sessions, downloads."""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Request, Response
from fastapi import Path as InPath
from pydantic import BaseModel, Field

from dscqs.displays import profile_from_dict
from dscqs.plan import plan_from_dict
from dscqs.record import session_log, test_document, vote_table, votes_csv
from dscqs.store import SessionStore
from service.http.dscqs import ENTRY, Asked, Name
from service.http.dscqs_access import COOKIE, COOKIE_SECONDS, Operating
from service.http.dscqs_folders import folder_of
from service.http.problems import ProblemError, responses

router = APIRouter(prefix="/dscqs/api/operator", tags=["subjective tests: operators"])

Id = Annotated[str, InPath(max_length=64)]


class Login(Asked):
    """What lets an operator in."""

    token: Annotated[str, InPath(max_length=512)]


class Operator(BaseModel):
    """Who is logged in."""

    name: str


class Invitation(Asked):
    """Whom a link is for."""

    assessor: Name
    display: Name
    language: Name = "en"


class Invited(BaseModel):
    """A link, which is shown this once."""

    link: str
    session: str
    dry: bool = False


class GroupInvitation(Asked):
    """Who sits before one screen."""

    assessors: Annotated[list[Name], Field(max_length=100)]
    display: Name
    language: Name = "en"


class GroupInvited(BaseModel):
    """Links, which are shown this once."""

    screen: str
    phones: dict[str, str]


class Made(BaseModel):
    """A test that was made."""

    test: str


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


@router.get("/displays", responses=responses(401))
def displays(request: Request, name: Operating) -> dict[str, Any]:
    """Return the profiles of displays: those that ship, and those calibrated."""
    profiles = request.app.state.desks.real.displays.all()
    return {key: profile.as_dict() for key, profile in profiles.items()}


@router.put("/displays/{display}", responses=responses(400, 401))
def calibrate(
    request: Request, name: Operating, display: Id, profile: dict[str, Any]
) -> dict[str, Any]:
    """Store the profile of a display; sessions made from now on have it."""
    checked = profile_from_dict(profile)
    request.app.state.desks.real.displays.put(display, checked)
    return checked.as_dict()


@router.get("/tests", responses=responses(401))
def tests(request: Request, name: Operating) -> list[dict[str, Any]]:
    """List the tests, newest first."""
    records = request.app.state.desks.real.store.tests()
    return [_summary(record) for record in reversed(records)]


@router.post("/tests", status_code=201, responses=responses(400, 401))
def make_test(request: Request, name: Operating, plan: dict[str, Any]) -> Made:
    """Make a test of a plan; its stimuli are copied, checked and hashed."""
    checked = plan_from_dict(plan)
    source = folder_of(request.app.state.config, checked.folder)
    return Made(test=request.app.state.desks.real.make_test(checked, source).id)


@router.get("/tests/{test}", responses=responses(401, 404))
def show_test(request: Request, name: Operating, test: Id) -> dict[str, Any]:
    """Return a test with its plan."""
    record = request.app.state.desks.real.store.test(test)
    return {**_summary(record), "plan": dict(record.plan)}


@router.post("/tests/{test}/links", status_code=201, responses=responses(400, 401, 404))
def invite(request: Request, name: Operating, test: Id, asked: Invitation) -> Invited:
    """Return a link into the session of an assessor; the order is stored here.

    A second link for the same assessor and display goes on with the same session.
    """
    desk = request.app.state.desks.real
    record, link = desk.invite(test, asked.assessor, asked.display, asked.language)
    return Invited(link=f"{ENTRY}{link}", session=record.id)


@router.post("/tests/{test}/groups", status_code=201, responses=responses(400, 401, 404, 409))
def invite_group(
    request: Request, name: Operating, test: Id, asked: GroupInvitation
) -> GroupInvited:
    """Return links for a group before one screen: the screen's, and each telephone's."""
    desk = request.app.state.desks.real
    screen, phones = desk.invite_group(test, asked.assessors, asked.display, asked.language)
    return GroupInvited(
        screen=f"{ENTRY}{screen}",
        phones={assessor: f"{ENTRY}{link}" for assessor, link in phones.items()},
    )


@router.post("/tests/{test}/dry-run", status_code=201, responses=responses(400, 401, 404))
def dry_run(request: Request, name: Operating, test: Id, asked: Invitation) -> Invited:
    """Return a link into a session of which nothing is stored."""
    record, link = request.app.state.desks.dry_run(
        test, asked.assessor, asked.display, asked.language
    )
    return Invited(link=f"{ENTRY}{link}", session=record.id, dry=True)


@router.get("/tests/{test}/progress", responses=responses(401, 404))
def progress(request: Request, name: Operating, test: Id) -> list[dict[str, Any]]:
    """Tell where every session stands, and what its page warned of."""
    return request.app.state.desks.real.progress(test)


@router.post("/tests/{test}/sessions/{session}/{action}", responses=responses(400, 401, 404, 409))
def act(
    request: Request,
    name: Operating,
    test: Id,
    session: Id,
    action: Literal["pause", "resume", "withdraw", "erase"],
) -> dict[str, Any]:
    """Pause, resume or withdraw a session, or erase its forms; the grades stay."""
    desk = request.app.state.desks.real
    return desk.act(desk.of_test(test, session), action)


@router.get(
    "/tests/{test}/export",
    response_class=Response,
    responses={
        200: {
            "content": {
                "text/csv": {}, "application/json": {}, "text/html": {}, "application/pdf": {},
            }
        },
        **responses(400, 401, 404, 409),
    },
)  # fmt: skip
def export(
    request: Request,
    name: Operating,
    test: Id,
    format: Literal["csv", "json", "scores", "html", "pdf", "sujson", "sureal"] = "csv",
    display: Annotated[str | None, Query(max_length=64)] = None,
    dimension: Annotated[str | None, Query(max_length=64)] = None,
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


def _summary(record: Any) -> dict[str, Any]:
    plan = plan_from_dict(record.plan)
    return {
        "test": record.id,
        "name": record.name,
        "created": record.created,
        "displays": list(plan.displays),
        "presentations": plan.presentations,
        "minutes": round(plan.session_s / 60, 1),
    }
