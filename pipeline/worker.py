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
from pipeline.superresolve import Memory, RegisteredFrame, reconstruct_frame, register_frame


class Worker:
    """Super-resolves the frames of one stream, one after another.

    :meth:`take` does all of a frame. Two stages may share the work instead: one thread calls
    :meth:`register` for every frame, another :meth:`reconstruct` for every result of that, both
    in the order of the frames; the results are the same.

    Parameters
    ----------
    settings : Settings
    stop : callable, optional
        Polled often; the work ends with :class:`Interrupted` once it says so.
    arguments : keyword arguments of :func:`pipeline.superresolve.superresolve`
        The same for every frame: targets, observed views, PSF and so on.
    """

    def __init__(
        self, settings: Settings, *, stop: Callable[[], bool] | None = None, **arguments: Any
    ) -> None:
        self.settings = settings
        self._stop = stop
        self._arguments = arguments
        self._memory = Memory() if settings.temporal == "warm" else None

    def take(self, frame: MultiViewFrame) -> FrameResult:
        """Return the result of the next frame; after an error the chain starts anew."""
        return self.reconstruct(self.register(frame))

    def register(self, frame: MultiViewFrame) -> RegisteredFrame:
        """Do the first half of the next frame; after an error the chain starts anew."""
        try:
            return register_frame(
                frame, self.settings, stop=self._stop, memory=self._memory, **self._arguments
            )
        except BaseException:
            self.reset()
            raise

    def reconstruct(self, registered: RegisteredFrame) -> FrameResult:
        """Do the second half of a frame that is registered."""
        try:
            return reconstruct_frame(registered, stop=self._stop, memory=self._memory)
        except BaseException:
            self.reset()
            raise

    def reset(self) -> None:
        """Forget the frames so far: the next one to be registered is computed on its own."""
        if self._memory is not None:
            self._memory.forget()
