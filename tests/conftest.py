"""What all tests share: the real scenes, the seed of hypothesis, the guard against ERROR logs."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import hypothesis
import pytest

from pipeline.numba_cache import prepare_numba_cache
from tests.support.browser import PATIENCE_MS, Chromium, kill_browsers
from tests.support.needed import absent, program
from tests.support.waiting import limited

prepare_numba_cache()  # before anything imports numba

hypothesis.settings.register_profile(
    "depthsr",
    deadline=None,  # the first example may compile
    derandomize=True,  # the same examples everywhere
    max_examples=25,
)
hypothesis.settings.load_profile("depthsr")


LONGEST = (
    "pipeline/registration/test_register.py",  # compiles what many others need
    "service/dscqs_pages/test_session.py",
    "service/test_journeys_jobs.py",
    "service/pages/test_pages.py",
    "service/dscqs_pages/test_looks.py",
    "service/http/test_poisoned.py",
    "service/streams/test_faults.py",
    "service/test_cli.py",
    "service/dscqs_pages/test_video_and_groups.py",
    "service/dscqs_pages/test_killed.py",
)
"""Files that begin first: who comes to one of them last leaves the other processes idle."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the longest files first, the others after them in their order."""
    places = {Path(__file__).parent / name: place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: places.get(item.path, len(places)))


ANSWERS_WITHIN = PATIENCE_MS / 1000 + 60
"""Seconds that a test with a browser may take, more than any limit of the browser's driver: the
longest takes 20 on a machine of its own."""

CHROMIUM_OPTIONS = (
    "--no-sandbox",
    "--disable-background-networking",
    "--autoplay-policy=no-user-gesture-required",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-watchdog",
    "--disable-gpu-compositing",  # what WebGL draws is emulated, pages need not be: half the time
)


@pytest.fixture(scope="session")
def scenes_dir() -> Path:
    """Folder of the real scenes: DEPTHSR_SCENES. Without it: skipped; under CI=true: failed."""
    named = os.environ.get("DEPTHSR_SCENES", "")
    if named and Path(named).is_dir():
        return Path(named)
    reason = (
        f"DEPTHSR_SCENES={named}: there is no such folder"
        if named
        else "DEPTHSR_SCENES is not set: it names the folder of the real scenes"
    )
    absent(reason)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A real browser. Without it: skipped; under CI=true: failed.

    For the tests of one file, since its driver holds the event loop of the thread.
    """
    from playwright.sync_api import sync_playwright

    path = program("chromium")
    with sync_playwright() as driver:
        browser = Chromium(
            partial(
                driver.chromium.launch,
                executable_path=path, args=list(CHROMIUM_OPTIONS), timeout=PATIENCE_MS,
            )
        )  # fmt: skip
        yield browser
        browser.close()


@pytest.fixture(autouse=True)
def browsers_answer(request: pytest.FixtureRequest) -> Iterator[None]:
    """Kill the browsers under a test that takes too long: what a page is asked has no limit."""
    if "chromium" not in request.fixturenames:
        yield
        return
    killed: list[str] = []

    with limited(lambda: killed.extend(kill_browsers()), ANSWERS_WITHIN):
        yield
    assert not killed, (
        f"{request.node.nodeid}: a page had not answered after {ANSWERS_WITHIN:.0f} s, its browser "
        "was killed"
    )


@pytest.fixture(autouse=True)
def no_error_logs(caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Fail a test that logged an ERROR."""
    yield
    errors = [
        record.getMessage()
        for phase in ("setup", "call")
        for record in caplog.get_records(phase)
        if record.levelno >= logging.ERROR
    ]
    assert not errors, f"logged as ERROR: {errors}"
