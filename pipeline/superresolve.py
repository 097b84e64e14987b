"""One multi-view frame in, super-resolved reference views out: the order of the stages.

Registration says where each LR pixel lands and whether to trust it; reconstruction
consumes that and knows nothing of depth, layers or cameras. This file hands the
:class:`RegisteredView` records from one to the other, and accounts for what happened.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.colour import interleaved
from pipeline.config import Settings, Solver
from pipeline.effort import FULL, Effort, nearest_views
from pipeline.errors import ConfigurationError, Interrupted, SceneError
from pipeline.frames import ChromaImage, GreyImage, MultiViewFrame, RegisteredView, View
from pipeline.grid import Grid
from pipeline.learned_filters import learned_filters
from pipeline.noise import estimate_noise
from pipeline.reconstruction.again import Due, fuse_again
from pipeline.reconstruction.alone import CHANGE_REACH, Restored, restored
from pipeline.reconstruction.coverage import phase_coverage
from pipeline.reconstruction.fused import (
    FusedResult,
    FusedTuning,
    by_power,
    estimate_alone,
    finished,
    fuse,
    initial_estimate,
    landing_points,
    left_over,
    some_rows,
)
from pipeline.reconstruction.learned import LearnedFilters
from pipeline.reconstruction.median import median_magnitude
from pipeline.reconstruction.pocs import pocs
from pipeline.reconstruction.psf import BicubicPsf, GaussianPsf, Psf, psf_axes, sampling_taps
from pipeline.registration.layers import layer_labels, layer_thresholds
from pipeline.registration.method import METHODS, Layout, RegistrationMethod
from pipeline.registration.prepare import PreparedView
from pipeline.registration.register import (
    Previous,
    Thresholds,
    ViewRegistration,
    prepare_views,
    register_some,
    register_views,
)
from pipeline.registration.verification import count_rejections
from pipeline.results import (
    FrameReport,
    FrameResult,
    SuperResolvedImage,
    TargetDebug,
    TargetReport,
    ViewReport,
)
from pipeline.temporal.initial import BlockMatch, StartChoice, match_blocks, warped
from pipeline.temporal.moving import has_moved
from pipeline.temporal.neighbours import with_neighbours
from pipeline.temporal.still import Still, first_seen, seen_again
from pipeline.threads import map_threads, set_threads, stoppable

PICTURE_LAYERS = 11
"""Depth layers shown in debug pictures where the method has none of its own (thesis Figure 2)."""

SEES_NOTHING = 0.02
"""Trusted share of a view below which it is said to see nothing."""

NOTHING_NEW = 5.0
"""Phase coverage gained, per cent, below which views are said to bring nothing new."""


WARM = FusedTuning(alone=0.0, together=4)
"""Work from the previous frame's result; see :class:`FusedTuning` for that from a cold start."""

NEW = FusedTuning(alone=0.0, together=14, settled=0.08)
"""The same where the previous frame does not show it."""

MOVED = FusedTuning(
    together=7, prior_strength=0.09, prior_noise_power=1.75, prior_psf_powers=(-1.0, -1.35),
    data_share=0.015,
)  # fmt: skip
"""Work from a cold start where the camera has moved, of two views and at σ_psf 1: few steps smooth
by themselves, and leave less to the prior; with so few observations they may go farther. More views
need no more steps as it is."""

MOVED_FROM = 1.0
"""Noise from which so few steps are enough: with less of it there is more to find, grey levels."""

MOVED_PSF_POWERS = (-1.3, 0.85)
"""They grow with σ_psf to the first power below σ_psf 1, to the second above; …"""

MOVED_NOISE_POWERS = (-0.2, 0.0)
"""… and with the noise likewise, below and above noise 2."""

STILL = FusedTuning(alone=0.0, together=2)
"""The same where nothing has changed but the mean of the observations."""

MOSTLY_CHANGED = 0.9
"""Share of the pixels, halos included, from which what has changed is not worth being cut out:
all is reconstructed again at once."""

REFRESH = 4
"""Frames within which everything is reconstructed again, changed or not."""


@dataclass(frozen=True, kw_only=True)
class _Target:
    """One reconstructed reference view."""

    image: SuperResolvedImage
    report: TargetReport
    debug: TargetDebug | None
    solved: Solved


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


@dataclass(frozen=True, kw_only=True, eq=False)
class RegisteredFrame:
    """A frame whose views are registered: all that its reconstruction needs."""

    frame: MultiViewFrame
    """In a chain, its luma averaged over the frames in which it has stood still."""
    settings: Settings
    targets: tuple[str, ...]
    sources: tuple[str, ...]
    """Ids of the observed views."""
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
    motions_are_kept: bool
    """Whether the motions are those of the frame before, unchanged."""
    turn: int
    """Frames since the chain began."""
    layers: Mapping[str, npt.NDArray[np.int32]] | None
    """Depth layers by view id, where pictures of them are wanted."""
    timings: Mapping[str, float]
    """Seconds by stage."""


