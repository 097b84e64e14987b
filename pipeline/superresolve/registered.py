"""A frame whose views are registered: what the first half of the work hands to the second."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.effort import Effort
from pipeline.frames import MultiViewFrame
from pipeline.reconstruction.fused import Begun
from pipeline.reconstruction.psf import Psf
from pipeline.registration.register import ViewRegistration
from pipeline.temporal.initial import BlockMatch
from pipeline.temporal.still import Still


@dataclass(frozen=True, kw_only=True, eq=False)
class RegisteredFrame:
    """A frame whose views are registered: all that its reconstruction needs."""

    frame: MultiViewFrame
    """In a chain, its luma averaged over the frames in which it has stood still."""
    settings: Settings
    targets: tuple[str, ...]
    sources: tuple[str, ...]
    """Ids of the observed views."""
    near: tuple[str, ...]
    """Those of them that what has changed is made of."""
    still: Mapping[str, Still]
    """In a chain, by target: what has stood still, and for how long."""
    psf: Psf
    noise: float
    """Standard deviation, grey levels."""
    registrations: Mapping[str, Sequence[ViewRegistration]]
    """By target, every source view registered onto it."""
    matches: Mapping[str, BlockMatch]
    """By target: how the previous frame's result is moved to where this one starts; empty
    where the frame starts cold."""
    is_cut: bool
    """Whether the frame before this one shows something else."""
    has_moved: bool
    """Whether it shows the same from another place."""
    effort: Effort
    turn: int
    """Frames since the chain began."""
    begun: Mapping[str, Callable[[], Begun]]
    """By target, what gives, once, what its reconstruction begins with: where that was begun
    beside registration."""
    layers: Mapping[str, npt.NDArray[np.int32]] | None
    """Depth layers by view id, where pictures of them are wanted."""
    timings: Mapping[str, float]
    """Seconds by stage."""
