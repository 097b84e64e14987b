"""Cameras on the network: what FFmpeg opens by an address, each read by a thread of its own.

A camera that is lost is opened again for as long as it takes; the others go on meanwhile.
"""

from __future__ import annotations

import contextlib
import queue
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import av
import av.error

from pipeline.errors import ConfigurationError, Interrupted, SceneError
from pipeline.media.decode import planar, planes_of
from pipeline.media.instants import Instant, Instants, SteadyClock
from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_frames import EncodedPicture, PictureEncoding
from pipeline.media.png import encode_png

OPEN_WITHIN, READ_WITHIN = 10.0, 5.0
"""How long a camera may take to be there, and to send on, seconds."""

SETTLE = 1.0
"""How long a camera that was opened is only listened to, seconds: what lay ready comes at once, and
when it was taken cannot be told."""

LONGEST_REST = 10.0
"""Between two tries to open a lost camera, at most, seconds; the first is half a second."""

SPARE = 100_000_000
"""How much longer than a frame lasts an instant waits for late pictures, nanoseconds."""

UNTOLD_FPS = Fraction(25)
"""Rate of a camera that does not tell its own, frames a second."""

QUALITY = 92
"""Of JPEG."""

_OPTIONS = {
    "rtsp_transport": "tcp", "fflags": "nobuffer", "flags": "low_delay",
    "analyzeduration": "1000000",
}  # fmt: skip
"""For FFmpeg: nothing lost on the way, nothing held back, a second to find out what it is."""


@dataclass(frozen=True, kw_only=True)
class CameraNews:
    """A camera was lost, or is there again."""

    camera: str
    problem: str | None
    """Why it is lost; None: it is there."""


def without_password(address: str) -> str:
    """Return an address that may be shown.

    >>> without_password("rtsp://ann:secret@10.0.0.7/main")
    'rtsp://ann:…@10.0.0.7/main'
    """
    return re.sub(r"(//[^/@:]*:)[^/@]*@", r"\1…@", address)


