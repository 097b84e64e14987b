"""Tabs of the browser that tests of pages share."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from tests.support.waiting import PATIENCE

PATIENCE_MS = round(1000 * PATIENCE)
"""The same for what a browser shall have done."""


@contextlib.contextmanager
def opened_tab(chromium: Any, url: str, **options: Any) -> Iterator[Any]:
    """A tab on a page; whoever closes it with errors logged fails."""
    context = chromium.new_context(**{"viewport": {"width": 640, "height": 400}, **options})
    context.set_default_timeout(PATIENCE_MS)
    page = context.new_page()
    errors: list[str] = []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.on("console", lambda said: errors.append(said.text) if said.type == "error" else None)
    page.goto(url)
    yield page
    context.close()
    assert errors == []
