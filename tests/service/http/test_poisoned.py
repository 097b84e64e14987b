"""Broken files by the hundred: refused or failed with a reason, and never worse."""

from __future__ import annotations

import json
import random
import signal
from fractions import Fraction

import httpx
import numpy as np
import pytest

from pipeline.media.encode import write_segment
from pipeline.media.join import join_segments
from pipeline.media.video_format import Container, VideoCodec, VideoFormat
from pipeline.stereo import StereoLayout
from service.client import Client
from tests.service.conftest import LiveService
from tests.support.waiting import PATIENCE

COUNT = 200
WORKED = 6
"""So many of them go through a worker."""

VIDEOS = 60
"""Broken MP4 and raw 4:2:0 files, besides."""


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


@pytest.fixture
def videos(tmp_path):
    """Return scenes of one broken file each: a stereo video, or raw planes and their manifest."""
    chance = random.Random(5)
    fps = Fraction(5)
    form = VideoFormat(
        container=Container.MP4, codec=VideoCodec.H264, layout=StereoLayout.SBS, fps=fps
    )
    noise = np.random.default_rng(6).integers(0, 256, (3, 32, 48, 3), np.uint8)
    write_segment(tmp_path / "a.mkv", form, [(eye, eye) for eye in noise], first_frame=0)
    join_segments([tmp_path / "a.mkv"], tmp_path / "a_3D_SBS_LR.mp4", form)
    video = (tmp_path / "a_3D_SBS_LR.mp4").read_bytes()
    planes = noise[0].tobytes()[: 48 * 32 * 3 // 2]
    raw = {"path": "a.yuv", "width": 48, "height": 32, "pixel_format": "yuv420p"}
    manifest = {
        "format": "depthsr-scene/1", "frame_count": 1,
        "views": [{"id": view, "color": {**raw, "path": f"{view}.yuv"}} for view in "ab"],
    }  # fmt: skip
    made = []
    for number in range(VIDEOS):
        if number % 2:
            made.append({"a_3D_SBS_LR.mp4": _mutated(video, chance)})
        else:
            text = json.dumps(manifest).encode()
            broken = _mutated(text, chance) if number % 4 else text
            made.append({"scene.json": broken, "a.yuv": _mutated(planes, chance), "b.yuv": planes})
    return made


@pytest.fixture(scope="module")
def idle(tmp_path_factory):
    """A service that takes jobs and does none."""
    service = LiveService(tmp_path_factory.mktemp("idle") / "data", ("--workers", "0")).start()
    yield service
    assert service.end() in (0, -signal.SIGTERM)


def test_no_broken_video_is_a_fault(idle, videos):
    with httpx.Client(base_url=idle.url, timeout=PATIENCE) as api:
        statuses = {
            api.post(
                "/api/v1/jobs", files=[("files", item) for item in scene.items()],
                data={"job": "{}"},
            ).status_code
            for scene in videos
        }  # fmt: skip
        assert statuses <= {202, 413, 422}
        assert api.get("/readyz").status_code == 200
        uploads = idle.data / "jobs"
        jobs = api.get("/api/v1/jobs?limit=500").json()["jobs"]
        assert {path.name for path in uploads.iterdir()} == {job["id"] for job in jobs}


def test_no_broken_upload_is_a_fault(idle, corpus):
    statuses = set()
    with httpx.Client(base_url=idle.url, timeout=PATIENCE) as api:
        for scene in corpus:
            files = [("files", item) for item in scene.items()]
            answer = api.post("/api/v1/jobs", files=files, data={"job": "{}"})
            statuses.add(answer.status_code)
        assert statuses <= {202, 413, 422}
        assert api.get("/readyz").status_code == 200


def test_no_broken_scene_kills_a_worker(live_service, corpus, videos):
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        jobs = []
        body = json.dumps({"input": {"frames": "0:1"}})
        for scene in [*corpus[:: COUNT // WORKED], *videos[:4]]:
            files = [("files", item) for item in scene.items()]
            answer = api.post("/api/v1/jobs", files=files, data={"job": body})
            if answer.status_code == 202:
                jobs.append(answer.json()["id"])
    assert jobs
    with Client(live_service.url, timeout=PATIENCE) as client:
        for job in jobs:
            list(client.events(job))
            found = client.job(job)
            assert found.attempt == 1, "its worker died"
            assert found.state == "succeeded" or "urn:depthsr" in found.problem["type"]
