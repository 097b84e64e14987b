"""``python -m benchmarks.service``: the service under load, on a machine that is computing.

Four loads, each with a real service in a process of its own: many jobs of one small frame
queued at once and drained; large jobs that take all cores; a live stream with many
viewers; a day's events in minutes. Meanwhile a client asks the API at a steady rate.
"""

from __future__ import annotations

import argparse
import asyncio
import multiprocessing
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

LIMIT = 200.0
"""What the 99th percentile of the API may be, milliseconds."""

RATE = 20.0
"""Requests a second of the client that measures."""

DAY = 86_400
"""Events: one a second."""


@dataclass(frozen=True, kw_only=True)
class Load:
    """What the benchmark does."""

    jobs: int = 500
    large: float = 60.0
    """How long the API is asked while large jobs run, seconds."""
    viewers: int = 50
    watched: float = 60.0
    """How long they watch, seconds."""
    events: int = DAY


@dataclass(kw_only=True)
class Measured:
    """What one load came to."""

    name: str
    facts: list[str] = field(default_factory=list)
    """In words, with figures."""
    asked: list[float] = field(default_factory=list)
    """What each request of the client took, milliseconds."""
    memory: tuple[float, float] = (0.0, 0.0)
    """Of the service, MiB: at the beginning, and the most."""

    @property
    def p99(self) -> float:
        """The 99th percentile of the requests, milliseconds."""
        return percentile(self.asked, 0.99)

    @property
    def holds(self) -> bool:
        """Whether the API stayed quick enough."""
        return self.p99 <= LIMIT


def percentile(values: Sequence[float], share: float) -> float:
    """Return the value that this share of the values does not exceed.

    >>> percentile([3.0, 1.0, 2.0], 0.5)
    2.0
    """
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def resident_mib(pid: int) -> float:
    """Return the memory that a process has in use, MiB."""
    found = re.search(r"VmRSS:\s+(\d+)", Path(f"/proc/{pid}/status").read_text(encoding="ascii"))
    return int(found[1]) / 1024 if found else float("nan")


class Asker:
    """Asks the API at a steady rate, and looks at the memory of the service."""

    def __init__(self, url: str, pid: int, paths: Sequence[str]) -> None:
        self._url, self._pid, self._paths = url, pid, paths
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="asker")
        self.asked: list[float] = []
        self.failed: list[str] = []
        self.memory: list[float] = [resident_mib(pid)]

    def __enter__(self) -> Asker:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        due = time.perf_counter()
        with httpx.Client(base_url=self._url, timeout=60) as api:
            for number in range(1 << 30):
                due = max(due + 1 / RATE, time.perf_counter())
                if self._stop.wait(due - time.perf_counter()):
                    return
                begin = time.perf_counter()
                answer = api.get(self._paths[number % len(self._paths)])
                self.asked.append(1000 * (time.perf_counter() - begin))
                if not answer.is_success:
                    self.failed.append(f"{answer.request.url}: {answer.status_code}")
                if number % int(RATE) == 0:
                    self.memory.append(resident_mib(self._pid))

    def told(self, name: str, *facts: str) -> Measured:
        """Return what was measured."""
        if self.failed:
            raise RuntimeError(f"{len(self.failed)} requests failed: {self.failed[:3]}")
        return Measured(
            name=name, facts=list(facts), asked=self.asked,
            memory=(self.memory[0], max(self.memory)),
        )  # fmt: skip


