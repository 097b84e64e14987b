"""Whole frames from parts that come late, twice, in disorder or not at all.

A machine without I/O and without a clock: parts and times go in, frames come
out. A *part* is one view's picture or depth map of one instant. Frames leave in
the order of their index. What becomes of every part is counted, so that

    received = used + duplicate + late + unknown + too large + lost with a frame + waiting

Times are seconds of a monotonic clock of ours; capture times are the source's
clock and are compared among themselves only.
"""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import asdict, dataclass, field
from typing import Any

from service.bus.keys import Part
from service.streams.options import Rule

PartKey = tuple[str, Part]
"""View id, and which of its two parts."""


@dataclass(frozen=True, kw_only=True)
class Expected:
    """What belongs to a frame, and how long to wait for it."""

    color: frozenset[str]
    """Ids of all views."""
    depth: frozenset[str]
    """Ids of the views that send depth."""
    needed: frozenset[str]
    """Ids of the views without whose colour there is no frame: the stereo pair."""
    interval: float
    """Time between frames, seconds."""
    wait: float = 0.2
    """How long a frame may be incomplete after its first part, seconds."""
    window: int = 8
    """Frames that may be incomplete at the same time."""
    max_bytes: int = 256 << 20
    """Of all parts that wait, bytes."""
    max_skew: float = 0.0
    """Capture times of a frame may differ by this, seconds; 0: half the interval."""
    missing_view: Rule = Rule.DROP
    """What to do with a frame that lacks a view that is not of the pair."""
    missing_depth: Rule = Rule.USE
    """What to do with a frame that lacks a depth map."""
    skewed: Rule = Rule.USE
    """What to do with a frame whose capture times differ by more than allowed."""

    @property
    def parts(self) -> frozenset[PartKey]:
        """Everything that a complete frame has."""
        color = {(view, Part.COLOR) for view in self.color}
        return frozenset(color | {(view, Part.DEPTH) for view in self.depth})

    @property
    def skew_allowed(self) -> float:
        """Seconds."""
        return self.max_skew or self.interval / 2

    def is_usable(self, missing: Set[PartKey]) -> bool:
        """Tell whether a frame without these parts is worth computing."""
        views = {view for view, part in missing if part is Part.COLOR}
        depth = {view for view, part in missing if part is Part.DEPTH and view not in views}
        if views & self.needed or (views and self.missing_view is Rule.DROP):
            return False
        return not (depth and self.missing_depth is Rule.DROP)


@dataclass(frozen=True, kw_only=True, eq=False)
class ArrivedPart:
    """One message of a source."""

    view: str
    part: Part
    frame_index: int
    """Of the source, ≥ 0."""
    capture_time_ns: int
    """Of the source's clock, since the epoch."""
    arrived: float
    """Seconds."""
    size: int
    """Bytes."""
    content: Any = None
    """The picture; never looked at here."""


@dataclass(frozen=True, kw_only=True, eq=False)
class AssembledFrame:
    """All that came of one instant."""

    frame_index: int
    """Of the source."""
    position: int
    """Grows by one from frame to frame of the source, and never falls, whatever its index does."""
    parts: Mapping[PartKey, ArrivedPart]
    missing: frozenset[PartKey]
    first_arrived: float
    """Seconds."""
    last_arrived: float
    """Seconds: of the part that completed it."""
    capture_time_ns: int
    """The earliest of its views."""


@dataclass(kw_only=True)
class AssemblyCounts:
    """What became of parts and frames."""

    parts_received: int = 0
    parts_used: int = 0
    parts_duplicate: int = 0
    """Of a frame that already has this part."""
    parts_late: int = 0
    """Of a frame that has left, or of one before it."""
    parts_unknown: int = 0
    """Of a view, or a depth map, that the manifest does not know."""
    parts_too_large: int = 0
    parts_lost: int = 0
    """Of frames that were given up."""
    frames_complete: int = 0
    frames_without_view: int = 0
    """Used although a view is missing."""
    frames_without_depth: int = 0
    """Used although a depth map is missing."""
    frames_incomplete: int = 0
    """Given up: something is missing."""
    frames_crowded_out: int = 0
    """Given up before their time, because too many were incomplete."""
    frames_skewed: int = 0
    """Capture times differ by more than allowed."""
    frames_missing: int = 0
    """Numbers of the source of which nothing usable came."""
    restarts: int = 0
    """The source began to count anew."""

    def plain(self) -> dict[str, int]:
        """Return the counts by name."""
        return asdict(self)


@dataclass(kw_only=True)
class _Waiting:
    frame_index: int
    first_arrived: float
    parts: dict[PartKey, ArrivedPart] = field(default_factory=dict)

    @property
    def size(self) -> int:
        return sum(part.size for part in self.parts.values())


