"""What moves followed, where an eye is made of itself alone: in time, and from eye to eye.

Motion-compensated prediction, corrected by :mod:`pipeline.reconstruction.followed`. One of two eyes
is made better by what the frame before has shown of it, the other one by the first, in turn: so
each of them takes from the other's past, too, and either costs one search at most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pipeline.config import Settings
from pipeline.frames import GreyImage
from pipeline.reconstruction.alone import Restored, made_better
from pipeline.reconstruction.followed import Trust
from pipeline.reconstruction.psf import Psf
from pipeline.reconstruction.system import HrImage
from pipeline.temporal.flow import SIDE, Flow, flow_of
from pipeline.temporal.still import Still
from pipeline.threads import map_threads

MUCH_CHANGED = 0.5
"""Share of a target, with what is near, from whose change on nothing is followed: a cut has
nothing to follow, and it would take too long."""

ALONE = Trust()
"""Trust in another picture where each target is made of itself alone, …"""

TO_BE_SOLVED = Trust(tolerated=0.6)
"""… where what becomes of it is then solved, with other views, …"""

SOLVED = Trust(gain=0.2)
"""… and in a picture that was."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Shown:
    """What a frame has left of a target."""

    observed: GreyImage
    """(H, W), grey levels."""
    shown: HrImage
    """(K·H, K·W), made of it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Following:
    """What of the targets of a frame is followed, and where it was."""

    leaders: Mapping[str, str | None]
    """By target that is followed, the one that it is made better by; None: its own past."""
    before: Mapping[str, Shown]
    still: Mapping[str, Still]
    flows: dict[str, Flow]
    """By such a target, from it to there; what is not there is left to :meth:`find`."""
    settings: Settings
    psf: Psf
    noise: float
    """Standard deviation of a single frame, grey levels."""
    in_turn: bool
    """Whether those that lead are made of other views, too."""

    @property
    def sought(self) -> list[str]:
        """Targets whose motion is still to be found."""
        return [target for target in self.leaders if target not in self.flows]

    def find(self, target: str) -> None:
        """Find the motion of a target."""
        leader, now = self.leaders[target], self.still[target]
        there = self.before[target].observed if leader is None else self.still[leader].mean
        self.flows[target] = flow_of(now.mean, there, now.touched)

    def improve(self, made: Mapping[str, Restored], *, leads: bool) -> None:
        """Make what has changed better, in place: of the leaders, or of those that follow them.

        Parameters
        ----------
        made : mapping of target ids to Restored
            Each made of itself alone, the leaders perhaps of other views, too.
        """
        trust = ALONE
        if self.in_turn:
            trust = TO_BE_SOLVED if leads else SOLVED

        def improve(target: str) -> None:
            leader, still, grid = self.leaders[target], self.still[target], self.settings.grid
            picture = self.before[target].shown if leader is None else made[leader].shown
            flow = self.flows[target]
            made_better(made[target], picture, flow, still, grid, self.psf, self.noise, trust)

        map_threads(improve, [name for name in self.flows if (self.leaders[name] is None) is leads])


def followable(
    targets: Sequence[str], before: Mapping[str, Shown], still: Mapping[str, Still]
) -> list[str]:
    """Return the targets that may be followed, in their order.

    Parameters
    ----------
    before : mapping of target ids to Shown
        Of the frame before; targets that it has not are not followed.
    still : mapping of view ids to Still
    """
    return [
        target
        for target in targets
        if target in before
        and still[target].share_touched <= MUCH_CHANGED
        and min(still[target].mean.shape) >= SIDE
    ]


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
