"""Whole journeys with real processes: what is killed, cut off or full is found again."""

from __future__ import annotations

import hashlib
import os
import random
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx
import pytest

from service.client import Client, ServiceError
from tests.support.hanging import hanging, has_hung
from tests.support.needed import small_disk
from tests.support.ports import free_port
from tests.support.waiting import PATIENCE, until

KILLS = 20
SEGMENT = {"output": {"segment_length": 2}}
WORKER = "service.worker_process"


def _run(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "service", *words],
        capture_output=True, text=True, timeout=PATIENCE, check=False,
    )  # fmt: skip


def _later(work, *what, **more):
    time.sleep(1)  # nobody is there meanwhile
    return work(*what, **more)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def undisturbed(tiny_scene, tmp_path_factory) -> str:
    """Digest of what ``depthsr run`` makes of the scene."""
    target = tmp_path_factory.mktemp("run") / "out.mkv"
    done = _run("run", str(tiny_scene), "-o", str(target), "--segment-length", "2", "-q")
    assert done.returncode == 0, done.stderr
    return _digest(target)


def test_submit_watches_and_fetches_what_run_would_have_made(
    live_service, tiny_scene, undisturbed, tmp_path
):
    target = tmp_path / "out.mkv"
    done = _run(
        "submit", str(tiny_scene), "--server", live_service.url, "--watch",
        "--segment-length", "2", "-o", str(target),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "6 frames to come\n" in done.stderr
    assert "frame 6 of 6\nsegment 3 of 3\njoining\ncomputed in " in done.stderr
    assert _digest(target) == undisturbed


def test_submit_fetches_every_view_under_its_name(live_service, tiny_scene, tmp_path):
    done = _run(
        "submit", str(tiny_scene), "--server", live_service.url, "--frames", ":1",
        "--layout", "views", "--crf", "20", "-o", str(tmp_path / "out.mkv"),
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = sorted(path.name for path in tmp_path.iterdir())
    assert found == [f"out.cam{number}.mkv" for number in range(3)]


def test_submit_says_in_one_line_what_went_wrong(live_service, tmp_path):
    (tmp_path / "scene.json").write_text("{}")
    done = _run("submit", str(tmp_path), "--server", live_service.url)
    assert done.returncode == 2
    assert "scene.json: format: must be" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    clip = tmp_path / "clip.mp4"
    clip.write_bytes(b"no video")
    done = _run("submit", str(clip), "--server", live_service.url, "-o", str(tmp_path / "o.mkv"))
    assert done.returncode == 1
    sent, failed = done.stderr.splitlines()
    assert sent == "sending 1 file, 0.0 MB"
    assert "failed" in failed
    done = _run("submit", str(clip), "--server", "http://127.0.0.1:9")
    assert done.returncode == 1
    assert "is not there" in done.stderr
    assert "depthsr serve starts a service" in done.stderr


def _worker_of(service) -> int | None:
    """Return a process id among the children of the service."""
    listed = Path(f"/proc/{service.process.pid}/task")
    for task in listed.iterdir():
        try:
            children = (task / "children").read_text().split()
        except OSError:
            continue
        if children:
            return int(children[0])
    return None


def test_killed_at_random_moments_the_result_is_the_same(
    make_service, tiny_scene, undisturbed, tmp_path
):
    """Kill the service or its worker again and again while jobs run; nothing is lost."""
    chance = random.Random(20261123)
    options = ("--roots", str(tiny_scene.parent), "--max-attempts", "100")  # of worker kills
    service = make_service(*options)
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as api:
        jobs = [
            api.post("/api/v1/jobs", json={"scene": "tiny", **SEGMENT}).json()["id"]
            for _ in range(3)
        ]
    for _ in range(KILLS):
        moment = threading.Event()  # never set: a wait with an end
        moment.wait(chance.uniform(0.0, 1.2))
        worker = _worker_of(service)
        if chance.random() < 0.5 and worker is not None:
            try:
                os.kill(worker, signal.SIGKILL)
            except ProcessLookupError:
                continue
        else:
            service.end(signal.SIGKILL)
            service = make_service(*options, data=service.data)
    begun = 0
    with Client(service.url, timeout=PATIENCE) as client:
        for job in jobs:
            kinds = [event.kind for event in client.events(job)]
            assert kinds.count("succeeded") == 1
            begun += kinds.count("running")
            assert client.job(job).state == "succeeded"
            (video,) = [item for item in client.results(job) if item.name.endswith(".mkv")]
            client.download(video, tmp_path / "out.mkv")
            assert _digest(tmp_path / "out.mkv") == undisturbed
    assert begun > len(jobs) + 3  # the kills did hit work
    assert service.end() in (0, -signal.SIGTERM)
    for job in jobs:
        results = service.data / "jobs" / job / "results"
        assert {path.name for path in results.iterdir()} == {"tiny_3D_SBS_LR.mkv", "report.json"}
    with sqlite3.connect(service.data / "service.sqlite") as db:
        assert db.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    db.close()


def test_a_hung_worker_is_replaced(make_service, tiny_scene, tmp_path):
    options = ("--roots", str(tiny_scene.parent), "--lease", "6", "--max-attempts", "100")
    held = hanging(tmp_path / "held", WORKER, finished=1)
    service = make_service(*options, **held)
    with Client(service.url, timeout=PATIENCE) as client:
        job = client.submit({"scene": "tiny", **SEGMENT})
        assert [event.kind for event in client.events(job.id)][-1] == "succeeded"
        attempts = client.job(job.id).attempt
    assert has_hung(held)
    assert attempts > 1
    said = (service.data.parent / "data.log").read_text()
    assert said.count("worker hangs: killed") == attempts - 1  # for nothing else


def test_it_ends_in_time_with_a_stream_open(make_service, tiny_scene):
    service = make_service("--roots", str(tiny_scene.parent), "--workers", "0", "--grace", "600")
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as api:
        job = api.post("/api/v1/jobs", json={"scene": "tiny"}).json()["id"]
        headers = {"Accept": "text/event-stream"}
        with api.stream("GET", f"/api/v1/jobs/{job}/events", headers=headers) as stream:
            lines = stream.iter_lines()
            while not next(lines).startswith("data: "):
                pass
            begin = time.monotonic()
            assert service.end() in (0, -signal.SIGTERM)
            assert time.monotonic() - begin < 60  # not when the grace is over
            list(lines)


def test_who_follows_a_job_waits_for_a_service_that_is_started_anew(
    make_service, tiny_scene, tmp_path
):
    options = ("--roots", str(tiny_scene.parent), "--port", str(free_port()), "--grace", "1")
    held = hanging(tmp_path / "held", WORKER, finished=1)
    service = make_service(*options, **held)
    kinds = []
    with Client(service.url, timeout=PATIENCE) as client, ThreadPoolExecutor() as beside:
        job = client.submit({"scene": "tiny", **SEGMENT})
        begun_anew = None
        for event in client.events(job.id):
            kinds.append(event.kind)
            if event.kind == "JobStarted" and begun_anew is None:
                until(lambda: has_hung(held))
                assert service.end() in (0, -signal.SIGTERM)  # its streams end in good order
                begun_anew = beside.submit(_later, make_service, *options, data=service.data)
        begun_anew.result()
    assert kinds.count("running") == 2
    assert kinds[-1] == "succeeded"


def test_a_full_disk_fails_the_job_and_the_service_lives(make_service, tiny_scene, tmp_path):
    """On a file system of 8 MiB that fills up while the job runs."""
    disk = tmp_path / "disk"
    with small_disk(disk, "8m"):
        options = ("--roots", str(tiny_scene.parent), "--disk-reserve", "4")
        held = hanging(tmp_path / "held", WORKER, finished=1)  # it shall not be done first
        service = make_service(*options, data=disk / "data", **held)
        with Client(service.url, timeout=PATIENCE) as client:
            job = client.submit({"scene": "tiny", **SEGMENT})
            kinds = []
            for event in client.events(job.id):
                kinds.append(event.kind)
                if event.kind == "JobStarted" and "full" not in kinds:
                    kinds.append("full")
                    until(lambda: has_hung(held))
                    ballast = os.open(disk / "ballast", os.O_CREAT | os.O_WRONLY)
                    os.posix_fallocate(ballast, 0, 7 << 20)
                    os.close(ballast)
            assert kinds[-1] == "failed"
            assert client.job(job.id).problem["type"] == "urn:depthsr:problem:disk-full"
            assert httpx.get(f"{service.url}/readyz", timeout=PATIENCE).status_code == 503
            with pytest.raises(ServiceError, match="507"):
                client.submit({"scene": "tiny"})
            (disk / "ballast").unlink()
            client.retry(job.id)
            rest = [event.kind for event in client.events(job.id, after=len(kinds) - 1)]
            assert rest[-1] == "succeeded"
            assert httpx.get(f"{service.url}/readyz", timeout=PATIENCE).status_code == 200
        service.end()
