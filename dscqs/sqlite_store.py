"""Tests and sessions in one SQLite file that only grows.

One connection of one process writes and reads it, behind a lock; whoever opens it keeps other
processes out (the service locks its data folder). That is what makes WAL safe with every SQLite:
before 3.51.3 two connections that write and checkpoint at the same time could corrupt the file.
Memory mapping stays off. Commits are synchronous (``synchronous=FULL``): what a method has
returned from survives the loss of power. Deleted content is overwritten, in the file and in its
log, so that erased answers are gone.
"""

from __future__ import annotations

import json
import sqlite3
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dscqs.errors import DscqsError, NotFound, OrderError, UsedUp
from dscqs.store import SessionRecord, StoredEvent, TestRecord

MIGRATIONS = (
    """
    CREATE TABLE test (
        id TEXT PRIMARY KEY,
        name TEXT NOT NULL,
        plan TEXT NOT NULL,
        files TEXT NOT NULL,
        created REAL NOT NULL
    );
    CREATE TABLE session (
        id TEXT PRIMARY KEY,
        test TEXT NOT NULL REFERENCES test (id),
        number INTEGER NOT NULL,
        assessor TEXT NOT NULL,
        display TEXT NOT NULL,
        language TEXT NOT NULL,
        presentations TEXT NOT NULL,
        order_version INTEGER NOT NULL,
        created REAL NOT NULL,
        profile TEXT NOT NULL,
        role TEXT NOT NULL,
        "group" TEXT,
        UNIQUE (test, assessor, display)
    );
    CREATE TABLE event (
        session TEXT NOT NULL REFERENCES session (id),
        sequence INTEGER NOT NULL,
        at REAL NOT NULL,
        name TEXT NOT NULL,
        data TEXT NOT NULL,
        PRIMARY KEY (session, sequence)
    ) WITHOUT ROWID;
    CREATE TABLE form (
        session TEXT NOT NULL REFERENCES session (id),
        stage TEXT NOT NULL,
        answers TEXT NOT NULL,
        PRIMARY KEY (session, stage)
    );
    CREATE TABLE link (
        digest TEXT PRIMARY KEY,
        session TEXT NOT NULL REFERENCES session (id),
        used INTEGER NOT NULL
    );
    CREATE INDEX link_session ON link (session);
    CREATE TABLE cookie (
        session TEXT PRIMARY KEY REFERENCES session (id),
        digest TEXT NOT NULL UNIQUE
    );
    """
    + "".join(
        f"CREATE TRIGGER {table}_{verb} BEFORE {verb} ON {table}"
        f" BEGIN SELECT raise(ABORT, 'the table {table} only grows'); END;\n"
        for table in ("test", "session", "event")
        for verb in ("UPDATE", "DELETE")
    ),
)
"""One script for each step of ``PRAGMA user_version``."""


@dataclass(kw_only=True)
class _Waiting:
    """Events that wait for the next commit."""

    session: str
    events: list[tuple[str, str]]
    form: tuple[str, str] | None
    is_done: bool = False
    error: Exception | None = None


