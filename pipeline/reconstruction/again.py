"""Reconstructing a reference view again: only the parts of it that are due."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.frames import Mask, RegisteredView
from pipeline.grid import Grid
from pipeline.reconstruction.fused import (
    FusedResult,
    FusedTuning,
    fuse,
    left_over,
    some_landing_points,
)
from pipeline.reconstruction.parts import (
    Box,
    covering_boxes,
    cut_views,
    on_hr_grid,
    put_back,
    widened,
    within,
)
from pipeline.reconstruction.psf import Psf, sampling_taps
from pipeline.reconstruction.system import HrImage


@dataclass(frozen=True, kw_only=True, eq=False)
class Due:
    """Pixels of a reference view that are reconstructed again."""

    wanted: Mask
    """(H, W), LR pixels."""
    noise: float
    """Standard deviation, grey levels."""
    tuning: FusedTuning

    @functools.cached_property
    def boxes(self) -> list[Box]:
        """What is solved, without halos."""
        return covering_boxes(self.wanted)

    @property
    def share(self) -> float:
        """Pixels that are solved, halos included, over all."""
        shape = self.wanted.shape
        areas = [
            (rows.stop - rows.start) * (columns.stop - columns.start)
            for rows, columns in (widened(box, shape) for box in self.boxes)
        ]
        return sum(areas) / self.wanted.size


def fuse_again(
    registered: Sequence[RegisteredView],
    grid: Grid,
    psf: Psf,
    before: FusedResult,
    start: HrImage,
    due: Sequence[Due],
    *,
    residual_threshold: float,
    most_steps: int | None = None,
    stop: Callable[[], bool] | None = None,
) -> FusedResult:
    """Return what :func:`fused.fuse` gives, made anew where it is due and else as it was.

    Its ``iterations`` are those of a pixel in the mean, rounded up.

    Parameters
    ----------
    before : FusedResult
        Of the previous frame, of the same views.
    start : (K·H, K·W) float32
        Initial estimate; what is not due keeps that of ``before``.
    due : sequence of Due
        Disjoint parts.
    """
    estimate, density = before.estimate.copy(), before.density.copy()
    weights = tuple(array.copy() for array in before.weights)
    flags = tuple(array.copy() for array in before.flags)
    work, stop_reason = 0, before.stop_reason
    for part in due:
        wides = [widened(box, part.wanted.shape) for box in part.boxes]
        for box, wide, cut in zip(part.boxes, wides, cut_views(registered, wides), strict=True):
            fine = on_hr_grid(wide, grid)
            height, width = (side.stop - side.start for side in wide)
            solved = fuse(
                cut.views, grid, (height, width), psf, noise=part.noise,
                residual_threshold=residual_threshold, tuning=part.tuning,
                start=np.ascontiguousarray(start[fine]),
                most_steps=most_steps, judged=False, stop=stop,
            )  # fmt: skip
            work += solved.iterations * height * width
            stop_reason = solved.stop_reason
            inside = np.zeros((height, width), bool)
            inside[within(box, wide)] = part.wanted[box]
            inside = inside.repeat(grid.magnification_y, 0).repeat(grid.magnification_x, 1)
            np.copyto(estimate[fine], solved.estimate, where=inside)
            np.copyto(density[fine], solved.density, where=inside)
            for index, (view, place) in enumerate(zip(registered, cut.places, strict=True)):
                put_back(
                    (solved.weights[index], solved.flags[index]), (weights[index], flags[index]),
                    place, view.position, box,
                )  # fmt: skip
    points = [some_landing_points(view, grid) for view in registered]
    misfit, misfits = left_over(
        estimate, sampling_taps(psf, grid), points, registered, flags, weights
    )
    return FusedResult(
        estimate=estimate,
        weights=weights,
        flags=flags,
        misfits=misfits,
        density=density,
        iterations=-(-work // registered[0].flags.size),
        residuals=(misfit,),
        stop_reason=stop_reason,
    )
