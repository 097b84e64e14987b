"""Cameras on the network, over real sockets."""

from __future__ import annotations

import socket
import threading
import time
from fractions import Fraction

import av
import numpy as np
import pytest

from pipeline.colour import picture_from_rgb
from pipeline.errors import ConfigurationError, Interrupted, SceneError
from pipeline.media import cameras as module
from pipeline.media import instants
from pipeline.media.cameras import Cameras, encoded
from pipeline.media.live_frames import PictureEncoding, decode_color
from tests.support.camera import STEP, RtspServer, TcpCamera
from tests.support.waiting import PATIENCE, limited, until


@pytest.fixture
def patient(monkeypatch):
    """Cameras that are there may take as long as the machine does."""
    monkeypatch.setattr(module, "OPEN_WITHIN", PATIENCE)
    monkeypatch.setattr(module, "READ_WITHIN", PATIENCE)


def level(picture) -> float:
    return float(decode_color(picture, max_pixels=1 << 20).luma.mean()) * 219 / 255 + 16


@pytest.mark.parametrize("encoding", list(PictureEncoding))
@pytest.mark.parametrize(
    ("height", "pixels", "matrix", "tag"),
    [
        (48, "yuv420p", 6, 2), (48, "nv12", 6, 2), (48, "rgb24", None, 2),
        (48, "yuvj444p", 5, 5), (720, "yuvj422p", 5, 5), (720, "yuv420p", 1, 2),
        (48, "yuv420p", 1, 1), (720, "yuv420p10le", 1, 1),
    ],
)  # fmt: skip
def test_pictures_are_sent_as_they_were_taken(height, pixels, matrix, tag, encoding):
    """By the matrix that they are tagged with, or that one of their kind has."""
    picture = np.full((height, 64, 3), (200, 90, 40), np.uint8)
    frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
    if matrix is not None:
        frame = frame.reformat(format=pixels, dst_colorspace=matrix)
        frame.colorspace = tag
    seen = decode_color(encoded(frame, encoding), max_pixels=1 << 20)
    meant = picture_from_rgb(picture, 255.0)
    assert np.abs(seen.luma - meant.luma).max() < 3
    assert np.abs(seen.chroma - meant.chroma).max() < 3


@pytest.mark.usefixtures("patient")
def test_pictures_of_one_instant_come_together():
    """Although each camera has time stamps of its own.

    When pictures were taken is known from those that were on their way the shortest: while a
    machine holds all of them up, not at once.
    """
    begun = time.monotonic()
    with (
        TcpCamera(begun) as first, TcpCamera(begun + 0.01) as second,
        Cameras(
            {"left": first.address, "right": second.address}, threading.Event()
        ) as rig,
    ):  # fmt: skip
        assert rig.fps == 4
        alike = 0
        for instant in rig.instants():
            assert "left" in instant.pictures
            if len(instant.pictures) == 2:
                seen = [level(instant.pictures[name]) for name in ("left", "right")]
                alike = alike + 1 if abs(seen[0] - seen[1]) < STEP / 2 else 0
            if alike >= 5:
                break
            assert time.monotonic() - begun < PATIENCE


@pytest.mark.usefixtures("patient")
def test_pictures_that_tell_no_time_were_taken_when_they_came(monkeypatch):
    """FFmpeg says of JPEG that 25 were taken a second, however many come."""
    monkeypatch.setattr(instants, "FORGOTTEN", 10**15)
    begun = time.monotonic()
    with (
        TcpCamera(begun, has_stamps=False) as camera,
        Cameras({"left": camera.address}, threading.Event()) as rig,
    ):
        taken: list[int] = []
        for instant in rig.instants():
            taken.append(instant.taken)
            if len(taken) > 6 and taken[-1] - taken[-7] > 0.5e9:  # of 1.5 s
                break
            assert time.monotonic() - begun < PATIENCE


@pytest.mark.usefixtures("patient")
def test_frames_that_nobody_takes_in_time_are_counted(monkeypatch):
    monkeypatch.setattr(instants, "LATE", 0)
    with (
        TcpCamera(time.monotonic(), fps=20) as camera,
        Cameras({"left": camera.address}, threading.Event()) as rig,
    ):
        for _ in rig.instants():
            if rig.left_out:
                break
            time.sleep(0.25)


@pytest.mark.usefixtures("patient")
def test_a_camera_that_is_cut_off_is_opened_again_and_the_other_goes_on():
    begun, news = time.monotonic(), []
    with (
        TcpCamera(begun) as first, TcpCamera(begun) as second,
        Cameras(
            {"left": first.address, "right": second.address}, threading.Event(),
            on_news=news.append,
        ) as rig,
    ):  # fmt: skip
        sizes = []
        for instant in rig.instants():
            sizes.append(len(instant.pictures))
            if 2 in sizes and not news:
                second.cut()
            if len(news) == 2 and sizes[-1] == 2:
                break
        assert 1 in sizes
        assert [(item.camera, item.problem is None) for item in news] == [
            ("right", False), ("right", True)
        ]  # fmt: skip


