"""``python -m benchmarks.dscqs``: simulated assessors at once, and the round trip of their votes.

Starts a service, makes a test of pictures of 512×192 pixels for two eyes, lets every assessor go
through it at the same time, and compares what they voted with what was stored. One vote in twenty
is sent twice, as by a browser that did not hear the answer. Service and assessors share the
machine, so the assessors are light: a socket each, no library of HTTP, one thread for all. What
they take of the processor is told, and how late their own loop was: both are part of the round
trips. ``--write docs/dscqs.md`` puts what was measured into the section of it.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
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
TWICE = 0.05
"""Part of the votes that are sent a second time."""
SECTION = "## 200 at once"
"""Head of the section of a page that ``--write`` renews."""
WHAT = (
    "`python -m benchmarks.dscqs` lets 200 simulated assessors at once through a test at the pace "
    "of people, in two and a half minutes. Every vote is compared with what was stored; one in "
    "twenty is sent twice, as by a browser that did not hear the answer. It fails where a vote is "
    "lost, comes twice, or where its answer, which is on the disk by then, takes more than 150 ms "
    "at the 99th percentile. It says what part of that the simulated assessors themselves are. Run "
    "it on a machine that does nothing else; `--write docs/dscqs.md` renews this section."
)
"""What the section says first."""


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
    sent_twice: int = 0
    seconds: float = 0.0
    own_s: float = 0.0
    """Processor time of the assessors."""
    service_s: float = 0.0
    """Processor time of the service."""
    is_same: bool = False
    """Every vote that was given is stored once, as it was given, and no other."""

    @property
    def p99_ms(self) -> float:
        """The round trip that 99 of 100 votes stay below or at."""
        return percentile(self.round_trips_ms, 0.99)

    @property
    def holds(self) -> bool:
        """True where nothing was lost or doubled, and votes were answered in time."""
        return self.is_same and self.p99_ms <= P99_MS


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
        data = b"" if body is None else json.dumps(body).encode()
        head = f"{method} {path} HTTP/1.1\r\nHost: {self._address.netloc}\r\n{self._cookie}"
        if data:
            head += f"Content-Type: application/json\r\nContent-Length: {len(data)}\r\n"
        said = (await self._exchange(head.encode() + b"\r\n" + data)).decode("latin-1")
        length = re.search(r"(?i)\r\ncontent-length: (\d+)", said)
        answer = await self._reader.readexactly(int(length[1])) if length else b""
        if not said.startswith("HTTP/1.1 2"):
            raise RuntimeError(f"{method} {path}: {said.splitlines()[0]}: {answer.decode()}")
        cookie = re.search(r"(?i)\r\nset-cookie: ([^;]+)", said)
        if cookie:
            self._cookie = f"Cookie: {cookie[1]}\r\n"
        self._measured.requests += 1
        return answer

    async def _exchange(self, request: bytes) -> bytes:
        """Send, and return the head of the answer; connect anew where the service hung up.

        It ends connections that were idle for 15 seconds, perhaps just as a request is on its way.
        """
        with contextlib.suppress(asyncio.IncompleteReadError, ConnectionError):
            self._writer.write(request)
            return await self._reader.readuntil(b"\r\n\r\n")
        self._writer.close()
        await self._connect()
        self._writer.write(request)
        return await self._reader.readuntil(b"\r\n\r\n")


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
            if chance.random() < TWICE:
                measured.sent_twice += 1
                await browser.ask("POST", f"{API}/assessor/grades", vote)
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


def as_text(measured: Measured, speed: float) -> str:
    """Return what was measured, for people."""
    votes, seconds = len(measured.round_trips_ms), measured.seconds
    requests, p99 = measured.requests, measured.p99_ms
    return (
        f"{len(measured.grades)} assessors at {speed:g} × the pace of people, {seconds:.0f} s: "
        f"{votes} votes, {measured.sent_twice} of them sent twice, "
        f"{'each stored once, as it was given' if measured.is_same else 'NOT WHAT WAS STORED'}\n"
        f"round trip of a vote: median {percentile(measured.round_trips_ms, 0.5):.1f} ms, p99 "
        f"{p99:.1f} ms ({'met' if p99 <= P99_MS else 'NOT MET'}: ≤ {P99_MS:g} ms), longest "
        f"{max(measured.round_trips_ms):.1f} ms\n"
        f"of it the assessors' own lateness: median {percentile(measured.lags_ms, 0.5):.1f} ms, "
        f"p99 {percentile(measured.lags_ms, 0.99):.1f} ms\n"
        f"processor time of a request ({requests / seconds:.0f} a second): service "
        f"{1e3 * measured.service_s / requests:.2f} ms, assessors "
        f"{1e3 * measured.own_s / requests:.2f} ms"
    )


def renewed(page: str, section: str) -> str:
    """Return a page whose section of the same head is this one, or that has it at its end."""
    before, head, after = page.partition(SECTION + "\n")
    if not head:
        return f"{page.rstrip()}\n\n{section.strip()}\n"
    following = after.find("\n## ")
    rest = "" if following < 0 else after[following:]
    return f"{before}{section.strip()}\n{rest}"


def _section(text: str, command: str, load: float) -> str:
    from pipeline.machine import described, today

    return (
        f"{SECTION}\n\n{WHAT}\n\nMeasured on {today()} with `{command}`.\n\n"
        f"Machine: {described()}; load average {load:.1f} when it began.\n\n```text\n{text}\n```\n"
    )


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; status 1 where a vote was lost, doubled, or answered too late."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dscqs", description=__doc__)
    parser.add_argument("--assessors", type=int, default=200, help="at once (default: %(default)s)")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="times faster than people (default: %(default)s)"
    )
    parser.add_argument(
        "--write", type=Path, metavar="FILE", help="page (Markdown) whose section is renewed"
    )
    options = parser.parse_args(arguments)
    from pipeline.machine import load_average
    from pipeline.media.files import write_atomic

    load = load_average()
    with tempfile.TemporaryDirectory() as folder:
        measured = _measure(Path(folder), options.assessors, options.speed)
    text = as_text(measured, options.speed)
    print(text)
    if options.write is not None:
        changed = "".join(
            f" --{name} {getattr(options, name):g}"
            for name in ("assessors", "speed")
            if getattr(options, name) != parser.get_default(name)
        )
        page = options.write.read_text(encoding="utf-8")
        section = _section(text, f"python -m benchmarks.dscqs{changed}", load)
        write_atomic(options.write, renewed(page, section).encode())
    return 0 if measured.holds else 1


def _measure(folder: Path, assessors: int, speed: float) -> Measured:
    depthsr = [sys.executable, "-m", "service"]
    file = folder / "plan.yaml"
    _write_stimuli(folder / "stimuli")
    words = ["dscqs", "plan", str(folder / "stimuli"), "-o", str(file), "--dummies", "1"]
    subprocess.run([*depthsr, *words, "--displays", DISPLAY], check=True, stdout=subprocess.DEVNULL)
    words = ["serve", "--port", "0", "--workers", "0", "--log-level", "warning"]
    words += ["--data", str(folder / "data"), "--roots", str(folder)]
    with subprocess.Popen([*depthsr, *words], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found
        try:
            token = (folder / "data" / TOKEN_FILE).read_text().strip()
            with operator_client(found[0], token) as operator:
                return measure(
                    operator, found[0], read_plan(file), assessors, speed=speed,
                    service=process.pid,
                )  # fmt: skip
        finally:
            process.terminate()


def measure(
    operator: OperatorClient,
    server: str,
    plan: Plan,
    assessors: int,
    *,
    speed: float,
    service: int,
) -> Measured:
    """Make a test, let so many assessors through it at once, and compare with what was stored.

    ``service`` is the process that answers.
    """
    from dscqs.plan import plan_to_dict

    test = operator.make_test(plan_to_dict(plan))
    codes = [f"sim{number + 1:03d}" for number in range(assessors)]
    links = {code: operator.invite(test, code, DISPLAY) for code in codes}
    measured = Measured()
    begin, own, theirs = time.perf_counter(), time.process_time(), _processor_s(service)
    asyncio.run(walk_all(server, links, plan, speed, measured))
    measured.seconds = time.perf_counter() - begin
    measured.own_s = time.process_time() - own
    measured.service_s = _processor_s(service) - theirs
    counts = {len(grades) for grades in measured.grades.values()}
    measured.is_same = counts == {plan.presentations} and stored_grades(
        operator.votes_csv(test)
    ) == dict(measured.grades)
    return measured


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
