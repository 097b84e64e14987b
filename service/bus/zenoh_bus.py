"""The bus that is zenoh: the only module that imports it.

What is settled here for everybody (each was measured, see docs/zenoh.md):

- multicast and gossip are off: only named endpoints are spoken to;
- shared memory is off: pictures are larger than its pool, and a receiver that
  is held up for a tenth of a second loses messages without a word;
- congestion is answered by dropping, never by waiting, for one receiver that
  stands still would hold up all others;
- a session is always closed: a process that ends with a callback still
  declared does not end.
"""

from __future__ import annotations

import contextlib
import json
import logging
import re
import socket
import threading
from collections.abc import Callable, Iterable, Sequence
from types import TracebackType
from typing import Any

import zenoh

from service.bus.bus import Answer, BusError, Declared, Publisher, Question, Sample
from service.bus.config import BusConfig
from service.bus.rules import access_control

log = logging.getLogger(__name__)

CLOSING = 3.0
"""Seconds that leaving may take."""

SMALL_WAIT = 20_000
"""How long a message of one piece waits for a congested link before it is dropped, µs. zenoh's
own millisecond loses pictures that all cameras send at once where the processor is busy."""

PRIVATE = {"link_protocols": ["unixsock-stream"]}
"""Who comes by the socket that only the service's user can open."""

FRAGMENT_WAIT = 50_000
"""How long a large message waits for a congested link before it is dropped, µs."""


