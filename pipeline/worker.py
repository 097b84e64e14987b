"""A worker owns one chain: the state of one stream. It takes a frame and gives a result.

Files, jobs and live streams all go through it. What it gives depends on nothing but
the settings and the frames it was given since it was made or reset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from pipeline.config import Settings
from pipeline.effort import FULL, Effort
from pipeline.frames import MultiViewFrame
from pipeline.results import FrameResult
from pipeline.superresolve import (
    Memory,
    RegisteredFrame,
    reconstruct_frame,
    register_frame,
    superresolve,
)
from pipeline.threads import stoppable


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
        self._targets: tuple[str, ...] = arguments.pop("targets")
        self._stop = stop
        self._arguments = arguments
        self._memory = Memory() if settings.temporal != "cold" else None

    def take(
        self,
        frame: MultiViewFrame,
        *,
        effort: Effort = FULL,
        neighbours: Sequence[MultiViewFrame] = (),
    ) -> FrameResult:
        """Return the result of the next frame; after an error the chain starts anew.

        Parameters
        ----------
        effort : Effort
            What may be left out.
        neighbours : sequence of MultiViewFrame
            Frames before and after this one, whose pixels are further constraints.
        """
        try:
            with stoppable(self._stop):
                return superresolve(
                    frame, self.settings, targets=self._targets, memory=self._memory,
                    effort=effort, stop=self._stop, neighbours=neighbours, **self._arguments,
                )  # fmt: skip
        except BaseException:
            self.reset()
            raise

    def register(
        self, frame: MultiViewFrame, *, neighbours: Sequence[MultiViewFrame] = ()
    ) -> RegisteredFrame:
        """Do the first half of the next frame; after an error the chain starts anew."""
        try:
            with stoppable(self._stop):
                return register_frame(
                    frame, self.settings, targets=self._targets, stop=self._stop,
                    memory=self._memory, neighbours=neighbours, **self._arguments,
                )  # fmt: skip
        except BaseException:
            self.reset()
            raise

    def reconstruct(self, registered: RegisteredFrame) -> FrameResult:
        """Do the second half of a frame that is registered."""
        try:
            with stoppable(self._stop):
                return reconstruct_frame(registered, stop=self._stop, memory=self._memory)
        except BaseException:
            self.reset()
            raise

    @property
    def lacks_motions(self) -> bool:
        """Whether the picture has been another one, which stands, since a frame was registered."""
        return self._memory is not None and self._memory.lacks_motions(self._targets)

    def watch(self, frame: MultiViewFrame) -> None:
        """Look at a frame that is not computed: what stands still from it on is known sooner."""
        if self._memory is not None:
            self._memory.seen.watch(frame, self.settings)

    def begin_again(self) -> None:
        """Find all motions anew, in a picture that goes on as it did."""
        if self._memory is not None:
            self._memory.begin_again()

    def reset(self) -> None:
        """Forget the frames so far: the next one to be registered is computed on its own."""
        if self._memory is not None:
            self._memory.forget()
