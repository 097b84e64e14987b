"""Gives jobs to worker processes, watches over them, and finds what a crash left behind."""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.machine import available_memory
from service.child import environment
from service.config import MIB, ServiceConfig
from service.jobs.states import Action, State, TransitionError
from service.problem_table import problem
from service.store import JobRecord, Store
from service.worker_process import LOG, WorkOrder

log = logging.getLogger(__name__)

TICK = 1.0
"""Seconds between two looks at the leases."""

LOG_LIMIT = 1 << 20
"""A worker's log is begun anew beyond this, bytes."""

MAX_JOBS = 100
"""Jobs that one process does, one after the other and all of one client."""

REST = 5.0
"""Time that a process waits for another job of its client, seconds."""


class Scheduler:
    """Runs as many workers as the settings allow, until it is closed.

    Parameters
    ----------
    store : Store
        The truth about jobs; only this process writes it.
    config : ServiceConfig
        Limits of workers.
    on_event : callable
        Told (kind, data) of everything that workers say; for metrics.
    on_piece : callable
        Told (job id, data) of every piece that can be watched.
    on_end : callable
        Told the id of a job whose worker has ended.
    """

    def __init__(
        self,
        store: Store,
        config: ServiceConfig,
        *,
        on_event: Callable[[str, dict[str, Any]], None] = lambda kind, data: None,
        on_piece: Callable[[str, dict[str, Any]], None] = lambda job, data: None,
        on_end: Callable[[str], None] = lambda job: None,
    ) -> None:
        self.store = store
        self.config = config
        self._on_event = on_event
        self._on_piece = on_piece
        self._on_end = on_end
        self._wake = threading.Event()
        self._closing = False
        self._lock = threading.Lock()
        self._workers: dict[str, _Worker] = {}
        self._resting: list[_Process] = []
        self._thread = threading.Thread(target=self._run, name="depthsr-scheduler", daemon=True)

    def start(self) -> None:
        """Put back what an earlier service left running, and begin."""
        sweep(self.store)
        self._thread.start()

    def close(self) -> None:
        """End the workers; their finished segments stay. Takes at most the grace time."""
        self._closing = True
        self._wake.set()
        if self._thread.ident is not None:
            self._thread.join()
        with self._lock:
            workers = list(self._workers.values())
        for worker in workers:
            worker.stop()
        deadline = time.monotonic() + self.config.grace
        for worker in workers:
            worker.join(max(0.0, deadline - time.monotonic()))
        for worker in workers:
            worker.kill()
            worker.join(5)
        self._dismiss()

    def poke(self) -> None:
        """Look for work at once."""
        self._wake.set()

    def cancel(self, job_id: str) -> JobRecord:
        """Cancel a job, running or not."""
        with self._lock:  # what has been taken has its worker
            record = self.store.act(job_id, Action.CANCEL)
            worker = self._workers.get(job_id)
        if worker is not None:
            worker.cancel()
        elif record.state is State.CANCELLING:
            record = self.store.act(job_id, Action.STOPPED)
        return record

    @property
    def busy(self) -> int:
        """Workers at work."""
        with self._lock:
            return len(self._workers)

    @property
    def is_alive(self) -> bool:
        """True while jobs are being given out."""
        return self._thread.is_alive()

    @property
    def pids(self) -> dict[str, int]:
        """Process ids of the workers, by job."""
        with self._lock:
            return {job: worker.pid for job, worker in self._workers.items()}

    def _run(self) -> None:
        while not self._closing:
            self._wake.clear()
            try:
                self._fill()
                self._watch()
            except Exception:  # a full disk, say: the next tick tries again
                log.warning("scheduler: trying again", exc_info=True)
            self._wake.wait(TICK)

    def _fill(self) -> None:
        while self.busy < self.config.workers and self._has_room and not self._closing:
            with self._lock:
                record = self.store.take(self.config.lease)
                if record is None:
                    break
                worker = _Worker(self, record, self._rested(record.client))
                self._workers[record.id] = worker
            worker.start()
        self._dismiss(time.monotonic() - REST)

    @property
    def _has_room(self) -> bool:
        """False while the disk has no room, or memory none for one more worker beside others."""
        if shutil.disk_usage(self.store.folder).free < self.config.disk_reserve * MIB:
            return False
        return not self.busy or available_memory() >= self.config.memory_reserve * MIB

    def _rested(self, client: str) -> _Process | None:
        """Take a process that has done a job of the same client, and is good for another one.

        Where there is none, one of another client makes room: there are never more processes
        than workers.
        """
        for process in self._resting:
            if process.client == client and process.is_alive:
                self._resting.remove(process)
                return process
        if self._resting and len(self._workers) + len(self._resting) >= self.config.workers:
            self._resting.pop(0).end()
        return None

    def _dismiss(self, before: float = math.inf) -> None:
        """End the processes that have rested since before a time, and whatever has died."""
        with self._lock:
            ended = [
                process for process in self._resting
                if process.rests_since < before or not process.is_alive
            ]  # fmt: skip
            self._resting = [process for process in self._resting if process not in ended]
        for process in ended:
            process.end()

    def _watch(self) -> None:
        silent = {record.id for record in self.store.expired()}
        with self._lock:
            workers = dict(self._workers)
        if shutil.disk_usage(self.store.folder).free < self.config.disk_reserve * MIB // 2:
            for worker in workers.values():  # while the database can still be written
                worker.fail(problem("disk-full", "the disk is full; make room, then retry"))
        for job_id, worker in workers.items():
            is_silent = worker.silent_seconds > self.config.lease
            if is_silent or worker.idle_seconds > self.config.stall:
                log.warning("worker hangs: killed", extra={"job": job_id})
                worker.kill()
        for job_id in silent - workers.keys():
            lose(self.store, job_id, self.config.max_attempts)

    def _ended(self, worker: _Worker, process: _Process | None) -> None:
        with self._lock:
            if self._workers.get(worker.record.id) is worker:  # else it was retried at once
                del self._workers[worker.record.id]
            if process is not None:
                process.rests_since = time.monotonic()
                self._resting.append(process)
        self._on_end(worker.record.id)
        self._wake.set()


