"""Segments of the service's jobs on a real Dask scheduler and worker."""

from __future__ import annotations

import contextlib

import httpx

from service.client import Client
from tests.pipeline.test_cluster import START, Cluster
from tests.service.http.test_api import follow


def test_the_cluster_makes_what_the_service_makes_itself(make_service, tiny_scene, tmp_path):
    """Result, master and tracks, byte for byte; watched in order while segments come in any."""
    wanted = {"scene": "tiny", "output": {"segment_length": 2}, "settings": {"temporal": "warm"}}
    roots = ("--roots", str(tiny_scene.parent))
    files = {}
    with contextlib.closing(Cluster(tmp_path)) as cluster:
        cluster.worker()
        cluster.worker()
        for name, options in (("own", ()), ("cluster", ("--cluster", cluster.address))):
            service = make_service(*roots, *options, data=tmp_path / name)
            with Client(service.url, timeout=START) as client:
                job = client.submit(wanted)
                events = list(client.events(job.id))
                assert events[-1].kind == "succeeded", events[-1]
                assert sum(event.kind == "FrameFinished" for event in events) == 6
                watch = httpx.get(f"{service.url}/api/v1/jobs/{job.id}/watch", timeout=30).json()
            assert {track["frames"] for track in watch["tracks"].values()} == {6}
            folder = service.data / "jobs" / job.id
            names = ("*.mkv", "results/*.mkv", "watch/*/*")
            files[name] = {
                path.relative_to(folder): path.read_bytes()
                for pattern in names for path in folder.glob(pattern)
            }  # fmt: skip
            if name == "cluster":
                with httpx.Client(base_url=service.url, timeout=START) as api:
                    made = api.post(f"/api/v1/jobs/{job.id}/exports", json={"layout": "tab"})
                    assert follow(api, made.json()["id"])[-1]["kind"] == "succeeded"
            service.end()
    assert len(files["own"]) > 10
    assert files["cluster"] == files["own"]
