"""``python -m benchmarks.dscqs``: simulated assessors at once, and the round trip of their votes.

Starts a service, makes a test of pictures of 512×192 pixels for two eyes, lets every assessor go
through it at the same time, and compares what they voted with what was stored. Service and
assessors share the machine, so the assessors are light: a socket each, no library of HTTP, one
thread for all. What they take of the processor is told, and how late their own loop was: both
are part of the round trips.
"""

from __future__ import annotations

import argparse
import asyncio
import csv
import io
import json
import os
import random
import re
import subprocess
import sys
import tempfile
import time
import uuid
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np

from dscqs.plan import Plan
from service.dscqs_client import API, OperatorClient, entry, operator_client
from service.http.dscqs_access import TOKEN_FILE
from service.plan_files import read_plan

DISPLAY = "polarised"
P99_MS = 150.0
"""Longest round trip that 99 of 100 votes may take."""
LAG_S = 0.05
"""Time between two looks at how late the assessors' loop is."""


@dataclass(kw_only=True)
class Measured:
    """What the assessors gave, and what it took."""

    grades: dict[str, list[tuple[float, float]]] = field(default_factory=lambda: defaultdict(list))
    """(A, B) by assessor, in the order in which they were answered."""
    round_trips_ms: list[float] = field(default_factory=list)
    """From sending a vote to the end of its answer."""
    lags_ms: list[float] = field(default_factory=list)
    """How late the assessors' loop was."""
    requests: int = 0


class Browser:
    """One connection that is kept as long as the service keeps it, and one cookie."""

    def __init__(self, server: str, measured: Measured) -> None:
        self._address = urlsplit(server)
        self._measured = measured
        self._cookie = ""

    async def __aenter__(self) -> Browser:
        await self._connect()
        return self

    async def _connect(self) -> None:
        host, port = self._address.hostname, self._address.port
        self._reader, self._writer = await asyncio.open_connection(host, port)

    async def __aexit__(self, *_: object) -> None:
        self._writer.close()
        await self._writer.wait_closed()

    async def ask(self, method: str, path: str, body: Any = None) -> bytes:
        """Send a request and return the body of its answer, which must be a success."""
        if self._reader.at_eof():  # the service ends what was idle for 15 seconds
            self._writer.close()
            await self._connect()
        data = b"" if body is None else json.dumps(body).encode()
        head = f"{method} {path} HTTP/1.1\r\nHost: {self._address.netloc}\r\n{self._cookie}"
        if data:
            head += f"Content-Type: application/json\r\nContent-Length: {len(data)}\r\n"
        self._writer.write(head.encode() + b"\r\n" + data)
        said = (await self._reader.readuntil(b"\r\n\r\n")).decode("latin-1")
        length = re.search(r"(?i)\r\ncontent-length: (\d+)", said)
        answer = await self._reader.readexactly(int(length[1])) if length else b""
        if not said.startswith("HTTP/1.1 2"):
            raise RuntimeError(f"{method} {path}: {said.splitlines()[0]}: {answer.decode()}")
        cookie = re.search(r"(?i)\r\nset-cookie: ([^;]+)", said)
        if cookie:
            self._cookie = f"Cookie: {cookie[1]}\r\n"
        self._measured.requests += 1
        return answer


async def walk(
    browser: Browser, link: str, assessor: str, plan: Plan, speed: float, measured: Measured
) -> None:
    """Go through a session as a page does, at so many times the pace of people."""
    chance = random.Random(assessor)
    await asyncio.sleep(chance.uniform(0, plan.timing.presentation_s) / speed)
    await browser.ask("POST", f"{API}/assessor/enter", entry(link, uuid.uuid4().hex))
    state = json.loads(await browser.ask("GET", f"{API}/assessor/state"))
    while state["stage"] != "thanks":
        stage = state["stage"]
        if stage == "instructions":
            answer = await browser.ask("POST", f"{API}/assessor/continue", {"stage": stage})
        elif stage != "presentation":
            form = {"stage": stage, "answers": {"simulated": True}}
            answer = await browser.ask("POST", f"{API}/assessor/forms", form)
        else:
            offered = json.loads(await browser.ask("GET", f"{API}/assessor/presentation"))
            for address in offered["sides"].values():
                await browser.ask("GET", address)
            await asyncio.sleep(plan.timing.presentation_s * chance.uniform(0.8, 1.2) / speed)
            ticket = offered["ticket"]
            shown = {"ticket": ticket, "outcome": "ok", "log": {"intervals": []}}
            await browser.ask("POST", f"{API}/assessor/shown", shown)
            pair = round(chance.uniform(0, 100), 1), round(chance.uniform(0, 100), 1)
            grades = {"quality": dict(zip("AB", pair, strict=True))}
            vote = {"ticket": ticket, "submission": uuid.uuid4().hex, "grades": grades}
            begin = time.perf_counter()
            answer = await browser.ask("POST", f"{API}/assessor/grades", vote)
            measured.round_trips_ms.append(1e3 * (time.perf_counter() - begin))
            measured.grades[assessor].append(pair)
        state = json.loads(answer)


