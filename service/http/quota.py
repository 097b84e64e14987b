"""Is there room: on the disk, and within the quota of the data folder."""

from __future__ import annotations

import os
import shutil
import threading
import time
from pathlib import Path

from service.config import MIB, ServiceConfig
from service.http.problems import ProblemError

REMEMBER = 10.0
"""A measured size is believed for this long, seconds."""

_known: dict[Path, tuple[float, int]] = {}
_measuring: set[Path] = set()
_lock = threading.Lock()


def check_space(config: ServiceConfig, wanted: int) -> None:
    """Refuse what would not fit.

    Raises
    ------
    ProblemError
        ``disk-full``.
    """
    if shutil.disk_usage(config.data).free - wanted < config.disk_reserve * MIB:
        raise ProblemError("disk-full", "the disk has no room for this")
    if folder_size(config.data) + wanted > config.quota * MIB:
        raise ProblemError("disk-full", "the quota of the service is used up; delete old jobs")


def folder_size(folder: Path) -> int:
    """Return the bytes of the files in a folder as of a few seconds ago.

    Only the first caller waits for the measurement; later ones are made beside the requests,
    which thousands of jobs' files would hold up.
    """
    with _lock:
        if folder not in _known:
            _known[folder] = (time.monotonic(), _size(folder))
        measured, size = _known[folder]
        if time.monotonic() - measured > REMEMBER and folder not in _measuring:
            _measuring.add(folder)
            threading.Thread(
                target=_measure, args=(folder,), name="depthsr-quota", daemon=True
            ).start()
        return size


def _measure(folder: Path) -> None:
    try:
        size = _size(folder)
        with _lock:
            _known[folder] = (time.monotonic(), size)
    finally:
        with _lock:
            _measuring.discard(folder)


def _size(folder: Path) -> int:
    total = 0
    for where, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.stat(os.path.join(where, name), follow_symlinks=False).st_size
            except FileNotFoundError:
                continue
    return total
