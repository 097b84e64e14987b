"""One video on its way to many: stored once, read by every viewer at its own pace.

Whoever encodes feeds the bytes of a fragmented MP4 as they come
(:meth:`pipeline.media.live_encode.LiveEncoder.take_mp4`) and, for viewers that know nothing
better, JPEG stills: as they come, or both where somebody asks for them. The init segment and a
bounded ring of fragments are kept. A viewer has a place in the ring and no queue of its own: one
that falls behind goes on at the newest key frame, and slows nobody.

Feeding is for any thread; watching is for the event loop.
"""

from __future__ import annotations

import asyncio
import math
import threading
import time
from collections import Counter
from collections.abc import AsyncGenerator, Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from uuid import uuid4

from pipeline.stereo import StereoLayout
from service.live.fragments import Fragment, Init, Splitter
from service.live.hls import MediaSegment, playlist

KEEP = 30.0
"""Length of the ring, seconds; HLS lists the newer half of it."""

KEEP_BYTES = 256 << 20
"""Size of the ring at most, bytes."""

PATIENCE = 2.0
"""How far a viewer may fall behind before it goes on at the newest key frame, seconds."""

FRESH = 0.2
"""A still that was asked for is the newest for so long, seconds."""

ANSWERED_WITHIN = 5.0
"""How long a still, or a playlist's first segment, is waited for where it is asked for, seconds."""

LOOKED_AT = 10.0
"""Who has asked for a playlist or a segment so long ago looks on, seconds."""


@dataclass(frozen=True, kw_only=True)
class Gap:
    """The viewer was too slow: what follows begins with a key frame."""

    fragments: int
    """How many were left out."""


@dataclass(frozen=True, kw_only=True)
class Still:
    """One picture as JPEG."""

    number: int
    """Grows by one with each."""
    jpeg: bytes


@dataclass(kw_only=True)
class _Segment:
    """From one key frame to the next."""

    number: int
    generation: int
    first: int
    """Number of its first fragment."""
    timescale: int
    fragments: list[Fragment] = field(default_factory=list)
    ticks: int = 0
    size: int = 0

    @property
    def seconds(self) -> float:
        """Its length."""
        return self.ticks / self.timescale

    def add(self, part: Fragment) -> None:
        self.fragments.append(part)
        self.ticks += part.duration
        self.size += len(part.data)


@dataclass(frozen=True, kw_only=True)
class _Step:
    """What a viewer gets next."""

    place: int
    """Number of the fragment."""
    part: Fragment
    generation: int
    init: Init
    left_out: int


