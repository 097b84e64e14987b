"""The machine: what it has to give, and enough of it to compare what was measured on it."""

from __future__ import annotations

import ctypes
import math
import os
import platform
import re
from datetime import UTC, datetime
from pathlib import Path

from pipeline.report import versions

KEPT = 512 << 20
"""Bytes that a process keeps for itself of what it has given back, at most, where they lie at the
end of all it has."""

LARGE = 32 << 20
"""Bytes from which on an array is none of them: glibc allows no more."""

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
"""Parameters of glibc's ``mallopt``."""


def today() -> str:
    """Return the date (UTC), as 2025-01-31."""
    return datetime.now(UTC).date().isoformat()


def cpu_model() -> str:
    """Return the name of the processor, as far as the system tells."""
    table = Path("/proc/cpuinfo")
    if table.is_file():
        for line in table.read_text(encoding="utf-8", errors="replace").splitlines():
            key, _, value = line.partition(":")
            if key.strip() == "model name" and value.strip():
                return " ".join(value.split())
    return platform.processor() or platform.machine() or "unknown processor"


def load_average() -> float:
    """Return how many threads wanted to run in the last minute, NaN where not known."""
    return os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan


def available_cores() -> int:
    """Return the number of cores this process may use, ≥ 1."""
    if hasattr(os, "sched_getaffinity"):
        return max(1, len(os.sched_getaffinity(0)))
    return max(1, os.cpu_count() or 1)


def keep_memory() -> None:
    """Let the memory of arrays that are gone serve those to come.

    Each frame needs arrays like those of the one before it. The C library would return theirs to
    the system, which clears every page before it gives it out again, while other threads of the
    process wait for its map of memory. Where it is not glibc nothing is done.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt is not None:
        mallopt(TRIM_THRESHOLD, KEPT)
        mallopt(MMAP_THRESHOLD, LARGE)


def available_memory(root: Path = Path("/")) -> float:
    """Return the bytes that may still be taken: by the machine, or by this control group.

    Infinite where the system does not tell. Files that the system keeps in memory only because
    nobody needs it count as free.
    """

    def numbers(name: str, pattern: str) -> list[float]:
        file = root / name
        text = file.read_text(encoding="ascii") if file.is_file() else ""
        return [float(number) for number in re.findall(pattern, text, re.M)]

    group = "sys/fs/cgroup/memory"
    free = [1024 * size for size in numbers("proc/meminfo", r"^MemAvailable: +(\d+) kB$")]
    for most in numbers(f"{group}.max", r"^(\d+)$"):
        taken = sum(numbers(f"{group}.current", r"^(\d+)$"))
        free.append(most - taken + sum(numbers(f"{group}.stat", r"^inactive_file (\d+)$")))
    return min(free, default=math.inf)


def machine() -> dict[str, str]:
    """Return processor, cores, system and versions, by what they are."""
    return {
        "processor": cpu_model(),
        "cores": str(available_cores()),
        "system": f"{platform.system()} {platform.machine()}",
        **versions(),
    }


def described() -> str:
    """Return the machine in one line."""
    facts = machine()
    packages = ", ".join(
        f"{name} {version}"
        for name, version in facts.items()
        if name not in ("processor", "cores", "system")
    )
    return f"{facts['processor']}, {facts['cores']} cores, {facts['system']}; {packages}"
