"""A real service in a process of its own, and a scene small enough for it."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import pytest

from tests.support.waiting import PATIENCE

QUIET = {"DEPTHSR_ZENOH": "off", "DEPTHSR_WORKER_NICE": "0"}
"""No streams unless asked for; and workers of jobs do not wait for the tests beside."""


@dataclass
class LiveService:
    """``depthsr serve`` on a free port; its data folder outlives it."""

    data: Path
    options: tuple[str, ...] = ()
    environment: dict[str, str] = field(default_factory=dict)
    process: subprocess.Popen[str] | None = None
    url: str = ""

    def start(self) -> LiveService:
        with (self.data.parent / f"{self.data.name}.log").open("a") as log:
            self.process = subprocess.Popen(
                [
                    sys.executable, "-m", "service", "serve", "--port", "0",
                    "--data", str(self.data), *self.options,
                ],
                stdout=subprocess.PIPE, stderr=log, text=True,
                env={**os.environ, **QUIET, **self.environment},
            )  # fmt: skip
        assert self.process.stdout is not None
        said = self.process.stdout.readline()
        found = re.search(r"http://\S+", said)
        assert found, f"the service said {said!r}"
        self.url = found[0]
        with httpx.Client(transport=httpx.HTTPTransport(retries=5), base_url=self.url) as client:
            assert client.get("/readyz", timeout=PATIENCE).status_code == 200
        return self

    def end(self, number: int = signal.SIGTERM) -> int:
        assert self.process is not None
        self.process.send_signal(number)
        status = self.process.wait(PATIENCE)
        assert self.process.stdout is not None
        self.process.stdout.close()
        return status


@pytest.fixture(scope="session")
def tiny_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a scene of 48×36 pixels, three views, six frames."""
    from pipeline.synthetic.scene import SampleScene
    from pipeline.synthetic.writing import write_scene

    folder = tmp_path_factory.mktemp("scenes") / "tiny"
    write_scene(folder, SampleScene(width=48, height=36, num_views=3), num_frames=6)
    return folder


@pytest.fixture
def make_service(tmp_path: Path) -> Iterator[Callable[..., LiveService]]:
    """Return what starts a service; whatever still runs at the end is killed."""
    made: list[LiveService] = []

    def make(*options: str, data: Path | None = None, **environment: str) -> LiveService:
        service = LiveService(data or tmp_path / "data", options, environment)
        made.append(service)
        return service.start()

    yield make
    for service in made:
        if service.process is not None and service.process.poll() is None:
            service.end(signal.SIGKILL)


@pytest.fixture(scope="session")
def live_service(
    tmp_path_factory: pytest.TempPathFactory, tiny_scene: Path
) -> Iterator[LiveService]:
    """One service for all tests that leave it well."""
    folder = tmp_path_factory.mktemp("live")
    options = ("--roots", str(tiny_scene.parent), "--zenoh-listen", "tcp/127.0.0.1:0")
    service = LiveService(folder / "data", options, {"DEPTHSR_ZENOH": "router"}).start()
    yield service
    assert service.end() in (0, -signal.SIGTERM)