class Broadcast:
    """A live video and its viewers.

    Parameters
    ----------
    fps : Fraction
        Of the source.
    layout : StereoLayout
        What the pictures hold.
    keep : float
        Length of the ring, seconds.
    ask_still : callable, optional
        Asks whoever makes the stills for the newest one; returns False where nobody does now.
        Answered by :meth:`show`, :meth:`confirm` or :meth:`lose_still`, in any thread. Without
        it, stills come by themselves.
    ask_video : callable, optional
        Asks whoever makes the video to begin. Without it, it comes by itself.

    Examples
    --------
    >>> from pipeline.media.live_encode import LiveEncoder
    >>> import numpy as np
    >>> encoder = LiveEncoder(fps=Fraction(15), layout=StereoLayout.SBS)
    >>> broadcast = Broadcast(fps=Fraction(15), layout=StereoLayout.SBS)
    >>> for number in range(20):
    ...     units = encoder.encode(np.zeros((32, 64, 3), np.uint8), number)
    ...     broadcast.feed(encoder.take_mp4())
    >>> broadcast.fragments
    19
    """

    def __init__(
        self,
        *,
        fps: Fraction,
        layout: StereoLayout,
        keep: float = KEEP,
        ask_still: Callable[[], bool] | None = None,
        ask_video: Callable[[], object] | None = None,
    ) -> None:
        self._ask_still, self._ask_video = ask_still, ask_video
        self.id = uuid4().hex
        """Tells it from others of the same name."""
        self.fps = fps
        self.layout = layout
        self.keep = keep
        self.ended = False
        self.fragments = 0
        """How many have come."""
        self.newest_at: float | None = None
        """When the newest came, seconds since the epoch; None before anything has come."""
        self.left_out = 0
        """Fragments that slow viewers did not get, added up over viewers."""
        self._lock = threading.Lock()
        self._splitter = Splitter()
        self._inits: dict[int, Init] = {}
        self._generation = -1
        self._segments: list[_Segment] = []
        self._num_segments = 0
        self._looked_at = -math.inf
        self._still: Still | None = None
        self._num_stills = self._answers = 0
        self._answered_at = -math.inf
        self._viewers: Counter[str] = Counter()
        self._waiting: dict[asyncio.Event, asyncio.AbstractEventLoop] = {}

    # Feeding

    def feed(self, data: bytes) -> None:
        """Take bytes of the fragmented MP4; a new ``ftyp`` begins a video of another kind.

        Raises
        ------
        DamagedStreamError
            If the bytes are no fragmented MP4.
        """
        if not data:
            return
        with self._lock:
            for part in self._splitter.feed(data):
                if isinstance(part, Init):
                    self._generation += 1
                    self._inits[self._generation] = part
                else:
                    self._add(part)
            self._forget()
        self._tell()

    def pause(self) -> None:
        """Say that the video does not go on for now; who comes later is not shown what was."""
        with self._lock:
            self._segments.clear()

    def show(self, jpeg: bytes) -> None:
        """Take a still."""
        with self._lock:
            self._still = Still(number=self._num_stills, jpeg=jpeg)
            self._num_stills += 1
        self.confirm()

    def confirm(self) -> None:
        """Say that the still that is there is the newest."""
        with self._lock:
            self._answers += 1
            self._answered_at = time.monotonic()
        self._tell()

    def lose_still(self) -> None:
        """Say that there were newer pictures than the still, and that they are lost."""
        with self._lock:
            self._still = None
        self.confirm()

    def close(self) -> None:
        """Say that nothing more will come; viewers get what is there, then the end."""
        self.ended = True
        self._tell()

    def stop(self) -> None:
        """The same from a signal handler, which may hold the lock already."""
        self.ended = True
        _wake(list(self._waiting.items()))

    # Watching

    @property
    def viewers(self) -> int:
        """How many are watching now, by fragments or by stills."""
        return self._viewers.total()

    @property
    def viewers_of_stills(self) -> int:
        """How many of them by stills."""
        return self._viewers["stills"]

    @property
    def is_watched(self) -> bool:
        """Whether somebody watches the video, fragment by fragment or by HLS."""
        asked = time.monotonic() - self._looked_at < LOOKED_AT
        return asked or self._viewers["fragments"] > 0

    @property
    def newest_init(self) -> Init | None:
        """The init segment of what comes now; None before anything has come."""
        with self._lock:
            return self._inits.get(self._generation)

    def init(self, generation: int) -> Init | None:
        """Return an init segment by its number in the playlist."""
        with self._lock:
            return self._inits.get(generation)

    def segment(self, number: int) -> Sequence[bytes] | None:
        """Return the fragments of an HLS segment; None where it is not there (any more)."""
        self._looked_at = time.monotonic()
        with self._lock:
            for segment in self._whole():
                if segment.number == number:
                    return [part.data for part in segment.fragments]
        return None

    def playlist(self) -> str:
        """Return the HLS playlist as of now: a window that moves on."""
        with self._lock:
            whole = list(self._whole())
            shown: list[_Segment] = []
            for segment in reversed(whole):
                if shown and sum(item.seconds for item in shown) >= self.keep / 2:
                    break
                shown.insert(0, segment)
        items = [
            MediaSegment(number=item.number, duration=item.seconds, generation=item.generation)
            for item in shown
        ]
        return playlist(items, ended=self.ended, growing=False)

    async def filled(self) -> None:
        """Ask for the video where it does not come by itself, until the playlist has some."""
        self._looked_at = time.monotonic()
        if self._ask_video is None or self._whole():
            return
        await asyncio.to_thread(self._ask_video)
        with self._listening() as news, suppress(TimeoutError):
            async with asyncio.timeout(ANSWERED_WITHIN):
                while not (self._whole() or self.ended):
                    news.clear()
                    await news.wait()

    async def watch(self) -> AsyncGenerator[Init | Fragment | Gap, None]:
        """Yield the init segment, then fragments from the newest key frame on, until the end.

        An init segment comes again when the video changes its kind; what follows it begins
        with a key frame. Close the iterator when done (``contextlib.aclosing``).
        """
        generation, place = -1, -1
        with self._viewing("fragments"), self._listening() as news:
            if self._ask_video is not None:
                await asyncio.to_thread(self._ask_video)
            while True:
                news.clear()
                step = self._step(place)
                if step is None:
                    if self.ended:
                        return
                    await news.wait()
                    continue
                if step.left_out:
                    yield Gap(fragments=step.left_out)
                if step.generation != generation:
                    generation = step.generation
                    yield step.init
                yield step.part
                place = step.place + 1

    async def stills(self) -> AsyncGenerator[Still, None]:
        """Yield stills as they come, the newest first; a slow viewer gets the newest."""
        with self._viewing("stills"), self._listening() as news:
            seen = -1 if await self._is_still_newest() else self._num_stills - 1
            while True:
                news.clear()
                still = self._still
                if still is not None and still.number > seen:
                    seen = still.number
                    yield still
                elif self.ended:
                    return
                else:
                    await news.wait()

    async def still(self) -> Still | None:
        """Return the newest still, which may have to be made; None where there is none."""
        return self._still if await self._is_still_newest() else None

    # Inside

    async def _is_still_newest(self) -> bool:
        """Ask for a newer one where they do not come by themselves; False without an answer."""
        ask = self._ask_still
        if ask is None or self.ended or time.monotonic() - self._answered_at < FRESH:
            return True
        answers = self._answers
        with self._listening() as news, suppress(TimeoutError):
            if not await asyncio.to_thread(ask):
                return True
            async with asyncio.timeout(ANSWERED_WITHIN):
                while True:
                    news.clear()
                    if self._answers != answers or self.ended:
                        return True
                    await news.wait()
        return False

    def _add(self, part: Fragment) -> None:
        newest = self._segments[-1] if self._segments else None
        generation = self._generation
        if newest is None or part.is_key or newest.generation != generation:
            newest = _Segment(
                number=self._num_segments,
                generation=generation,
                first=self.fragments,
                timescale=self._inits[generation].timescale,
            )
            self._segments.append(newest)
            self._num_segments += 1
        newest.add(part)
        self.fragments += 1
        self.newest_at = time.time()

    def _forget(self) -> None:
        """Let go of the oldest segments; the newest two stay."""
        seconds = sum(item.seconds for item in self._segments)
        size = sum(item.size for item in self._segments)
        while len(self._segments) > 2 and (seconds > self.keep or size > KEEP_BYTES):
            oldest = self._segments.pop(0)
            seconds -= oldest.seconds
            size -= oldest.size
        needed = self._segments[0].generation if self._segments else self._generation
        for generation in [number for number in self._inits if number < needed]:
            del self._inits[generation]

    def _whole(self) -> Sequence[_Segment]:
        """Return the segments that will not grow any more."""
        return self._segments if self.ended else self._segments[:-1]

    def _step(self, place: int) -> _Step | None:
        """Return the fragment at a place, or the newest key frame where that is too far back."""
        with self._lock:
            if not self._segments or place >= self.fragments:
                return None
            newest = self._segments[-1]
            start = newest.first
            if place < 0 or (place < start and self._behind(place) > PATIENCE):
                left_out = 0 if place < 0 else start - place
                self.left_out += left_out
                place = start
            else:
                left_out = 0
            segment = next(item for item in reversed(self._segments) if item.first <= place)
            return _Step(
                place=place,
                part=segment.fragments[place - segment.first],
                generation=segment.generation,
                init=self._inits[segment.generation],
                left_out=left_out,
            )

    def _behind(self, place: int) -> float:
        """Return the seconds of video from a place to the end; infinite where it is gone."""
        if place < self._segments[0].first:
            return math.inf
        rest = 0.0
        for segment in reversed(self._segments):
            if segment.first <= place:
                parts = segment.fragments[place - segment.first :]
                return rest + sum(part.duration for part in parts) / segment.timescale
            rest += segment.seconds
        return rest

    @contextmanager
    def _viewing(self, what: str) -> Iterator[None]:
        """Count a viewer."""
        with self._lock:
            self._viewers[what] += 1
        try:
            yield
        finally:
            with self._lock:
                self._viewers[what] -= 1

    @contextmanager
    def _listening(self) -> Iterator[asyncio.Event]:
        """Yield an event that is set whenever there is something new."""
        news = asyncio.Event()
        with self._lock:
            self._waiting[news] = asyncio.get_running_loop()
        try:
            yield news
        finally:
            with self._lock:
                del self._waiting[news]

    def _tell(self) -> None:
        """Wake every viewer, with one call into each event loop."""
        with self._lock:
            waiting = list(self._waiting.items())
        _wake(waiting)


