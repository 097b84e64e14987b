"""A camera on the network: H.264 in MPEG-TS, or JPEG, over TCP, at the pace of the clock."""

from __future__ import annotations

import contextlib
import io
import socket
import threading
import time
from types import TracebackType

import av
import numpy as np

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
    """

    def __init__(
        self, begun: float, *, fps: int = 4, size: tuple[int, int] = (64, 48), late: float = 0.0,
        has_stamps: bool = True,
    ) -> None:  # fmt: skip
        self._begun, self._fps, self._size, self._late = begun, fps, size, late
        self._has_stamps = has_stamps
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
        number = int((time.monotonic() - self._begun) * self._fps) + 1
        first = number
        while not self._cut.is_set():
            due = self._begun + number / self._fps + self._late
            if self._cut.wait(max(0.0, due - time.monotonic())):
                return
            planes = np.full((height * 3 // 2, width), 128, np.uint8)
            planes[:height] = level_of(number)
            frame = av.VideoFrame.from_ndarray(planes, format=stream.pix_fmt)
            frame.pts = number - first
            for packet in stream.encode(frame):
                container.mux(packet)
            connection.sendall(out.getvalue())
            out.seek(0)
            out.truncate()
            number += 1


def level_of(number: int) -> int:
    """Return the luma code of an instant's picture."""
    return FIRST_LEVEL + STEP * (number % LEVELS)
