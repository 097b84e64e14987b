"""Is it alive, can it work, how much has it done."""

from __future__ import annotations

import shutil
import sqlite3
from typing import Annotated

from fastapi import APIRouter, Request, Response
from fastapi.responses import PlainTextResponse
from pydantic import BaseModel, Field

from service.config import MIB
from service.http.auth import Client, require
from service.http.files import add_heads
from service.http.problems import ProblemError, responses

router = APIRouter(tags=["operation"])


class Health(BaseModel):
    """It is well."""

    status: Annotated[str, Field(examples=["ok"])] = "ok"


@router.get("/healthz")
async def healthz() -> Health:
    """Answer while the event loop turns; needs no token."""
    return Health()


@router.get("/readyz", responses=responses(503))
def readyz(request: Request) -> Health:
    """Answer 503 where jobs or streams could not be worked on now; needs no token."""
    state = request.app.state
    if state.notices.stopping:
        raise ProblemError("unavailable", "the service is stopping")
    if not state.scheduler.is_alive:
        raise ProblemError("unavailable", "the scheduler has ended")
    try:
        state.store.check()
    except sqlite3.Error:
        raise ProblemError("unavailable", "the database cannot be written") from None
    if shutil.disk_usage(state.config.data).free < state.config.disk_reserve * MIB:
        raise ProblemError("unavailable", "the disk is nearly full")
    if state.streams.is_on and state.streams.problem:
        raise ProblemError("unavailable", f"streams: {state.streams.problem}")
    return Health()


@router.get(
    "/metrics",
    response_class=PlainTextResponse,
    responses={200: {"content": {"text/plain": {"example": 'depthsr_jobs{state="queued"} 3.0\n'}}}},
)
def metrics(request: Request, client: Annotated[Client, require("read")]) -> Response:
    """Return the numbers for Prometheus."""
    state = request.app.state
    state.metrics.free.set(shutil.disk_usage(state.config.data).free)
    return Response(state.metrics.text(), media_type="text/plain; version=0.0.4; charset=utf-8")


add_heads(router)
