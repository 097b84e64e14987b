"""Files half written when the machine went: what is found again, and what is not believed."""

from __future__ import annotations

import hashlib
import importlib
import io
import itertools
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import httpx

from tests.support.service_api import follow, is_problem
from tests.support.waiting import PATIENCE

ROOT = Path(__file__).parents[2]
CRASH = 9
FORM = {"container": "mp4", "layout": "tab"}


def drive(scene: str, folder: str, again: str) -> None:
    """Do a job again and again, each time torn off a little later, until it is done.

    Afterwards a copy of its folder, whose accounts the disk has lost the ends of, is done once.

    Each try is a process of its own. The n-th file that is flushed to the disk loses its second
    half, and the process ends there, before the file gets its name; nothing is cleaned up.
    """
    from pipeline.numba_cache import prepare_numba_cache
    from service.child import Voice

    prepare_numba_cache()
    for name in ("pipeline.export", "pipeline.run", "service.jobs.request", "service.jobs.sinks"):
        importlib.import_module(name)  # once, and not in every process that is torn off
    from service.worker_process import WorkOrder, _work

    output = {"segment_length": 2, "frames": True}
    wanted = {"scene": scene, "input": {"frames": ":4"}, "output": output, "exports": [FORM]}
    order = WorkOrder(request=wanted, scene=scene, folder=folder, name="x", threads=1)

    def tried(order: WorkOrder, number: int) -> int:
        pid = os.fork()
        if pid == 0:
            _tear(number)
            _work(order, Voice(io.StringIO()))
            os._exit(0)
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        sys.stdout.write(f"{status}\n")
        return status

    for number in itertools.count(2, 5):
        if tried(order, number) != CRASH:
            break
    shutil.copytree(folder, again)
    for account in ("done.json", "computed.json"):
        path = Path(again) / account
        path.write_bytes(path.read_bytes()[:5])
    tried(replace(order, folder=again), 0)


def _tear(number: int) -> None:
    """Let the n-th flush of a file be the last thing that happens."""
    flush, calls = os.fsync, itertools.count(1)

    def torn(descriptor: int) -> None:
        size = os.fstat(descriptor).st_size
        if os.path.isfile(f"/proc/self/fd/{descriptor}") and next(calls) == number:
            os.ftruncate(descriptor, size // 2)
            os._exit(CRASH)
        flush(descriptor)

    os.fsync = torn


def _files(folder: Path) -> dict[str, str]:
    """Return the digests of all that is left of a job; accounts of time and locks apart."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix not in (".json", ".lock")
    }


def test_a_job_torn_off_at_any_write_ends_with_the_same_files(tiny_scene, tmp_path):
    folder, again = tmp_path / "torn", tmp_path / "again"
    folder.mkdir()
    call = "import sys; from tests.service.test_torn_writes import drive; drive(*sys.argv[1:])"
    done = subprocess.run(
        [sys.executable, "-c", call, str(tiny_scene), str(folder), str(again)],
        capture_output=True, text=True, cwd=ROOT, timeout=PATIENCE, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    statuses = [int(line) for line in done.stdout.split()]
    assert set(statuses[:-2]) == {CRASH}
    assert len(statuses) >= 5
    assert statuses[-2:] == [0, 0]
    files = _files(folder)
    names = {Path(name).name for name in files}
    assert {"master.mkv", "x_3D_SBS_LR.mkv", "x_3D_TAB.mp4", "left-000003.png"} <= names
    assert not [name for name in files if name.endswith(".tmp") or "depthsr" in name]
    assert _files(again) == files
    assert json.loads((again / "done.json").read_text())["frames"] == 4


def test_a_job_whose_files_are_gone_is_no_fault(live_service):
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        body = {"scene": "tiny", "input": {"frames": ":1"}}
        job = api.post("/api/v1/jobs", json=body).json()["id"]
        assert follow(api, job)[-1]["kind"] == "succeeded"
        shutil.rmtree(live_service.data / "jobs" / job)
        here = f"/api/v1/jobs/{job}"
        assert api.get(f"{here}/results").json() == []
        assert api.get(f"{here}/logs").text == ""
        assert api.get(f"{here}/watch").json()["tracks"] == {}
        is_problem(api.get(f"{here}/results/report.json"), 404, "not-found")
        is_problem(api.post(f"{here}/exports", json=FORM), 409, "conflict")
        assert api.delete(here).status_code == 204
