"""A worker owns one chain: the state of one stream. It takes a frame and gives a result.

Files, jobs and live streams all go through it. What it gives depends on nothing but
the settings and the frames it was given since it was made or reset.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from pipeline.config import Settings
from pipeline.effort import FULL, Effort
from pipeline.frames import MultiViewFrame
from pipeline.report import distinct, sum_timings
from pipeline.results import FrameResult
from pipeline.superresolve import (
    Memory,
    RegisteredFrame,
    reconstruct_frame,
    register_frame,
    superresolve,
)
from pipeline.threads import map_threads, stoppable


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
        self._memories = [Memory()] if settings.temporal != "cold" else []

    def take(
        self,
        frame: MultiViewFrame,
        *,
        targets: tuple[str, ...] | None = None,
        effort: Effort = FULL,
        neighbours: Sequence[MultiViewFrame] = (),
    ) -> FrameResult:
        """Return the result of the next frame; after an error the chain starts anew.

        Parameters
        ----------
        targets : tuple of view ids, optional
            Those of the worker's that are made now; each goes on from the last frame that it
            was made of.
        effort : Effort
            What may be left out.
        neighbours : sequence of MultiViewFrame
            Frames before and after this one, whose pixels are further constraints.
        """
        groups, idle = self._groups(targets or self._targets)

        def compute(group: tuple[tuple[str, ...], Memory | None]) -> FrameResult:
            return superresolve(
                frame, self.settings, targets=group[0], memory=group[1], effort=effort,
                stop=self._stop, neighbours=neighbours, **self._arguments,
            )  # fmt: skip

        try:
            with stoppable(self._stop):
                results = map_threads(compute, groups)
        except BaseException:
            self.reset()
            raise
        self._memories = _joined([*(memory for _, memory in groups if memory is not None), *idle])
        return _merged(results)

    def _groups(
        self, targets: tuple[str, ...]
    ) -> tuple[list[tuple[tuple[str, ...], Memory | None]], list[Memory]]:
        """Return the targets by the memory that they share, and the memories not asked for."""
        if not self._memories:
            return [(targets, None)], []
        groups: list[tuple[tuple[str, ...], Memory | None]] = []
        idle = []
        fresh = Memory()
        for memory in self._memories:
            if not memory.targets:
                fresh = memory
                continue
            asked = tuple(target for target in targets if target in memory.targets)
            if len(asked) < len(memory.targets):
                memory, rest = memory.split(asked)
                idle.append(rest)
            if asked:
                groups.append((asked, memory))
        known = {target for asked, _ in groups for target in asked}
        new = tuple(target for target in targets if target not in known)
        if new:
            groups.append((new, fresh))
        return groups, idle

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

    def watch(self, frame: MultiViewFrame) -> None:
        """Look at a frame that is not computed: what stands still from it on is known sooner."""
        for memory in self._memories:
            memory.watch(frame, self.settings)

    def reset(self) -> None:
        """Forget the frames so far: the next one to be registered is computed on its own."""
        for memory in self._memories:
            memory.forget()

    @property
    def _memory(self) -> Memory | None:
        """The memory of all targets."""
        return self._memories[0] if self._memories else None


def _joined(memories: Sequence[Memory]) -> list[Memory]:
    """Return the memories, those that stand at the same frame made one."""
    found: list[Memory] = []
    for memory in memories:
        both = [one.joined(memory) for one in found]
        for place, joined in enumerate(both):
            if joined is not None:
                found[place] = joined
                break
        else:
            found.append(memory)
    return found


def _merged(results: Sequence[FrameResult]) -> FrameResult:
    """Return one result of a frame whose targets were made apart."""
    first, *others = results
    if not others:
        return first
    reports = [result.report for result in results]
    report = replace(
        first.report,
        targets=tuple(target for report in reports for target in report.targets),
        timings=sum_timings(report.timings for report in reports),
        warnings=tuple(distinct(text for report in reports for text in report.warnings)),
    )
    return FrameResult(
        frame_index=first.frame_index,
        images={view_id: image for result in results for view_id, image in result.images.items()},
        report=report,
        debug={view_id: debug for result in results for view_id, debug in result.debug.items()},
    )
