"""Cameras on the network, at the pace of the clock: H.264 in MPEG-TS, or JPEG, over TCP; RTSP."""

from __future__ import annotations

import contextlib
import io
import socket
import subprocess
import threading
import time
from pathlib import Path
from types import TracebackType

import av
import numpy as np
from av.video.frame import PictureType

from tests.support.needed import absent, program
from tests.support.ports import free_port
from tests.support.waiting import limited

FIRST_LEVEL, STEP, LEVELS = 40, 8, 20
"""Grey of the pictures: each instant's differs from those before and after."""

_FAST = {"preset": "ultrafast", "tune": "zerolatency", "g": "5", "crf": "1"}


class TcpCamera:
    """Sends flat grey pictures, whose level tells the instant, to whoever connects.

    Parameters
    ----------
    begun : float
        Instant 0, seconds of the monotonic clock: the same for all cameras of a rig.
    late : float
        How long a picture takes to be sent, seconds.
    has_stamps : bool
        False: it sends JPEG, which tells no time and no rate.
    key : Event, optional
        Until it is set no key frame is sent, and nothing that says how pictures are coded.
    """

    def __init__(
        self, begun: float, *, fps: int = 4, size: tuple[int, int] = (64, 48), late: float = 0.0,
        has_stamps: bool = True, key: threading.Event | None = None,
    ) -> None:  # fmt: skip
        self._begun, self._fps, self._size, self._late = begun, fps, size, late
        self._has_stamps, self._key = has_stamps, key
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._stop = threading.Event()
        self._cut = threading.Event()
        self._connection: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Where it is."""
        return f"tcp://127.0.0.1:{self.port}"

    def cut(self) -> None:
        """End the stream that runs; who comes again gets another."""
        self._cut.set()

    def close(self) -> None:
        self._stop.set()
        self._cut.set()
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()

    def __enter__(self) -> TcpCamera:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self.close()

    def _serve(self) -> None:
        while not self._stop.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            self._cut.clear()
            with connection, contextlib.suppress(OSError, av.error.FFmpegError):
                self._send(connection)

    def _send(self, connection: socket.socket) -> None:
        out = io.BytesIO()
        form, codec, options = (
            ("mpegts", "libx264", _FAST) if self._has_stamps else ("mpjpeg", "mjpeg", {})
        )
        container = av.open(out, "w", format=form, options={"flush_packets": "1"})
        stream = container.add_stream(codec, rate=self._fps, options=options)
        width, height = self._size
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuv420p" if self._has_stamps else "yuvj420p"
        if self._key is not None:
            stream.options = {**_FAST, "g": "1000000", "forced-idr": "1"}
        number = int((time.monotonic() - self._begun) * self._fps) + 1
        first = number
        is_keyless = self._key is not None
        while not self._cut.is_set():
            due = self._begun + number / self._fps + self._late
            if self._cut.wait(max(0.0, due - time.monotonic())):
                return
            planes = np.full((height * 3 // 2, width), 128, np.uint8)
            planes[:height] = level_of(number)
            frame = av.VideoFrame.from_ndarray(planes, format=stream.pix_fmt)
            frame.pts = number - first
            if is_keyless and self._key is not None and self._key.is_set():
                is_keyless = False
                frame.pict_type = PictureType.I
            for packet in stream.encode(frame):
                if not (is_keyless and packet.is_keyframe):
                    container.mux(packet)
            connection.sendall(out.getvalue())
            out.seek(0)
            out.truncate()
            number += 1


def level_of(number: int) -> int:
    """Return the luma code of an instant's picture."""
    return FIRST_LEVEL + STEP * (number % LEVELS)


class RtspServer:
    """A process with GStreamer's RTSP server and its cameras; their pictures are as TcpCamera's.

    Parameters
    ----------
    cameras : str
        Names; ``NAME:udp`` sends by UDP alone.
    """

    FPS = 10

    def __init__(self, *cameras: str) -> None:
        self._cameras = cameras
        self._port = free_port()
        self._start()

    def address(self, camera: str) -> str:
        """Where a camera is, with name and password."""
        return f"rtsp://ann:secret@127.0.0.1:{self._port}/{camera}"

    def restart(self) -> None:
        """Kill it, and start it anew at the same place."""
        self.close()
        self._start()

    def close(self) -> None:
        self._process.kill()
        self._process.communicate()

    def __enter__(self) -> RtspServer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _start(self) -> None:
        script = Path(__file__).with_name("rtsp_server.py")
        python = program("/usr/bin/python3")
        command = [python, script, str(self._port), str(self.FPS), *self._cameras]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        with limited(self._process.kill):
            is_ready = self._process.stdout.readline() == "ready\n"
        if not is_ready:
            self._process.kill()
            _, said = self._process.communicate()
            absent(f"GStreamer's RTSP server cannot be run: {said[-300:]}")
