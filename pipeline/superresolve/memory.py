"""What one frame of a chain leaves to the next."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, Mask, MultiViewFrame, RegisteredView
from pipeline.reconstruction.alone import Restored
from pipeline.reconstruction.fused import FusedResult
from pipeline.registration.by_depth import DepthLaw, landed_by_depth, learn_law
from pipeline.registration.cleaning import cleaned_where
from pipeline.registration.register import Previous
from pipeline.superresolve.follow import Shown
from pipeline.superresolve.registered import RegisteredFrame
from pipeline.superresolve.seen import Seen
from pipeline.temporal.alike import ASKED, NOTHING_ASKED, Alike, Looked, differences_alike
from pipeline.temporal.flow import Flow
from pipeline.temporal.initial import BlockMatch, match_blocks
from pipeline.temporal.moving import has_moved
from pipeline.temporal.still_kernels import take_frames
from pipeline.threads import map_threads

STANDS = 0.5
"""Share of a target up to which it may change in a frame of a picture that stands."""

RIGHT = 0.5
"""How far patches may land from where depth maps say for these to be right, LR pixels."""

LAGGED = 4
"""Frames in which much of a coded picture has lagged behind until motions are found from scratch:
those of before hold what is fitted anew, and noise hides that they misfit."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Solved:
    """What a frame's reconstruction leaves to the next frame's."""

    result: FusedResult
    shown: GreyImage
    """(K·H, K·W) float32: what has become of it."""
    views: tuple[str, ...]
    """Of which views it was made."""
    frames: npt.NDArray[np.float32] | None
    """(H, W): of how many frames the pixels observed were the mean when it was made of them;
    None where there is no chain."""
    restored: Restored | None = None
    """Where frames since then were made of the target alone: what they left."""


