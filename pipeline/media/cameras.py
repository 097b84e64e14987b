"""Cameras on the network: what FFmpeg opens by an address, each read by a thread of its own.

A camera that is lost is opened again for as long as it takes; the others go on meanwhile.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import pairwise
from statistics import median

import av
import av.error
import numpy.typing as npt

from pipeline.errors import ConfigurationError, Interrupted, SceneError
from pipeline.media.decode import rate_of
from pipeline.media.decoded import matrix_of, planar, planes_of, range_of
from pipeline.media.instants import Instant, Instants, SteadyClock
from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_frames import EncodedPicture, PictureEncoding
from pipeline.media.png import encode_png
from pipeline.media.video_format import HIGHEST_FPS
from pipeline.media.ycbcr import MATRIX_CODES, matrix_for
from pipeline.media.yuv import Range

OPEN_WITHIN, READ_WITHIN = 10.0, 5.0
"""How long a camera may take to be there, and to send on, seconds."""

SETTLE = 1.0
"""How long a camera that was opened is only listened to, seconds: what lay ready comes at once, and
when it was taken cannot be told."""

KEY_WITHIN = 120.0
"""How long a camera that sends may take to send a key frame, seconds: cameras that save bandwidth
send one every half a minute."""

LONGEST_REST = 3.0
"""Between two tries to open a lost camera, at most, seconds; the first is half a second."""

SPARE = 100_000_000
"""How much longer than a frame lasts an instant waits for late pictures, nanoseconds."""

UNTOLD_FPS = Fraction(25)
"""Rate of a camera that does not tell its own, frames a second."""

QUALITY = 92
"""Of JPEG."""

_NO_STAMPS = 0x80
"""FFmpeg's mark of formats whose pictures tell no time (AVFMT_NOTIMESTAMPS): what it says of that,
and of the rate, is made up."""

_OPTIONS = {
    "rtsp_flags": "prefer_tcp", "allowed_media_types": "video", "fflags": "nobuffer",
    "flags": "low_delay", "analyzeduration": "1000000",
}  # fmt: skip
"""For FFmpeg: nothing lost on the way where the camera allows it, no sound (whose clock would have
a say in the pictures' time stamps), nothing held back, a second to find out what it is."""


_REFUSALS = (av.error.HTTPUnauthorizedError, av.error.HTTPForbiddenError)
"""What a camera says to who may not look, over RTSP, too."""


@dataclass(frozen=True, kw_only=True)
class CameraNews:
    """A camera was lost, is there again, or lets one wait."""

    camera: str
    problem: str | None = None
    """Why it is lost; None: it is there."""
    is_awaited: bool = False
    """Whether it sends, but has not sent a key frame yet."""

    def __str__(self) -> str:
        if self.is_awaited:
            return f"camera {self.camera} sends, but no key frame yet: waiting for one"
        state = "is there again" if self.problem is None else f"lost: {self.problem}"
        return f"camera {self.camera} {state}"


def host_of(address: str) -> str:
    """Return what may be shown of an address: all else may be a password or a key.

    >>> host_of("rtsp://ann:sec@ret@10.0.0.7:554/main?key=1"), host_of("rtsp://ann:sec/ret@host")
    ('rtsp://10.0.0.7:554', 'rtsp://…')
    """
    kind, _, rest = address.partition("://")
    authority, *path = re.split(r"[/?#]", rest, maxsplit=1)
    host = "…" if "@" in "".join(path) else authority.rpartition("@")[2]
    return f"{kind}://{host}"


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

    Attributes
    ----------
    fps : Fraction
        Instants a second.

    Raises
    ------
    ConfigurationError
        If an address is none.
    SceneError
        If a camera cannot be opened or sends nothing within ten seconds, or no key frame within
        two minutes.
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
                    f"--camera {name}: must be an address like rtsp://HOST/PATH; files are played "
                    "by a scene.json that names them"
                )
        self._encoding = encoding
        self._stop = stop
        self._came = threading.Condition()
        self._together: Instants[av.VideoFrame] | None = None
        """None: nobody wants pictures yet."""
        self._readers = [
            _Reader(name, address, self._stop, partial(self._add, name), on_news)
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
        with self._came:
            self._together = together
        with ThreadPoolExecutor(len(names)) as pool:
            while not self._stop.is_set():
                with self._came:
                    instant = next(together.ready(time.time_ns()), None)
                    if instant is None:
                        self._came.wait(min(period, SPARE) / 1e9)
                        continue
                encode = partial(encoded, encoding=self._encoding)
                pictures = pool.map(encode, instant.pictures.values())
                yield Instant(
                    taken=instant.taken,
                    pictures=dict(zip(instant.pictures, pictures, strict=True)),
                )

    @property
    def left_out(self) -> int:
        """Instants that were not handed out, since they were not taken in time."""
        with self._came:
            return 0 if self._together is None else self._together.left_out

    def _add(self, camera: str, taken: int, came: int, frame: av.VideoFrame) -> None:
        with self._came:
            if self._together is not None:
                self._together.add(camera, taken, came, frame)
                self._came.notify()

    def close(self) -> None:
        """Let go of all cameras; a thread that is just opening one ends a little later."""
        self._stop.set()
        deadline = time.monotonic() + READ_WITHIN + 1
        for reader in self._readers:
            reader.join(deadline)

    def __enter__(self) -> Cameras:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class _Reader:
    """Reads one camera."""

    def __init__(
        self, name: str, address: str, stop: threading.Event,
        on_frame: Callable[[int, int, av.VideoFrame], None],
        on_news: Callable[[CameraNews], None],
    ) -> None:  # fmt: skip
        self.name, self._address = name, address
        self._stop, self._on_frame, self._on_news = stop, on_frame, on_news
        self.fps: Fraction | None = None
        self._heard: float | None = None
        """When something came last, seconds of the monotonic clock."""
        self._came = threading.Event()
        self._problem = ""
        self._is_refused = False
        self._thread = threading.Thread(target=self._run, name=f"camera {name}", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def join(self, deadline: float) -> None:
        if self._thread.ident is not None:
            self._thread.join(max(0.0, deadline - time.monotonic()))

    def wait_for_first(self, deadline: float) -> None:
        """Wait for the first picture; for longer while there is hope of a key frame."""
        is_told = False
        while not self._came.wait(0.1):
            if self._stop.is_set():
                raise Interrupted("stopped before all cameras were there")
            now = time.monotonic()
            sends = self._heard is not None and now - self._heard < READ_WITHIN
            patience = KEY_WITHIN - OPEN_WITHIN if sends else 0.0
            if now < deadline + patience and not self._is_refused:
                if now >= deadline and not is_told:
                    self._on_news(CameraNews(camera=self.name, is_awaited=True))
                    is_told = True
                continue
            said = self._problem or ("it sends no key frame" if sends else "it sends no picture")
            raise SceneError(f"{said}: {host_of(self._address)}", view=self.name)

    def _run(self) -> None:
        rest = 0.5
        while not self._stop.is_set():
            try:
                count = self._read()
                problem = "the camera has ended its stream"
            except (av.error.FFmpegError, OSError, ValueError) as error:
                count, problem = 0, _said(error)
                # many cameras lock out who comes with a wrong password again and again
                self._is_refused = isinstance(error, _REFUSALS)
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
            self._address, options=_OPTIONS, timeout=(OPEN_WITHIN, READ_WITHIN),
            metadata_errors="replace",
        ) as container:  # fmt: skip
            if not container.streams.video:
                raise OSError(0, "there is no video in it")
            stream = container.streams.video[0]
            stream.thread_type = "SLICE"  # threads by frames would hold pictures back
            has_stamps = not int(container.format.flags) & _NO_STAMPS
            self.fps = rate_of(stream) if has_stamps else None
            heard: list[int] = []
            clock, settled = SteadyClock(), time.monotonic() + SETTLE
            for frame in self._frames(container, stream):
                came = time.time_ns()
                taken, stamp = came, frame.time
                if has_stamps and stamp is not None:
                    taken = clock.taken(round(stamp * 1e9), came)
                heard.append(came)
                if time.monotonic() >= settled:
                    if self.fps is None and not count:
                        self.fps = measured_rate(heard)
                    self._tell(taken, came, frame)
                    count += 1
                    heard.clear()
        return count

    def _frames(
        self, container: av.container.InputContainer, stream: av.VideoStream
    ) -> Iterator[av.VideoFrame]:
        """Yield what can be decoded, until the camera ends its stream, is silent, or is stopped."""
        self._heard = None
        for packet in container.demux(stream):
            now = time.monotonic()
            if self._heard is not None and now - self._heard >= READ_WITHIN:
                raise TimeoutError(0, "it sends nothing")  # FFmpeg has handed out what it held
            self._heard = now
            if self._stop.is_set():
                return
            try:
                frames = packet.decode()
            except av.error.InvalidDataError:
                continue  # before the first key frame, or damaged on the way
            yield from frames

    def _tell(self, taken: int, came: int, frame: av.VideoFrame) -> None:
        if self._problem and self._came.is_set():
            self._on_news(CameraNews(camera=self.name))
        self._problem = ""
        self._came.set()
        self._on_frame(taken, came, frame)


def measured_rate(came: Sequence[int]) -> Fraction | None:
    """Return a whole number of pictures a second by when they came, ns; None: too few came.

    >>> measured_rate([0, 1, 2, 101_000_000, 199_000_000, 300_000_000, 400_000_000])
    Fraction(10, 1)
    """
    gaps = [later - earlier for earlier, later in pairwise(came)]
    usual = median(gaps) if gaps else 0
    return Fraction(max(1, round(1e9 / usual))) if HIGHEST_FPS * usual >= 1e9 else None


def encoded(frame: av.VideoFrame, encoding: PictureEncoding) -> EncodedPicture:
    """Return a decoded picture as it is sent."""
    if encoding is PictureEncoding.RAW:
        return _raw(frame)
    if encoding is PictureEncoding.PNG:
        data = encode_png(_rgb(frame, "rgb48le" if _is_deep(frame) else "rgb24"))
    else:
        data = encode_jpeg(_rgb(frame, "rgb24"), quality=QUALITY)
    return EncodedPicture(encoding=encoding, data=data)


def _raw(frame: av.VideoFrame) -> EncodedPicture:
    """Return the planes as the camera sent them; RGB where they would be taken for other ones."""
    flat, layout = planar(frame)
    name = flat.format.name
    if layout is not None and (
        not layout.has_chroma
        or (
            matrix_of(frame) is matrix_for(frame.height)
            and (range_of(frame, layout, Range.LIMITED) is Range.FULL) == name.startswith("yuvj")
        )
    ):
        data = b"".join(plane.tobytes() for plane in planes_of(flat, layout))
    else:
        name = "rgb48le" if _is_deep(frame) else "rgb24"
        data = _rgb(frame, name).tobytes()
    return EncodedPicture(
        encoding=PictureEncoding.RAW, data=data, width=frame.width, height=frame.height,
        pixel_format=name,
    )  # fmt: skip


def _rgb(frame: av.VideoFrame, pixel_format: str) -> npt.NDArray:
    if not frame.format.is_rgb:
        frame.colorspace = MATRIX_CODES[matrix_of(frame)]  # the converter has another default
    return frame.to_ndarray(format=pixel_format)


def _is_deep(frame: av.VideoFrame) -> bool:
    return max(component.bits for component in frame.format.components) > 8


def _said(error: Exception) -> str:
    if isinstance(error, av.error.ExitError):
        return "it sends nothing"
    if isinstance(error, av.error.ProtocolNotFoundError):
        return "addresses of this kind are not known"
    # never the whole message, which has the address with its password
    return (getattr(error, "strerror", None) or "it cannot be read").lower()
