"""The second half of the work on a frame: its targets made of the views registered onto them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pipeline.config import Settings, Solver
from pipeline.errors import Interrupted
from pipeline.frames import GreyImage, MultiViewFrame, RegisteredView
from pipeline.reconstruction.again import fuse_again
from pipeline.reconstruction.coverage import nothing_filled, phase_coverage
from pipeline.reconstruction.fused import (
    FusedResult,
    estimate_alone,
    finished,
    fuse,
    initial_estimate,
    landing_points,
    left_over,
    some_rows,
)
from pipeline.reconstruction.learned import LearnedFilters
from pipeline.reconstruction.pocs import pocs
from pipeline.reconstruction.psf import Psf, psf_axes, sampling_taps
from pipeline.reconstruction.system import NUM_BANDS
from pipeline.registration.records import ViewRegistration
from pipeline.results import (
    Colour,
    FrameReport,
    FrameResult,
    StartChoice,
    SuperResolvedImage,
    TargetDebug,
    TargetReport,
    WholeColour,
)
from pipeline.superresolve.account import (
    remark_of,
    unused_settings,
    view_report,
    warnings_of,
)
from pipeline.superresolve.choices import (
    chosen_filters,
    chosen_method,
    default_residual_threshold,
)
from pipeline.superresolve.colours import EnlargedColour
from pipeline.superresolve.due import frames_solved, parts_due, tuning_of
from pipeline.superresolve.memory import Memory, Solved
from pipeline.superresolve.register import register_frame
from pipeline.superresolve.registered import RegisteredFrame
from pipeline.superresolve.stages import Stages
from pipeline.temporal.initial import warped
from pipeline.threads import map_threads, stoppable


@dataclass(frozen=True, kw_only=True)
class _Target:
    """One reconstructed reference view."""

    image: SuperResolvedImage
    report: TargetReport
    debug: TargetDebug | None
    solved: Solved


def reconstruct_frame(
    registered: RegisteredFrame,
    *,
    stop: Callable[[], bool] | None = None,
    memory: Memory | None = None,
) -> FrameResult:
    """Do the second half of :func:`superresolve`: the images of a registered frame."""
    frame, settings, psf = registered.frame, registered.settings, registered.psf
    clock = Stages(stop)

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
            images[target] = replace(
                images[target], colour=colour_of(frame, settings, target, registered.sources, psf)
            )
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
        timings={**registered.timings, **clock.timings},
        warnings=(
            *warnings_of(frame, registered.sources),
            *unused_settings(settings, chosen_method(settings)),
        ),
    )
    debug = {result.image.view_id: result.debug for result in results if result.debug is not None}
    return FrameResult(frame_index=frame.frame_index, images=images, report=report, debug=debug)


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
    residual_threshold = settings.residual_threshold or default_residual_threshold(frame.noise)
    learned = chosen_filters(settings, frame.psf, frame.noise)
    start = due = shown = None
    choice = StartChoice(warm_share=0.0, is_cut=frame.is_cut, has_moved=frame.has_moved)
    if previous is not None:
        match = frame.matches[target]
        cold = estimate_alone(
            reference.luma, grid, frame.psf, frame.noise, learned,
            ~match.matched_pixels(frame.frame.lr_shape),
        )  # fmt: skip
        start = warped(match, previous.result.estimate, cold, grid)
        choice = match.choice
        previous = _of_views(previous, registered)
        due = parts_due(frame, target, previous)
    if due is None:
        registrations = [one for one in registrations if one.registered.view_id in frame.near]
        registered = [registration.registered for registration in registrations]
    views = tuple(view.view_id for view in registered)
    if previous is not None and start is not None and due is not None:
        shown = previous.shown, [box for part in due for box in part.boxes], grid
        solved = fuse_again(
            registered, grid, frame.psf, previous.result, start, due,
            residual_threshold=residual_threshold, most_steps=frame.effort.steps, stop=stop,
        )  # fmt: skip
    else:
        solved = _solve(frame, target, registered, start, learned, residual_threshold, stop)
    if stop is not None and stop():
        raise Interrupted
    luma = finished(solved, learned, shown)
    # what the solver made is kept as it is
    luma = np.clip(luma, 0.0, 255.0, out=None if luma is solved.estimate else luma)
    kept = Solved(
        result=solved, shown=luma, views=views,
        frames=frames_solved(frame, target, previous, due),
    )  # fmt: skip
    return _Target(
        image=SuperResolvedImage(view_id=target, luma=luma),
        report=_report(frame, target, registered, solved, choice),
        debug=None if frame.layers is None else _debug(target, registrations, solved, frame.layers),
        solved=kept,
    )


def _report(
    frame: RegisteredFrame,
    target: str,
    registered: Sequence[RegisteredView],
    solved: FusedResult,
    start: StartChoice,
) -> TargetReport:
    """Return what is said of a target that is made of these views."""
    own_phases, all_phases = solved.phases or _phases(frame, registered, solved)
    reports = tuple(
        view_report(view, flags, weight, misfit)
        for view, flags, weight, misfit in zip(
            registered, solved.flags, solved.weights, solved.misfits, strict=True
        )
    )
    return TargetReport(
        view_id=target,
        views=reports,
        phase_coverage=100 * all_phases,
        phase_coverage_reference=100 * own_phases,
        remark=remark_of(reports, registered, 100 * (all_phases - own_phases)),
        solver=frame.settings.solver,
        iterations=solved.iterations,
        stop_reason=solved.stop_reason,
        residuals=solved.residuals,
        start=start,
    )


def _phases(
    frame: RegisteredFrame, registered: Sequence[RegisteredView], solved: FusedResult
) -> tuple[float, float]:
    """Return which share of a target's phases its own trusted pixels fill, and all views'."""
    grid, lr_shape = frame.settings.grid, frame.frame.lr_shape
    filled = nothing_filled(grid, lr_shape)
    own_phases, all_phases = (
        phase_coverage(
            [view.position for view in registered if view.is_reference == is_own],
            [
                flags == 0
                for view, flags in zip(registered, solved.flags, strict=True)
                if view.is_reference == is_own
            ],
            grid, lr_shape, filled=filled,
        )
        for is_own in (True, False)
    )  # fmt: skip
    return own_phases, all_phases


def _debug(
    target: str,
    registrations: Sequence[ViewRegistration],
    solved: FusedResult,
    layers: Mapping[str, npt.NDArray[np.int32]],
) -> TargetDebug:
    """Return what pictures of a target are drawn from."""
    return TargetDebug(
        view_id=target,
        registered=tuple(
            replace(one.registered, flags=flags)
            for one, flags in zip(registrations, solved.flags, strict=True)
        ),
        weights=solved.weights,
        patch_labels={one.registered.view_id: one.patch_labels for one in registrations},
        layer_labels=layers,
        contribution_count=solved.density,
    )


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


def _solve(
    frame: RegisteredFrame,
    target: str,
    registered: Sequence[RegisteredView],
    start: GreyImage | None,
    learned: LearnedFilters | None,
    residual_threshold: float,
    stop: Callable[[], bool] | None,
) -> FusedResult:
    """Run the chosen solver over a whole target."""
    settings, steps = frame.settings, frame.effort.steps
    if settings.solver != Solver.FUSED:
        return _solve_by_pocs(frame, registered, start, residual_threshold, stop)
    begun = frame.begun[target]() if start is None and target in frame.begun else None
    # several targets go side by side, so that their bands do not
    is_one_band = len(frame.targets) > 1
    return fuse(
        registered, settings.grid, frame.frame.lr_shape, frame.psf, noise=frame.noise,
        residual_threshold=residual_threshold, stop=stop, start=start, begun=begun,
        tuning=tuning_of(frame, len(registered), start), learned=learned, most_steps=steps,
        most_bands=1 if is_one_band else NUM_BANDS,
    )  # fmt: skip


def _solve_by_pocs(
    frame: RegisteredFrame,
    registered: Sequence[RegisteredView],
    start: GreyImage | None,
    residual_threshold: float,
    stop: Callable[[], bool] | None,
) -> FusedResult:
    """Run one of the thesis' solvers; its result is brought into the form of the fused one's."""
    settings, grid, psf, steps = frame.settings, frame.settings.grid, frame.psf, frame.effort.steps
    own = next(view for view in registered if view.is_reference)
    shape = grid.hr_shape(frame.frame.lr_shape)
    bound = 2 * frame.noise if settings.residual_bound is None else settings.residual_bound
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


def colour_of(
    frame: MultiViewFrame,
    settings: Settings,
    target: str,
    sources: Sequence[str],
    psf: Psf,
) -> Colour | None:
    """Return the colour of a reference view on the HR grid, None for grey input.

    "bicubic" enlarges it; "sr" super-resolves each of its two planes as if it were luma.
    """
    view = frame.view(target)
    if view.chroma is None:
        return None
    if settings.chroma == "bicubic":
        return EnlargedColour(chroma=view.chroma, grid=settings.grid)
    planes = []
    for plane in range(2):
        views = tuple(
            replace(other, luma=np.ascontiguousarray(other.chroma[..., plane]), chroma=None)
            for other in frame.views
            if other.chroma is not None
        )
        registered = register_frame(
            replace(frame, views=views), replace(settings, noise_sigma=None, filters="none"),
            targets=(target,), observed_views=tuple(sources), psf=psf,
        )  # fmt: skip
        result = reconstruct_frame(registered)
        planes.append(result.images[target].luma)
    return WholeColour(chroma=np.stack(planes, axis=-1))
