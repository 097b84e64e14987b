"""What streams need of a bus; :mod:`service.bus.zenoh_bus` and :mod:`service.bus.memory` give it.

Callbacks run in threads of the bus and must be quick: while one runs, the next
message of its subscription waits.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from pipeline.errors import PipelineError

JSON = "application/json"
JPEG = "image/jpeg"
PNG = "image/png"
RAW = "video/raw"
H264 = "video/h264"


class BusError(PipelineError):
    """The bus cannot be reached, or refuses; the message names the endpoint."""

    code = "bus-error"


@dataclass(frozen=True, kw_only=True)
class Sample:
    """One message. Its payload is copied only when it is read."""

    key: str
    encoding: str
    size: int
    """Of the payload, bytes."""
    read: Callable[[], bytes]
    """Returns the payload."""
    attachment: bytes = b""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """What is replied to a question."""

    key: str
    payload: bytes
    encoding: str
    attachment: bytes = b""


@dataclass(frozen=True, kw_only=True)
class Question:
    """What somebody asks for."""

    key: str
    """Key expression asked for."""
    parameters: str
    """After the question mark: ``name=value;name=value``."""


class Declared(Protocol):
    """Something declared on a bus, until it is closed."""

    def close(self) -> None:
        """Take it back; may be called twice."""


class Publisher(Declared, Protocol):
    """Puts messages on one key. A receiver that cannot follow loses some; nobody waits for it."""

    def put(self, payload: bytes, attachment: bytes = b"") -> None:
        """Send one message."""

    @property
    def has_subscribers(self) -> bool:
        """Whether anybody listens now. True as well while that is not known yet."""


class Bus(Protocol):
    """A connection to everybody else; a context manager that closes it."""

    def put(self, key: str, payload: bytes, *, encoding: str, attachment: bytes = b"") -> None:
        """Send one small message for which its receivers may be waited for a while."""

    def publisher(self, key: str, *, encoding: str, urgent: bool = False) -> Publisher:
        """Return what sends messages on a key; ``urgent`` ones are not collected into batches."""

    def subscribe(self, expression: str, callback: Callable[[Sample], None]) -> Declared:
        """Call back for every message whose key the expression selects."""

    def answer(self, expression: str, callback: Callable[[Question], Iterable[Answer]]) -> Declared:
        """Answer questions that meet the expression."""

    def ask(self, selector: str, *, timeout: float = 2.0) -> Sequence[Sample]:
        """Return all answers that come within the time (seconds)."""

    def live(self, key: str) -> Declared:
        """Show that we are there until it is closed, or this process is gone."""

    def who_lives(self, expression: str, *, timeout: float = 2.0) -> Sequence[str]:
        """Return the keys of those who are there."""

    def watch_lives(self, expression: str, callback: Callable[[str, bool], None]) -> Declared:
        """Call back with (key, whether it is there), for those already there too."""

    def close(self) -> None:
        """Take everything back and leave; may be called twice. Takes a few seconds at most."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


def answer_json(
    key: str, make: Callable[[Question], object]
) -> Callable[[Question], Iterable[Answer]]:
    """Return what answers questions on a key with JSON."""

    def answer(question: Question) -> Iterable[Answer]:
        yield Answer(key=key, payload=json.dumps(make(question)).encode(), encoding=JSON)

    return answer
