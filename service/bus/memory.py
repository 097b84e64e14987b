"""A bus within one process: the twin of zenoh for tests, message by message in the same order."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from types import TracebackType
from typing import Any

from service.bus.bus import Answer, BusError, Declared, Publisher, Question, Sample
from service.bus.keys import matches


class MemoryNetwork:
    """What the buses of a process are connected to."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._entries: dict[str, list[_Entry]] = {}

    def connect(self) -> MemoryBus:
        """Return a bus on this network."""
        return MemoryBus(self)

    def add(self, entry: _Entry) -> None:
        """Take a subscription, an answerer or a token."""
        with self._lock:
            self._entries.setdefault(entry.kind, []).append(entry)

    def remove(self, entry: _Entry) -> bool:
        """Let go of an entry; tell whether it was there."""
        with self._lock:
            entries = self._entries.get(entry.kind, [])
            there = entry in entries
            if there:
                entries.remove(entry)
            return there

    def entries(self, kind: str) -> Sequence[_Entry]:
        """Return the entries of a kind, in the order they came."""
        with self._lock:
            return tuple(self._entries.get(kind, ()))


class _Entry:
    """One declaration."""

    def __init__(
        self, network: MemoryNetwork, kind: str, expression: str, callback: Any = None
    ) -> None:
        self.network, self.kind = network, kind
        self.expression, self.callback = expression, callback
        network.add(self)

    def close(self) -> None:
        """Take it back."""
        if self.network.remove(self) and self.kind == "token":
            _tell_lives(self.network, self.expression, False)


class _MemoryPublisher:
    def __init__(self, bus: MemoryBus, key: str, encoding: str) -> None:
        self._bus, self._key, self._encoding = bus, key, encoding

    @property
    def has_subscribers(self) -> bool:
        found = self._bus.network.entries("subscription")
        return any(matches(entry.expression, self._key) for entry in found)

    def put(self, payload: bytes, attachment: bytes = b"") -> None:
        self._bus.put(self._key, payload, encoding=self._encoding, attachment=attachment)

    def close(self) -> None:
        pass


class MemoryBus:
    """See :class:`service.bus.bus.Bus`. Messages are handed over in the thread that sends."""

    def __init__(self, network: MemoryNetwork) -> None:
        self.network = network
        self._mine: list[_Entry] = []
        self._closed = False

    def put(self, key: str, payload: bytes, *, encoding: str, attachment: bytes = b"") -> None:
        """Send one message."""
        self._check()
        sample = Sample(
            key=key, encoding=encoding, size=len(payload), read=lambda: payload,
            attachment=attachment,
        )  # fmt: skip
        for entry in self.network.entries("subscription"):
            if matches(entry.expression, key):
                entry.callback(sample)

    def publisher(self, key: str, *, encoding: str, urgent: bool = False) -> Publisher:
        """Return what sends messages on a key."""
        self._check()
        return _MemoryPublisher(self, key, encoding)

    def subscribe(self, expression: str, callback: Callable[[Sample], None]) -> Declared:
        """Call back for every message that the expression selects."""
        return self._add("subscription", expression, callback)

    def answer(self, expression: str, callback: Callable[[Question], Iterable[Answer]]) -> Declared:
        """Answer questions that meet the expression."""
        return self._add("answerer", expression, callback)

    def ask(self, selector: str, *, timeout: float = 2.0) -> Sequence[Sample]:
        """Return all answers."""
        self._check()
        key, _, parameters = selector.partition("?")
        question = Question(key=key, parameters=parameters)
        return [
            Sample(
                key=item.key, encoding=item.encoding, size=len(item.payload),
                read=partial(bytes, item.payload), attachment=item.attachment,
            )
            for entry in self.network.entries("answerer")
            if matches(key, entry.expression) or matches(entry.expression, key)
            for item in entry.callback(question)
        ]  # fmt: skip

    def live(self, key: str) -> Declared:
        """Show that we are there."""
        token = self._add("token", key, None)
        _tell_lives(self.network, key, True)
        return token

    def who_lives(self, expression: str, *, timeout: float = 2.0) -> Sequence[str]:
        """Return the keys of those who are there."""
        self._check()
        tokens = self.network.entries("token")
        return [item.expression for item in tokens if matches(expression, item.expression)]

    def watch_lives(self, expression: str, callback: Callable[[str, bool], None]) -> Declared:
        """Call back with (key, whether it is there)."""
        entry = self._add("watcher", expression, callback)
        for key in self.who_lives(expression):
            callback(key, True)
        return entry

    def close(self) -> None:
        """Take everything back."""
        self._closed = True
        for entry in self._mine:
            entry.close()

    def __enter__(self) -> MemoryBus:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _add(self, kind: str, expression: str, callback: Any) -> _Entry:
        self._check()
        entry = _Entry(self.network, kind, expression, callback)
        self._mine.append(entry)
        return entry

    def _check(self) -> None:
        if self._closed:
            raise BusError("the bus is closed")


def _tell_lives(network: MemoryNetwork, key: str, there: bool) -> None:
    for entry in network.entries("watcher"):
        if matches(entry.expression, key):
            entry.callback(key, there)
