"""Segments of the service's jobs on a real Dask scheduler and worker."""

from __future__ import annotations

import contextlib
from pathlib import Path

import httpx

from service.client import Client
from tests.support.cluster import Cluster
from tests.support.service_api import follow
from tests.support.waiting import PATIENCE


def _made(service) -> tuple[str, dict[Path, bytes]]:
    """Let a service do the job; return its id, and its files by their places."""
    wanted = {"scene": "tiny", "output": {"segment_length": 2}, "settings": {"temporal": "warm"}}
    with Client(service.url, timeout=PATIENCE) as client:
        job = client.submit(wanted).id
        events = list(client.events(job))
    assert events[-1].kind == "succeeded", events[-1]
    assert sum(event.kind == "FrameFinished" for event in events) == 6
    watch = httpx.get(f"{service.url}/api/v1/jobs/{job}/watch", timeout=PATIENCE).json()
    assert {track["frames"] for track in watch["tracks"].values()} == {6}
    folder = service.data / "jobs" / job
    return job, {
        path.relative_to(folder): path.read_bytes()
        for pattern in ("*.mkv", "results/*.mkv", "watch/*/*") for path in folder.glob(pattern)
    }  # fmt: skip


def test_the_cluster_makes_what_the_service_makes_itself(
    make_service, live_service, tiny_scene, tmp_path
):
    """Result, master and tracks, byte for byte; watched in order while segments come in any."""
    with contextlib.closing(Cluster(tmp_path)) as cluster:
        cluster.worker()
        cluster.worker()
        service = make_service("--roots", str(tiny_scene.parent), "--cluster", cluster.address)
        _, own = _made(live_service)
        job, files = _made(service)
        with httpx.Client(base_url=service.url, timeout=PATIENCE) as api:
            made = api.post(f"/api/v1/jobs/{job}/exports", json={"layout": "tab"})
            assert follow(api, made.json()["id"])[-1]["kind"] == "succeeded"
        service.end()
    assert len(own) > 10
    assert files == own