def _wake(waiting: Sequence[tuple[asyncio.Event, asyncio.AbstractEventLoop]]) -> None:
    by_loop: dict[asyncio.AbstractEventLoop, list[asyncio.Event]] = {}
    for news, loop in waiting:
        by_loop.setdefault(loop, []).append(news)
    for loop, events in by_loop.items():
        if not loop.is_closed():
            loop.call_soon_threadsafe(_set_all, events)


def _set_all(events: Sequence[asyncio.Event]) -> None:
    for event in events:
        event.set()


class Broadcasts:
    """The broadcasts of a service by name: ``streams/<stream>``, ``jobs/<job>``.

    What the result is compared with has the same name and ``/before``.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._by_name: dict[str, Broadcast] = {}

    def open(
        self,
        name: str,
        *,
        fps: Fraction,
        layout: StereoLayout,
        ask_still: Callable[[], bool] | None = None,
        ask_video: Callable[[], object] | None = None,
    ) -> Broadcast:
        """Return a new broadcast; one of the same name ends."""
        made = Broadcast(fps=fps, layout=layout, ask_still=ask_still, ask_video=ask_video)
        with self._lock:
            before = self._by_name.get(name)
            self._by_name[name] = made
        if before is not None:
            before.close()
        return made

    def get(self, name: str) -> Broadcast | None:
        """Return a broadcast; None where there is none."""
        with self._lock:
            return self._by_name.get(name)

    def close(self, name: str) -> None:
        """End a broadcast and forget it."""
        with self._lock:
            found = self._by_name.pop(name, None)
        if found is not None:
            found.close()

    def all(self) -> dict[str, Broadcast]:
        """Return all of them by name."""
        with self._lock:
            return dict(self._by_name)

    def stop(self) -> None:
        """End them all: the service ends. May be called from a signal handler."""
        for found in list(self._by_name.values()):
            found.stop()
