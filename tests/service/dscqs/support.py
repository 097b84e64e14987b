"""Stimuli that a test knows again, and a walk through a session as a page does it."""

from __future__ import annotations

import multiprocessing
import socket
import time
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import uvicorn

from pipeline.media.png import encode_png
from tests.support.assessor_client import AssessorClient
from tests.support.ports import free_port
from tests.support.waiting import PATIENCE

CONTENTS, CONDITIONS, REFERENCE = ("ballet", "street"), ("bicubic", "sr"), "original"


def colour_of(content: str, condition: str) -> tuple[int, int, int]:
    """Every stimulus has a colour of its own, by which a test knows it again."""
    contents, conditions = (*CONTENTS, "meadow"), (REFERENCE, *CONDITIONS)
    return 40 + 60 * contents.index(content), 30 + 70 * conditions.index(condition), 90


def write_stimuli(folder: Path) -> dict[str, str]:
    """Write the pictures of a plan; noise makes their lengths differ much."""
    folder.mkdir(parents=True, exist_ok=True)
    stimuli = {}
    for content in (*CONTENTS, "meadow"):
        for number, condition in enumerate((REFERENCE, *CONDITIONS)):
            picture = np.zeros((24, 64, 3), np.uint8)
            picture[:] = colour_of(content, condition)
            noise = np.random.default_rng(number).integers(0, 256, (24, 12 * number, 3))
            picture[:, 8 : 8 + noise.shape[1]] = noise
            name = f"{content}-{condition}.png"
            (folder / name).write_bytes(encode_png(picture))
            stimuli[f"{content}/{condition}"] = name
    return stimuli


def walk(client: AssessorClient, *, until: Callable[[dict], bool] = lambda state: False) -> dict:
    """Go through a session as a page does, until its end or where ``until`` says."""
    state = client.state()
    while state["stage"] != "thanks" and not until(state):
        state = step(client, state)
    return state


def step(client: AssessorClient, state: dict) -> dict:
    """Do what the present stage asks for."""
    stage = state["stage"]
    if stage in ("instructions", "break"):
        return client.leave(stage)
    if stage not in ("training", "presentation"):
        return client.leave(stage, {"answer": stage})
    dimensions = client.present()["dimensions"]
    for side in ("A", "B"):
        client.fetch(side)
    client.shown(log={"intervals": [{"what": "A", "late": 0, "dropped": 0}]})
    index = state["index"]
    return client.grade({name: {"A": 50.5 + index, "B": 20.1} for name in dimensions})


@dataclass
class KillableService:
    """The application in a process of its own that is forked, so that it starts at once."""

    data: Path
    roots: Path
    port: int = 0
    process: BaseProcess | None = None

    def start(self) -> None:
        if not self.port:
            self.port = free_port()
        forks = multiprocessing.get_context("forkserver")
        forks.set_forkserver_preload(["service.app", "uvicorn"])
        self.process = forks.Process(target=_serve, args=(self.data, self.roots, self.port))
        self.process.start()
        until = time.monotonic() + PATIENCE
        while True:
            try:
                with socket.create_connection(("127.0.0.1", self.port), timeout=1):
                    return
            except OSError:
                assert self.process.is_alive()
                assert time.monotonic() < until
                time.sleep(0.02)

    def kill(self) -> None:
        """End it as a crash does: SIGKILL, no goodbye."""
        assert self.process is not None
        self.process.kill()
        self.process.join(PATIENCE)

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"


def _serve(data: Path, roots: Path, port: int) -> None:
    from service.app import create_app
    from service.config import ServiceConfig

    app = create_app(ServiceConfig(data=data, workers=0, roots=(roots,), zenoh="off"))
    uvicorn.run(app, host="127.0.0.1", port=port, log_config=None, ws="none")
