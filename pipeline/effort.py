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
    """Most views that are observed, the targets among them, ≥ 1; None: all."""

    register: bool = True
    """False: the motions of the previous frame are kept as they are. A frame without a
    previous one is registered all the same."""

    register_every: int = 1
    """Frames from one in which a view's motions are found anew to the next, other views having
    their turn in each, ≥ 1; between, they are kept."""

    alone: bool = False
    """True: what has changed is restored from its own view, what has not stays as it was, and no
    other view is looked at."""

    def __post_init__(self) -> None:
        for name in ("steps", "views", "register_every"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ConfigurationError(f"effort: {name} must be 1 or more, not {value}")

    @property
    def is_full(self) -> bool:
        """Whether nothing is left out."""
        return self == Effort()


FULL = Effort()
"""Nothing is left out."""


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
