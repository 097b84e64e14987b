"""Every page meets WCAG AA as far as rules can tell, and grades by keys as by pointers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

RULES = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]}}


def problems(page: Any) -> list[str]:
    """What axe finds on a page."""
    from axe_playwright_python.sync_playwright import Axe

    found = Axe().run(page, options=RULES).response["violations"]
    return [f"{item['id']}: {node['html'][:120]}" for item in found for node in item["nodes"]]


@pytest.mark.parametrize("language", ["en", "ja"])
def test_pages_of_a_session(enter, make_test, plan, language):
    stages = ["instructions", "screening", "fatigue_before"]
    test = make_test({**plan, "stages": stages, "dimensions": ["quality", "comfort"]})
    seat = enter(test, language=language)
    found: dict[str, list[str]] = {}
    for name, act in (
        ("instructions", seat.press_main), ("screening", seat.fill_screening),
        ("fatigue", seat.fill_fatigue), ("ready", None),
    ):  # fmt: skip
        seat.wait_for(name)
        found[name] = problems(seat.page)
        assert seat.page.evaluate("document.documentElement.lang") == language
        if act is not None:
            act()
    seat.come_to_vote()
    for side in range(4):
        seat.page.locator(".scale").nth(side).press("PageUp")
    found["vote"] = problems(seat.page)
    assert found == {name: [] for name in found}


def test_keys_grade_as_pointers_do(enter, make_test, operator, plan):
    from tests.service.dscqs_pages.test_session import given, votes_of

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
    seat.wait_for("loading")
    assert given(votes_of(operator, test)) == [{"A": 60.9, "B": 90.0}]


def test_both_eyes_read_the_same_page_at_the_same_place(
    make_tab, make_test, operator, served, plan
):
    from dscqs.displays import profile_from_dict

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
