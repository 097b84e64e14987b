"""What of a chain holds for its next frame: cuts, fades, moving cameras, slow changes told apart.

Not in the thesis. What tells them lies in :mod:`pipeline.temporal`; here it is asked in order, and
the memory forgets what no longer holds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.config import Settings
from pipeline.frames import MultiViewFrame
from pipeline.superresolve.memory import Memory
from pipeline.temporal.alike import DOUBTED, MOST, NOISY, NOTHING_ASKED
from pipeline.temporal.initial import BlockMatch
from pipeline.temporal.lagging import has_few_tiles
from pipeline.temporal.still import Still, first_seen

IN_PLACE = 0.5
"""Share of a target that changes without moving from which the frame starts cold: it fades, or one
picture dissolves into another, and what a chain keeps of it would be of the older picture."""

IN_PLACE_OF_MOST = (2 / 3, 1 / 4)
"""Share that has changed, with what is near, and share that has without moving, from which
the same holds: light flickers. Little is left to go on from."""

IN_PLACE_OF_FEW = 1 / 16
"""The same of a picture of few tiles, of which a part that dissolves is much."""

FEWEST_TILES = 15
"""Of a picture of fewer tiles nothing is kept that another place is seen from: so few blocks match
there after a nudge, or where light flickers, that either is taken for that."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Continued:
    """A frame, and what it goes on from; without a chain, from nothing."""

    frame: MultiViewFrame
    """Its luma averaged over the frames in which it has stood still."""
    noise: float
    """Standard deviation, grey levels."""
    matches: Mapping[str, BlockMatch]
    """By target: how the previous frame's result is moved; empty where the frame starts cold."""
    still: Mapping[str, Still]
    """By target: what has stood still, and for how long; empty without a chain."""
    is_cut: bool
    """Whether the frame before shows something else, or is of no use."""
    has_moved: bool
    """Whether the camera has moved, or all is to start as if it had."""


def continued(
    memory: Memory | None,
    frame: MultiViewFrame,
    settings: Settings,
    targets: Sequence[str],
    sources: Sequence[str],
    noise: float,
) -> Continued:
    """Return a frame with what it goes on from; what no longer holds leaves the memory.

    Parameters
    ----------
    memory : Memory or None
        Of the chain; None: the frame stands alone.
    sources : sequence of view ids
        Those observed, of which the noise is asked.
    noise : float
        That of the frame by :meth:`Seen.noise`, grey levels.
    """
    if memory is None:
        return Continued(
            frame=frame, noise=noise, matches={}, still={}, is_cut=False, has_moved=False
        )
    matches = memory.matches(frame, targets, noise)
    is_other = any(match.is_cut for match in matches.values())
    is_quieter = bool(matches) and memory.seen.is_quieter
    has_moved = (
        is_other
        and not is_quieter
        and not has_few_tiles(frame.lr_shape, FEWEST_TILES)
        and memory.has_moved(frame, targets)
    )
    is_cut = is_quieter or (is_other and not has_moved)
    if is_cut:
        memory.forget()
        matches, noise = {}, memory.seen.noise(frame, settings, sources)
    is_small = has_few_tiles(frame.lr_shape)
    drifts = memory.seen.drifts(frame, targets, noise, is_asked=is_small or not has_moved)
    begins_apart = not (has_moved or drifts) and memory.seen.begins_apart(frame, targets, noise)
    drifts = drifts or begins_apart or (not has_moved and memory.seen.jumps(targets, noise))
    if drifts:
        has_moved = bool(matches) and not is_small
    if has_moved:
        memory.move()
        matches, noise = {}, memory.seen.noise(frame, settings, sources)
    averaged = memory.seen.averaged(frame, noise)
    alike = memory.found_alike(frame, targets) if matches else NOTHING_ASKED
    if matches and not alike.is_behind:
        is_left = memory.doubts > 0 and (alike.is_far or noise < NOISY)
        part = 1.0 if is_left else alike.way_on
        if part > 0:
            averaged = memory.seen.moved_on_to(frame, part)
    if (
        matches
        and is_small
        and (
            drifts
            or alike.is_behind
            or memory.seen.lags(targets)
            or _changes_in_place(memory, matches, IN_PLACE_OF_FEW)
        )
    ):
        is_cut = True
        memory.begin_apart()
        matches, noise = {}, memory.seen.noise(frame, settings, sources)
        averaged = frame
    elif alike.share_behind > MOST or (matches and memory.seen.lags_all_over(targets)):
        has_moved = True
        memory.move()
        matches, noise = {}, memory.seen.noise(frame, settings, sources)
        averaged = memory.seen.averaged(frame, noise)
    if matches and (
        alike.is_behind
        or _changes_in_place(memory, matches, IN_PLACE)
        or _changes_mostly(memory, matches)
    ):
        is_cut = True
        memory.begin_again()
        matches, noise = {}, memory.seen.noise(frame, settings, sources)
        averaged = memory.seen.averaged(frame, noise)
    elif matches and memory.seen.lags(targets):
        # few steps from the frame before lose more than means of what stands still gain
        matches, noise = {}, memory.seen.noise_anew(frame, settings, sources)
        memory.stand_again()
        memory.lag()
    elif matches and (memory.doubts > 0 or (is_small and alike.is_far)):
        matches, noise = {}, memory.seen.noise_anew(frame, settings, sources)
    began = alike.is_behind or (has_moved and not begins_apart)
    memory.doubts = DOUBTED if began else max(memory.doubts - 1, 0)
    if averaged is frame:
        still = {target: first_seen(frame.view(target).luma) for target in targets}
    else:
        still = {target: memory.seen.still[target] for target in targets}
    return Continued(
        frame=averaged,
        noise=noise,
        matches=matches,
        still=still,
        is_cut=is_cut,
        has_moved=has_moved,
    )


def _changes_mostly(memory: Memory, matches: Mapping[str, BlockMatch]) -> bool:
    """Return whether most of every target has changed, and much of it where it was."""
    changed, in_place = IN_PLACE_OF_MOST
    still = memory.seen.still
    return _changes_in_place(memory, matches, in_place) and all(
        still[target].share_touched > changed for target in matches
    )


def _changes_in_place(memory: Memory, matches: Mapping[str, BlockMatch], share: float) -> bool:
    """Return whether more than a share of every target has changed where it was."""
    return all(
        match.share_in_place(memory.seen.still[target].changed) > share
        for target, match in matches.items()
    )
