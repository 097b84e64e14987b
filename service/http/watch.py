"""Watching jobs and streams: what there is, HLS, the live edge by WebSocket, stills.

A job has its pieces on the disk, and is on air as well while a worker has it. A stream is on
air only.
"""

from __future__ import annotations

import asyncio
import json
import re
from collections.abc import AsyncGenerator, Iterator, Mapping
from contextlib import aclosing
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, Literal
from urllib.parse import urlsplit

from fastapi import APIRouter, Request, Response, WebSocket, WebSocketDisconnect
from fastapi import Path as InPath
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.requests import HTTPConnection

from service.http.auth import Client, identify, require
from service.http.files import (
    BYTES,
    TAGGED,
    Known,
    add_heads,
    matches,
    send_file,
    tag_of,
    unchanged,
)
from service.http.job_views import find_job
from service.http.problems import ProblemError, responses
from service.http.status import silent_since
from service.http.streams import find as find_stream
from service.live.broadcast import Broadcast, Gap
from service.live.fragments import Fragment, Init, read_init
from service.live.job_watch import broadcast_name, job_track
from service.live.track import Track
from service.store import JobRecord

router = APIRouter(prefix="/api/v1", tags=["watch"])

HLS = "application/vnd.apple.mpegurl"
BOUNDARY = "picture"

TrackName = Literal["result", "before"]
Kind = Literal["jobs", "streams"]
State = Literal["waiting", "growing", "live", "silent", "ended"]
Reader = Annotated[Client, require("read")]
Name = Annotated[
    str,
    InPath(max_length=64, description="id of the job, or name of the stream", examples=["stage"]),
]

EXAMPLE_PLAYLIST = """#EXTM3U
#EXT-X-VERSION:7
#EXT-X-TARGETDURATION:1
#EXT-X-MEDIA-SEQUENCE:0
#EXT-X-INDEPENDENT-SEGMENTS
#EXT-X-PLAYLIST-TYPE:VOD
#EXT-X-MAP:URI="init-0.mp4"
#EXTINF:1.000000,
segment-000000.m4s
#EXT-X-ENDLIST
"""


class TrackView(BaseModel):
    """One video that can be watched."""

    layout: str = Field(description="`sbs`, or `left` or `right` where there is one eye only")
    fps: float = Field(description="frames a second")
    eye_width: int = Field(description="of one eye, pixels")
    eye_height: int
    codec: str = Field(description="as in RFC 6381", examples=["avc1.640028"])
    first_frame: int = Field(description="source frame number at time 0")
    frames: int | None = Field(description="that can be watched now; null of a stream")
    playlist: str = Field(description="address of the HLS playlist")
    live: str | None = Field(description="path of the WebSocket; null where nothing is on air")
    stills: str = Field(description="address of the pictures, one after the other")
    broadcast: str | None = Field(
        description="of a stream: another one where it was stopped and made again; null of a job"
    )


