"""Motions found anew where a cut has left those of another picture: a few in each frame.

All of them are of one frame, which is kept until they are found. Frames between are made without.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from pipeline.config import Settings
from pipeline.effort import Effort, looked_at
from pipeline.frames import MultiViewFrame
from pipeline.registration.register import Previous, prepare_views, register_in_steps
from pipeline.superresolve.choices import terms_of
from pipeline.superresolve.memory import Memory
from pipeline.threads import set_threads

AT_ONCE = 2
"""Views that are registered onto a target in one step: with two threads no more takes longer."""


def begin_anew(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: Sequence[str],
    memory: Memory,
    effort: Effort,
) -> None:
    """Let motions be found of a frame that has just been made, all of whose views are there.

    Parameters
    ----------
    effort : Effort
        With which it was made: the views that were not looked at then are now.
    """
    set_threads(settings.threads)
    names = [view.view_id for view in frame.views]
    noise = memory.seen.noise_anew(frame, settings, names)
    known = looked_at(effort, names, targets, frame.frame_index)
    rest = tuple(view for view in frame.views if view.view_id not in known)
    memory.seen.averaged(replace(frame, views=rest), noise)
    memory.begin_to_find(_found(frame, settings, targets, noise))


def go_on_anew(memory: Memory) -> None:
    """Do a step of that; after the last one the motions are those of the picture that stands."""
    assert memory.finding is not None  # it was begun
    found = next(memory.finding)
    if found is not None:
        memory.has_found(found)


def _found(
    frame: MultiViewFrame, settings: Settings, targets: Sequence[str], noise: float
) -> Iterator[Previous | None]:
    """Yield None after each step, the motions at last."""
    prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
    yield None
    names = [view.view_id for view in frame.views]
    terms = terms_of(settings, noise)
    for found in register_in_steps(prepared, targets, names, terms, AT_ONCE):
        if found is None:
            yield None
        else:
            yield Previous(prepared=prepared, registrations=found, turn=0)
