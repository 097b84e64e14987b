"""Simulated assessors that go through a test over HTTP, all at once, as their pages would.

An assessor is not told what a side is; a simulated one looks: the coded picture inside what was
sent is compared with the files of the plan.
"""

from __future__ import annotations

import asyncio
import csv
import io
import random
import ssl
import time
import uuid
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx

from dscqs.errors import StimulusError
from dscqs.plan import Plan
from dscqs.simulated import AssessorModel, SimulatedAssessor
from dscqs.stimulus import signature
from service.dscqs_client import API, DscqsClientError, entry

PATIENCE_S = 60.0


@dataclass(kw_only=True)
class Measured:
    """What a simulation took and gave."""

    round_trips_s: list[float] = field(default_factory=list)
    """From sending a vote to its answer [s]."""
    votes: Counter[tuple[Any, ...]] = field(default_factory=Counter)
    """Every vote that was answered: assessor, display, content, condition, both grades."""
    seconds: float = 0.0

    def percentile(self, part: float) -> float:
        """Return the round trip that this part of the votes stays below or at [s]."""
        ordered = sorted(self.round_trips_s)
        return ordered[min(int(part * len(ordered)), len(ordered) - 1)] if ordered else 0.0


def simulate(
    server: str,
    plan: Plan,
    links: Mapping[tuple[str, str], str],
    model: AssessorModel,
    *,
    speed: float = 20.0,
) -> Measured:
    """Let an assessor through every link, all at the same time.

    Parameters
    ----------
    server : str
        Address of the service.
    plan : Plan
        Its ``folder`` is where the files of the stimuli lie.
    links : mapping
        Link by (assessor, display).
    model : AssessorModel
    speed : float
        How many times faster than the plan's timing they are; they begin within the length of
        one presentation.

    Raises
    ------
    DscqsClientError
        If the service refuses something.
    """
    known = {
        signature((Path(plan.folder) / plan.stimuli[key]).read_bytes()): key for key in plan.used
    }
    if len(known) < len(plan.used):
        raise StimulusError("two stimuli of the plan are the same picture; nobody could tell them")
    return asyncio.run(_all(server, plan, links, model, known, speed))


async def _all(
    server: str,
    plan: Plan,
    links: Mapping[tuple[str, str], str],
    model: AssessorModel,
    known: Mapping[str, str],
    speed: float,
) -> Measured:
    measured = Measured()
    trusted = ssl.create_default_context()  # one for all: to make it takes as long as a vote
    begin = time.monotonic()
    walkers = [
        _Walker(
            server, plan, SimulatedAssessor(model, f"{who} {display}"), known, measured, trusted
        )
        for who, display in links
    ]
    delays = random.Random(model.seed)
    async with asyncio.TaskGroup() as tasks:
        for walker, ((who, display), link) in zip(walkers, links.items(), strict=True):
            delay = delays.uniform(0, plan.timing.presentation_s / speed)
            tasks.create_task(walker.walk(link, (who, display), delay, speed))
    measured.seconds = time.monotonic() - begin
    return measured


class _Walker:
    def __init__(
        self,
        server: str,
        plan: Plan,
        assessor: SimulatedAssessor,
        known: Mapping[str, str],
        measured: Measured,
        trusted: ssl.SSLContext,
    ) -> None:
        self._trusted = trusted
        self._server, self._plan, self._assessor = server, plan, assessor
        self._known, self._measured = known, measured

    async def walk(self, link: str, who: tuple[str, str], delay: float, speed: float) -> None:
        await asyncio.sleep(delay)
        async with httpx.AsyncClient(
            base_url=self._server, timeout=PATIENCE_S, verify=self._trusted
        ) as http:
            await _ask(http, "POST", f"{API}/assessor/enter", entry(link, uuid.uuid4().hex))
            state = (await _ask(http, "GET", f"{API}/assessor/state")).json()
            while state["stage"] not in ("thanks", "withdrawn"):
                state = await self._step(http, state, who, speed)

    async def _step(
        self, http: httpx.AsyncClient, state: dict[str, Any], who: tuple[str, str], speed: float
    ) -> dict[str, Any]:
        stage = state["stage"]
        if stage in ("training", "presentation"):
            return await self._judge(http, who, speed)
        if stage == "paused":
            await asyncio.sleep(1)
            return dict((await _ask(http, "GET", f"{API}/assessor/state")).json())
        if stage in ("instructions", "break"):
            await asyncio.sleep(state.get("break_s", 0) / speed)
            asked, what = {"stage": stage}, "continue"
        else:
            asked, what = {"stage": stage, "answers": {"simulated": True}}, "forms"
        return dict((await _ask(http, "POST", f"{API}/assessor/{what}", asked)).json())

    async def _judge(
        self, http: httpx.AsyncClient, who: tuple[str, str], speed: float
    ) -> dict[str, Any]:
        offered = (await _ask(http, "GET", f"{API}/assessor/presentation")).json()
        seen = {}
        for side, address in offered["sides"].items():
            data = (await _ask(http, "GET", address)).content
            seen[side] = self._known[signature(data)].split("/")
        await asyncio.sleep(self._plan.timing.presentation_s / speed)
        shown = {"ticket": offered["ticket"], "outcome": "ok", "log": {"simulated": True}}
        await _ask(http, "POST", f"{API}/assessor/shown", shown)
        grades = {
            dimension: {side: self._assessor.grade(*seen[side]) for side in "AB"}
            for dimension in offered["dimensions"]
        }
        vote = {"ticket": offered["ticket"], "submission": uuid.uuid4().hex, "grades": grades}
        begin = time.perf_counter()
        answer = await _ask(http, "POST", f"{API}/assessor/grades", vote)
        self._measured.round_trips_s.append(time.perf_counter() - begin)
        self._note(who, seen, grades)
        return dict(answer.json())

    def _note(self, who: tuple[str, str], seen: Mapping[str, list[str]], grades: Any) -> None:
        is_a = seen["A"][1] == self._plan.reference
        reference, test = ("A", "B") if is_a else ("B", "A")
        content, condition = seen[test]
        for dimension, pair in grades.items():
            key = (*who, content, condition, dimension, pair[reference], pair[test])
            self._measured.votes[key] += 1


def unlike(measured: Measured, votes_csv: str) -> tuple[int, int]:
    """Return how many votes are lost, and how many are there that were not given."""
    lines = [line for line in io.StringIO(votes_csv) if not line.startswith("#")]
    stored = Counter(
        (
            row["assessor"], row["display"], row["content"], row["condition"],
            row.get("dimension", "quality"), float(row["grade_reference"]),
            float(row["grade_test"]),
        )
        for row in csv.DictReader(lines)
    )  # fmt: skip
    return (measured.votes - stored).total(), (stored - measured.votes).total()


async def _ask(http: httpx.AsyncClient, method: str, path: str, json: Any = None) -> httpx.Response:
    answer = await http.request(method, path, json=json, follow_redirects=False)
    if answer.status_code >= 400:
        said: Sequence[Any] | dict[str, Any] = answer.json()
        message = said.get("message", "") if isinstance(said, dict) else ""
        raise DscqsClientError(answer.status_code, "", f"{method} {path}: {message}")
    return answer
