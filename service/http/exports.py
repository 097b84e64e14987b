"""Other forms of a finished job: each is a job of its own that computes nothing again."""

from __future__ import annotations

import uuid
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Body, Request, Response

from service.http.files import add_heads
from service.http.job_views import (
    JobId,
    JobPage,
    JobView,
    Reader,
    Submitter,
    find_job,
    view_of,
)
from service.http.problems import ProblemError, responses
from service.http.quota import check_queue, check_space
from service.jobs.request import ExportForm, export_options
from service.jobs.sinks import MASTER
from service.jobs.states import State
from service.scheduler import job_folder

router = APIRouter(prefix="/api/v1", tags=["jobs"])

FORMS = {
    "television": {
        "summary": "half side by side for a television",
        "value": {"container": "mp4", "layout": "half-sbs"},
    },
    "pictures": {
        "summary": "lossless pictures, one of each eye and frame",
        "value": {"video": False, "frames": True},
    },
}


@router.post(
    "/jobs/{job_id}/exports",
    status_code=202,
    responses={
        202: {
            "description": "Taken; Location is the address of the job that exports",
            "headers": {"Location": {"schema": {"type": "string"}}},
        },
        **responses(400, 404, 409, 413, 422, 429, 507),
    },
)
def create(
    request: Request,
    response: Response,
    job_id: JobId,
    client: Submitter,
    form: Annotated[ExportForm, Body(openapi_examples=FORMS)],
) -> JobView:
    """Make another form of a job's result, from its lossless master."""
    state = request.app.state
    parent = find_job(request, job_id, client)
    folder = job_folder(state.config.data, parent.id)
    if parent.state is not State.SUCCEEDED:
        raise ProblemError("conflict", f"the job is {parent.state}: only a finished one can")
    if not (folder / MASTER).is_file():
        raise ProblemError("conflict", "the job has kept no lossless master to export from")
    name = parent.request.get("name", "result")
    export_options(form, Path("results"), name)  # is it possible?
    check_queue(state, client)
    check_space(state, client, 0)
    record, _ = state.store.create_job(
        job_id=uuid.uuid4().hex,
        client=client.name,
        request={
            "request": {"export": form.model_dump(), "of": parent.id},
            "scene": str(folder),
            "name": name,
        },
        priority=parent.priority,
        parent=parent.id,
    )
    state.scheduler.poke()
    response.headers["Location"] = f"/api/v1/jobs/{record.id}"
    return view_of(record)


@router.get("/jobs/{job_id}/exports", responses=responses(404, 422))
def index(request: Request, job_id: JobId, client: Reader) -> JobPage:
    """List the exports of a job, newest first."""
    parent = find_job(request, job_id, client)
    records = request.app.state.store.jobs(parent=parent.id, limit=500)
    return JobPage(jobs=[view_of(record) for record in records], next=None)


add_heads(router)
