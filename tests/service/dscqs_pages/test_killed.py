"""The real page in a real browser, while its server is killed: grades are what was clicked."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import httpx
import pytest

from service.dscqs_client import OperatorClient
from service.http.dscqs_access import TOKEN_FILE
from tests.service.dscqs.support import KillableService, write_stimuli
from tests.service.dscqs_pages.conftest import PROFILE, TIMING
from tests.service.dscqs_pages.exports import document_of, given, votes_of
from tests.support.assessor_page import AssessorPage
from tests.support.waiting import PATIENCE


@pytest.fixture
def service(tmp_path: Any) -> Iterator[KillableService]:
    service = KillableService(data=tmp_path / "data", roots=tmp_path / "roots")
    write_stimuli(service.roots / "set1")
    service.start()
    yield service
    service.kill()


@pytest.fixture
def operator(service: KillableService) -> Iterator[OperatorClient]:
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as http:
        client = OperatorClient(http=http)
        client.login((service.data / TOKEN_FILE).read_text().strip())
        put = http.put("/dscqs/api/operator/displays/desk", json=PROFILE)
        assert put.status_code == 200
        yield client


@contextlib.contextmanager
def away(service: KillableService) -> Iterator[None]:
    """``kill -9``; the server is not there for what is done within, or for its beginning."""
    service.kill()
    coming = threading.Timer(0.2, service.start)
    coming.start()
    yield
    coming.join(PATIENCE)


def come_to_showing(seat: AssessorPage) -> None:
    """Go on until something is shown; or has been, where the machine is slow to say so."""
    shown = "html[data-showing=yes], [data-page=vote]"
    asks = ":is([data-page=ready], [data-page=elsewhere], [data-page=failed]) button.main"
    while True:
        seat.page.wait_for_selector(f"{shown}, {asks}", state="attached")
        if seat.page.locator(shown).count():
            return
        seat.press_main()


def test_a_session_outlives_its_server_at_every_step(make_tab, service, operator):
    """Every request of a session is sent to a server that is not there."""
    conditions = ["bicubic", "sr"]
    test = operator.make_test({
        "name": "kills", "folder": "set1", "contents": ["ballet"], "conditions": conditions,
        "reference": "original", "dummies": 0, "break_every": 1, "break_s": 0,
        "displays": ["desk"], "timing": TIMING,
        "stimuli": {f"ballet/{name}": f"ballet-{name}.png" for name in ("original", *conditions)},
    })  # fmt: skip
    seat = make_tab()
    seat.page.goto(service.url + operator.invite(test, "a1", "desk"))
    seat.wait_for("enter")
    with away(service):
        seat.press_main()
    for name, answer in (
        ("instructions", None), ("screening", seat.answer_screening), ("stereo-acuity", None),
        ("fatigue", seat.answer_fatigue),
    ):  # fmt: skip
        seat.wait_for(name)
        if answer is not None:
            answer()
        with away(service):
            seat.press_main()

    seat.wait_for("ready")
    seat.record()
    with away(service):  # the presentation is asked for
        seat.press_main()

    def lose(route: Any) -> None:
        with away(service):
            pass
        route.continue_()

    seat.page.route("**/stimulus/*", lose, times=1)  # its pictures are, and went with the server
    come_to_showing(seat)
    with away(service):  # the end of the showing is told
        seat.come_to_vote()
    with away(service):
        seat.vote(71, 33)

    seat.wait_for("pause")
    with away(service):
        seat.press_main()
    seat.come_to_vote()
    seat.grade(0, 90)
    with away(service):
        pass
    seat.reload()  # with one grade given: the pair is shown again
    seat.come_to_vote()
    with away(service):
        seat.vote(60, 48)
    seat.wait_for("fatigue")
    seat.answer_fatigue()
    with away(service):
        seat.press_main()
    seat.wait_for("thanks")

    assert given(votes_of(operator, test)) == seat.clicked
    (session,) = document_of(operator, test)["sessions"]
    names = [event["name"] for event in session["events"]]
    assert [names.count(name) for name in ("graded", "continued", "formfilled")] == [2, 2, 4]
    assert set(session["forms"]) == {
        "screening", "stereo_acuity", "fatigue_before", "fatigue_after",
    }  # fmt: skip
