"""The doors one by one, on a real service whose single worker is real too."""

from __future__ import annotations

import asyncio
import base64
import json
import threading
from pathlib import Path
from types import SimpleNamespace

import httpx
import pytest

from service.http.job_events import stream_events
from service.jobs.states import Action, State
from service.notices import Notices
from service.store import Store
from tests.support.service_api import follow, is_problem
from tests.support.waiting import PATIENCE


@pytest.fixture(scope="module")
def done(api, tiny_scene):
    """A finished job."""
    body = {"scene": "tiny", "input": {"frames": ":2"}, "output": {"segment_length": 1}}
    job = api.post("/api/v1/jobs", json=body).json()["id"]
    follow(api, job)
    return job


def test_a_job_is_taken_followed_and_done(api, done):
    job = api.get(f"/api/v1/jobs/{done}").json()
    assert (job["state"], job["frames_done"], job["frames_total"]) == ("succeeded", 2, 2)
    events = api.get(f"/api/v1/jobs/{done}/events").json()
    kinds = [item["kind"] for item in events["events"]]
    assert kinds[:2] == ["queued", "running"]
    assert kinds[-1] == "succeeded"
    assert kinds.count("FrameFinished") == 2
    assert [item["sequence"] for item in events["events"]] == list(range(1, len(kinds) + 1))


def test_events_are_replayed_from_the_last_one_seen(api, done):
    whole = follow(api, done)
    rest = follow(api, done, **{"Last-Event-ID": "3"})
    assert rest == whole[3:]
    page = api.get(f"/api/v1/jobs/{done}/events", params={"after": 3, "limit": 2}).json()
    assert page["events"] == whole[3:5]
    assert page["last"] == 5


def test_results_by_ranges_tags_and_heads(api, done):
    listed = {item["name"]: item for item in api.get(f"/api/v1/jobs/{done}/results").json()}
    assert set(listed) == {"tiny_3D_SBS_LR.mkv", "report.json"}
    video = listed["tiny_3D_SBS_LR.mkv"]
    whole = api.get(video["url"])
    assert len(whole.content) == video["size"]
    assert whole.headers["content-type"] == "video/x-matroska"
    part = api.get(video["url"], headers={"Range": "bytes=10-19"})
    assert (part.status_code, part.content) == (206, whole.content[10:20])
    is_problem(
        api.get(video["url"], headers={"Range": "bytes=99999999-"}), 416, "range-not-satisfiable"
    )
    tag = whole.headers["etag"]
    assert api.get(video["url"], headers={"If-None-Match": tag}).status_code == 304
    head = api.head(video["url"])
    assert (head.status_code, head.content) == (200, b"")
    assert int(head.headers["content-length"]) == video["size"]
    for method, range_ in (("GET", "lines=1-2"), ("HEAD", "bytes=0-9"), ("HEAD", "bytes=x")):
        answer = api.request(method, video["url"], headers={"Range": range_})
        assert (answer.status_code, int(answer.headers["content-length"])) == (200, video["size"])
    is_problem(api.get(f"/api/v1/jobs/{done}/results/..%2f..%2fservice.sqlite"), 404, "not-found")
    assert api.get(f"/api/v1/jobs/{done}/logs").status_code == 200


