"""Jobs, their events, uploads and idempotency keys in one SQLite file.

One connection of one process writes and reads it, behind a lock; a file lock on the data
folder keeps a second service out. That is what makes WAL safe with every SQLite: before
3.51.3 two connections that write and checkpoint at the same time could corrupt the file.
Memory mapping stays off; commits are synchronous, so that what was answered is kept.
"""

from __future__ import annotations

import json
import sqlite3
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO, Any

from pipeline.errors import ConfigurationError
from service.jobs.states import Action, State, after

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

MIGRATIONS = (
    """
    CREATE TABLE job (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        client TEXT NOT NULL,
        priority INTEGER NOT NULL,
        state TEXT NOT NULL,
        request TEXT NOT NULL,
        attempt INTEGER NOT NULL DEFAULT 0,
        created REAL NOT NULL,
        started REAL,
        finished REAL,
        lease_until REAL,
        frames_done INTEGER NOT NULL DEFAULT 0,
        frames_total INTEGER,
        problem TEXT,
        version INTEGER NOT NULL DEFAULT 1
    );
    CREATE INDEX job_state ON job (state, priority, number);
    CREATE TABLE event (
        job TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
        sequence INTEGER NOT NULL,
        at REAL NOT NULL,
        kind TEXT NOT NULL,
        data TEXT NOT NULL,
        PRIMARY KEY (job, sequence)
    ) WITHOUT ROWID;
    CREATE TABLE idempotency (
        client TEXT NOT NULL,
        key TEXT NOT NULL,
        hash TEXT NOT NULL,
        job TEXT NOT NULL REFERENCES job (id) ON DELETE CASCADE,
        PRIMARY KEY (client, key)
    ) WITHOUT ROWID;
    """,
    """
    CREATE TABLE upload (
        id TEXT PRIMARY KEY,
        client TEXT NOT NULL,
        name TEXT NOT NULL,
        length INTEGER NOT NULL,
        created REAL NOT NULL
    ) WITHOUT ROWID;
    """,
    "ALTER TABLE job ADD COLUMN crashes INTEGER NOT NULL DEFAULT 0;",
    """
    ALTER TABLE job ADD COLUMN parent TEXT REFERENCES job (id) ON DELETE SET NULL;
    CREATE INDEX job_parent ON job (parent);
    """,
    "CREATE INDEX job_client ON job (client, started);",
    "ALTER TABLE upload ADD COLUMN metadata TEXT NOT NULL DEFAULT '';",
    "ALTER TABLE job ADD COLUMN compiling INTEGER NOT NULL DEFAULT 0;",
)
"""One script for each step of ``PRAGMA user_version``."""


@dataclass(frozen=True, kw_only=True)
class JobRecord:
    """One row of the table of jobs."""

    number: int
    id: str
    client: str
    priority: int
    state: State
    request: Mapping[str, Any]
    attempt: int
    created: float
    """Seconds since the epoch, as all times here."""
    started: float | None
    finished: float | None
    lease_until: float | None
    frames_done: int
    frames_total: int | None
    problem: Mapping[str, Any] | None
    version: int
    """Grows with every change."""
    crashes: int
    """Workers that died or hung over it since it was last asked for."""
    parent: str | None
    """Of an export: the id of the job whose result it is a form of."""
    compiling: bool
    """Whether its first frame waits for kernels that are compiled."""


@dataclass(frozen=True, kw_only=True)
class EventRecord:
    """Something that happened in a job."""

    job: str
    sequence: int
    """From 1, without gaps."""
    at: float
    kind: str
    data: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True)
class UploadRecord:
    """A file that is on its way."""

    id: str
    client: str
    name: str
    length: int
    created: float
    metadata: str
    """As its client gave it."""


class KeyReusedError(Exception):
    """The idempotency key was used for another request."""


