"""Connections that are cut, and clients that dribble: others do not notice, nothing is lost."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import socket
import time
from urllib.parse import urlsplit

import httpx
import pytest

from service.config import ServiceConfig
from service.http import guards
from service.http.guards import Guards
from service.http.problems import ProblemError
from service.metrics import Metrics
from tests.support.waiting import PATIENCE

SLOW = 200
TUS = {"Tus-Resumable": "1.0.0"}


@pytest.fixture
def open_line(live_service):
    """Return what opens a bare connection; all are closed at the end."""
    there = urlsplit(live_service.url)
    lines = []

    def connect() -> socket.socket:
        lines.append(socket.create_connection((there.hostname, there.port), timeout=PATIENCE))
        return lines[-1]

    yield connect
    for line in lines:
        line.close()


def test_an_upload_that_is_cut_off_goes_on_where_it_was(live_service, open_line):
    data = bytes(range(256)) * 4096
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE, headers=TUS) as api:
        name = base64.b64encode(b"a.bin").decode()
        made = api.post(
            "/api/v1/uploads",
            headers={"Upload-Length": str(len(data)), "Upload-Metadata": f"filename {name}"},
        ).headers["location"]
        line = open_line()
        head = (
            f"PATCH {made} HTTP/1.1\r\nHost: x\r\nTus-Resumable: 1.0.0\r\nUpload-Offset: 0\r\n"
            f"Content-Type: application/offset+octet-stream\r\nContent-Length: {len(data)}\r\n\r\n"
        )
        line.sendall(head.encode() + data[:300_000])
        line.close()
        deadline = time.monotonic() + PATIENCE
        kept = -1
        while time.monotonic() < deadline:  # until the service has seen the end of the line
            answer = api.head(made)
            at = int(answer.headers["upload-offset"])
            typed = {"Content-Type": "application/offset+octet-stream", "Upload-Offset": str(at)}
            rest = api.patch(made, headers=typed, content=data[at:])
            if rest.status_code == 204:
                kept = at
                break
            assert rest.status_code == 409, rest.text
        assert 0 <= kept <= 300_000
        assert api.head(made).headers["upload-offset"] == str(len(data))
    stored = live_service.data / "uploads" / made.rsplit("/", 1)[1]
    assert stored.read_bytes() == data


def test_a_form_that_is_cut_off_is_no_job(live_service, open_line):
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:

        def newest():
            return [job["id"] for job in api.get("/api/v1/jobs?limit=1").json()["jobs"]]

        before = newest()
        line = open_line()
        line.sendall(
            b"POST /api/v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Type: multipart/form-data; "
            b"boundary=b\r\nContent-Length: 100000\r\n\r\n--b\r\nContent-Disposition: form-data; "
            b'name="files"; filename="left.png"\r\n\r\n' + b"\0" * 5000
        )
        line.close()
        assert api.get("/readyz").status_code == 200
        assert newest() == before


def test_two_hundred_dribbling_clients_slow_nobody(live_service, open_line):
    heads = (
        b"GET /healthz HTTP/1.1\r\nHost: ",
        b"POST /api/v1/jobs HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
        b"Content-Length: 900000\r\n\r\n{",
    )
    lines = [open_line() for _ in range(SLOW)]
    for number, line in enumerate(lines):
        line.sendall(heads[number % 2])
    with httpx.Client(base_url=live_service.url, timeout=PATIENCE) as api:
        for turn in range(5):
            for line in lines[turn::5]:
                with contextlib.suppress(ConnectionError):  # let go: a head is waited for 20 s
                    line.sendall(b"x")
            assert api.get("/api/v1/jobs?limit=5").status_code == 200
            assert api.get("/readyz").status_code == 200


def test_a_body_that_stops_coming_is_answered(monkeypatch, tmp_path):
    monkeypatch.setattr(guards, "BODY_PATIENCE", 0.05)
    seen = []

    class State:
        metrics = Metrics()

    class App:
        state = State()

    async def app(scope, receive, send):
        try:
            await receive()
        except ProblemError as error:
            seen.append(error.kind)

    async def never():
        await asyncio.sleep(60)

    async def send(message):
        pass

    scope = {
        "type": "http", "method": "POST", "path": "/", "app": App(),
        "headers": [(b"content-length", b"5")],
    }  # fmt: skip
    asyncio.run(Guards(app, ServiceConfig(data=tmp_path))(scope, never, send))
    assert seen == ["too-slow"]
