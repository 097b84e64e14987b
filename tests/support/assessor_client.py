"""An assessor without a browser."""

from __future__ import annotations

import uuid
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import httpx

from service.dscqs_client import API, ask, entry


@dataclass(kw_only=True)
class AssessorClient:
    """What the page of an assessor does, request by request."""

    http: httpx.Client
    presentation: dict[str, Any] = field(default_factory=dict)
    """The newest that was given out."""
    browser: str = field(default_factory=lambda: uuid.uuid4().hex)
    """A link that was opened works for this one only."""

    def enter(self, link: str) -> None:
        """Open a link, and keep its cookie."""
        ask(self.http, "POST", f"{API}/assessor/enter", entry(link, self.browser))

    def state(self) -> dict[str, Any]:
        """Return where the session stands."""
        return dict(ask(self.http, "GET", f"{API}/assessor/state").json())

    def leave(self, stage: str, answers: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Leave a stage: with answers a form, without one that asks for nothing."""
        if answers is None:
            return dict(ask(self.http, "POST", f"{API}/assessor/continue", {"stage": stage}).json())
        asked = {"stage": stage, "answers": dict(answers)}
        return dict(ask(self.http, "POST", f"{API}/assessor/forms", asked).json())

    def present(self) -> dict[str, Any]:
        """Ask for the presentation to show."""
        self.presentation = ask(self.http, "GET", f"{API}/assessor/presentation").json()
        return self.presentation

    def fetch(self, side: str) -> bytes:
        """Return the bytes of a side of it."""
        return ask(self.http, "GET", self.presentation["sides"][side]).content

    def shown(self, outcome: str = "ok", log: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Tell how the presentation went."""
        asked = {"ticket": self.presentation["ticket"], "outcome": outcome, "log": dict(log or {})}
        return dict(ask(self.http, "POST", f"{API}/assessor/shown", asked).json())

    def grade(self, grades: Mapping[str, Any], submission: str | None = None) -> dict[str, Any]:
        """Vote."""
        asked = {
            "ticket": self.presentation["ticket"],
            "submission": submission or uuid.uuid4().hex,
            "grades": dict(grades),
        }
        return dict(ask(self.http, "POST", f"{API}/assessor/grades", asked).json())
