"""Problems as HTTP clients meet them (RFC 9457); the table is :mod:`service.problem_table`."""

from __future__ import annotations

import logging
import sqlite3
from collections.abc import Iterable, Mapping
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from fastapi.routing import APIRoute
from pydantic import BaseModel, ConfigDict
from starlette.exceptions import HTTPException
from starlette.routing import BaseRoute, Match

from dscqs.errors import DscqsError
from pipeline.errors import PipelineError
from service.problem_table import DISK_FULL, KINDS, problem

log = logging.getLogger(__name__)

MEDIA_TYPE = "application/problem+json"

DSCQS = "/dscqs/"
"""Problems of subjective tests have ``code`` and ``message`` besides."""

KINDS_OF_DSCQS = {
    "out-of-order": "conflict", "not-found": "not-found",
    "used-up": "gone", "not-logged-in": "unauthorized", "plan-error": "bad-request",
    "grades-error": "bad-request", "stimulus-error": "bad-request", "display-error": "bad-request",
    "votes-error": "conflict",
    "stimulus-lost": "internal", "dscqs-error": "internal",
}  # fmt: skip
"""Kind of problem by the code of a :class:`DscqsError`."""


def wrong_fields(errors: Iterable[Mapping[str, Any]]) -> list[dict[str, str]]:
    """Return where each of pydantic's errors is, and what it says."""
    return [
        {
            "at": "/".join(map(str, item["loc"])),
            "says": "no such field" if item["type"] == "extra_forbidden" else item["msg"],
        }
        for item in errors
    ]


class Problem(BaseModel):
    """What went wrong (RFC 9457)."""

    model_config = ConfigDict(
        extra="allow",
        json_schema_extra={
            "examples": [
                problem("not-found", "there is no such job", instance="/api/v1/jobs/3f0c5d9a")
            ]
        },
    )

    type: str
    title: str
    status: int
    detail: str
    instance: str | None = None


class ProblemError(Exception):
    """Answered to the client as a problem."""

    def __init__(
        self, kind: str, detail: str, *, headers: dict[str, str] | None = None, **more: Any
    ) -> None:
        super().__init__(detail)
        self.kind, self.detail, self.headers, self.more = kind, detail, headers, more


def responses(*statuses: int) -> dict[int | str, dict[str, Any]]:
    """Return the declaration of problem answers for OpenAPI."""
    titles: dict[int, list[str]] = {}
    for kind in KINDS.values():
        titles.setdefault(kind.status, []).append(kind.title)
    schema = {"schema": {"$ref": "#/components/schemas/Problem"}}
    return {
        status: {
            "description": "; or: ".join(titles.get(status, ["Problem"])),
            "content": {MEDIA_TYPE: schema},
        }
        for status in statuses
    }


def answer(
    kind: str, detail: str, *, path: str, headers: dict[str, str] | None = None, **more: Any
) -> JSONResponse:
    """Return the HTTP answer of a problem."""
    if path.startswith(DSCQS):
        more = {"code": kind, "message": detail, **more}
    content = problem(kind, detail, instance=path, **more)
    return JSONResponse(
        content, status_code=content["status"], headers=headers, media_type=MEDIA_TYPE
    )


def add_handlers(app: FastAPI, routes: Iterable[BaseRoute]) -> None:
    """Make every error of the application a problem; ``routes`` are those of all its routers."""
    known = [route for route in routes if isinstance(route, APIRoute)]

    async def ours(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, ProblemError)
        return answer(
            error.kind, error.detail, path=request.url.path, headers=error.headers, **error.more
        )

    async def theirs(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, HTTPException)
        kind = next(
            (name for name, kind in KINDS.items() if kind.status == error.status_code),
            "bad-request",
        )
        headers = dict(error.headers or {})
        if kind == "method-not-allowed":  # the framework names those of one route only
            there = [route for route in known if route.matches(request.scope)[0] is not Match.NONE]
            methods = {method for route in there for method in route.methods or ()}
            headers["Allow"] = ", ".join(sorted(methods))
        return answer(kind, str(error.detail), path=request.url.path, headers=headers)

    async def invalid(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, RequestValidationError)
        errors = wrong_fields(error.errors())
        said = "; ".join(f"{item['at']}: {item['says']}" for item in errors[:3])
        kind = "bad-request" if request.url.path.startswith(DSCQS) else "invalid"
        return answer(kind, said, path=request.url.path, errors=errors[:20])

    async def of_pipeline(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, PipelineError)
        return answer(error.code, str(error), path=request.url.path)

    async def of_dscqs(request: Request, error: Exception) -> JSONResponse:
        assert isinstance(error, DscqsError)
        kind = KINDS_OF_DSCQS[error.code]
        return answer(kind, str(error), path=request.url.path, code=error.code)

    async def of_disk(request: Request, error: Exception) -> JSONResponse:
        log.warning("storage: %s", error)
        if isinstance(error, OSError) and error.errno not in DISK_FULL:
            return answer("internal", "a file cannot be read or written", path=request.url.path)
        return answer("disk-full", "the disk cannot take more", path=request.url.path)

    async def fault(request: Request, error: Exception) -> JSONResponse:
        return answer("internal", "see the service's log", path=request.url.path)

    app.add_exception_handler(ProblemError, ours)
    app.add_exception_handler(HTTPException, theirs)
    app.add_exception_handler(RequestValidationError, invalid)
    app.add_exception_handler(PipelineError, of_pipeline)
    app.add_exception_handler(DscqsError, of_dscqs)
    app.add_exception_handler(OSError, of_disk)
    app.add_exception_handler(sqlite3.OperationalError, of_disk)
    app.add_exception_handler(Exception, fault)
