"""What a running job tells whoever listens: one frozen record per event."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, kw_only=True)
class Event:
    """Something happened in a job."""


@dataclass(frozen=True, kw_only=True)
class JobStarted(Event):
    """The scene is open, the outputs can be written, the work begins."""

    frames_total: int
    frames_done: int
    """Frames in segments that an earlier run finished."""
    num_views: int
    """Views observed."""
    targets: tuple[str, ...]
    """Ids of the views that are super-resolved."""
    lr_shape: tuple[int, int]
    """(height, width)."""
    hr_shape: tuple[int, int]
    """(height, width) of one eye."""


@dataclass(frozen=True, kw_only=True)
class Compiling(Event):
    """The first frame takes longer: nothing is compiled yet."""


@dataclass(frozen=True, kw_only=True)
class FrameFinished(Event):
    """A frame is super-resolved (and on its way to the encoder)."""

    frame_index: int
    """Source frame number."""
    done: int
    """Frames finished, earlier runs included."""
    total: int


@dataclass(frozen=True, kw_only=True)
class SegmentFinished(Event):
    """A segment is on the disk and will not be computed again."""

    index: int
    """0-based."""
    count: int
    """Segments of the job."""


@dataclass(frozen=True, kw_only=True)
class Joining(Event):
    """All segments are there and are put together."""

    segments: int


@dataclass(frozen=True, kw_only=True)
class Warned(Event):
    """Something the user should know; the job goes on."""

    text: str


@dataclass(frozen=True, kw_only=True)
class JobFinished(Event):
    """Everything is written."""

    seconds: float
    timings: Mapping[str, float] = field(default_factory=dict)
    """Seconds of each stage, added up over the frames."""
