"""Every page meets WCAG AA as far as rules can tell, and grades by keys as by pointers."""

from __future__ import annotations

import numpy as np
import pytest
from playwright.sync_api import expect

from dscqs.displays import profile_from_dict
from tests.service.dscqs_pages.conftest import HEIGHT, PROFILE, TIMING, WIDTH
from tests.service.dscqs_pages.exports import given, logs_of, sides_of, votes_of
from tests.support.accessibility import problems
from tests.support.browser import PATIENCE_MS


def test_pages_around_a_session(make_tab, desk, make_test, operator, served, plan):
    """What a session shows when something is amiss, from its link to its end."""
    test = make_test({**plan, "break_every": 1})
    session = f"/dscqs/api/operator/tests/{test}/sessions/a1"
    tab = make_tab(locale="de-DE")
    found: dict[str, list[str]] = {}

    def look(name: str) -> None:
        tab.wait_for(name)
        assert name not in found
        found[name] = problems(tab.page)

    link = served.url + operator.invite(test, "a1", "desk")
    tab.page.goto(link)
    look("enter")
    assert "in keinem anderen" in tab.page.inner_text("main")
    assert operator.progress(test)[0]["joined"] is False
    tab.press_main()
    tab.page.wait_for_url("**/assessor.html")
    tab.record()
    look("ready")
    tab.page.set_viewport_size({"width": WIDTH + 20, "height": HEIGHT})
    tab.press_main()
    look("display")
    tab.page.set_viewport_size({"width": WIDTH, "height": HEIGHT})
    tab.page.route("**/stimulus/*", lambda route: route.abort(), times=2)
    tab.press_main()
    look("failed")
    other = type(tab)(tab.page.context.new_page())
    other.open(tab.page.url)
    other.come_to_vote()
    tab.page.bring_to_front()
    tab.press_main()
    tab.come_to_vote()
    other.page.bring_to_front()
    other.vote(50, 50)
    other.wait_for("elsewhere")
    found["elsewhere"] = problems(other.page)
    other.page.close()
    tab.page.bring_to_front()
    tab.page.context.set_offline(True)
    tab.vote(50, 40)
    tab.page.wait_for_selector("#banner:not(:empty)")
    look("vote")
    tab.page.context.set_offline(False)
    look("pause")
    operator.http.post(f"{session}/pause")
    tab.reload()
    look("still")
    operator.http.post(f"{session}/withdraw")  # resumed first, the page might see that alone
    look("withdrawn")
    tab = make_tab(locale="de-DE")
    tab.page.goto(link)
    tab.page.click("main[data-page=enter] button.main")  # it was used in another browser
    look("no-session")
    assert "anderen Browser" in tab.page.inner_text("main")
    assert tab.page.evaluate("document.documentElement.lang") == "de"
    assert found == {name: [] for name in found}


@pytest.mark.parametrize("language", ["en", "ja"])
def test_pages_of_a_session(enter, make_test, plan, language):
    stages = ["instructions", "screening", "stereo_acuity", "fatigue_before"]
    timing = {**TIMING, "showings": 3, "show_s": 0.2, "grey_s": 0.2}
    test = make_test({
        **plan, "stages": stages, "dimensions": ["quality", "comfort"], "timing": timing,
    })  # fmt: skip
    seat = enter(test, language=language)
    found: dict[str, list[str]] = {}
    for name, act in (
        ("instructions", seat.press_main), ("screening", seat.fill_screening),
        ("stereo-acuity", seat.leave_out_stereo_acuity), ("fatigue", seat.fill_fatigue),
        ("ready", None),
    ):  # fmt: skip
        seat.wait_for(name)
        if name == "screening":  # with both of its drawn questions
            for part in ("acuity", "colour"):
                seat.page.locator(f"label:has(input[name={part}])").nth(1).click()
        if name == "instructions":
            assert "3" in seat.page.locator("main li").first.inner_text()
        found[name] = problems(seat.page)
        assert seat.page.evaluate("document.documentElement.lang") == language
        if act is not None:
            act()
    seat.come_to_vote()
    for side in range(4):
        seat.page.locator(".scale").nth(side).press("PageUp")
    found["vote"] = problems(seat.page)
    assert found == {name: [] for name in found}


