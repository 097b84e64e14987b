"""One stream through everything that can go wrong around it, with real processes."""

from __future__ import annotations

import json
import os
import signal
import time

import av
import httpx
import pytest

from service.bus import keys
from service.bus.bus import JPEG, JSON, PNG, RAW
from service.bus.keys import Output, Part
from service.streams.messages import InputHeader, write_input_header
from service.streams.receiver import Receiver
from tests.service.conftest import LiveService
from tests.service.streams.conftest import Stage, free_endpoint
from tests.support.waiting import PATIENCE, until


@pytest.fixture(scope="module")
def stage(tmp_path_factory, tiny_scene):
    """A service, and a scene that is played in a loop, with jitter."""
    folder = tmp_path_factory.mktemp("faults")
    endpoint = free_endpoint()
    options = (
        "--zenoh", "router", "--zenoh-listen", endpoint, "--worker-threads", "1",
        "--max-payload", "1", "--max-rate", "30", "--max-streams", "1", "--grace", "300",
    )  # fmt: skip
    service = LiveService(folder / "data", options)
    stage = Stage(service, endpoint)
    try:
        service.start()
        stage.run(
            "publish", str(tiny_scene), "--stream", "tiny", "--rate", "6", "--loop",
            "--jitter", "0.18", "--loss", "0.02",
        )  # fmt: skip
        until(lambda: stage.state("tiny") == "live")
        yield stage
    finally:
        stage.end()
        if service.process is not None and service.process.poll() is None:
            service.end(signal.SIGKILL)


def _counts(stage):
    return stage.status("tiny")["status"]["counts"]


def _units(stage, count, stream="tiny"):
    """Receive so many access units in this process."""
    import threading

    stop = threading.Event()
    found = []
    with stage.bus() as bus:
        for unit in Receiver(bus, stream).units(stop=stop, timeout=PATIENCE):
            found.append(unit)
            if len(found) == count:
                break
    return found


def _decoded(units):
    decoder = av.CodecContext.create("h264", "r")
    frames = [frame for unit in units for frame in decoder.decode(av.Packet(unit.data))]
    return frames + decoder.decode(None)


def test_who_joins_late_can_decode_from_the_first_message(stage):
    units = _units(stage, 8)
    assert units[0].is_key
    sequences = [unit.sequence for unit in units]
    assert sequences == list(range(sequences[0], sequences[0] + 8))
    frames = _decoded(units)
    assert len(frames) == 8
    assert {(frame.width, frame.height) for frame in frames} == {(units[0].width, units[0].height)}


def test_what_is_lost_and_in_disorder_is_counted_and_the_rest_goes_on(stage):
    def is_counted():
        counts = _counts(stage)
        return counts["frames_without_depth"] + counts["frames_incomplete"]

    until(is_counted)
    status = stage.status("tiny")["status"]
    assert status["frames_done"] > 0
    assert status["frames_failed"] == 0


def test_browsers_get_the_same_video(stage):
    where = f"{stage.service.url}/api/v1/streams/tiny/watch"
    until(lambda: len(httpx.get(where, timeout=PATIENCE).json()["tracks"]) == 2)
    tracks = httpx.get(where, timeout=PATIENCE).json()["tracks"]
    before, track = tracks["before"], tracks["result"]
    assert (track["layout"], track["fps"]) == (before["layout"], before["fps"]) == ("sbs", 6.0)
    assert (before["eye_width"], track["eye_width"]) == (48, 96)
    playlist = f"{stage.service.url}{track['playlist']}"
    until(lambda: "#EXTINF" in httpx.get(playlist, timeout=PATIENCE).text)


