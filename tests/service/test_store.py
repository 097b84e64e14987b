from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
import uuid

import pytest

from pipeline.errors import ConfigurationError
from service.jobs.states import Action, State, TransitionError
from service.scheduler import lose, sweep
from service.store import MIGRATIONS, KeyReusedError, Store
from tests.support.waiting import PATIENCE


class Clock:
    now = 1000.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def store(tmp_path, clock):
    store = Store(tmp_path, clock=clock)
    yield store
    store.close()


def _add(store, client="anna", **more):
    return store.create_job(job_id=uuid.uuid4().hex, client=client, request={}, **more)[0]


def test_jobs_and_events_outlive_the_process(tmp_path):
    store = Store(tmp_path)
    job = _add(store)
    store.report(job.id, "Warned", {"text": "dark"})
    store.close()
    again = Store(tmp_path)
    assert again.job(job.id) == store_like(job, again)
    assert [(e.sequence, e.kind) for e in again.events(job.id)] == [(1, "queued"), (2, "Warned")]
    again.close()


def store_like(job, store):
    found = store.job(job.id)
    assert (found.id, found.state, found.client) == (job.id, job.state, job.client)
    return found


def test_turns_go_by_priority_then_client_then_age(store, clock):
    many = [_add(store, "greedy") for _ in range(4)]
    late = _add(store, "modest")
    urgent = _add(store, "other", priority=5)
    order = []
    for _ in range(6):
        clock.now += 1
        job = store.take(30)
        order.append(job.id)
        store.act(job.id, Action.SUCCEED)
    assert order == [urgent.id, many[0].id, late.id, *(job.id for job in many[1:])]
    assert store.take(30) is None


def test_a_key_makes_one_job(store):
    first, new = store.create_job(job_id="a", client="anna", request={}, key="k", request_hash="h")
    again, fresh = store.create_job(
        job_id="b", client="anna", request={}, key="k", request_hash="h"
    )
    assert (new, fresh, first.id, again.id) == (True, False, "a", "a")
    with pytest.raises(KeyReusedError):
        store.create_job(job_id="c", client="anna", request={}, key="k", request_hash="other")
    store.create_job(job_id="d", client="bert", request={}, key="k", request_hash="other")


def test_leases_run_out_unless_renewed(store, clock):
    job = _add(store)
    attempt = store.take(30).attempt
    clock.now += 29
    store.renew(job.id, attempt, 30)
    clock.now += 29
    assert store.expired() == []
    clock.now += 2
    assert [item.id for item in store.expired()] == [job.id]


def test_a_job_compiles_until_its_first_frame_or_another_attempt(store):
    job = _add(store)
    store.take(30)
    store.report(job.id, "Compiling", {})
    assert store.job(job.id).compiling
    store.report(job.id, "FrameFinished", {"done": 1, "total": 4})
    assert not store.job(job.id).compiling
    store.report(job.id, "Compiling", {})
    store.act(job.id, Action.LOSE)
    store.take(30)
    assert not store.job(job.id).compiling


def test_a_late_word_of_an_old_attempt_is_not_heard(store):
    job = _add(store)
    old = store.take(30).attempt
    store.act(job.id, Action.LOSE)
    store.take(30)
    with pytest.raises(KeyError):
        store.act(job.id, Action.SUCCEED, attempt=old)
    assert store.job(job.id).state is State.RUNNING


def test_lost_too_often_is_failed_with_a_problem(store):
    job = _add(store)
    for attempt in range(3):
        assert store.take(30).attempt == attempt + 1
        lose(store, job.id, 3)
    found = store.job(job.id)
    assert found.state is State.FAILED
    assert found.problem["type"].endswith("worker-lost")
    assert store.act(job.id, Action.RETRY).crashes == 0


def test_nothing_is_left_running_after_a_start(store):
    running, cancelling = _add(store), _add(store)
    store.take(30)
    store.take(30)
    store.act(cancelling.id, Action.CANCEL)
    (store.folder / "jobs" / "orphan").mkdir(parents=True)
    sweep(store)
    assert store.job(running.id).state is State.QUEUED
    assert store.job(running.id).crashes == 0
    assert store.job(cancelling.id).state is State.CANCELLED
    assert not (store.folder / "jobs" / "orphan").exists()


def test_a_refused_change_leaves_nothing(store):
    job = _add(store)
    with pytest.raises(TransitionError):
        store.act(job.id, Action.SUCCEED)
    assert len(store.events(job.id)) == 1
    assert store.job(job.id).version == 1


def test_deleting_takes_events_and_key_along(store):
    store.create_job(job_id="a", client="anna", request={}, key="k", request_hash="h")
    store.delete_job("a")
    assert store.events("a") == []
    assert store.keyed("anna", "k", "h") is None


def test_one_service_a_folder(store):
    with pytest.raises(ConfigurationError, match="another service"):
        Store(store.folder)


def test_a_second_service_says_so_in_one_line(store):
    command = [sys.executable, "-m", "service", "serve", "--port", "0", "--zenoh", "off"]
    ended = subprocess.run(
        [*command, "--data", str(store.folder)],
        capture_output=True, text=True, timeout=PATIENCE,
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stdout == ""  # no address that nobody answers
    said = f"depthsr: error: {store.folder}: another service works on this data folder\n"
    assert ended.stderr == said


def test_old_schemas_are_brought_up_and_newer_ones_refused(tmp_path):
    db = sqlite3.connect(tmp_path / "service.sqlite")
    db.executescript(f"{MIGRATIONS[0]}; {MIGRATIONS[1]}; PRAGMA user_version = 2;")
    db.execute("INSERT INTO upload VALUES ('begun', 'anna', 'b.png', 7, 1)")
    db.execute(
        "INSERT INTO job (id, client, priority, state, request, created)"
        " VALUES ('old', 'anna', 0, 'queued', '{}', 1)"
    )
    db.commit()
    db.close()
    store = Store(tmp_path)
    assert store.job("old").state is State.QUEUED
    assert store.upload("begun").length == 7
    assert store.create_upload("anna", "a.png", 3).length == 3
    store.close()
    db = sqlite3.connect(tmp_path / "service.sqlite")
    db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(ConfigurationError, match="newer depthsr"):
        Store(tmp_path)


WRITER = """
import sys, itertools
from pathlib import Path
from service.store import Store
store = Store(Path(sys.argv[1]))
for number in itertools.count():
    store.create_job(job_id=f"job-{number}", client="anna", request={"n": number})
    print(number, flush=True)
"""


def test_what_was_answered_survives_a_kill(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    with process:
        for line in process.stdout:
            if int(line) == 40:
                os.kill(process.pid, signal.SIGKILL)
                break
    store = Store(tmp_path)
    kept = {job.id for job in store.jobs(limit=10_000)}
    assert {f"job-{number}" for number in range(41)} <= kept
    assert all(len(store.events(job)) == 1 for job in kept)
    store.close()
    db = sqlite3.connect(tmp_path / "service.sqlite")
    assert db.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    db.close()
