"""Jobs: list, read, cancel, retry, delete."""

from __future__ import annotations

import shutil
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from service.http.files import TAGGED, Known, add_heads, matches, tag_of, unchanged
from service.http.job_views import JobId, JobPage, JobView, Reader, Submitter, find_job, view_of
from service.http.problems import ProblemError, responses
from service.jobs.states import Action, State, TransitionError
from service.scheduler import job_folder

router = APIRouter(prefix="/api/v1", tags=["jobs"])

PAGE = 50
"""Jobs on a page, unless more or fewer are asked for."""


@router.get("/jobs", responses={200: TAGGED, 304: {"description": "Nothing new"}, **responses(422)})
def index(
    request: Request,
    response: Response,
    client: Reader,
    state: Annotated[list[State], Query(description="without it all")] = [],  # noqa: B006 - FastAPI copies it
    before: Annotated[
        int | None,
        Query(ge=1, le=1 << 53, description="as `next` of the page before says", examples=[17]),
    ] = None,
    limit: Annotated[int, Query(ge=1, le=500, description="most on a page")] = PAGE,
    if_none_match: Known = None,
) -> JobPage:
    """List jobs, newest first."""
    records = request.app.state.store.jobs(
        client=None if client.sees_all else client.name,
        states=tuple(state),
        before=before,
        limit=limit + 1,
    )
    page, rest = records[:limit], records[limit:]
    more = None
    if rest:
        filters = "".join(f"&state={item.value}" for item in state)
        more = f"/api/v1/jobs?limit={limit}&before={page[-1].number}{filters}"
    tag = tag_of("-".join(f"{record.number}.{record.version}" for record in page) + str(more))
    response.headers["ETag"] = tag
    if matches(if_none_match, tag):
        return unchanged(tag)  # type: ignore[return-value]
    return JobPage(jobs=[view_of(record) for record in page], next=more)


@router.get(
    "/jobs/{job_id}",
    responses={200: TAGGED, 304: {"description": "Nothing new"}, **responses(404, 422)},
)
def show(
    request: Request,
    response: Response,
    job_id: JobId,
    client: Reader,
    if_none_match: Known = None,
) -> JobView:
    """Show a job."""
    record = find_job(request, job_id, client)
    tag = tag_of(f"{record.id}.{record.version}")
    response.headers["ETag"] = tag
    if matches(if_none_match, tag):
        return unchanged(tag)  # type: ignore[return-value]
    return view_of(record)


@router.delete("/jobs/{job_id}", status_code=204, responses=responses(404, 409, 422))
def delete(request: Request, job_id: JobId, client: Submitter) -> None:
    """Forget a finished job and its files."""
    record = find_job(request, job_id, client)
    if not record.state.is_final:
        raise ProblemError("conflict", f"the job is {record.state}; cancel it first")
    request.app.state.store.delete_job(record.id)
    shutil.rmtree(job_folder(request.app.state.config.data, record.id), ignore_errors=True)


@router.post("/jobs/{job_id}/cancel", status_code=202, responses=responses(404, 409, 422))
def cancel(request: Request, job_id: JobId, client: Submitter) -> JobView:
    """Ask a job to stop; again is no error."""
    record = find_job(request, job_id, client)
    try:
        return view_of(request.app.state.scheduler.cancel(record.id))
    except TransitionError as error:
        raise ProblemError("conflict", str(error)) from None


@router.post("/jobs/{job_id}/retry", status_code=202, responses=responses(404, 409, 422))
def retry(request: Request, job_id: JobId, client: Submitter) -> JobView:
    """Queue a failed or cancelled job again; its finished segments are not computed again."""
    record = find_job(request, job_id, client)
    try:
        record = request.app.state.store.act(record.id, Action.RETRY)
    except TransitionError as error:
        raise ProblemError("conflict", str(error)) from None
    request.app.state.scheduler.poke()
    return view_of(record)


add_heads(router)
