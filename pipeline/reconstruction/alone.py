"""A view made of itself alone, and only what has changed of it: the quickest way to a picture."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, Mask, RegisteredView
from pipeline.grid import Grid
from pipeline.reconstruction.again import Due, pieces_of
from pipeline.reconstruction.fused import estimate_alone, parts_alone
from pipeline.reconstruction.learned import LearnedFilters
from pipeline.reconstruction.parts import covering_boxes, put_pixels
from pipeline.reconstruction.psf import Psf
from pipeline.reconstruction.system import HrImage
from pipeline.temporal.still import Still


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
    again: Mask | None = None
    """(H, W): what all views have made of it in this frame; None: nothing."""


def restored(
    still: Still,
    before: Restored | None,
    grid: Grid,
    psf: Psf,
    noise: float,
    learned: LearnedFilters | None,
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
    """
    mean, count = still.mean, still.count
    if before is None:
        estimate = estimate_alone(mean, grid, psf, noise, learned)
        return Restored(estimate=estimate, shown=np.clip(estimate, 0.0, 255.0), frames=count.copy())
    wanted = still.touched | (count >= 2 * before.frames)
    boxes = covering_boxes(wanted)
    estimate, shown, frames = before.estimate, before.shown.copy(), before.frames.copy()
    parts = parts_alone(mean, grid, psf, noise, learned, boxes)
    for box, part in zip(boxes, parts, strict=True):
        put_pixels(estimate, part, wanted[box], box, grid)
        put_pixels(shown, np.clip(part, 0.0, 255.0), wanted[box], box, grid)
    np.copyto(frames, count, where=wanted)
    return Restored(estimate=estimate, shown=shown, frames=frames)


def refreshed(
    made: Restored,
    due: Sequence[Due],
    registered: Sequence[RegisteredView],
    grid: Grid,
    psf: Psf,
    learned: LearnedFilters | None,
    *,
    residual_threshold: float,
    offsets: Sequence[GreyImage] | None = None,
    most_steps: int | None = None,
    stop: Callable[[], bool] | None = None,
) -> Restored:
    """Return a view restored of which parts are made of all views; it is changed in place.

    Parameters
    ----------
    due : sequence of Due
        Disjoint parts.
    registered : sequence of RegisteredView
        All views, itself among them.
    offsets : sequence of (H, W) float32, optional
        What is taken off the pixels observed of each, grey levels.
    """
    again = np.zeros(made.frames.shape, np.bool_)
    for piece in pieces_of(
        due, registered, grid, psf, made.estimate, is_shown=True, learned=learned,
        offsets=offsets, residual_threshold=residual_threshold, most_steps=most_steps, stop=stop,
    ):  # fmt: skip
        piece.put_into(made.estimate, piece.solved.estimate)
        piece.put_into(made.shown, piece.shown)
    for part in due:
        again |= part.wanted
    np.copyto(made.frames, np.float32(np.inf), where=again)
    return replace(made, again=again)
