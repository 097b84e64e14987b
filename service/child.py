"""What every worker process has: a voice, a heartbeat, an ear for its end, a limit of memory."""

from __future__ import annotations

import json
import os
import queue
import resource
import signal
import sys
import threading
import time
from pathlib import Path
from typing import IO

BEAT = 1.0
"""Seconds between two signs of life."""


class Voice:
    """Writes lines to the service; whole ones, from any thread."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._lock = threading.Lock()

    def say(self, event: str, **data: object) -> None:
        """Write one line; a service that is gone ends the process."""
        try:
            with self._lock:
                self._stream.write(json.dumps({"event": event, **data}) + "\n")
                self._stream.flush()
        except OSError:
            os._exit(1)


def take_stdout() -> Voice:
    """Return the voice on stdout; whatever else prints goes to stderr from now on."""
    voice = Voice(os.fdopen(os.dup(1), "w", encoding="utf-8"))
    os.dup2(2, 1)
    return voice


def log_to(path: Path) -> None:
    """Append whatever is printed from now on to a file."""
    with path.open("ab") as file:
        for descriptor in (1, 2):
            os.dup2(file.fileno(), descriptor)


def step_back(nice: int) -> None:
    """Let others go first: this thread, and those that it starts."""
    if nice > os.getpriority(os.PRIO_PROCESS, 0):
        os.setpriority(os.PRIO_PROCESS, 0, nice)


def limit_memory(size: int) -> None:
    """Allow no more than this address space (bytes; 0: any), and no core dumps."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if size:
        resource.setrlimit(resource.RLIMIT_AS, (size, size))


def begin(voice: Voice) -> queue.SimpleQueue[str]:
    """Beat every second; end with a signal when stdin says ``stop``, at once when it ends.

    Returns the other lines of stdin as they come.
    """
    orders: queue.SimpleQueue[str] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(orders,), daemon=True).start()
    threading.Thread(target=_beat, args=(voice,), daemon=True).start()
    return orders


def _listen(orders: queue.SimpleQueue[str]) -> None:
    for line in sys.stdin:
        if line.strip() == "stop":
            os.kill(os.getpid(), signal.SIGTERM)
        else:
            orders.put(line)
    os._exit(1)


def _beat(voice: Voice) -> None:
    while True:
        time.sleep(BEAT)
        voice.say("beat")


def environment() -> dict[str, str]:
    """Return the environment of a worker: ours without anything of the service's."""
    kept = {"DEPTHSR_CACHE"}
    return {
        name: value
        for name, value in os.environ.items()
        if not name.startswith("DEPTHSR_") or name in kept
    }
