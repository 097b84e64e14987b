"""Stimuli that a test knows again, and a walk through a session as a page does it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.media.png import encode_png
from service.dscqs_client import AssessorClient

CONTENTS, CONDITIONS, REFERENCE = ("ballet", "street"), ("bicubic", "sr"), "original"


def colour_of(content: str, condition: str) -> tuple[int, int, int]:
    """Every stimulus has a colour of its own, by which a test knows it again."""
    contents, conditions = (*CONTENTS, "lawn"), (REFERENCE, *CONDITIONS)
    return 40 + 60 * contents.index(content), 30 + 70 * conditions.index(condition), 90


def write_stimuli(folder: Path) -> dict[str, str]:
    """Write the pictures of a plan; noise makes their lengths differ much."""
    folder.mkdir(parents=True, exist_ok=True)
    stimuli = {}
    for content in (*CONTENTS, "lawn"):
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
