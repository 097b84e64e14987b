"""Jobs: create, list, read, follow, cancel, retry, delete, results, logs."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import mimetypes
import shutil
import threading
import uuid
from collections.abc import AsyncIterator, Iterator
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request, Response
from fastapi import Path as InPath
from fastapi.responses import FileResponse, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException
from starlette.requests import ClientDisconnect, HTTPConnection

from pipeline.job import Job
from service.config import MIB
from service.http import uploads
from service.http.auth import Client, require
from service.http.files import TAGGED, Known, add_heads, matches, send_file, tag_of, unchanged
from service.http.problems import ProblemError, responses, wrong_fields
from service.http.quota import check_queue, check_space, note_size
from service.jobs.pictures import too_large
from service.jobs.request import JobRequest, export_options, make_job, safe_name
from service.jobs.states import Action, State, TransitionError
from service.scheduler import job_folder
from service.store import EventRecord, JobRecord, KeyReusedError

router = APIRouter(prefix="/api/v1", tags=["jobs"])

PAGE = 50
LAST_WORD = ("succeeded", "failed", "cancelled")
"""Kinds of events after which nothing comes unless somebody asks for a retry."""

LINKED = ("events", "results", "archive", "logs")
"""Addresses below a job's that its view names."""

BREATH = 15.0
"""A comment keeps an idle stream of events open this often, seconds."""

Reader = Annotated[Client, require("read")]
Submitter = Annotated[Client, require("submit")]
JobId = Annotated[str, InPath(max_length=64, examples=["3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f"])]

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
    "problem": None,
    "request": {"scene": "teapot", "settings": {"magnification": "2"}},
    "links": {
        "self": "/api/v1/jobs/3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f",
        "events": "/api/v1/jobs/3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f/events",
    },
}
EXAMPLE_EVENT: dict[str, Any] = {
    "sequence": 5,
    "at": "2026-11-26T10:00:04Z",
    "kind": "FrameFinished",
    "data": {"done": 12, "total": 48},
}
EXAMPLE_STREAM = (
    "retry: 2000\n\nid: 5\nevent: FrameFinished\n"
    'data: {"sequence":5,"at":"2026-11-26T10:00:04Z","kind":"FrameFinished",'
    '"data":{"done":12,"total":48}}\n\n'
)


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


class EventView(BaseModel):
    """Something that happened in a job."""

    sequence: int
    at: datetime
    kind: str
    data: dict[str, Any]


class EventPage(BaseModel):
    """Events after a number; ask again with the last one's."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"events": [EXAMPLE_EVENT], "last": 5}]}
    )

    events: list[EventView]
    last: int


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
            scene = _scene(request, client, asked, files, folder / "input")
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
    """Return what the job's files are called: of plain letters, as its own name or its scene."""
    of = scene.parent if scene.name == "scene.json" else scene
    name = asked.name or ("scene" if of == folder / "input" else of.stem)
    kept = "".join(c if (c.isalnum() and c.isascii()) or c in "-_" else "-" for c in name)[:60]
    return kept.strip("-") or "scene"


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


@router.get(
    "/jobs/{job_id}/events",
    response_model=EventPage,
    responses={
        200: {
            "description": "A page of events; with Accept: text/event-stream, a stream of them",
            "content": {
                "text/event-stream": {"schema": {"type": "string"}, "example": EXAMPLE_STREAM}
            },
        },
        **responses(404, 422),
    },
)
async def events(
    request: Request,
    job_id: JobId,
    client: Reader,
    after: Annotated[int, Query(ge=0, le=1 << 53, description="`sequence` of the last known")] = 0,
    limit: Annotated[int, Query(ge=1, le=1000, description="most on a page")] = 1000,
    last_event_id: Annotated[
        str | None, Header(description="of a stream: goes on after this one", examples=["4"])
    ] = None,
) -> Any:
    """Follow a job: poll with ``after``, or listen to a stream that goes on from Last-Event-ID."""
    record = await asyncio.to_thread(find_job, request, job_id, client)
    store = request.app.state.store
    streams = "text/event-stream" in request.headers.get("accept", "")
    if streams and request.method == "GET":
        if last_event_id and last_event_id.isascii() and last_event_id.isdigit():
            after = int(last_event_id[:15])
        return StreamingResponse(
            stream_events(request, record.id, after),
            media_type="text/event-stream",
            headers={"X-Accel-Buffering": "no"},
        )
    found = await asyncio.to_thread(store.events, record.id, after=after, limit=limit)
    page = [_event(item) for item in found]
    return EventPage(events=page, last=page[-1].sequence if page else after)


async def stream_events(request: Request, job_id: str, after: int) -> AsyncIterator[str]:
    """Yield the events of a job after a number as server-sent events, until its last."""
    notices, store = request.app.state.notices, request.app.state.store
    yield "retry: 2000\n\n"
    with notices.listen(job_id) as news:
        while not notices.stopping:
            news.clear()
            record = await asyncio.to_thread(store.job, job_id)  # first: its last event is there
            found = await asyncio.to_thread(store.events, job_id, after=after)
            for item in found:
                data = _event(item).model_dump_json()
                yield f"id: {item.sequence}\nevent: {item.kind}\ndata: {data}\n\n"
                after = item.sequence
            if record is None or (record.state.is_final and not found):
                return
            if found:
                continue
            try:
                await asyncio.wait_for(news.wait(), BREATH)
            except TimeoutError:
                yield ": here\n\n"


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


def find_job(request: HTTPConnection, job_id: str, client: Client) -> JobRecord:
    """Return a job that the client may see; a problem where there is none."""
    record: JobRecord | None = request.app.state.store.job(job_id)
    if record is None or not (client.sees_all or record.client == client.name):
        raise ProblemError("not-found", "there is no such job")
    return record


def result_files(request: HTTPConnection, record: JobRecord) -> dict[str, Path]:
    """Return the files that a finished job has made, by their names."""
    folder = job_folder(request.app.state.config.data, record.id) / "results"
    if record.state is not State.SUCCEEDED or not folder.is_dir():
        return {}
    names = {path.relative_to(folder).as_posix(): path for path in sorted(folder.rglob("*"))}
    return {
        name: path for name, path in names.items() if path.is_file() and not name.startswith(".")
    }


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
        created=_time(record.created),
        started=_time(record.started),
        finished=_time(record.finished),
        frames_done=record.frames_done,
        frames_total=record.frames_total,
        problem=None if record.problem is None else dict(record.problem),
        request=record.request["request"],
        links={
            "self": here,
            **{key: f"{here}/{key}" for key in ("events", "results", "archive", "logs")},
        },
    )


def _event(item: EventRecord) -> EventView:
    return EventView(**{**asdict(item), "at": _time(item.at)})


def _time(seconds: float | None) -> Any:
    return None if seconds is None else datetime.fromtimestamp(seconds, UTC)


def _media_type(name: str) -> str:
    ours = {".mkv": "video/x-matroska", ".mp4": "video/mp4", ".webm": "video/webm"}
    return (
        ours.get(Path(name).suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    )


add_heads(router)
