"""What a stream gives, in order: access units from a key frame on, gaps told."""

from __future__ import annotations

import json
import queue
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from typing import Any

from service.bus import keys
from service.bus.bus import Bus, Sample
from service.bus.keys import Output

QUEUE = 64
"""Messages that wait for whoever receives; the oldest are dropped."""


@dataclass(frozen=True, kw_only=True)
class Unit:
    """One picture of a stream as it came."""

    data: bytes
    sequence: int
    run: int
    frame_index: int
    position: int
    is_key: bool
    fps: Fraction
    width: int
    height: int
    capture_time_ns: int
    published_time_ns: int
    missed: int = 0
    """Messages that were lost between this one and the last that could be used."""
    is_new_run: bool = False
    """Whether another worker made it than the last that could be used."""


class Receiver:
    """Takes one output of a stream.

    A receiver that joins late begins with the last key frame and what follows,
    asked from the stream. After a loss it waits for the next key frame.

    Parameters
    ----------
    bus : Bus
    stream : str
    which : Output
    """

    def __init__(self, bus: Bus, stream: str, which: Output = Output.SBS) -> None:
        self._bus, self._stream, self._which = bus, stream, which
        self._queue: queue.Queue[Sample] = queue.Queue(maxsize=QUEUE)
        self._lock = threading.Lock()
        self.missed = 0
        """Messages lost so far."""
        self.skipped = 0
        """Messages that could not be used without the lost ones."""
        self._last: tuple[int, int] | None = None
        """Run and sequence of the last message."""
        self._gap = 0
        self._is_new_run = False
        self._needs_key = which is Output.SBS
        self._subscription = bus.subscribe(keys.output(stream, which), self._hear)

    def units(self, *, stop: threading.Event, timeout: float | None = None) -> Iterator[Unit]:
        """Yield what comes until ``stop`` is set, or nothing came for the time (seconds)."""
        if self._which is Output.SBS:
            yield from self._joined()
        heard = time.monotonic()
        while not stop.is_set():
            try:
                sample = self._queue.get(timeout=0.2)
            except queue.Empty:
                if timeout is not None and time.monotonic() - heard > timeout:
                    return
                continue
            heard = time.monotonic()
            unit = self._unit(sample.attachment, sample.read)
            if unit is not None:
                yield unit

    def close(self) -> None:
        """Take nothing more."""
        self._subscription.close()

    def _hear(self, sample: Sample) -> None:
        """In a thread of the bus."""
        with self._lock:
            while True:
                try:
                    self._queue.put_nowait(sample)
                    return
                except queue.Full:
                    self._queue.get_nowait()

    def _joined(self) -> Iterator[Unit]:
        """Yield the last key frame and what follows it; nothing where there is none."""
        for sample in self._bus.ask(keys.output(self._stream, self._which), timeout=2.0):
            for attachment, data in split_group(sample):
                unit = self._unit(attachment, partial(bytes, data))
                if unit is not None:
                    yield unit
            return

    def _unit(self, attachment: bytes, read: Callable[[], bytes]) -> Unit | None:
        said = read_output_header(attachment)
        if said is None:
            return None
        run, sequence = said["run"], said["sequence"]
        last_run, last_sequence = self._last or (run, sequence - 1)
        missed = sequence - last_sequence - 1
        if missed < 0 and run == last_run:
            return None  # we have it from the answer to our question
        missed = max(0, missed)
        self.missed += missed
        self._gap += missed
        self._is_new_run |= run != last_run
        self._last = (run, sequence)
        if self._which is Output.SBS and (missed or run != last_run):
            self._needs_key = True
        if self._needs_key and not said["key"]:
            self.skipped += 1
            return None
        unit = Unit(
            data=read(),
            sequence=sequence,
            run=run,
            frame_index=said["frame_index"],
            position=said["position"],
            is_key=bool(said["key"]),
            fps=Fraction(said["fps"]),
            width=said["width"],
            height=said["height"],
            capture_time_ns=said["capture_time_ns"],
            published_time_ns=said["published_time_ns"],
            missed=self._gap,
            is_new_run=self._is_new_run,
        )
        self._gap, self._is_new_run, self._needs_key = 0, False, False
        return unit


def read_output_header(attachment: bytes) -> dict[str, Any] | None:
    """Return the attachment of a picture that a stream gives; None where it is none."""
    try:
        said = json.loads(attachment)
        needed = ("sequence", "run", "frame_index", "position", "width", "height")
        if not all(isinstance(said[name], int) for name in needed) or Fraction(said["fps"]) <= 0:
            return None
    except (ValueError, KeyError, TypeError, ZeroDivisionError):
        return None
    return said


def split_group(sample: Sample) -> Iterator[tuple[bytes, bytes]]:
    """Yield (attachment, access unit) of each unit that a late joiner was answered with."""
    try:
        said = json.loads(sample.attachment)
        units = said.pop("units")
        data = sample.read()
        at = 0
        for unit in units:
            size = unit["size"]
            yield json.dumps({**said, **unit}).encode(), data[at : at + size]
            at += size
    except (ValueError, KeyError, TypeError):
        return
