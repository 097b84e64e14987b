"""What the dashboard shows: queue, workers, what is on air, the machine."""

from __future__ import annotations

import os
import shutil
import time
from datetime import UTC, datetime
from importlib import metadata
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, ConfigDict, Field

from service.config import MIB
from service.http.auth import Client, require
from service.http.files import add_heads
from service.http.quota import folder_size
from service.jobs.states import State
from service.live.broadcast import Broadcast
from service.streams.states import State as StreamState
from service.streams.stream import Stream

router = APIRouter(prefix="/api/v1", tags=["operation"])

_BEGIN = time.time()


class Workers(BaseModel):
    """Who computes."""

    busy: int
    total: int
    jobs: list[str] = Field(description="ids of the jobs being worked on that the client may see")


class Disk(BaseModel):
    """Room for results."""

    free: int = Field(description="bytes")
    used: int = Field(description="bytes of the data folder, a few seconds old")
    quota: int = Field(description="bytes that the data folder may have")


class OnAir(BaseModel):
    """A stream that can be watched."""

    name: str
    viewers: int
    fragments: int
    left_out: int = Field(description="fragments that slow viewers did not get")
    silent_since: datetime | None = Field(
        None, description="when the last frame came, of a stream that is not live now"
    )


class Status(BaseModel):
    """The service at a glance."""

    model_config = ConfigDict(
        json_schema_extra={
            "examples": [
                {
                    "version": "0.1.0",
                    "seconds": 86400.0,
                    "ready": True,
                    "queue": {"queued": 3, "running": 1},
                    "workers": {
                        "busy": 1, "total": 1, "jobs": ["3f0c5d9a7be24c6f8d1e0a4b5c6d7e8f"]
                    },
                    "disk": {"free": 214748364800, "used": 73400320, "quota": 107374182400},
                    "load": 1.5,
                    "cores": 2,
                    "streams": [
                        {"name": "stage", "viewers": 2, "fragments": 1800, "left_out": 0,
                         "silent_since": None}
                    ],
                }
            ]
        }
    )  # fmt: skip

    version: str
    seconds: float = Field(description="since the service began")
    ready: bool
    queue: dict[State, int] = Field(description="jobs of the client by state")
    workers: Workers
    disk: Disk
    load: float | None = Field(description="processes wanting a core, mean of a minute")
    cores: int
    streams: list[OnAir]


@router.get("/status")
def status(request: Request, client: Annotated[Client, require("read")]) -> Status:
    """Tell what goes on: jobs by state, workers, disk, streams on air."""
    state = request.app.state
    usage = shutil.disk_usage(state.config.data)
    mine = [job for job in state.scheduler.pids if _sees(request, client, job)]
    streams = [
        OnAir(
            name=name.removeprefix("streams/"),
            viewers=found.viewers,
            fragments=found.fragments,
            left_out=found.left_out,
            silent_since=silent_since(state.streams.get(name.removeprefix("streams/")), found),
        )
        for name, found in sorted(state.broadcasts.all().items())
        if name.startswith("streams/") and not name.endswith("/before") and not found.ended
    ]
    return Status(
        version=metadata.version("depthsr"),
        seconds=round(time.time() - _BEGIN, 1),
        ready=state.scheduler.is_alive
        and not state.notices.stopping
        and usage.free >= state.config.disk_reserve * MIB,
        queue=state.store.counts(None if client.sees_all else client.name),
        workers=Workers(busy=state.scheduler.busy, total=state.config.workers, jobs=mine),
        disk=Disk(
            free=usage.free, used=folder_size(state.config.data), quota=state.config.quota * MIB
        ),
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        cores=os.cpu_count() or 1,
        streams=streams,
    )


def silent_since(stream: Stream | None, found: Broadcast) -> datetime | None:
    """Return when the last picture of a stream came; None while they come."""
    if stream is None or stream.state is StreamState.LIVE or found.newest_at is None:
        return None
    return datetime.fromtimestamp(found.newest_at, UTC)


def _sees(request: Request, client: Client, job_id: str) -> bool:
    record = request.app.state.store.job(job_id)
    return record is not None and (client.sees_all or record.client == client.name)


add_heads(router)
