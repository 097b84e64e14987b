"""Jobs and the processes that do them."""

from __future__ import annotations

import contextlib
import threading
import time
import uuid
from pathlib import Path

from service import scheduler as scheduling
from service.config import ServiceConfig
from service.jobs.states import State, TransitionError
from service.scheduler import Scheduler
from service.store import Store
from tests.support.waiting import PATIENCE, until


def test_one_more_worker_waits_until_memory_is_free(tmp_path, tiny_scene):
    """There is never as much as is asked for here; a worker alone begins all the same."""
    ended, seen = threading.Semaphore(0), []
    store = Store(tmp_path)
    config = ServiceConfig(
        data=tmp_path, workers=2, worker_threads=1, worker_nice=0, memory_reserve=1 << 24
    )
    scheduler = Scheduler(
        store,
        config,
        on_event=lambda kind, data: seen.append(scheduler.busy),
        on_end=lambda job: ended.release(),
    )
    jobs = [_add(store, tiny_scene, client, 1) for client in ("anna", "bert")]
    scheduler.start()
    try:
        for _ in jobs:
            assert ended.acquire(timeout=PATIENCE)
        assert {store.job(job).state for job in jobs} == {State.SUCCEEDED}
        assert max(seen) == 1
    finally:
        scheduler.close()
        store.close()


def _add(store, scene, client, priority):
    wanted = {"scene": str(scene), "input": {"frames": ":1"}}
    request = {"request": wanted, "scene": str(scene), "name": "tiny"}
    job_id = uuid.uuid4().hex
    store.create_job(job_id=job_id, client=client, request=request, priority=priority)
    return job_id


def test_a_job_cancelled_in_the_moment_it_is_taken_has_a_worker_that_is_told(tmp_path, tiny_scene):
    class Cancelling(Store):
        """Somebody cancels what is taken before it is given to a worker, or waits to do that."""

        def take(self, lease):
            record = super().take(lease)
            if record is not None:
                threads.append(threading.Thread(target=scheduler.cancel, args=(record.id,)))
                threads[0].start()
                until(lambda: scheduler._lock.locked() or self.job(record.id).state.is_final)
            return record

    def cancel(job):
        with contextlib.suppress(TransitionError):  # it was done first
            scheduler.cancel(job)

    ended, threads = threading.Semaphore(0), []
    store = Cancelling(tmp_path)
    config = ServiceConfig(data=tmp_path, workers=1, worker_threads=1, worker_nice=0)
    scheduler = Scheduler(store, config, on_end=lambda job: ended.release())
    job = _add(store, tiny_scene, "anna", 1)
    scheduler.start()
    try:
        assert ended.acquire(timeout=PATIENCE)
        threads[0].join(PATIENCE)
        kinds = [event.kind for event in store.events(job)]
    finally:
        scheduler.close()
        store.close()
    assert kinds[-1] in ("cancelled", "succeeded"), "and nothing is said after that"


def test_jobs_of_one_client_share_a_process_that_nobody_else_gets(
    tmp_path, tiny_scene, monkeypatch
):
    """And a clock that jumps costs nobody an attempt."""
    monkeypatch.setattr(scheduling, "REST", PATIENCE)
    ended, seen, hours = threading.Semaphore(0), {}, [0]
    store = Store(tmp_path, clock=lambda: time.time() + 3600 * hours[-1])

    def heard(kind, data):
        if kind == "JobStarted":
            seen.update(scheduler.pids)
            hours.append(hours[-1] + (5 if len(hours) == 1 else -3))

    scheduler = Scheduler(
        store,
        ServiceConfig(data=tmp_path, worker_threads=1, worker_nice=0),
        on_event=heard,
        on_end=lambda job: ended.release(),
    )

    jobs = [_add(store, tiny_scene, *who) for who in (("anna", 2), ("anna", 1), ("bert", 0))]
    scheduler.start()
    try:
        for _ in jobs:
            assert ended.acquire(timeout=PATIENCE)
        jobs.append(_add(store, tiny_scene, "bert", 0))
        scheduler.poke()
        assert ended.acquire(timeout=PATIENCE)
        assert {store.job(job).state for job in jobs} == {State.SUCCEEDED}
        assert {store.job(job).attempt for job in jobs} == {1}
        monkeypatch.setattr(scheduling, "REST", 0.0)
        scheduler.poke()
        until(lambda: not Path(f"/proc/{seen[jobs[-1]]}").exists())
    finally:
        scheduler.close()
        store.close()
    first, second, other, later = (seen[job] for job in jobs)
    assert first == second != other == later
    assert not Path(f"/proc/{first}").exists()
    for job in jobs:
        assert (tmp_path / "jobs" / job / "worker.log").is_file()
