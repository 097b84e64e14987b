"""Reconstructing a reference view again: only the parts of it that are due."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, Mask, RegisteredView
from pipeline.grid import Grid
from pipeline.reconstruction.boxes import SolvedBox, solved_box
from pipeline.reconstruction.fused import (
    FusedResult,
    FusedTuning,
    left_over,
    some_landing_points,
)
from pipeline.reconstruction.learned import LearnedFilters
from pipeline.reconstruction.parts import (
    Box,
    Uncut,
    covering_boxes,
    landing_in,
    on_hr_grid,
    put_back,
    put_pixels,
    widened,
    within,
)
from pipeline.reconstruction.psf import Psf, sampling_taps
from pipeline.reconstruction.system import NOTHING, NUM_BANDS, HrImage
from pipeline.threads import map_threads

BAND_PIXELS = 40_000
"""Of a box, for each band of rows that it is divided into, LR pixels."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Due:
    """Pixels of a reference view that are reconstructed again."""

    wanted: Mask
    """(H, W), LR pixels."""
    noise: float
    """Standard deviation, grey levels."""
    tuning: FusedTuning
    views: tuple[str, ...] | None = None
    """Ids of those that they are made of, the reference among them; None: all."""

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


@dataclass(frozen=True, kw_only=True, eq=False)
class Piece:
    """A box of what is due, solved."""

    box: Box
    wanted: Mask
    """(H, W): the pixels of the whole that are due."""
    inner: Box
    """Where the box lies in what was solved, LR pixels."""
    grid: Grid
    of: SolvedBox
    """What was solved: the box and what lies around it."""
    shown: HrImage
    """The same finished, without what lies around the box, where that was asked for."""

    def put_into(self, image: HrImage, part: HrImage) -> None:
        """Write of what was solved, or told with it, the pixels that are due, in place."""
        put_pixels(image, part, self.wanted, self.box, self.grid, self.inner)

    def show_in(self, image: HrImage) -> None:
        """Write of what is shown the pixels that are due, in place."""
        put_pixels(image, self.shown, self.wanted, self.box, self.grid, is_clipped=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Again:
    """A reference view of which parts are solved again."""

    due: Sequence[Due]
    """Disjoint parts."""
    registered: Sequence[RegisteredView]
    start: HrImage
    """(K·H, K·W) float32: initial estimate."""
    offsets: Sequence[GreyImage] | None = None
    """(H, W) float32 each: what is taken off the pixels observed of each view registered, grey
    levels."""


def pieces_of(
    references: Sequence[Again],
    grid: Grid,
    psf: Psf,
    *,
    residual_threshold: float,
    most_steps: int | None = None,
    is_shown: bool = False,
    learned: LearnedFilters | None = None,
    stop: Callable[[], bool] | None = None,
) -> list[list[Piece]]:
    """Return the boxes of what is due of each; parameters are those of :func:`fuse_again`.

    All are solved side by side, the largest first. Small ones are not divided further: a band
    computes rows of its neighbours, too.

    Parameters
    ----------
    is_shown : bool
        Whether they are to be finished, by the ``learned`` filters if there are any.
    """

    def solve(item: tuple[Again, Due, Box, Uncut, npt.NDArray[np.int64]]) -> Piece:
        again, part, box, uncut, places = item
        wide = widened(box, part.wanted.shape)
        some = [
            index
            for index, view in enumerate(again.registered)
            if part.views is None or view.view_id in part.views
        ]
        inner = within(box, wide)
        height, width = (side.stop - side.start for side in wide)
        found = solved_box(
            uncut, places, some, wide, grid, psf, noise=part.noise,
            residual_threshold=residual_threshold, tuning=part.tuning,
            start=np.ascontiguousarray(again.start[on_hr_grid(wide, grid)]),
            most_steps=most_steps,
            most_bands=max(1, min(NUM_BANDS, height * width // BAND_PIXELS)), stop=stop,
        )  # fmt: skip
        return Piece(
            box=box, wanted=part.wanted, inner=inner, grid=grid, of=found,
            shown=_shown(found.solved, learned, on_hr_grid(inner, grid)) if is_shown else NOTHING,
        )  # fmt: skip

    def boxes_of(again: Again) -> list[tuple[Again, Due, Box, Uncut, npt.NDArray[np.int64]]]:
        boxes = [(part, box) for part in again.due for box in part.boxes]
        uncut = Uncut(again.registered, again.offsets)
        places = landing_in(uncut, [widened(box, part.wanted.shape) for part, box in boxes])
        return [(again, *one, uncut, there) for one, there in zip(boxes, places, strict=True)]

    found = map_threads(boxes_of, references)
    items = [item for items in found for item in items]
    # what takes longest comes first, so that no thread is left with it at the end
    order = sorted(range(len(items)), key=lambda number: -_work(*items[number][1:3]))
    solved = dict(zip(order, map_threads(solve, [items[k] for k in order]), strict=True))
    numbers = iter(range(len(items)))
    return [[solved[next(numbers)] for _ in ones] for ones in found]


def _shown(solved: FusedResult, learned: LearnedFilters | None, inner: Box) -> HrImage:
    """Return some HR pixels of what was solved, finished."""
    if learned is None:
        return solved.estimate[inner]
    return learned.finished(solved.estimate, solved.density, inner)


def _work(part: Due, box: Box) -> int:
    """Return about how long a box takes."""
    height, width = (side.stop - side.start for side in widened(box, part.wanted.shape))
    return height * width * part.tuning.together


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
    (pieces,) = pieces_of(
        [Again(due=due, registered=registered, start=start)], grid, psf,
        residual_threshold=residual_threshold, most_steps=most_steps, stop=stop,
    )  # fmt: skip
    for piece in pieces:
        solved = piece.of.solved
        work += solved.iterations * solved.estimate.size
        stop_reason = solved.stop_reason
        piece.put_into(estimate, solved.estimate)
        piece.put_into(density, solved.density)
        for index, place, weight, flag in zip(
            piece.of.views, piece.of.places, solved.weights, solved.flags, strict=True
        ):
            put_back(
                (weight, flag), (weights[index], flags[index]), place, registered[index].position,
                piece.box,
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
        iterations=-(-work // estimate.size),
        residuals=(misfit,),
        stop_reason=stop_reason,
    )
