"""The service put together: settings, store, scheduler and the routers of its doors."""

from __future__ import annotations

import asyncio
import logging
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from importlib import metadata
from pathlib import Path
from typing import Any

from fastapi import APIRouter, FastAPI
from fastapi.responses import JSONResponse
from fastapi.routing import APIRoute
from starlette.routing import BaseRoute

from service.bus.bus import Bus
from service.bus.config import BusConfig
from service.config import ServiceConfig
from service.desks import Desks
from service.http import (
    archive,
    dscqs,
    dscqs_making,
    dscqs_operator,
    dscqs_pages,
    exports,
    health,
    job_events,
    job_views,
    jobs,
    pages,
    problems,
    results,
    session,
    status,
    streams,
    submissions,
    uploads,
    watch,
)
from service.http.auth import Tokens
from service.http.dscqs_access import Operators
from service.http.guards import Guards
from service.jobs.request import JobRequest
from service.live.broadcast import Broadcasts
from service.live.job_watch import JobWatch
from service.metrics import Metrics
from service.notices import Notices
from service.scheduler import Scheduler
from service.store import Store
from service.streams.streams import Streams

log = logging.getLogger(__name__)

ROUTERS: tuple[APIRouter, ...] = (
    submissions.router, jobs.router, job_events.router, results.router, streams.router,
    uploads.router, session.router, health.router, watch.router, status.router, pages.router,
    exports.router, archive.router,
    dscqs.router, dscqs_operator.router, dscqs_making.router, dscqs_pages.router,
)  # fmt: skip
"""Every door of the service."""

WITH_NULLS: tuple[Any, ...] = (
    job_views.JobView, job_views.JobPage, streams.StreamView, streams.StreamPage, watch.WatchView,
    dscqs_operator.Progress,
)  # fmt: skip
"""Models whose examples have nulls, which FastAPI leaves out of its description."""


def create_app(config: ServiceConfig) -> FastAPI:
    """Return the application; its lifespan opens the data folder and starts the workers.

    Afterwards ``app.state`` has ``config``, ``store``, ``scheduler``, ``streams``, ``notices``,
    ``tokens``, ``metrics``, ``broadcasts``, ``desks`` and ``operators``.
    """

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        store = Store(config.data, on_change=app.state.notices.tell)
        try:
            app.state.desks = Desks(config.data)
            on_air = JobWatch(config.data, app.state.broadcasts)
            scheduler = Scheduler(
                store,
                config,
                on_event=app.state.metrics.of_worker,
                on_piece=on_air.take,
                on_end=on_air.end,
            )
            app.state.store, app.state.scheduler = store, scheduler
            app.state.metrics.watch(store, scheduler)
            await asyncio.to_thread(uploads.sweep, store)
            live = Streams(
                config,
                open_bus=_open_bus,
                broadcasts=app.state.broadcasts,
                on_change=app.state.notices.tell,
            )
            app.state.streams = live
            app.state.metrics.watch_streams(live)
            await asyncio.to_thread(scheduler.start)
            await asyncio.to_thread(live.start)
            sweeping = asyncio.create_task(uploads.keep_swept(store))
            try:
                yield
            finally:
                sweeping.cancel()
                app.state.notices.stop()
                app.state.broadcasts.stop()
                await asyncio.gather(
                    asyncio.to_thread(scheduler.close), asyncio.to_thread(live.close)
                )
        finally:
            if hasattr(app.state, "desks"):
                app.state.desks.close()
            store.close()

    app = FastAPI(
        title="depthsr",
        version=metadata.version("depthsr"),
        summary="Depth-guided super-resolution of multi-view 3D video",
        lifespan=lifespan,
        responses=problems.responses(401, 403, 500, 503),
        docs_url=None,
        redoc_url=None,
        openapi_url=None,
    )
    app.state.config = config
    app.state.notices = Notices()
    app.state.broadcasts = Broadcasts()
    key = _signing_key(config.data)
    app.state.tokens = Tokens(config.token_file, key=key)
    app.state.operators = Operators(app.state.tokens, config.data, key)
    app.state.metrics = Metrics()
    app.add_middleware(Guards, config=config)
    for router in ROUTERS:
        app.include_router(router)
    _declare(app)
    problems.add_handlers(app, [*_routes(), *app.routes])
    return app


def _open_bus(config: BusConfig) -> Bus:
    from service.bus.zenoh_bus import ZenohBus  # a service without streams need not load it

    return ZenohBus(config)


def _routes() -> list[BaseRoute]:
    return [route for router in ROUTERS for route in router.routes]


def _restore_answers(schema: dict[str, Any]) -> None:
    """Put the examples of answers back as they were declared, nulls among them."""
    for route in _routes():
        if not (isinstance(route, APIRoute) and route.include_in_schema):
            continue
        for method in route.methods or ():
            described = schema["paths"][route.path_format][method.lower()]["responses"]
            for code, answer in route.responses.items():
                for kind, item in answer.get("content", {}).items():
                    declared = {key: item[key] for key in item if key.startswith("example")}
                    described[str(code)]["content"][kind] |= declared


def _declare(app: FastAPI) -> None:
    """Add what FastAPI cannot see to the OpenAPI description: problems and bearer tokens."""
    made = app.openapi

    def openapi() -> dict[str, object]:
        if app.openapi_schema:
            return app.openapi_schema
        schema = made()
        components = schema.setdefault("components", {})
        template = "#/components/schemas/{model}"
        for model in (problems.Problem, JobRequest):
            made_schema = model.model_json_schema(ref_template=template)
            for name, part in made_schema.pop("$defs", {}).items():
                components.setdefault("schemas", {})[name] = part
            components.setdefault("schemas", {})[model.__name__] = made_schema
        for model in WITH_NULLS:
            components["schemas"][model.__name__] |= model.model_config["json_schema_extra"]
        _restore_answers(schema)
        components["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
        if app.state.tokens.are_needed:
            schema["security"] = [{"token": []}]
        return schema

    app.openapi = openapi  # type: ignore[method-assign]

    @app.api_route("/api/openapi.json", methods=["GET", "HEAD"], include_in_schema=False)
    def description() -> JSONResponse:
        """Answer from a thread: making it takes half a second, which others need not wait for."""
        return JSONResponse(app.openapi())


def _signing_key(data: Path) -> bytes:
    """Return the key of signed addresses, which outlives a restart."""
    data.mkdir(parents=True, exist_ok=True, mode=0o700)
    path = data / "signing.key"
    try:
        key = path.read_bytes()
    except FileNotFoundError:
        key = b""
    if len(key) < 32:
        key = secrets.token_bytes(32)
        path.touch(mode=0o600)
        path.write_bytes(key)
    return key
