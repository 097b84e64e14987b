"""The motions of windows: each pixel sampled once, windows put together from their cells.

What a fit needs of the pixels that a patch owns is 35 sums. The window of a patch is its own
cell and, less weighted, the cells next to it whose patches move alike, so that every pixel is
sampled once an iteration however much the windows overlap; patches that have come to rest are
neither sampled nor moved again. See :mod:`window_kernels`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.registration import window_kernels
from pipeline.registration.kernels import TOO_FEW
from pipeline.registration.motions import (
    FitPrior,
    FittedMotions,
    Motions,
    Pass,
    least_scale,
)
from pipeline.registration.patches import Windows
from pipeline.registration.prepare import Level, PreparedView
from pipeline.threads import map_threads, shares

BESIDE, ACROSS = 0.46, 0.21
"""Weights of the cells at the four sides and at the four corners: the shares of them that a
window of 24 pixels covers."""

FARTHEST = 0.1
"""Difference of two patches' motions from which they are of different surfaces, LR pixels."""

AT_REST = 0.05
"""A patch has come to rest where no point of its window moves more, pixels of the level."""

NUM_SUMS = 35

Chosen = npt.NDArray[np.bool_]
"""(P,): some of the patches."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Samples:
    """The reference where the owners' motions send each pixel; zero where nothing was sampled."""

    residual: npt.NDArray[np.float32]
    """(H, W): reference − source + ζ, grey levels; a million outside the reference."""
    gradient_x: npt.NDArray[np.float32]
    """(H, W), grey levels an LR pixel."""
    gradient_y: npt.NDArray[np.float32]
    move_u: npt.NDArray[np.float32]
    """(H, W): displacement by the owner, LR pixels."""
    move_v: npt.NDArray[np.float32]

    @property
    def planes(self) -> tuple[npt.NDArray[np.float32], ...]:
        """All of them, in the order in which the kernels take them."""
        return self.residual, self.gradient_x, self.gradient_y, self.move_u, self.move_v


def no_samples(shape: tuple[int, ...]) -> Samples:
    """Return samples yet to be taken."""
    residual, gradient_x, gradient_y, move_u, move_v = (
        np.zeros(shape, np.float32) for _ in range(5)
    )
    return Samples(
        residual=residual, gradient_x=gradient_x, gradient_y=gradient_y, move_u=move_u,
        move_v=move_v,
    )  # fmt: skip


def windows_of(fitted: FittedMotions) -> Windows:
    """Return the patches of motions that are those of windows; TypeError where they are not."""
    if not isinstance(fitted.patches, Windows):
        raise TypeError("these motions are of strips, not of windows")
    return fitted.patches


def around(patches: Windows, chosen: Chosen, rings: int = 1) -> Chosen:
    """Return the patches of the cells of those chosen, and of so many rings of cells around."""
    cells = np.zeros(patches.grid, np.uint8)
    cells.flat[patches.cell[chosen]] = 1
    if rings:
        cells = cv2.dilate(cells, np.ones((2 * rings + 1, 2 * rings + 1), np.uint8))
    return cells.ravel()[patches.cell] > 0


def fit_windows(
    source: PreparedView,
    reference: PreparedView,
    patches: Windows,
    start: Motions,
    passes: Sequence[Pass],
    prior: FitPrior,
    directions: npt.NDArray[np.float64],
    *,
    noise: float,
    min_support: int,
    before: tuple[FittedMotions, Chosen] | None = None,
) -> tuple[FittedMotions, Samples]:
    """Return the affine motions of windows, refined from their start by robust Gauss–Newton.

    Parameters
    ----------
    start : (P, 13) float64
        Not modified.
    passes : sequence of Pass
        Coarse to fine; levels that the pyramid lacks are left out.
    directions : (P, 2) float64
        Unit vectors along which ``prior.along`` holds.
    noise : float
        Grey levels; the robust scale is kept above a share of it.
    min_support : int
        Fewest LR pixels of a patch.
    before : (motions, patches to fit), optional
        Where only some patches are fitted: what is known of all. The others are not sampled:
        their sums are those of the frame in which they were.

    Returns
    -------
    motions : FittedMotions
    samples : Samples
        At these motions, where the last pass took every pixel; of the patches fitted.
    """
    count = len(patches.windows)
    motion, stepped = start.copy(), start.copy()
    precision = prior.precision(directions)
    status = np.full(count, TOO_FEW, np.int32)
    scale = np.full(count, np.inf, np.float32)
    reliable = np.zeros(count, np.float32)
    chosen = np.ones(count, bool)
    moved = np.zeros(count, np.float32)
    sums = kept_sums = np.zeros((count, NUM_SUMS))
    if before is not None:
        known, chosen = before
        status, scale, reliable = known.status.copy(), known.scale.copy(), known.reliable.copy()
        if known.sums is not None:
            kept_sums = known.sums
    first = patches.first
    samples = no_samples((0, 0))
    for run in passes:
        at, onto = source.level(run.level), reference.level(run.level)
        if at is None or onto is None:
            continue
        finer = 2**run.level
        pitch = run.stride * finer
        samples = no_samples(at.image.shape if pitch == 1 else (0, 0))
        due = chosen
        sums = kept_sums / pitch**2
        for _ in range(run.iterations):
            _sum_up(
                at, onto, run.stride, finer, patches, motion, due, least_scale(noise, run.level),
                scale, sums, samples,
            )  # fmt: skip
            window_kernels.step_windows(
                sums, first, *patches.grid, patches.windows, motion, start, precision,
                prior.linear, prior.offset_mean, prior.offset_sigma**-2,
                max(int(0.5 * min_support / pitch**2), 1), BESIDE, ACROSS, FARTHEST * finer,
                due, moved, status, reliable, stepped,
            )  # fmt: skip
            motion, stepped = stepped, motion
            due = moved > AT_REST * finer
            if not due.any():
                break
    if samples.residual.size:
        window_kernels.move_samples(patches.cells, chosen, patches.owners, patches.windows,
            motion, *samples.planes)  # fmt: skip
    fitted = FittedMotions(
        patches=patches, motion=motion, status=status, scale=scale, reliable=reliable, sums=sums
    )
    return fitted, samples


def take_samples(
    source: PreparedView, reference: PreparedView, patches: Windows, motion: Motions
) -> Samples:
    """Return the samples of every pixel at given motions."""
    at, onto = source.fine, reference.fine
    count = len(patches.windows)
    samples = no_samples(at.image.shape)
    _sum_up(
        at, onto, 1, 1, patches, motion, np.ones(count, bool), 1.0, np.ones(count, np.float32),
        np.zeros((count, NUM_SUMS)), samples,
    )  # fmt: skip
    return samples


def _sum_up(
    at: Level, onto: Level, stride: int, finer: int, patches: Windows, motion: Motions, due: Chosen,
    smallest_scale: float, scale: npt.NDArray[np.float32], sums: npt.NDArray[np.float64],
    samples: Samples,
) -> None:  # fmt: skip
    """Do what :func:`window_kernels.sum_cells` does, a share of what is due on each thread."""
    numbers = np.flatnonzero(due)

    def sum_up(share: slice) -> None:
        part = np.zeros_like(due)
        part[numbers[share]] = True
        window_kernels.sum_cells(
            at.image, at.gradient_x, at.gradient_y, onto.coefficients, stride, finer,
            patches.owners, patches.cells, patches.windows, motion, part, smallest_scale, scale,
            sums, *samples.planes,
        )  # fmt: skip

    map_threads(sum_up, shares(numbers.size))