async def walk_all(
    server: str, links: Mapping[str, str], plan: Plan, speed: float, measured: Measured
) -> None:
    """Let an assessor through every link, all at the same time."""

    async def look_at_lag() -> None:
        while True:
            begin = time.perf_counter()
            await asyncio.sleep(LAG_S)
            measured.lags_ms.append(1e3 * (time.perf_counter() - begin - LAG_S))

    async def one(assessor: str, link: str) -> None:
        async with Browser(server, measured) as browser:
            await walk(browser, link, assessor, plan, speed, measured)

    looking = asyncio.create_task(look_at_lag())
    async with asyncio.TaskGroup() as tasks:
        for assessor, link in links.items():
            tasks.create_task(one(assessor, link))
    looking.cancel()


def stored_grades(votes_csv: str) -> dict[str, list[tuple[float, float]]]:
    """Return (A, B) by assessor of a table of votes, in the order in which they were shown."""
    lines = [line for line in io.StringIO(votes_csv) if not line.startswith("#")]
    rows = sorted(csv.DictReader(lines), key=lambda row: int(row["position"]))
    found = defaultdict(list)
    for row in rows:
        pair = float(row["grade_reference"]), float(row["grade_test"])
        found[row["assessor"]].append(pair if row["reference_side"] == "A" else pair[::-1])
    return dict(found)


def percentile(values: list[float], part: float) -> float:
    """Return the value that this part of the values stays below or at."""
    ordered = sorted(values)
    return ordered[min(int(part * len(ordered)), len(ordered) - 1)]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dscqs", description=__doc__)
    parser.add_argument("--assessors", type=int, default=200, help="at once (default: %(default)s)")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="times faster than people (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        return _measure(Path(folder), options.assessors, options.speed)


def _measure(folder: Path, assessors: int, speed: float) -> int:
    depthsr = [sys.executable, "-m", "service"]
    file = folder / "plan.yaml"
    _write_stimuli(folder / "stimuli")
    words = ["dscqs", "plan", str(folder / "stimuli"), "-o", str(file), "--dummies", "1"]
    subprocess.run([*depthsr, *words, "--displays", DISPLAY], check=True)
    words = ["serve", "--port", "0", "--workers", "0", "--log-level", "warning"]
    words += ["--data", str(folder / "data"), "--roots", str(folder)]
    with subprocess.Popen([*depthsr, *words], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found
        try:
            token = (folder / "data" / TOKEN_FILE).read_text().strip()
            with operator_client(found[0], token) as operator:
                return _watch(operator, found[0], process.pid, read_plan(file), assessors, speed)
        finally:
            process.terminate()


def _watch(
    operator: OperatorClient, server: str, service: int, plan: Plan, assessors: int, speed: float
) -> int:
    from dscqs.plan import plan_to_dict

    test = operator.make_test(plan_to_dict(plan))
    codes = [f"sim{number + 1:03d}" for number in range(assessors)]
    links = {code: operator.invite(test, code, DISPLAY) for code in codes}
    measured = Measured()
    begin, own, theirs = time.perf_counter(), time.process_time(), _processor_s(service)
    asyncio.run(walk_all(server, links, plan, speed, measured))
    seconds = time.perf_counter() - begin
    own, theirs = time.process_time() - own, _processor_s(service) - theirs
    is_same = stored_grades(operator.votes_csv(test)) == dict(measured.grades)
    p99 = percentile(measured.round_trips_ms, 0.99)
    votes = len(measured.round_trips_ms)
    print(
        f"{assessors} assessors at {speed:g} × the pace of people, {seconds:.0f} s: {votes} votes, "
        f"{'each stored once, as it was given' if is_same else 'NOT WHAT WAS STORED'}\n"
        f"round trip of a vote: median {percentile(measured.round_trips_ms, 0.5):.1f} ms, p99 "
        f"{p99:.1f} ms ({'met' if p99 <= P99_MS else 'NOT MET'}: ≤ {P99_MS:g} ms), longest "
        f"{max(measured.round_trips_ms):.1f} ms\n"
        f"of it the assessors' own lateness: median {percentile(measured.lags_ms, 0.5):.1f} ms, "
        f"p99 {percentile(measured.lags_ms, 0.99):.1f} ms\n"
        f"processor time of a request ({measured.requests / seconds:.0f} a second): service "
        f"{1e3 * theirs / measured.requests:.2f} ms, assessors "
        f"{1e3 * own / measured.requests:.2f} ms; load average {os.getloadavg()[0]:.1f} on "
        f"{os.cpu_count()} cores"
    )
    return 0 if is_same and p99 <= P99_MS else 1


def _processor_s(process: int) -> float:
    """Return the processor time that a process has taken so far [s]."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _write_stimuli(folder: Path) -> None:
    from pipeline.media.png import encode_png

    folder.mkdir()
    chance = np.random.default_rng(1)
    for content in ("ballet", "street"):
        for condition in ("original", "bicubic", "sr"):
            picture = np.kron(chance.integers(0, 256, (48, 128, 3)), np.ones((4, 4, 1)))
            (folder / f"{content}--{condition}.png").write_bytes(
                encode_png(picture.astype(np.uint8))
            )


if __name__ == "__main__":
    sys.exit(main())
