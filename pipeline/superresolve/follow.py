"""What moves followed, where each eye is made of itself alone: in time, and from eye to eye."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.config import Settings
from pipeline.frames import GreyImage
from pipeline.reconstruction.alone import Restored, made_better
from pipeline.reconstruction.followed import moved_here
from pipeline.reconstruction.psf import Psf
from pipeline.reconstruction.system import HrImage
from pipeline.temporal.flow import SIDE, Flow, flow_of
from pipeline.temporal.still import Still
from pipeline.threads import map_threads

MUCH_CHANGED = 0.5
"""Share of a target, with what is near, from whose change on nothing is followed: a cut has
nothing to follow, and it would take too long."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """What a frame has left of a target."""

    observed: GreyImage
    """(H, W), grey levels."""
    shown: HrImage
    """(K·H, K·W), made of it."""


def follow(
    made: Mapping[str, Restored],
    before: Mapping[str, Shown],
    still: Mapping[str, Still],
    settings: Settings,
    psf: Psf,
    noise: float,
    frame_index: int,
) -> None:
    """Make what has changed of targets better, in place.

    One of two eyes by what the frame before has shown of it, the other one by the first, in turn:
    so each of them takes from the other's past, too, and either costs one search.

    Parameters
    ----------
    made : mapping of target ids to Restored
        Each made of itself alone, left to right.
    before : mapping of target ids to Shown
        Of the frame before; targets that it has not are not followed.
    still : mapping of view ids to Still
    noise : float
        Standard deviation of a single frame, grey levels.
    """
    targets = [
        target
        for target in made
        if target in before
        and still[target].share_touched <= MUCH_CHANGED
        and min(still[target].mean.shape) >= SIDE
    ]
    leaders = leaders_of(targets, frame_index)

    def found(target: str) -> Flow:
        leader = leaders[target]
        there = before[target].observed if leader is None else still[leader].mean
        return flow_of(still[target].mean, there, still[target].touched)

    flows = dict(zip(targets, map_threads(found, targets), strict=True))

    def improve(target: str) -> None:
        leader = leaders[target]
        picture = before[target].shown if leader is None else made[leader].shown
        touched = still[target].touched
        predicted = moved_here(made[target].shown, picture, flows[target], touched, settings.grid)
        made_better(made[target], predicted, still[target], settings.grid, psf, noise)

    for leads in (True, False):
        map_threads(improve, [name for name in targets if (leaders[name] is None) is leads])


def leaders_of(targets: Sequence[str], frame_index: int) -> dict[str, str | None]:
    """Return the target that each one is made better by; None: its own past.

    >>> leaders_of(["left", "right"], 0), leaders_of(["left", "right"], 1)
    ({'left': None, 'right': 'left'}, {'left': 'right', 'right': None})
    """
    found: dict[str, str | None] = dict.fromkeys(targets)
    for pair in zip(targets[::2], targets[1::2], strict=False):
        leader, other = pair if frame_index % 2 == 0 else pair[::-1]
        found[other] = leader
    return found
