"""What a test needs and may not find: skipped with a line that says so, under CI=true failed."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import pytest


def absent(reason: str) -> NoReturn:
    """Skip the test for this reason; under CI=true fail it."""
    if os.environ.get("CI") == "true":
        pytest.fail(reason, pytrace=False)
    pytest.skip(reason)


def program(name: str) -> str:
    """Return the path of an outside program, or let the test end as :func:`absent` does."""
    found = shutil.which(name)
    if found is None:
        absent(f"{name} is not installed")
    return found


@contextlib.contextmanager
def small_disk(folder: Path, size: str) -> Iterator[None]:
    """Mount a file system of its own at a new folder, where the test may; size as ``64k``."""
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    try:
        mounted = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        absent("no file system can be mounted here: a full disk cannot be tried")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)
