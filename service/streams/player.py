"""A scene played as live cameras: each view's picture at its time, with the faults asked for."""

from __future__ import annotations

import heapq
import itertools
import random
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

from pipeline.media.live_frames import EncodedPicture
from pipeline.media.live_source import LiveSource
from service.bus.bus import Bus
from service.bus.keys import Part
from service.streams.feed import Feed, header_of


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
        self._feed = Feed(bus, stream, source.manifest)
        self.frames = self.lost = 0

    def play(self, stop: threading.Event) -> Played:
        """Send frame after frame until the scene ends (or for ever), or ``stop`` is set."""
        begin = self._clock()
        begin_wall = self._wall()
        due: list[_Due] = []
        numbers = itertools.count()
        late = 0.0
        for number, frame_index in enumerate(self._indices()):
            at = number / float(self._playing.rate)
            self._feed.tell(at)
            capture = begin_wall + round(at * 1e9)
            for key, picture in self._source.read(frame_index).items():
                place = self._source.frame_indices.start + number
                header = header_of(picture, frame_index=place, capture_time_ns=capture)
                delay = self._chance.uniform(0, self._playing.jitter)
                if self._chance.random() < self._playing.loss:
                    self.lost += 1
                    continue
                item = _Due(at + delay, next(numbers), key, picture, header)
                heapq.heappush(due, item)
            if not self._send_until(due, begin, at, stop):
                break
            late = max(0.0, self._clock() - begin - at)
            self.frames += 1
        self._send_until(due, begin, float("inf"), stop)
        return Played(
            frames=self.frames, pictures=self._feed.pictures, bytes=self._feed.bytes,
            lost=self.lost, late=late,
        )  # fmt: skip

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
            view_id, part = item.key
            self._feed.put(view_id, Part(part), item.picture, item.header)
        return not stop.is_set()
