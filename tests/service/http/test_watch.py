"""Watching over HTTP and WebSocket: jobs from the disk, streams from the air, who may."""

from __future__ import annotations

import asyncio
import functools
import json
import re
import socket
import subprocess

import httpx
import numpy as np
import pytest
import websockets.asyncio.client
import websockets.sync.client
from websockets.exceptions import InvalidStatus

from service.config import ServiceConfig
from service.live.fragments import Fragment, Init, Splitter
from service.live.job_watch import JobWatch
from service.live.track import TrackInfo, TrackWriter
from tests.support.on_air import OnAir
from tests.support.service_api import follow, is_problem
from tests.support.waiting import PATIENCE, until

connect = functools.partial(websockets.sync.client.connect, open_timeout=PATIENCE)
open_socket = functools.partial(websockets.asyncio.client.connect, open_timeout=PATIENCE)

TOKENS = """
reader read  a-token-for-reading-it
sender submit  a-token-for-sending-it
"""


@pytest.fixture(scope="module")
def done(api):
    """A finished job of six frames in segments of two."""
    body = {"scene": "tiny", "output": {"segment_length": 2, "layout": "anaglyph"}}
    job = api.post("/api/v1/jobs", json=body).json()["id"]
    follow(api, job)
    return f"/api/v1/jobs/{job}/watch"


def _count_frames(url):
    command = ["ffprobe", "-v", "error", "-count_frames", "-show_entries", "stream=nb_read_frames"]
    answer = subprocess.run([*command, "-of", "json", url], capture_output=True, check=True)
    return int(json.loads(answer.stdout)["streams"][0]["nb_read_frames"])


def test_a_finished_job_is_a_video_on_demand(api, done):
    seen = api.get(done).json()
    assert (seen["state"], seen["frames_total"]) == ("ended", 6)
    assert set(seen["tracks"]) == {"result", "before"}
    result, before = seen["tracks"]["result"], seen["tracks"]["before"]
    assert (result["layout"], result["fps"], result["frames"]) == ("sbs", 12.0, 6)
    assert (result["eye_width"], result["eye_height"]) == (96, 72)
    assert (before["eye_width"], before["eye_height"]) == (48, 36)
    assert result["codec"].startswith("avc1.64")
    assert result["live"] is None
    playlist = api.get(result["playlist"])
    assert playlist.headers["content-type"] == "application/vnd.apple.mpegurl"
    assert playlist.text.endswith("#EXT-X-ENDLIST\n")
    tag = playlist.headers["etag"]
    assert api.get(result["playlist"], headers={"If-None-Match": tag}).status_code == 304
    for track in (result, before):
        assert _count_frames(str(api.base_url.join(track["playlist"]))) == 6


def test_parts_of_a_job(api, done):
    init = api.get(f"{done}/result/init-0.mp4")
    part = api.get(f"{done}/result/segment-000001.m4s")
    assert part.headers["content-type"] == "video/mp4"
    found = Splitter().feed(init.content + part.content)
    assert [type(item) for item in found] == [Init, Fragment, Fragment]
    assert api.get(f"{done}/result/segment-000002.jpg").content.startswith(b"\xff\xd8")
    newest = api.get(f"{done}/result/latest.jpg")
    assert newest.content == api.get(f"{done}/result/segment-000002.jpg").content
    for name in ("segment-000003.m4s", "init-1.mp4", "track.json", "segment-*.m4s"):
        is_problem(api.get(f"{done}/result/{name}"), 404, "not-found")
    assert api.get(f"{done}/sideways/init-0.mp4").status_code == 422


def test_stills_of_a_finished_job_run_through_and_end(api, done):
    answer = api.get(f"{done}/before/stills")
    assert answer.headers["content-type"].startswith("multipart/x-mixed-replace")
    assert answer.content.count(b"Content-Type: image/jpeg") == 3
    assert answer.content.endswith(b"--picture\r\n")


