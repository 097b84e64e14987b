"""Where compiled kernels are kept between runs; decided before numba is imported.

numba reads ``NUMBA_CACHE_DIR`` once, when it is imported, so that this module
must run first and must not import numba itself. numba uses no folder that it
cannot write; a cache built ahead and installed read-only is therefore copied to
where the user may write.

numba asks of a kernel's own file alone whether it has changed, not of those with what is
compiled into it. So each edition of the sources has a folder of its own.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import MutableMapping
from pathlib import Path

KEPT = 60 * 86400
"""Seconds for which the kernels of an edition are kept that nobody has used."""


@functools.cache
def edition() -> str:
    """Return what tells the sources of these kernels from others.

    A digest of the modules with kernels, and of those that they import, whose constants are
    compiled into them.
    """
    root = Path(__file__).parents[1]
    sources = {path: path.read_bytes() for path in root.joinpath("pipeline").rglob("*.py")}
    asked = {path for path, source in sources.items() if b"njit" in source}
    for source in [sources[path] for path in asked]:
        names = re.findall(rb"^from (pipeline[.\w]*) import", source, re.MULTILINE)
        asked |= {root.joinpath(*name.decode().split(".")).with_suffix(".py") for name in names}
    digest = hashlib.sha256()
    for path in sorted(asked & sources.keys()):
        digest.update(str(path.relative_to(root)).encode() + b"\0" + sources[path] + b"\0")
    return digest.hexdigest()[:16]


def user_folder(environment: MutableMapping[str, str]) -> Path:
    """Return the user's own folder: XDG_CACHE_HOME/depthsr/numba or ~/.cache/depthsr/numba."""
    shared = environment.get("XDG_CACHE_HOME")
    home = environment.get("HOME")
    base = Path(shared) if shared else (Path(home) if home else Path.home()) / ".cache"
    return base / "depthsr" / "numba"


def prepare_numba_cache(environment: MutableMapping[str, str] = os.environ) -> Path:
    """Point numba at the cache folder, and return it; a ``NUMBA_CACHE_DIR`` that is set stays.

    In this order: ``DEPTHSR_CACHE``/numba where it can be written, the user's
    cache folder, a temporary folder; in each, that of this edition. What a read-only
    ``DEPTHSR_CACHE`` holds of it is copied there, and others that have not been used for
    long are removed.
    """
    chosen = environment.get("NUMBA_CACHE_DIR")
    if chosen:
        return Path(chosen)
    own = environment.get("DEPTHSR_CACHE")
    built_ahead = Path(own) / "numba" if own else None
    if built_ahead is not None and _can_write(built_ahead):
        folder = built_ahead / edition()
    else:
        folder = _user_cache(environment) / edition()
    folder.mkdir(mode=0o700, exist_ok=True)
    _remove_unused(folder)
    if built_ahead is not None:
        _copy_missing(built_ahead / edition(), folder)
    environment["NUMBA_CACHE_DIR"] = str(folder)
    if environment is os.environ and "numba" in sys.modules:
        # Too late for the variable: tell the module, which has read it already.
        sys.modules["numba"].config.CACHE_DIR = str(folder)
    return folder


def _user_cache(environment: MutableMapping[str, str]) -> Path:
    """Return the user's own folder, or a temporary one where that cannot be written."""
    folder = user_folder(environment)
    if _can_write(folder):
        return folder
    name = f"depthsr-numba-{os.getuid()}" if hasattr(os, "getuid") else "depthsr-numba"
    folder = Path(tempfile.gettempdir()) / name
    if not _can_write(folder) or not _is_ours(folder):
        folder = Path(tempfile.mkdtemp(prefix="depthsr-numba-"))
    return folder


def _can_write(folder: Path) -> bool:
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _is_ours(folder: Path) -> bool:
    """Return whether nobody else may put code there: compiled kernels are executed."""
    if not hasattr(os, "getuid"):
        return True
    status = folder.lstat()
    return status.st_uid == os.getuid() and not status.st_mode & 0o022


def _remove_unused(folder: Path) -> None:
    """Remove what lies beside a folder that is used and has not been for long itself."""
    with contextlib.suppress(OSError):
        os.utime(folder)
        for other in folder.parent.iterdir():
            if other.is_dir() and time.time() - other.stat().st_mtime > KEPT:
                shutil.rmtree(other, ignore_errors=True)


def _copy_missing(source: Path, target: Path) -> None:
    """Copy the files that are not there yet, each whole or not at all; never mind a failure."""
    with contextlib.suppress(OSError):
        for path in sorted(source.rglob("*.nb[ic]")):
            copy = target / path.relative_to(source)
            if not copy.exists():
                copy.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                half = copy.with_name(f"{copy.name}.{os.getpid()}.tmp")
                shutil.copy2(path, half)
                half.replace(copy)
