"""What one frame of a chain leaves to the next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.frames import GreyImage, MultiViewFrame, RegisteredView, View
from pipeline.noise import estimate_noise
from pipeline.reconstruction.alone import Restored
from pipeline.reconstruction.fused import FusedResult
from pipeline.registration.register import Previous
from pipeline.superresolve.registered import RegisteredFrame
from pipeline.temporal.drift import KEPT, detail_of, goes_on_changing
from pipeline.temporal.initial import BlockMatch, match_blocks
from pipeline.temporal.moving import has_moved
from pipeline.temporal.still import Still, first_seen, seen_again
from pipeline.threads import map_threads

NOISE_JUMP = 0.25
"""Share of a view's noise by which it may differ from one look at it to the next without the other
views being looked at, too."""

LEAST_NOISE = 1.0
"""Noise of which that is a share, at least, grey levels."""

QUIETER = 0.7
"""Share of the noise before below which means and results of frames before are worse than a frame
of its own."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Solved:
    """What a frame's reconstruction leaves to the next frame's."""

    result: FusedResult
    shown: GreyImage
    """(K·H, K·W) float32: what has become of it."""
    views: tuple[str, ...]
    """Of which views it was made."""
    frames: npt.NDArray[np.float32] | None
    """(H, W): of how many frames the pixels observed were the mean when it was made of them;
    None where there is no chain."""
    restored: Restored | None = None
    """Where frames since then were made of the target alone: what they left."""