class Cameras:
    """Live cameras.

    Parameters
    ----------
    addresses : mapping of str to str
        Of FFmpeg (``rtsp://``, ``udp://``, ``tcp://``, ``http://`` …), by the cameras' names;
        the first camera sets the pace.
    stop : Event
        Ends everything; set by :meth:`close`, too.
    fps : Fraction, optional
        Instants a second; those of the first camera if left out.
    encoding : PictureEncoding
        How pictures are handed out.
    on_news : callable
        Told what happens to cameras, from their threads.

    Raises
    ------
    ConfigurationError
        If an address is none.
    SceneError
        If a camera cannot be opened, or sends no picture within ten seconds.
    Interrupted
        If it is stopped before all are there.
    """

    def __init__(
        self,
        addresses: Mapping[str, str],
        stop: threading.Event,
        *,
        fps: Fraction | None = None,
        encoding: PictureEncoding = PictureEncoding.JPEG,
        on_news: Callable[[CameraNews], None] = lambda news: None,
    ) -> None:
        for name, address in addresses.items():
            if "://" not in address:
                raise ConfigurationError(
                    f"--camera {name}: {address!r} is no address like rtsp://HOST/PATH; files are "
                    "played by a scene.json that names them"
                )
        self._encoding = encoding
        self._stop = stop
        self._news: queue.Queue[tuple[str, int, int, av.VideoFrame]] = queue.Queue(64)
        self._readers = [
            _Reader(name, address, self._stop, self._news, on_news)
            for name, address in addresses.items()
        ]
        try:
            for reader in self._readers:
                reader.start()
            deadline = time.monotonic() + OPEN_WITHIN
            for reader in self._readers:
                reader.wait_for_first(deadline)
        except BaseException:
            self.close()
            raise
        self.fps = fps or self._readers[0].fps or UNTOLD_FPS

    def instants(self) -> Iterator[Instant[EncodedPicture]]:
        """Yield what the cameras see, until they are stopped."""
        period = round(1e9 / self.fps)
        names = [reader.name for reader in self._readers]
        together: Instants[av.VideoFrame] = Instants(
            names, period=period, patience=period + SPARE
        )  # fmt: skip
        while not self._stop.is_set():
            with contextlib.suppress(queue.Empty):
                camera, taken, came, frame = self._news.get(timeout=period / 1e9)
                together.add(camera, taken, came, frame)
            for instant in together.ready(time.time_ns()):
                pictures = {
                    name: encoded(frame, self._encoding) for name, frame in instant.pictures.items()
                }
                yield Instant(taken=instant.taken, pictures=pictures)

    def close(self) -> None:
        """Let go of all cameras."""
        self._stop.set()
        for reader in self._readers:
            reader.join()

    def __enter__(self) -> Cameras:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Reader:
    """Reads one camera."""

    def __init__(
        self, name: str, address: str, stop: threading.Event,
        news: queue.Queue[tuple[str, int, int, av.VideoFrame]],
        on_news: Callable[[CameraNews], None],
    ) -> None:  # fmt: skip
        self.name, self._address = name, address
        self._stop, self._frames, self._on_news = stop, news, on_news
        self.fps: Fraction | None = None
        self._came = threading.Event()
        self._problem = ""
        self._thread = threading.Thread(target=self._run, name=f"camera {name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def join(self) -> None:
        if self._thread.ident is not None:
            self._thread.join(READ_WITHIN + 1)

    def wait_for_first(self, deadline: float) -> None:
        """Wait for the first picture."""
        while not self._came.wait(0.1):
            if self._stop.is_set():
                raise Interrupted("stopped before all cameras were there")
            if time.monotonic() < deadline:
                continue
            said = self._problem or "it sends no picture"
            raise SceneError(f"{said}: {without_password(self._address)}", view=self.name)

    def _run(self) -> None:
        rest = 0.5
        while not self._stop.is_set():
            try:
                count = self._read()
                problem = "the camera has ended its stream"
            except (av.error.FFmpegError, OSError) as error:
                count, problem = 0, _said(error)
            if self._stop.is_set():
                return
            rest = 0.5 if count else min(2 * rest, LONGEST_REST)
            self._lose(problem)
            self._stop.wait(rest)

    def _lose(self, problem: str) -> None:
        if self._came.is_set() and not self._problem:
            self._on_news(CameraNews(camera=self.name, problem=problem))
        self._problem = problem

    def _read(self) -> int:
        """Read until the camera ends or fails; return the number of pictures."""
        count = 0
        with av.open(
            self._address, options=_OPTIONS, timeout=(OPEN_WITHIN, READ_WITHIN)
        ) as container:  # fmt: skip
            if not container.streams.video:
                raise OSError(0, "there is no video in it")
            stream = container.streams.video[0]
            stream.thread_type = "SLICE"  # threads by frames would hold pictures back
            rate = stream.average_rate or stream.guessed_rate
            self.fps = Fraction(rate.numerator, rate.denominator) if rate else None
            clock, settled = SteadyClock(), time.monotonic() + SETTLE
            for frame in container.decode(stream):
                if self._stop.is_set():
                    return count
                came = time.time_ns()
                stamp = frame.time
                taken = came if stamp is None else clock.taken(round(stamp * 1e9), came)
                if time.monotonic() >= settled:
                    self._tell(taken, came, frame)
                    count += 1
        return count

    def _tell(self, taken: int, came: int, frame: av.VideoFrame) -> None:
        if self._problem and self._came.is_set():
            self._on_news(CameraNews(camera=self.name, problem=None))
        self._problem = ""
        self._came.set()
        with contextlib.suppress(queue.Full):  # nobody has taken any for long: they are old
            self._frames.put_nowait((self.name, taken, came, frame))


def encoded(frame: av.VideoFrame, encoding: PictureEncoding) -> EncodedPicture:
    """Return a decoded picture as it is sent."""
    if encoding is PictureEncoding.RAW:
        return _raw(frame)
    rgb = frame.to_ndarray(format="rgb24")
    data = encode_png(rgb) if encoding is PictureEncoding.PNG else encode_jpeg(rgb, quality=QUALITY)
    return EncodedPicture(encoding=encoding, data=data)


def _raw(frame: av.VideoFrame) -> EncodedPicture:
    """Return the planes as the camera sent them, where the format has a name that is understood."""
    frame, layout = planar(frame)
    if layout is None:
        frame, layout = planar(frame.reformat(format="yuv420p"))
    assert layout is not None
    data = b"".join(plane.tobytes() for plane in planes_of(frame, layout))
    return EncodedPicture(
        encoding=PictureEncoding.RAW, data=data, width=frame.width, height=frame.height,
        pixel_format=frame.format.name,
    )  # fmt: skip


def _said(error: Exception) -> str:
    if isinstance(error, av.error.ExitError):
        return "it sends nothing"
    if isinstance(error, av.error.ProtocolNotFoundError):
        return "addresses of this kind are not known"
    return (getattr(error, "strerror", None) or str(error)).lower()