def test_the_page_that_calibrates(make_tab, served):
    """Logged out, and in: size, eyes and pixels of the very screen, stored under a new name."""
    name, address = "calibrated", f"{served.url}/dscqs/pages/calibrate.html"
    displays = served.app.state.desks.real.displays
    displays.put("another", profile_from_dict({**PROFILE, "pixel_pitch_mm": 0.277}))
    page = make_tab().page
    page.goto(address)
    page.get_by_text("Log in as an operator first").wait_for()
    assert problems(page) == []
    login = f"{served.url}/dscqs/api/operator/login"
    assert page.request.post(login, data={"token": served.token}).ok
    page.goto(f"{address}?display=another")
    page.get_by_label("Store as").fill(name)
    page.get_by_text("Measure the pixels with a bank card").click()
    assert problems(page) == []
    page.get_by_label("Width of the signal, pixels").fill("10")
    page.get_by_role("button", name="eyes", exact=True).click()
    page.get_by_text(f"the window has {WIDTH} × {HEIGHT} pixels").wait_for()
    assert problems(page) == []
    page.get_by_role("button", name="Take the size of this screen").click()
    page.get_by_text("Measure the pixels to know the distance").wait_for()  # not another's any more
    page.get_by_role("button", name="eyes", exact=True).click()
    page.wait_for_selector("html[data-showing=yes]", state="attached")
    for key in ("s", "p", " "):
        page.keyboard.press(key)
    page.get_by_text("Eyes exchanged; lines shifted by 1").wait_for()
    page.get_by_text("the size of a pixel is not known").wait_for()
    page.get_by_text("Measure the pixels with a bank card").click()
    page.get_by_label("Width of the card, pixels").fill("428")
    page.get_by_role("button", name="Store the profile").click()
    page.get_by_text(f"Stored as {name}").wait_for()
    stored = displays.get(name)
    assert (stored.width_px, stored.height_px) == (WIDTH, HEIGHT)
    assert (stored.swap, stored.phase, stored.pixel_pitch_mm) == (True, 1, 0.2)
    page.get_by_label("Width of the signal, pixels").fill("10")
    page.get_by_label("Pixel pitch, mm").fill("0.3")
    page.get_by_role("button", name="Take the size of this screen").click()
    expect(page.get_by_label("Width of the signal, pixels")).to_have_value(
        str(WIDTH), timeout=PATIENCE_MS
    )
    assert page.get_by_label("Pixel pitch, mm").input_value() == "0.3"  # measured on this one


def test_fingers_grade_as_pointers_do(enter, make_test, operator, plan):
    """A tap on one line, a finger that slides on the other; the page does not scroll under it."""
    test = make_test(plan)
    seat = enter(test, has_touch=True)
    seat.come_to_vote()
    x, y, first = seat.place_of(0, 73)
    seat.page.touchscreen.tap(x, y)
    seat.page.wait_for_selector(".handle:visible")  # a touch is answered before the page has it
    assert seat.page.locator(".handle:visible").count() == 1
    fingers = seat.page.context.new_cdp_session(seat.page)
    for kind, value in (("Start", 20), ("Move", 40), ("Move", 64), ("End", None)):
        if value is not None:
            x, y, second = seat.place_of(1, value)
        points = [] if value is None else [{"x": x, "y": y}]
        fingers.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})
    assert seat.page.evaluate("[scrollY, document.querySelector('main').scrollTop]") == [0, 0]
    # a browser takes a tap amid a finger's last move for the end of that
    seat.page.wait_for_timeout(600)
    seat.lead_on(lambda button: button.tap(), again_ms=3000)
    seat.wait_until_sent()
    assert given(votes_of(operator, test)) == [{"A": first, "B": second}]


BAR_STAYS = """() => {
  const wait = window.setTimeout;
  window.setTimeout = (act, ms, ...more) => (ms === 3000 ? 0 : wait(act, ms, ...more));
}"""
"""Once it is there it does not go again, however long a loaded machine takes to touch it."""


