"""The operator's page in a real browser: from the login to the votes, clean to axe."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page

from dscqs.exchange.files import parse_scores
from dscqs.votes import Order, parse_csv
from tests.service.dscqs.support import walk
from tests.support.assessor_client import AssessorClient
from tests.support.browser import PATIENCE_MS


@pytest.fixture(scope="module")
def page(chromium, served, stimuli):
    folder = served.root / "thesis-set-1"
    folder.mkdir()
    for key, name in stimuli.items():
        shutil.copy(served.root / "set1" / name, folder / f"{key.replace('/', '--')}.png")
    page = chromium.new_page(viewport={"width": 1360, "height": 900}, accept_downloads=True)
    page.set_default_timeout(PATIENCE_MS)
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto(f"{served.url}/dscqs/pages/operator.html")
    yield page
    assert errors == []
    page.close()


def _look(page: Page, name: str) -> None:
    """Check the page with axe, and keep a picture of it where one is asked for."""
    found = Axe().run(page, options={"resultTypes": ["violations"]})
    assert found.violations_count == 0, found.generate_report()
    if os.environ.get("DEPTHSR_SCREENSHOTS"):
        page.screenshot(
            path=Path(os.environ["DEPTHSR_SCREENSHOTS"]) / f"{name}.png", full_page=True
        )


def test_an_operator_makes_a_test_and_sees_it_through(page, served, make_http, operator):
    page.get_by_label("Token").fill("not this one")
    page.get_by_role("button", name="Log in").click()
    page.get_by_text("lets no operator in").wait_for()
    _look(page, "operator-login")
    page.get_by_label("Token").fill(served.token)
    page.get_by_role("button", name="Log in").click()
    page.get_by_role("button", name="New test").click()

    page.get_by_label("Stimuli").select_option(label="roots/thesis-set-1 (3 × 3, stills)")
    page.get_by_text("3 contents × 2 conditions against “original”: 11 presentations").wait_for()
    page.get_by_label("Times each pair is shown").fill("20")
    page.get_by_text("more than 30").wait_for()
    assert page.get_by_role("button", name="Make the test").is_disabled()
    page.get_by_label("Times each pair is shown").fill("1")
    page.get_by_label("Level of the grey").fill("256")
    page.get_by_text("grey: 256 is not a whole number from 0 to 255").wait_for()
    assert page.locator("[aria-invalid]").get_attribute("name") == "grey"
    page.get_by_label("Level of the grey").fill("74")
    page.get_by_label("letters A and B").uncheck()
    page.get_by_label("Times A and B are shown in turn").fill("3")
    page.get_by_label("A or B is shown [s]").fill("2.5")
    page.get_by_label("fatigue after").uncheck()
    page.get_by_label("Training contents").fill("meadow")
    page.get_by_label("Dummies at the start").fill("1")
    for label, hint in (("Dummies at the start", "do not count"),
                        ("Pairs that come once more", "both times"),
                        ("Off by more has failed [s]", "offered again")):  # fmt: skip
        described = page.get_by_label(label).get_attribute("aria-describedby")
        assert hint in page.locator(f"[id='{described}']").inner_text()
    page.get_by_label("Name", exact=True).fill("Thesis, set 1")
    page.get_by_label("autostereoscopic").check()
    page.get_by_text("2 contents × 2 conditions against “original”: 5 presentations").wait_for()
    _look(page, "operator-new")
    page.set_viewport_size({"width": 360, "height": 740})
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    page.set_viewport_size({"width": 1360, "height": 900})
    page.get_by_role("button", name="Make the test").click()

    page.get_by_role("heading", name="Thesis, set 1").wait_for()
    (made,) = operator.http.get("/dscqs/api/operator/tests").json()[:1]
    made = operator.http.get(f"/dscqs/api/operator/tests/{made['test']}").json()["plan"]
    assert (made["grey"], made["captions"]) == (74, False)
    assert made["timing"] == {
        "show_s": 2.5, "grey_s": 2, "vote_s": 8, "showings": 3, "tolerance_s": 0.1,
    }  # fmt: skip
    assert made["stages"] == ["instructions", "screening", "stereo_acuity", "fatigue_before"]
    page.get_by_text("Nobody was let in yet").wait_for()
    page.get_by_label("Codes of assessors").fill("a1, a2")
    page.get_by_role("button", name="Links to stations").click()
    page.get_by_alt_text("QR code of the link of a2").wait_for()
    links = page.locator(".link code").all_inner_texts()
    assert len(links) == 2
    first, second = (AssessorClient(http=make_http()) for _ in links)
    first.enter(links[0])
    walk(first)
    second.enter(links[1])
    walk(second, until=lambda state: state["stage"] == "presentation" and state["index"] == 2)
    second.present()
    second.shown("failed", {"faults": [{"kind": "focus", "detail": "the window lost the focus"}]})
    row = page.get_by_role("row").filter(has_text="a2")
    row.get_by_text("the window lost the focus").wait_for()
    noted = {"kind": "display", "detail": {"codes": ["odd-ratio"]}}
    assert second.http.post("/dscqs/api/assessor/events", json=noted).status_code == 204
    row.get_by_text("display: odd-ratio").wait_for()
    page.get_by_role("row").filter(has_text="a1").get_by_text("finished").wait_for()
    row.get_by_role("button", name="Pause").click()
    row.get_by_text("paused").wait_for()
    assert second.state()["stage"] == "paused"
    assert page.locator(".link code").all_inner_texts() == links
    assert row.locator("button:focus").inner_text() == "Resume"
    row.get_by_role("button", name="Resume").click()
    row.get_by_text("test", exact=True).wait_for()
    _look(page, "operator-test")
    page.set_viewport_size({"width": 360, "height": 740})
    assert page.evaluate("document.documentElement.scrollWidth") == 360  # a telephone shows it all
    page.set_viewport_size({"width": 1360, "height": 900})

    with page.expect_download() as download:
        page.get_by_role("link", name="Votes (CSV)").click()
    table = parse_csv(Path(download.value.path()).read_text(encoding="utf-8"))
    assert len([vote for vote in table.votes if vote.assessor == "a1"]) == 7
    assert table.order == Order(
        displays=tuple(made["displays"]), contents=tuple(made["contents"]),
        conditions=("bicubic", "sr"), dimensions=("quality",),
    )  # fmt: skip
    with page.expect_download() as download:
        page.get_by_role("link", name="Report (HTML)").click()
    assert "Thesis, set 1" in Path(download.value.path()).read_text(encoding="utf-8")
    for name in ("Votes (suJSON)", "Votes (sureal: polarised, quality)"):
        with page.expect_download() as download:
            page.get_by_role("link", name=name).click()
        again = parse_scores(Path(download.value.path()).read_text(encoding="utf-8"))
        assert again.order in (table.order, Order())  # a dataset of sureal has no place for it
        assert "a1" in {vote.assessor for vote in again.votes}

    page.on("dialog", lambda dialog: dialog.accept())
    row.get_by_role("button", name="Withdraw").click()
    row.get_by_text("withdrawn").wait_for()
    assert second.state()["stage"] == "withdrawn"


def test_a_group_and_a_dry_run_are_let_in(page, served, make_http):
    before = page.locator(".link").count()
    page.get_by_label("Codes of assessors").fill("")
    page.get_by_role("button", name="A group before one screen").click()
    page.get_by_text("Enter the code of an assessor first").wait_for()
    page.get_by_label("Codes of assessors").fill("g1 g2 g3")
    page.get_by_role("button", name="A group before one screen").click()
    page.get_by_alt_text("QR code of the link of g3").wait_for()
    assert page.get_by_text("this machine alone").is_visible()  # no telephone reaches it
    assert page.locator(".link").count() == before + 4
    _look(page, "operator-group")
    for _ in range(2):  # the newer takes the place of the one before
        page.get_by_role("button", name="Dry run").click()
        page.get_by_text("nothing is stored").wait_for()
    dry = page.locator(".link").filter(has_text="nothing is stored")
    link = dry.locator("code").inner_text()
    assert page.locator(".link").count() == before + 5
    client = AssessorClient(http=make_http())
    client.enter(link)
    assert walk(client)["stage"] == "thanks"
    assert page.get_by_role("row").filter(has_text="dry-run").count() == 0
    page.get_by_role("button", name="Log out").click()
    page.get_by_label("Token").wait_for()
    assert page.context.request.get(f"{served.url}/dscqs/api/operator/tests").status == 401