def superresolve(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: tuple[str, ...],
    observed_views: tuple[str, ...] | None = None,
    psf: Psf | None = None,
    keep_intermediates: bool = False,
    stop: Callable[[], bool] | None = None,
    memory: Memory | None = None,
    effort: Effort = FULL,
    neighbours: Sequence[MultiViewFrame] = (),
) -> FrameResult:
    """Super-resolve reference views of one frame from all (or some) of its views.

    Parameters
    ----------
    frame : MultiViewFrame
        N views of (H, W) LR pixels.
    settings : Settings
    targets : tuple of view ids
        Reference views to reconstruct.
    observed_views : tuple of view ids, optional
        Views whose pixels may be used; default: all. Every target must be among them.
    psf : GaussianPsf or BicubicPsf, optional
        The estimated PSF, where the settings say "auto" (see ``psf_search``).
    keep_intermediates : bool
        Whether the result carries what debug pictures need.
    stop : callable, optional
        Polled between stages, views and sweeps.
    memory : Memory, optional
        Of the chain of frames that this one goes on; it is brought up to date.
    effort : Effort
        What may be left out, for a controller that holds a rate; where views are, neighbours
        are too.
    neighbours : sequence of MultiViewFrame
        Frames before and after this one, whose pixels are further constraints.

    Returns
    -------
    FrameResult

    Raises
    ------
    SceneError
        If a target is not among the observed views.
    ConfigurationError
        If the settings say that the PSF is estimated and no estimate is handed over.
    Interrupted
        If ``stop`` said so; nothing is returned then.
    """
    if effort.alone:
        return restore_frame(
            frame, settings, targets=targets, psf=psf, stop=stop, memory=memory, effort=effort
        )
    registered = register_frame(
        frame, settings, targets=targets, observed_views=observed_views, psf=psf,
        keep_intermediates=keep_intermediates, stop=stop, memory=memory, effort=effort,
        neighbours=neighbours,
    )  # fmt: skip
    return reconstruct_frame(registered, stop=stop, memory=memory)


def register_frame(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: tuple[str, ...],
    observed_views: tuple[str, ...] | None = None,
    psf: Psf | None = None,
    keep_intermediates: bool = False,
    stop: Callable[[], bool] | None = None,
    memory: Memory | None = None,
    effort: Effort = FULL,
    neighbours: Sequence[MultiViewFrame] = (),
) -> RegisteredFrame:
    """Do the first half of :func:`superresolve`, which takes the same parameters.

    Of a chain, the next frame may be registered while this one is reconstructed.
    """
    set_threads(settings.threads)
    clock = _Stages(stop)
    sources = observed_views or tuple(view.view_id for view in frame.views)
    for target in targets:
        if target not in sources:
            raise SceneError(
                "cannot be reconstructed: it is not among the observed views",
                view=target, frame=frame.frame_index,
            )  # fmt: skip
    if effort.views is not None:
        in_order = [view.view_id for view in frame.views if view.view_id in sources]
        sources = nearest_views(in_order, targets, effort.views)
    widened = frame
    added: tuple[str, ...] = ()
    if neighbours and effort.views is None:
        widened, added = with_neighbours(frame, neighbours, sources)
    observed = (*sources, *added)
    views = [widened.view(view_id) for view_id in dict.fromkeys((*targets, *observed))]
    noise = (memory or Memory()).noise(frame, settings, sources)
    psf = psf or _psf_of(settings)
    method = chosen_method(settings)
    clock.done("preparation")
    with stoppable(stop):
        matches = {} if memory is None else memory.matches(frame, targets, noise)
        is_other = any(match.is_cut for match in matches.values())
        has_moved = memory is not None and is_other and memory.has_moved(frame, targets)
        is_cut = is_other and not has_moved
        if is_cut and memory is not None:
            memory.forget()
            matches, noise = {}, memory.noise(frame, settings, sources)
        if has_moved and memory is not None:
            memory.move()
            matches = {}
        if memory is not None:
            frame = memory.averaged(frame, noise)
            if not added:
                widened = frame
            views = [widened.view(view_id) for view_id in dict.fromkeys((*targets, *observed))]
        previous = None if memory is None else memory.previous
        keeps_motions = (
            previous is not None
            and not effort.register
            and not has_moved
            and _covers(previous, targets, observed)
        )
        due = known = observed
        if previous is not None and _covers(previous, targets, observed) and not has_moved:
            due = _due_views(observed, effort.register_every, previous.turn)
            known = (*observed, *_left_out(previous, targets, observed))
        if previous is not None and keeps_motions:
            found = previous
            registrations = _with_pixels_of(previous, widened, targets, observed)
        else:
            prepared, registrations = _registered(
                frame, views, targets, known, settings, method, noise, previous, due
            )
            found = Previous(prepared=prepared, registrations=registrations, turn=0)
            if len(due) < len(known):
                registrations = _with_pixels_of(found, widened, targets, observed)
    if memory is not None:
        # motions that are kept stay with the pixels that they were found from
        memory.keep(
            found, {target: frame.view(target).luma for target in targets}, frame.frame_index
        )
    clock.done("registration")
    return RegisteredFrame(
        frame=frame,
        settings=settings,
        targets=targets,
        sources=sources,
        still={} if memory is None else {target: memory.still[target] for target in targets},
        psf=psf,
        noise=noise,
        registrations=registrations,
        matches=matches,
        is_cut=is_cut,
        has_moved=has_moved,
        effort=effort,
        motions_are_kept=keeps_motions,
        turn=1 if memory is None else memory.turn,
        layers=_layers_of(found.prepared, method) if keep_intermediates else None,
        timings=clock.timings,
    )