class Memory:
    """What one frame of a chain leaves to the next; one owner, one stream.

    Registration and reconstruction each have their part of it, so that the one may be a frame
    ahead of the other.
    """

    def __init__(self) -> None:
        self.forget()
        self._solved: dict[str, Solved] = {}
        self._solved_turn = 0

    def forget(self) -> None:
        """Start a new chain: the next frame is computed on its own."""
        self.previous: Previous | None = None
        self.turn = 0
        self._found_in = self._last = -1
        self._observed: dict[str, GreyImage] = {}
        self._details: dict[str, tuple[GreyImage, ...]] = {}
        self.still: dict[str, Still] = {}
        self._noise: dict[str, float] = {}
        self.is_quieter = False
        """Whether the noise last asked for has fallen so far that what came before it is of no
        use."""

    def begin_again(self) -> None:
        """Start a new chain in a picture that goes on as it did."""
        details = self._details
        self.forget()
        self._details = details

    def noise(self, frame: MultiViewFrame, settings: Settings, view_ids: Sequence[str]) -> float:
        """Return the noise of the settings, or that of the frame's views, grey levels.

        Of a chain's frames after the first, one view is looked at, another one in each; all of
        them where that one has another noise than before.
        """
        if settings.noise_sigma is not None:
            return settings.noise_sigma
        known, before = self._noise, self.known_noise(view_ids)
        due = [name for name in view_ids if name not in known]
        if not due:
            one = view_ids[frame.frame_index % len(view_ids)]
            self._look_at(frame, [one])
            if abs(self._noise[one] - known[one]) > NOISE_JUMP * max(known[one], LEAST_NOISE):
                due = [name for name in view_ids if name != one]
        self._look_at(frame, due)
        noise = float(np.median([self._noise[name] for name in view_ids]))
        self.is_quieter = before is not None and before > LEAST_NOISE and noise < QUIETER * before
        return noise

    def _look_at(self, frame: MultiViewFrame, view_ids: Sequence[str]) -> None:
        """Estimate the noise of some views."""
        found = map_threads(estimate_noise, [frame.view(name).luma for name in view_ids])
        self._noise = {**self._noise, **dict(zip(view_ids, found, strict=True))}

    def known_noise(self, view_ids: Sequence[str]) -> float | None:
        """Return the noise that frames before have shown, grey levels; None: none has."""
        found = [self._noise[name] for name in view_ids if name in self._noise]
        return float(np.median(found)) if len(found) == len(view_ids) else None

    def has_moved(self, frame: MultiViewFrame, targets: Sequence[str]) -> bool:
        """Return whether a frame shows the targets as the one before, from another place."""
        return all(has_moved(frame.view(target).luma, self._observed[target]) for target in targets)

    def drifts(self, frame: MultiViewFrame, targets: Sequence[str], noise: float) -> bool:
        """Return whether a target goes on changing all over; to be asked of each frame once."""
        self._details |= {
            target: (*self._details.get(target, ())[1 - KEPT :], detail_of(frame.view(target).luma))
            for target in targets
        }
        return any(goes_on_changing(self._details[target], noise) for target in targets)

    def move(self) -> None:
        """Keep of the frames so far only what holds wherever the rig is."""
        self.move_on()
        self.still = {}

    def move_on(self) -> None:
        """Keep of the registration so far only what holds wherever the rig is."""
        if self.previous is not None:
            self.previous = replace(self.previous, has_moved=True)

    def known_views(self) -> dict[str, list[RegisteredView]]:
        """Return the views registered onto each target, as they were when last looked at.

        Nothing where they are so from another place, or no frame was reconstructed of them.
        """
        previous = self.previous
        if previous is None or previous.has_moved or not self._solved:
            return {}
        return {
            target: [
                replace(view, observed=self.still[view.view_id].mean - one.offset)
                for one in registrations
                for view in [one.registered]
                if view.view_id in self.still
            ]
            for target, registrations in previous.registrations.items()
        }

    def watch(self, frame: MultiViewFrame, settings: Settings) -> None:
        """Take note of a frame that is not computed."""
        names = [view.view_id for view in frame.views]
        noise = self.noise(frame, settings, names)
        if self.is_quieter:
            self.still = {}
        self.averaged(frame, noise)

    def averaged(self, frame: MultiViewFrame, noise: float) -> MultiViewFrame:
        """Return the frame with what stands still averaged over the frames before."""

        def seen(view: View) -> Still:
            before = self.still.get(view.view_id)
            return first_seen(view.luma) if before is None else seen_again(view.luma, before, noise)

        found = map_threads(seen, frame.views)
        seen_now = {view.view_id: still for view, still in zip(frame.views, found, strict=True)}
        self.still = {**self.still, **seen_now}
        views = [
            replace(view, luma=still.mean) for view, still in zip(frame.views, found, strict=True)
        ]
        return replace(frame, views=tuple(views))

    def matches(
        self, frame: MultiViewFrame, targets: Sequence[str], noise: float
    ) -> dict[str, BlockMatch]:
        """Return how the targets have moved since the previous frame; empty where there is none."""
        if self.previous is None:
            return {}
        return {
            target: match_blocks(frame.view(target).luma, self._observed[target], noise)
            for target in targets
        }

    def keep(self, found: Previous, observed: dict[str, GreyImage], frame_index: int) -> None:
        """Remember a frame that is registered."""
        self.turn += 1
        if self.previous is None or found.prepared is not self.previous.prepared:
            self._found_in = frame_index
        self._last = frame_index
        self.previous = replace(found, turn=self.turn)
        self._observed = observed

    def split(self, targets: Sequence[str]) -> tuple[Memory, Memory]:
        """Return the memories of these targets and of the others, which then go their own ways."""
        others = [target for target in self._observed if target not in targets]
        return self._of(targets), self._of(others)

    def joined(self, other: Memory) -> Memory | None:
        """Return the memory of both one's targets; None unless they stand at the same frame."""
        one, two = self.previous, other.previous
        here, there = ((memory._found_in, memory._last) for memory in (self, other))
        if one is None or two is None or here != there:
            return None
        both = Memory()
        both.turn = both._solved_turn = max(self.turn, other.turn)
        both._found_in, both._last = here
        both.previous = Previous(
            prepared={**two.prepared, **one.prepared},
            registrations={**one.registrations, **two.registrations},
            turn=both.turn,
        )
        both._observed = {**self._observed, **other._observed}
        both._details = {**other._details, **self._details}
        both.still = {**other.still, **self.still}
        both._noise = {**other._noise, **self._noise}
        both._solved = {**self._solved, **other._solved}
        return both

    @property
    def targets(self) -> frozenset[str]:
        """The targets of the last frame; empty where there is none."""
        return frozenset(self._observed)

    def _of(self, targets: Sequence[str]) -> Memory:
        part = Memory()
        part.turn, part._solved_turn = self.turn, self._solved_turn
        part._found_in, part._last = self._found_in, self._last
        assert self.previous is not None  # there are targets
        part.previous = replace(
            self.previous,
            registrations={target: self.previous.registrations[target] for target in targets},
        )
        part._observed = {target: self._observed[target] for target in targets}
        part._details = {target: self._details[target] for target in targets}
        part.still, part._noise = self.still, self._noise
        part._solved = {
            target: image for target, image in self._solved.items() if target in targets
        }
        return part

    def solved(self, registered: RegisteredFrame, target: str) -> Solved | None:
        """Return the previous frame's result of a target; None where the chain has none."""
        if target not in registered.matches or self._solved_turn != registered.turn - 1:
            return None
        return self._solved[target]

    def is_of_size(self, frame: MultiViewFrame) -> bool:
        """Return whether the targets of the frame before, if any, have the size of this one's."""
        shapes = {luma.shape for luma in self._observed.values()}
        return not shapes or shapes == {frame.lr_shape}

    def restored(self, target: str) -> Restored | None:
        """Return what a target's last frame leaves to one that is made of the target alone."""
        solved = self._solved.get(target)
        if self.previous is None or solved is None or solved.frames is None:
            return None
        return solved.restored or Restored(
            estimate=solved.result.estimate, shown=solved.shown,
            frames=np.full_like(solved.frames, np.inf),
        )  # fmt: skip

    def keep_restored(self, frame: MultiViewFrame, made: Mapping[str, Restored]) -> None:
        """Remember a frame whose targets were made of themselves alone; of a chain only."""
        if self.previous is None:
            return
        self._last = frame.frame_index
        for target, left in made.items():
            self._observed[target] = frame.view(target).luma
            old = self._solved[target]
            frames = old.frames
            if frames is not None:
                frames = np.where(np.isinf(left.frames), frames, np.float32(0))
                if left.again is not None:
                    np.copyto(frames, self.still[target].count, where=left.again)
            self._solved[target] = replace(
                old,
                result=replace(old.result, estimate=left.estimate),
                shown=left.shown,
                frames=frames,
                restored=left,
            )

    def keep_solved(self, registered: RegisteredFrame, solved: dict[str, Solved]) -> None:
        """Remember a frame that is reconstructed."""
        self._solved_turn, self._solved = registered.turn, solved
