"""How long each stage of a frame took, and a stop let through between them."""

from __future__ import annotations

import time
from collections.abc import Callable

from pipeline.errors import Interrupted


class Stages:
    """Times the stages, and lets a stop through between them."""

    def __init__(self, stop: Callable[[], bool] | None) -> None:
        self._stop = stop
        self._begin = time.perf_counter()
        self.timings: dict[str, float] = {}

    def done(self, stage: str) -> None:
        """Note the end of a stage, which begins the next."""
        now = time.perf_counter()
        self.timings[stage] = now - self._begin
        self._begin = now
        if self._stop is not None and self._stop():
            raise Interrupted