def reconstruct_frame(
    registered: RegisteredFrame,
    *,
    stop: Callable[[], bool] | None = None,
    memory: Memory | None = None,
) -> FrameResult:
    """Do the second half of :func:`superresolve`: the images of a registered frame."""
    frame, settings, psf = registered.frame, registered.settings, registered.psf
    clock = _Stages(stop)

    def reconstruct(target: str) -> _Target:
        return _reconstruct(
            registered,
            target,
            stop,
            None if memory is None else memory.solved(registered, target),
        )

    with stoppable(stop):
        results = map_threads(reconstruct, registered.targets)
        if memory is not None:
            memory.keep_solved(
                registered, {result.image.view_id: result.solved for result in results}
            )
        clock.done("reconstruction")
        images = {result.image.view_id: result.image for result in results}
        for target in registered.targets:
            chroma = _chroma(frame, settings, target, registered.sources, psf)
            images[target] = replace(images[target], chroma=chroma)
    clock.done("chroma")
    report = FrameReport(
        frame_index=frame.frame_index,
        noise_sigma=registered.noise,
        noise_is_estimated=settings.noise_sigma is None,
        psf_sigma=psf.sigma,
        psf_support=psf.support,
        psf_is_estimated=settings.psf == "auto",
        targets=tuple(result.report for result in results),
        effort=registered.effort,
        motions_are_kept=registered.motions_are_kept,
        timings={**registered.timings, **clock.timings},
        warnings=(
            *_warnings(frame, registered.sources),
            *_unused(settings, chosen_method(settings)),
        ),
    )
    debug = {result.image.view_id: result.debug for result in results if result.debug is not None}
    return FrameResult(frame_index=frame.frame_index, images=images, report=report, debug=debug)


