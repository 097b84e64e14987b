"""What looking at the frames of a chain has told: their noise, what stands still, what drifts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pipeline.config import Settings
from pipeline.frames import MultiViewFrame, View
from pipeline.noise import estimate_noise
from pipeline.temporal.drift import (
    FIRST,
    KEPT,
    Detail,
    changed_at_once,
    detail_of,
    goes_on_changing,
    share_noise,
)
from pipeline.temporal.lagging import has_few_tiles, much_lags
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


@dataclass(kw_only=True, eq=False)
class Seen:
    """What looking at the frames of a chain has told of its views.

    Nothing in it is written over: a shallow copy is what was known at that time.
    """

    still: dict[str, Still] = field(default_factory=dict)
    """By view: what stands still, its mean, and what has just changed."""
    is_quieter: bool = False
    """Whether the noise last asked for has fallen so far that what came before it is of no use."""
    _noise: dict[str, float] = field(default_factory=dict)
    """By view, grey levels."""
    _last_noise: dict[str, float] = field(default_factory=dict)
    """That of the views of the last frame that were looked at."""
    _details: dict[str, tuple[Detail, ...]] = field(default_factory=dict)
    """By target, of the last frames looked at."""
    _detailed: int = -1
    """Index of the last of them."""
    _frames: int = 0
    """How many frames were looked at so."""

    def begun_again(self) -> Seen:
        """Return what is left of it to a new chain in a picture that goes on as it did."""
        return Seen(_details=self._details, _detailed=self._detailed, _frames=self._frames)

    def moved_on(self) -> None:
        """Forget what is of where the rig was: noise is still to be looked at in other views."""
        self.still, self._noise = {}, self._last_noise

    def noise(self, frame: MultiViewFrame, settings: Settings, view_ids: Sequence[str]) -> float:
        """Return the noise of the settings, or that of the frame's views, grey levels.

        Of a chain's frames after the first, one view is looked at, another one in each; all of
        them where that one has another noise than before.
        """
        if settings.noise_sigma is not None:
            return settings.noise_sigma
        known, before = self._noise, self.known_noise(view_ids)
        self._last_noise = {}
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

    def noise_anew(
        self, frame: MultiViewFrame, settings: Settings, view_ids: Sequence[str]
    ) -> float:
        """Return that of a picture that has nothing to do with the frames before."""
        self._noise = {}
        return self.noise(frame, settings, view_ids)

    def _look_at(self, frame: MultiViewFrame, view_ids: Sequence[str]) -> None:
        """Estimate the noise of some views."""
        lumas = [frame.view(name).luma for name in view_ids]
        found = dict(zip(view_ids, map_threads(estimate_noise, lumas), strict=True))
        self._noise, self._last_noise = self._noise | found, self._last_noise | found

    def known_noise(self, view_ids: Sequence[str]) -> float | None:
        """Return the noise that frames before have shown, grey levels; None: none has."""
        found = [self._noise[name] for name in view_ids if name in self._noise]
        return float(np.median(found)) if len(found) == len(view_ids) else None

    def drifts(
        self, frame: MultiViewFrame, targets: Sequence[str], noise: float, *, is_asked: bool = True
    ) -> bool:
        """Return whether a target goes on changing all over; to be called for each frame once.

        Frames that follow one another tell; of others, changes in unlike times would be compared.
        What is not asked is denied: then the frame is only remembered.
        """
        follows = frame.frame_index == self._detailed + 1
        before = self._details if follows else {}

        def look(target: str) -> tuple[tuple[Detail, ...], bool]:
            now = detail_of(frame.view(target).luma)
            details = (*before.get(target, ())[1 - KEPT :], now)
            return details, is_asked and goes_on_changing(details, noise)

        found = map_threads(look, targets)
        looked_at = zip(targets, found, strict=True)
        self._details = before | {target: details for target, (details, _) in looked_at}
        self._detailed = frame.frame_index
        self._frames += 1
        return any(goes_on for _, goes_on in found)

    def jumps(self, targets: Sequence[str], noise: float) -> bool:
        """Return whether most of a target is not what it was in the frames before.

        To be asked after :meth:`drifts`, and before the frame is averaged.
        """

        def has_jumped(target: str) -> bool:
            before = self.still.get(target)
            if before is None:
                return False
            # fewer pixels say as much of how many frames they are the mean of
            frames = 1 / float(np.mean(1 / before.count[::4, ::4]))
            return changed_at_once(self._details[target], before.mean, frames, noise)

        return any(map_threads(has_jumped, targets))

    def begins_apart(self, frame: MultiViewFrame, targets: Sequence[str], noise: float) -> bool:
        """Return whether the frame just asked of is to be computed as if all drifted.

        Of a chain's first frames, which are too few to tell, that is so where two share their
        noise, which hides what changes.
        """
        if self._frames > FIRST:
            return False

        def is_apart(target: str) -> bool:
            details = self._details[target]
            own = noise
            if not self._noise:
                # what is given need not be the noise of these frames
                own = min(noise, estimate_noise(frame.view(target).luma))
            return share_noise(details, own)

        return any(map_threads(is_apart, targets))

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
            if before is None:
                return first_seen(view.luma)
            return seen_again(view.luma, before, noise)

        found = map_threads(seen, frame.views)
        seen_now = {view.view_id: still for view, still in zip(frame.views, found, strict=True)}
        self.still = {**self.still, **seen_now}
        views = [
            replace(view, luma=still.mean) for view, still in zip(frame.views, found, strict=True)
        ]
        return replace(frame, views=tuple(views))

    def moved_on_to(self, frame: MultiViewFrame, part: float) -> MultiViewFrame:
        """Return a frame just averaged, its means moved a part of the way to its own pixels."""
        kept = np.float32(1 - part)

        def move(view: View) -> Still:
            still = self.still[view.view_id]
            mean = view.luma + kept * (still.mean - view.luma)
            return replace(still, mean=mean, count=1 + kept * (still.count - 1))

        found = map_threads(move, frame.views)
        self.still |= {view.view_id: still for view, still in zip(frame.views, found, strict=True)}
        views = [
            replace(view, luma=still.mean) for view, still in zip(frame.views, found, strict=True)
        ]
        return replace(frame, views=tuple(views))

    def lags(self, targets: Sequence[str]) -> bool:
        """Return whether much of what was kept of a target has just proved to lag behind.

        Of small pictures, whether much of any view has.
        """
        looked_at = [self.still[target] for target in targets]
        if has_few_tiles(looked_at[0].mean.shape):
            looked_at = list(self.still.values())
        return any(much_lags(still.lagging) for still in looked_at)

    def begins_to_lag(self, targets: Sequence[str]) -> bool:
        """Return whether what was kept of a target begins to lag behind."""
        return any(self.still[target].begins_to_lag for target in targets)

    def lags_all_over(self, targets: Sequence[str]) -> bool:
        """Return whether all of what was kept of a target has just proved to lag behind."""
        return any(self.still[target].lagging.all() for target in targets)
