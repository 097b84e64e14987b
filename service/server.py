"""Runs the application under uvicorn, and ends it within its time, streams open or not."""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import Callable
from types import FrameType
from typing import Any

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from pipeline.errors import ConfigurationError
from service.config import ServiceConfig

HEAD_PATIENCE = 20.0
"""Longest time for the head of a request, seconds."""


class PunctualProtocol(H11Protocol):
    """A connection that is let go when a head does not come in time: others want its place."""

    _timer: asyncio.TimerHandle | None = None
    _last: Any = None
    """The request before the one whose head is waited for."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Wait for the first head."""
        super().connection_made(transport)
        self._expect_head()

    def data_received(self, data: bytes) -> None:
        """Go on, and wait for the rest of a head that has begun."""
        before = self.cycle
        is_head = before is None or before.response_complete
        super().data_received(data)
        if is_head and self.cycle is before:
            self._expect_head()

    def _expect_head(self) -> None:
        if self._timer is not None:
            if self._last is self.cycle:  # that long already
                return
            self._timer.cancel()
        self._last = self.cycle
        self._timer = self.loop.call_later(HEAD_PATIENCE, self._give_up)

    def _give_up(self) -> None:
        """Let go unless a head has come since, or the connection became a WebSocket."""
        self._timer = None
        if self.cycle is self._last and self.transport.get_protocol() is self:
            self.transport.close()


class Server(uvicorn.Server):
    """A server whose open streams learn of the end at once."""

    def __init__(self, settings: uvicorn.Config, on_exit: Callable[[], None]) -> None:
        super().__init__(settings)
        self._on_exit = on_exit

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Wake every stream, then end as uvicorn does."""
        self._on_exit()
        super().handle_exit(sig, frame)


def serve(app: FastAPI, config: ServiceConfig, *, say: Callable[[str], object]) -> None:
    """Serve until a signal; say the address once it is bound.

    Raises
    ------
    ConfigurationError
        If the address cannot be had.
    """
    try:
        listener = socket.create_server(
            (config.host, config.port),
            family=socket.AF_INET6 if ":" in config.host else socket.AF_INET,
            backlog=2048,
        )
    except OSError as error:
        raise ConfigurationError(
            f"--host, --port: {config.host}:{config.port} cannot be had: {error.strerror}"
        ) from error
    settings = uvicorn.Config(
        app,
        http=PunctualProtocol,
        log_config=None,
        server_header=False,
        timeout_keep_alive=15,
        timeout_graceful_shutdown=max(1, math.ceil(config.grace)),
        limit_concurrency=1000,
        ws_per_message_deflate=False,  # video does not get smaller
    )

    def end_streams() -> None:
        app.state.notices.stop()
        app.state.broadcasts.stop()

    server = Server(settings, end_streams)
    host, port = listener.getsockname()[:2]
    shown = f"[{host}]" if ":" in host else host
    say(f"depthsr serves http://{shown}:{port}")
    with listener:
        server.run(sockets=[listener])
