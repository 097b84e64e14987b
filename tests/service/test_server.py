"""Connections of a server whose heads must come in time."""

from __future__ import annotations

import socket
import threading

import pytest
import uvicorn

from service import server
from service.server import PunctualProtocol
from tests.support.waiting import PATIENCE, until

WHOLE = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"
TO_WEBSOCKET = (
    b"GET / HTTP/1.1\r\nHost: x\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
)
EMPTY_TEXT = b"\x81\x80\0\0\0\0"
"""A text message of a WebSocket's client, of no letters."""


async def app(scope, receive, send):
    """Answer when the body is there; say something on a WebSocket after a while."""
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.accept"})
        await receive()
        await send({"type": "websocket.send", "text": "still here"})
        return
    while (await receive()).get("more_body"):
        pass
    await send({"type": "http.response.start", "status": 204, "headers": []})
    await send({"type": "http.response.body"})


@pytest.fixture
def line_with(monkeypatch):
    """Return what opens a line on which words are there when the server sees it first."""
    monkeypatch.setattr(server, "HEAD_PATIENCE", 0.2)
    settings = uvicorn.Config(
        app, port=0, log_config=None, lifespan="off", http=PunctualProtocol, timeout_keep_alive=60
    )
    running = uvicorn.Server(settings)
    thread = threading.Thread(target=running.run)
    thread.start()
    until(lambda: running.started)

    def open_line(said: bytes) -> socket.socket:
        (listening,) = running.servers
        is_said = threading.Event()
        listening.get_loop().call_soon_threadsafe(is_said.wait)
        line = socket.create_connection(listening.sockets[0].getsockname(), timeout=PATIENCE)
        line.sendall(said)
        is_said.set()
        return line

    yield open_line
    running.should_exit = True
    thread.join()


@pytest.mark.parametrize(("before", "begun"), [(b"", b""), (b"", WHOLE[:9]), (WHOLE, WHOLE[:9])])
def test_who_does_not_end_a_head_is_let_go(line_with, before, begun):
    with line_with(before or begun) as line:
        if before:
            assert b"204" in line.recv(4096)
            line.sendall(begun)
        assert line.recv(4096) == b""


def test_who_takes_time_for_a_body_or_between_requests_is_not(line_with):
    wait = threading.Event().wait
    with line_with(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 2\r\n\r\na") as line:
        wait(0.5)
        line.sendall(b"b")
        assert b"204" in line.recv(4096)
        wait(0.5)
        line.sendall(WHOLE)
        assert b"204" in line.recv(4096)


def test_a_websocket_stays_open(line_with):
    with line_with(TO_WEBSOCKET) as viewer:
        assert b" 101 " in viewer.recv(4096)
        threading.Event().wait(0.5)
        viewer.sendall(EMPTY_TEXT)
        assert viewer.recv(4096).endswith(b"still here")
