from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.bus.bus import JSON
from service.bus.memory import MemoryNetwork
from service.config import ServiceConfig
from service.live.broadcast import Broadcasts
from service.streams.states import Action, State, TransitionError, after
from service.streams.stream import KeptStreams
from service.streams.streams import (
    NoSuchStreamError,
    StreamRefusedError,
    Streams,
    TooManyStreamsError,
)
from tests.support.waiting import until

MANIFEST = {"format": "depthsr-scene/1", "fps": "15/1", "views": [{"id": "a"}, {"id": "b"}]}


def make(folder, **more):
    def never(config):
        raise AssertionError("no bus is opened here")

    config = ServiceConfig(data=folder, **more)
    return Streams(config, open_bus=never, broadcasts=Broadcasts())


def test_streams_made_over_http_outlive_the_service(tmp_path):
    before = make(tmp_path)
    before.create("one", "ann", manifest=MANIFEST, settings={"magnification": "3"})
    before.create("two", "bob", options={"wait": 0.5})
    before.stop("two")
    (tmp_path / "streams" / "torn.json").write_text('{"id": "to')
    kept = {item.id: item for item in KeptStreams(tmp_path / "streams").all()}
    assert set(kept) == {"one", "two"}
    assert (kept["one"].client, kept["one"].settings) == ("ann", {"magnification": "3"})
    assert kept["one"].manifest.content == before.get("one").manifest.content
    assert (kept["two"].state, kept["two"].options) == (State.STOPPED, {"wait": 0.5})
    before.remove("one")
    assert [item.id for item in KeptStreams(tmp_path / "streams").all()] == ["two"]


def test_who_asks_hears_of_streams_without_a_worker(tmp_path):
    network = MemoryNetwork()
    config = ServiceConfig(data=tmp_path, workers=0)
    streams = Streams(config, open_bus=lambda _: network.connect(), broadcasts=Broadcasts())
    bus = network.connect()
    heard = []
    bus.subscribe("depthsr/*/status", lambda sample: heard.append(json.loads(sample.read())))
    streams.start()
    try:
        streams.create("one", "ann")
        assert [(item["stream"], item["state"]) for item in heard] == [("one", "waiting")]
        streams.stop("one")
        (answer,) = bus.ask("depthsr/one/status")
        assert json.loads(answer.read())["state"] == "stopped"
        assert len(bus.ask("depthsr/*/status")) == 1
        assert bus.ask("depthsr/two/status") == []
        heard.clear()  # its source comes later, and is told at each manifest
        bus.put("depthsr/one/in/manifest", json.dumps(MANIFEST).encode(), encoding=JSON)
        until(lambda: heard)
        assert heard[-1]["state"] == "stopped"
        streams.create("one", "ann", manifest=MANIFEST)
        until(lambda: streams.get("one").process)  # which has not said anything yet
        (answer,) = bus.ask("depthsr/one/status")
        assert json.loads(answer.read())["state"] == "starting"
    finally:
        streams.close()


def test_what_cannot_be_made_is_refused(tmp_path):
    streams = make(tmp_path, max_streams=1)
    streams.create("one", "ann")
    with pytest.raises(StreamRefusedError, match="stop it first"):
        streams.create("one", "ann")
    with pytest.raises(TooManyStreamsError):
        streams.create("two", "ann")
    with pytest.raises(NoSuchStreamError):
        streams.stop("none")
    streams.stop("one")
    streams.create("two", "ann")


@given(actions=st.lists(st.sampled_from(Action), max_size=20))
def test_a_stopped_stream_does_nothing_until_it_begins_anew(actions):
    state = State.WAITING
    for action in actions:
        try:
            following = after(state, action)
        except TransitionError:
            continue
        if state in (State.STOPPED, State.FAILED):
            assert following is state or action in (Action.BEGIN, Action.STOP)
        state = following
