"""A server of the page's files, under a policy as strict as the one that they are served with."""

from __future__ import annotations

import functools
import http.server
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.browser import opened_tab

PAGE = Path(__file__).parents[3] / "dscqs" / "page"


class _Files(http.server.SimpleHTTPRequestHandler):
    """The page's files, and those of a folder of the test under ``/made/``."""

    made: Path

    def do_GET(self) -> None:
        if self.path == "/favicon.ico":
            self.send_response(204)
            self.end_headers()
        else:
            super().do_GET()

    def translate_path(self, path: str) -> str:
        plain = path.partition("?")[0]
        if plain.startswith("/made/"):
            return str(self.made / plain.removeprefix("/made/"))
        return str(PAGE / plain.lstrip("/"))

    def end_headers(self) -> None:
        self.send_header("Content-Security-Policy", "default-src 'self'; img-src 'self' blob:")
        self.send_header("Cross-Origin-Opener-Policy", "same-origin")
        self.send_header("Cross-Origin-Embedder-Policy", "require-corp")
        super().end_headers()

    def log_message(self, *args: Any) -> None:
        pass


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of files that the page can fetch under ``/made/``."""
    return tmp_path_factory.mktemp("made")


@pytest.fixture(scope="session")
def files_url(made: Path) -> Iterator[str]:
    """Address of the page's files."""
    (made / "empty.html").write_text("<!doctype html><title>empty</title>", encoding="utf-8")
    handler = functools.partial(type("Files", (_Files,), {"made": made}))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture(scope="module")
def tab(chromium: Any, files_url: str) -> Iterator[Any]:
    """A tab on an empty page of the server, for all tests of a file."""
    with opened_tab(chromium, f"{files_url}/made/empty.html") as page:
        yield page
