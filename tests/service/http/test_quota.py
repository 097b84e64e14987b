"""Who may still send something, and ask for something."""

from __future__ import annotations

from types import SimpleNamespace

import httpx
import pytest

from service.config import ServiceConfig
from service.http import quota
from service.http.auth import Client
from service.http.problems import ProblemError
from service.http.quota import check_queue, check_space, folder_size, note_size
from service.jobs.states import Action
from service.store import Store
from tests.support.waiting import PATIENCE, until

KIB = 1 << 10
ANNA, BOB = (Client(name=name, scopes=frozenset({"submit"})) for name in ("anna", "bob"))


@pytest.fixture
def state(tmp_path):
    config = ServiceConfig(data=tmp_path, client_quota=1, max_queue=1, disk_reserve=0)
    store = Store(tmp_path)
    yield SimpleNamespace(config=config, store=store)
    store.close()


def _write(path, size):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(size))


def test_a_client_has_its_share_of_the_disk_and_no_more(state):
    data, store = state.config.data, state.store
    upload = store.create_upload("anna", "a.png", 300 * KIB)
    store.create_job(job_id="1" * 32, client="anna", request={"request": {}})
    store.create_job(job_id="2" * 32, client="bob", request={"request": {}})
    _write(data / "uploads" / upload.id, 300 * KIB)
    _write(data / "jobs" / ("1" * 32) / "results" / "frames" / "left.png", 600 * KIB)
    _write(data / "jobs" / ("2" * 32) / "results" / "a.mkv", 100 * KIB)
    check_space(state, ANNA, 124 * KIB)
    with pytest.raises(ProblemError, match="your quota") as refused:
        check_space(state, ANNA, 125 * KIB)
    assert refused.value.kind == "disk-full"
    check_space(state, BOB, 924 * KIB)
    assert folder_size(data) >= 1000 * KIB


def test_after_a_silence_sizes_are_measured_before_they_are_believed(state, monkeypatch):
    upload = state.store.create_upload("anna", "a.png", 900 * KIB)
    check_space(state, ANNA, 900 * KIB)
    _write(state.config.data / "uploads" / upload.id, 900 * KIB)
    check_space(state, ANNA, 900 * KIB)  # as of a few seconds ago
    monkeypatch.setattr(quota, "REMEMBER", 0.0)
    monkeypatch.setattr(quota, "TOO_OLD", 0.0)
    with pytest.raises(ProblemError, match="your quota"):
        check_space(state, ANNA, 900 * KIB)


def test_what_has_just_come_counts_at_once(state):
    check_space(state, ANNA, 600 * KIB)  # sizes are measured here
    state.store.create_job(job_id="1" * 32, client="anna", request={"request": {}})
    note_size(state.config.data, "1" * 32, 600 * KIB)
    check_space(state, BOB, 600 * KIB)
    with pytest.raises(ProblemError, match="your quota"):
        check_space(state, ANNA, 600 * KIB)
    state.store.act("1" * 32, Action.CANCEL)
    state.store.delete_job("1" * 32)
    check_space(state, ANNA, 600 * KIB)


def test_twice_what_fits_once_is_refused_over_http(make_service, tmp_path):
    file = tmp_path / "tokens"
    file.write_text("anna submit,read anna-secret-0123456789\n")
    service = make_service("--token-file", str(file), "--client-quota", "1")
    headers = {"Authorization": "Bearer anna-secret-0123456789"}
    with httpx.Client(base_url=service.url, timeout=PATIENCE, headers=headers) as api:
        files = [("files", ("a.dat", bytes(700 * KIB)))]
        answers = [api.post("/api/v1/jobs", files=files).status_code for _ in range(2)]
        assert answers == [202, 507]
        (job,) = api.get("/api/v1/jobs").json()["jobs"]
        until(lambda: api.get(job["links"]["self"]).json()["state"] == "failed")
        assert api.delete(job["links"]["self"]).status_code == 204
        tus = {"Tus-Resumable": "1.0.0", "Upload-Length": str(700 * KIB)}
        kind = {"Content-Type": "application/offset+octet-stream", "Upload-Offset": "0"}
        made = [api.post("/api/v1/uploads", headers=tus).headers["location"] for _ in range(2)]
        sent = [
            api.patch(where, headers={**tus, **kind}, content=bytes(700 * KIB)).status_code
            for where in made
        ]
        assert sent == [204, 507]


def test_a_client_has_its_share_of_the_queue(state):
    check_queue(state, ANNA)
    state.store.create_job(job_id="1" * 32, client="anna", request={"request": {}})
    with pytest.raises(ProblemError, match="unfinished"):
        check_queue(state, ANNA)
    check_queue(state, BOB)
    state.store.act("1" * 32, Action.CANCEL)
    check_queue(state, ANNA)