class Store:
    """The database of a data folder.

    Parameters
    ----------
    folder : Path
        Made if it is not there.
    on_change : callable
        Told the id of a job after anything about it has changed, in the changing thread.
    clock : callable
        Seconds since the epoch.

    Raises
    ------
    ConfigurationError
        If another service works on the folder, or a newer one has.
    """

    def __init__(
        self,
        folder: Path,
        *,
        on_change: Callable[[str], None] = lambda _: None,
        clock: Callable[[], float] = time.time,
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        self.folder = folder
        self.on_change = on_change
        self._clock = clock
        self._lock = threading.RLock()
        self._guard: IO[str] | None = _locked(folder / "service.lock")
        self._db = sqlite3.connect(
            folder / "service.sqlite", check_same_thread=False, isolation_level=None
        )
        try:
            self._db.row_factory = sqlite3.Row
            for pragma in (
                "journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON", "busy_timeout=5000",
                "mmap_size=0",
            ):  # fmt: skip
                self._db.execute(f"PRAGMA {pragma}").fetchall()
            self._migrate()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the file and let another service in."""
        with self._lock:
            self._db.close()
            if self._guard is not None:
                self._guard.close()
                self._guard = None

    def check(self) -> None:
        """Raise sqlite3.Error where the database cannot be written."""
        with self._transaction() as db:
            db.execute("UPDATE job SET version = version WHERE number < 0")

    # Jobs

    def create_job(
        self,
        *,
        job_id: str,
        client: str,
        request: Mapping[str, Any],
        priority: int = 0,
        key: str | None = None,
        request_hash: str = "",
        parent: str | None = None,
    ) -> tuple[JobRecord, bool]:
        """Insert a job and its idempotency key; return it, and whether it is new.

        Raises
        ------
        KeyReusedError
            If the key stands for another request.
        """
        with self._transaction() as db:
            if key is not None:
                found = self._keyed(client, key, request_hash)
                if found is not None:
                    return found, False
            db.execute(
                "INSERT INTO job (id, client, priority, state, request, created, parent)"
                " VALUES (?, ?, ?, ?, ?, ?, ?)",
                (
                    job_id,
                    client,
                    priority,
                    State.QUEUED,
                    json.dumps(request),
                    self._clock(),
                    parent,
                ),
            )
            if key is not None:
                db.execute(
                    "INSERT INTO idempotency VALUES (?, ?, ?, ?)",
                    (client, key, request_hash, job_id),
                )
            self._add_event(job_id, "queued", {})
        self.on_change(job_id)
        return self._must(job_id), True

    def keyed(self, client: str, key: str, request_hash: str) -> JobRecord | None:
        """Return the job that this idempotency key made, if any."""
        with self._lock:
            return self._keyed(client, key, request_hash)

    def job(self, job_id: str) -> JobRecord | None:
        """Return a job; None where there is none."""
        with self._lock:
            row = self._db.execute("SELECT * FROM job WHERE id = ?", (job_id,)).fetchone()
        return None if row is None else _job(row)

    def jobs(
        self,
        *,
        client: str | None = None,
        states: tuple[State, ...] = (),
        before: int | None = None,
        parent: str | None = None,
        limit: int = 50,
    ) -> list[JobRecord]:
        """Return jobs, newest first; ``before`` is the number to go on from."""
        terms, values = ["1"], []
        if client is not None:
            terms.append("client = ?")
            values.append(client)
        if states:
            terms.append(f"state IN ({', '.join('?' * len(states))})")
            values += states
        if parent is not None:
            terms.append("parent = ?")
            values.append(parent)
        if before is not None:
            terms.append("number < ?")
            values.append(before)  # type: ignore[arg-type]
        query = f"SELECT * FROM job WHERE {' AND '.join(terms)} ORDER BY number DESC LIMIT ?"
        with self._lock:
            return [_job(row) for row in self._db.execute(query, (*values, limit))]

    def counts(self, client: str | None = None) -> dict[State, int]:
        """Return the number of jobs in each state."""
        with self._lock:
            rows = self._db.execute(
                "SELECT state, count(*) FROM job WHERE ?1 IS NULL OR client = ?1 GROUP BY state",
                (client,),
            ).fetchall()
        return {state: 0 for state in State} | {State(state): count for state, count in rows}

    def take(self, lease: float) -> JobRecord | None:
        """Start the job whose turn it is: priority, then the client served least, then age."""
        now = self._clock()
        with self._transaction() as db:
            row = db.execute(
                """
                WITH waiting AS (SELECT DISTINCT client FROM job WHERE state = 'queued'),
                turn AS MATERIALIZED (
                    SELECT client,
                        (SELECT count(*) FROM job WHERE +client = waiting.client
                            AND state IN ('running', 'cancelling')) AS busy,
                        (SELECT ifnull(max(started), 0) FROM job
                            WHERE client = waiting.client) AS last
                    FROM waiting
                )
                SELECT id, state FROM job JOIN turn USING (client) WHERE state = 'queued'
                ORDER BY priority DESC, busy, last, number
                LIMIT 1
                """
            ).fetchone()
            if row is None:
                return None
            db.execute(
                "UPDATE job SET state = ?, attempt = attempt + 1, started = ?, finished = NULL,"
                " lease_until = ?, problem = NULL, compiling = 0, version = version + 1"
                " WHERE id = ?",
                (after(State(row["state"]), Action.START), now, now + lease, row["id"]),
            )
            record = self._must(row["id"])
            self._add_event(record.id, "running", {"attempt": record.attempt})
        self.on_change(record.id)
        return record

    def renew(self, job_id: str, attempt: int, lease: float) -> None:
        """Note that the worker of that attempt lives."""
        with self._transaction() as db:
            db.execute(
                "UPDATE job SET lease_until = ? WHERE id = ? AND attempt = ?"
                " AND state IN ('running', 'cancelling')",
                (self._clock() + lease, job_id, attempt),
            )

    def act(
        self,
        job_id: str,
        action: Action,
        *,
        attempt: int | None = None,
        crashed: bool = False,
        problem: Mapping[str, Any] | None = None,
        data: Mapping[str, Any] | None = None,
    ) -> JobRecord:
        """Move a job to the state that the action leads to.

        Raises
        ------
        KeyError
            If there is no such job, or its attempt is another one.
        TransitionError
            If its state does not allow that.
        """
        with self._transaction() as db:
            record = self._must(job_id)
            if attempt is not None and record.attempt != attempt:
                raise KeyError(job_id)
            state = after(record.state, action)
            if state == record.state:
                return record
            db.execute(
                "UPDATE job SET state = ?, problem = ?, version = version + 1, lease_until = NULL,"
                " finished = ?, crashes = ? WHERE id = ?",
                (
                    state,
                    None if problem is None else json.dumps(problem),
                    self._clock() if state.is_final else None,
                    0 if action is Action.RETRY else record.crashes + crashed,
                    job_id,
                ),
            )
            extra = {} if problem is None else {"problem": problem}
            self._add_event(job_id, state.value, {**(data or {}), **extra})
            record = self._must(job_id)
        self.on_change(job_id)
        return record

    def delete_job(self, job_id: str) -> None:
        """Forget a job, its events and its key."""
        with self._transaction() as db:
            db.execute("DELETE FROM job WHERE id = ?", (job_id,))
        self.on_change(job_id)

    def expired(self) -> list[JobRecord]:
        """Return the jobs whose worker has been silent for longer than its lease."""
        with self._lock:
            rows = self._db.execute(
                "SELECT * FROM job WHERE state IN ('running', 'cancelling') AND lease_until < ?",
                (self._clock(),),
            ).fetchall()
        return [_job(row) for row in rows]

    # Events

    def report(self, job_id: str, kind: str, data: Mapping[str, Any]) -> None:
        """Add what a worker said to the events of a job; count its frames."""
        with self._transaction() as db:
            if self.job(job_id) is None:
                return
            if kind == "JobStarted":
                done, total = data["frames_done"], data["frames_total"]
            elif kind == "FrameFinished":
                done, total = data["done"], data["total"]
            else:
                done = total = None
            if total is not None:
                db.execute(
                    "UPDATE job SET frames_done = ?, frames_total = ?, compiling = 0,"
                    " version = version + 1 WHERE id = ?",
                    (done, total, job_id),
                )
            elif kind == "Compiling":
                db.execute(
                    "UPDATE job SET compiling = 1, version = version + 1 WHERE id = ?", (job_id,)
                )
            self._add_event(job_id, kind, data)
        self.on_change(job_id)

    def events(self, job_id: str, *, after: int = 0, limit: int = 1000) -> list[EventRecord]:
        """Return the events of a job with numbers above ``after``."""
        with self._lock:
            rows = self._db.execute(
                "SELECT * FROM event WHERE job = ? AND sequence > ? ORDER BY sequence LIMIT ?",
                (job_id, after, limit),
            ).fetchall()
        return [EventRecord(**{**dict(row), "data": json.loads(row["data"])}) for row in rows]

    # Uploads

    def create_upload(
        self, client: str, name: str, length: int, metadata: str = ""
    ) -> UploadRecord:
        """Insert an upload."""
        record = UploadRecord(
            id=uuid.uuid4().hex, client=client, name=name, length=length, created=self._clock(),
            metadata=metadata,
        )  # fmt: skip
        with self._transaction() as db:
            db.execute(
                "INSERT INTO upload VALUES (:id, :client, :name, :length, :created, :metadata)",
                asdict(record),
            )
        return record

    def upload(self, upload_id: str) -> UploadRecord | None:
        """Return an upload; None where there is none."""
        with self._lock:
            row = self._db.execute("SELECT * FROM upload WHERE id = ?", (upload_id,)).fetchone()
        return None if row is None else UploadRecord(**dict(row))

    def delete_upload(self, upload_id: str) -> None:
        """Forget an upload."""
        with self._transaction() as db:
            db.execute("DELETE FROM upload WHERE id = ?", (upload_id,))

    def owned(self, client: str) -> list[str]:
        """Return the ids of all jobs and uploads of a client."""
        query = (
            "SELECT id FROM job WHERE client = ?1 UNION ALL SELECT id FROM upload WHERE client = ?1"
        )
        with self._lock:
            return [row[0] for row in self._db.execute(query, (client,))]

    # Inside

    def _must(self, job_id: str) -> JobRecord:
        record = self.job(job_id)
        if record is None:
            raise KeyError(job_id)
        return record

    def _keyed(self, client: str, key: str, request_hash: str) -> JobRecord | None:
        row = self._db.execute(
            "SELECT hash, job FROM idempotency WHERE client = ? AND key = ?", (client, key)
        ).fetchone()
        if row is None:
            return None
        if row["hash"] != request_hash:
            raise KeyReusedError(key)
        return self._must(row["job"])

    def _add_event(self, job_id: str, kind: str, data: Mapping[str, Any]) -> None:
        self._db.execute(
            "INSERT INTO event SELECT ?1, ifnull(max(sequence), 0) + 1, ?2, ?3, ?4 FROM event"
            " WHERE job = ?1",
            (job_id, self._clock(), kind, json.dumps(data)),
        )

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
            raise ConfigurationError(
                f"{self.folder}: was written by a newer depthsr (schema {version}, "
                f"known: {len(MIGRATIONS)}); install that one"
            )
        for number, script in enumerate(MIGRATIONS[version:], start=version + 1):
            self._db.executescript(f"BEGIN;{script};PRAGMA user_version={number};COMMIT;")


def _job(row: sqlite3.Row) -> JobRecord:
    values = dict(row)
    values["state"] = State(values["state"])
    values["compiling"] = bool(values["compiling"])
    values["request"] = json.loads(values["request"])
    values["problem"] = None if values["problem"] is None else json.loads(values["problem"])
    return JobRecord(**values)


def _locked(path: Path) -> IO[str]:
    file = path.open("w", encoding="utf-8")
    if fcntl is not None:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.close()
            raise ConfigurationError(
                f"{path.parent}: another service works on this data folder"
            ) from None
    return file
