"""A real service, a real browser, and tests of stimuli small enough for both."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from service.dscqs_client import OperatorClient
from tests.service.dscqs.conftest import Served, http, make_http, operator, served, stimuli
from tests.service.dscqs.support import CONDITIONS, CONTENTS, REFERENCE
from tests.support.assessor_page import AssessorPage
from tests.support.browser import PATIENCE_MS

__all__ = ["http", "make_http", "operator", "served", "stimuli"]

WIDTH, HEIGHT = 600, 620
TIMING = {"show_s": 0.2, "grey_s": 0.1, "vote_s": 60, "showings": 1, "tolerance_s": 20}
"""A loaded machine may be late; how late it was is looked at by the tests that are about it."""

PROFILE = {
    "title": "the browser's window", "mode": "rows", "width_px": WIDTH, "height_px": HEIGHT,
    "distance_heights": 3.0,
}  # fmt: skip


@pytest.fixture(scope="session")
def desk(served: Served) -> str:
    """Name of a display of the size of the browser's window."""
    from dscqs.displays import profile_from_dict

    served.app.state.desks.real.displays.put("desk", profile_from_dict(PROFILE))
    return "desk"


@pytest.fixture
def plan(stimuli: dict[str, str], desk: str) -> dict[str, Any]:
    return {
        "name": "in a browser", "folder": "set1", "contents": list(CONTENTS),
        "conditions": list(CONDITIONS), "reference": REFERENCE, "dummies": 1,
        "stimuli": {key: name for key, name in stimuli.items() if not key.startswith("meadow")},
        "displays": [desk], "timing": TIMING, "stages": [],
    }  # fmt: skip


@pytest.fixture
def make_test(operator: OperatorClient) -> Callable[[dict[str, Any]], str]:
    def make(plan: dict[str, Any]) -> str:
        answer = operator.http.post("/dscqs/api/operator/tests", json=plan)
        assert answer.status_code == 201, answer.text
        return answer.json()["test"]

    return make


@pytest.fixture
def make_tab(chromium: Any, served: Served) -> Iterator[Callable[..., AssessorPage]]:
    """Return what opens a tab; a test whose pages logged errors of their own fails."""
    errors: list[str] = []
    with contextlib.ExitStack() as stack:

        def make(**options: Any) -> AssessorPage:
            size = {"width": WIDTH, "height": HEIGHT}
            context = chromium.new_context(**{"viewport": size, **options})
            stack.callback(context.close)
            context.set_default_timeout(PATIENCE_MS)
            page = context.new_page()
            page.on("pageerror", lambda error: errors.append(str(error)))
            return AssessorPage(page)

        yield make
    assert errors == []


@pytest.fixture
def enter(
    make_tab: Callable[..., AssessorPage], operator: OperatorClient, served: Served, desk: str
) -> Callable[..., AssessorPage]:
    """Return what lets an assessor into a test, in a tab of their own."""

    def enter(test: str, assessor: str = "a1", language: str = "en", **options: Any) -> Any:
        answer = operator.http.post(
            f"/dscqs/api/operator/tests/{test}/links",
            json={"assessor": assessor, "display": desk, "language": language},
        )
        assert answer.status_code == 201, answer.text
        return make_tab(**options).open(served.url + answer.json()["link"])

    return enter