def test_simple_clients_get_pictures_and_answers(stage):
    with stage.bus() as bus:
        seen = {}
        for which in (Output.SBS_JPEG, Output.LEFT, Output.RIGHT):
            bus.subscribe(keys.output("tiny", which), lambda s, w=which: seen.update({w: s}))
        until(lambda: len(seen) == 3)
        for which, sample in seen.items():
            said = json.loads(sample.attachment)
            decoder = av.CodecContext.create("mjpeg", "r")
            (frame,) = decoder.decode(av.Packet(sample.read()))
            assert sample.encoding == JPEG
            assert (frame.width, frame.height) == (said["width"], said["height"])
            assert said["layout"] == ("sbs" if which is Output.SBS_JPEG else which.value)
            (answer,) = until(lambda which=which: bus.ask(keys.output("tiny", which)))
            assert answer.read()[:2] == b"\xff\xd8"
        (info,) = until(lambda: bus.ask(keys.info("tiny")))
        assert (
            json.loads(info.read())["width"]
            == json.loads(seen[Output.SBS_JPEG].attachment)["width"]
        )
        until(lambda: stage.status("tiny")["status"]["frames_done"] >= 3)
        (history,) = until(lambda: bus.ask(f"{keys.history('tiny')}?limit=3"))
        assert len(json.loads(history.read())) == 3
        assert list(until(lambda: bus.who_lives(keys.alive("tiny")))) == [keys.alive("tiny")]
        (streams,) = until(lambda: bus.ask(keys.SERVICE))
        assert [item["stream"] for item in json.loads(streams.read())] == ["tiny"]


def test_what_is_malformed_is_counted_and_harms_nobody(stage):
    before = _counts(stage)
    good = write_input_header(InputHeader(frame_index=1 << 40, capture_time_ns=1))
    raw = write_input_header(
        InputHeader(frame_index=1 << 40, capture_time_ns=1, width=9, height=9, pixel_format="gray")
    )
    color = keys.input_key("tiny", "cam0", Part.COLOR)
    with stage.bus() as bus:

        def send(number):
            bus.put(color, os.urandom(5000), encoding=JPEG, attachment=good)
            bus.put(color, b"", encoding="text/plain", attachment=good)
            bus.put(color, b"x", encoding=PNG, attachment=b"{")
            bus.put(color, b"x", encoding=PNG, attachment=b"%d" % number)
            bus.put(color, b"x", encoding=RAW, attachment=raw)
            bus.put("depthsr/tiny/in/cam0/smell", b"x", encoding=PNG, attachment=good)
            bus.put("depthsr/tiny/in/nobody/color", b"x", encoding=PNG, attachment=good)
            bus.put(f"depthsr/bad{number}/in/manifest", os.urandom(100), encoding=JSON)

        def is_counted(name, more):
            return _counts(stage)[name] >= before[name] + more

        for number in range(20):
            send(number)
        until(lambda: is_counted("malformed", 80) or send(20))  # what a busy router drops
        until(lambda: is_counted("parts_unknown", 20) or send(20))
        refused = []
        bus.subscribe(keys.status("other"), lambda s: refused.append(json.loads(s.read())))
        manifest = {"format": "depthsr-scene/1", "views": [{"id": "a"}, {"id": "b"}]}

        def is_refused():
            bus.put("depthsr/other/in/manifest", json.dumps(manifest).encode(), encoding=JSON)
            return refused

        until(is_refused)

        def is_too_large():
            bus.put(color, bytes(1_060_000), encoding=JPEG, attachment=good)
            return _counts(stage)["too_large"] > before["too_large"]

        until(is_too_large)
    assert refused[0]["state"] == "refused"
    assert "1 streams are there already" in refused[0]["problem"]["detail"]
    done = stage.status("tiny")["status"]["frames_done"]
    until(lambda: stage.status("tiny")["status"]["frames_done"] > done + 5)
    assert stage.status("tiny")["run"] == 1

    def numbers():
        return httpx.get(f"{stage.service.url}/metrics", timeout=PATIENCE).text

    until(lambda: 'depthsr_streams{state="live"} 1.0' in numbers())  # idle, where the source lags
    assert 'depthsr_stream_dropped_total{reason="malformed",stream="tiny"}' in numbers()
    assert "depthsr_manifests_refused_total" in numbers()