def restore_frame(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: tuple[str, ...],
    psf: Psf | None = None,
    stop: Callable[[], bool] | None = None,
    memory: Memory | None = None,
    effort: Effort = FULL,
) -> FrameResult:
    """Do what :func:`superresolve` does where each target is to be made of itself alone.

    What has not changed since the previous frame stays as it was.
    """
    set_threads(settings.threads)
    clock = _Stages(stop)
    psf = psf or _psf_of(settings)
    memory = memory or Memory()
    frame = replace(frame, views=tuple(frame.view(target) for target in targets))
    with stoppable(stop):
        if not memory.is_of_size(frame):
            memory.forget()
        noise = memory.known_noise(targets)
        if noise is None:
            noise = memory.noise(frame, settings, targets)
        frame = memory.averaged(frame, noise)
        learned = chosen_filters(settings, psf, noise)
        clock.done("preparation")

        def restore(target: str) -> Restored:
            return restored(
                memory.still[target], memory.restored(target), settings.grid, psf, noise, learned
            )

        found = dict(zip(targets, map_threads(restore, targets), strict=True))
        memory.keep_restored(frame, found)
        clock.done("reconstruction")
        images = {
            target: SuperResolvedImage(
                view_id=target,
                luma=made.shown,
                chroma=_chroma(frame, settings, target, targets, psf),
            )
            for target, made in found.items()
        }
    clock.done("chroma")
    report = FrameReport(
        frame_index=frame.frame_index,
        noise_sigma=noise,
        noise_is_estimated=settings.noise_sigma is None,
        psf_sigma=psf.sigma,
        psf_support=psf.support,
        psf_is_estimated=settings.psf == "auto",
        targets=tuple(_report_alone(target, settings) for target in targets),
        effort=effort,
        motions_are_kept=True,
        timings=clock.timings,
    )
    return FrameResult(frame_index=frame.frame_index, images=images, report=report)


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
        self.turn = 0
        self._found_in = self._last = -1
        self._observed: dict[str, GreyImage] = {}
        self.still: dict[str, Still] = {}
        self._noise: dict[str, float] = {}

    def noise(self, frame: MultiViewFrame, settings: Settings, view_ids: Sequence[str]) -> float:
        """Return the noise of the settings, or that of the frame's views, grey levels.

        Of a chain's frames after the first, one view is looked at, another one in each.
        """
        if settings.noise_sigma is not None:
            return settings.noise_sigma
        new = [name for name in view_ids if name not in self._noise]
        due = new or [view_ids[frame.frame_index % len(view_ids)]]
        found = map_threads(estimate_noise, [frame.view(name).luma for name in due])
        self._noise = {**self._noise, **dict(zip(due, found, strict=True))}
        return float(np.median([self._noise[name] for name in view_ids]))

    def known_noise(self, view_ids: Sequence[str]) -> float | None:
        """Return the noise that frames before have shown, grey levels; None: none has."""
        found = [self._noise[name] for name in view_ids if name in self._noise]
        return float(np.median(found)) if len(found) == len(view_ids) else None

    def has_moved(self, frame: MultiViewFrame, targets: Sequence[str]) -> bool:
        """Return whether a frame shows the targets as the one before, from another place."""
        return all(has_moved(frame.view(target).luma, self._observed[target]) for target in targets)

    def move(self) -> None:
        """Keep of the frames so far only what holds wherever the rig is."""
        assert self.previous is not None  # it has moved since then
        self.previous = replace(self.previous, has_moved=True)
        self.still = {}

    def watch(self, frame: MultiViewFrame, settings: Settings) -> None:
        """Take note of a frame that is not computed."""
        names = [view.view_id for view in frame.views]
        self.averaged(frame, self.noise(frame, settings, names))

    def averaged(self, frame: MultiViewFrame, noise: float) -> MultiViewFrame:
        """Return the frame with what stands still averaged over the frames before."""

        def seen(view: View) -> Still:
            before = self.still.get(view.view_id)
            return first_seen(view.luma) if before is None else seen_again(view.luma, before, noise)

        found = map_threads(seen, frame.views)
        seen_now = {view.view_id: still for view, still in zip(frame.views, found, strict=True)}
        self.still = {**self.still, **seen_now}
        views = [
            replace(view, luma=still.mean) for view, still in zip(frame.views, found, strict=True)
        ]
        return replace(frame, views=tuple(views))

    def matches(
        self, frame: MultiViewFrame, targets: Sequence[str], noise: float
    ) -> dict[str, BlockMatch]:
        """Return how the targets have moved since the previous frame; empty where there is none."""
        if self.previous is None:
            return {}
        return {
            target: match_blocks(frame.view(target).luma, self._observed[target], noise)
            for target in targets
        }

    def keep(self, found: Previous, observed: dict[str, GreyImage], frame_index: int) -> None:
        """Remember a frame that is registered."""
        self.turn += 1
        if self.previous is None or found.prepared is not self.previous.prepared:
            self._found_in = frame_index
        self._last = frame_index
        self.previous = replace(found, turn=self.turn)
        self._observed = observed

    def split(self, targets: Sequence[str]) -> tuple[Memory, Memory]:
        """Return the memories of these targets and of the others, which then go their own ways."""
        others = [target for target in self._observed if target not in targets]
        return self._of(targets), self._of(others)

    def joined(self, other: Memory) -> Memory | None:
        """Return the memory of both one's targets; None unless they stand at the same frame."""
        one, two = self.previous, other.previous
        here, there = ((memory._found_in, memory._last) for memory in (self, other))
        if one is None or two is None or here != there:
            return None
        both = Memory()
        both.turn = both._solved_turn = max(self.turn, other.turn)
        both._found_in, both._last = here
        both.previous = Previous(
            prepared={**two.prepared, **one.prepared},
            registrations={**one.registrations, **two.registrations},
            turn=both.turn,
        )
        both._observed = {**self._observed, **other._observed}
        both.still = {**other.still, **self.still}
        both._noise = {**other._noise, **self._noise}
        both._solved = {**self._solved, **other._solved}
        return both

    @property
    def targets(self) -> frozenset[str]:
        """The targets of the last frame; empty where there is none."""
        return frozenset(self._observed)

    def _of(self, targets: Sequence[str]) -> Memory:
        part = Memory()
        part.turn, part._solved_turn = self.turn, self._solved_turn
        part._found_in, part._last = self._found_in, self._last
        assert self.previous is not None  # there are targets
        part.previous = replace(
            self.previous,
            registrations={target: self.previous.registrations[target] for target in targets},
        )
        part._observed = {target: self._observed[target] for target in targets}
        part.still, part._noise = self.still, self._noise
        part._solved = {
            target: image for target, image in self._solved.items() if target in targets
        }
        return part

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
        """Return what a target's last frame leaves to one that is made of the target alone."""
        solved = self._solved.get(target)
        if self.previous is None or solved is None or solved.frames is None:
            return None
        return solved.restored or Restored(
            estimate=solved.result.estimate, shown=solved.shown,
            frames=np.full_like(solved.frames, np.inf),
        )  # fmt: skip

    def keep_restored(self, frame: MultiViewFrame, made: Mapping[str, Restored]) -> None:
        """Remember a frame whose targets were made of themselves alone; of a chain only."""
        if self.previous is None:
            return
        self._last = frame.frame_index
        for target, left in made.items():
            self._observed[target] = frame.view(target).luma
            old = self._solved[target]
            self._solved[target] = replace(
                old,
                result=replace(old.result, estimate=left.estimate),
                shown=left.shown,
                frames=None
                if old.frames is None
                else np.where(np.isinf(left.frames), old.frames, np.float32(0)),
                restored=left,
            )

    def keep_solved(self, registered: RegisteredFrame, solved: dict[str, Solved]) -> None:
        """Remember a frame that is reconstructed."""
        self._solved_turn, self._solved = registered.turn, solved


class _Stages:
    """Times the stages, and lets a stop through between them."""

    def __init__(self, stop: Callable[[], bool] | None) -> None:
        self._stop = stop
        self._begin = time.perf_counter()
        self.timings: dict[str, float] = {}

    def done(self, stage: str) -> None:
        now = time.perf_counter()
        self.timings[stage] = now - self._begin
        self._begin = now
        if self._stop is not None and self._stop():
            raise Interrupted