@contextmanager
def running(folder: Path, *options: str) -> Iterator[tuple[str, int]]:
    """Yield the address and the process id of a service without streams."""
    words = [sys.executable, "-m", "service", "serve", "--port", "0", "--zenoh", "off"]
    words += ["--data", str(folder / "data"), "--roots", str(folder / "scenes")]
    with subprocess.Popen(
        [*words, "--log-level", "warning", *options], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            found = re.search(r"http://\S+", process.stdout.readline())
            assert found
            yield found[0], process.pid
        finally:
            process.terminate()


def many_jobs(folder: Path, count: int) -> Measured:
    """Queue jobs of one small frame at once, and wait until they are drained."""
    with running(folder) as (url, pid), httpx.Client(base_url=url, timeout=60) as api:
        paths = ("/api/v1/jobs?limit=50", "/api/v1/status", "/readyz", "/metrics")
        posts = []
        begin = time.perf_counter()
        for _ in range(count):
            before = time.perf_counter()
            answer = api.post("/api/v1/jobs", json={"scene": "tiny"})
            posts.append(1000 * (time.perf_counter() - before))
            answer.raise_for_status()
        queued = time.perf_counter() - begin
        with Asker(url, pid, paths) as asker:
            states: dict[str, int] = {}
            while sum(states.get(name, 0) for name in ("succeeded", "failed")) < count:
                time.sleep(0.5)
                states = api.get("/api/v1/status").json()["queue"]
        seconds = time.perf_counter() - begin
        jobs = list(_all_jobs(api))
    starts = [job["started"] for job in sorted(jobs, key=lambda job: job["created"])]
    order = "in order" if starts == sorted(starts) else "NOT in order"
    return asker.told(
        f"{count} jobs of one frame",
        f"queued in {queued:.1f} s (POST: median {statistics.median(posts):.1f} ms, "
        f"p99 {percentile(posts, 0.99):.1f} ms)",
        f"drained {order} in {seconds:.0f} s, {count / seconds:.2f} jobs a second",
        f"{states['failed']} failed",
    )


def _all_jobs(api: httpx.Client) -> Iterator[dict[str, Any]]:
    where = "/api/v1/jobs?limit=500"
    while where:
        page = api.get(where).json()
        yield from page["jobs"]
        where = page["next"]


def large_jobs(folder: Path, seconds: float) -> Measured:
    """Ask while jobs take all cores."""
    with running(folder) as (url, pid), httpx.Client(base_url=url, timeout=60) as api:
        jobs = [api.post("/api/v1/jobs", json={"scene": "large"}).json()["id"] for _ in range(40)]
        here = f"/api/v1/jobs/{jobs[0]}"
        while api.get(here).json()["frames_done"] == 0:
            time.sleep(0.5)
        paths = (here, f"{here}/events", "/api/v1/jobs", f"{here}/watch", "/api/v1/status")
        with Asker(url, pid, paths) as asker:
            time.sleep(seconds)
        done = sum(job["frames_done"] for job in _all_jobs(api))
    return asker.told(
        "jobs that take all cores",
        f"{done} frames of {LARGE['num_views']} views {LARGE['width']}×{LARGE['height']} "
        f"in {seconds:.0f} s",
    )


LARGE = {"width": 512, "height": 384, "num_views": 8}
"""Of the large job's scene."""


def many_viewers(folder: Path, count: int, seconds: float) -> Measured:
    """Let many watch one live stream at its edge."""
    from benchmarks.latency import STREAM, StreamPlan, running, wait_until_live

    plan = StreamPlan(size=(128, 96), num_views=3, rate=10, seconds=seconds)
    from pipeline.synthetic.scene import SampleScene
    from pipeline.synthetic.writing import write_scene

    scene = SampleScene(width=128, height=96, num_views=3)
    write_scene(folder / "scene", scene, num_frames=plan.num_frames)
    with running(folder, plan, 0) as url, httpx.Client(base_url=url, timeout=60) as api:
        wait_until_live(api)
        pid = _listener(url)
        here = f"/api/v1/streams/{STREAM}"
        paths = (here, f"{here}/watch", f"{here}/watch/result/index.m3u8", "/api/v1/status")
        with Asker(url, pid, paths) as asker:
            address = f"{url.replace('http', 'ws', 1)}{here}/watch/result/live"
            counts, gaps = asyncio.run(_watch(address, count, seconds))
        status = api.get(here).json()["status"]
    total = status["latency"]["total"]
    return asker.told(
        f"{count} viewers of one live stream",
        f"{min(counts)} to {max(counts)} frames each in {seconds:.0f} s, {sum(gaps)} gaps",
        f"{total['median_ms']:.0f} ms from arrival to publication (median; "
        f"p95 {total['p95_ms']:.0f} ms)",
    )


def _listener(url: str) -> int:
    """Return the id of the process that listens at an address."""
    port = int(url.rsplit(":", 1)[1])
    table = Path("/proc/net/tcp").read_text(encoding="ascii").splitlines()[1:]
    inode = next(
        row.split()[9] for row in table
        if row.split()[1].endswith(f":{port:04X}") and row.split()[3] == "0A"
    )  # fmt: skip
    for link in Path("/proc").glob("[0-9]*/fd/*"):
        with suppress(OSError):
            if str(link.readlink()) == f"socket:[{inode}]":
                return int(link.parts[2])
    raise RuntimeError(f"nobody listens at {url}")


async def _watch(address: str, count: int, seconds: float) -> tuple[list[int], list[int]]:
    """Return the frames that each viewer got, and the gaps it was told of."""
    from websockets.asyncio.client import connect

    async def view() -> tuple[int, int]:
        frames = gaps = 0
        async with connect(address, max_size=None) as viewer:
            with suppress(TimeoutError):
                async with asyncio.timeout(seconds):
                    async for message in viewer:
                        frames += isinstance(message, bytes)
                        gaps += isinstance(message, str) and '"gap"' in message
        return frames - 1, gaps  # the init segment is no frame

    found = await asyncio.gather(*(view() for _ in range(count)))
    return [frames for frames, _ in found], [gaps for _, gaps in found]


def day_of_events(folder: Path, count: int) -> Measured:
    """Put a day's events of jobs through the service, with followers of each job."""
    made, address = folder / "events", multiprocessing.get_context("spawn").Queue()
    service = multiprocessing.get_context("spawn").Process(
        target=_serve_events, args=(made, count, address), daemon=True
    )
    service.start()
    assert service.pid is not None
    url, jobs = address.get()
    paths = ("/api/v1/jobs", f"/api/v1/jobs/{jobs[0]}/events?after={count // 2}", "/metrics")
    begin = time.perf_counter()
    followed = [0] * len(jobs)

    def follow(place: int) -> None:
        headers = {"Accept": "text/event-stream"}
        with (
            httpx.Client(base_url=url, timeout=None) as api,
            api.stream("GET", f"/api/v1/jobs/{jobs[place]}/events", headers=headers) as events,
        ):
            for line in events.iter_lines():
                followed[place] += line.startswith("event: FrameFinished")

    followers = [threading.Thread(target=follow, args=(place,)) for place in range(len(jobs))]
    with Asker(url, service.pid, paths) as asker:
        for thread in followers:
            thread.start()
        address.put(None)  # go
        for thread in followers:
            thread.join()
    seconds = time.perf_counter() - begin
    settled = asker.memory[len(asker.memory) // 3 :]
    size = sum(path.stat().st_size for path in made.glob("service.sqlite*"))
    service.terminate()
    service.join()
    return asker.told(
        f"{count} events of {len(jobs)} jobs",
        f"taken, stored and followed in {seconds:.0f} s ({count / seconds:.0f} a second)",
        f"{sum(followed)} of {count} reached their followers",
        f"{size / (1 << 20):.0f} MiB of database; memory of the last two thirds within "
        f"{100 * (max(settled) / min(settled) - 1):.1f} %",
    )


def _serve_events(data: Path, count: int, address: Any) -> None:
    """Serve in this process; store so many events once told to, then end the jobs."""
    import uvicorn

    from service.app import create_app
    from service.config import ServiceConfig
    from service.jobs.states import Action

    app = create_app(ServiceConfig(data=data, workers=0, zenoh="off"))
    server = uvicorn.Server(uvicorn.Config(app, port=0, log_config=None))
    threading.Thread(target=server.run, daemon=True).start()
    while not server.started:
        time.sleep(0.05)
    port = server.servers[0].sockets[0].getsockname()[1]
    store = app.state.store
    jobs = [f"{number:032x}" for number in range(8)]
    for job in jobs:
        store.create_job(job_id=job, client="", request={"request": {"scene": "x"}})
        store.take(1e9)
    address.put((f"http://127.0.0.1:{port}", jobs))
    address.get()
    per_job = count // len(jobs)
    for number in range(per_job):
        for job in jobs:
            said = {"frame_index": number, "done": number + 1, "total": per_job}
            store.report(job, "FrameFinished", said)
    for job in jobs:
        store.act(job, Action.SUCCEED)
    threading.Event().wait()


def measure(load: Load, note: Any = lambda name: None) -> list[Measured]:
    """Put the loads on, one after the other; those of no size are left out."""
    from pipeline.numba_cache import prepare_numba_cache

    prepare_numba_cache()  # before anything imports numba
    from pipeline.synthetic.scene import SampleScene
    from pipeline.synthetic.writing import write_scene

    found: list[Measured] = []
    with tempfile.TemporaryDirectory(prefix="depthsr-load-") as name:
        scenes = Path(name) / "scenes"
        write_scene(scenes / "tiny", SampleScene(width=48, height=36, num_views=3))
        if load.large:
            write_scene(scenes / "large", SampleScene(**LARGE), num_frames=4)  # type: ignore[arg-type]
        for what, size in (
            (lambda folder: many_jobs(folder, load.jobs), load.jobs),
            (lambda folder: large_jobs(folder, load.large), load.large),
            (lambda folder: many_viewers(folder, load.viewers, load.watched), load.viewers),
            (lambda folder: day_of_events(folder, load.events), load.events),
        ):
            if size:
                folder = Path(name) / f"load-{len(found)}"
                folder.mkdir()
                (folder / "scenes").symlink_to(scenes)
                found.append(what(folder))
                note(found[-1])
    return found


def table(found: Sequence[Measured]) -> Any:
    """Return the loads as a table."""
    from pipeline.evaluation.tables import Table, number

    rows = []
    for item in found:
        times = (statistics.median(item.asked), item.p99, max(item.asked))
        rows.append(
            (
                item.name, "; ".join(item.facts), *(number(value, 1) for value in times),
                str(len(item.asked)), f"{item.memory[0]:.0f} → {item.memory[1]:.0f}",
            )
        )  # fmt: skip
    head = ("load", "what became of it", "median ms", "p99 ms", "longest ms", "requests",
            "memory MiB")  # fmt: skip
    return Table(head=head, rows=tuple(rows), left=("what became of it",))


def page(found: Sequence[Measured], command: str, load: float) -> str:
    """Return the page of the result, Markdown."""
    from pipeline.machine import described, today

    verdict = "It holds" if all(item.holds for item in found) else "**It does not hold**"
    return f"""# Under load

Measured on {today()} with `{command}` (`make soak`).

Machine: {described()}; load average {load:.1f} when it began.

A real service, and a client that asks the API {RATE:g} times a second while it is loaded: lists,
single jobs, events, what there is to watch, status, metrics. Times are what the client sees.
Memory is that of the service's own process, at the beginning and the most.

{verdict}: the 99th percentile of the API may be {LIMIT:g} ms.

{table(found).as_markdown()}
"""


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; status 1 where the API was too slow."""
    from dataclasses import fields

    parser = argparse.ArgumentParser(prog="python -m benchmarks.service", description=__doc__)
    for item in fields(Load):
        parser.add_argument(
            f"--{item.name}", type=type(item.default), default=item.default, metavar="N",
            help="0 leaves it out (default: %(default)s)",
        )  # fmt: skip
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the page as Markdown")
    options = parser.parse_args(arguments)
    load = Load(**{item.name: getattr(options, item.name) for item in fields(Load)})
    from pipeline.machine import load_average

    before = load_average()

    def note(item: Measured) -> None:
        facts = "; ".join(item.facts)
        print(f"{item.name}: {facts}; p99 {item.p99:.0f} ms", file=sys.stderr, flush=True)

    found = measure(load, note)
    changed = [
        f" --{item.name} {getattr(load, item.name):g}"
        for item in fields(Load)
        if getattr(load, item.name) != item.default
    ]
    text = page(found, "python -m benchmarks.service" + "".join(changed), before)
    print(text)
    if options.write is not None:
        from pipeline.media.files import write_atomic

        write_atomic(options.write, text.encode())
    return 0 if all(item.holds for item in found) else 1


if __name__ == "__main__":
    sys.exit(main())