class SqliteSessionStore:
    """The store of a file.

    Parameters
    ----------
    path : Path
        Made if it is not there.
    clock : callable
        Seconds since the epoch.

    Raises
    ------
    DscqsError
        If a newer depthsr has written it.
    """

    def __init__(self, path: Path, *, clock: Callable[[], float] = time.time) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self._path = path
        self._clock = clock
        self._lock = threading.RLock()
        self._waiting: list[_Waiting] = []
        self._waiting_lock = threading.Lock()
        self._db = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
        try:
            self._db.row_factory = sqlite3.Row
            for pragma in (
                "journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=5000",
                "mmap_size=0", "secure_delete=ON",
            ):  # fmt: skip
                self._db.execute(f"PRAGMA {pragma}").fetchall()
            self._migrate()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Let go of the file."""
        with self._lock:
            self._db.close()

    def add_test(self, record: TestRecord) -> None:
        """Add a test."""
        with self._transaction() as db:
            db.execute(
                "INSERT INTO test VALUES (?, ?, ?, ?, ?)",
                (
                    record.id, record.name, json.dumps(record.plan), json.dumps(record.files),
                    record.created,
                ),
            )  # fmt: skip

    def test(self, test: str) -> TestRecord:
        """Return a test, or raise :class:`NotFound`."""
        rows = self._rows("SELECT * FROM test WHERE id = ?", test)
        if not rows:
            raise NotFound(f"there is no test {test!r}")
        return _test(rows[0])

    def tests(self) -> list[TestRecord]:
        """Return all tests, oldest first."""
        return [_test(row) for row in self._rows("SELECT * FROM test ORDER BY created, rowid")]

    def add_session(self, record: SessionRecord) -> None:
        """Add a session; raise :class:`OrderError` if assessor and display have one already."""
        self.test(record.test)
        try:
            with self._transaction() as db:
                db.execute(
                    "INSERT INTO session VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                    (
                        record.id, record.test, record.number, record.assessor, record.display,
                        record.language, json.dumps(record.order), record.order_version,
                        record.created, json.dumps(record.profile), record.role, record.group,
                    ),
                )  # fmt: skip
        except sqlite3.IntegrityError:
            raise OrderError(
                f"{record.assessor} has a session on {record.display} already"
            ) from None

    def session(self, session: str) -> SessionRecord:
        """Return a session, or raise :class:`NotFound`."""
        rows = self._rows("SELECT * FROM session WHERE id = ?", session)
        if not rows:
            raise NotFound(f"there is no session {session!r}")
        return _session(rows[0])

    def sessions(self, test: str) -> list[SessionRecord]:
        """Return the sessions of a test, oldest first."""
        query = "SELECT * FROM session WHERE test = ? ORDER BY created, rowid"
        return [_session(row) for row in self._rows(query, test)]

    def append(
        self,
        session: str,
        events: Iterable[tuple[str, Mapping[str, Any]]],
        *,
        form: tuple[str, Mapping[str, Any]] | None = None,
    ) -> None:
        """Add events to a session, and the answers of a form (stage, answers), all or nothing.

        What waits while another commit is on its way to the disk goes there together with the
        next: the disk is asked once for all of it.
        """
        mine = _Waiting(
            session=session,
            events=[(name, json.dumps(data)) for name, data in events],
            form=None if form is None else (form[0], json.dumps(form[1])),
        )
        with self._waiting_lock:
            self._waiting.append(mine)
        with self._lock:
            if not mine.is_done:
                self._append_waiting()
        if mine.error is not None:
            raise mine.error

    def _append_waiting(self) -> None:
        with self._waiting_lock:
            batch, self._waiting = self._waiting, []
        try:
            with self._transaction() as db:
                for one in batch:
                    self._append_one(db, one)
        except Exception as error:
            for one in batch:
                one.error = one.error or error
        finally:
            for one in batch:
                one.is_done = True

    def _append_one(self, db: sqlite3.Connection, one: _Waiting) -> None:
        db.execute("SAVEPOINT one")
        try:
            for name, data in one.events:
                db.execute(
                    "INSERT INTO event SELECT ?1, ifnull(max(sequence), 0) + 1, ?2, ?3, ?4"
                    " FROM event WHERE session = ?1",
                    (one.session, self._clock(), name, data),
                )
            if one.form is not None:
                db.execute("INSERT OR REPLACE INTO form VALUES (?, ?, ?)", (one.session, *one.form))
        except sqlite3.IntegrityError as error:  # that of one, not of the others
            db.execute("ROLLBACK TO one")
            one.error = error
        db.execute("RELEASE one")

    def events(self, session: str) -> list[StoredEvent]:
        """Return everything that happened in a session, in order."""
        rows = self._rows("SELECT * FROM event WHERE session = ? ORDER BY sequence", session)
        return [
            StoredEvent(
                sequence=row["sequence"], at=row["at"], name=row["name"],
                data=json.loads(row["data"]),
            )
            for row in rows
        ]  # fmt: skip

    def forms(self, session: str) -> dict[str, Mapping[str, Any]]:
        """Return the answers of the forms of a session, by stage."""
        rows = self._rows(
            "SELECT stage, answers FROM form WHERE session = ? ORDER BY rowid", session
        )
        return {row["stage"]: json.loads(row["answers"]) for row in rows}

    def erase(self, session: str) -> None:
        """Remove the answers of the forms of a session for good, from the log of the file too."""
        with self._lock:
            with self._transaction() as db:
                db.execute("DELETE FROM form WHERE session = ?", (session,))
            self._db.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()

    def add_link(self, digest: str, session: str) -> None:
        """Add a link to a session, known by the hash of its secret; earlier unused ones end."""
        with self._transaction() as db:
            db.execute("UPDATE link SET used = 1 WHERE session = ?", (session,))
            db.execute("INSERT INTO link VALUES (?, ?, 0)", (digest, session))

    def use_link(self, digest: str, cookie_digest: str) -> str:
        """Use a link up, let in who shows the cookie and nobody else; return the session."""
        with self._transaction() as db:
            row = db.execute("SELECT * FROM link WHERE digest = ?", (digest,)).fetchone()
            if row is None:
                raise NotFound("there is no such link")
            again = db.execute(
                "SELECT 1 FROM cookie WHERE session = ? AND digest = ?",
                (row["session"], cookie_digest),
            ).fetchone()
            if row["used"] and again is None:
                raise UsedUp("the link was used before; ask the operator for a new one")
            db.execute("UPDATE link SET used = 1 WHERE digest = ?", (digest,))
            db.execute(
                "INSERT OR REPLACE INTO cookie VALUES (?, ?)", (row["session"], cookie_digest)
            )
            return str(row["session"])

    def session_of(self, cookie_digest: str) -> str | None:
        """Return the session that a cookie belongs to."""
        rows = self._rows("SELECT session FROM cookie WHERE digest = ?", cookie_digest)
        return str(rows[0]["session"]) if rows else None

    # Inside

    def _rows(self, query: str, *values: Any) -> list[sqlite3.Row]:
        with self._lock:
            return self._db.execute(query, values).fetchall()

    @contextmanager
    def _transaction(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:  # a full disk rolls back by itself
                    self._db.execute("ROLLBACK")
                raise

    def _migrate(self) -> None:
        version = self._db.execute("PRAGMA user_version").fetchone()[0]
        if version > len(MIGRATIONS):
            raise DscqsError(
                f"{self._path}: was written by a newer depthsr (schema {version}, "
                f"known: {len(MIGRATIONS)}); install that one"
            )
        for number, script in enumerate(MIGRATIONS[version:], start=version + 1):
            self._db.executescript(f"BEGIN;{script};PRAGMA user_version={number};COMMIT;")


def _test(row: sqlite3.Row) -> TestRecord:
    values = dict(row)
    return TestRecord(
        **{**values, "plan": json.loads(values["plan"]), "files": json.loads(values["files"])}
    )


def _session(row: sqlite3.Row) -> SessionRecord:
    values = dict(row)
    order = tuple(json.loads(values.pop("presentations")))
    profile = json.loads(values.pop("profile"))
    return SessionRecord(**values, order=order, profile=profile)
