"""A frame from its views to its images, both halves of the work."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from pipeline.config import Settings, Solver
from pipeline.effort import FULL, Effort
from pipeline.frames import MultiViewFrame
from pipeline.reconstruction.psf import Psf
from pipeline.results import FrameResult
from pipeline.superresolve.memory import Memory
from pipeline.superresolve.reconstruct import reconstruct_frame
from pipeline.superresolve.register import register_frame
from pipeline.superresolve.restore import restore_frame, swift_frame


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
    is_swift = effort.by_depth or (settings.temporal == "swift" and effort.is_full)
    if is_swift and memory is not None:
        is_plain = observed_views is None and not (keep_intermediates or neighbours)
        swift = None
        if is_plain and settings.solver == Solver.FUSED:
            swift = swift_frame(
                frame, settings, targets=targets, psf=psf, stop=stop, memory=memory,
                effort=effort if effort.by_depth else None,
            )  # fmt: skip
        if swift is not None:
            return swift
    if effort.by_depth:
        # where a cut has left no motions, none are found within the frame
        is_lacking = memory is not None and memory.lacks_motions
        effort = replace(effort, by_depth=False) if is_lacking else FULL
    if not effort.registers:
        return restore_frame(
            frame, settings, targets=targets, psf=psf, stop=stop, memory=memory, effort=effort
        )
    registered = register_frame(
        frame, settings, targets=targets, observed_views=observed_views, psf=psf,
        keep_intermediates=keep_intermediates, stop=stop, memory=memory, effort=effort,
        neighbours=neighbours,
    )  # fmt: skip
    return reconstruct_frame(registered, stop=stop, memory=memory)
