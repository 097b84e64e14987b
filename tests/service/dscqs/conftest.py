"""A service with a plan of pictures, and clients of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
import pytest
import uvicorn
from fastapi import FastAPI

from service.app import create_app
from service.config import ServiceConfig
from service.dscqs_client import OperatorClient
from service.http.dscqs_access import TOKEN_FILE
from tests.service.dscqs.support import CONDITIONS, CONTENTS, REFERENCE, write_stimuli
from tests.support.assessor_client import AssessorClient
from tests.support.waiting import PATIENCE


@dataclass(frozen=True, kw_only=True)
class Served:
    """The application, served by a thread of this process."""

    app: FastAPI
    url: str
    data: Path
    root: Path

    @property
    def token(self) -> str:
        return (self.data / TOKEN_FILE).read_text().strip()


@pytest.fixture(scope="session")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """One service for all tests; each makes tests of its own."""
    folder = tmp_path_factory.mktemp("served")
    (folder / "roots").mkdir()
    app = create_app(
        ServiceConfig(data=folder / "data", workers=0, roots=(folder / "roots",), zenoh="off")
    )
    server = uvicorn.Server(uvicorn.Config(app, port=0, log_config=None, ws="none"))
    thread = threading.Thread(target=server.run)
    thread.start()
    while not server.started:
        assert thread.is_alive()
        time.sleep(0.01)
    port = server.servers[0].sockets[0].getsockname()[1]
    yield Served(
        app=app, url=f"http://127.0.0.1:{port}", data=folder / "data", root=folder / "roots"
    )
    server.should_exit = True
    thread.join(PATIENCE)
    assert not thread.is_alive()


@pytest.fixture(scope="session")
def stimuli(served: Served) -> dict[str, str]:
    return write_stimuli(served.root / "set1")


@pytest.fixture
def plan(stimuli: dict[str, str]) -> dict[str, Any]:
    """A plan of two contents and two conditions; its files lie under the root."""
    return {
        "name": "set 1", "folder": "set1", "contents": list(CONTENTS),
        "conditions": list(CONDITIONS), "reference": REFERENCE, "dummies": 1,
        "stimuli": {key: name for key, name in stimuli.items() if key != "meadow/bicubic"},
        "training": ["meadow/sr"], "break_every": 3, "break_s": 0,
        "displays": ["polarised", "autostereoscopic"],
    }  # fmt: skip


@pytest.fixture
def make_http(served: Served) -> Iterator[Callable[[], httpx.Client]]:
    """Return what makes a browser without cookies."""
    made: list[httpx.Client] = []

    def make() -> httpx.Client:
        made.append(httpx.Client(base_url=served.url, timeout=PATIENCE))
        return made[-1]

    yield make
    for client in made:
        client.close()


@pytest.fixture
def http(make_http: Callable[[], httpx.Client]) -> httpx.Client:
    return make_http()


@pytest.fixture
def operator(make_http: Callable[[], httpx.Client], served: Served) -> OperatorClient:
    """An operator who is logged in."""
    client = OperatorClient(http=make_http())
    client.login(served.token)
    return client


@pytest.fixture
def enter(
    make_http: Callable[[], httpx.Client], operator: OperatorClient
) -> Callable[..., AssessorClient]:
    """Return what lets an assessor into a test."""

    def enter(test: str, assessor: str = "a1", display: str = "polarised") -> AssessorClient:
        client = AssessorClient(http=make_http())
        client.enter(operator.invite(test, assessor, display))
        return client

    return enter
