"""The real page in a real browser, while its server is killed: grades are what was clicked."""

from __future__ import annotations

import threading
import time
from contextlib import suppress

import httpx
import pytest
from playwright.sync_api import Error as PlaywrightError

from dscqs.votes import parse_csv
from service.dscqs_client import OperatorClient
from service.http.dscqs_access import TOKEN_FILE
from tests.service.dscqs.support import KillableService, write_stimuli

PATIENCE_MS = 60_000
WIDTH, HEIGHT = 600, 620
PROFILE = {
    "title": "the browser's window", "mode": "rows", "width_px": WIDTH, "height_px": HEIGHT,
    "distance_heights": 3.0,
}  # fmt: skip


@pytest.fixture
def service(tmp_path):
    service = KillableService(data=tmp_path / "data", roots=tmp_path / "roots")
    write_stimuli(service.roots / "set1")
    service.start()
    yield service
    service.kill()


@pytest.fixture
def operator(service):
    with httpx.Client(base_url=service.url, timeout=60) as http:
        client = OperatorClient(http=http)
        client.login((service.data / TOKEN_FILE).read_text().strip())
        put = http.put("/dscqs/api/operator/displays/desk", json=PROFILE)
        assert put.status_code == 200
        yield client


def _bounce(service, away_s=0.5):
    """Kill the server, and start it again a little later."""
    service.kill()
    starting = threading.Timer(away_s, service.start)
    starting.start()
    return starting


def _grade(page, side, value):
    """Click where a grade lies; return the grade of the very point clicked."""
    box = page.locator(".scale .line").nth(side).bounding_box()
    y = round(box["y"] + box["height"] * (1 - value / 100))
    page.mouse.click(box["x"] + box["width"] / 2, y)
    return round(100 * (1 - (y - box["y"]) / box["height"]) + 1e-9, 1)


def _come_to_vote(page):
    """See the presentation to its end, however often it is offered again."""
    until = time.monotonic() + PATIENCE_MS / 1000
    while time.monotonic() < until:
        if page.locator("main[data-page=vote] .scales:not([inert])").count():
            return
        ready = page.locator("main:not([data-page=vote]) button.main:enabled")
        if ready.count() and page.locator("html[data-showing=yes]").count() == 0:
            with suppress(PlaywrightError):  # the page went on meanwhile
                ready.first.click(timeout=1000)
        page.wait_for_timeout(100)
    raise AssertionError(f"no vote; the page is {page.locator('main').get_attribute('data-page')}")


def test_a_session_outlives_its_server(chromium, service, operator):
    plan = {
        "name": "kills", "folder": "set1", "contents": ["ballet"], "conditions": ["bicubic", "sr"],
        "reference": "original", "dummies": 0, "stages": [], "displays": ["desk"],
        "timing": {"show_s": 0.4, "grey_s": 0.1, "vote_s": 60, "showings": 2, "tolerance_s": 20},
        "stimuli": {
            f"ballet/{name}": f"ballet-{name}.png" for name in ("original", "bicubic", "sr")
        },
    }  # fmt: skip
    test = operator.make_test(plan)
    page = chromium.new_page(viewport={"width": WIDTH, "height": HEIGHT})
    page.set_default_timeout(PATIENCE_MS)
    page.goto(service.url + operator.invite(test, "a1", "desk"))
    page.wait_for_selector("main[data-page] button.main:enabled")
    _bounce(service).join(60)  # before anything was shown
    clicked = []
    for number in range(2):
        _come_to_vote(page)
        clicked.append({"A": _grade(page, 0, 70 + number), "B": _grade(page, 1, 30 + number)})
        coming = _bounce(service, 1.0)  # the vote is sent to a server that is not there
        page.locator("main button.main:enabled").click()
        coming.join(60)
    page.wait_for_selector("main[data-page=thanks]")
    page.close()
    votes = parse_csv(operator.votes_csv(test)).votes
    given = [
        {"A": vote.grade_reference, "B": vote.grade_test}
        if vote.extra["reference_side"] == "A"
        else {"A": vote.grade_test, "B": vote.grade_reference}
        for vote in votes
    ]
    assert given == clicked
