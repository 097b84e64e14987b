"""From messages to the newest whole frame: what the bus calls back, and what the worker takes.

Bounded whatever a source does: messages are judged by key, size, rate and
header before their payload is copied; parts wait in the assembler's window; of
whole frames only the newest waits for the worker, and those it replaces are
counted.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

from service.bus.bus import Sample
from service.bus.keys import parse_input
from service.streams.assembly import ArrivedPart, AssembledFrame, Assembler, Expected
from service.streams.messages import MessageError, check_encoding, read_input_header, read_picture

LONGEST_REASON = 300
"""What is wrong with a message is told in so many characters."""


@dataclass(kw_only=True)
class IntakeCounts:
    """What became of messages before assembly, and of frames after it."""

    messages: int = 0
    bytes: int = 0
    malformed: int = 0
    """Messages that are not as docs/zenoh.md says."""
    too_large: int = 0
    """Messages above the limit of size."""
    too_many: int = 0
    """Messages above the limit of rate."""
    frames_behind: int = 0
    """Whole frames that a newer one replaced before the worker came to them."""


@dataclass(kw_only=True)
class RateLimit:
    """At most so many a second, a second's worth at once. Not for several threads."""

    rate: float
    _left: float = field(default=0.0, init=False)
    _at: float | None = field(default=None, init=False)

    def allows(self, now: float) -> bool:
        """Tell whether one more is allowed at this time (seconds)."""
        if self._at is None:
            self._left = self.rate
        else:
            self._left = min(self.rate, self._left + (now - self._at) * self.rate)
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


class Intake:
    """Takes the messages of one stream in any thread, gives whole frames to one worker.

    Parameters
    ----------
    expected : Expected
        What belongs to a frame.
    max_payload : int
        Largest picture taken, bytes.
    max_rate : float
        Frames a second taken.
    clock : callable
        Monotonic seconds.
    """

    def __init__(
        self,
        expected: Expected,
        *,
        max_payload: int,
        max_rate: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._assembler = Assembler(expected)
        self._counts = IntakeCounts()
        self._max_payload = max_payload
        self._limit = RateLimit(rate=max(1.0, max_rate * len(expected.parts)))
        self._clock = clock
        self._ready: AssembledFrame | None = None
        self._news = threading.Condition()
        self._closed = False
        self.last_heard: float | None = None
        """When the last message came, seconds."""
        self.last_wrong = ""
        """What was wrong with the last malformed message."""

    def hear(self, sample: Sample) -> None:
        """Take a message; never raises for what it holds."""
        now = self._clock()
        with self._news:
            self._counts.messages += 1
            self._counts.bytes += sample.size
            self.last_heard = now
            if not self._limit.allows(now):
                self._counts.too_many += 1
                return
            if sample.size > self._max_payload:
                self._counts.too_large += 1
                self._note(sample.key, f"{sample.size} bytes; up to {self._max_payload} are taken")
                return
        try:
            part = self._part(sample, now)
        except MessageError as error:
            self.refuse(sample.key, str(error))
            return
        with self._news:
            self._offer(self._assembler.take(part))

    def refuse(self, where: str, reason: str) -> None:
        """Count something that is not as it should be."""
        with self._news:
            self._counts.malformed += 1
            self._note(where, reason)

    def take(self, timeout: float) -> AssembledFrame | None:
        """Return the newest whole frame, or None when none comes in time (seconds)."""
        deadline = self._clock() + timeout
        with self._news:
            while self._ready is None and not self._closed:
                now = self._clock()
                if now >= deadline:
                    return None
                due = self._assembler.deadline
                until = deadline if due is None else min(deadline, due)
                self._news.wait(max(0.0, until - now) + 1e-3)
                self._offer(self._assembler.tick(self._clock()))
            frame, self._ready = self._ready, None
            return frame

    def wake(self) -> None:
        """Let nobody wait any more."""
        with self._news:
            self._closed = True
            self._news.notify_all()

    def counts(self) -> dict[str, int]:
        """Return what became of messages, parts and frames."""
        with self._news:
            return {**asdict(self._counts), **self._assembler.counts.plain()}

    def _part(self, sample: Sample, now: float) -> ArrivedPart:
        key = parse_input(sample.key)
        if key is None:
            raise MessageError("key: names no view's color or depth")
        check_encoding(sample.encoding)
        header = read_input_header(sample.attachment)
        content = read_picture(sample.encoding, sample.read(), header)
        return ArrivedPart(
            view=key.view,
            part=key.part,
            frame_index=header.frame_index,
            capture_time_ns=header.capture_time_ns,
            arrived=now,
            size=sample.size,
            content=content,
        )

    def _offer(self, frames: list[AssembledFrame]) -> None:
        for frame in frames:
            if self._ready is not None:
                self._counts.frames_behind += 1
            self._ready = frame
        if frames:
            self._news.notify_all()

    def _note(self, where: str, reason: str) -> None:
        self.last_wrong = f"{where}: {reason}"[:LONGEST_REASON]
