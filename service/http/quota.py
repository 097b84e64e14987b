"""Is there room: on the disk, in the data folder, for this client, in its queue."""

from __future__ import annotations

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
"""A measured size is believed for this long, seconds."""

_known: dict[Path, tuple[float, Mapping[str, int]]] = {}
_measuring: set[Path] = set()
_lock = threading.Lock()


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


def folder_size(folder: Path) -> int:
    """Return the bytes of the files in the data folder as of a few seconds ago."""
    return sum(_sizes(folder).values())


def _sizes(folder: Path) -> Mapping[str, int]:
    """Return the bytes of each job and upload by id, and of all else under "".

    Only the first caller waits for the measurement; later ones are made beside the requests,
    which thousands of jobs' files would hold up.
    """
    with _lock:
        if folder not in _known:
            _known[folder] = (time.monotonic(), _measured(folder))
        measured, sizes = _known[folder]
        if time.monotonic() - measured > REMEMBER and folder not in _measuring:
            _measuring.add(folder)
            threading.Thread(
                target=_measure, args=(folder,), name="depthsr-quota", daemon=True
            ).start()
        return sizes


def _measure(folder: Path) -> None:
    try:
        sizes = _measured(folder)
        with _lock:
            _known[folder] = (time.monotonic(), sizes)
    finally:
        with _lock:
            _measuring.discard(folder)


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
