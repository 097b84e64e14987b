"""A session in memory: what its stored events have come to."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dscqs.plan import Plan
from dscqs.session import Event, Joined, Noted, Session, Shown
from dscqs.store import SessionRecord


@dataclass(kw_only=True)
class LiveSession:
    """A session in memory: what its events have come to."""

    record: SessionRecord
    plan: Plan
    state: Session
    files: Mapping[str, Mapping[str, Any]]
    lock: threading.RLock = field(default_factory=threading.RLock)
    sides: dict[str, bytes] = field(default_factory=dict)
    """Bytes that wait to be fetched, by token; of the newest ticket only."""
    has_joined: bool = False
    last: float | None = None
    """When something happened last."""
    notes: list[dict[str, Any]] = field(default_factory=list)
    """The latest notes of the page, for the operator."""

    def learn(self, event: Event, at: float) -> None:
        """Keep what progress shows of an event that was stored."""
        self.last = at
        if isinstance(event, Joined):
            self.has_joined = True
        elif isinstance(event, Noted):
            self._note({"at": at, "kind": event.kind, "reason": _note_of(event.detail)})
        elif isinstance(event, Shown) and event.outcome == "failed":
            self._note({"at": at, "kind": "failed", "reason": reason_of(event.log)})

    def _note(self, note: dict[str, Any]) -> None:
        self.notes = [*self.notes, note][-5:]


def reason_of(log: Mapping[str, Any]) -> str:
    """Return why a presentation failed, as its page said it."""
    faults = log.get("faults")
    said = [
        f"{fault.get('kind', '')}: {fault.get('detail', '')}"[:120]
        for fault in (faults if isinstance(faults, list) else [])
        if isinstance(fault, Mapping)
    ]
    return "; ".join(said[:3])


def _note_of(detail: Mapping[str, Any]) -> str:
    """Return what a note of the page says: codes of what is wrong with the display, or a text."""
    codes = detail.get("codes")
    said = codes if isinstance(codes, list) else [detail.get("message", "")]
    return ", ".join(str(one) for one in said)[:200]