class _Process:
    """A worker process, which does jobs of one client one after the other."""

    def __init__(self, client: str, log_file: Path) -> None:
        self.client = client
        self.jobs = 0
        self.rests_since = 0.0
        with log_file.open("ab") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "service.worker_process"],
                stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors,
                text=True, encoding="utf-8", env=environment(), start_new_session=True,
            )  # fmt: skip
        self.pid = self._process.pid

    @property
    def is_alive(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def tell(self, line: str) -> None:
        """Write a line to it, if it still listens."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()

    def lines(self) -> Iterator[str]:
        """Yield what it says; ends with it."""
        assert self._process.stdout is not None
        yield from iter(self._process.stdout.readline, "")

    def kill(self) -> None:
        """End it at once."""
        self._process.kill()

    def end(self) -> None:
        """End it, and see it off."""
        with contextlib.suppress(OSError), self._process:  # closes the pipes, waits
            self._process.kill()


class _Worker:
    """One job in a worker process, and the thread that listens to it."""

    def __init__(self, scheduler: Scheduler, record: JobRecord, process: _Process | None) -> None:
        self.record = record
        self._scheduler = scheduler
        self._lock = threading.Lock()
        self._process = process
        self._alive = self._heard = time.monotonic()
        self._renewed = 0.0
        self._cancelled = self._stopping = self._killed = False
        self._verdict: dict[str, Any] | None = None
        self._thread = threading.Thread(target=self._run, name=f"depthsr-worker-{record.id}")
        self._thread.daemon = True

    @property
    def pid(self) -> int:
        return self._process.pid if self._process else 0

    @property
    def silent_seconds(self) -> float:
        """Time since the last sign of life: not by the clock of leases, which may jump."""
        return time.monotonic() - self._alive

    @property
    def idle_seconds(self) -> float:
        """Time since anything but a sign of life was heard."""
        return time.monotonic() - self._heard

    def start(self) -> None:
        self._thread.start()

    def join(self, seconds: float) -> None:
        self._thread.join(seconds)

    def cancel(self) -> None:
        self._cancelled = True
        self.stop()

    def stop(self) -> None:
        with self._lock:
            self._stopping = True
            if self._process is not None:
                self._process.tell("stop")

    def fail(self, verdict: dict[str, Any]) -> None:
        """End the process; the job fails for that reason."""
        self._verdict = verdict
        self.kill()

    def kill(self) -> None:
        with self._lock:
            self._killed = True
            if self._process is not None:
                self._process.kill()

    def _run(self) -> None:
        last: dict[str, Any] = {}
        rested = None
        try:
            last = self._listen()
        except Exception:
            log.warning("worker could not be run", exc_info=True, extra={"job": self.record.id})
            self.kill()
        finally:
            rested = self._let_go(last)
            try:
                self._conclude(last)
            except (KeyError, TransitionError):
                pass  # deleted, or taken from it, meanwhile
            except Exception:  # the lease will run out, and the scheduler finds the job
                log.warning("end of job not written", exc_info=True, extra={"job": self.record.id})
            self._scheduler._ended(self, rested)

    def _let_go(self, last: Mapping[str, Any]) -> _Process | None:
        """Return the process where it is good for another job; end it where it is not."""
        with self._lock:
            process, self._process = self._process, None
        if process is None:
            return None
        is_good = last.get("event") == "done" and not self._stopping and not self._killed
        if is_good and process.jobs < MAX_JOBS:
            return process
        process.end()
        return None

    def _listen(self) -> dict[str, Any]:
        config, store, record = self._scheduler.config, self._scheduler.store, self.record
        folder = job_folder(store.folder, record.id)
        order = WorkOrder(
            request=dict(record.request["request"]),
            scene=record.request["scene"],
            folder=str(folder),
            name=record.request.get("name", "result"),
            threads=config.worker_threads,
            memory=config.worker_memory * MIB,
            max_pixels=config.max_pixels,
            max_frames=config.max_frames,
            cluster=config.cluster or "",
            nice=min(19, os.getpriority(os.PRIO_PROCESS, 0) + config.worker_nice),
        )
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / LOG
        if path.exists() and path.stat().st_size > LOG_LIMIT:
            path.unlink()
        process = self._process or _Process(record.client, path)
        log.info("worker started", extra={"job": record.id, "attempt": record.attempt})
        process.jobs += 1
        process.tell(json.dumps(asdict(order)))
        with self._lock:
            self._process = process
            if self._stopping:  # asked before there was a process
                process.tell("stop")
            if self._killed:
                process.kill()
        for line in process.lines():
            try:
                said = json.loads(line)
                kind = said.pop("event")
            except (ValueError, KeyError):
                continue  # torn off by a kill
            self._alive = time.monotonic()
            self._renew()
            if kind == "beat":
                continue
            self._heard = self._alive
            if kind == "piece":
                self._scheduler._on_piece(record.id, said)
            elif kind in ("done", "stopped", "problem"):
                return {"event": kind, **said}
            else:
                store.report(record.id, kind, said)
                self._scheduler._on_event(kind, said)
        return {}

    def _renew(self) -> None:
        now, lease = time.monotonic(), self._scheduler.config.lease
        if now - self._renewed > lease / 4:
            self._renewed = now
            self._scheduler.store.renew(self.record.id, self.record.attempt, lease)

    def _conclude(self, last: dict[str, Any]) -> None:
        store, record = self._scheduler.store, self.record
        said = last.get("event")
        if said == "done":
            data = {"frames": last["frames"], "seconds": last["seconds"]}
            store.act(record.id, Action.SUCCEED, attempt=record.attempt, data=data)
        elif self._verdict is not None:
            store.act(record.id, Action.FAIL, attempt=record.attempt, problem=self._verdict)
        elif said == "problem":
            store.act(record.id, Action.FAIL, attempt=record.attempt, problem=last["problem"])
        elif self._cancelled:
            store.act(record.id, Action.STOPPED, attempt=record.attempt)
        else:
            if self._stopping:  # together with the service: not the job's fault
                store.act(record.id, Action.LOSE, attempt=record.attempt)
            else:
                lose(store, record.id, self._scheduler.config.max_attempts)
        log.info("worker ended", extra={"job": record.id, "said": said or "nothing"})


def lose(store: Store, job_id: str, max_attempts: int) -> None:
    """Queue a job whose worker is gone again, or fail it when that has happened too often."""
    record = store.job(job_id)
    if record is None:
        return
    if record.state is State.RUNNING and record.crashes + 1 >= max_attempts:
        detail = f"the worker died or hung {max_attempts} times; see the job's log"
        store.act(job_id, Action.FAIL, problem=problem("worker-lost", detail))
    else:
        store.act(job_id, Action.LOSE, crashed=True)


def sweep(store: Store) -> None:
    """At start: queue what was running, and remove what belongs to no job.

    An end of the service is not the job's fault: it does not count as a crash.
    """
    for record in store.jobs(states=(State.RUNNING, State.CANCELLING), limit=1 << 30):
        store.act(record.id, Action.LOSE)
    jobs = store.folder / "jobs"
    for folder in jobs.iterdir() if jobs.is_dir() else ():
        if store.job(folder.name) is None:
            shutil.rmtree(folder, ignore_errors=True)


def job_folder(data: Path, job_id: str) -> Path:
    """Return the folder of a job's input, results and log."""
    return data / "jobs" / job_id
