"""What the dashboard shows: queue, workers, what is on air, the machine."""

from __future__ import annotations

import os
import shutil
import time
from importlib import metadata
from typing import Annotated

from fastapi import APIRouter, Request
from pydantic import BaseModel, Field

from service.config import MIB
from service.http.auth import Client, require
from service.http.files import add_heads
from service.http.quota import folder_size
from service.jobs.states import State

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


class Status(BaseModel):
    """The service at a glance."""

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


def _sees(request: Request, client: Client, job_id: str) -> bool:
    record = request.app.state.store.job(job_id)
    return record is not None and (client.sees_all or record.client == client.name)


add_heads(router)
