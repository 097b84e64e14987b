"""Whole journeys of streams: cameras, service and subscribers in processes of their own."""

from __future__ import annotations

import json
import signal
import time

import httpx
import numpy as np
import pytest

from pipeline.media.decode import VideoReader
from pipeline.media.source import open_scene
from pipeline.metrics import psnr
from service.bus import keys
from tests.support.camera import STEP, TcpCamera
from tests.support.waiting import PATIENCE, until


def _read(path):
    """Return the luma of every frame of a file."""
    video = VideoReader(path)
    try:
        return [video.picture(number).luma for number in range(video.num_frames)]
    finally:
        video.close()


@pytest.fixture(scope="module")
def expected(tiny_scene):
    """Luma of both eyes side by side for each frame, as ``depthsr run`` computes it."""
    from pipeline.config import Settings
    from pipeline.worker import Worker

    with open_scene(tiny_scene) as source:
        info = source.info
        worker = Worker(Settings(), targets=(info.left, info.right))
        found = {}
        for frame in source.frames():
            images = worker.take(frame).images
            found[frame.frame_index] = np.hstack([images[v].luma for v in (info.left, info.right)])
    return found


def test_a_scene_is_published_served_and_received(make_stage, tiny_scene, expected, tmp_path):
    stage = make_stage("--grace", "300")
    asked = {
        "id": "tiny",
        "settings": {"temporal": "cold"},
        # a part that the machine is slow to send is waited for, a frame without one left out
        "options": {"quality": 1, "real_time": False, "wait": 10, "missing_depth": "drop"},
    }
    made = httpx.post(f"{stage.service.url}/api/v1/streams", json=asked, timeout=PATIENCE)
    assert (made.status_code, made.headers["location"]) == (201, "/api/v1/streams/tiny")
    assert made.json()["state"] == "waiting"
    cameras = stage.run("publish", str(tiny_scene), "--stream", "tiny", "--rate", "4", "--loop")
    until(lambda: stage.state("tiny") == "live")
    target = tmp_path / "out.mkv"
    receiver = stage.run("subscribe", "tiny", "-o", str(target), "--frames", "12")
    said = receiver.communicate(timeout=PATIENCE)
    assert receiver.returncode == 0, said
    frames = _read(target)
    assert len(frames) == 12
    first_index = next(iter(_history(stage, "tiny")))["frame_index"]
    assert first_index >= 0
    for luma in frames:
        assert max(psnr(luma, other) for other in expected.values()) > 38
    status = stage.status("tiny")["status"]
    assert status["frames_failed"] == 0
    assert set(status["latency"]) == {
        "wait", "decode", "superresolve", "pack", "encode", "publish", "pictures", "total"
    }  # fmt: skip
    assert "side by side" in _probe(target)
    cameras.send_signal(signal.SIGINT)
    assert "published" in cameras.communicate(timeout=PATIENCE)[0]
    assert cameras.returncode == 0
    begin = time.monotonic()
    assert stage.service.end() in (0, -signal.SIGTERM)
    assert time.monotonic() - begin < 60  # not when the grace is over


def test_of_a_stream_that_never_comes_no_file_is_said_to_be_written(make_stage, tmp_path):
    stage = make_stage("--workers", "0")
    target = tmp_path / "out.mkv"
    receiver = stage.run("subscribe", "none", "-o", str(target), "--wait", "0.5")
    _, said = receiver.communicate(timeout=PATIENCE)
    assert (receiver.returncode, target.exists()) == (1, False)
    assert "stream none: nothing came" in said
    assert "wrote" not in said


def test_cameras_on_the_network_are_watched_in_3d(make_stage, tmp_path):
    """From two H.264 streams over sockets to a file of super-resolved stereo."""
    stage, begun = make_stage(), time.monotonic()
    with TcpCamera(begun) as left, TcpCamera(begun) as right:
        cameras = stage.run(
            "publish", "--stream", "rig", "--camera", f"left={left.address}",
            "--camera", f"right={right.address}",
        )  # fmt: skip
        until(lambda: stage.state("rig") == "live")
        target = tmp_path / "out.mkv"
        receiver = stage.run("subscribe", "rig", "-o", str(target), "--frames", "4")
        said = receiver.communicate(timeout=PATIENCE)
        assert receiver.returncode == 0, said
        frames = _read(target)
        assert [frame.shape for frame in frames] == [(2 * 48, 2 * 2 * 64)] * 4
        eyes = [np.hsplit(frame, 2) for frame in frames]
        # on a busy machine the first ones may have come too late to be told apart
        assert any(abs(float(left.mean() - right.mean())) < STEP / 2 for left, right in eyes)
        cameras.send_signal(signal.SIGINT)
        said = cameras.communicate(timeout=PATIENCE)
        assert cameras.returncode == 0, said
        assert "published" in said[0]
        assert "2 cameras, 4 frames a second" in said[1]


def _history(stage, stream):
    with stage.bus() as bus:
        (answer,) = until(lambda: bus.ask(keys.history(stream)))
        return json.loads(answer.read())


def _probe(path):
    import subprocess

    return subprocess.run(
        ["ffprobe", "-v", "error", "-show_streams", str(path)],
        capture_output=True, text=True, check=True,
    ).stdout  # fmt: skip