class ZenohBus:
    """See :class:`service.bus.bus.Bus`.

    Raises
    ------
    BusError
        If an endpoint cannot be listened on or connected to.
    """

    def __init__(self, config: BusConfig) -> None:
        self.listening = tuple(_with_port(endpoint) for endpoint in config.listen)
        """The endpoints listened on, port 0 replaced by the one that was free."""
        try:
            self._session = zenoh.open(_settings(config, self.listening))
        except zenoh.ZError as error:
            where = ", ".join((*self.listening, *config.connect)) or "nothing"
            raise BusError(f"zenoh at {where}: {_said(error)}") from None
        self._declared: list[_Declared] = []
        self._lock = threading.Lock()
        self._closed = False

    def put(self, key: str, payload: bytes, *, encoding: str, attachment: bytes = b"") -> None:
        """Send one small message."""
        with _told("put"):
            self._session.put(
                key, payload, encoding=encoding, attachment=attachment or None,
                congestion_control=zenoh.CongestionControl.DROP,
            )  # fmt: skip

    def publisher(self, key: str, *, encoding: str, urgent: bool = False) -> Publisher:
        """Return what sends messages on a key."""
        with _told("publish"):
            made = self._session.declare_publisher(
                key,
                encoding=encoding,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA_HIGH if urgent else zenoh.Priority.DATA,
                express=urgent,
            )
        publisher = _ZenohPublisher(made)
        self._keep(publisher)
        return publisher

    def subscribe(self, expression: str, callback: Callable[[Sample], None]) -> Declared:
        """Call back for every message that the expression selects."""

        def heard(sample: zenoh.Sample) -> None:
            if sample.kind != zenoh.SampleKind.PUT:
                return
            try:
                callback(_sample(sample))
            except Exception:
                log.exception("bus: a message could not be taken")

        with _told("subscribe"):
            return self._keep(_Declared(self._session.declare_subscriber(expression, heard)))

    def answer(self, expression: str, callback: Callable[[Question], Iterable[Answer]]) -> Declared:
        """Answer questions that meet the expression."""

        def asked(query: zenoh.Query) -> None:
            with query:
                try:
                    question = Question(key=str(query.key_expr), parameters=str(query.parameters))
                    for item in callback(question):
                        query.reply(
                            item.key, item.payload, encoding=item.encoding,
                            attachment=item.attachment or None,
                        )  # fmt: skip
                except Exception:
                    log.exception("bus: a question could not be answered")

        with _told("answer"):
            return self._keep(_Declared(self._session.declare_queryable(expression, asked)))

    def ask(self, selector: str, *, timeout: float = 2.0) -> Sequence[Sample]:
        """Return all answers that come within the time (seconds)."""
        with _told("ask"):
            replies = self._session.get(
                selector, timeout=timeout, consolidation=zenoh.ConsolidationMode.NONE
            )
            return [_sample(reply.ok) for reply in replies if reply.ok is not None]

    def live(self, key: str) -> Declared:
        """Show that we are there."""
        with _told("live"):
            return self._keep(_Declared(self._session.liveliness().declare_token(key)))

    def who_lives(self, expression: str, *, timeout: float = 2.0) -> Sequence[str]:
        """Return the keys of those who are there."""
        with _told("who_lives"):
            replies = self._session.liveliness().get(expression, timeout=timeout)
            return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]

    def watch_lives(self, expression: str, callback: Callable[[str, bool], None]) -> Declared:
        """Call back with (key, whether it is there)."""

        def seen(sample: zenoh.Sample) -> None:
            callback(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        with _told("watch_lives"):
            made = self._session.liveliness().declare_subscriber(expression, seen, history=True)
            return self._keep(_Declared(made))

    def close(self) -> None:
        """Take everything back and leave, within :data:`CLOSING` seconds."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            declared, self._declared = self._declared, []
        thread = threading.Thread(target=self._leave, args=(declared,), name="depthsr-bus-close")
        thread.daemon = True
        thread.start()
        thread.join(CLOSING)
        if thread.is_alive():
            log.warning("bus: leaving takes too long; left behind")

    def _leave(self, declared: Sequence[_Declared]) -> None:
        for item in reversed(declared):
            item.close()
        with contextlib.suppress(zenoh.ZError):
            self._session.close()

    def _keep(self, item: Any) -> Any:
        with self._lock:
            self._declared.append(item)
        return item

    def __enter__(self) -> ZenohBus:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


class _Declared:
    """Anything that can be taken back."""

    def __init__(self, made: Any) -> None:
        self._made = made
        self._lock = threading.Lock()

    def close(self) -> None:
        with self._lock:
            made, self._made = self._made, None
        if made is not None:
            with contextlib.suppress(zenoh.ZError):
                made.undeclare()


class _ZenohPublisher(_Declared):
    @property
    def has_subscribers(self) -> bool:
        made = self._made
        if made is None:
            return False
        with _told("matching"):
            return bool(made.matching_status.matching)

    def put(self, payload: bytes, attachment: bytes = b"") -> None:
        made = self._made
        if made is None:
            raise BusError("the publisher is closed")
        with _told("put"):
            made.put(payload, attachment=attachment or None)


@contextlib.contextmanager
def _told(what: str) -> Any:
    """Make what zenoh raises an error of ours."""
    try:
        yield
    except zenoh.ZError as error:
        raise BusError(f"zenoh, {what}: {_said(error)}") from None


def _said(error: Exception) -> str:
    """Return what an error of zenoh says, without the places in its source."""
    text = re.sub(r"\s+at /\S+\.rs:\d+\.?", "", str(error))
    return re.sub(r"\s+", " ", text).strip().rstrip(".!") or "failed"


def _sample(sample: zenoh.Sample) -> Sample:
    payload = sample.payload
    attachment = sample.attachment
    return Sample(
        key=str(sample.key_expr),
        encoding=str(sample.encoding),
        size=len(payload),
        read=payload.to_bytes,
        attachment=b"" if attachment is None else attachment.to_bytes(),
    )


def _with_port(endpoint: str) -> str:
    """Return the endpoint with a port that is free now, where it asks for port 0."""
    found = re.fullmatch(r"(tcp|tls|ws|quic)/(.*):0", endpoint)
    if found is None:
        return endpoint
    kind, host = found[1], found[2]
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.bind((host.strip("[]"), 0))
        return f"{kind}/{host}:{probe.getsockname()[1]}"


def _settings(config: BusConfig, listening: Sequence[str]) -> zenoh.Config:
    tls = {
        "root_ca_certificate": config.ca,
        "listen_certificate": config.certificate,
        "listen_private_key": config.key,
        "connect_certificate": config.certificate if config.mutual_tls else None,
        "connect_private_key": config.key if config.mutual_tls else None,
        "enable_mtls": config.mutual_tls or None,
    }
    values: dict[str, Any] = {
        "mode": config.mode,
        "listen/endpoints": list(listening),
        "connect/endpoints": list(config.connect),
        "scouting/multicast/enabled": False,
        # the time that a router gives others to be found: those that it connects to, or nobody
        "scouting/delay": None if config.connect else 0,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/rx/max_message_size": config.max_message,
        "transport/link/tx/queue/congestion_control/drop/wait_before_drop": SMALL_WAIT,
        "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments": (
            FRAGMENT_WAIT
        ),
        "transport/auth/usrpwd/user": config.user,
        "transport/auth/usrpwd/password": config.password,
        "transport/auth/usrpwd/dictionary_file": config.users_file and str(config.users_file),
        **{
            f"transport/link/tls/{name}": value if isinstance(value, bool) else str(value)
            for name, value in tls.items()
            if value is not None
        },
    }
    if config.rights is not None:
        workers = {"usernames": [config.workers_user]} if config.workers_user else PRIVATE
        values["access_control"] = access_control(config.rights, workers)
    made = zenoh.Config()
    for name, value in values.items():
        if value is not None:
            made.insert_json5(name, json.dumps(value))
    return made


zenoh.init_log_from_env_or("error")
