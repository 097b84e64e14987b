"""Taking a job: a scene under an allowed root, finished uploads, or files sent with it."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import shutil
import threading
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response
from pydantic import ValidationError
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException
from starlette.requests import ClientDisconnect

from pipeline.job import Job
from pipeline.media.eye_files import name_of_pair
from service.config import MIB
from service.http import uploads
from service.http.auth import Client
from service.http.files import add_heads
from service.http.job_views import JobView, Reader, Submitter, view_of
from service.http.problems import ProblemError, responses, wrong_fields
from service.http.quota import check_queue, check_space, note_size
from service.jobs.pictures import too_large
from service.jobs.request import (
    JobRequest,
    export_options,
    make_job,
    plain_name,
    safe_name,
    without_layout,
)
from service.scheduler import job_folder
from service.store import JobRecord, KeyReusedError

router = APIRouter(prefix="/api/v1", tags=["jobs"])


@router.post(
    "/jobs",
    status_code=202,
    response_model=JobView,
    responses={
        202: {
            "description": "Taken; Location is the job's address",
            "headers": {
                "Location": {"schema": {"type": "string"}},
                "Retry-After": {"schema": {"type": "integer"}},
            },
        },
        **responses(400, 404, 408, 409, 413, 415, 422, 429, 507),
    },
    openapi_extra={
        "requestBody": {
            "required": True,
            "content": {
                "application/json": {"schema": {"$ref": "#/components/schemas/JobRequest"}},
                "multipart/form-data": {
                    "schema": {
                        "type": "object",
                        "required": ["files"],
                        "properties": {
                            "job": {"type": "string", "description": "a JobRequest as JSON"},
                            "files": {
                                "type": "array",
                                "items": {"type": "string", "format": "binary"},
                                "description": "the scene; file names are relative paths",
                            },
                        },
                    },
                    "example": {
                        "job": '{"settings": {"magnification": "2"}}',
                        "files": ["scene.json", "left.png", "right.png"],
                    },
                },
            },
        }
    },
)
async def create(
    request: Request,
    response: Response,
    client: Submitter,
    idempotency_key: Annotated[
        str | None,
        Header(
            max_length=200,
            description="makes one job however often the request is sent",
            examples=["7d1f"],
        ),
    ] = None,
) -> JobView:
    """Take a job: a path under an allowed root, finished uploads, or files in this request."""
    kind = request.headers.get("content-type", "").partition(";")[0].strip().lower()
    files: list[UploadFile] = []
    config = request.app.state.config
    with contextlib.ExitStack() as stack:
        if kind == "multipart/form-data":
            try:
                form = await request.form(max_files=config.max_files, max_fields=10)
            except (MultiPartException, ClientDisconnect) as error:
                raise ProblemError("bad-request", str(error)) from error
            stack.callback(lambda: [item.file.close() for item in files])
            files = [item for item in form.getlist("files") if isinstance(item, UploadFile)]
            said = form.get("job", "{}")
            if not files:
                raise ProblemError("invalid", "files: none were sent")
            text = said if isinstance(said, str) else await _text_of(said)
        elif kind == "application/json":
            try:
                text = (await request.body()).decode()
            except ValueError as error:
                raise ProblemError("bad-request", "the body is not UTF-8") from error
        else:
            raise ProblemError(
                "unsupported-media-type", "send application/json or multipart/form-data"
            )
        record = await asyncio.to_thread(_take, request, client, text, files, idempotency_key)
    response.headers["Location"] = f"/api/v1/jobs/{record.id}"
    response.headers["Retry-After"] = "1"
    return view_of(record)


async def _text_of(file: UploadFile) -> str:
    """Return the text of a form's field that came as a file, as browsers send a Blob."""
    try:
        return (await file.read(MIB)).decode()
    except ValueError as error:
        raise ProblemError("bad-request", "job: is not UTF-8") from error
    finally:
        await file.close()


_creating: set[tuple[str, str]] = set()
_creating_lock = threading.Lock()


@contextlib.contextmanager
def _alone(client: Client, key: str | None) -> Iterator[None]:
    """Let only one request of an idempotency key be worked on."""
    item = (client.name, key or "")
    with _creating_lock:
        if key is not None and item in _creating:
            raise ProblemError("in-progress", "a request with this key is being worked on")
        if key is not None:
            _creating.add(item)
    try:
        yield
    finally:
        with _creating_lock:
            _creating.discard(item)


def _take(
    request: Request, client: Client, text: str, files: list[UploadFile], key: str | None
) -> JobRecord:
    state = request.app.state
    asked = _parsed(text)
    with _alone(client, key):
        digest = _digest(text, files) if key is not None else ""
        try:
            known = state.store.keyed(client.name, key, digest) if key is not None else None
        except KeyReusedError:
            raise ProblemError(
                "key-reused", "the Idempotency-Key was used for another request"
            ) from None
        if known is not None:
            return known
        check_queue(state, client)
        sent = sum(item.size or 0 for item in files)
        check_space(state, client, sent)
        job_id = uuid.uuid4().hex
        folder = job_folder(state.config.data, job_id)
        try:
            scene = _scene(request, client, asked, files, _input(asked, folder))
            name = _stem(asked, scene, folder)
            _check_forms(asked, make_job(asked, scene, folder / "results", name=name), name)
            record, _ = state.store.create_job(
                job_id=job_id,
                client=client.name,
                request={
                    "request": asked.model_dump(exclude_unset=True),
                    "scene": str(scene),
                    "name": name,
                },
                priority=asked.priority,
                key=key,
                request_hash=digest,
            )
        except BaseException:
            shutil.rmtree(folder, ignore_errors=True)
            raise
        note_size(state.config.data, job_id, sent)
    state.scheduler.poke()
    return record


