"""A process of its own for one stream: the order on stdin, how it goes on stdout.

stdin: one line of JSON (:class:`StreamOrder`); later the line ``stop``, and for
browsers what they want (:class:`service.streams.stills.Wish`); its end
means that the service is gone, and this process ends at once. stdout: a line of
JSON for each event: ``beat`` every second, ``status``, last ``stopped`` or
``problem``. A pipe named in the order carries pictures for browsers as records:
one letter (``m`` fragmented MP4, ``b`` that of the observed views, ``p`` that
this one pauses, ``j`` JPEG, ``s`` that there is no picture newer than the last
``j``), four bytes of length (big-endian), the bytes. Each ``still`` is answered
by ``j`` or ``s``.
"""

from __future__ import annotations

import json
import logging
import os
import queue
import signal
import struct
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.child import Voice, begin, limit_memory, take_stdout

if TYPE_CHECKING:
    from service.streams.session import StreamSession

log = logging.getLogger(__name__)

RECORD = struct.Struct(">cI")
"""Head of a record: kind and length."""

KINDS = {"mp4": b"m", "jpeg": b"j", "before": b"b", "pause": b"p", "same": b"s"}


@dataclass(frozen=True, kw_only=True)
class StreamOrder:
    """What a worker is to do."""

    stream: str
    run: int
    manifest: dict[str, Any]
    settings: dict[str, Any]
    options: dict[str, Any]
    bus: dict[str, Any]
    """Fields of :class:`service.bus.config.BusConfig`; paths as text."""
    pictures: int
    """File descriptor of the pipe for browsers."""
    sequences: str
    """File of the numbers of its messages."""
    memory: int = 0
    """Address space, bytes; 0 is no limit."""
    max_pixels: int = 1 << 25
    max_payload: int = 64 << 20
    max_rate: float = 60.0


def main() -> int:
    """Do what stdin orders."""
    voice = take_stdout()
    order = StreamOrder(**json.loads(sys.stdin.readline()))
    limit_memory(order.memory)
    orders = begin(voice)

    from pipeline.numba_cache import prepare_numba_cache

    prepare_numba_cache()
    from pipeline.errors import PipelineError

    try:
        _work(order, voice, orders)
    except PipelineError as error:
        voice.say("problem", code=error.code, text=str(error))
        return 1
    except MemoryError:
        voice.say("problem", code="memory-limit", text="the worker ran out of memory")
        return 1
    voice.say("stopped")
    return 0


def _work(order: StreamOrder, voice: Voice, orders: queue.SimpleQueue[str]) -> None:
    from pipeline.config import Settings
    from pipeline.media.live_manifest import live_manifest
    from pipeline.threads import set_threads
    from service.bus.zenoh_bus import ZenohBus
    from service.streams.options import StreamOptions
    from service.streams.sequences import Sequences
    from service.streams.session import Limits, StreamSession

    settings = Settings(**order.settings)
    set_threads(settings.threads)
    pictures = PicturePipe(order.pictures)
    with ZenohBus(_bus_config(order.bus)) as bus:
        session = StreamSession(
            bus,
            order.stream,
            live_manifest(order.manifest),
            settings=settings,
            options=StreamOptions(**order.options),
            limits=Limits(
                max_pixels=order.max_pixels,
                max_payload=order.max_payload,
                max_rate=order.max_rate,
            ),
            run=order.run,
            sequences=Sequences(Path(order.sequences), run=order.run),
            to_service=pictures.send,
            on_status=lambda status: voice.say("status", status=status),
        )
        signal.signal(signal.SIGTERM, lambda number, frame: session.stop())
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # the service's to handle
        threading.Thread(target=_grant, args=(orders, session), daemon=True).start()
        session.prepare()
        voice.say("ready")
        session.run()


def _grant(orders: queue.SimpleQueue[str], session: StreamSession) -> None:
    """Do what browsers wish, as long as this process lives."""
    from service.streams.stills import Wish

    while True:
        try:
            session.wish(Wish(orders.get().strip()))
        except Exception:
            log.warning("a picture could not be shown", exc_info=True)


class PicturePipe:
    """Writes records for browsers; a service that is gone ends the process."""

    def __init__(self, descriptor: int) -> None:
        self._file = os.fdopen(descriptor, "wb", buffering=0)
        self._lock = threading.Lock()

    def send(self, kind: str, data: bytes) -> None:
        """Write one record."""
        record = memoryview(RECORD.pack(KINDS[kind], len(data)) + data)
        try:
            with self._lock:
                while record:
                    record = record[self._file.write(record) :]
        except OSError:
            os._exit(1)


def _bus_config(fields: dict[str, Any]) -> Any:
    from service.bus.config import BusConfig

    paths = ("ca", "certificate", "key", "users_file")
    values: dict[str, Any] = {
        name: Path(value) if name in paths and value is not None else value
        for name, value in fields.items()
    }
    values |= {name: tuple(fields[name]) for name in ("listen", "connect")}
    return BusConfig(**values)


if __name__ == "__main__":
    sys.exit(main())
