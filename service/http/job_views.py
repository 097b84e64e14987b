"""A job as clients see it, and who may see which: what its addresses have in common."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import Path
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import HTTPConnection

from service.http.auth import Client, require
from service.http.problems import ProblemError
from service.jobs.states import State
from service.store import JobRecord

Reader = Annotated[Client, require("read")]
Submitter = Annotated[Client, require("submit")]
JobId = Annotated[str, Path(max_length=64, examples=["3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f"])]

EXAMPLE_JOB: dict[str, Any] = {
    "id": "3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f",
    "name": "teapot",
    "state": "running",
    "client": "ann",
    "priority": 0,
    "attempt": 1,
    "created": "2026-11-26T10:00:00Z",
    "started": "2026-11-26T10:00:01Z",
    "finished": None,
    "frames_done": 12,
    "frames_total": 48,
    "compiling": False,
    "problem": None,
    "request": {"scene": "teapot", "settings": {"magnification": "2"}},
    "links": {
        "self": "/api/v1/jobs/3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f",
        "events": "/api/v1/jobs/3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f/events",
    },
}


class JobView(BaseModel):
    """A job as clients see it."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE_JOB]})

    id: str
    name: str = Field(description="its files begin with it")
    state: State
    client: str
    priority: int
    attempt: int
    created: datetime
    started: datetime | None
    finished: datetime | None
    frames_done: int
    frames_total: int | None
    compiling: bool = Field(description="whether its first frame waits for kernels, this once")
    problem: dict[str, Any] | None = Field(description="why it failed (RFC 9457)")
    request: dict[str, Any]
    links: dict[str, str]


class JobPage(BaseModel):
    """Some of the jobs, newest first."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [{"jobs": [EXAMPLE_JOB], "next": "/api/v1/jobs?limit=1&before=17"}]
        }
    )

    jobs: list[JobView]
    next: str | None = Field(description="address of the next page")


def find_job(request: HTTPConnection, job_id: str, client: Client) -> JobRecord:
    """Return a job that the client may see; a problem where there is none."""
    record: JobRecord | None = request.app.state.store.job(job_id)
    if record is None or not (client.sees_all or record.client == client.name):
        raise ProblemError("not-found", "there is no such job")
    return record


def view_of(record: JobRecord) -> JobView:
    """Return a job as clients see it."""
    here = f"/api/v1/jobs/{record.id}"
    return JobView(
        id=record.id,
        name=record.request.get("name", "result"),
        state=record.state,
        client=record.client,
        priority=record.priority,
        attempt=record.attempt,
        created=time_of(record.created),
        started=time_of(record.started),
        finished=time_of(record.finished),
        frames_done=record.frames_done,
        frames_total=record.frames_total,
        compiling=record.compiling and record.state is State.RUNNING,
        problem=None if record.problem is None else dict(record.problem),
        request=record.request["request"],
        links={
            "self": here,
            **{key: f"{here}/{key}" for key in ("events", "results", "archive", "logs")},
        },
    )


def time_of(seconds: float | None) -> Any:
    """Return a moment of the store as clients see it: a datetime, or None where there is none."""
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC)
