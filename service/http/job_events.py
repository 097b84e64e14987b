"""What happens in a job: by polling, or as a stream of server-sent events."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from dataclasses import asdict
from datetime import datetime
from typing import Annotated, Any

from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, ConfigDict

from service.http.files import add_heads
from service.http.job_views import JobId, Reader, find_job, time_of
from service.http.problems import responses
from service.store import EventRecord

router = APIRouter(prefix="/api/v1", tags=["jobs"])

BREATH = 15.0
"""A comment keeps an idle stream of events open this often, seconds."""

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


def _event(item: EventRecord) -> EventView:
    return EventView(**{**asdict(item), "at": time_of(item.at)})


add_heads(router)
