"""A stream at work within one process: cameras with faults, the session, what comes out."""

from __future__ import annotations

import contextlib
import io
import json
import threading
import time
from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest

from pipeline import realtime
from pipeline.config import Settings
from pipeline.media.layouts import describe_path
from pipeline.media.live_source import LiveSource
from pipeline.realtime import Controller, ladder
from pipeline.synthetic.scene import SampleScene
from pipeline.synthetic.writing import write_scene
from pipeline.worker import Worker
from service.bus import keys
from service.bus.keys import Output
from service.bus.memory import MemoryNetwork
from service.streams import stills
from service.streams.options import StreamOptions
from service.streams.player import Player, Playing
from service.streams.receiver import Receiver, split_group
from service.streams.session import Limits, StreamSession
from service.streams.stills import Wish
from tests.support.waiting import PATIENCE, until


@pytest.fixture
def network():
    return MemoryNetwork()


class Clock:
    """Seconds that pass, except while it is held: however slow the machine is just then."""

    def __init__(self):
        self._behind, self._held_at = 0.0, None

    def __call__(self):
        return self._held_at or time.monotonic() - self._behind

    @contextlib.contextmanager
    def held(self):
        self._held_at = self()
        yield
        self._behind, self._held_at = time.monotonic() - self._held_at, None


CLOCK = Clock()
"""Of sessions: a frame whose parts are sent one after the other is sent at once."""


def run(network, source, *, options, settings=None, playing=None, frames=None, sent=None):
    """Play the scene through a session; return the session after its last frame."""
    bus = network.connect()
    pictures = []
    session = StreamSession(
        bus, "s", source.manifest, settings=settings or Settings(psf_sigma=1.0, noise_sigma=1.0),
        options=options, limits=Limits(max_rate=1000), clock=CLOCK,
        to_service=lambda kind, data: pictures.append((kind, data)),
    )  # fmt: skip
    worker = threading.Thread(target=session.run)
    worker.start()
    try:
        until(lambda: bus.who_lives(keys.alive("s")))
        until(lambda: network.connect().publisher(
            "depthsr/s/in/cam0/color", encoding="").has_subscribers)  # fmt: skip
        if sent is not None:
            sent(network.connect(), session)
        else:
            Player(network.connect(), "s", source, playing).play(threading.Event())
        until(lambda: session.status()["frames_done"] >= (frames or 1))
    finally:
        session.stop()
        worker.join(PATIENCE)
    assert not worker.is_alive()
    session.pictures = pictures
    return session


def one_by_one(source, *, spoil=lambda index, parts: parts, wish=None):
    """Return what sends each frame when the one before it is done, and first a wish."""
    from service.bus.keys import Part
    from service.streams.messages import InputHeader, write_input_header

    def send(bus, session):
        if wish is not None:
            session.wish(wish)
        for number, index in enumerate(source.frame_indices):
            pictures = spoil(index, source.read(index))
            header = InputHeader(frame_index=index, capture_time_ns=number * 10**8)
            with CLOCK.held():
                for (view, part), item in pictures.items():
                    bus.put(
                        keys.input_key("s", view, Part(part)), item.data,
                        encoding=item.encoding.value, attachment=write_input_header(header),
                    )  # fmt: skip
            until(lambda number=number: len(session._history) == number + 1)

    return send


