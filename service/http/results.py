"""What a job has made, file by file, and what its workers said."""

from __future__ import annotations

import mimetypes
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from fastapi import Path as InPath
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import HTTPConnection

from service.http.files import TAGGED, Known, add_heads, send_file
from service.http.job_views import JobId, Reader, find_job
from service.http.problems import ProblemError, responses
from service.jobs.request import safe_name
from service.jobs.states import State
from service.scheduler import job_folder
from service.store import JobRecord

router = APIRouter(prefix="/api/v1", tags=["jobs"])


class ResultView(BaseModel):
    """A file that a job has made."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "name": "teapot_3D_SBS_LR.mkv",
                    "size": 1482011,
                    "media_type": "video/x-matroska",
                    "url": "/api/v1/jobs/3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f/results/"
                    "teapot_3D_SBS_LR.mkv",
                }
            ]
        }
    )

    name: str
    size: int = Field(description="bytes")
    media_type: str
    url: str


@router.get("/jobs/{job_id}/results", responses=responses(404, 422))
def results(request: Request, job_id: JobId, client: Reader) -> list[ResultView]:
    """List the files of a finished job."""
    record = find_job(request, job_id, client)
    sign = request.app.state.tokens.sign
    return [
        ResultView(
            name=name,
            size=path.stat().st_size,
            media_type=_media_type(name),
            url=sign(f"/api/v1/jobs/{record.id}/results/{name}", client.name),
        )
        for name, path in result_files(request, record).items()
    ]


FILE: dict[int | str, dict[str, Any]] = {
    200: {
        **TAGGED,
        "description": "The file",
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    },
    206: {"description": "The bytes asked for by Range"},
    304: {"description": "Nothing new"},
}


@router.get(
    "/jobs/{job_id}/results/{name:path}",
    response_class=FileResponse,
    responses={**FILE, **responses(400, 404, 416, 422)},
)
def result(
    request: Request,
    job_id: JobId,
    name: Annotated[str, InPath(max_length=300, examples=["teapot_3D_SBS_LR.mkv"])],
    client: Reader,
    if_none_match: Known = None,
) -> Response:
    """Fetch a result, whole or by ranges."""
    record = find_job(request, job_id, client)
    folder = job_folder(request.app.state.config.data, record.id) / "results"
    good = safe_name(name)
    if good is None or record.state is not State.SUCCEEDED or not (folder / good).is_file():
        raise ProblemError("not-found", "the job has no such result")
    return send_file(folder / good, if_none_match, _media_type(good))


@router.get(
    "/jobs/{job_id}/logs",
    response_class=FileResponse,
    responses={
        200: {
            **TAGGED,
            "description": "What its workers wrote",
            "content": {
                "text/plain": {
                    "schema": {"type": "string"},
                    "example": "WARNING: depth is estimated",
                }
            },
        },
        304: {"description": "Nothing new"},
        **responses(404, 416, 422),
    },
)
def logs(
    request: Request,
    job_id: JobId,
    client: Reader,
    if_none_match: Known = None,
) -> Response:
    """Read what the workers of a job wrote to their logs."""
    record = find_job(request, job_id, client)
    path = job_folder(request.app.state.config.data, record.id) / "worker.log"
    if not path.is_file():
        return Response("", media_type="text/plain; charset=utf-8")
    return send_file(path, if_none_match, "text/plain; charset=utf-8")


def result_files(request: HTTPConnection, record: JobRecord) -> dict[str, Path]:
    """Return the files that a finished job has made, by their names."""
    folder = job_folder(request.app.state.config.data, record.id) / "results"
    if record.state is not State.SUCCEEDED or not folder.is_dir():
        return {}
    names = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*"))}
    return {
        name: path for name, path in names.items() if path.is_file() and not name.startswith(".")
    }


def _media_type(name: str) -> str:
    ours = {
        ".mkv": "video/x-matroska",
        ".mp4": "video/mp4",
        ".webm": "video/webm",
        ".mov": "video/quicktime",
    }
    return (
        ours.get(Path(name).suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    )


add_heads(router)