def test_fingers_switch_freely(enter, make_test, operator, plan):
    """Buttons over the picture, large enough and with names; gone until a finger comes again."""
    test = make_test({**plan, "variant": "I"})
    seat = enter(test, has_touch=True, language="de")
    seat.wait_for("ready")
    assert "berühren" in seat.page.inner_text("main")
    seat.press_main()
    seat.wait_until_drawn(1)
    assert problems(seat.page) == []
    buttons = {
        name: seat.page.get_by_role("button", name=name)
        for name in ("A zeigen", "B zeigen", "Bewerten")
    }
    for one in buttons.values():
        box = one.bounding_box()
        assert min(box["width"], box["height"]) >= 44
    assert buttons["A zeigen"].get_attribute("aria-pressed") == "true"
    assert buttons["Bewerten"].is_disabled()
    seat.page.wait_for_selector("main[data-bar=no]", state="attached")
    seat.page.evaluate(BAR_STAYS)
    places = {name: seat.middle_of(f"main button >> nth={at}") for at, name in enumerate(buttons)}
    seat.page.touchscreen.tap(*places["B zeigen"])  # nothing is there to be touched by accident
    seat.page.wait_for_selector("main[data-bar=yes]", state="attached")
    assert buttons["A zeigen"].get_attribute("aria-pressed") == "true"
    seat.page.touchscreen.tap(*places["B zeigen"])
    seat.wait_until_drawn(2)
    assert buttons["B zeigen"].get_attribute("aria-pressed") == "true"
    seat.page.touchscreen.tap(*places["Bewerten"])
    seat.come_to_vote()
    (log,) = logs_of(operator, test)
    assert [item["what"] for item in log["log"]["intervals"]] == ["A", "B"]
    assert log["outcome"] == "ok"
    seat.vote(60, 40)
    seat.wait_until_sent()
    (vote,) = votes_of(operator, test)
    assert [item["rgb"] for item in seat.drawn[0] if item["stereo"]] == sides_of(vote)


def test_keys_grade_as_pointers_do(enter, make_test, operator, plan):
    test = make_test(plan)
    seat = enter(test)
    seat.come_to_vote()
    keys = seat.page.keyboard
    assert seat.page.locator(".handle:visible").count() == 0
    assert seat.page.locator("main button.main").is_disabled()
    for key in ("ArrowUp", "ArrowUp", "PageUp", "Shift+ArrowDown"):
        keys.press(key)  # 50, 51, 61, 60.9
    assert seat.page.locator(".scale").first.get_attribute("aria-valuetext") == "Good"
    keys.press("=")  # B same as A
    keys.press("Tab")
    keys.press("End")
    keys.press("ArrowUp")  # no further than 100
    keys.press("PageDown")
    seat.press_main()
    seat.wait_until_sent()
    assert given(votes_of(operator, test)) == [{"A": 60.9, "B": 90.0}]


def test_both_eyes_read_the_same_page_at_the_same_place(
    make_tab, make_test, operator, served, plan
):
    served.app.state.desks.real.displays.put(
        "pair",
        profile_from_dict(
            {"title": "two projectors", "mode": "dual", "width_px": 1280, "height_px": 640,
             "distance_heights": 3}
        ),
    )  # fmt: skip
    test = make_test({**plan, "displays": ["pair"], "stages": ["instructions"]})
    size = {"width": 1280, "height": 640}
    seat = make_tab(viewport=size).open(served.url + operator.invite(test, "a1", "pair"))
    seat.wait_for("instructions")
    seat.page.locator("#page .scale").first.press("PageUp")
    seat.page.wait_for_selector(".copy .handle:visible")
    places = seat.page.evaluate(
        """() => ["#page", ".copy main"].map((root) =>
          [...document.querySelectorAll(
            `${root} :is(h1, p, li, button, .line, .handle:not([hidden]))`)].map(
            (element) => {
              const {x, y, width, height} = element.getBoundingClientRect();
              return [x, y, width, height].map((value) => Math.round(100 * value) / 100);
            }))"""
    )
    original, copy = places
    assert len(original) > 10
    np.testing.assert_allclose(np.array(copy) - original, len(copy) * [[640, 0, 0, 0]], atol=0.02)
    assert seat.page.locator(".copy .focused").count() == 1
    seat.grade(1, 40)  # by the mouse, which draws no ring: neither eye may see one
    seat.page.wait_for_selector(".copy .scale:nth-child(2) .handle:visible >> nth=1")
    rings = seat.page.locator("#page :focus-visible, .copy .focused")
    assert rings.count() == 0
