"""Tabs of the browser that tests of pages share."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import psutil

from tests.support.waiting import PATIENCE

PATIENCE_MS = round(1000 * PATIENCE)
"""The same for what a browser shall have done."""


class Chromium:
    """A browser; another one where it was killed.

    Parameters
    ----------
    launch : callable
        Starts one.
    """

    def __init__(self, launch: Callable[[], Any]) -> None:
        self._launch = launch
        self._browser = launch()

    def new_context(self, **options: Any) -> Any:
        """As of playwright's browsers."""
        return self._living().new_context(**options)

    def new_page(self, **options: Any) -> Any:
        """As of playwright's browsers."""
        return self._living().new_page(**options)

    def close(self) -> None:
        self._browser.close()

    def _living(self) -> Any:
        if not self._browser.is_connected():
            self._browser = self._launch()
        return self._browser


def kill_browsers() -> list[str]:
    """Kill the browsers of this process; return the names of what was killed."""
    killed = []
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if "chrom" in process.name():
                killed.append(process.name())
                process.kill()
    return killed


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
