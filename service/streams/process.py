"""The worker process of a stream, as the service holds it."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import IO, Any

from service.child import environment
from service.streams.stills import Wish
from service.streams.worker import RECORD, StreamOrder

log = logging.getLogger(__name__)

LOG_LIMIT = 1 << 20
"""A worker's log is begun anew beyond this, bytes."""

MAX_RECORD = 64 << 20
"""Longest record of pictures, bytes."""


class StreamProcess:
    """One process; its callbacks run in threads of their own.

    Parameters
    ----------
    order : StreamOrder
        Without the pipe, which is made here.
    log_file : Path
        Where what it writes to stderr goes.
    on_event : callable
        Told (kind, data) of all it says but heartbeats.
    on_picture : callable
        Given (letter, bytes) of each record for browsers.
    on_end : callable
        Told the last event, or {} where it just vanished.
    """

    def __init__(
        self,
        order: StreamOrder,
        log_file: Path,
        *,
        on_event: Callable[[str, dict[str, Any]], None],
        on_picture: Callable[[bytes, bytes], None],
        on_end: Callable[[dict[str, Any]], None],
    ) -> None:
        self._on_event, self._on_picture, self._on_end = on_event, on_picture, on_end
        self.asked_to_stop = False
        self._writing = threading.Lock()
        self._heard = time.monotonic()
        ours, theirs = os.pipe()
        try:
            log_file.parent.mkdir(parents=True, exist_ok=True)
            too_long = log_file.exists() and log_file.stat().st_size > LOG_LIMIT
            with log_file.open("w" if too_long else "a", encoding="utf-8") as errors:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "service.streams.worker"],
                    stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True,
                    encoding="utf-8", env=environment(), start_new_session=True,
                    pass_fds=(theirs,),
                )  # fmt: skip
        except BaseException:
            os.close(ours)
            raise
        finally:
            os.close(theirs)
        self._extra = {"stream": order.stream, "run": order.run}
        log.info("stream worker started", extra=self._extra)
        self._write(json.dumps(asdict(replace(order, pictures=theirs))))
        name = f"depthsr-stream-{order.stream}"
        self._threads = [
            threading.Thread(target=self._listen, name=name, daemon=True),
            threading.Thread(
                target=self._read_pictures, args=(os.fdopen(ours, "rb"),), name=name, daemon=True
            ),
        ]
        for thread in self._threads:
            thread.start()

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    @property
    def silent_seconds(self) -> float:
        """Time since the last sign of life."""
        return time.monotonic() - self._heard

    def stop(self) -> None:
        """Ask it to end."""
        self.asked_to_stop = True
        self._write("stop")

    def kill(self) -> None:
        """End it."""
        self._process.kill()

    def wish(self, wish: Wish) -> None:
        """Ask it for pictures."""
        self._write(wish)

    def join(self, seconds: float) -> None:
        """Wait for its end, as long as that."""
        self._threads[0].join(seconds)  # it waits for the other one

    def _write(self, line: str) -> None:
        assert self._process.stdin is not None
        with self._writing, contextlib.suppress(OSError, ValueError):
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()

    def _listen(self) -> None:
        last: dict[str, Any] = {}
        process = self._process
        assert process.stdout is not None
        assert process.stdin is not None
        for line in process.stdout:
            try:
                said = json.loads(line)
                kind = said.pop("event")
            except (ValueError, KeyError, AttributeError):
                continue  # torn off by a kill
            self._heard = time.monotonic()
            if kind in ("stopped", "problem"):
                last = {"event": kind, **said}
            elif kind != "beat":
                self._on_event(kind, said)
        with contextlib.suppress(OSError):
            process.stdin.close()
        process.wait()
        process.stdout.close()
        log.info("stream worker ended", extra={**self._extra, "status": process.returncode})
        self._threads[1].join()
        self._on_end(last)

    def _read_pictures(self, pipe: IO[bytes]) -> None:
        with pipe:
            while len(head := pipe.read(RECORD.size)) == RECORD.size:
                kind, length = RECORD.unpack(head)
                if length > MAX_RECORD:
                    log.warning("stream worker sends nonsense: killed", extra=self._extra)
                    self.kill()
                    return
                data = pipe.read(length)
                if len(data) == length:
                    self._on_picture(kind, data)
