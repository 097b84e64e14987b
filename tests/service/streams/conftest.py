"""Streams with real processes on loopback: a service, sources and subscribers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import httpx
import pytest

from pipeline.media.layouts import describe_path
from pipeline.media.live_source import LiveSource
from service.bus.config import BusConfig
from service.bus.zenoh_bus import ZenohBus
from tests.support.ports import free_port
from tests.support.waiting import PATIENCE


def free_endpoint(kind: str = "tcp", host: str = "127.0.0.1") -> str:
    return f"{kind}/{host}:{free_port()}"


@dataclass
class Stage:
    """A service with streams, and what has been started around it."""

    service: Any
    endpoint: str
    words: tuple[str, ...] = ()
    """Options of publish and subscribe besides the endpoint."""
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def status(self, stream: str) -> dict[str, Any]:
        answer = httpx.get(f"{self.service.url}/api/v1/streams/{stream}", timeout=PATIENCE)
        return answer.json() if answer.is_success else {"state": "none", "status": {}}

    def state(self, stream: str) -> str:
        return self.status(stream)["state"]

    def worker(self, stream: str) -> int:
        """Return the process id of the stream's worker; 0 while there is none."""
        for task in Path(f"/proc/{self.service.process.pid}/task").iterdir():
            with contextlib.suppress(OSError):  # a thread or a process that has ended meanwhile
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
def source(tiny_scene: Path) -> Iterator[LiveSource]:
    """The tiny scene as cameras give it, 10 frames a second."""
    with LiveSource(describe_path(tiny_scene), fps=Fraction(10)) as source:
        yield source


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
