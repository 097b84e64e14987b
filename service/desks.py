"""The two desks of the service: the one that stores, and the one of dry runs."""

from __future__ import annotations

import base64
import hashlib
import secrets
import time
from pathlib import Path

from dscqs.desk import Desk
from dscqs.displays import DisplayShelf
from dscqs.shelf import Shelf
from dscqs.sqlite_store import SqliteSessionStore
from dscqs.store import MemorySessionStore, SessionRecord


class Desks:
    """Opens ``dscqs.sqlite`` and the stimuli of a data folder."""

    DRY = "dry-"
    """Links and cookies of dry runs begin so."""

    def __init__(self, data: Path) -> None:
        shelf = Shelf(data / "stimuli")
        displays = DisplayShelf(data / "displays")
        self.real = Desk(SqliteSessionStore(data / "dscqs.sqlite"), shelf, displays)
        self.dry = Desk(
            MemorySessionStore(time.time), shelf, displays,
            secret=lambda: f"{self.DRY}{secrets.token_urlsafe(24)}",
        )  # fmt: skip

    def of(self, secret: str) -> Desk:
        """Return the desk that a link or a cookie belongs to."""
        return self.dry if secret.startswith(self.DRY) else self.real

    def cookie(self, link: str, browser: str) -> str:
        """Return the cookie that a link gives to a browser: always the same one."""
        digest = hashlib.sha256(f"{link}\n{browser}".encode()).digest()
        made = base64.urlsafe_b64encode(digest).decode().rstrip("=")
        return f"{self.DRY}{made}" if link.startswith(self.DRY) else made

    def dry_run(
        self, test: str, assessor: str, display: str, language: str
    ) -> tuple[SessionRecord, str]:
        """Return a session of a test, and a link into it, of which nothing is stored."""
        self.dry.store.add_test(self.real.store.test(test))
        return self.dry.invite(test, f"{assessor[:20]}-{secrets.token_hex(4)}", display, language)

    def close(self) -> None:
        """Let go of the file."""
        self.real.store.close()
