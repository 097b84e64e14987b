"""Runs the application under uvicorn, and ends it within its time, streams open or not."""

from __future__ import annotations

import math
import socket
from collections.abc import Callable
from types import FrameType

import uvicorn
from fastapi import FastAPI

from pipeline.errors import ConfigurationError
from service.config import ServiceConfig


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
