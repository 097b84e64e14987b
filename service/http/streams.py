"""Streams: make, list, read, stop, forget."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from fastapi import Path as InPath
from fastapi.requests import HTTPConnection
from pydantic import BaseModel, ConfigDict, Field

from service.bus import keys
from service.http.auth import Client, require
from service.http.files import add_heads
from service.http.problems import ProblemError, responses
from service.jobs.request import SettingsModel, fields_model
from service.streams.options import StreamOptions
from service.streams.states import State
from service.streams.streams import (
    FROM_BUS,
    NoSuchStreamError,
    Stream,
    StreamRefusedError,
    Streams,
    TooManyStreamsError,
)

router = APIRouter(prefix="/api/v1/streams", tags=["streams"])

Reader = Annotated[Client, require("read")]
Submitter = Annotated[Client, require("submit")]
EXAMPLE_STREAM: dict[str, Any] = {
    "id": "stage",
    "state": "live",
    "client": "zenoh",
    "created": "2026-11-26T10:00:00Z",
    "run": 1,
    "manifest": {
        "format": "depthsr-scene/1",
        "fps": "15/1",
        "views": [{"id": "cam0"}, {"id": "cam1"}],
        "stereo": {"left": "cam0", "right": "cam1"},
    },
    "settings": {},
    "options": {},
    "problem": None,
    "status": {"state": "live", "fps_in": 15.0, "fps_out": 14.8, "frames_done": 112},
    "keys": {"manifest": "depthsr/stage/in/manifest", "sbs": "depthsr/stage/out/sbs"},
    "links": {"self": "/api/v1/streams/stage", "stop": "/api/v1/streams/stage/stop"},
}

StreamName = Annotated[str, InPath(pattern=f"^{keys.STREAM_ID}$", examples=["stage"])]

OptionsModel: Any = fields_model("StreamOptions", StreamOptions)


class StreamRequest(BaseModel):
    """A stream: its name, and what is known of its source before it comes."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {"id": "stage", "settings": {"magnification": "2"}, "options": {"wait": 0.1}}
            ]
        },
    )

    id: str = Field(pattern=f"^{keys.STREAM_ID}$", description="name, as in the keys of the bus")
    manifest: dict[str, Any] | None = Field(
        None, description="scene manifest without paths; without it the source's is waited for"
    )
    settings: SettingsModel = Field(default_factory=SettingsModel)
    options: OptionsModel = Field(default_factory=OptionsModel)


class StreamView(BaseModel):
    """A stream as clients see it."""

    model_config = ConfigDict(json_schema_extra={"examples": [EXAMPLE_STREAM]})

    id: str
    state: State
    client: str
    created: datetime
    run: int = Field(description="workers so far; grows by one when it is started anew")
    manifest: dict[str, Any] | None
    settings: dict[str, Any]
    options: dict[str, Any]
    problem: dict[str, Any] | None
    status: dict[str, Any] = Field(description="what the worker said last: rates, drops, latency")
    keys: dict[str, str] = Field(description="where it is found on the bus")
    links: dict[str, str]


class StreamPage(BaseModel):
    """All streams, newest first."""

    model_config = ConfigDict(
        json_schema_extra={"examples": [{"streams": [EXAMPLE_STREAM], "bus": ""}]}
    )

    streams: list[StreamView]
    bus: str = Field(description="why there are no streams now; empty where all is well")


@router.post(
    "",
    status_code=201,
    responses={
        201: {
            "description": "Made; Location is the stream's address",
            "headers": {"Location": {"schema": {"type": "string"}}},
        },
        **responses(409, 413, 422, 429),
    },
)
def create(
    request: Request, response: Response, client: Submitter, asked: StreamRequest
) -> StreamView:
    """Make a stream; it begins with its manifest, given here or sent by the source."""
    streams: Streams = request.app.state.streams
    if not streams.is_on:
        raise ProblemError("conflict", "streams are off in this service (--zenoh)")
    known = streams.get(asked.id)
    if known is not None and not _may_change(known, client):
        raise ProblemError("conflict", f"{asked.id}: the name is taken")
    try:
        item = streams.create(
            asked.id,
            client.name,
            manifest=asked.manifest,
            settings=asked.settings.model_dump(exclude_unset=True),
            options=asked.options.model_dump(exclude_unset=True),
        )
    except TooManyStreamsError as error:
        raise ProblemError("too-many", str(error), headers={"Retry-After": "30"}) from None
    except StreamRefusedError as error:
        raise ProblemError("conflict", str(error)) from None
    response.headers["Location"] = f"/api/v1/streams/{item.id}"
    return _view(item)


@router.get("")
def index(request: Request, client: Reader) -> StreamPage:
    """List the streams."""
    streams: Streams = request.app.state.streams
    seen = [item for item in streams.all() if _may_see(item, client)]
    return StreamPage(
        streams=[_view(item) for item in seen], bus=streams.problem if streams.is_on else "off"
    )


@router.get("/{stream}", responses=responses(404, 422))
def show(request: Request, client: Reader, stream: StreamName) -> StreamView:
    """Tell how a stream is."""
    return _view(find(request, client, stream))


@router.post("/{stream}/stop", responses=responses(403, 404, 422))
def stop(request: Request, client: Submitter, stream: StreamName) -> StreamView:
    """Stop a stream; what its source sends is ignored until it is made again."""
    _changeable(request, client, stream)
    try:
        return _view(request.app.state.streams.stop(stream))
    except NoSuchStreamError as error:
        raise ProblemError("not-found", str(error)) from None


@router.delete("/{stream}", status_code=204, responses=responses(403, 404, 422))
def delete(request: Request, client: Submitter, stream: StreamName) -> None:
    """Stop and forget a stream; its source's next manifest begins it anew."""
    _changeable(request, client, stream)
    try:
        request.app.state.streams.remove(stream)
    except NoSuchStreamError as error:
        raise ProblemError("not-found", str(error)) from None


def find(connection: HTTPConnection, client: Client, stream: str) -> Stream:
    """Return a stream that the client may see.

    Raises
    ------
    ProblemError
        ``not-found``.
    """
    item: Stream | None = connection.app.state.streams.get(stream)
    if item is None or not _may_see(item, client):
        raise ProblemError("not-found", "there is no such stream")
    return item


def _changeable(request: Request, client: Client, stream: str) -> None:
    item = find(request, client, stream)
    if not _may_change(item, client):
        raise ProblemError("forbidden", "a stream of others needs the scope operate")


def _may_see(item: Stream, client: Client) -> bool:
    return client.sees_all or item.client in (client.name, FROM_BUS)


def _may_change(item: Stream, client: Client) -> bool:
    return client.sees_all or item.client == client.name


def _view(item: Stream) -> StreamView:
    here = f"/api/v1/streams/{item.id}"
    return StreamView(
        id=item.id,
        state=item.state,
        client=item.client,
        created=datetime.fromtimestamp(item.created, UTC),
        run=item.run,
        manifest=None if item.manifest is None else item.manifest.content,
        settings=item.settings,
        options=item.options,
        problem=item.problem,
        status=item.status,
        keys={
            "manifest": keys.manifest(item.id),
            "inputs": keys.inputs(item.id),
            "status": keys.status(item.id),
            **{str(which): keys.output(item.id, which) for which in keys.Output},
        },
        links={"self": here, "stop": f"{here}/stop"},
    )


add_heads(router)
