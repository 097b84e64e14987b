"""Resumable uploads: tus 1.0 with creation and termination; old ones are swept.

A file lies in ``uploads/<id>`` of the data folder; its size is its offset, so that a torn
write or a kill loses nothing that the client would not send again.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import logging
import os
import shutil
import sqlite3
import threading
import time
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from fastapi import Path as InPath
from starlette.requests import ClientDisconnect

from service.config import MIB
from service.http.auth import Client, require
from service.http.problems import ProblemError, responses
from service.http.quota import check_space, note_size
from service.jobs.request import safe_name
from service.store import Store, UploadRecord

log = logging.getLogger(__name__)

router = APIRouter(prefix="/api/v1/uploads", tags=["uploads"])

VERSION = "1.0.0"
EXTENSIONS = "creation,termination"
KEEP_SECONDS = 7 * 86400
"""Uploads are kept so long."""

SWEEP_SECONDS = 3600.0
"""From one look for old ones to the next."""

_busy: set[str] = set()
_busy_lock = threading.Lock()

TUS_HEADERS = {
    "Tus-Resumable": {"schema": {"type": "string"}, "description": "the protocol's version"}
}
"""Of every answer."""

OFFSET = {**TUS_HEADERS, "Upload-Offset": {"schema": {"type": "integer"}}}

UploadId = Annotated[str, InPath(max_length=64, examples=["9d2c61f0a7e84b3c"])]


def _asks(**headers: str | int) -> dict[str, Any]:
    """Declare request headers for OpenAPI, by an example of each (``_`` for ``-``)."""
    return {
        "parameters": [
            {
                "name": name.replace("_", "-"),
                "in": "header",
                "required": name != "Upload_Metadata",
                "schema": {"type": "string" if isinstance(value, str) else "integer"},
                "example": value,
            }
            for name, value in {"Tus_Resumable": VERSION, **headers}.items()
        ]
    }


def path_of(data: Path, upload_id: str) -> Path:
    """Return where an upload lies."""
    return data / "uploads" / upload_id


async def keep_swept(store: Store) -> None:
    """Sweep now and again, until cancelled."""
    while True:
        await asyncio.sleep(SWEEP_SECONDS)
        try:
            await asyncio.to_thread(sweep, store)
        except (OSError, sqlite3.Error) as error:
            log.warning("old uploads could not be swept: %s", error)


def sweep(store: Store) -> None:
    """Remove files without a row, and uploads that are old."""
    folder = store.folder / "uploads"
    folder.mkdir(exist_ok=True)
    for path in folder.iterdir():
        record = store.upload(path.name)
        if record is None or time.time() - record.created > KEEP_SECONDS:
            path.unlink(missing_ok=True)
            store.delete_upload(path.name)


@router.options(
    "", status_code=204, responses={204: {"description": "Told", "headers": TUS_HEADERS}}
)
async def options(request: Request) -> Response:
    """Tell what of tus is spoken."""
    return _answer(
        204,
        {
            "Tus-Version": VERSION,
            "Tus-Extension": EXTENSIONS,
            "Tus-Max-Size": str(request.app.state.config.max_body * MIB),
        },
    )


@router.post(
    "",
    status_code=201,
    response_class=Response,
    responses={
        201: {
            "description": "Created; Location says where to send it",
            "headers": {**TUS_HEADERS, "Location": {"schema": {"type": "string"}}},
        },
        **responses(400, 412, 413, 422, 507),
    },
    openapi_extra=_asks(Upload_Length=4096, Upload_Metadata="filename bGVmdC5wbmc="),
)
def create(request: Request, client: Annotated[Client, require("submit")]) -> Response:
    """Begin an upload of ``Upload-Length`` bytes, named by ``Upload-Metadata: filename …``."""
    _check_version(request)
    length = _number(request, "Upload-Length")
    config = request.app.state.config
    if length > config.max_body * MIB:
        raise ProblemError("too-large", f"an upload may have {config.max_body} MiB")
    name = safe_name(_filename(request))
    if name is None:
        raise ProblemError("invalid", "Upload-Metadata: filename is not a plain relative name")
    check_space(request.app.state, client, length)
    metadata = request.headers.get("upload-metadata", "")
    record = request.app.state.store.create_upload(client.name, name, length, metadata)
    path_of(config.data, record.id).touch()
    return _answer(201, {"Location": f"/api/v1/uploads/{record.id}"})


@router.head(
    "/{upload_id}",
    response_class=Response,
    responses={
        200: {
            "description": "How much is there",
            "headers": {
                **OFFSET,
                "Upload-Length": {"schema": {"type": "integer"}},
                "Upload-Metadata": {"schema": {"type": "string"}},
            },
        },
        **responses(404, 412, 422),
    },
    openapi_extra=_asks(),
)
def offset(
    request: Request, upload_id: UploadId, client: Annotated[Client, require("submit")]
) -> Response:
    """Tell how much of an upload is there."""
    _check_version(request)
    record, path = _find(request, upload_id, client)
    headers = {"Upload-Offset": str(path.stat().st_size), "Upload-Length": str(record.length)}
    return _answer(200, headers | ({"Upload-Metadata": record.metadata} if record.metadata else {}))


@router.patch(
    "/{upload_id}",
    status_code=204,
    responses={
        204: {"description": "Taken", "headers": OFFSET},
        **responses(400, 404, 408, 409, 412, 413, 415, 422, 507),
    },
    openapi_extra=_asks(Upload_Offset=0)
    | {
        "requestBody": {
            "required": True,
            "content": {
                "application/offset+octet-stream": {
                    "schema": {"type": "string", "format": "binary"}
                }
            },
        }
    },
)
async def append(
    request: Request, upload_id: UploadId, client: Annotated[Client, require("submit")]
) -> Response:
    """Go on with an upload from ``Upload-Offset``."""
    _check_version(request)
    if request.headers.get("content-type") != "application/offset+octet-stream":
        raise ProblemError("unsupported-media-type", "send application/offset+octet-stream")
    record, path = await asyncio.to_thread(_find, request, upload_id, client)
    begin = _number(request, "Upload-Offset")
    with _busy_lock:
        if upload_id in _busy:
            raise ProblemError("in-progress", "another request is writing this upload")
        _busy.add(upload_id)
    try:
        at = path.stat().st_size
        if at != begin:
            raise ProblemError("conflict", f"the upload is at {at}, not at {begin}")
        await asyncio.to_thread(check_space, request.app.state, client, record.length - at)
        with path.open("ab") as file:
            try:
                async for chunk in request.stream():
                    if at + len(chunk) > record.length:
                        raise ProblemError("too-large", "more bytes than Upload-Length said")
                    await asyncio.to_thread(file.write, chunk)
                    at += len(chunk)
            except ClientDisconnect:  # what came is kept
                return Response(status_code=499)
            finally:
                await asyncio.to_thread(_flush, file.fileno(), file.flush)
                note_size(request.app.state.config.data, upload_id, at)
    finally:
        with _busy_lock:
            _busy.discard(upload_id)
    return _answer(204, {"Upload-Offset": str(at)})


@router.delete(
    "/{upload_id}",
    status_code=204,
    responses={204: {"description": "Gone", "headers": TUS_HEADERS}, **responses(404, 412, 422)},
    openapi_extra=_asks(),
)
def remove(
    request: Request, upload_id: UploadId, client: Annotated[Client, require("submit")]
) -> Response:
    """Throw an upload away."""
    _check_version(request)
    record, path = _find(request, upload_id, client)
    path.unlink(missing_ok=True)
    request.app.state.store.delete_upload(record.id)
    return _answer(204, {})


def take(request: Request, upload_id: str, client: Client, target: Path) -> None:
    """Give a finished upload to a job: a second name for the same file where that is possible."""
    record, path = _find(request, upload_id, client)
    if path.stat().st_size != record.length:
        raise ProblemError("conflict", f"upload {upload_id} is not finished")
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(path, target)
    except FileExistsError:
        raise ProblemError("invalid", f"{target.name}: is named twice") from None
    except OSError:
        shutil.copyfile(path, target)


def _find(request: Request, upload_id: str, client: Client) -> tuple[UploadRecord, Path]:
    record = request.app.state.store.upload(upload_id)
    if record is None or record.client != client.name:
        raise ProblemError("not-found", "there is no such upload")
    path = path_of(request.app.state.config.data, record.id)
    if not path.is_file():
        raise ProblemError("not-found", "the upload's file is gone")
    return record, path


def _flush(number: int, flush: object) -> None:
    flush()  # type: ignore[operator]
    os.fsync(number)


def _check_version(request: Request) -> None:
    if request.headers.get("tus-resumable") != VERSION:
        raise ProblemError(
            "precondition-failed", f"send Tus-Resumable: {VERSION}",
            headers={"Tus-Version": VERSION},
        )  # fmt: skip


def _number(request: Request, name: str) -> int:
    text = request.headers.get(name, "")
    if not (text.isascii() and text.isdigit() and len(text) <= 18):
        raise ProblemError("bad-request", f"{name}: must be a number of bytes")
    return int(text)


def _filename(request: Request) -> str:
    for pair in request.headers.get("upload-metadata", "").split(","):
        key, _, value = pair.strip().partition(" ")
        if key == "filename":
            try:
                return base64.b64decode(value, validate=True).decode()
            except (binascii.Error, ValueError):
                return ""
    return "file"


def _answer(status: int, headers: dict[str, str]) -> Response:
    return Response(status_code=status, headers={"Tus-Resumable": VERSION, **headers})
