"""A box of a reference view, solved from what lands in it of each view registered.

What :func:`fused.fuse` does with views and a start, in fewer and longer calls, and so that what is
cut out of a view is still in the processor's cache when it is predicted and weighed.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import OPTIONS
from pipeline.grid import Grid
from pipeline.reconstruction import agreement, kernels
from pipeline.reconstruction.fused import (
    SMALLEST_NOISE,
    FusedResult,
    FusedTuning,
    agreement_terms,
    descended,
    equations_of,
    fuse,
    local_strength,
)
from pipeline.reconstruction.parts import Box, Flags, Uncut, cut_rows, cut_views
from pipeline.reconstruction.psf import Psf, sampling_taps
from pipeline.reconstruction.system import HrImage, spline_coefficients
from pipeline.reconstruction.tables import Table, bytes_at, floats_at

X, Y, BEYOND, WEIGHT, OBSERVED = range(5)
"""Of the numbers of a view's pixels: in the order of a table's images, see ``kernels.FLAGS``."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SolvedBox:
    """A box, solved, and of what."""

    solved: FusedResult
    """Its weights and flags are those of what was taken of the views; it is not judged."""
    views: Sequence[int]
    """Places of these among those registered."""
    places: Sequence[Box]
    """Rows and columns that were taken of each."""


def solved_box(
    uncut: Uncut,
    places: npt.NDArray[np.int64],
    views: Sequence[int],
    box: Box,
    grid: Grid,
    psf: Psf,
    *,
    noise: float,
    residual_threshold: float,
    tuning: FusedTuning,
    start: HrImage,
    most_steps: int | None = None,
    most_bands: int,
    stop: Callable[[], bool] | None = None,
) -> SolvedBox:
    """Return a box solved; other parameters are those of :func:`fused.fuse`.

    Parameters
    ----------
    places : (views, 4) int64
        Of :func:`parts.landing_in`, of that box.
    views : sequence of int
        Of those registered, those that it is made of.
    start : (K·h, K·w) float32
        Initial estimate.
    """
    bounds = places[views].tolist()
    taken = [(slice(top, bottom), slice(left, right)) for top, bottom, left, right in bounds]
    height, width = (side.stop - side.start for side in box)
    if len(views) == 1 or int(tuning.alone / max(noise, SMALLEST_NOISE)) > 0:
        solved = fuse(
            cut_views(uncut, places, views, box, grid), grid, (height, width), psf, noise=noise,
            residual_threshold=residual_threshold, tuning=tuning, start=start,
            most_steps=most_steps, judged=False, most_bands=most_bands, stop=stop,
        )  # fmt: skip
        return SolvedBox(solved=solved, views=views, places=taken)
    noise = max(noise, SMALLEST_NOISE)
    reference = next(
        place for place, index in enumerate(views) if uncut.registered[index].is_reference
    )
    sizes = [(bottom - top) * (right - left) for top, bottom, left, right in bounds]
    starts = list(itertools.accumulate(sizes, initial=0))
    numbers, flags = np.empty((5, starts[-1]), np.float32), np.empty(starts[-1], np.uint8)
    table = _table_of(numbers, flags, bounds, starts)
    taps = sampling_taps(psf, grid)
    _cut_and_weigh(
        uncut.table, np.array(views, np.int64), places, uncut.is_offset,
        np.float32(box[1].start), np.float32(grid.magnification_x), np.float32(grid.offset_x),
        np.float32(box[0].start), np.float32(grid.magnification_y), np.float32(grid.offset_y),
        spline_coefficients(start, taps), table, reference,
        *agreement_terms(noise, len(views) - 1, tuning, residual_threshold), np.ones(len(views)),
    )  # fmt: skip
    first = starts[reference]
    level = float(numbers[OBSERVED, first : first + sizes[reference]].mean())
    local = local_strength(start, grid, noise, tuning)
    system = equations_of(start.shape, grid, psf, level, local, tuning, most_bands)
    system.gather_table(table, start)
    plan, is_stopped = tuning.together, stop is not None and stop()
    estimate = start
    if not is_stopped:
        steps = plan if most_steps is None else min(plan, most_steps)
        estimate = descended(system, start, noise, psf, tuning, steps, tuning.stretch, stop)
    stop_reason = "iterations" if most_steps is None or most_steps >= plan else "steps"
    shapes = [(bottom - top, right - left) for top, bottom, left, right in bounds]
    parts = [
        (slice(at, at + size), shape)
        for at, size, shape in zip(starts, sizes, shapes, strict=False)
    ]
    return SolvedBox(
        solved=FusedResult(
            estimate=estimate,
            weights=tuple(numbers[WEIGHT, part].reshape(shape) for part, shape in parts),
            flags=tuple(flags[part].reshape(shape) for part, shape in parts),
            misfits=(),
            density=system.density,
            iterations=system.steps,
            residuals=(),
            stop_reason="stopped" if is_stopped else stop_reason,
        ),
        views=views,
        places=taken,
    )


def _table_of(
    numbers: npt.NDArray[np.float32],
    flags: Flags,
    bounds: Sequence[Sequence[int]],
    starts: Sequence[int],
) -> Table:
    """Return where the images of parts lie that follow one another, each sort in a piece."""
    table = np.empty((len(bounds), 8), np.int64)
    first, sizes = np.array(starts[:-1], np.int64), np.array(bounds, np.int64)
    plane = numbers.strides[0]
    for number in range(len(numbers)):
        table[:, number] = numbers.ctypes.data + plane * number + numbers.itemsize * first
    table[:, kernels.FLAGS] = flags.ctypes.data + first
    table[:, -2] = sizes[:, 1] - sizes[:, 0]
    table[:, -1] = sizes[:, 3] - sizes[:, 2]
    return table


@njit(**OPTIONS)
def _cut_and_weigh(
    uncut, some, places, is_offset, before, magnification_x, offset_x, above, magnification_y,
    offset_y, coefficients, table, reference, threshold, mark, impossible, largest, low_pass,
    window, expected, tolerated, severity, doubt, agreeing,
):  # fmt: skip
    """Write parts of views, where they land, what is beyond what is predicted, and their weights.

    Rows are predicted as soon as they are cut out, and a view is weighed before the next one.

    Parameters
    ----------
    uncut, some, places, is_offset, before, …, offset_y
        See :func:`parts.cut_rows`.
    coefficients, table, reference, threshold, …, agreeing
        See :func:`kernels.sample_spline` and :func:`agreement.weigh_views`.
    """
    for number in range(some.size):
        x, y = floats_at(table, number, kernels.X), floats_at(table, number, kernels.Y)
        predicted = floats_at(table, number, kernels.VALUE)
        observed = floats_at(table, number, kernels.OBSERVED)
        flags = bytes_at(table, number, kernels.FLAGS)
        height = predicted.shape[0]
        for top in range(0, height, kernels.LANDED):
            bottom = min(top + kernels.LANDED, height)
            cut_rows(
                uncut, some[number], places, is_offset, before, magnification_x, offset_x, above,
                magnification_y, offset_y, top, bottom, x, y, observed, flags,
            )  # fmt: skip
            kernels.sample_spline(coefficients, x, y, top, bottom, predicted)
        if number == reference:
            floats_at(table, number, kernels.WEIGHT)[:] = np.float32(1.0)
        agreement.weigh_views(
            table, number, number + 1, reference, threshold, mark, impossible, largest, low_pass,
            window, expected, tolerated, severity, doubt, agreeing,
        )  # fmt: skip
