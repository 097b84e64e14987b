"""A scene played as live cameras: each view's picture at its time, with the faults asked for."""

from __future__ import annotations

import heapq
import itertools
import json
import random
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

from pipeline.media.live_frames import EncodedPicture
from pipeline.media.live_source import LiveSource
from service.bus import keys
from service.bus.bus import JSON, Answer, Bus, Publisher
from service.bus.keys import Part
from service.streams.messages import InputHeader, write_input_header

MANIFEST_INTERVAL = 2.0
"""The manifest is sent again this often, for a service that comes later, seconds."""


@dataclass(frozen=True, kw_only=True)
class Playing:
    """How a scene is played."""

    rate: Fraction
    """Frames a second."""
    loop: bool = False
    jitter: float = 0.0
    """Each picture is late by up to this, seconds, drawn evenly."""
    loss: float = 0.0
    """Share of pictures that are not sent, 0 to 1."""
    seed: int = 1
    """Of jitter and loss."""


@dataclass(frozen=True, kw_only=True)
class Played:
    """What was sent."""

    frames: int
    pictures: int
    bytes: int
    lost: int
    """Pictures left out on purpose."""
    late: float
    """How far the last frame was behind its time, seconds."""


@dataclass(frozen=True, order=True)
class _Due:
    at: float
    number: int
    key: tuple[str, str]
    picture: EncodedPicture
    header: bytes


class Player:
    """Plays a scene on a bus.

    Parameters
    ----------
    bus : Bus
    stream : str
    source : LiveSource
    playing : Playing
    clock, wall : callable
        Monotonic seconds; nanoseconds since the epoch.
    """

    def __init__(
        self,
        bus: Bus,
        stream: str,
        source: LiveSource,
        playing: Playing,
        *,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], int] = time.time_ns,
    ) -> None:
        self._source, self._playing = source, playing
        self._clock, self._wall = clock, wall
        self._chance = random.Random(playing.seed)
        self._manifest = json.dumps(source.manifest.content).encode()
        self._bus, self._key = bus, keys.manifest(stream)
        self._stream = stream
        self._publishers: dict[tuple[tuple[str, str], str], Publisher] = {}
        self.frames = self.pictures = self.bytes = self.lost = 0
        bus.answer(
            self._key,
            lambda question: [Answer(key=self._key, payload=self._manifest, encoding=JSON)],
        )

    def play(self, stop: threading.Event) -> Played:
        """Send frame after frame until the scene ends (or for ever), or ``stop`` is set."""
        begin = self._clock()
        begin_wall = self._wall()
        due: list[_Due] = []
        told = -MANIFEST_INTERVAL
        numbers = itertools.count()
        late = 0.0
        for number, frame_index in enumerate(self._indices()):
            at = number / float(self._playing.rate)
            if at - told >= MANIFEST_INTERVAL:
                self._bus.put(self._key, self._manifest, encoding=JSON)
                told = at
            capture = begin_wall + round(at * 1e9)
            for key, picture in self._source.read(frame_index).items():
                header = InputHeader(
                    frame_index=self._source.frame_indices.start + number,
                    capture_time_ns=capture,
                    width=picture.width, height=picture.height, pixel_format=picture.pixel_format,
                )  # fmt: skip
                delay = self._chance.uniform(0, self._playing.jitter)
                if self._chance.random() < self._playing.loss:
                    self.lost += 1
                    continue
                item = _Due(at + delay, next(numbers), key, picture, write_input_header(header))
                heapq.heappush(due, item)
            if not self._send_until(due, begin, at, stop):
                break
            late = max(0.0, self._clock() - begin - at)
            self.frames += 1
        self._send_until(due, begin, float("inf"), stop)
        return Played(
            frames=self.frames, pictures=self.pictures, bytes=self.bytes, lost=self.lost, late=late
        )

    def _indices(self) -> Iterator[int]:
        indices = self._source.frame_indices
        return itertools.cycle(indices) if self._playing.loop else iter(indices)

    def _send_until(
        self, due: list[_Due], begin: float, until: float, stop: threading.Event
    ) -> bool:
        """Send what is due up to a time of the scene; tell whether to go on."""
        while due and due[0].at <= until:
            item = heapq.heappop(due)
            if stop.wait(max(0.0, begin + item.at - self._clock())):
                return False
            self._publisher(item).put(item.picture.data, item.header)
            self.pictures += 1
            self.bytes += len(item.picture.data)
        return not stop.is_set()

    def _publisher(self, item: _Due) -> Publisher:
        """Return what sends on the picture's key with its encoding."""
        name = (item.key, item.picture.encoding.value)
        if name not in self._publishers:
            view_id, part = item.key
            key = keys.input_key(self._stream, view_id, Part(part))
            self._publishers[name] = self._bus.publisher(key, encoding=name[1])
        return self._publishers[name]
