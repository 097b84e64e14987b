"""Is there room: on the disk, in the data folder, for this client, in its queue."""

from __future__ import annotations

import math
import os
import shutil
import threading
import time
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from service.config import MIB
from service.http.auth import Client
from service.http.problems import ProblemError

REMEMBER = 10.0
"""After so many seconds sizes are measured anew, beside the requests."""

TOO_OLD = 30.0
"""Sizes older than this are not believed: who asks waits for new ones, seconds."""

_known: dict[Path, tuple[float, Mapping[str, int]]] = {}
"""When a folder's sizes began to be measured, and what they are."""

_noted: dict[Path, dict[str, tuple[float, int]]] = {}
"""What came since, by its id: when, and its size."""

_measuring: set[Path] = set()
_news = threading.Condition()


def check_queue(state: Any, client: Client) -> None:
    """Refuse another job to who has too many unfinished ones; ``state`` is the application's.

    Raises
    ------
    ProblemError
        ``too-many``.
    """
    most = state.config.max_queue
    counts = state.store.counts(client.name)
    if sum(count for name, count in counts.items() if not name.is_final) >= most:
        raise ProblemError(
            "too-many", f"{most} jobs are unfinished", headers={"Retry-After": "30"}
        )  # fmt: skip


def check_space(state: Any, client: Client, wanted: int) -> None:
    """Refuse what would not fit; ``state`` is the application's.

    Raises
    ------
    ProblemError
        ``disk-full``.
    """
    config = state.config
    if shutil.disk_usage(config.data).free - wanted < config.disk_reserve * MIB:
        raise ProblemError("disk-full", "the disk has no room for this")
    sizes = _sizes(config.data)
    if sum(sizes.values()) + wanted > config.quota * MIB:
        raise ProblemError("disk-full", "the quota of the service is used up; delete old jobs")
    if config.client_quota:
        own = sum(sizes.get(name, 0) for name in state.store.owned(client.name))
        if own + wanted > config.client_quota * MIB:
            raise ProblemError("disk-full", "your quota is used up; delete old jobs")


def note_size(folder: Path, owner: str, size: int) -> None:
    """Let what has just come for a job or an upload count before sizes are measured anew."""
    with _news:
        _noted.setdefault(folder, {})[owner] = (time.monotonic(), size)


def folder_size(folder: Path) -> int:
    """Return the bytes of the files in the data folder as of a few seconds ago."""
    return sum(_sizes(folder).values())


def _sizes(folder: Path) -> Mapping[str, int]:
    """Return the bytes of each job and upload by id, and of all else under "".

    They are measured beside the requests, which thousands of jobs' files would hold up; only who
    comes first, or after a long silence, waits for it.
    """
    with _news:
        measured, sizes = _known.get(folder, (-math.inf, {}))
        age = time.monotonic() - measured
        if age > REMEMBER and folder not in _measuring:
            _measuring.add(folder)
            threading.Thread(
                target=_measure, args=(folder,), name="depthsr-quota", daemon=True
            ).start()
        if age > TOO_OLD:
            _news.wait_for(lambda: folder not in _measuring)
            measured, sizes = _known.get(folder, (measured, sizes))
        noted = _noted.get(folder, {})
        return {**sizes, **{owner: size for owner, (at, size) in noted.items() if at > measured}}


def _measure(folder: Path) -> None:
    begin = time.monotonic()
    try:
        sizes = _measured(folder)
        with _news:
            _known[folder] = (begin, sizes)
            noted = _noted.pop(folder, {})
            _noted[folder] = {owner: note for owner, note in noted.items() if note[0] > begin}
    finally:
        with _news:
            _measuring.discard(folder)
            _news.notify_all()


def _measured(folder: Path) -> Mapping[str, int]:
    sizes: Counter[str] = Counter()
    for where, _, names in os.walk(folder):
        for name in names:
            path = Path(where, name)
            kind, *inside = path.relative_to(folder).parts
            owner = inside[0] if inside and kind in ("jobs", "uploads") else ""
            try:
                sizes[owner] += path.stat(follow_symlinks=False).st_size
            except FileNotFoundError:
                continue
    return sizes