class WatchView(BaseModel):
    """What there is to watch."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "state": "live",
                    "silent_since": None,
                    "frames_total": None,
                    "sampling": "area",
                    "tracks": {
                        "result": {
                            "layout": "sbs",
                            "fps": 15.0,
                            "eye_width": 1024,
                            "eye_height": 768,
                            "codec": "avc1.640028",
                            "first_frame": 0,
                            "frames": None,
                            "playlist": "/api/v1/streams/stage/watch/result/index.m3u8",
                            "live": "/api/v1/streams/stage/watch/result/live",
                            "stills": "/api/v1/streams/stage/watch/result/stills",
                            "broadcast": "6f1f0c0f6d3b4c0b9d1a52c1a4f2f7ce",
                        }
                    },
                }
            ]
        }
    )

    state: State = Field(description="`silent`: of a stream of which no more pictures come")
    silent_since: datetime | None = Field(description="when the last one came; else null")
    frames_total: int | None
    sampling: str = Field(description="where the pixels of `before` lie on the grid of `result`")
    tracks: dict[str, TrackView] = Field(description="`result`, and `before` where there is one")


@dataclass(frozen=True, kw_only=True)
class _Programme:
    """A job or a stream that may be watched."""

    kind: Kind
    name: str
    job: JobRecord | None
    state: Any
    """Of the application."""

    def on_air(self, track: str) -> Broadcast | None:
        found: Broadcast | None = self.state.broadcasts.get(
            broadcast_name(self.kind, self.name, track)
        )
        return found

    def on_disk(self, track: str) -> Track | None:
        return None if self.job is None else job_track(self.state.config.data, self.name, track)

    @property
    def ended(self) -> bool:
        return self.job is not None and self.job.state.is_final

    def address(self, track: str, what: str) -> str:
        return f"/api/v1/{self.kind}/{self.name}/watch/{track}/{what}"


def _programme(connection: HTTPConnection, kind: Kind, name: str, client: Client) -> _Programme:
    state = connection.app.state
    if kind == "jobs":
        job = find_job(connection, name, client)
        return _Programme(kind=kind, name=job.id, job=job, state=state)
    on_air = state.broadcasts.get(broadcast_name(kind, name, "result")) is not None
    if state.streams.get(name) is not None or not on_air:
        find_stream(connection, client, name)
    return _Programme(kind=kind, name=name, job=None, state=state)


@router.get("/{kind}/{name}/watch", responses=responses(404, 422))
def watch(request: Request, kind: Kind, name: Name, client: Reader) -> WatchView:
    """Tell what there is to watch, and where."""
    programme = _programme(request, kind, name, client)
    tracks = {}
    for track in ("result", "before"):
        seen = _view_of_disk(programme, track) if kind == "jobs" else _view_of_air(programme, track)
        if seen is not None:
            tracks[track] = seen
    job = programme.job
    state: State = "live"
    silent: datetime | None = None
    settings: Mapping[str, Any] = {}
    if job is not None:
        state = "ended" if programme.ended else "growing" if tracks else "waiting"
        settings = job.request["request"].get("settings", {})
    elif not tracks:
        state = "waiting"
    if (stream := request.app.state.streams.get(name)) is not None and job is None:
        settings = stream.settings
        on_air = programme.on_air("result")
        silent = None if on_air is None else silent_since(stream, on_air)
        state = state if silent is None else "silent"
    return WatchView(
        state=state,
        silent_since=silent,
        frames_total=None if job is None else job.frames_total,
        sampling=settings.get("sampling", "area"),
        tracks=tracks,
    )


def _view_of_disk(programme: _Programme, name: str) -> TrackView | None:
    track = programme.on_disk(name)
    assert track is not None
    info, init, pieces = track.info, track.init(), track.pieces()
    if info is None or init is None or not pieces:
        return None
    return TrackView(
        layout=info.layout,
        fps=float(info.rate),
        eye_width=info.eye_width,
        eye_height=info.eye_height,
        codec=read_init(init.read_bytes()).codec,
        first_frame=info.first_frame,
        frames=sum(piece.num_frames for piece in pieces),
        broadcast=None,
        **_addresses(programme, name),
    )


def _view_of_air(programme: _Programme, name: str) -> TrackView | None:
    broadcast = programme.on_air(name)
    init = None if broadcast is None else broadcast.newest_init
    if broadcast is None or init is None:
        return None
    wide, high = broadcast.layout.side_by_side, broadcast.layout.top_bottom
    return TrackView(
        layout=broadcast.layout.value,
        fps=float(broadcast.fps),
        eye_width=init.width // 2 if wide else init.width,
        eye_height=init.height // 2 if high else init.height,
        codec=init.codec,
        first_frame=0,
        frames=None,
        broadcast=broadcast.id,
        **_addresses(programme, name),
    )


def _addresses(programme: _Programme, track: str) -> dict[str, Any]:
    on_air = None if programme.ended else programme.on_air(track)
    return {
        "playlist": programme.address(track, "index.m3u8"),
        "live": None if on_air is None or on_air.ended else programme.address(track, "live"),
        "stills": programme.address(track, "stills"),
    }


@router.get(
    "/{kind}/{name}/watch/{track}/index.m3u8",
    response_class=Response,
    responses={
        200: {
            **TAGGED,
            "description": "The playlist (RFC 8216)",
            "content": {HLS: {"schema": {"type": "string"}, "example": EXAMPLE_PLAYLIST}},
        },
        304: {"description": "Nothing new"},
        **responses(404, 422),
    },
)
async def playlist(
    request: Request,
    kind: Kind,
    name: Name,
    track: TrackName,
    client: Reader,
    if_none_match: Known = None,
) -> Response:
    """Return the HLS playlist: of a job all that is done so far, of a stream the last seconds."""
    programme = await asyncio.to_thread(_programme, request, kind, name, client)
    disk, air = programme.on_disk(track), programme.on_air(track)
    text = ""
    if disk is not None:
        text = await asyncio.to_thread(_playlist_of, disk, ended=programme.ended)
    elif air is not None:
        await air.filled()
        text = air.playlist()
    if not text:
        raise ProblemError("not-found", "there is nothing to watch yet")
    tag = tag_of(text)
    if matches(if_none_match, tag):
        return unchanged(tag)
    return Response(text, media_type=HLS, headers={"ETag": tag, "Cache-Control": "no-cache"})


def _playlist_of(track: Track, *, ended: bool) -> str:
    return "" if track.info is None else track.playlist(ended=ended)


@router.get(
    "/{kind}/{name}/watch/{track}/stills",
    response_class=StreamingResponse,
    responses={
        200: {
            "description": "JPEG pictures, each in place of the one before",
            "content": {"multipart/x-mixed-replace": BYTES},
        },
        **responses(404, 422),
    },
)
def stills(request: Request, kind: Kind, name: Name, track: TrackName, client: Reader) -> Response:
    """Send pictures as they come, for viewers that play no video; a slow one skips some."""
    programme = _programme(request, kind, name, client)
    air, disk = programme.on_air(track), programme.on_disk(track)
    if air is not None:
        pictures = _stills_of_air(air)
    elif disk is not None and disk.info is not None:
        pictures = _stills_of_disk(request, disk)
    else:
        raise ProblemError("not-found", "there is nothing to watch yet")
    kind_of = f"multipart/x-mixed-replace; boundary={BOUNDARY}"
    if request.method == "HEAD":
        return Response(media_type=kind_of)
    return StreamingResponse(_multipart(pictures), media_type=kind_of)


async def _stills_of_air(broadcast: Broadcast) -> AsyncGenerator[bytes, None]:
    async with aclosing(broadcast.stills()) as pictures:
        async for still in pictures:
            yield still.jpeg


async def _stills_of_disk(request: Request, track: Track) -> AsyncGenerator[bytes, None]:
    info = track.info
    assert info is not None
    for piece in await asyncio.to_thread(track.pieces):
        path = track.still(piece.number)
        if path is None or request.app.state.notices.stopping:
            return
        yield await asyncio.to_thread(path.read_bytes)
        await asyncio.sleep(float(piece.num_frames / info.rate))


async def _multipart(pictures: AsyncGenerator[bytes, None]) -> AsyncGenerator[bytes, None]:
    """Yield each picture with the boundary after it, so that it is shown at once."""
    yield f"--{BOUNDARY}\r\n".encode()
    async with aclosing(pictures) as jpegs:
        async for jpeg in jpegs:
            head = f"Content-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            yield head.encode() + jpeg + f"\r\n--{BOUNDARY}\r\n".encode()


PART: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The file",
        "content": {
            "video/mp4": BYTES,
            "image/jpeg": BYTES,
        },
    },
    206: {"description": "The bytes asked for by Range"},
    304: {"description": "Nothing new"},
}


@router.get(
    "/{kind}/{name}/watch/{track}/latest.jpg",
    response_class=Response,
    responses={
        **PART,
        200: {"description": "The picture", "content": {"image/jpeg": BYTES}},
        **responses(404, 416, 422),
    },
)
async def latest(
    request: Request,
    kind: Kind,
    name: Name,
    track: TrackName,
    client: Reader,
    if_none_match: Known = None,
) -> Response:
    """Return the newest picture; of a stream it is made now."""
    programme = await asyncio.to_thread(_programme, request, kind, name, client)
    disk = programme.on_disk(track)
    if disk is not None:
        path = await asyncio.to_thread(_latest_of, disk)
        if path is not None:
            return send_file(path, if_none_match, "image/jpeg")
    elif (air := programme.on_air(track)) is not None:
        still = await air.still()
        if still is not None:
            return Response(still.jpeg, media_type="image/jpeg")
    raise ProblemError("not-found", "there is no picture yet")


def _latest_of(track: Track) -> Path | None:
    pieces = track.pieces()
    return track.still(pieces[-1].number) if pieces else None


@router.get(
    "/{kind}/{name}/watch/{track}/{part}",
    response_class=Response,
    responses={**PART, **responses(400, 404, 416, 422)},
)
def part_of(
    request: Request,
    kind: Kind,
    name: Name,
    track: TrackName,
    part: Annotated[
        str,
        InPath(
            max_length=40,
            description="`init-0.mp4`, `segment-000000.m4s` as the playlist says; the first "
            "picture of a segment of a job, `segment-000000.jpg`",
            examples=["segment-000000.m4s"],
        ),
    ],
    client: Reader,
    if_none_match: Known = None,
) -> Response:
    """Return a part of the video, or a picture of it."""
    programme = _programme(request, kind, name, client)
    disk = programme.on_disk(track)
    if disk is not None:
        path = _file_of(disk, part)
        if path is not None:
            kind_of = "image/jpeg" if part.endswith(".jpg") else "video/mp4"
            return send_file(path, if_none_match, kind_of)
    elif (air := programme.on_air(track)) is not None:
        found = _bytes_of(air, part)
        if found is not None:
            return found
    raise ProblemError("not-found", "the video has no such part (any more)")


def _file_of(track: Track, part: str) -> Path | None:
    if part == "init-0.mp4":
        return track.init()
    match = re.fullmatch(r"segment-([0-9]{6})\.(m4s|jpg)", part)
    if match is None:
        return None
    number = int(match[1])
    return track.piece(number) if match[2] == "m4s" else track.still(number)


def _bytes_of(broadcast: Broadcast, part: str) -> Response | None:
    match = re.fullmatch(r"(?:init-([0-9]{1,9})\.mp4)|(?:segment-([0-9]{6,12})\.m4s)", part)
    if match is None:
        return None
    if match[1]:
        init = broadcast.init(int(match[1]))
        return None if init is None else Response(init.data, media_type="video/mp4")
    fragments = broadcast.segment(int(match[2]))
    if fragments is None:
        return None
    length = str(sum(map(len, fragments)))
    return StreamingResponse(
        iter(fragments), media_type="video/mp4", headers={"Content-Length": length}
    )


@router.websocket("/{kind}/{name}/watch/{track}/live")
async def live(websocket: WebSocket, kind: Kind, name: str, track: TrackName) -> None:
    """Send the live edge: JSON texts say what comes, binary messages are the parts of an MP4.

    ``{"kind": "init", "codec": …}`` comes before an init segment; ``{"kind": "gap"}`` where
    the viewer was too slow, before a key frame; ``{"kind": "end"}`` last.
    """
    try:
        client = _viewer(websocket)
        programme = await asyncio.to_thread(_programme, websocket, kind, name, client)
    except ProblemError:
        await websocket.close()  # before it is accepted: the answer is 403
        return
    broadcast = programme.on_air(track)
    await websocket.accept()
    sending = asyncio.create_task(_send(websocket, broadcast))
    leaving = asyncio.create_task(_until_gone(websocket))
    try:
        await asyncio.wait((sending, leaving), return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in (sending, leaving):
            task.cancel()
        await asyncio.gather(sending, leaving, return_exceptions=True)


def _viewer(websocket: WebSocket) -> Client:
    """Return who asks for a WebSocket, which browsers open for pages of any origin."""
    origin = websocket.headers.get("origin")
    if origin and urlsplit(origin).netloc != websocket.headers.get("host"):
        raise ProblemError("forbidden", "pages of another origin may not do this")
    client = identify(websocket)
    if "read" not in client.scopes:
        raise ProblemError("forbidden", "the token has no scope read")
    return client


async def _send(websocket: WebSocket, broadcast: Broadcast | None) -> None:
    if broadcast is not None:
        async with aclosing(broadcast.watch()) as parts:
            async for part in parts:
                for message in _messages(part):
                    if isinstance(message, str):
                        await websocket.send_text(message)
                    else:
                        await websocket.send_bytes(message)
    await websocket.send_text(json.dumps({"kind": "end"}))
    await websocket.close()


def _messages(part: Init | Fragment | Gap) -> Iterator[str | bytes]:
    if isinstance(part, Gap):
        yield json.dumps({"kind": "gap", "fragments": part.fragments})
        return
    if isinstance(part, Init):
        yield json.dumps({"kind": "init", "codec": part.codec})
    yield part.data


async def _until_gone(websocket: WebSocket) -> None:
    try:
        while True:
            await websocket.receive_bytes()
    except (WebSocketDisconnect, KeyError, RuntimeError):
        return


add_heads(router)