def test_a_flood_is_dropped_before_it_is_copied(stage):
    before = _counts(stage)["too_many"]
    header = write_input_header(InputHeader(frame_index=5, capture_time_ns=1))
    with stage.bus() as bus:
        publisher = bus.publisher(keys.input_key("tiny", "cam1", Part.COLOR), encoding=PNG)

        def flooded():
            for _ in range(500):
                publisher.put(bytes(2_000), header)
            return _counts(stage)["too_many"] > before

        until(flooded)
    done = stage.status("tiny")["status"]["frames_done"]
    until(lambda: stage.status("tiny")["status"]["frames_done"] > done + 5)


def test_a_killed_worker_is_replaced_and_the_gap_is_seen(stage, tmp_path):
    target = tmp_path / "out.mkv"
    receiver = stage.run("subscribe", "tiny", "-o", str(target))
    assert "frames a second" in receiver.stderr.readline()
    os.kill(until(lambda: stage.worker("tiny")), signal.SIGKILL)
    assert "started anew" in receiver.stderr.readline()
    assert stage.status("tiny")["run"] == 2
    until(lambda: stage.status("tiny")["status"].get("frames_done", 0) > 5)
    receiver.send_signal(signal.SIGINT)
    _, said = receiver.communicate(timeout=PATIENCE)
    assert receiver.returncode == 0, said
    with av.open(str(target)) as container:
        assert sum(1 for _ in container.decode(video=0)) > 1
    text = httpx.get(f"{stage.service.url}/metrics", timeout=PATIENCE).text
    assert "depthsr_stream_workers_lost_total 1.0" in text


def test_a_killed_service_goes_on_where_its_subscribers_are(stage):
    """Sequences go on, so that nobody takes what is new for what it has."""
    numbers = []
    with stage.bus() as bus:

        def hear(sample):
            said = json.loads(sample.attachment)
            numbers.append((said["run"], said["sequence"]))

        bus.subscribe(keys.output("tiny", Output.SBS), hear)
        until(lambda: len(numbers) >= 3)
        run = numbers[-1][0]
        stage.service.end(signal.SIGKILL)
        stage.service.start()
        until(lambda: numbers[-1][0] > run)
    assert numbers == sorted(set(numbers))
    sequences = [sequence for _, sequence in numbers]
    assert sequences == sorted(set(sequences))


def test_stopped_over_http_it_stays_stopped_until_it_is_made_again(stage):
    url = f"{stage.service.url}/api/v1/streams"
    assert httpx.post(f"{url}/tiny/stop", timeout=PATIENCE).json()["state"] == "stopped"
    until(lambda: not stage.worker("tiny"))
    again = []
    with stage.bus() as bus:  # the source sends its manifest again
        bus.subscribe(keys.manifest("tiny"), again.append)
        until(lambda: len(again) >= 2)
    assert stage.state("tiny") == "stopped"
    made = httpx.post(url, json={"id": "tiny", "options": {"quality": 30}}, timeout=PATIENCE)
    assert made.status_code == 201, made.text
    assert made.json()["run"] == 3
    until(lambda: stage.state("tiny") == "live")
    assert httpx.post(url, json={"id": "tiny"}, timeout=PATIENCE).status_code == 409
    assert httpx.post(url, json={"id": "more"}, timeout=PATIENCE).status_code == 429
    asked = {"id": "more", "settings": {"magnification": "9"}}
    wrong = httpx.post(url, json=asked, timeout=PATIENCE)
    assert wrong.status_code == 422


def test_the_service_ends_in_its_time_with_sources_and_subscribers_there(stage):
    receiver = stage.run("subscribe", "tiny")
    stalled = stage.run("subscribe", "tiny")
    for process in (receiver, stalled):
        assert "sequence" in process.stdout.readline()
    stalled.send_signal(signal.SIGSTOP)
    worker = until(lambda: stage.worker("tiny"))
    begin = time.monotonic()
    try:
        assert stage.service.end() in (0, -signal.SIGTERM)
        assert time.monotonic() - begin < 60  # not when the grace is over
    finally:
        stalled.kill()
    assert not os.path.exists(f"/proc/{worker}")
    begin = time.monotonic()
    for process in (receiver, *stage.started[:1]):
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=PATIENCE)
        assert process.returncode == 0
    assert time.monotonic() - begin < 15
