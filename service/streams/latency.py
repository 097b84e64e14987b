"""How long each stage took, over the last frames. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

STAGES = ("wait", "decode", "superresolve", "pack", "encode", "publish", "pictures", "total")
"""From the arrival of a frame's last part to its publication, in order; ``total`` is all of it but
``pictures``, which come after it."""

KEEP = 100
"""Frames that count."""


class Latency:
    """The last frames' seconds by stage."""

    def __init__(self, keep: int = KEEP) -> None:
        self._kept: deque[Mapping[str, float]] = deque(maxlen=keep)

    def add(self, seconds: Mapping[str, float]) -> None:
        """Take the stages of one frame, seconds."""
        self._kept.append(dict(seconds))

    def summary(self) -> dict[str, dict[str, float]]:
        """Return median, 95th percentile and largest of each stage, milliseconds.

        >>> latency = Latency()
        >>> for number in range(1, 101):
        ...     latency.add({"total": number / 1000})
        >>> latency.summary()["total"]
        {'median_ms': 51.0, 'p95_ms': 96.0, 'max_ms': 100.0}
        """
        found: dict[str, dict[str, float]] = {}
        for stage in STAGES:
            times = sorted(item[stage] for item in self._kept if stage in item)
            if times:
                found[stage] = {
                    "median_ms": _ms(times[len(times) // 2]),
                    "p95_ms": _ms(times[min(len(times) - 1, int(0.95 * len(times)))]),
                    "max_ms": _ms(times[-1]),
                }
        return found


class Rate:
    """Events a second over the last few seconds."""

    def __init__(self, seconds: float = 5.0) -> None:
        self._seconds = seconds
        self._times: deque[float] = deque(maxlen=1024)

    def add(self, now: float) -> None:
        """Count one at this time (seconds)."""
        self._times.append(now)

    def value(self, now: float) -> float:
        """Return how many a second."""
        recent = sum(1 for at in self._times if now - at <= self._seconds)
        return round(recent / self._seconds, 2)


def _ms(seconds: float) -> float:
    return round(1000 * seconds, 3)