def _check_forms(asked: JobRequest, job: Job, name: str) -> None:
    """Find out whether everything that is asked for can be written, each under its own name."""
    output: Any = asked.output
    if asked.exports and not output.master:
        raise ProblemError("invalid", "exports: are made from the master; let it be kept")
    results = job.output.report.parent if job.output.report is not None else Path()
    taken = [path for path in (job.output.output, job.output.frames_dir) if path is not None]
    for form in asked.exports:
        options = export_options(form, results, name)
        for path in (options.output, options.frames_dir):
            if path is not None and path in taken:
                raise ProblemError("invalid", f"exports: two forms would be called {path.name}")
            taken += [] if path is None else [path]


def _parsed(text: str) -> JobRequest:
    try:
        return JobRequest.model_validate_json(text)
    except ValidationError as error:
        said = wrong_fields(error.errors())
        detail = "; ".join(f"{item['at'] or 'body'}: {item['says']}" for item in said[:3])
        raise ProblemError("invalid", detail, errors=said[:20]) from None


def _digest(text: str, files: list[UploadFile]) -> str:
    total = hashlib.sha256(text.encode())
    for item in files:
        total.update(f"\n{item.filename}\n{item.size}\n".encode())
        total.update(hashlib.file_digest(item.file, "sha256").digest())  # type: ignore[arg-type]
        item.file.seek(0)
    return total.hexdigest()


def _input(asked: JobRequest, folder: Path) -> Path:
    """Return the folder of the files that are sent: of the job's name, which may tell the scene."""
    return folder / "input" / plain_name(asked.name or "")


def _scene(
    request: Request, client: Client, asked: JobRequest, files: list[UploadFile], folder: Path
) -> Path:
    """Return the scene's path, its uploaded files in place."""
    config = request.app.state.config
    if not files and not asked.uploads:
        return _under_a_root(asked.scene, config.roots)
    for name, upload in (asked.uploads or {}).items():
        uploads.take(request, upload, client, _place(folder, name))
    for item in files:
        target = _place(folder, item.filename or "file")
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            with target.open("xb") as file:
                shutil.copyfileobj(item.file, file, 1 << 20)
        except (FileExistsError, NotADirectoryError, IsADirectoryError):
            raise ProblemError("invalid", f"{item.filename}: is named twice") from None
    wrong = too_large(folder, config.max_pixels)
    if wrong:
        raise ProblemError("too-large", wrong)
    if asked.scene is not None:
        named = safe_name(asked.scene)
        if named is None or not (folder / named).exists():
            raise ProblemError("invalid", "scene: names none of the files sent")
        return folder / named
    there = [path for path in folder.rglob("*") if path.is_file()]
    manifests = [path for path in there if path.name == "scene.json"]
    if len(manifests) == 1:
        return manifests[0]
    return there[0] if len(there) == 1 else folder


def _place(folder: Path, name: str) -> Path:
    good = safe_name(name)
    if good is None:
        raise ProblemError("invalid", f"{name[:100]!r}: is not a plain relative file name")
    return folder / good


def _under_a_root(scene: str | None, roots: tuple[Path, ...]) -> Path:
    if scene is None:
        raise ProblemError("invalid", "scene: say which, or send files")
    if "\0" in scene:
        raise ProblemError("invalid", "scene: is not a path")
    for root in roots:
        try:
            path = (root / scene).resolve()
            if path.is_relative_to(root.resolve()) and path.exists():
                return path
        except (OSError, RuntimeError, ValueError):
            continue
    raise ProblemError("invalid", "scene: nothing of that name lies under an allowed root")


def _stem(asked: JobRequest, scene: Path, folder: Path) -> str:
    """Return what the job's files are called: as it is, or its scene, in letters and digits."""
    of = scene.parent if scene.name == "scene.json" else scene
    if of == folder / "input":
        pairs = {name_of_pair(path, "scene") for path in of.iterdir()}
        found = pairs.pop() if len(pairs) == 1 else None
        of_scene = found or "scene"
    else:
        of_scene = name_of_pair(of, of.parent.stem) or of.stem
    return plain_name(without_layout(asked.name or of_scene)) or "scene"


@router.get(
    "/settings-schema",
    responses={
        200: {
            "content": {"application/json": {"example": {"title": "JobRequest", "type": "object"}}}
        }
    },
)
def settings_schema(client: Reader) -> dict[str, Any]:
    """Return the JSON schema of a job: the settings of ``depthsr run``."""
    return JobRequest.model_json_schema()


add_heads(router)