def test_a_key_frame_is_waited_for_longer_than_a_camera(monkeypatch):
    """As they come half a minute apart from cameras that save bandwidth."""
    news = []

    def tell(item):
        news.append(item)
        key.set()

    monkeypatch.setattr(module, "READ_WITHIN", PATIENCE)
    monkeypatch.setattr(module, "KEY_WITHIN", PATIENCE)
    for patience in (4, 20, PATIENCE):  # more where the machine is slow to open it at all
        monkeypatch.setattr(module, "OPEN_WITHIN", patience)
        key = threading.Event()
        try:
            with (
                TcpCamera(time.monotonic(), fps=50, key=key) as camera,
                Cameras({"left": camera.address}, threading.Event(), on_news=tell) as rig,
            ):
                assert next(rig.instants()).pictures
            break
        except SceneError as error:
            assert "sends no picture" in str(error)  # noqa: PT017
    assert [str(item) for item in news] == [
        "camera left sends, but no key frame yet: waiting for one"
    ]


@pytest.mark.usefixtures("patient")
def test_cameras_speak_rtsp_over_tcp_or_udp_and_come_back():
    """GStreamer's server: one camera that is asked by TCP first, one that sends by UDP alone."""
    news, sizes, alike = [], [], 0
    stop = threading.Event()
    with (
        RtspServer("left") as first, RtspServer("right:udp") as second, limited(stop.set),
        Cameras(
            {"left": first.address("left"), "right": second.address("right")}, stop,
            on_news=news.append,
        ) as rig,
    ):  # fmt: skip
        assert rig.fps == RtspServer.FPS
        for instant in rig.instants():
            sizes.append(len(instant.pictures))
            if sizes[-1] == 2:
                seen = [level(instant.pictures[name]) for name in ("left", "right")]
                alike = alike + 1 if abs(seen[0] - seen[1]) < STEP / 2 else 0
            if alike >= 5 and len(news) == 2:
                break
            if alike >= 5 and not news:
                second.restart()
                alike = 0
        else:
            pytest.fail(f"stopped after {PATIENCE:g} s: {(alike, news, sizes[-20:])}")
    assert 1 in sizes
    assert [(item.camera, item.problem is None) for item in news] == [
        ("right", False), ("right", True)
    ]  # fmt: skip


@pytest.mark.usefixtures("patient")
def test_a_wrong_password_is_not_tried_twice():
    with RtspServer("left") as server:
        address = server.address("left").replace("secret", "cret")
        with pytest.raises(SceneError, match="401") as told:
            Cameras({"left": address}, threading.Event())
    assert "cret" not in str(told.value)


def test_a_camera_that_is_not_there_is_told_without_its_password(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    address = f"rtsp://ann:se@cret@127.0.0.1:{port}/main?key=cret"
    for patience in (1, 5, 25, PATIENCE):  # more where the machine is slow to try at all
        monkeypatch.setattr(module, "OPEN_WITHIN", patience)
        with pytest.raises(SceneError) as told:
            Cameras({"left": address}, threading.Event())
        if "it sends no picture" not in str(told.value):
            break
    assert f"connection refused: rtsp://127.0.0.1:{port}" in str(told.value)
    assert "cret" not in str(told.value)
    assert "left" in str(told.value)


def test_a_camera_that_sends_nothing_can_be_stopped():
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as silent:
        threading.Timer(0.3, stop.set).start()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "OPEN_WITHIN", 2.0)
            with pytest.raises(Interrupted):
                Cameras({"left": f"tcp://127.0.0.1:{silent.getsockname()[1]}"}, stop)


def test_a_file_is_no_camera(tmp_path):
    with pytest.raises(ConfigurationError, match=r"scene\.json"):
        Cameras({"left": str(tmp_path / "clip.mp4")}, threading.Event())
    with pytest.raises(ConfigurationError) as told:
        Cameras({"left": "ann:secret@10.0.0.7"}, threading.Event())
    assert "secret" not in str(told.value)


@pytest.mark.usefixtures("patient")
def test_no_thread_outlives_the_cameras():
    with TcpCamera(time.monotonic()) as camera:
        with Cameras({"left": camera.address}, threading.Event(), fps=Fraction(5)) as rig:
            next(rig.instants())
        until(lambda: not any(t.name.startswith("camera") for t in threading.enumerate()))
