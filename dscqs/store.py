"""What a store of sessions can do, and the twin of it in memory.

A store only grows: tests, sessions and events are added, never changed. Two things can go: the
answers of forms (personal data, :meth:`SessionStore.erase`), and secrets that were replaced.
Whatever a method has returned from is durable, as far as the store is.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from dscqs.errors import NotFound, OrderError, UsedUp


@dataclass(frozen=True, kw_only=True)
class TestRecord:
    """A test: its plan, and its files as they are served."""

    __test__ = False  # not one of pytest's

    id: str
    name: str
    plan: Mapping[str, Any]
    files: Mapping[str, Mapping[str, Any]]
    created: float
    """Seconds since the epoch, as all times here."""


@dataclass(frozen=True, kw_only=True)
class SessionRecord:
    """Who judges what on which display, in which order."""

    id: str
    test: str
    number: int
    """Of the assessor within test and display, from 0: the order follows from it."""
    assessor: str
    display: str
    language: str
    order: tuple[Mapping[str, Any], ...]
    """The presentations, as they were drawn; stored before the first is shown."""
    order_version: int
    created: float
    profile: Mapping[str, Any] = field(default_factory=dict)
    """Of the display, as it was calibrated when the session was made."""
    role: str = "station"
    """``station``, or in a group ``screen`` or ``phone``."""
    group: str | None = None


@dataclass(frozen=True, kw_only=True)
class StoredEvent:
    """Something that happened in a session."""

    sequence: int
    """From 1, without gaps."""
    at: float
    name: str
    data: Mapping[str, Any]


class SessionStore(Protocol):
    """Keeps tests, sessions, their events, forms and secrets."""

    def add_test(self, record: TestRecord) -> None:
        """Add a test."""

    def test(self, test: str) -> TestRecord:
        """Return a test, or raise :class:`NotFound`."""

    def tests(self) -> list[TestRecord]:
        """Return all tests, oldest first."""

    def add_session(self, record: SessionRecord) -> None:
        """Add a session; raise :class:`OrderError` if assessor and display have one already."""

    def session(self, session: str) -> SessionRecord:
        """Return a session, or raise :class:`NotFound`."""

    def sessions(self, test: str) -> list[SessionRecord]:
        """Return the sessions of a test, oldest first."""

    def append(
        self,
        session: str,
        events: Iterable[tuple[str, Mapping[str, Any]]],
        *,
        form: tuple[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Add events to a session, and the answers of a form (stage, answers), all or nothing."""

    def events(self, session: str) -> list[StoredEvent]:
        """Return everything that happened in a session, in order."""

    def forms(self, session: str) -> dict[str, Mapping[str, Any]]:
        """Return the answers of the forms of a session, by stage."""

    def erase(self, session: str) -> None:
        """Remove the answers of the forms of a session for good."""

    def add_link(self, digest: str, session: str) -> None:
        """Add a link to a session, known by the hash of its secret; earlier unused ones end."""

    def use_link(self, digest: str, cookie_digest: str) -> str:
        """Use a link up, let in who shows the cookie and nobody else; return the session.

        A link that was used for the same cookie before lets in as the first time.

        Raises
        ------
        NotFound
            If there is no such link.
        UsedUp
            If it was used before, or replaced by a newer one.
        """

    def session_of(self, cookie_digest: str) -> str | None:
        """Return the session that a cookie belongs to."""

    def close(self) -> None:
        """Let go of the file."""


class MemorySessionStore:
    """A store that is gone with the process: dry runs, and a measure for the other in tests."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._lock = threading.RLock()
        self._tests: dict[str, TestRecord] = {}
        self._sessions: dict[str, SessionRecord] = {}
        self._events: dict[str, list[StoredEvent]] = {}
        self._forms: dict[str, dict[str, Mapping[str, Any]]] = {}
        self._links: dict[str, tuple[str, bool]] = {}
        self._cookies: dict[str, str] = {}

    def add_test(self, record: TestRecord) -> None:
        """Add a test."""
        self._tests[record.id] = record

    def test(self, test: str) -> TestRecord:
        """Return a test, or raise :class:`NotFound`."""
        if test not in self._tests:
            raise NotFound(f"there is no test {test!r}")
        return self._tests[test]

    def tests(self) -> list[TestRecord]:
        """Return all tests, oldest first."""
        return list(self._tests.values())

    def add_session(self, record: SessionRecord) -> None:
        """Add a session; raise :class:`OrderError` if assessor and display have one already."""
        with self._lock:
            self.test(record.test)
            for other in self.sessions(record.test):
                if (other.assessor, other.display) == (record.assessor, record.display):
                    raise OrderError(f"{record.assessor} has a session on {record.display} already")
            self._sessions[record.id] = record
            self._events[record.id] = []

    def session(self, session: str) -> SessionRecord:
        """Return a session, or raise :class:`NotFound`."""
        if session not in self._sessions:
            raise NotFound(f"there is no session {session!r}")
        return self._sessions[session]

    def sessions(self, test: str) -> list[SessionRecord]:
        """Return the sessions of a test, oldest first."""
        return [record for record in self._sessions.values() if record.test == test]

    def append(
        self,
        session: str,
        events: Iterable[tuple[str, Mapping[str, Any]]],
        *,
        form: tuple[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Add events to a session, and the answers of a form (stage, answers), all or nothing."""
        with self._lock:
            self.session(session)
            kept = self._events[session]
            for name, data in events:
                kept.append(
                    StoredEvent(
                        sequence=len(kept) + 1, at=self._clock(), name=name, data=dict(data)
                    )
                )
            if form is not None:
                self._forms.setdefault(session, {})[form[0]] = dict(form[1])

    def events(self, session: str) -> list[StoredEvent]:
        """Return everything that happened in a session, in order."""
        self.session(session)
        return list(self._events[session])

    def forms(self, session: str) -> dict[str, Mapping[str, Any]]:
        """Return the answers of the forms of a session, by stage."""
        return dict(self._forms.get(session, {}))

    def erase(self, session: str) -> None:
        """Remove the answers of the forms of a session for good."""
        self._forms.pop(session, None)

    def add_link(self, digest: str, session: str) -> None:
        """Add a link to a session, known by the hash of its secret; earlier unused ones end."""
        with self._lock:
            self.session(session)
            for other, (owner, _) in self._links.items():
                if owner == session:
                    self._links[other] = (owner, True)
            self._links[digest] = (session, False)

    def use_link(self, digest: str, cookie_digest: str) -> str:
        """Use a link up, let in who shows the cookie and nobody else; return the session."""
        with self._lock:
            if digest not in self._links:
                raise NotFound("there is no such link")
            session, used = self._links[digest]
            if used and self._cookies.get(cookie_digest) != session:
                raise UsedUp("the link was used before; ask the operator for a new one")
            self._links[digest] = (session, True)
            self._cookies = {
                cookie: owner for cookie, owner in self._cookies.items() if owner != session
            }
            self._cookies[cookie_digest] = session
            return session

    def session_of(self, cookie_digest: str) -> str | None:
        """Return the session that a cookie belongs to."""
        return self._cookies.get(cookie_digest)

    def close(self) -> None:
        """Let go of nothing."""
