"""Stills are made when they are wanted: the machine, then a real worker and real clients."""

from __future__ import annotations

import json
import os
import signal
import threading

import httpx
import pytest
from hypothesis import given
from hypothesis import strategies as st
from websockets.sync.client import connect

from service.bus import keys
from service.bus.config import BusConfig
from service.bus.keys import Output
from service.bus.zenoh_bus import ZenohBus
from service.config import ServiceConfig
from service.live.fragments import Splitter
from service.streams.player import Player, Playing
from service.streams.states import State
from service.streams.stills import LEASE, STILL_INTERVAL, Stills, Wish
from tests.service.streams.conftest import free_endpoint
from tests.support.on_air import OnAir
from tests.support.waiting import PATIENCE, until

EVENTS = st.lists(
    st.tuples(st.sampled_from(["frame", Wish.ONE, Wish.MORE]), st.floats(0.0, 2 * LEASE)),
    max_size=60,
)


@given(events=EVENTS)
def test_each_frame_is_shown_once_at_most_and_to_those_who_wanted_it_alone(events):
    stills = Stills()
    now, renewed, followed = 0.0, -LEASE, -STILL_INTERVAL
    newest = shown = 0
    for event, later in events:
        now += later
        if event == "frame":
            stills.come()
            newest += 1
            is_made = stills.is_due(now)
            assert not (is_made and now >= renewed + LEASE)
        else:
            renewed = now if event is Wish.MORE else renewed
            is_made = stills.wish(event, now)
            assert event is Wish.MORE or is_made == (newest > shown)
        if is_made:
            assert shown < newest
            assert event is Wish.ONE or now - followed >= STILL_INTERVAL
            shown, followed = newest, now
        elif now < renewed + LEASE and newest > shown:
            assert now - followed < STILL_INTERVAL


def test_who_looks_on_gets_the_last_frame_before_a_pause_too():
    stills = Stills()
    stills.come()
    assert stills.wish(Wish.MORE, 0.0)
    stills.come()
    assert not stills.is_due(STILL_INTERVAL / 2)
    assert stills.wish(Wish.MORE, 2 * STILL_INTERVAL)
    assert not stills.wish(Wish.MORE, 4 * STILL_INTERVAL)
    stills.come()
    assert not stills.is_due(4 * STILL_INTERVAL + LEASE)
    assert stills.end(4 * STILL_INTERVAL + LEASE)


@pytest.fixture
def station(tmp_path):
    """The service in this process, its bus and workers real ones."""
    endpoint = free_endpoint()
    config = ServiceConfig(
        data=tmp_path / "data", workers=0, zenoh="router", zenoh_listen=(endpoint,),
        worker_threads=1, grace=300.0,
    )  # fmt: skip
    with OnAir(config) as station:
        until(lambda: not station.app.state.streams.problem)
        station.endpoint = endpoint
        yield station


class Source:
    """The tiny scene, played by this process."""

    def __init__(self, station, source):
        self._station, self._source = station, source
        self._bus = ZenohBus(BusConfig(connect=(station.endpoint,)))
        self._stop = threading.Event()
        self._thread = None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.pause()
        self._bus.close()

    def play(self):
        self._stop.clear()
        player = Player(
            self._bus, "s", self._source, Playing(rate=self._source.manifest.fps, loop=True)
        )
        self._thread = threading.Thread(target=player.play, args=(self._stop,))
        self._thread.start()

    def pause(self):
        self._stop.set()
        if self._thread is not None:
            self._thread.join()


def test_nobody_looks_and_nothing_is_made_and_who_asks_gets_the_newest(station, source):
    streams, where = station.app.state.streams, "/api/v1/streams/s/watch/result"
    with (
        Source(station, source) as cameras,
        ZenohBus(BusConfig(connect=(station.endpoint,))) as bus,
        httpx.Client(base_url=f"http://{station.address}", timeout=PATIENCE) as api,
    ):

        def got():
            answer = api.get(f"{where}/latest.jpg")
            return answer.content if answer.is_success else b""

        cameras.play()
        result = until(lambda: station.app.state.broadcasts.get("streams/s"))
        until(lambda: result.fragments > 8)
        assert result._num_stills == 0
        assert until(got)[:2] == b"\xff\xd8"

        cameras.pause()
        until(lambda: streams.get("s").state is State.IDLE)
        (answer,) = until(lambda: bus.ask(keys.output("s", Output.SBS_JPEG)))
        picture = answer.read()
        assert until(got) == picture  # though no frame comes any more
        made = result._num_stills
        assert got() == got() == picture
        assert result._num_stills == made

        before = station.app.state.broadcasts.get("streams/s/before")
        assert (before.fragments, before.playlist().count("segment")) == (1, 0)
        assert len(api.get("/api/v1/streams/s/watch").json()["tracks"]) == 2
        address = f"ws://{station.address}/api/v1/streams/s/watch/before/live"
        with connect(address, max_size=None) as viewer:
            assert json.loads(viewer.recv(PATIENCE))["kind"] == "init"
            init, first = Splitter().feed(viewer.recv(PATIENCE) + viewer.recv(PATIENCE))
            newest = result._segments[-1].fragments[-1]
            assert (init.timescale, first.start) == (result.newest_init.timescale, newest.start)

        with api.stream("GET", f"{where}/stills") as viewer:
            chunks = viewer.iter_bytes()
            seen = b""
            while picture not in seen:  # the first, and at once
                seen += next(chunks)
            assert seen.count(b"Content-Type: image/jpeg") == 1
            cameras.play()
            while seen.count(b"Content-Type: image/jpeg") < 4:
                seen += next(chunks)
        until(lambda: not result.viewers_of_stills)

        def is_still():
            made, frames = result._num_stills, result.fragments
            until(lambda: result.fragments > frames + 5)
            return result._num_stills == made

        until(is_still)
        until(lambda: "#EXTINF" in api.get(f"{where}/index.m3u8".replace("result", "before")).text)

        cameras.pause()
        lost = streams.get("s").run
        os.kill(streams.get("s").process.pid, signal.SIGKILL)
        until(lambda: streams.get("s").run > lost)
        assert got() == b""  # what it made last is lost, and what it showed is older
        cameras.play()
        assert until(got)

        cameras.pause()
        streams.get("s").options["idle"] = 1.0
        until(lambda: streams.get("s").state is State.WAITING and not streams.get("s").process)
        assert got()  # the worker has left its last picture behind