def test_a_job_unchanged_is_not_sent_again(api, done):
    for where in (f"/api/v1/jobs/{done}", "/api/v1/jobs?state=succeeded"):
        first = api.get(where)
        assert api.head(where).status_code == 200
        again = api.get(where, headers={"If-None-Match": first.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")


def test_the_job_of_a_form_may_come_as_a_file(api):
    """As browsers send a Blob of JSON."""
    said = ("job", ("job.json", b'{"priority": 3}', "application/json"))
    answer = api.post("/api/v1/jobs", files=[said, ("files", ("a.dat", b"x"))])
    assert (answer.status_code, answer.json()["priority"]) == (202, 3)
    wrong = ("job", ("job.json", b"\xff", "application/json"))
    is_problem(
        api.post("/api/v1/jobs", files=[wrong, ("files", ("a.dat", b"x"))]), 400, "bad-request"
    )


def test_multipart_upload_is_a_job(api, tiny_scene):
    names = [path for path in sorted(tiny_scene.rglob("*")) if path.is_file()]
    files = [("files", (p.relative_to(tiny_scene).as_posix(), p.read_bytes())) for p in names]
    body = {"input": {"frames": "0:1"}, "output": {"container": "mp4"}}
    answer = api.post("/api/v1/jobs", files=files, data={"job": json.dumps(body)})
    assert answer.status_code == 202, answer.text
    assert answer.headers["location"] == f"/api/v1/jobs/{answer.json()['id']}"
    assert follow(api, answer.json()["id"])[-1]["kind"] == "succeeded"
    results = api.get(answer.json()["links"]["results"]).json()
    assert "scene_3D_SBS_LR.mp4" in {item["name"] for item in results}


@pytest.mark.parametrize(
    ("files", "said", "name"),
    [
        (["clip.mp4"], {}, "clip"),
        (["clip_3D_SBS_LR.mp4"], {}, "clip"),
        (["clip_L.mov", "clip_R.mov"], {}, "clip"),
        (["left.mov", "right.mov"], {}, "scene"),
        (["im2.png", "im6.png"], {}, "scene"),
        (["scene.json", "left.png"], {}, "scene"),
        (["hall/scene.json", "hall/left.png"], {}, "hall"),
        (["im2.png", "im6.png"], {"name": "cones, 1st take"}, "cones--1st-take"),
        (["im2.png"], {"name": "../.."}, "scene"),
    ],
)
def test_a_job_is_called_as_it_says_or_as_its_scene(api, files, said, name):
    sent = [("files", (file, b"x")) for file in files]
    answer = api.post("/api/v1/jobs", files=sent, data={"job": json.dumps(said)})
    assert (answer.status_code, answer.json()["name"]) == (202, name)


def test_foreign_tus_client_resumes_and_the_upload_becomes_a_job(api, live_service, tiny_scene):
    from tusclient.client import TusClient

    tus = TusClient(f"{live_service.url}/api/v1/uploads")
    uploads = {}
    for path in sorted(tiny_scene.rglob("*")):
        if path.is_file():
            with path.open("rb") as file:
                named = {"filename": path.name}
                uploader = tus.uploader(file_stream=file, chunk_size=1000, metadata=named)
                uploader.upload_chunk()  # cut off after the first piece
                again = tus.uploader(file_stream=file, chunk_size=1 << 20, url=uploader.url)
                assert again.offset == min(1000, path.stat().st_size)
                again.upload()
            uploads[path.relative_to(tiny_scene).as_posix()] = uploader.url.rsplit("/", 1)[1]
    body = {"uploads": uploads, "input": {"frames": "1:2"}}
    answer = api.post("/api/v1/jobs", json=body)
    assert answer.status_code == 202, answer.text
    assert follow(api, answer.json()["id"])[-1]["kind"] == "succeeded"


def test_wrong_fields_are_each_named(api):
    body = {"scene": "tiny", "outptu": {}, "settings": {"magnification": "7"}}
    said = is_problem(api.post("/api/v1/jobs", json=body), 422, "invalid")
    assert {"at": "outptu", "says": "no such field"} in said["errors"]
    assert "settings/magnification: Input should be" in said["detail"]
    said = is_problem(api.post("/api/v1/streams", json={"id": "a", "idel": 3}), 422, "invalid")
    assert said["errors"] == [{"at": "body/idel", "says": "no such field"}]


TUS = {"Tus-Resumable": "1.0.0"}


def test_tus_by_hand(api):
    name = base64.b64encode(b"a.bin").decode()
    made = api.post(
        "/api/v1/uploads",
        headers={**TUS, "Upload-Length": "5", "Upload-Metadata": f"filename {name}"},
    )
    assert made.status_code == 201
    where = made.headers["location"]
    kind = {"Content-Type": "application/offset+octet-stream"}
    patch = api.patch(where, headers={**TUS, **kind, "Upload-Offset": "0"}, content=b"abc")
    assert (patch.status_code, patch.headers["upload-offset"]) == (204, "3")
    again = api.patch(where, headers={**TUS, **kind, "Upload-Offset": "0"}, content=b"abc")
    is_problem(again, 409, "conflict")
    assert again.headers["tus-resumable"] == "1.0.0"
    is_problem(
        api.patch(where, headers={**TUS, **kind, "Upload-Offset": "3"}, content=b"defg"),
        413, "too-large",
    )  # fmt: skip
    there = api.head(where, headers=TUS).headers
    assert (there["upload-offset"], there["upload-metadata"]) == ("3", f"filename {name}")
    is_problem(api.post("/api/v1/jobs", json={"uploads": {"a.bin": where[-32:]}}), 409, "conflict")
    is_problem(
        api.post("/api/v1/uploads", headers={"Upload-Length": "5"}), 412, "precondition-failed"
    )
    rest = {"Upload-Offset": "3", "X-HTTP-Method-Override": "PATCH"}
    assert api.post(where, headers={**TUS, **kind, **rest}, content=b"de").status_code == 204
    assert api.head(where, headers=TUS).headers["upload-offset"] == "5"
    foreign = {"X-HTTP-Method-Override": "DELETE", "Origin": "http://evil.example"}
    is_problem(api.get(where, headers={**TUS, **foreign}), 403, "forbidden")
    assert api.delete(where, headers=TUS).status_code == 204
    assert api.head(where, headers=TUS).status_code == 404


@pytest.mark.parametrize("name", ["../up.png", "/abs.png", "a/../../b", ".hidden", "a\\b"])
def test_names_that_leave_their_folder_are_refused(api, name):
    answer = api.post("/api/v1/jobs", files=[("files", (name, b"x"))])
    is_problem(answer, 422, "invalid")
    meta = f"filename {base64.b64encode(name.encode()).decode()}"
    made = api.post(
        "/api/v1/uploads", headers={**TUS, "Upload-Length": "1", "Upload-Metadata": meta}
    )
    is_problem(made, 422, "invalid")


def test_a_bomb_is_refused_before_it_is_decoded(api):
    bomb = bytes.fromhex("89504e470d0a1a0a0000000d4948445200100000001000000802000000")
    is_problem(api.post("/api/v1/jobs", files=[("files", ("left.png", bomb))]), 413, "too-large")


@pytest.mark.parametrize(
    "scene", ["../../etc", "/etc/passwd", "nothing", "tiny/../../..", "", "\0", "a" * 5000]
)
def test_scenes_outside_the_roots_are_not_found(api, scene, tiny_scene):
    if scene == "":  # the root itself: nothing to read there, and the worker says so
        return
    is_problem(api.post("/api/v1/jobs", json={"scene": scene}), 422, "invalid")


def test_a_link_that_leads_out_of_the_root_is_not_followed(api, tiny_scene):
    link = tiny_scene.parent / "way-out"
    link.symlink_to("/etc")
    try:
        is_problem(api.post("/api/v1/jobs", json={"scene": "way-out/passwd"}), 422, "invalid")
    finally:
        link.unlink()


def test_a_key_makes_one_job_and_no_other_request_may_use_it(api):
    body = {"scene": "tiny", "input": {"frames": ":1"}}
    headers = {"Idempotency-Key": "once"}
    first = api.post("/api/v1/jobs", json=body, headers=headers).json()
    again = api.post("/api/v1/jobs", json=body, headers=headers)
    assert (again.status_code, again.json()["id"]) == (202, first["id"])
    is_problem(
        api.post("/api/v1/jobs", json={**body, "priority": 1}, headers=headers), 422, "key-reused"
    )
    follow(api, first["id"])


def test_one_job_of_many_requests_with_one_key(api, live_service):
    body = {"scene": "tiny", "input": {"frames": ":1"}}
    answers = []

    def send():
        with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as client:
            answers.append(
                client.post("/api/v1/jobs", json=body, headers={"Idempotency-Key": "rush"})
            )

    threads = [threading.Thread(target=send) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} <= {202, 409}
    ids = {answer.json()["id"] for answer in answers if answer.status_code == 202}
    assert len(ids) == 1
    follow(api, ids.pop())


def test_a_scene_that_cannot_be_read_fails_with_its_reason(api):
    job = api.post("/api/v1/jobs", files=[("files", ("scene.json", b'{"format": 1}'))]).json()["id"]
    last = follow(api, job)[-1]
    assert last["kind"] == "failed"
    job = api.get(f"/api/v1/jobs/{job}").json()
    assert job["problem"]["type"] == "urn:depthsr:problem:scene-error"
    assert job["attempt"] == 1
    assert "/data/jobs/" not in job["problem"]["detail"]


def test_cancel_retry_delete(api):
    body = {"scene": "tiny", "output": {"segment_length": 1}, "priority": -1}
    while True:  # a quick worker may be done before it is told
        job = api.post("/api/v1/jobs", json=body).json()["id"]
        where = f"/api/v1/jobs/{job}"
        refused, cancelled = api.delete(where), api.post(f"{where}/cancel")
        if cancelled.status_code == 202:
            break
    is_problem(refused, 409, "conflict")
    assert cancelled.json()["state"] in ("cancelling", "cancelled")
    assert follow(api, job)[-1]["kind"] == "cancelled"
    assert api.post(f"{where}/cancel").status_code == 202
    assert api.post(f"{where}/retry").json()["state"] == "queued"
    assert follow(api, job)[-1]["kind"] in ("cancelled", "succeeded")
    while api.get(where).json()["state"] not in ("succeeded", "cancelled"):
        follow(api, job, **{"Last-Event-ID": "9999"})
    assert api.get(where).json()["state"] == "succeeded"
    is_problem(api.post(f"{where}/retry"), 409, "conflict")
    assert api.delete(where).status_code == 204
    is_problem(api.get(where), 404, "not-found")


def test_pages_follow_each_other(api, done):
    seen, where = [], "/api/v1/jobs?limit=2"
    while where:
        page = api.get(where).json()
        assert len(page["jobs"]) <= 2
        seen += [job["id"] for job in page["jobs"]]
        where = page["next"]
    assert done in seen
    assert len(seen) == len(set(seen))


BAD_SWEEPS = {"scene": "tiny", "settings": {"sweeps": 0}}
ELSEWHERE = {"Origin": "http://evil.example"}


@pytest.mark.parametrize(
    ("method", "where", "options", "status", "kind"),
    [
        ("GET", "/api/v1/nothing", {}, 404, "not-found"),
        ("PUT", "/api/v1/jobs", {}, 405, "method-not-allowed"),
        ("POST", "/api/v1/jobs", {"content": b"x"}, 415, "unsupported-media-type"),
        ("POST", "/api/v1/jobs", {"json": {"unheard": 1}}, 422, "invalid"),
        ("POST", "/api/v1/jobs", {"json": BAD_SWEEPS}, 422, "configuration-error"),
        ("GET", "/api/v1/jobs?limit=0", {}, 422, "invalid"),
        ("POST", "/api/v1/jobs", {"json": {"scene": "x" * 2_000_000}}, 413, "too-large"),
        ("POST", "/api/v1/jobs", {"headers": ELSEWHERE, "json": {}}, 403, "forbidden"),
    ],
)  # fmt: skip
def test_problems(api, method, where, options, status, kind):
    is_problem(api.request(method, where, **options), status, kind)


@pytest.mark.parametrize(
    ("where", "methods"),
    [
        ("/api/v1/jobs", "GET, HEAD, POST"),
        ("/api/v1/jobs/17", "DELETE, GET, HEAD"),
        ("/api/v1/jobs/17/cancel", "POST"),
        ("/api/v1/uploads/17", "DELETE, HEAD, PATCH"),
        ("/api/v1/streams", "GET, HEAD, POST"),
        ("/api/openapi.json", "GET, HEAD"),
        ("/healthz", "GET, HEAD"),
    ],
)
def test_a_wrong_method_is_told_which_there_are(api, where, methods):
    answer = api.put(where)
    is_problem(answer, 405, "method-not-allowed")
    assert answer.headers["allow"] == methods


def test_a_long_body_without_a_length_is_cut_off(api):
    def endless():
        yield b'{"scene": "'
        for _ in range(40):
            yield b"x" * 65536

    headers = {"Content-Type": "application/json"}
    is_problem(api.post("/api/v1/jobs", content=endless(), headers=headers), 413, "too-large")


def test_health_metrics_and_headers(api, done):
    assert api.get("/healthz").json() == {"status": "ok"}
    assert api.get("/readyz").json() == {"status": "ok"}
    numbers = api.get("/metrics").text
    assert 'depthsr_jobs{state="succeeded"}' in numbers
    assert "depthsr_frames_total" in numbers
    assert 'depthsr_stage_seconds_total{stage="encode"}' in numbers
    headers = api.get("/api/v1/jobs").headers
    assert headers["x-content-type-options"] == "nosniff"
    assert "default-src 'self'" in headers["content-security-policy"]
    assert "access-control-allow-origin" not in headers
    assert "server" not in headers


def test_the_schema_of_a_job_is_that_of_run(api):
    schema = api.get("/api/v1/settings-schema").json()
    assert "psf_sigma" in schema["$defs"]["Settings"]["properties"]
    assert Path(schema["$defs"]["Settings"]["title"]).name == "Settings"


class EndsBehindOurBack(Store):
    """A job of it succeeds just after somebody has asked for events and there were none."""

    def events(self, job_id, **where):
        found = super().events(job_id, **where)
        if not found and self.job(job_id).state is State.RUNNING:
            self.act(job_id, Action.SUCCEED)
        return found


def test_a_stream_of_events_never_ends_before_the_last_of_them(tmp_path):
    notices = Notices()
    store = EndsBehindOurBack(tmp_path, on_change=notices.tell)
    store.create_job(job_id="a", client="", request={})
    store.take(60)
    app = SimpleNamespace(state=SimpleNamespace(notices=notices, store=store))

    async def listen():
        return [text async for text in stream_events(SimpleNamespace(app=app), "a", 0)]

    said = asyncio.run(asyncio.wait_for(listen(), PATIENCE))
    assert "event: succeeded" in said[-1]
    store.close()
