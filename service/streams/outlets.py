"""A stream's pictures on their way out: H.264, JPEG, and what late joiners ask for."""

from __future__ import annotations

import json
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

from pipeline.colour import to_grey, to_rgb
from pipeline.frames import View
from pipeline.media.coded import chroma_to_code, coded_together
from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_encode import LiveEncoder
from pipeline.media.ycbcr import HD_LINES, Yuv420, matrix_for
from pipeline.results import SuperResolvedImage
from pipeline.stereo import Picture, StereoLayout, pack
from service.bus import keys
from service.bus.bus import H264, JPEG, Answer, Bus, Question
from service.bus.keys import Output
from service.streams.messages import OutputHeader
from service.streams.sequences import Sequences
from service.streams.stills import Lease, Stills, Wish

KEY_INTERVAL = 1.0
"""A key frame at least this often, seconds."""

MAX_GROUP_BYTES = 32 << 20
"""Of the access units since the last key frame that are kept for late joiners."""

CRF_OF_OBSERVED = 12
"""What will be enlarged needs more bits."""

NUM_OBSERVED = 2
"""Frames that a video of the observed pictures begins with: of two, the first can be seen, as in
the result's, where no further one comes."""

MATRIX = matrix_for(HD_LINES)
"""Of all live video, whatever its size."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FinishedFrame:
    """One super-resolved frame, ready to be shown."""

    left: SuperResolvedImage
    right: SuperResolvedImage
    observed: tuple[View, View] | None
    """Left and right as they came, where they are to be shown beside."""
    frame_index: int
    position: int
    capture_time_ns: int

    @cached_property
    def pictures(self) -> tuple[Picture, Picture]:
        """Left and right for people to look at, (H, W, 3) or (H, W), uint8; made when asked for."""
        return picture_of(self.left), picture_of(self.right)

    @property
    def both(self) -> Picture:
        """These side by side."""
        return pack(*self.pictures, StereoLayout.SBS, multiple=2)

    @property
    def coded(self) -> Picture | Yuv420:
        """Both side by side as they are encoded: in colour, planes that take no way by RGB."""
        eyes = self.left, self.right
        if any(eye.colour is None for eye in eyes):
            return self.both
        return coded_together([(eye.luma, chroma_to_code(eye)) for eye in eyes], MATRIX)


def picture_of(image: SuperResolvedImage | View) -> Picture:
    """Return a picture for people to look at, (H, W, 3) RGB or (H, W), uint8."""
    if image.chroma is None:
        return to_grey(image.luma, 8)
    return to_rgb(image.luma, image.chroma, 8)


@dataclass(frozen=True, kw_only=True)
class Sent:
    """What sending one frame took."""

    seconds: Mapping[str, float]
    """By stage: pack, encode, publish; pictures is what follows the access unit."""
    bytes: int
    """Of the access units."""
    size: tuple[int, int]
    """(width, height) of both eyes side by side."""


class Outlets:
    """All outputs of one stream.

    Parameters
    ----------
    bus : Bus
    stream : str
    run : int
        Which worker this is, for the headers.
    sequences : Sequences
        Numbers of the messages.
    fps : Fraction
        Of the source.
    quality, jpeg_quality : int
        See :class:`service.streams.options.StreamOptions`.
    to_service : callable
        Takes (kind, bytes) for browsers: ``mp4`` as they come, ``jpeg`` where they are wanted,
        ``same``, empty, where one is wanted and there is none newer, ``before`` the video of the
        observed pictures where it is wanted, and at first a frame of it, ``pause``, empty, where
        it is not wanted any more.
    """

    def __init__(
        self,
        bus: Bus,
        stream: str,
        *,
        run: int,
        sequences: Sequences,
        fps: Fraction,
        quality: int,
        jpeg_quality: int,
        to_service: Callable[[str, bytes], None] = lambda kind, data: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._bus, self._stream, self._run = bus, stream, run
        self._fps, self._quality, self._jpeg_quality = fps, quality, jpeg_quality
        self._to_service = to_service
        self._clock = clock
        self._encoder: LiveEncoder | None = None
        self._before: LiveEncoder | None = None
        self._shape: tuple[int, ...] = ()
        self._last_key = -1e9
        self._lock = threading.Lock()
        self._showing = threading.Lock()
        """Held while a still is made, so that none comes after a newer one."""
        self._stills = Stills()
        self._first = 0
        """Position that the video begins with, and that of the observed pictures, too."""
        self._observing = threading.Lock()
        """Held while the observed pictures are encoded."""
        self._observed: deque[tuple[int, tuple[View, View]]] = deque(maxlen=NUM_OBSERVED)
        """Positions of the newest frames, and what was observed."""
        self._observed_wanted = Lease()
        self._sequences = sequences
        self._group: deque[tuple[OutputHeader, bytes]] = deque()
        self._eyes: FinishedFrame | None = None
        self._publishers = {
            which: bus.publisher(
                keys.output(stream, which),
                encoding=H264 if which is Output.SBS else JPEG,
                urgent=True,
            )
            for which in Output
        }
        for which in Output:
            key = keys.output(stream, which)
            bus.answer(key, partial(self._answer, which))

    def send(self, frame: FinishedFrame) -> Sent:
        """Encode and publish one frame; return what it took."""
        begin = self._clock()
        both = frame.coded
        packed = self._clock()
        is_key = packed - self._last_key >= KEY_INTERVAL
        encoder = self._encoder_for(both, frame.position)
        units = encoder.encode(both, frame.position, key=is_key)
        encoded = self._clock()
        height, width = both.shape[:2]
        size = 0
        for unit in units:
            header = self._header(Output.SBS, frame, (width, height), key=unit.is_key)
            with self._lock:
                self._eyes = frame
                self._stills.come()
                self._remember(header, unit.annex_b)
            self._publishers[Output.SBS].put(unit.annex_b, header.encoded())
            size += len(unit.annex_b)
            if unit.is_key:
                self._last_key = packed
        published = self._clock()
        self._to_service("mp4", encoder.take_mp4())
        self._send_stills(frame)
        self._send_observed(frame, key=is_key)
        seconds = {
            "pack": packed - begin,
            "encode": encoded - packed,
            "publish": published - encoded,
            "pictures": self._clock() - published,
        }
        return Sent(seconds=seconds, bytes=size, size=(width, height))

    def wish(self, wish: Wish) -> None:
        """Give browsers what they want, or say that they have it; for any thread."""
        if wish is Wish.BEFORE:
            with self._observing:
                self._observed_wanted.renew(self._clock())
                if self._before is None and self._observed:
                    self._begin_observed()
            return
        if not self._show(lambda now: self._stills.wish(wish, now)) and wish is Wish.ONE:
            self._to_service("same", b"")

    def close(self) -> None:
        """Finish the video, and show the last picture; the bus is the caller's to close."""
        self._close_video()
        self._show(self._stills.end)

    def _close_video(self) -> None:
        if self._encoder is not None:
            self._encoder.close()
            self._to_service("mp4", self._encoder.take_mp4())
            self._encoder = None
        with self._observing:
            self._end_observed()
            self._observed.clear()

    def _encoder_for(self, picture: Picture | Yuv420, position: int) -> LiveEncoder:
        """Return the encoder; a new one where the picture's shape is new."""
        if self._encoder is None or picture.shape != self._shape:
            self._close_video()
            self._encoder = LiveEncoder(fps=self._fps, layout=StereoLayout.SBS, crf=self._quality)
            self._shape, self._first = picture.shape, position
        return self._encoder

    def _send_observed(self, frame: FinishedFrame, *, key: bool) -> None:
        """Give browsers what the result is compared with, if they want it."""
        if frame.observed is None:
            return
        with self._observing:
            is_first = not self._observed
            self._observed.append((frame.position, frame.observed))
            is_wanted = self._observed_wanted.runs(self._clock())
            if self._before is not None and is_wanted:
                self._encode_observed(self._before, *self._observed[-1], key=key)
            elif is_wanted or is_first:  # of the first one, browsers learn what there would be
                self._begin_observed()
            else:
                self._end_observed()

    def _begin_observed(self) -> None:
        """Begin with the newest frames, at the times that they have in the result."""
        self._before = LiveEncoder(
            fps=self._fps, layout=StereoLayout.SBS, crf=CRF_OF_OBSERVED, begin=self._first
        )
        for position, views in self._observed:
            self._encode_observed(self._before, position, views)

    def _encode_observed(
        self, encoder: LiveEncoder, position: int, views: tuple[View, View], *, key: bool = False
    ) -> None:
        left, right = (picture_of(view) for view in views)
        encoder.encode(pack(left, right, StereoLayout.SBS, multiple=2), position, key=key)
        self._to_service("before", encoder.take_mp4())

    def _end_observed(self) -> None:
        if self._before is not None:
            self._before.close()
            self._to_service("before", self._before.take_mp4())
            self._to_service("pause", b"")
            self._before = None

    def _send_stills(self, frame: FinishedFrame) -> None:
        pictures: dict[Output, Callable[[], Picture]] = {
            Output.SBS_JPEG: lambda: frame.both,
            Output.LEFT: lambda: frame.pictures[0],
            Output.RIGHT: lambda: frame.pictures[1],
        }
        both = b""
        for which, picture in pictures.items():
            if not self._publishers[which].has_subscribers:
                continue
            shown = picture()
            data = encode_jpeg(shown, quality=self._jpeg_quality)
            both = data if which is Output.SBS_JPEG else both
            header = self._header(which, frame, (shown.shape[1], shown.shape[0]))
            self._publishers[which].put(data, header.encoded())
        self._show(self._stills.is_due, both)

    def _show(self, is_asked: Callable[[float], bool], made: bytes = b"") -> bool:
        """Show browsers the newest frame, if that is asked; it may have been made already."""
        with self._showing:
            with self._lock:
                frame = self._eyes if is_asked(self._clock()) else None
            if frame is None:
                return False
            self._to_service("jpeg", made or encode_jpeg(frame.both, quality=self._jpeg_quality))
            return True

    def _header(
        self, which: Output, frame: FinishedFrame, size: tuple[int, int], *, key: bool = True
    ) -> OutputHeader:
        layouts = {Output.LEFT: "left", Output.RIGHT: "right"}
        return OutputHeader(
            sequence=self._sequences.take(which),
            run=self._run,
            frame_index=frame.frame_index,
            position=frame.position,
            capture_time_ns=frame.capture_time_ns,
            published_time_ns=time.time_ns(),
            fps=f"{self._fps.numerator}/{self._fps.denominator}",
            width=size[0],
            height=size[1],
            layout=layouts.get(which, "sbs"),
            key=key,
        )

    def _remember(self, header: OutputHeader, data: bytes) -> None:
        """Keep what a late joiner needs: the last key frame and what follows."""
        if header.key:
            self._group.clear()
        self._group.append((header, data))
        if sum(len(kept) for _, kept in self._group) > MAX_GROUP_BYTES:
            self._group.clear()  # the next key frame is a second away

    def _answer(self, which: Output, question: Question) -> Iterable[Answer]:
        """Answer with the newest picture; of the video, with all since its last key frame."""
        key = keys.output(self._stream, which)
        with self._lock:
            group, frame = list(self._group), self._eyes
        if not group or frame is None:
            return
        if which is Output.SBS:
            said = json.loads(group[-1][0].encoded())
            said |= {
                "key": True,
                "units": [{**_that_differ(header), "size": len(data)} for header, data in group],
            }
            data = b"".join(unit for _, unit in group)
            yield Answer(key=key, payload=data, encoding=H264, attachment=json.dumps(said).encode())
            return
        eyes = {Output.LEFT: 0, Output.RIGHT: 1}
        shown = frame.pictures[eyes[which]] if which in eyes else frame.both
        header = replace(
            group[-1][0],
            sequence=self._sequences.last(which),
            width=shown.shape[1],
            height=shown.shape[0],
            layout={Output.LEFT: "left", Output.RIGHT: "right"}.get(which, "sbs"),
            key=True,
        )
        yield Answer(
            key=key,
            payload=encode_jpeg(shown, quality=self._jpeg_quality),
            encoding=JPEG,
            attachment=header.encoded(),
        )


def _that_differ(header: OutputHeader) -> dict[str, Any]:
    """Return what an access unit does not share with the others of its group."""
    names = ("sequence", "frame_index", "position", "capture_time_ns", "published_time_ns", "key")
    return {name: getattr(header, name) for name in names}