def test_what_comes_out_is_what_the_worker_makes(network, source, tiny_scene, monkeypatch):
    from pipeline.media.source import open_scene

    monkeypatch.setattr(stills, "LEASE", PATIENCE)
    settings = Settings(psf_sigma=1.0, noise_sigma=1.0, temporal="warm")
    made = []
    bus = network.connect()
    bus.subscribe(keys.output("s", Output.SBS), lambda s: made.append(json.loads(s.attachment)))
    receiver = Receiver(network.connect(), "s")
    session = run(
        network, source, options=StreamOptions(real_time=False, wait=0.5), settings=settings,
        sent=one_by_one(source, wish=Wish.BEFORE), frames=6,
    )  # fmt: skip
    with open_scene(tiny_scene) as scene:
        info = scene.info
        worker = Worker(settings, targets=(info.left, info.right))
        for frame in scene.frames():
            last = worker.take(frame)
    from service.streams.outlets import picture_of

    pair = info.left, info.right
    for picture, view in zip(session._outlets._eyes.pictures, pair, strict=True):
        assert np.array_equal(picture, picture_of(last.images[view]))
    assert [item["sequence"] for item in made] == list(range(6))
    assert [item["frame_index"] for item in made] == list(source.frame_indices)
    assert made[0]["key"]
    assert {kind for kind, _ in session.pictures} == {"mp4", "jpeg", "before", "pause"}
    (last,) = [data for kind, data in session.pictures if kind == "jpeg"]  # as nobody looked
    (answer,) = bus.ask(keys.output("s", Output.SBS_JPEG))
    assert answer.read() == last
    beside = b"".join(data for kind, data in session.pictures if kind == "before")
    with av.open(io.BytesIO(beside)) as video:
        shown = [item.to_ndarray(format="rgb24").astype(int) for item in video.decode(video=0)]
    assert len(shown) == 6
    half = shown[-1][:, : shown[-1].shape[1] // 2]
    apart = [
        np.abs((half - picture_of(frame.view(view))) @ [0.2126, 0.7152, 0.0722]).mean()
        for view in (info.left, info.right)
    ]  # of luma: the colour of so small a picture has half its size
    assert apart[0] < 0.2 * apart[1]
    (answer,) = bus.ask(keys.output("s", Output.SBS))
    units = [json.loads(attachment) for attachment, _ in split_group(answer)]
    assert units[0]["key"]
    assert units[-1]["sequence"] == 5
    stop = threading.Event()
    assert len(list(receiver.units(stop=stop, timeout=0.1))) >= len(units)


def test_missing_and_broken_parts_cost_what_the_rules_say(network, source):
    def spoil(index, parts):
        number = index - source.frame_indices.start
        left = dict(parts)
        if number == 1:
            del left["cam0", "depth"]
        if number == 2:
            del left["cam0", "color"]
        if number == 3:
            broken = replace(left["cam2", "depth"], data=b"\x89PNG\r\n\x1a\nbroken")
            left["cam2", "depth"] = broken
        if number == 4:
            left["cam1", "color"] = replace(left["cam1", "color"], data=b"no picture")
        return left

    session = run(
        network, source, options=StreamOptions(wait=0.5, missing_view="use", real_time=False),
        sent=one_by_one(source, spoil=spoil), frames=5,
    )  # fmt: skip
    beside = b"".join(data for kind, data in session.pictures if kind == "before")
    with av.open(io.BytesIO(beside)) as video:  # nobody wants more than to know what it is
        assert len(list(video.decode(video=0))) == 1
    status = session.status()
    counts = status["counts"]
    assert (status["frames_done"], status["frames_failed"], status["pictures_refused"]) == (5, 1, 2)
    assert (counts["frames_without_depth"], counts["frames_without_view"]) == (1, 1)
    assert counts["malformed"] == 2
    history = session._asked_history(type("Q", (), {"parameters": "limit=3"}))
    assert "cam1" in history[1]["problem"]
    assert [item["problem"] is None for item in history] == [True, False, True]
    assert json.dumps(status)


def test_a_source_faster_than_the_machine_loses_frames_and_quality_but_goes_on(network, source):
    playing = Playing(rate=Fraction(200), loop=True, jitter=0.02, loss=0.05, seed=3)
    fast = LiveSource(source._scene, fps=Fraction(200))

    def send(bus, session):
        stop = threading.Event()
        player = Player(bus, "s", fast, playing)
        thread = threading.Thread(target=player.play, args=(stop,))
        thread.start()
        until(lambda: session.status()["frames_done"] >= 25)
        stop.set()
        thread.join(PATIENCE)
        assert player.lost > 0

    with fast:
        options = StreamOptions(wait=0.05, window=16)
        session = run(network, fast, options=options, sent=send, frames=25)
    status = session.status()
    counts = status["counts"]
    assert status["frames_failed"] == 0
    assert counts["frames_behind"] > 0
    assert counts["frames_without_depth"] + counts["frames_incomplete"] > 0
    assert len(status["frames_by_effort"]) > 1
    assert sum(status["frames_by_effort"].values()) == status["frames_done"]


@pytest.mark.parametrize("by_depth", [False, True])
def test_after_a_cut_motions_are_found_anew_between_frames(
    by_depth, network, tmp_path, monkeypatch
):
    scenes = []
    for seed in (0, 5):
        scene = SampleScene(width=96, height=72, num_views=3, seed=seed)
        scenes.append(tmp_path / str(seed))
        write_scene(scenes[-1], scene, num_frames=20)
    kept = next(
        level
        for level, rung in enumerate(ladder(3, has_depth=True))
        if rung.keeps_motions and rung.effort.by_depth is by_depth
    )
    end, find = Controller.end, StreamSession._find_motions

    def end_on_the_rung(controller, *arguments):
        end(controller, *arguments)
        controller.level = kept

    def find_and_note(session, *arguments):
        find(session, *arguments)
        told.append((session._worker.lacks_motions, session._worker.finds_motions))

    def cut(index, parts):
        return parts if index < 6 else other.read(index)

    monkeypatch.setattr(Controller, "end", end_on_the_rung)
    monkeypatch.setattr(StreamSession, "_find_motions", find_and_note)
    # whatever the machine is busy with: no frame is late, and each is followed by a step
    monkeypatch.setattr(realtime, "PATIENCE", np.inf)
    monkeypatch.setattr(Controller, "may_find", lambda controller, left: True)
    monkeypatch.setattr(Controller, "may_find_more", lambda controller, left: False)
    told = []

    with (
        LiveSource(describe_path(scenes[0]), fps=Fraction(10)) as source,
        LiveSource(describe_path(scenes[1]), fps=Fraction(10)) as other,
    ):
        session = run(
            network, source, options=StreamOptions(wait=5.0),
            settings=Settings(psf_sigma=1.0, noise_sigma=1.0, temporal="warm"),
            sent=one_by_one(source, spoil=cut), frames=20,
        )  # fmt: skip
    assert session.status()["frames_failed"] == 0
    lacking = [number for number, (lacks, _) in enumerate(told) if lacks]
    assert lacking[0] == 6
    assert any(finds for _, finds in told)
    assert not any(told[-1])
    efforts = [item["effort"] for item in session._history]
    assert set(efforts[6:]) == {str(session._controller.rungs[kept])}, "none is made in full"
