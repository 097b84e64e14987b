"""The pixels of the frames before and after as further constraints.

Thesis, "Extension to Temporal SR": "It is also possible to directly map the LR pixels from the
adjacent time instances." A view of another instant is one more view: registered by the same
machinery, verified by the same rules, weighted by the same agreement, and trusted where it agrees
only. Nothing is assumed to stand still: the motion of a moving rig past a scene at rest is that of
a view at another place, and what moves by itself is found window by window, or left out.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from pipeline.errors import SceneError
from pipeline.frames import MultiViewFrame


def neighbour_name(view_id: str, distance: int) -> str:
    """Return what a view of another instant is called.

    >>> neighbour_name("left", -1)
    'left@-1'
    """
    return f"{view_id}@{distance:+d}"


def with_neighbours(
    frame: MultiViewFrame, neighbours: Sequence[MultiViewFrame], view_ids: Sequence[str]
) -> tuple[MultiViewFrame, tuple[str, ...]]:
    """Return the frame with views of its neighbours added, and the names of these.

    Parameters
    ----------
    neighbours : sequence of MultiViewFrame
        Other instants, of the same views.
    view_ids : sequence of str
        Views that are taken of each neighbour.

    Raises
    ------
    SceneError
        If a neighbour's pictures are of another size.
    """
    added = []
    for other in neighbours:
        if other.lr_shape != frame.lr_shape:
            raise SceneError("of another size than its neighbour", frame=other.frame_index)
        distance = other.frame_index - frame.frame_index
        for view_id in view_ids:
            # calibration tells where cameras stand to one another at one instant, not whether
            # the rig has moved meanwhile
            name = neighbour_name(view_id, distance)
            added.append(replace(other.view(view_id), view_id=name, calibration=None))
    views = (*frame.views, *added)
    return replace(frame, views=views), tuple(view.view_id for view in added)


def in_windows(
    frames: Iterable[MultiViewFrame], window: int
) -> Iterator[tuple[MultiViewFrame, tuple[MultiViewFrame, ...]]]:
    """Yield each frame with those up to ``window`` before and after it, as far as there are any.

    Holds 2 · window + 1 frames.
    """
    held: deque[MultiViewFrame] = deque()
    place = 0

    def around() -> tuple[MultiViewFrame, tuple[MultiViewFrame, ...]]:
        near = [
            other
            for index, other in enumerate(held)
            if index != place and abs(index - place) <= window
        ]
        return held[place], tuple(near)

    for frame in frames:
        held.append(frame)
        if len(held) - 1 - place < window:
            continue
        yield around()
        place += 1
        while place > window:
            held.popleft()
            place -= 1
    while place < len(held):
        yield around()
        place += 1
