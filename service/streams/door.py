"""How our own workers reach the bus: by a socket in a folder that nobody else may open.

The folder's path is short, as a socket's may not be long; it is gone when we are.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import secrets
import shutil
import tempfile
from dataclasses import replace
from pathlib import Path

from service.bus.config import BusConfig

PREFIX = "depthsr-bus-"
"""Of the folders' names, in the folder of temporary files."""


class WorkersDoor:
    """The socket of one service's workers and, where users are asked for, their user."""

    def __init__(self) -> None:
        self._folder: PrivateFolder | None = None
        self._user, self._password = f"worker-{secrets.token_hex(4)}", secrets.token_hex(16)

    def opened(self, config: BusConfig) -> BusConfig:
        """Return the settings by which the service listens at this door, too.

        A client of another router has none: its workers go there themselves.
        """
        if config.mode == "client":
            return config
        if self._folder is None:
            self._folder = PrivateFolder()
        users = None
        if config.users_file is not None:
            users = self._folder.path / "users"
            users.touch(mode=0o600)
            known = config.users_file.read_text(encoding="utf-8").rstrip("\n")
            users.write_text(f"{known}\n{self._user}:{self._password}\n", encoding="utf-8")
        return replace(
            config,
            listen=(*config.listen, self._endpoint),
            users_file=users,
            workers_user=None if users is None else self._user,
        )

    def for_workers(self, config: BusConfig) -> BusConfig:
        """Return the settings by which the workers come in."""
        if self._folder is None:
            return replace(config, listen=())
        is_asked = config.users_file is not None
        return BusConfig(
            connect=(self._endpoint,),
            user=self._user if is_asked else None,
            password=self._password if is_asked else None,
            max_message=config.max_message,
        )

    def close(self) -> None:
        """Remove the folder, if there is one."""
        if self._folder is not None:
            self._folder.close()

    @property
    def _endpoint(self) -> str:
        assert self._folder is not None  # the door is open
        return f"unixsock-stream/{self._folder.path}/bus"


class PrivateFolder:
    """A new folder that nobody else may open; it is locked for as long as this process lives.

    It lies in the folder of temporary files. What services that were killed have left there is
    removed first: folders that nobody locks.
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
