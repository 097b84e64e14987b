"""A worker owns one chain: the state of one stream. It takes a frame and gives a result.

Files, jobs and live streams all go through it. What it gives depends on nothing but
the settings and the frames it was given since it was made or reset.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pipeline.config import Settings
from pipeline.frames import MultiViewFrame
from pipeline.results import FrameResult
from pipeline.superresolve import Memory, superresolve


class Worker:
    """Super-resolves the frames of one stream, one after another.

    Parameters
    ----------
    settings : Settings
    compute : callable
        What super-resolves one frame: :func:`superresolve`, or another in tests.
    arguments : keyword arguments of ``compute``
        The same for every frame: targets, observed views, PSF and so on.
    """

    def __init__(
        self,
        settings: Settings,
        *,
        compute: Callable[..., FrameResult] = superresolve,
        **arguments: Any,
    ) -> None:
        self.settings = settings
        self._compute = compute
        self._arguments = arguments
        self._memory = Memory() if settings.temporal == "warm" else None

    def take(self, frame: MultiViewFrame) -> FrameResult:
        """Return the result of the next frame; after an error the chain starts anew."""
        arguments = self._arguments
        if self._memory is not None:
            arguments = arguments | {"memory": self._memory}
        try:
            return self._compute(frame, self.settings, **arguments)
        except BaseException:
            self.reset()
            raise

    def reset(self) -> None:
        """Forget the frames so far: the next one is computed on its own."""
        if self._memory is not None:
            self._memory.forget()
