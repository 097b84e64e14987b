"""``python -m benchmarks.service``: the service under load, on a machine that is computing.

Queues jobs of one small frame, asks the API all the while, and prints what that took.
"""

from __future__ import annotations

import argparse
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import httpx


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.service", description=__doc__)
    parser.add_argument("--jobs", type=int, default=50, help="jobs (default: %(default)s)")
    parser.add_argument("--workers", type=int, default=1, help="workers (default: %(default)s)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        _measure(Path(folder), options.jobs, options.workers)
    return 0


def _measure(folder: Path, count: int, workers: int) -> None:
    from service.numba_cache import prepare_numba_cache

    prepare_numba_cache()
    from pipeline.synthetic.scene import SampleScene
    from pipeline.synthetic.writing import write_scene

    write_scene(folder / "scenes" / "tiny", SampleScene(width=48, height=36, num_views=3))
    words = [sys.executable, "-m", "service", "serve", "--port", "0", "--zenoh", "off"]
    words += ["--data", str(folder / "data"), "--roots", str(folder / "scenes")]
    words += ["--workers", str(workers), "--log-level", "warning"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found
        try:
            with httpx.Client(base_url=found[0], timeout=60) as api:
                _load(api, count, process.pid)
        finally:
            process.terminate()


def _load(api: httpx.Client, count: int, pid: int) -> None:
    taken: list[float] = []
    begin = time.perf_counter()
    for _ in range(count):
        taken.append(_timed(lambda: api.post("/api/v1/jobs", json={"scene": "tiny"})))
    queued = time.perf_counter() - begin
    asked: list[float] = []
    pause = threading.Event()
    while True:
        asked.append(_timed(lambda: api.get("/api/v1/jobs?limit=50")))
        done = api.get("/api/v1/jobs?limit=500&state=succeeded&state=failed").json()["jobs"]
        if len(done) >= min(count, 500):
            break
        pause.wait(0.05)
    seconds = time.perf_counter() - begin
    failed = sum(job["state"] == "failed" for job in done)
    starts = [job["started"] for job in sorted(done, key=lambda job: job["created"])]
    print(f"jobs                  {count}, failed {failed}, in order {starts == sorted(starts)}")
    print(f"queued in             {queued:.2f} s")
    print(f"drained in            {seconds:.1f} s ({count / seconds:.2f} jobs/s)")
    for name, times in (("POST /jobs", taken), ("GET /jobs", asked)):
        ordered = sorted(times)
        p99 = ordered[min(len(ordered) - 1, int(0.99 * len(ordered)))]
        print(f"{name:<21} median {statistics.median(times):.1f} ms, p99 {p99:.1f} ms, "
              f"{len(times)} requests")  # fmt: skip
    print(f"memory of the service {_memory(pid):.0f} MiB")


def _timed(ask: object) -> float:
    """Return the milliseconds of a request, which must succeed."""
    begin = time.perf_counter()
    answer = ask()  # type: ignore[operator]
    assert answer.is_success, answer.text
    return 1000 * (time.perf_counter() - begin)


def _memory(pid: int) -> float:
    status = Path(f"/proc/{pid}/status")
    found = re.search(r"VmRSS:\s+(\d+)", status.read_text()) if status.exists() else None
    return int(found[1]) / 1024 if found else float("nan")


if __name__ == "__main__":
    sys.exit(main())
