"""A view made of itself alone, and only what has changed of it: the quickest way to a picture."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pipeline.frames import Mask
from pipeline.grid import Grid
from pipeline.reconstruction.again import Again, pieces_of
from pipeline.reconstruction.followed import Trust, put_right
from pipeline.reconstruction.fused import SMALLEST_NOISE, estimate_alone, parts_alone
from pipeline.reconstruction.learned import LearnedFilters
from pipeline.reconstruction.parts import covering_boxes, put_pixels
from pipeline.reconstruction.psf import Psf
from pipeline.reconstruction.restoration import Restoration, restoration_of
from pipeline.reconstruction.system import HrImage
from pipeline.temporal.flow import Flow
from pipeline.temporal.still import Still
from pipeline.threads import map_threads


@dataclass(frozen=True, kw_only=True, eq=False)
class Restored:
    """What a frame that was made of its own view leaves to the next one."""

    estimate: HrImage
    """(K·H, K·W) float32, grey levels."""
    shown: HrImage
    """The same, clipped to 0..255, where it was restored; what was shown of it elsewhere."""
    frames: npt.NDArray[np.float32]
    """(H, W): of how many frames the pixels observed were the mean when they were restored;
    infinite where all views had made it."""
    restoration: Restoration | None = None
    """The linear filter that it was restored with; None: it was not."""
    alone: Mask | None = None
    """(H, W): what of it this frame has restored; None: nothing."""
    again: Mask | None = None
    """(H, W): what other views have made of it in this frame; None: nothing."""

    @property
    def waiting(self) -> Mask | None:
        """(H, W): what this frame has restored and no other views have made since."""
        return self.alone if self.alone is None or self.again is None else self.alone & ~self.again


def restored(
    still: Still,
    before: Restored | None,
    grid: Grid,
    psf: Psf,
    noise: float,
    learned: LearnedFilters | None,
    *,
    ripens: bool = True,
) -> Restored:
    """Return a view restored where it has changed, or where its pixels are worth twice as much.

    The estimate is that of ``before``, written over.

    Parameters
    ----------
    still : Still
        The view, averaged over the frames in which it has stood still.
    before : Restored, optional
        The frame before; without it all is restored.
    noise : float
        Standard deviation of a single frame, grey levels.
    ripens : bool
        False: the latter stay as they are.
    """
    mean, count = still.mean, still.count
    restoration = restoration_of(mean, grid, psf, max(noise, SMALLEST_NOISE))
    if before is None:
        estimate = estimate_alone(mean, grid, psf, noise, learned)
        shown = np.clip(estimate, 0.0, 255.0)
        return Restored(
            estimate=estimate, shown=shown, frames=count.copy(), restoration=restoration
        )  # fmt: skip
    wanted = still.touched | (count >= 2 * before.frames) if ripens else still.touched
    boxes = covering_boxes(wanted)
    estimate, shown, frames = before.estimate, before.shown.copy(), before.frames.copy()
    parts = parts_alone(mean, restoration, grid, learned, boxes)
    for box, part in zip(boxes, parts, strict=True):
        part = np.ascontiguousarray(part)
        put_pixels(estimate, part, wanted, box, grid)
        put_pixels(shown, part, wanted, box, grid, is_clipped=True)
    np.copyto(frames, count, where=wanted)
    return Restored(
        estimate=estimate, shown=shown, frames=frames, restoration=restoration, alone=wanted
    )  # fmt: skip


def made_better(
    made: Restored, other: HrImage, flow: Flow, still: Still, grid: Grid, psf: Psf, noise: float,
    trust: Trust,
) -> None:  # fmt: skip
    """Make what has changed of a view that was restored better by another picture, in place.

    Parameters
    ----------
    other : (K·H, K·W) float32
        The other picture.
    flow : (H, W, 2) float32
        Where pixels of the view are in that.
    """
    assert made.restoration is not None  # it was restored
    put_right(
        made.estimate, made.shown, other, flow, still.mean, still.touched, made.restoration, grid,
        psf, max(noise, SMALLEST_NOISE), trust,
    )  # fmt: skip


def refreshed(
    made: Sequence[Restored],
    again: Sequence[Again],
    grid: Grid,
    psf: Psf,
    learned: LearnedFilters | None,
    *,
    residual_threshold: float,
    most_steps: int | None = None,
    stop: Callable[[], bool] | None = None,
) -> list[Restored]:
    """Return views restored of which parts are made of all views; they are changed in place.

    Parameters
    ----------
    again : sequence of Again
        Of each view: of what it starts, and of what views, itself among them.
    """
    pieces = pieces_of(
        again, grid, psf, is_shown=True, learned=learned, residual_threshold=residual_threshold,
        most_steps=most_steps, stop=stop,
    )  # fmt: skip

    def put(number: int) -> Restored:
        view = made[number]
        for piece in pieces[number]:
            piece.put_into(view.estimate, piece.of.solved.estimate)
            piece.show_in(view.shown)
        solved = functools.reduce(np.logical_or, [part.wanted for part in again[number].due])
        np.copyto(view.frames, np.float32(np.inf), where=solved)
        return replace(view, again=solved)

    return map_threads(put, range(len(made)))
