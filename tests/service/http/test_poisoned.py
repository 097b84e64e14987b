"""Broken files by the hundred: refused or failed with a reason, and never worse."""

from __future__ import annotations

import json
import random

import httpx
import pytest

from service.client import Client

COUNT = 200
WORKED = 6
"""So many of them go through a worker."""


def _mutated(data: bytes, chance: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(chance.randint(1, 6)):
        kind, at = chance.randrange(4), chance.randrange(max(1, len(out)))
        if kind == 0:
            out[at : at + 1] = bytes([chance.randrange(256)])
        elif kind == 1:
            del out[at:]
        elif kind == 2:
            out[at:at] = chance.randbytes(chance.randint(1, 64))
        else:
            out[at : at + 4] = b"\xff\xff\xff\xff"
        if not out:
            break
    return bytes(out)


@pytest.fixture
def corpus(tiny_scene):
    """Return scenes of which each has one broken file."""
    chance = random.Random(4)
    good = {
        path.relative_to(tiny_scene).as_posix(): path.read_bytes()
        for path in sorted(tiny_scene.rglob("*"))
        if path.is_file()
    }
    first = {name: data for name, data in good.items() if "-0000." in name or "json" in name}
    names = sorted(first)
    made = []
    for number in range(COUNT):
        name = names[number % len(names)]
        made.append({**first, name: _mutated(first[name], chance)})
    return made


def test_no_broken_upload_is_a_fault(make_service, corpus):
    service = make_service("--workers", "0")
    statuses = set()
    with httpx.Client(base_url=service.url, timeout=30) as api:
        for scene in corpus:
            files = [("files", item) for item in scene.items()]
            answer = api.post("/api/v1/jobs", files=files, data={"job": "{}"})
            statuses.add(answer.status_code)
        assert statuses <= {202, 413, 422}
        assert api.get("/readyz").status_code == 200


def test_no_broken_scene_kills_a_worker(live_service, corpus):
    with httpx.Client(base_url=live_service.url, timeout=30) as api:
        jobs = []
        body = json.dumps({"input": {"frames": "0:1"}})
        for scene in corpus[:: COUNT // WORKED]:
            files = [("files", item) for item in scene.items()]
            answer = api.post("/api/v1/jobs", files=files, data={"job": body})
            if answer.status_code == 202:
                jobs.append(answer.json()["id"])
    assert jobs
    with Client(live_service.url) as client:
        for job in jobs:
            list(client.events(job))
            found = client.job(job)
            assert found.attempt == 1, "its worker died"
            assert found.state == "succeeded" or "urn:depthsr" in found.problem["type"]