class Assembler:
    """Takes parts, gives frames; see the module.

    Examples
    --------
    >>> expected = Expected(color=frozenset({"a", "b"}), depth=frozenset(),
    ...                     needed=frozenset({"a", "b"}), interval=0.1)
    >>> machine = Assembler(expected)
    >>> def part(view, index, at):
    ...     return ArrivedPart(view=view, part=Part.COLOR, frame_index=index,
    ...                        capture_time_ns=index, arrived=at, size=1)
    >>> machine.take(part("a", 7, 0.0))
    []
    >>> [frame.frame_index for frame in machine.take(part("b", 7, 0.01))]
    [7]
    """

    def __init__(self, expected: Expected) -> None:
        self.expected = expected
        self.counts = AssemblyCounts()
        self._wanted = expected.parts
        self._waiting: dict[int, _Waiting] = {}
        self._last_index: int | None = None
        self._last_capture = 0
        self._position = -1

    @property
    def waiting_bytes(self) -> int:
        """Of all parts that wait."""
        return sum(frame.size for frame in self._waiting.values())

    @property
    def waiting_parts(self) -> int:
        """How many parts wait."""
        return sum(len(frame.parts) for frame in self._waiting.values())

    @property
    def deadline(self) -> float | None:
        """When :meth:`tick` would give up a frame; None while none waits."""
        head = min(self._waiting, default=None)
        times = [
            frame.first_arrived
            for frame in self._waiting.values()
            if frame.frame_index == head or not self._is_usable(frame)
        ]
        return min(times) + self.expected.wait if times else None

    def take(self, part: ArrivedPart) -> list[AssembledFrame]:
        """Take a part; return the frames that may leave now, in order."""
        self.counts.parts_received += 1
        self._keep(part)
        return self._leaving(part.arrived)

    def tick(self, now: float) -> list[AssembledFrame]:
        """Let time pass; return the frames that may leave now, in order."""
        return self._leaving(now)

    def _keep(self, part: ArrivedPart) -> None:
        """Let a part wait with its frame, or count why it does not."""
        counts = self.counts
        key = (part.view, part.part)
        if key not in self._wanted:
            counts.parts_unknown += 1
            return
        if part.size > self.expected.max_bytes:
            counts.parts_too_large += 1
            return
        if self._counts_anew(part):
            self._begin_anew()
        if self._last_index is not None and part.frame_index <= self._last_index:
            counts.parts_late += 1
            return
        frame = self._waiting.setdefault(
            part.frame_index, _Waiting(frame_index=part.frame_index, first_arrived=part.arrived)
        )
        if key in frame.parts:
            counts.parts_duplicate += 1
            return
        frame.parts[key] = part

    def _leaving(self, now: float) -> list[AssembledFrame]:
        """Return the frames that leave; those in front first, and nothing overtakes."""
        left: list[AssembledFrame] = []
        while self._waiting:
            frame = self._waiting[min(self._waiting)]
            is_whole = self._wanted <= set(frame.parts)
            is_late = self._is_late(frame, now)
            if not (is_whole or is_late or self._is_crowded):
                break
            self.counts.frames_crowded_out += not (is_whole or is_late)
            del self._waiting[frame.frame_index]
            made = self._made(frame)
            if made is not None:
                left.append(made)
        for frame in list(self._waiting.values()):
            if self._is_late(frame, now) and not self._is_usable(frame):
                del self._waiting[frame.frame_index]
                self._made(frame)
        return left

    def _is_late(self, frame: _Waiting, now: float) -> bool:
        return now >= frame.first_arrived + self.expected.wait

    def _is_usable(self, frame: _Waiting) -> bool:
        return self.expected.is_usable(self._wanted - set(frame.parts))

    @property
    def _is_crowded(self) -> bool:
        too_many = len(self._waiting) > self.expected.window
        return too_many or self.waiting_bytes > self.expected.max_bytes

    def _made(self, frame: _Waiting) -> AssembledFrame | None:
        """Return the frame, or count why it is none."""
        counts, expected = self.counts, self.expected
        missing = frozenset(self._wanted - set(frame.parts))
        times = [item.capture_time_ns for item in frame.parts.values()]
        is_skewed = (max(times) - min(times)) / 1e9 > expected.skew_allowed
        counts.frames_skewed += is_skewed
        if not expected.is_usable(missing) or (is_skewed and expected.skewed is Rule.DROP):
            counts.frames_incomplete += not expected.is_usable(missing)
            counts.parts_lost += len(frame.parts)
            return None
        counts.parts_used += len(frame.parts)
        if not missing:
            counts.frames_complete += 1
        elif any(part is Part.COLOR for _, part in missing):
            counts.frames_without_view += 1
        else:
            counts.frames_without_depth += 1
        made = AssembledFrame(
            frame_index=frame.frame_index,
            position=self._next_position(frame.frame_index),
            parts=frame.parts,
            missing=missing,
            first_arrived=frame.first_arrived,
            last_arrived=max(item.arrived for item in frame.parts.values()),
            capture_time_ns=min(times),
        )
        self._last_index, self._last_capture = made.frame_index, made.capture_time_ns
        self._position = made.position
        return made

    def _next_position(self, frame_index: int) -> int:
        if self._last_index is None:
            return self._position + 1
        step = frame_index - self._last_index
        if step > self._longest_gap:
            self.counts.restarts += 1
            return self._position + 1
        self.counts.frames_missing += step - 1
        return self._position + step

    @property
    def _longest_gap(self) -> int:
        """Numbers that may be left out before the source counts as begun anew."""
        return max(self.expected.window, round(10 / self.expected.interval))

    def _counts_anew(self, part: ArrivedPart) -> bool:
        """Tell whether a part of an earlier number was captured after what has left."""
        return (
            self._last_index is not None
            and part.frame_index <= self._last_index - self.expected.window
            and part.capture_time_ns > self._last_capture
        )

    def _begin_anew(self) -> None:
        """Forget what waits; numbers begin anew, positions go on."""
        self.counts.restarts += 1
        self.counts.parts_lost += self.waiting_parts
        self.counts.frames_incomplete += len(self._waiting)
        self._waiting.clear()
        self._last_index = None


def named(missing: frozenset[PartKey]) -> list[str]:
    """Return what is missing as text, for people: ``cam1/depth``."""
    return sorted(f"{view}/{part}" for view, part in missing)
