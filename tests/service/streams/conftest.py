"""Streams with real processes on loopback: a service, sources and subscribers."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import pytest

from service.bus.config import BusConfig
from service.bus.zenoh_bus import ZenohBus

PATIENCE = 90.0
"""Seconds for anything: the machine may be busy."""


def free_endpoint(kind: str = "tcp", host: str = "127.0.0.1") -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"{kind}/{host}:{probe.getsockname()[1]}"


def until(check: Callable[[], Any], patience: float = PATIENCE) -> Any:
    """Wait until something is so, and return it."""
    deadline = time.monotonic() + patience
    pause = threading.Event()
    while not (found := check()):
        assert time.monotonic() < deadline, "it never came about"
        pause.wait(0.05)
    return found


@dataclass
class Stage:
    """A service with streams, and what has been started around it."""

    service: Any
    endpoint: str
    words: tuple[str, ...] = ()
    """Options of publish and subscribe besides the endpoint."""
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def status(self, stream: str) -> dict[str, Any]:
        answer = httpx.get(f"{self.service.url}/api/v1/streams/{stream}", timeout=30)
        return answer.json() if answer.is_success else {"state": "none", "status": {}}

    def state(self, stream: str) -> str:
        return self.status(stream)["state"]

    def worker(self, stream: str) -> int:
        """Return the process id of the stream's worker."""
        children = Path(f"/proc/{self.service.process.pid}/task")
        for task in children.iterdir():
            for pid in (task / "children").read_text().split():
                words = Path(f"/proc/{pid}/cmdline").read_bytes()
                if b"service.streams.worker" in words:
                    return int(pid)
        return 0

    def bus(self) -> ZenohBus:
        return ZenohBus(BusConfig(connect=(self.endpoint,)))

    def run(self, command: str, *words: str, **more: Any) -> subprocess.Popen[str]:
        """Start ``depthsr publish`` or ``subscribe``."""
        process = subprocess.Popen(
            [
                sys.executable, "-m", "service", command, *words, "--connect", self.endpoint,
                *self.words,
            ],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
            env={**os.environ, **more},
        )  # fmt: skip
        self.started.append(process)
        return process

    def end(self) -> None:
        for process in self.started:
            if process.poll() is None:
                process.send_signal(signal.SIGTERM)
        for process in self.started:
            process.communicate(timeout=PATIENCE)


@pytest.fixture
def make_stage(make_service, tmp_path) -> Iterator[Callable[..., Stage]]:
    """Return what starts a service with streams."""
    made: list[Stage] = []

    def make(*options: str, kind: str = "tcp", host: str = "127.0.0.1", **more: Any) -> Stage:
        endpoint = free_endpoint(kind, host)
        service = make_service(
            "--zenoh", "router", "--zenoh-listen", endpoint, "--worker-threads", "1", *options
        )
        stage = Stage(service, endpoint, **more)
        made.append(stage)
        return stage

    yield make
    for stage in made:
        stage.end()
