"""A folder for the socket of our own workers: short of path, ours alone, gone when we are."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from pathlib import Path

PREFIX = "depthsr-bus-"
"""Of the folders' names, in the folder of temporary files."""


class PrivateFolder:
    """A new folder that nobody else may open; it is locked for as long as this process lives.

    In the folder of temporary files, since the path of a socket may not be long. Whatever
    services that were killed have left there is removed first: folders that nobody locks.
    """

    def __init__(self) -> None:
        _sweep()
        while True:
            self.path = Path(tempfile.mkdtemp(prefix=PREFIX))
            lock = _locked(self.path, fcntl.LOCK_EX)
            if lock is not None:
                self._lock = lock
                return

    def close(self) -> None:
        """Remove it with all that is in it."""
        shutil.rmtree(self.path, ignore_errors=True)
        os.close(self._lock)


def _sweep() -> None:
    """Remove the folders of this user that nobody locks."""
    for folder in Path(tempfile.gettempdir()).glob(f"{PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.lstat().st_uid != os.getuid():
                continue
            lock = _locked(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if lock is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(lock)


def _locked(folder: Path, how: int) -> int | None:
    """Lock a folder; return the descriptor that holds the lock, or None where it is gone.

    Raises
    ------
    OSError
        If another process has locked it and ``how`` does not wait, or it is no folder.
    """
    try:
        lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(lock, how)
        if os.fstat(lock).st_nlink:
            return lock
    except OSError:
        os.close(lock)
        raise
    os.close(lock)
    return None
