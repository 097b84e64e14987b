"""The report in a real browser: clean to axe, and no wider than a telephone."""

from __future__ import annotations

from dscqs.report import LogEntry, html_report
from tests.dscqs.report.conftest import simulate
from tests.support.accessibility import problems
from tests.support.browser import opened_tab


def test_a_report_can_be_read_by_everybody(chromium, tmp_path):
    path = tmp_path / "report.html"
    log = [LogEntry(time="2026-01-31", event="joined", assessor="a01", detail="x" * 200)]
    path.write_bytes(html_report(simulate(assessors=5), title="Set 1", log=log))
    with opened_tab(chromium, path.as_uri()) as page:
        for folded in page.locator("summary").all():
            folded.click()
        assert problems(page) == []
        for width in (360, 1360):
            page.set_viewport_size({"width": width, "height": 800})
            assert page.evaluate("document.documentElement.scrollWidth") == width