class Memory:
    """What one frame of a chain leaves to the next; one owner, one stream.

    Registration and reconstruction each have their part of it, so that the one may be a frame
    ahead of the other.
    """

    def __init__(self) -> None:
        self.forget()
        self._solved: dict[str, Solved] = {}
        self._solved_turn = 0

    def forget(self) -> None:
        """Start a new chain: the next frame is computed on its own."""
        self.previous: Previous | None = None
        self.turn = self._stands_since = 0
        self.finding: Iterator[Previous | None] | None = None
        """What finds motions anew, step by step."""
        self.seen = Seen()
        self._lagged = 0
        """Frames in which much of the picture has lagged behind."""
        self.doubts = 0
        """Frames to come of which nothing is solved in few steps, see ``alike.DOUBTED``."""
        self._observed: dict[str, GreyImage] = {}
        self._missed: dict[str, Mask] = {}
        """By view, what has changed since something landed anew."""
        self._has_landed = False
        """Whether landing points are those of such a frame, which nobody else has."""
        self._laws: tuple[int, dict[tuple[str, str], DepthLaw | None]] = (-1, {})

    def begin_again(self) -> None:
        """Start a new chain in a picture that goes on as it did."""
        seen = self.seen.begun_again()
        self.forget()
        self.seen = seen

    def begin_apart(self) -> None:
        """Start a new chain, but let the means go on: they tell how long the picture changes."""
        still = self.seen.still
        self.begin_again()
        self.seen.still = still

    def has_moved(self, frame: MultiViewFrame, targets: Sequence[str]) -> bool:
        """Return whether a frame shows the targets as the one before, from another place."""
        return all(
            map_threads(
                lambda target: has_moved(frame.view(target).luma, self._observed[target]), targets
            )
        )

    def move(self) -> None:
        """Keep of the frames so far only what holds wherever the rig is."""
        self.move_on()
        self.seen.moved_on()

    def move_on(self) -> None:
        """Keep of the registration so far only what holds wherever the rig is."""
        self.stand_again()
        self.finding = None
        if self.previous is not None:
            self.previous = replace(self.previous, has_moved=True)

    @property
    def lacks_motions(self) -> bool:
        """Whether motions are those of another picture than the one that is seen now."""
        return self.previous is not None and self.previous.has_moved

    def stands(self, targets: Sequence[str]) -> bool:
        """Return whether most of the targets is what it was one frame before."""
        still = self.seen.still
        return all(name in still and still[name].share_touched <= STANDS for name in targets)

    def begin_to_find(self, finding: Iterator[Previous | None]) -> None:
        """Let motions be found anew of the frame just looked at."""
        self.finding, self._missed = finding, {}

    def has_found(self, found: Previous) -> None:
        """Go on by motions that were found anew, of the picture that stands."""
        self.turn += 1
        self._solved_turn = self.turn
        self.previous = replace(found, turn=self.turn)
        self.finding, self._has_landed = None, False

    def to_go_on_from(self) -> Previous | None:
        """Return what the previous frame left, and what of that has proved to lag behind."""
        lagging = {
            name: still.begun for name, still in self.seen.still.items() if still.lagging.any()
        }
        return None if self.previous is None else replace(self.previous, lagging=lagging)

    def found_alike(self, frame: MultiViewFrame, targets: Sequence[str]) -> Alike:
        """Return what the views of a frame just averaged tell of its means."""
        if self.previous is None:
            return NOTHING_ASKED
        registrations, still = self.previous.registrations, self.seen.still
        lumas = {view.view_id: view.luma for view in frame.views}
        place = {name: number for number, name in enumerate(lumas)}

        def look(target: str) -> npt.NDArray[np.float64]:
            known = {one.registered.view_id: one for one in registrations.get(target, ())}
            names = sorted(
                (known.keys() & lumas.keys() & still.keys()) - {target},
                key=lambda name: (abs(place[name] - place[target]), place[name]),
            )
            others = [
                Looked(
                    luma=lumas[name], mean=still[name].mean, touched=still[name].touched,
                    position=known[name].registered.position, flags=known[name].registered.flags,
                    offset=known[name].offset,
                )
                for name in names[:ASKED]
            ]  # fmt: skip
            own = still[target]
            return differences_alike(lumas[target], own.mean, own.touched, others)

        return Alike(np.add.reduce(map_threads(look, targets)))

    def lag(self) -> None:
        """Take note that much of a picture lags behind, and forget motions now and then."""
        self._lagged += 1
        if self._lagged % LAGGED == 0:
            seen, lagged = self.seen, self._lagged
            self.forget()
            self.seen, self._lagged = seen, lagged

    def known_views(self) -> dict[str, tuple[list[RegisteredView], list[GreyImage]]]:
        """Return the views registered onto each target, as they were when last looked at.

        With what is to be taken off the pixels observed of each. Nothing where they are so from
        another place, or no frame was reconstructed of them.
        """
        previous = self.previous
        if previous is None or previous.has_moved or not self._solved:
            return {}
        found = {}
        for target, registrations in previous.registrations.items():
            known = [one for one in registrations if one.registered.view_id in self.seen.still]
            views = [
                replace(one.registered, observed=self.seen.still[one.registered.view_id].mean)
                for one in known
            ]
            found[target] = views, [one.offset for one in known]
        return found

    def laws(self) -> dict[tuple[str, str], DepthLaw | None]:
        """Return, by target and view, what the last registered frame has shown of depth."""
        assert self.previous is not None  # a frame was registered
        if self._laws[0] != self.turn:
            prepared, registrations = self.previous.prepared, self.previous.registrations
            pairs = [
                (target, one)
                for target, ones in registrations.items()
                for one in ones
                if not one.registered.is_reference
            ]
            found = map_threads(
                lambda pair: learn_law(
                    pair[1], prepared[pair[1].registered.view_id].fine.nearness
                ),
                pairs,
            )  # fmt: skip
            names = [(target, one.registered.view_id) for target, one in pairs]
            self._laws = self.turn, dict(zip(names, found, strict=True))
        return self._laws[1]

    @property
    def frames_stood(self) -> int:
        """How many frames were registered since the chain began, or since the rig moved.

        From one to the next motions are found from means of more frames.
        """
        return self.turn - self._stands_since

    def solve_again(self) -> None:
        """Let the next frame solve all of its targets again, from what the last one left."""
        self._solved = {
            target: replace(
                solved, frames=None if solved.frames is None else np.zeros_like(solved.frames)
            )
            for target, solved in self._solved.items()
        }

    def stand_again(self) -> None:
        """Count the frames that were registered from this one on."""
        self._stands_since = self.turn

    def miss(self, view_ids: Sequence[str]) -> None:
        """Note what has changed of views in a frame in which nothing landed anew."""
        for view_id in view_ids:
            touched, before = self.seen.still[view_id].touched, self._missed.get(view_id)
            self._missed[view_id] = touched if before is None else touched | before
        if self.finding is not None and any(
            np.count_nonzero(missed) > STANDS * missed.size for missed in self._missed.values()
        ):
            self.finding = None

    def can_land(
        self, frame: MultiViewFrame, targets: Sequence[str], view_ids: Sequence[str]
    ) -> bool:
        """Return whether what changes in some views of a frame may land by their depth maps.

        That is so of a rig that stands still and whose depth has proved right.
        """
        previous = self.previous
        if (
            previous is None or previous.has_moved
            or not self.is_of_size(frame) or set(targets) != set(previous.registrations)
            or any(solved.frames is None for solved in self._solved.values())
        ):  # fmt: skip
            return False
        known = {view.view_id for view in frame.views if view.depth_map is not None}
        return all(
            law is not None and law.spread < RIGHT and name in known
            for (_, name), law in self.laws().items()
            if name in view_ids
        )

    def land(self, frame: MultiViewFrame, view_ids: Sequence[str]) -> None:
        """Let what has changed in some views of a frame land by their depth maps."""
        previous, laws = self.previous, self.laws()
        assert previous is not None  # there are laws
        self.miss([view.view_id for view in frame.views if view.view_id not in view_ids])
        views = {view.view_id: view for view in frame.views if view.view_id in view_ids}
        pairs = {
            name: [
                (target, place)
                for target, ones in previous.registrations.items()
                for place, one in enumerate(ones)
                if one.registered.view_id == name and laws.get((target, name)) is not None
            ]
            for name in views
        }
        registrations = {target: list(ones) for target, ones in previous.registrations.items()}

        def land(name: str) -> None:
            changed, depth_map = self.seen.still[name].touched, views[name].depth_map
            assert depth_map is not None  # depth has proved right
            if name in self._missed:
                changed = changed | self._missed[name]
            nearness = cleaned_where(depth_map, changed)
            for target, place in pairs[name]:
                law = laws[target, name]
                assert law is not None  # by which it lands
                registrations[target][place] = landed_by_depth(
                    registrations[target][place], law, nearness, changed, views[target].luma.shape,
                    self._has_landed,
                )  # fmt: skip

        map_threads(land, [name for name in views if pairs[name]])
        self.previous = replace(previous, registrations=registrations)
        self._missed = {name: mask for name, mask in self._missed.items() if name not in views}
        self._has_landed = True

    def landed_flows(self, leaders: Mapping[str, str | None]) -> dict[str, Flow]:
        """Return from where to where a target lands on the one that leads it, by its depth map.

        Parameters
        ----------
        leaders : mapping of target ids to target ids or None
            Those that None leads have no such flow.
        """
        assert self.previous is not None  # something has landed
        found = {}
        for target, leader in leaders.items():
            if leader is None:
                continue
            positions = next(
                one.registered.position
                for one in self.previous.registrations[leader]
                if one.registered.view_id == target
            )
            height, width = positions.shape[:2]
            flow = found[target] = np.empty_like(positions)
            np.subtract(positions[..., 0], np.arange(width, dtype=np.float32), out=flow[..., 0])
            np.subtract(
                positions[..., 1], np.arange(height, dtype=np.float32)[:, None], out=flow[..., 1]
            )
        return found

    def matches(
        self, frame: MultiViewFrame, targets: Sequence[str], noise: float
    ) -> dict[str, BlockMatch]:
        """Return how the targets have moved since the previous frame; empty where there is none."""
        if self.previous is None:
            return {}
        found = map_threads(
            lambda target: match_blocks(frame.view(target).luma, self._observed[target], noise),
            targets,
        )
        return dict(zip(targets, found, strict=True))

    def keep(self, found: Previous, observed: dict[str, GreyImage]) -> None:
        """Remember a frame that is registered."""
        self.turn += 1
        self.finding, self._missed, self._has_landed = None, {}, False
        self.previous = replace(found, turn=self.turn)
        self._observed = observed

    def solved(self, registered: RegisteredFrame, target: str) -> Solved | None:
        """Return the previous frame's result of a target; None where the chain has none."""
        if target not in registered.matches or self._solved_turn != registered.turn - 1:
            return None
        return self._solved[target]

    def is_of_size(self, frame: MultiViewFrame) -> bool:
        """Return whether the targets of the frame before, if any, have the size of this one's."""
        shapes = {luma.shape for luma in self._observed.values()}
        return not shapes or shapes == {frame.lr_shape}

    def restored(self, target: str) -> Restored | None:
        """Return what a target's last frame leaves to one that is made of the target alone.

        Its estimate may be written over; other solvers than the fused one keep theirs.
        """
        solved = self._solved.get(target)
        if self.previous is None or solved is None or solved.frames is None:
            return None
        return solved.restored or Restored(
            estimate=np.require(solved.result.estimate, requirements="W"), shown=solved.shown,
            frames=np.full_like(solved.frames, np.inf),
        )  # fmt: skip

    def is_ripe(self, target: str, rows: slice) -> Mask:
        """Return where a target's pixels are means of twice as many frames as when it was made.

        Or where it was made of itself alone; of some of its rows.
        """
        count, frames = self.seen.still[target].count[rows], self._solved[target].frames
        return np.ones(count.shape, np.bool_) if frames is None else count >= 2 * frames[rows]

    def shown(self, targets: Sequence[str]) -> dict[str, Shown]:
        """Return what the last frame has left of these targets, as far as it has any."""
        found = {target: self.restored(target) for target in targets}
        return {
            target: Shown(observed=self._observed[target], shown=left.shown)
            for target, left in found.items()
            if left is not None
        }

    def keep_restored(self, frame: MultiViewFrame, made: Mapping[str, Restored]) -> None:
        """Remember a frame whose targets were made of themselves alone; of a chain only."""
        if self.previous is None:
            return
        self._observed |= {target: frame.view(target).luma for target in made}

        def solved(target: str) -> Solved:
            old, left = self._solved[target], made[target]
            frames = old.frames
            if frames is not None:
                count = self.seen.still[target].count
                again = np.zeros(count.shape, np.bool_) if left.again is None else left.again
                frames = np.empty_like(frames)
                take_frames(old.frames, left.frames, count, again, frames)
            return replace(
                old,
                result=replace(old.result, estimate=left.estimate),
                shown=left.shown,
                frames=frames,
                restored=left,
            )

        self._solved |= dict(zip(made, map_threads(solved, made), strict=True))

    def keep_solved(self, registered: RegisteredFrame, solved: dict[str, Solved]) -> None:
        """Remember a frame that is reconstructed."""
        self._solved_turn, self._solved = registered.turn, solved
