"""``python -m benchmarks.cluster``: a job on 1 and on 2 worker processes, and without a cluster.

Scheduler and workers run on this machine, each worker with one thread.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pipeline.cluster import ClusterEngine
from pipeline.config import Settings
from pipeline.evaluation.tables import Table, number
from pipeline.job import Job, OutputOptions
from pipeline.line import WARM_UP
from pipeline.machine import described, load_average, today
from pipeline.run import run_job
from pipeline.segments import Engine
from pipeline.synthetic import SampleScene, write_scene

PATIENCE = 120.0
"""Seconds that processes may take to come up."""


@contextmanager
def cluster(folder: Path, num_workers: int) -> Iterator[ClusterEngine]:
    """Start a scheduler and workers; end them."""
    file = folder / "scheduler.json"
    root = str(Path(__file__).parents[1])
    local = ("--host", "127.0.0.1", "--no-dashboard")
    commands: list[tuple[str, ...]] = [("scheduler", "--port", "0", *local)]
    commands += [("worker", "--nthreads", "1", "--no-nanny", *local)] * num_workers
    started = []
    try:
        for what, *options in commands:
            words = [sys.executable, "-m", "dask", what, "--scheduler-file", str(file), *options]
            started.append(
                subprocess.Popen(
                    words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                    env={**os.environ, "PYTHONPATH": root},
                )
            )  # fmt: skip
            end = time.monotonic() + PATIENCE
            while not file.exists() and time.monotonic() < end:
                time.sleep(0.1)
        address = json.loads(file.read_text(encoding="utf-8"))["address"]
        with ClusterEngine(address, patience=PATIENCE) as engine:
            engine.wait_for_workers(num_workers, PATIENCE)
            yield engine
    finally:
        for process in reversed(started):
            process.kill()
            process.wait()


def main(arguments: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.cluster", description=__doc__)
    parser.add_argument("--frames", type=int, default=48, help="(default: %(default)s)")
    parser.add_argument("--segment-length", type=int, default=12, help="(default: %(default)s)")
    parser.add_argument("--width", type=int, default=256, help="LR pixels (default: %(default)s)")
    parser.add_argument("--height", type=int, default=192, help="LR pixels (default: %(default)s)")
    parser.add_argument("--views", type=int, default=8, help="views (default: %(default)s)")
    options = parser.parse_args(arguments)
    scene = SampleScene(width=options.width, height=options.height, num_views=options.views)
    rows: list[tuple[str, ...]] = []
    with tempfile.TemporaryDirectory(prefix="depthsr-bench-") as name:
        folder = Path(name)
        manifest = write_scene(folder / "scene", scene, num_frames=options.frames, noise_sigma=2.0)

        def job(place: str, threads: int = 0) -> Job:
            (folder / place).mkdir()
            return Job(
                scene=manifest,
                settings=Settings(temporal="warm", threads=threads),
                output=OutputOptions(
                    output=folder / place / "out.mkv", segment_length=options.segment_length
                ),
            )

        def run(name: str, place: str, engine: Engine | None, threads: int = 0) -> float:
            work = job(place, threads)
            begin = time.perf_counter()
            run_job(work, engine=engine)
            seconds = time.perf_counter() - begin
            rows.append((name, number(seconds, 1), number(options.frames / seconds, 2)))
            return seconds

        run_job(job("warm-up"))  # compiles
        run("without a cluster, 1 thread", "one", None, 1)
        run("without a cluster, a thread a core", "all", None)
        for count in (1, 2):
            place = folder / f"cluster-{count}"
            place.mkdir()
            with cluster(place, count) as engine:
                run(f"{count} workers, first job", f"first-{count}", engine)
                run(f"{count} workers", f"second-{count}", engine)
    share = WARM_UP / (options.segment_length + WARM_UP)
    print(f"{today()}; {described()}; load average {load_average():.1f} at the end")
    print(
        f"{options.frames} frames, {options.views} views {options.width}×{options.height}, warm, "
        f"segments of {options.segment_length}; {100 * share:.0f} % of the work is warm-up"
    )
    print(Table(head=("", "seconds", "frames a second"), rows=tuple(rows)).as_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
