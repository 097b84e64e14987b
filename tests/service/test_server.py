"""Connections of a server whose heads must come in time."""

from __future__ import annotations

import socket
import threading

import pytest
import uvicorn
from websockets.sync.client import connect

from service import server
from service.server import PunctualProtocol
from tests.support.waiting import PATIENCE, until

WHOLE = b"GET / HTTP/1.1\r\nHost: x\r\n\r\n"


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
def port(monkeypatch):
    monkeypatch.setattr(server, "HEAD_PATIENCE", 0.2)
    settings = uvicorn.Config(
        app, port=0, log_config=None, lifespan="off", http=PunctualProtocol, timeout_keep_alive=60
    )
    running = uvicorn.Server(settings)
    thread = threading.Thread(target=running.run)
    thread.start()
    until(lambda: running.started)
    yield running.servers[0].sockets[0].getsockname()[1]
    running.should_exit = True
    thread.join()


def line_to(port):
    return socket.create_connection(("127.0.0.1", port), timeout=PATIENCE)


@pytest.mark.parametrize(("before", "begun"), [(b"", b""), (b"", WHOLE[:9]), (WHOLE, WHOLE[:9])])
def test_who_does_not_end_a_head_is_let_go(port, before, begun):
    with line_to(port) as line:
        if before:
            line.sendall(before)
            assert b"204" in line.recv(4096)
        line.sendall(begun)
        assert line.recv(4096) == b""


def test_who_takes_time_for_a_body_or_between_requests_is_not(port):
    wait = threading.Event().wait
    with line_to(port) as line:
        line.sendall(b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: 2\r\n\r\na")
        wait(0.5)
        line.sendall(b"b")
        assert b"204" in line.recv(4096)
        wait(0.5)
        line.sendall(WHOLE)
        assert b"204" in line.recv(4096)


def test_a_websocket_stays_open(port):
    with connect(f"ws://127.0.0.1:{port}/") as viewer:
        threading.Event().wait(0.5)
        viewer.send("well?")
        assert viewer.recv(PATIENCE) == "still here"
