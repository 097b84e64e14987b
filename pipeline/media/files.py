"""Files that are whole or not there: written under another name, then renamed.

A reader never meets a half-written file under its final name, whatever kills
the writer; what is left behind then is called ``.<name>.<random>.tmp``.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from pathlib import Path

from pipeline.errors import OutputError

TEMPORARY_SUFFIX = ".tmp"
"""How the names of unfinished files end."""

_NAME_KEPT = 80
"""Characters of the final name kept in the temporary one, so that it stays a legal name."""

_WRITE_ONLY_ERRORS = frozenset({errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS})
"""Errors that no reading can cause, so that they are always the output's."""

_REASONS = {
    errno.ENOSPC: "the disk is full; free some space or write elsewhere",
    errno.EDQUOT: "the disk quota is used up; free some space or write elsewhere",
    errno.EFBIG: "the file grew beyond the allowed size; raise the limit or write fewer frames",
    errno.EROFS: "the file system is read-only; write elsewhere",
    errno.EACCES: "permission denied; choose a folder you may write to",
    errno.EPERM: "the system does not permit it; choose a folder you may write to",
    errno.ENOENT: "the folder does not exist; create it first",
    errno.ENOTDIR: "its parent is a file, not a folder; choose another path",
    errno.ENAMETOOLONG: "the name is too long; choose a shorter one",
}
"""What to tell people, by error number."""


@contextlib.contextmanager
def atomic_path(final: Path) -> Iterator[Path]:
    """Give a temporary path to write to; rename it to ``final`` when all went well.

    The temporary file exists (empty) and lies in the same folder. At the end
    it is flushed to the disk, renamed, and the folder is flushed, so that the
    name survives a power cut only together with its content. On any error,
    interruption included, it is removed and ``final`` stays as it was.

    Parameters
    ----------
    final : Path
        The name in the end; an existing file is replaced. A link is followed.

    Yields
    ------
    Path
        Where to write.

    Raises
    ------
    OutputError
        If the file cannot be made, flushed or renamed, or the disk ran full
        while it was written. Other errors of the body pass unchanged.
    """
    target = Path(os.path.realpath(final))
    temporary = _reserve(final, target)
    try:
        try:
            yield temporary
        except OSError as error:
            if error.errno in _WRITE_ONLY_ERRORS:
                raise output_error(final, error) from error
            raise
        try:
            _flush(temporary)
            os.replace(temporary, target)
            _flush_folder(target.parent)
        except OSError as error:
            raise output_error(final, error) from error
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def write_atomic(final: Path, content: bytes) -> None:
    """Write a whole file, or none.

    Raises
    ------
    OutputError
        As :func:`atomic_path`.
    """
    with atomic_path(final) as temporary:
        try:
            temporary.write_bytes(content)
        except OSError as error:
            raise output_error(final, error) from error


def check_writable(path: Path) -> None:
    """Make sure that a file can be written, by trying, before the work starts.

    An existing file is left as it is.

    Raises
    ------
    OutputError
        If the path is a folder or a device, its folder is missing or cannot be
        written to; the message says what to do.
    """
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise OutputError(f"{path}: cannot be written: it is a folder; give a file name in it")
    if target.exists() and not target.is_file():
        raise OutputError(f"{path}: cannot be written: it is not an ordinary file")
    if not target.parent.exists():
        raise OutputError(
            f"{path}: cannot be written: there is no folder {target.parent}; create it first"
        )
    _try_writing(path, target)


def check_folder_writable(folder: Path) -> None:
    """Make a folder where there is none, and make sure that files can be written in it.

    Raises
    ------
    OutputError
        If it cannot be made or written to; the message says what to do.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: cannot be written: it is a file, not a folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise output_error(folder, error) from error
    _try_writing(folder, Path(os.path.realpath(folder)) / "probe")


def remove_leftovers(final: Path) -> int:
    """Remove what killed writers of this file left behind; return how many files it was.

    Only for callers who know that nobody is writing ``final`` just now.
    """
    target = Path(os.path.realpath(final))
    prefix = _temporary_prefix(target)
    leftovers = [
        path
        for path in (target.parent.iterdir() if target.parent.is_dir() else ())
        if path.name.startswith(prefix) and path.name.endswith(TEMPORARY_SUFFIX)
    ]
    for path in leftovers:
        path.unlink(missing_ok=True)
    return len(leftovers)


def output_error(path: Path, error: OSError) -> OutputError:
    """Return the error to raise when the system refuses to write ``path``."""
    reason = _REASONS.get(error.errno or 0) or error.strerror or str(error)
    return OutputError(f"{path}: cannot be written: {reason}")


def _temporary_prefix(target: Path) -> str:
    return f".{target.name[:_NAME_KEPT]}."


def _reserve(final: Path, target: Path) -> Path:
    """Create the empty temporary file of ``target``, with the permissions of a new file."""
    if target.is_dir():
        raise OutputError(f"{final}: cannot be written: it is a folder; give a file name in it")
    name = f"{_temporary_prefix(target)}{secrets.token_hex(6)}{TEMPORARY_SUFFIX}"
    temporary = target.with_name(name)
    try:
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise output_error(final, error) from error
    return temporary


def _try_writing(path: Path, target: Path) -> None:
    """Create, fill, flush and remove a small file beside ``target``."""
    temporary = _reserve(path, target)
    try:
        temporary.write_bytes(b"depthsr")
        _flush(temporary)
    except OSError as error:
        raise output_error(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink()


def _flush(path: Path) -> None:
    """Wait until the file's content is on the disk."""
    descriptor = os.open(path, os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _flush_folder(folder: Path) -> None:
    """Wait until the folder's list of names is on the disk, where the system can."""
    if os.name == "nt":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP):
            raise
    finally:
        os.close(descriptor)


class Outlet:
    """A file in memory for those who write and cannot seek: what was written is taken away."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []

    def write(self, data: bytes) -> int:
        """Keep the bytes until they are taken; return their number."""
        self._parts.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def close(self) -> None:
        """Do nothing: what was written can still be taken."""

    def take(self) -> bytes:
        """Return what was written since the last time."""
        parts, self._parts = self._parts, []
        return b"".join(parts)
