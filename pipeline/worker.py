"""A worker owns one chain: the state of one stream. It takes a frame and gives a result.

Files, jobs and live streams all go through it. What it gives depends on nothing but
the settings and the frames it was given since it was made or reset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from pipeline.config import Settings
from pipeline.effort import FULL, Effort
from pipeline.frames import MultiViewFrame
from pipeline.results import FrameResult
from pipeline.superresolve import (
    Memory,
    RegisteredFrame,
    begin_anew,
    go_on_anew,
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
        with self._watched():
            return superresolve(
                frame, self.settings, targets=self._targets, memory=self._memory,
                effort=effort, stop=self._stop, neighbours=neighbours, **self._arguments,
            )  # fmt: skip

    def register(
        self, frame: MultiViewFrame, *, neighbours: Sequence[MultiViewFrame] = ()
    ) -> RegisteredFrame:
        """Do the first half of the next frame; after an error the chain starts anew."""
        with self._watched():
            return register_frame(
                frame, self.settings, targets=self._targets, stop=self._stop,
                memory=self._memory, neighbours=neighbours, **self._arguments,
            )  # fmt: skip

    def reconstruct(self, registered: RegisteredFrame) -> FrameResult:
        """Do the second half of a frame that is registered."""
        with self._watched():
            return reconstruct_frame(registered, stop=self._stop, memory=self._memory)

    @property
    def lacks_motions(self) -> bool:
        """Whether the picture has been another one since a frame was registered."""
        return self._memory is not None and self._memory.lacks_motions

    @property
    def stands(self) -> bool:
        """Whether most of the picture is what it was one frame before."""
        return self._memory is not None and self._memory.stands(self._targets)

    def watch(self, frame: MultiViewFrame) -> None:
        """Look at a frame that is not computed: what stands still from it on is known sooner."""
        if self._memory is not None:
            self._memory.seen.watch(frame, self.settings)

    def begin_anew(self, frame: MultiViewFrame, effort: Effort) -> None:
        """Let motions be found anew of the frame just made, of which all views are there."""
        if self._memory is not None:
            with self._watched():
                begin_anew(
                    frame, self.settings, targets=self._targets, memory=self._memory, effort=effort
                )  # fmt: skip

    @property
    def finds_motions(self) -> bool:
        """Whether motions are being found so: :meth:`find_more` does a step of it."""
        return self._memory is not None and self._memory.finding is not None

    def find_more(self) -> None:
        """Find some of these motions; once all are, the next frame is made of them."""
        if self._memory is not None:
            with self._watched():
                go_on_anew(self._memory)

    def reset(self) -> None:
        """Forget the frames so far: the next one to be registered is computed on its own."""
        if self._memory is not None:
            self._memory.forget()

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Let a stop through; after an error the chain starts anew."""
        try:
            with stoppable(self._stop):
                yield
        except BaseException:
            self.reset()
            raise
