"""Every page meets WCAG AA as far as rules can tell, and grades by keys as by pointers."""

from __future__ import annotations

from typing import Any

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
