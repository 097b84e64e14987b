"""One stream as the service knows it, and those that outlive a restart of the service."""

from __future__ import annotations

import json
import logging
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.errors import PipelineError
from pipeline.media.files import write_atomic
from pipeline.media.live_manifest import LiveManifest, live_manifest
from service.bus import keys
from service.live.broadcast import Broadcast
from service.streams.process import StreamProcess
from service.streams.states import Action, State, after

log = logging.getLogger(__name__)

MAX_LOSSES = 5
"""Workers that may be lost within a minute before a stream is given up."""


@dataclass(kw_only=True)
class Stream:
    """One stream. Changed by :class:`Streams` only, under its lock."""

    id: str
    client: str
    settings: dict[str, Any]
    options: dict[str, Any]
    created: float
    state: State = State.WAITING
    run: int = 0
    """Workers so far."""
    manifest: LiveManifest | None = None
    status: dict[str, Any] = field(default_factory=dict)
    """What its worker said last."""
    problem: dict[str, Any] | None = None
    broadcasts: tuple[Broadcast, Broadcast] | None = None
    """For browsers, the result and the observed views; None before the first manifest."""
    process: StreamProcess | None = None
    losses: deque[float] = field(default_factory=lambda: deque(maxlen=MAX_LOSSES))
    begin_at: float = 0.0
    """When the next worker may be started, monotonic seconds."""
    since: float = 0.0
    """When it came to its state, monotonic seconds."""

    def act(self, action: Action) -> None:
        """Change the state."""
        state = after(self.state, action)
        if state is not self.state:
            log.info("stream %s", state, extra={"stream": self.id, "was": self.state.value})
            self.since = time.monotonic()
        self.state = state


class KeptStreams:
    """Streams that were made over HTTP, a file each; those of the bus come with their manifest.

    Parameters
    ----------
    folder : Path
        Made when it is needed.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def keep(self, item: Stream) -> None:
        """Write a stream's file, whole or not at all."""
        said = {
            "id": item.id,
            "client": item.client,
            "settings": item.settings,
            "options": item.options,
            "created": item.created,
            "stopped": item.state is State.STOPPED,
            "manifest": None if item.manifest is None else item.manifest.content,
        }
        self._folder.mkdir(parents=True, exist_ok=True)
        write_atomic(self._path(item.id), json.dumps(said).encode())

    def forget(self, stream: str) -> None:
        """Remove a stream's file, if there is one."""
        self._path(stream).unlink(missing_ok=True)

    def all(self) -> list[Stream]:
        """Return the streams as they were kept; a file that is damaged is left out and told."""
        found = []
        for path in sorted(self._folder.glob("*.json")):
            try:
                found.append(_stream(json.loads(path.read_text(encoding="utf-8"))))
            except (OSError, ValueError, KeyError, TypeError, PipelineError) as error:
                log.warning("a kept stream cannot be read: %s: %s", path.name, error)
        return found

    def sequences(self, stream: str) -> Path:
        """Return the file of the numbers of a stream's messages; it outlives the stream."""
        return self._folder / f"{stream}.sequences"

    def _path(self, stream: str) -> Path:
        return self._folder / f"{stream}.json"


def _stream(said: dict[str, Any]) -> Stream:
    if not keys.is_stream(said["id"]):
        raise ValueError("not the name of a stream")
    manifest = said["manifest"]
    return Stream(
        id=said["id"],
        client=said["client"],
        settings=dict(said["settings"]),
        options=dict(said["options"]),
        created=float(said["created"]),
        state=State.STOPPED if said["stopped"] else State.WAITING,
        manifest=None if manifest is None else live_manifest(manifest),
    )