def _psf_of(settings: Settings) -> Psf:
    """Return the PSF that the settings tell."""
    if settings.psf == "auto":
        raise ConfigurationError("--psf auto: no estimate was made before the first frame")
    if settings.psf == "bicubic":
        return BicubicPsf(magnification=settings.grid.largest)
    return given_psf(settings)


def given_psf(settings: Settings) -> GaussianPsf:
    """Return the Gaussian of the settings: as given, or half of K wide."""
    sigma = settings.psf_sigma or 0.5 * settings.grid.largest
    return GaussianPsf.of(sigma, settings.psf_support)


def chosen_filters(settings: Settings, psf: Psf, noise: float) -> LearnedFilters | None:
    """Return the learned filters of the settings, None where there are none."""
    if settings.filters == "none" or settings.solver != Solver.FUSED:
        return None
    return learned_filters(settings.grid, psf.sigma, noise)


def chosen_method(settings: Settings) -> RegistrationMethod:
    """Return the registration method of the settings, with L and R where they are given."""
    method = METHODS[settings.registration]
    if settings.layers is not None:
        method = replace(method, num_layers=settings.layers)
    if settings.subregions is not None:
        method = replace(method, num_subregions=settings.subregions)
    return method


def default_weight_threshold(noise: float) -> float:
    """Return T_w for a noise, grey levels: noise of two pictures, and some aliasing."""
    return 3.0 + 3.0 * noise


def default_residual_threshold(noise: float) -> float:
    """Return T_R for a noise, grey levels: what no noise and little aliasing explains."""
    return 12.0 + 5.0 * noise


def _registered(
    frame: MultiViewFrame,
    views: Sequence[View],
    targets: Sequence[str],
    sources: Sequence[str],
    settings: Settings,
    method: RegistrationMethod,
    noise: float,
    previous: Previous | None,
    due: Sequence[str],
) -> tuple[dict[str, PreparedView], dict[str, list[ViewRegistration]]]:
    """Return the views prepared and registered; those that are not due keep their motions."""
    needed = [view for view in views if view.view_id in (*targets, *due)]
    prepared = prepare_views(needed, metric=frame.depth_is_metric)
    thresholds = Thresholds(
        weight=settings.weight_threshold or default_weight_threshold(noise),
        depth=settings.depth_threshold,
    )
    if previous is not None and len(due) < len(sources):
        prepared = {**previous.prepared, **prepared}
        return prepared, register_some(
            prepared, targets, sources, due, method, noise=noise, thresholds=thresholds,
            previous=previous,
        )  # fmt: skip
    known = [
        source
        for source in sources
        if previous is not None and _covers(previous, targets, [source])
    ]
    new = [source for source in sources if source not in known]
    found: dict[str, dict[str, ViewRegistration]] = {target: {} for target in targets}
    for part, before in ((known, previous), (new, None)):
        if part:
            registrations = register_views(
                prepared, targets, part, method, noise=noise, thresholds=thresholds, previous=before
            )
            for target in targets:
                found[target] |= dict(zip(part, registrations[target], strict=True))
    return prepared, {target: [found[target][source] for source in sources] for target in targets}


def _due_views(sources: Sequence[str], every: int, turn: int) -> tuple[str, ...]:
    """Return the views whose motions are found anew in this frame.

    >>> [_due_views("abcd", 3, turn) for turn in range(3)]
    [('a', 'd'), ('c',), ('b',)]
    """
    return tuple(name for place, name in enumerate(sources) if (place + turn) % every == 0)


def _left_out(
    previous: Previous, targets: Sequence[str], sources: Sequence[str]
) -> tuple[str, ...]:
    """Return the views that were registered onto all targets before, but for these."""
    names = [one.registered.view_id for one in previous.registrations[targets[0]]]
    return tuple(
        name for name in names if name not in sources and _covers(previous, targets, [name])
    )


def _covers(previous: Previous, targets: Sequence[str], sources: Sequence[str]) -> bool:
    """Return whether all of the sources were registered onto all of the targets before."""
    return all(
        set(sources) <= {one.registered.view_id for one in previous.registrations.get(target, ())}
        for target in targets
    )


def _with_pixels_of(
    previous: Previous, frame: MultiViewFrame, targets: Sequence[str], sources: Sequence[str]
) -> dict[str, list[ViewRegistration]]:
    """Return the previous frame's registrations, unchanged but for the pixels observed."""
    found: dict[str, list[ViewRegistration]] = {}
    for target in targets:
        before = {one.registered.view_id: one for one in previous.registrations[target]}
        found[target] = []
        for source in sources:
            old = before[source]
            observed = frame.view(source).luma - old.offset
            found[target].append(
                replace(old, registered=replace(old.registered, observed=observed))
            )
    return found


