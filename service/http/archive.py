"""All files of a finished job as one ZIP, made while it is sent: nothing of it is stored."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from urllib.parse import quote

from fastapi import APIRouter, Request, Response
from fastapi.responses import StreamingResponse

from pipeline.media.files import Outlet
from service.http.files import add_heads
from service.http.job_views import JobId, Reader, find_job
from service.http.problems import ProblemError, responses
from service.http.results import result_files

router = APIRouter(prefix="/api/v1", tags=["jobs"])

CHUNK = 1 << 20
"""Bytes read at once."""

LARGE = 1 << 31
"""Files from this size on need ZIP64, bytes."""


@router.get(
    "/jobs/{job_id}/archive",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "A ZIP of all results",
            "content": {"application/zip": {"schema": {"type": "string", "format": "binary"}}},
        },
        **responses(404, 422),
    },
)
def archive(request: Request, job_id: JobId, client: Reader) -> Response:
    """Fetch all results as one ZIP, such as the pictures of every frame; uncompressed."""
    record = find_job(request, job_id, client)
    files = result_files(request, record)
    if not files:
        raise ProblemError("not-found", "the job has no results")
    name = f"{record.request.get('name', 'result')}-{record.id[:8]}.zip"
    called = f'filename="{name}"' if name.isascii() else f"filename*=UTF-8''{quote(name)}"
    headers = {"Content-Disposition": f"attachment; {called}"}
    content = iter(()) if request.method == "HEAD" else zipped(files)
    return StreamingResponse(content, media_type="application/zip", headers=headers)


def zipped(files: Mapping[str, Path]) -> Iterator[bytes]:
    """Yield the bytes of a ZIP of the files, by the names that they get; the same every time."""
    outlet = Outlet()
    with zipfile.ZipFile(outlet, "w", zipfile.ZIP_STORED) as made:
        for name, path in files.items():
            entry = zipfile.ZipInfo(name)
            entry.external_attr = 0o644 << 16
            is_large = path.stat().st_size >= LARGE
            with path.open("rb") as source, made.open(entry, "w", force_zip64=is_large) as target:
                while chunk := source.read(CHUNK):
                    target.write(chunk)
                    yield outlet.take()
    yield outlet.take()


add_heads(router)
