"""The browser that tests of pages share."""

from __future__ import annotations

import pytest

from tests.support.browser import kill_browsers, opened_tab


def test_who_comes_after_a_browser_was_killed_gets_another(chromium):
    with opened_tab(chromium, "about:blank") as page:
        assert kill_browsers()
        with pytest.raises(Exception, match="closed"):
            page.evaluate("new Promise(() => {})")
    with opened_tab(chromium, "about:blank") as page:
        assert page.evaluate("1 + 1") == 2