def _reconstruct(
    frame: RegisteredFrame,
    target: str,
    stop: Callable[[], bool] | None,
    previous: Solved | None,
) -> _Target:
    """Return one reference view reconstructed from the views registered onto it."""
    settings, grid = frame.settings, frame.settings.grid
    reference, registrations = frame.frame.view(target), frame.registrations[target]
    registered = [registration.registered for registration in registrations]
    lr_shape = reference.luma.shape
    learned = chosen_filters(settings, frame.psf, frame.noise)
    start = None
    choice = StartChoice(warm_share=0.0, is_cut=frame.is_cut, has_moved=frame.has_moved)
    if previous is not None:
        match = frame.matches[target]
        cold = estimate_alone(
            reference.luma, grid, frame.psf, frame.noise, learned,
            ~match.matched_pixels((lr_shape[0], lr_shape[1])),
        )  # fmt: skip
        start = warped(match, previous.result.estimate, cold, grid)
        choice = match.choice
    views = tuple(view.view_id for view in registered)
    due = shown = None
    if previous is not None:
        previous = _of_views(previous, registered)
        due = _due(frame, target, previous)
    if previous is not None and start is not None and due is not None:
        shown = previous.shown, [box for part in due for box in part.boxes], grid
        solved = fuse_again(
            registered, grid, frame.psf, previous.result, start, due,
            residual_threshold=settings.residual_threshold
            or default_residual_threshold(frame.noise),
            most_steps=frame.effort.steps, stop=stop,
        )  # fmt: skip
    else:
        solved = _solve(
            settings, frame.psf, frame.noise, registered, grid,
            (lr_shape[0], lr_shape[1]), stop, start, _tuning(frame, len(registered), start),
            learned, frame.effort.steps,
        )  # fmt: skip
    if stop is not None and stop():
        raise Interrupted
    trusted = [flags == 0 for flags in solved.flags]
    filled = np.zeros(grid.hr_shape((lr_shape[0], lr_shape[1])), np.bool_)
    own_phases, all_phases = (
        phase_coverage(
            [view.position for view in registered if view.is_reference == is_own],
            [
                mask
                for view, mask in zip(registered, trusted, strict=True)
                if view.is_reference == is_own
            ],
            grid, lr_shape, filled=filled,
        )
        for is_own in (True, False)
    )  # fmt: skip
    reports = tuple(
        _view_report(view, flags, weight, misfit)
        for view, flags, weight, misfit in zip(
            registered, solved.flags, solved.weights, solved.misfits, strict=True
        )
    )
    report = TargetReport(
        view_id=reference.view_id,
        views=reports,
        phase_coverage=100 * all_phases,
        phase_coverage_reference=100 * own_phases,
        remark=_remark(reports, registered, 100 * (all_phases - own_phases)),
        solver=settings.solver,
        iterations=solved.iterations,
        stop_reason=solved.stop_reason,
        residuals=solved.residuals,
        start=choice,
    )
    debug = None
    if frame.layers is not None:
        debug = TargetDebug(
            view_id=reference.view_id,
            registered=tuple(
                replace(view, flags=flags)
                for view, flags in zip(registered, solved.flags, strict=True)
            ),
            weights=solved.weights,
            patch_labels={
                registration.registered.view_id: registration.patch_labels
                for registration in registrations
            },
            layer_labels=frame.layers,
            contribution_count=solved.density,
        )
    luma = np.clip(finished(solved, learned, shown), 0.0, 255.0)
    image = SuperResolvedImage(view_id=reference.view_id, luma=luma)
    kept = Solved(
        result=solved, shown=luma, views=views,
        frames=_frames_solved(frame, target, previous, due),
    )  # fmt: skip
    return _Target(image=image, report=report, debug=debug, solved=kept)


def _of_views(solved: Solved, registered: Sequence[RegisteredView]) -> Solved:
    """Return what is left of a frame to one that observes other views: nothing of new ones."""
    views = tuple(view.view_id for view in registered)
    if views == solved.views:
        return solved
    places = {name: place for place, name in enumerate(solved.views)}
    weights, flags = solved.result.weights, solved.result.flags
    result = replace(
        solved.result,
        weights=tuple(
            weights[places[view.view_id]]
            if view.view_id in places
            else np.zeros(view.flags.shape, np.float32)
            for view in registered
        ),
        flags=tuple(
            flags[places[view.view_id]] if view.view_id in places else view.flags
            for view in registered
        ),
    )
    return replace(solved, result=result, views=views)