def test_nothing_to_watch_yet(make_service, tiny_scene):
    service = make_service("--workers", "0", "--roots", str(tiny_scene.parent))
    with httpx.Client(base_url=service.url, timeout=PATIENCE) as api:
        job = api.post("/api/v1/jobs", json={"scene": "tiny"}).json()["id"]
        where = f"/api/v1/jobs/{job}/watch"
        assert api.get(where).json()["state"] == "waiting"
        assert api.get(where).json()["tracks"] == {}
        for what in ("result/index.m3u8", "result/stills", "result/latest.jpg"):
            is_problem(api.get(f"{where}/{what}"), 404, "not-found")
        is_problem(api.get("/api/v1/jobs/none/watch"), 404, "not-found")
        is_problem(api.get("/api/v1/streams/none/watch"), 404, "not-found")


@pytest.fixture
def on_air(tmp_path):
    with OnAir(ServiceConfig(data=tmp_path / "data", workers=0, zenoh="off")) as station:
        yield station


def test_a_stream_at_its_live_edge(on_air):
    on_air.feed(20)
    with connect(f"ws://{on_air.address}/api/v1/streams/room/watch/result/live") as viewer:
        head = json.loads(viewer.recv(PATIENCE))
        assert head["kind"] == "init"
        assert head["codec"].startswith("avc1.")
        data = viewer.recv(PATIENCE)
        data += b"".join(viewer.recv(PATIENCE) for _ in range(4))
        on_air.feed(10)
        data += b"".join(viewer.recv(PATIENCE) for _ in range(10))
        on_air.broadcast.close()
        assert json.loads(viewer.recv(PATIENCE)) == {"kind": "end"}
    _, *parts = Splitter().feed(data)
    assert [part.start * 15 // 15360 for part in parts] == list(range(15, 29))


def test_a_stream_by_hls_and_stills(on_air):
    where = "/api/v1/streams/room/watch"
    with httpx.Client(base_url=f"http://{on_air.address}", timeout=PATIENCE) as api:
        assert api.get(where).json()["state"] == "waiting"
        on_air.feed(50)
        seen = api.get(where).json()
        assert seen["state"] == "live"
        track = seen["tracks"]["result"]
        assert (track["eye_width"], track["eye_height"], track["frames"]) == (32, 32, None)
        assert track["live"] == "/api/v1/streams/room/watch/result/live"
        listed = api.get(f"{where}/result/index.m3u8").text
        names = re.findall(r"^\w\S+$", listed, re.M)
        parts = [api.get(f"{where}/result/{name}") for name in ["init-0.mp4", *names]]
        assert len(Splitter().feed(b"".join(part.content for part in parts))) == 1 + 45
        assert all(int(part.headers["content-length"]) == len(part.content) for part in parts)
        assert api.get(f"{where}/result/latest.jpg").content.startswith(b"\xff\xd8")
        with api.stream("GET", f"{where}/result/stills") as pictures:
            chunks = pictures.iter_bytes()
            seen_bytes = b""
            while b"\r\n--picture" not in seen_bytes:
                seen_bytes += next(chunks)
        assert api.get(f"{where}/result/segment-000099.m4s").status_code == 404


def test_a_job_that_ended_offers_no_live_edge_though_its_worker_still_hangs_up(
    tmp_path, tiny_scene
):
    roots = (tiny_scene.parent,)
    config = ServiceConfig(data=tmp_path / "data", workers=0, zenoh="off", roots=roots)
    with (
        OnAir(config) as station,
        httpx.Client(base_url=f"http://{station.address}", timeout=PATIENCE) as api,
    ):
        job = api.post("/api/v1/jobs", json={"scene": "tiny"}).json()["id"]
        watch = JobWatch(config.data, station.app.state.broadcasts)
        folder = config.data / "jobs" / job / "watch" / "result"
        info = TrackInfo(fps="15/1", layout="sbs", eye_width=32, eye_height=32, first_frame=0)
        writer = TrackWriter(
            folder, info, number=0, frame=0, crf=20,
            on_piece=lambda number: watch.take(job, {"track": "result", "number": number}),
        )  # fmt: skip
        writer.add(station.picture)
        writer.finish()
        where = f"/api/v1/jobs/{job}/watch"
        growing = api.get(where).json()
        assert growing["state"] == "growing"
        assert growing["tracks"]["result"]["live"] == f"{where}/result/live"
        assert api.post(f"/api/v1/jobs/{job}/cancel").json()["state"] == "cancelled"
        ended = api.get(where).json()
        assert ended["state"] == "ended"
        assert ended["tracks"]["result"]["live"] is None


def test_fifty_viewers_of_whom_one_never_reads(on_air):
    """Everybody who reads gets every frame; the one who does not holds nobody up."""
    on_air.picture = np.random.default_rng(1).integers(0, 256, (90, 320, 3), np.uint8)
    on_air.feed(2)
    url = f"ws://{on_air.address}/api/v1/streams/room/watch/result/live"
    counts = [0] * 49

    async def view(number):
        async with open_socket(url, max_queue=None) as viewer:
            async for message in viewer:
                counts[number] += isinstance(message, bytes)

    async def lazy():
        narrow = socket.socket()
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        narrow.connect(on_air.server.servers[0].sockets[0].getsockname())
        narrow.setblocking(False)
        async with open_socket(url, max_queue=1, sock=narrow, close_timeout=0.1):
            await ended.wait()

    async def everybody():
        nonlocal ended
        ended = asyncio.Event()
        stalled = asyncio.create_task(lazy())
        viewers = [asyncio.create_task(view(number)) for number in range(49)]
        while on_air.broadcast.viewers < 50:
            await asyncio.sleep(0.05)
        for fed in range(1, 31):
            await asyncio.to_thread(on_air.feed, 1)
            while min(counts) < 2 + fed:
                await asyncio.sleep(0.01)
        on_air.broadcast.close()
        await asyncio.gather(*viewers)
        ended.set()
        await stalled

    ended = None
    asyncio.run(asyncio.wait_for(everybody(), PATIENCE))
    assert counts == [32] * 49  # an init segment and 31 fragments
    until(lambda: on_air.broadcast.viewers == 0)


def test_a_viewer_that_is_cut_off_is_forgotten(on_air):
    on_air.feed(3)
    with connect(f"ws://{on_air.address}/api/v1/streams/room/watch/result/live") as viewer:
        viewer.recv(PATIENCE)
        assert on_air.broadcast.viewers == 1
        viewer.socket.shutdown(socket.SHUT_RDWR)  # no goodbye
    until(lambda: on_air.broadcast.viewers == 0)


def test_a_page_whose_name_was_made_to_mean_this_machine_watches_nothing(on_air):
    on_air.feed(3)
    port = int(on_air.address.rpartition(":")[2])
    for name in ("localhost", "evil.example"):
        line = socket.create_connection(("127.0.0.1", port))
        url = f"ws://{name}:{port}/api/v1/streams/room/watch/result/live"
        if name == "localhost":
            with connect(url, sock=line, origin=f"http://{name}:{port}") as viewer:
                assert viewer.recv(PATIENCE)
        else:
            with pytest.raises(InvalidStatus):
                connect(url, sock=line, origin=f"http://{name}:{port}")


def test_who_may_watch(tmp_path):
    (tmp_path / "tokens").write_text(TOKENS)
    config = ServiceConfig(
        data=tmp_path / "data", workers=0, zenoh="off", token_file=tmp_path / "tokens"
    )
    with OnAir(config) as station:
        station.feed(3)
        where = "/api/v1/streams/room/watch"
        url = f"ws://{station.address}{where}/result/live"
        for headers in (
            {},
            {"Authorization": "Bearer a-token-for-sending-it"},
            {"Cookie": "depthsr_token=a-token-that-is-wrong"},
        ):
            with pytest.raises(InvalidStatus) as refused, connect(url, additional_headers=headers):
                pass
            assert refused.value.response.status_code == 403
        good = {"Cookie": "depthsr_token=a-token-for-reading-it"}
        with pytest.raises(InvalidStatus), connect(
            url, additional_headers=good, origin="http://elsewhere.example"
        ):  # fmt: skip
            pass
        with connect(url, additional_headers=good, origin=f"http://{station.address}") as viewer:
            assert json.loads(viewer.recv(PATIENCE))["kind"] == "init"
        with httpx.Client(base_url=f"http://{station.address}", timeout=PATIENCE) as api:
            is_problem(api.get(where), 401, "unauthorized")
            assert api.get(where, headers=good).json()["state"] == "live"
