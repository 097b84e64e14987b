"""How much work one frame may cost: what a real-time controller turns, and a report records."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from pipeline.errors import ConfigurationError


@dataclass(frozen=True, kw_only=True)
class Effort:
    """The work put into one frame; by default all that the settings ask for.

    Not in the thesis. Which eyes are made is not here: those are the targets.

    Examples
    --------
    >>> Effort().is_full, Effort(steps=2, views=4).is_full
    (True, False)
    """

    steps: int | None = None
    """Most conjugate-gradient steps of the fused solver from all views, or sweeps of the
    POCS solvers, ≥ 1; None: as many as they need."""

    views: int | None = None
    """Most views that a frame without a previous one, and of the others what has changed, is made
    of, the targets among them, ≥ 1; None: all. What stands still is made of all: where motions are
    kept, of one in a frame as it is now, in turn, and of the others as they were. With ``in_turn``
    and without ``by_depth`` what changes is made of that one, too."""

    register: bool = True
    """False: the motions of the last frame that was registered are kept as they are, and no depth
    is looked at. Where there are none, each view is made of itself alone."""

    by_depth: bool = False
    """True, with ``register`` false: what has changed since then lands by its depth map, which is
    looked at for that, and not by motions of what was there before. Where nothing can land so, the
    frame is registered in full, but after a cut: then each view is made of itself alone until there
    are motions again."""

    in_turn: bool = False
    """True, with ``register`` false: of two eyes one is made of other views where it changes, in
    turn, and follows its own past; the other one follows it. What has changed meanwhile of that one
    has its turn in the next frame."""

    register_every: int = 1
    """Frames from one in which a view's motions are found anew to the next, other views having
    their turn in each, ≥ 1; between, they are kept."""

    refresh_every: int | None = 4
    """Frames within which what stands still is reconstructed again, another part of it in each,
    ≥ 1; None, of ``alone`` only: it stays as it was."""

    alone: bool = False
    """True: likewise, and what has changed is made of its own view. Of the other views one is
    looked at in a frame, in turn, and none where nothing is refreshed."""

    others: bool = True
    """False, of ``alone`` only: no other view is looked at, and what stands still is refreshed of
    them as they were."""

    follow: bool = True
    """False, of ``alone`` only: what has changed is not looked for in the frame before, nor in the
    other eye."""

    def __post_init__(self) -> None:
        for name in ("steps", "views", "register_every", "refresh_every"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ConfigurationError(f"effort: {name} must be 1 or more, not {value}")
        if self.refresh_every is None and not self.alone:
            raise ConfigurationError("effort: refresh_every must be said where not alone")
        if not (self.others or self.alone):
            raise ConfigurationError("effort: others must be looked at where not alone")
        if self.by_depth and (self.register or self.alone):
            raise ConfigurationError("effort: by_depth is of motions that are kept")
        if self.in_turn and (self.register or self.alone):
            raise ConfigurationError("effort: in_turn is of motions that are kept")

    @property
    def registers(self) -> bool:
        """Whether the motions of views are found."""
        return self.register and not self.alone

    @property
    def needs_depth(self) -> bool:
        """Whether depth maps are looked at."""
        return self.registers or self.by_depth

    @property
    def looks_around(self) -> bool:
        """Whether views other than the targets are looked at, if not all of them in every frame."""
        return self.others and self.refresh_every is not None

    @property
    def is_full(self) -> bool:
        """Whether nothing is left out."""
        return self == Effort()


FULL = Effort()
"""Nothing is left out."""

SWIFT = Effort(register=False, by_depth=True, refresh_every=8)
"""What goes into a frame of ``--temporal swift``."""


def nearest_views(
    view_ids: Sequence[str], targets: Sequence[str], count: int | None
) -> tuple[str, ...]:
    """Return the targets and those views that stand nearest to them, so many in all, in order.

    Parameters
    ----------
    view_ids : sequence of str
        Left to right.
    targets : sequence of str
        Always kept, even where there are more of them than ``count``.
    count : int or None
        None: all views.

    Examples
    --------
    >>> nearest_views(["a", "b", "c", "d", "e"], ["c", "d"], 3)
    ('b', 'c', 'd')
    """
    places = [view_ids.index(target) for target in targets if target in view_ids]
    if count is None or not places:
        return tuple(view_ids)
    order = sorted(range(len(view_ids)), key=lambda place: min(abs(place - at) for at in places))
    kept = order[: max(count, len(places))]
    return tuple(view_ids[place] for place in sorted(kept))


def depth_looked_at(
    effort: Effort, view_ids: Sequence[str], targets: Sequence[str]
) -> tuple[str, ...]:
    """Return the views whose depth maps are looked at."""
    if not effort.needs_depth:
        return ()
    return nearest_views(view_ids, targets, effort.views if effort.by_depth else None)


def looked_at(
    effort: Effort, view_ids: Sequence[str], targets: Sequence[str], frame_index: int
) -> tuple[str, ...]:
    """Return the views that are looked at in a frame.

    >>> once = Effort(alone=True, refresh_every=8)
    >>> [looked_at(once, "abcde", "cd", frame_index) for frame_index in range(4)]
    [('a', 'c', 'd'), ('b', 'c', 'd'), ('c', 'd', 'e'), ('a', 'c', 'd')]
    """
    if effort.registers or not (effort.alone or effort.views):
        return tuple(view_ids)
    near = targets if effort.alone else nearest_views(view_ids, targets, effort.views)
    others = [name for name in view_ids if name not in near]
    turn = others[frame_index % len(others)] if others and effort.looks_around else None
    return tuple(name for name in view_ids if name in near or name == turn)