def _due(frame: RegisteredFrame, target: str, previous: Solved) -> list[Due] | None:
    """Return what of a target is reconstructed again; None: all of it.

    That is what has changed, boxes with something in them that the previous frame does not show
    more thoroughly than others, and a part of what has not, another one in each frame; all of
    it where the pixels are for the most part means of twice as many frames as they were. Parts
    that cost more together, with their halos, than the whole frame does are one.
    """
    still = frame.still.get(target)
    if still is None or previous.frames is None or frame.settings.solver != Solver.FUSED:
        return None
    side = 2 * CHANGE_REACH + 1
    changed = cv2.dilate(still.changed.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    due = [Due(wanted=changed, noise=frame.noise, tuning=WARM)]
    if due[0].share > MOSTLY_CHANGED:
        return None
    unseen = changed & ~frame.matches[target].matched_pixels(changed.shape)
    with_unseen = np.zeros_like(changed)
    for box in due[0].boxes:
        if unseen[box].any():
            with_unseen[box] = changed[box]
    due = [
        Due(wanted=part, noise=frame.noise, tuning=tuning)
        for part, tuning in ((changed & ~with_unseen, WARM), (with_unseen, NEW))
        if part.any()
    ]
    again = ~changed
    ripe = (still.count >= 2 * previous.frames)[again]
    if ripe.size and ripe.mean() <= 0.5:
        edges = np.linspace(0, len(changed), REFRESH + 1).astype(int)
        turn = frame.frame.frame_index % REFRESH
        again[: edges[turn]] = again[edges[turn + 1] :] = False
    if again.any():
        due.append(Due(wanted=again, noise=frame.noise, tuning=STILL))
    if sum(part.share * part.tuning.together for part in due) > NEW.together:
        return [Due(wanted=np.ones_like(changed), noise=frame.noise, tuning=NEW)]
    return due


def _frames_solved(
    frame: RegisteredFrame, target: str, previous: Solved | None, due: Sequence[Due] | None
) -> npt.NDArray[np.float32] | None:
    still = frame.still.get(target)
    if still is None or previous is None or previous.frames is None or due is None:
        return None if still is None else still.count
    frames = previous.frames.copy()
    for part in due:
        np.copyto(frames, still.count, where=part.wanted)
    return frames


def _tuning(frame: RegisteredFrame, num_views: int, start: GreyImage | None) -> FusedTuning:
    """Return how a whole target is solved."""
    if start is not None:
        return WARM
    is_known = num_views == 2 and frame.noise >= MOVED_FROM and frame.settings.grid.largest == 2
    if not (frame.has_moved and is_known):
        return FusedTuning()
    growth = by_power(frame.psf.sigma, MOVED_PSF_POWERS)
    growth *= by_power(frame.noise / 2, MOVED_NOISE_POWERS)
    return replace(MOVED, together=round(MOVED.together * growth))


def _solve(
    settings: Settings,
    psf: Psf,
    noise: float,
    registered: Sequence[RegisteredView],
    grid: Grid,
    lr_shape: tuple[int, int],
    stop: Callable[[], bool] | None,
    start: GreyImage | None,
    tuning: FusedTuning,
    learned: LearnedFilters | None,
    steps: int | None,
) -> FusedResult:
    """Run the chosen solver; a POCS result is brought into the same form."""
    residual_threshold = settings.residual_threshold or default_residual_threshold(noise)
    if settings.solver == Solver.FUSED:
        return fuse(
            registered, grid, lr_shape, psf,
            noise=noise, residual_threshold=residual_threshold, stop=stop,
            start=start, tuning=tuning, learned=learned, most_steps=steps,
        )  # fmt: skip
    own = next(view for view in registered if view.is_reference)
    shape = grid.hr_shape(lr_shape)
    bound = 2 * noise if settings.residual_bound is None else settings.residual_bound
    swept = pocs(
        registered, grid, shape, *psf_axes(psf, grid),
        initial_estimate(own.observed, grid) if start is None else start,
        sweeps=min(settings.sweeps, steps or settings.sweeps),
        residual_bound=bound, residual_threshold=residual_threshold,
        simplified=settings.solver == Solver.POCS_SIMPLIFIED, stop=stop,
    )  # fmt: skip
    taps = sampling_taps(psf, grid)
    weights = tuple((flags == 0).astype(np.float32) for flags in swept.flags)
    points = [landing_points(view, grid) for view in registered]
    density = np.zeros(shape, np.float32)
    for (x, y), weight in zip(points, weights, strict=True):
        _count_nearest(x, y, weight, density)
    some = [(some_rows(x), some_rows(y)) for x, y in points]
    _, misfits = left_over(swept.estimate, taps, some, registered, swept.flags, weights)
    return FusedResult(
        estimate=swept.estimate,
        weights=weights,
        flags=swept.flags,
        misfits=misfits,
        density=density,
        iterations=swept.sweeps_done,
        residuals=swept.residuals,
        stop_reason=str(swept.stop_reason),
    )


def _count_nearest(
    x: npt.NDArray[np.float32],
    y: npt.NDArray[np.float32],
    weight: npt.NDArray[np.float32],
    density: npt.NDArray[np.float32],
) -> None:
    """Add the weights to the HR pixels nearest to the points, in place."""
    height, width = density.shape
    inside = (weight > 0) & (x > -0.5) & (y > -0.5) & (x < width - 0.5) & (y < height - 0.5)
    rows, columns = np.rint(y[inside]).astype(int), np.rint(x[inside]).astype(int)
    np.add.at(density, (rows, columns), weight[inside])


def _view_report(
    view: RegisteredView,
    flags: npt.NDArray[np.uint8],
    weight: GreyImage,
    misfit: float,
) -> ViewReport:
    rejections = count_rejections(flags)
    return ViewReport(
        view_id=view.view_id,
        registered_fraction=1 - rejections["no_motion"] / flags.size,
        verified_fraction=1 - np.count_nonzero(flags) / flags.size,
        weight_fraction=cv2.mean(weight)[0],
        rejections=rejections,
        median_absolute_weight=median_magnitude(some_rows(view.registration_weights)),
        residual_rms=misfit,
    )


def _report_alone(target: str, settings: Settings) -> TargetReport:
    """Return the report of a target that was made of itself alone."""
    own = 100.0 / (settings.grid.magnification_x * settings.grid.magnification_y)
    return TargetReport(
        view_id=target,
        views=(),
        phase_coverage=own,
        phase_coverage_reference=own,
        remark="No other view was looked at.",
        solver=settings.solver,
        iterations=0,
        stop_reason="alone",
        residuals=(),
        start=StartChoice(warm_share=0.0, is_cut=False),
    )


def _remark(
    reports: Sequence[ViewReport], registered: Sequence[RegisteredView], gained: float
) -> str:
    """Return a plain sentence about what the other views bring; empty where all is well."""
    others = [
        report for report, view in zip(reports, registered, strict=True) if not view.is_reference
    ]
    if not others:
        return "Only the reference view itself was used."
    blind = [report.view_id for report in others if report.verified_fraction < SEES_NOTHING]
    sentences = []
    if len(blind) == len(others):
        return "No other view sees what this one sees: the result is that of one view."
    if blind:
        sentences.append(f"Nothing of {', '.join(blind)} could be verified.")
    if gained < NOTHING_NEW:
        sentences.append(
            "The other views bring hardly any new sub-pixel positions: they average noise, "
            "but add no detail."
        )
    return " ".join(sentences)


def _layers_of(
    prepared: Mapping[str, PreparedView], method: RegistrationMethod
) -> dict[str, npt.NDArray[np.int32]]:
    """Return the depth layer of every pixel of every view, for pictures."""
    labels = {}
    for view_id, view in prepared.items():
        nearness = view.fine.nearness
        labels[view_id] = layer_labels(
            nearness, layer_thresholds(nearness, method.num_layers or PICTURE_LAYERS)
        )
    return labels


def _chroma(
    frame: MultiViewFrame,
    settings: Settings,
    target: str,
    sources: Sequence[str],
    psf: Psf,
) -> ChromaImage | None:
    """Return the colour of a reference view on the HR grid, None for grey input.

    "bicubic" enlarges it; "sr" super-resolves each of its two planes as if it were luma.
    """
    view = frame.view(target)
    if view.chroma is None:
        return None
    if settings.chroma == "bicubic":
        enlarged = [
            initial_estimate(np.ascontiguousarray(view.chroma[..., plane]), settings.grid)
            for plane in range(2)
        ]
        picture = interleaved(enlarged)
        return np.clip(picture, 0.0, 255.0, out=picture)
    planes = []
    for plane in range(2):
        views = tuple(
            replace(other, luma=np.ascontiguousarray(other.chroma[..., plane]), chroma=None)
            for other in frame.views
            if other.chroma is not None
        )
        result = superresolve(
            replace(frame, views=views), replace(settings, noise_sigma=None, filters="none"),
            targets=(target,), observed_views=tuple(sources), psf=psf,
        )  # fmt: skip
        planes.append(result.images[target].luma)
    return np.stack(planes, axis=-1)


def _unused(settings: Settings, method: RegistrationMethod) -> tuple[str, ...]:
    """Return what was asked for and has no effect beside the other settings."""
    is_cut = settings.layers is not None or settings.subregions is not None
    is_fused = settings.solver == Solver.FUSED
    said = {
        f"--layers and --subregions have no effect on --registration {settings.registration}, "
        "which cuts windows; they shape the methods a to l":
            is_cut and method.layout is not Layout.STRIPS,
        "--sweeps has no effect on --solver fused": is_fused and settings.sweeps != Settings.sweeps,
        f"--residual-bound has no effect on --solver {settings.solver}":
            settings.residual_bound is not None and settings.solver != Solver.POCS,
        "--psf-per-layer has no effect without --psf auto":
            settings.psf_per_layer and settings.psf != "auto",
        "--rate has no effect without --realtime":
            settings.rate is not None and not settings.realtime,
    }  # fmt: skip
    return tuple(text for text, is_so in said.items() if is_so)


def _warnings(frame: MultiViewFrame, sources: Sequence[str]) -> tuple[str, ...]:
    """Return what the user should know of this frame's input."""
    warnings = []
    for view_id in sources:
        view = frame.view(view_id)
        depth = None if view.depth_map is None else _two_values(view.depth_map)
        if view.depth_map is None:
            warnings.append(f"view {view_id} has no depth: it is taken as one layer")
        elif depth is None:
            warnings.append(f"view {view_id}: all of its depth is unknown; taken as one layer")
        elif depth[0] == depth[1]:
            warnings.append(f"view {view_id}: its depth is constant, one layer")
        luma = _two_values(view.luma)
        if luma is not None and luma[0] == luma[1]:
            warnings.append(f"view {view_id} is one flat tone: it brings nothing")
    return tuple(warnings)


def _two_values(image: GreyImage) -> tuple[float, float] | None:
    """Return known values of an image, unequal ones if it has any; None where none is known."""
    found = None
    # nearly always, a few of its pixels tell
    for some in (image[::16, ::16], image):
        known = some[np.isfinite(some)]
        if known.size:
            found = float(known.min()), float(known.max())
            if found[0] < found[1]:
                break
    return found
