"""Registering a view again: only what has changed since the previous frame.

A fixed rig moves nothing but what moves in front of it. Cells whose pixels, here and where they
land, show what they showed before keep their motion, and their pixels landing point, weight and
verdict. The others are cut and fitted anew, started from the parallax motion of the rig. A few
cells that seem to stand still are probed in every frame: where one has moved it is fitted anew,
where most have the rig itself has, and all is. Where what is fitted anew misfits for the most part,
it is where neither the rig nor its depth maps say, and the view is registered from scratch, if that
does better.

The measurements that chose the constants: docs/experiments.md#warm-frames, and
docs/experiments.md#what-goes-on-dissolving for ``MISFIT``.
"""

from __future__ import annotations

import functools
import math
import statistics
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.frames import Mask
from pipeline.registration import motions, window_kernels
from pipeline.registration.kernels import FITTED, TOO_FEW
from pipeline.registration.method import MotionModel
from pipeline.registration.motions import MIDDLE, FittedMotions, Pass, least_scale
from pipeline.registration.patches import Windows
from pipeline.registration.prepare import PreparedView
from pipeline.registration.records import ViewRegistration
from pipeline.registration.verification import EDGE_REACH
from pipeline.registration.window_fits import (
    ACROSS,
    BESIDE,
    FARTHEST,
    NUM_SUMS,
    Chosen,
    around,
    fit_windows,
    no_samples,
    windows_of,
)
from pipeline.registration.windows import (
    MIN_SUPPORT,
    SPACING,
    WindowFit,
    cut_view,
)

PASSES = (Pass(level=0, iterations=2, stride=2), Pass(level=0, iterations=1))
"""Where a fit is started from the rig's own motion, it is soon there."""

QUIET = 1.0
"""Noise below which it pays to go on, grey levels, …"""

QUIET_PASSES = (Pass(level=0, iterations=3), Pass(level=0, iterations=3))
"""… by so much."""

CHANGE_BOX = 5
"""Side of the box over which the difference of two frames is judged, LR pixels."""

DEPTH_BOX = 25
"""The same for depth maps; …"""

DEPTH_STRIDE = 5
"""… every so many rows and columns of them are looked at."""

CHANGE = 1.5
"""Difference of the smoothed pictures beside the noise that counts as a change, grey levels."""

PROBES = 12
"""Cells that seem to stand still and are probed in a frame."""

DRIFTED = 0.25
"""Displacement from which a probed cell is fitted anew, LR pixels."""

RIG_DRIFTED = 0.1
"""Median displacement of the probes beyond which all is registered anew, LR pixels."""

AGAIN = (1, 3)
"""Frames of a chain in which every cell is fitted anew, from means of twice as many frames and
more: what the first frame was registered by, one noisy picture, would be remembered otherwise."""

MOSTLY = 0.7
"""Share of changed cells from which all is registered anew."""

MISFIT = 1.5
"""Median misfit of the patches fitted anew, times the noise, from which a fit from scratch is
tried, …"""

BETTER = 0.7
"""… which holds where that of the same cells is no more than this share of it; …"""

GROWN = 1.3
"""… where it is more, none is tried again until the misfit has grown by so much."""

FEWEST_FITTED = 8
"""Patches fitted anew below which nothing is said of their misfit."""


Counts = npt.NDArray[np.int32]
"""(H + 1, W + 1): how many pixels of a mask lie above and to the left."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Again:
    """The windows of a view, some of them fitted anew."""

    fit: WindowFit
    fitted: Chosen
    """(P,): patches fitted anew."""
    kept: npt.NDArray[np.int32]
    """(P',): number of each patch of the previous frame in this one, −1 where it is gone."""
    fresh: Mask
    """(rows, columns): their cells."""

    @functools.cached_property
    def misfit(self) -> float:
        """Median robust residual scale of the patches fitted anew, grey levels; 0 of few."""
        if np.count_nonzero(self.fitted) < FEWEST_FITTED:
            return 0.0
        return float(np.median(self.fit.fitted.scale[self.fitted]))

    def misfits(self, noise: float) -> bool:
        """Return whether they misfit for the most part, by more than noise, grey levels, does."""
        return self.misfit > MISFIT * max(noise, QUIET)

    def is_beaten_by(self, scratch: WindowFit) -> bool:
        """Return whether a fit from scratch explains the same cells much better."""
        found = scratch.fitted
        same = self.fresh.ravel()[windows_of(found).cell]
        return float(np.median(found.scale[same])) <= BETTER * self.misfit


def count_changes(
    now: PreparedView, before: PreparedView, noise: float, lagging: Mask | None = None
) -> Counts:
    """Return how many pixels have changed between two frames of a view, in picture or in depth.

    Those that have lagged behind are among them.
    """
    changed = _changed_pixels(now, before, noise)
    if lagging is not None:
        changed |= lagging
    return cv2.integral(changed.astype(np.uint8))


def _changed_pixels(now: PreparedView, before: PreparedView, noise: float) -> Mask:
    fine, old = now.fine, before.fine
    if fine.image.shape != old.image.shape:
        return np.ones(fine.image.shape, bool)
    box = (CHANGE_BOX, CHANGE_BOX)
    difference = fine.image - old.image
    local = cv2.blur(difference * difference, box, borderType=cv2.BORDER_REFLECT)
    # the smoothing before registration lets about a sixth of the noise's power through
    changed = local > 2 * 2.5 * noise**2 / 6 + CHANGE**2
    # depth maps are ragged at edges; only where a surface has another depth has it changed
    some = slice(None, None, DEPTH_STRIDE)
    depth = cv2.absdiff(fine.nearness[some, some], old.nearness[some, some])
    side = DEPTH_BOX // DEPTH_STRIDE
    deeper = cv2.blur(depth, (side, side), borderType=cv2.BORDER_REFLECT) > 0.05 * now.depth_range
    height, width = changed.shape
    changed |= deeper.repeat(DEPTH_STRIDE, 0).repeat(DEPTH_STRIDE, 1)[:height, :width]
    return changed


def register_again(
    source: PreparedView,
    reference: PreparedView,
    before: ViewRegistration,
    changed: tuple[Counts, Counts],
    noise: float,
    turn: int,
    model: MotionModel,
) -> Again | None:
    """Return the windows of the previous frame, fitted anew where something has changed.

    None where most has changed, or the rig has moved.

    Parameters
    ----------
    changed : (in source, in reference)
        Pixels that are not what they were, counted.
    turn : int
        Frames since the chain began: says which cells are probed now.
    """
    old, parallax, prior = before.motions, before.parallax, before.prior
    dirty = stale_patches(source, reference, before, changed, noise, turn)
    if dirty is None or old is None or parallax is None or prior is None:
        return None
    patches = windows_of(old)
    fresh = np.zeros(patches.grid, bool)
    fresh.flat[patches.cell[dirty]] = True
    merged, kept, fitted = _merged(old, cut_view(source, parallax, fresh), dirty, fresh)
    some = merged.patches.some(fitted)
    start, directions = merged.motion.copy(), np.zeros((len(fitted), 2))
    start[fitted] = motions.from_parallax(some, parallax, model)
    start[fitted, motions.OFFSET] = prior.offset_mean
    directions[fitted] = motions.parallax_directions(some, parallax)
    fit, samples = fit_windows(
        source, reference, windows_of(merged), start, QUIET_PASSES if noise < QUIET else PASSES,
        prior, directions, noise=noise, min_support=MIN_SUPPORT, before=(merged, fitted),
    )  # fmt: skip
    return Again(
        fit=WindowFit(fitted=fit, parallax=parallax, prior=prior, samples=samples),
        fitted=fitted,
        kept=kept,
        fresh=fresh,
    )


def stale_patches(
    source: PreparedView,
    reference: PreparedView,
    before: ViewRegistration,
    changed: tuple[Counts, Counts],
    noise: float,
    turn: int,
) -> Chosen | None:
    """Return which patches of the previous frame no longer hold, (P,).

    None where most do not, or the rig has moved; see :func:`register_again`.
    """
    old = before.motions
    if old is None or not isinstance(old.patches, Windows):
        return None
    patches = old.patches
    dirty = np.empty(len(patches.cells), bool)
    _touch(*changed, patches.cells, old.motion, dirty)
    dirty = around(patches, dirty, 0)
    probes = _probes(old, dirty, turn)
    moved = _probe(source, reference, old, probes, before, noise)
    if _rig_moved(moved):
        return None
    if turn in AGAIN:
        return np.ones_like(dirty)
    dirty[probes[np.linalg.norm(moved, axis=1) > DRIFTED]] = True
    dirty = around(patches, dirty, 0)
    return None if dirty.mean() > MOSTLY else dirty


def _probes(old: FittedMotions, dirty: Chosen, turn: int) -> npt.NDArray[np.intp]:
    """Return the patches to probe in this frame, others in each."""
    still = np.flatnonzero(~dirty & (old.status == FITTED) & (old.reliable > 0.5))
    step = max(1, len(still) // PROBES)
    return still[turn % step :: step]


def _probe(
    source: PreparedView, reference: PreparedView, old: FittedMotions,
    probes: npt.NDArray[np.intp], before: ViewRegistration, noise: float,
) -> npt.NDArray[np.float64]:  # fmt: skip
    """Return how far one more step of the fit moves each probe, (M, 2), LR pixels."""
    patches, prior = old.patches, before.prior
    if not isinstance(patches, Windows) or prior is None or len(probes) == 0:
        return np.zeros((len(probes), 2))
    count = len(patches.windows)
    due = np.zeros(count, bool)
    due[probes] = True
    at, onto = source.fine, reference.fine
    sums = np.zeros((count, NUM_SUMS))
    moved, reliable = np.zeros(count, np.float32), np.zeros(count, np.float32)
    status, stepped = np.zeros(count, np.int32), np.empty_like(old.motion)
    window_kernels.sum_cells(
        at.image, at.gradient_x, at.gradient_y, onto.coefficients, 2, 1, patches.owners,
        patches.cells, patches.windows, old.motion, around(patches, due), least_scale(noise, 0),
        np.ones(count, np.float32), sums, *no_samples((0, 0)).planes,
    )  # fmt: skip
    window_kernels.step_windows(
        sums, patches.first, *patches.grid, patches.windows, old.motion, old.motion,
        np.tile(np.eye(2), (count, 1, 1)), 50.0, prior.offset_mean, prior.offset_sigma**-2,
        MIN_SUPPORT // 4, BESIDE, ACROSS, FARTHEST, due, moved, status, reliable, stepped,
    )  # fmt: skip
    away = stepped[probes][:, MIDDLE] - old.motion[probes][:, MIDDLE]
    away[status[probes] != FITTED] = 0
    return away


def _rig_moved(moved: npt.NDArray[np.float64]) -> bool:
    """Return whether the probes moved for the most part, together or each its way."""
    if len(moved) < PROBES // 4:
        return False
    along_x, along_y = moved.T.tolist()
    together = math.hypot(statistics.median(along_x), statistics.median(along_y))
    apart = statistics.median(map(math.hypot, along_x, along_y))
    return together > RIG_DRIFTED or apart > DRIFTED


def _merged(
    old: FittedMotions, cut: Windows, dirty: Chosen, stale: Mask
) -> tuple[FittedMotions, npt.NDArray[np.int32], Chosen]:
    """Return the old patches with those of dirty, stale cells replaced by the new cut's.

    Also where each old patch has gone, −1 where it is replaced, and which are new.
    """
    patches = windows_of(old)
    clean = ~dirty
    cell = np.concatenate([patches.cell[clean], cut.cell])
    order = np.argsort(cell, kind="stable")
    place = np.empty(len(order), np.int32)
    place[order] = np.arange(len(order), dtype=np.int32)
    split = int(clean.sum())
    kept = np.full(len(clean), -1, np.int32)
    kept[clean] = place[:split]
    owners = np.empty_like(patches.owners)
    _merge_owners(stale, SPACING, patches.owners, kept, cut.owners, place[split:], owners)

    def both(first: npt.NDArray, second: npt.NDArray) -> npt.NDArray:
        return np.concatenate([first[clean], second])[order]

    count = len(cut.windows)
    merged = Windows(
        windows=both(patches.windows, cut.windows),
        ranges=both(patches.ranges, cut.ranges),
        planes=both(patches.planes, cut.planes),
        support=both(patches.support, cut.support),
        owners=owners,
        cells=both(patches.cells, cut.cells),
        cell=cell[order],
        grid=patches.grid,
    )
    sums = np.zeros((len(clean), NUM_SUMS)) if old.sums is None else old.sums
    return (
        FittedMotions(
            patches=merged,
            motion=both(old.motion, np.zeros((count, motions.MOTION_SIZE))),
            status=both(old.status, np.full(count, TOO_FEW, np.int32)),
            scale=both(old.scale, np.full(count, np.inf, np.float32)),
            reliable=both(old.reliable, np.zeros(count, np.float32)),
            sums=both(sums, np.zeros((count, NUM_SUMS))),
        ),
        kept,
        (np.arange(len(order)) >= split)[order],
    )


@njit(nogil=True, cache=True, error_model="numpy")
def _merge_owners(stale, side, old, kept, new, place, owners):
    """Write the patch of each pixel: in stale cells that of the new cut, else the old one."""
    for row in range(owners.shape[0]):
        for column in range(owners.shape[1]):
            if stale[row // side, column // side]:
                owners[row, column] = place[new[row, column]]
            else:
                owners[row, column] = kept[old[row, column]]


@njit(nogil=True, cache=True, error_model="numpy")
def _renumber(labels, kept, out):
    """Write what patches are called now, −1 where there was none."""
    for row in range(labels.shape[0]):
        for column in range(labels.shape[1]):
            label = labels[row, column]
            out[row, column] = kept[label] if label >= 0 else -1


def renumbered(labels: npt.NDArray[np.int32], kept: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return the numbers that the patches of pixels have now, −1 where there is none."""
    out = np.empty_like(labels)
    _renumber(labels, kept, out)
    return out


def judged_again(renewed: Mask) -> Mask:
    """Return the pixels whose verdict may have changed: those near landing points that have."""
    side = 2 * EDGE_REACH + 1
    return cv2.dilate(renewed.astype(np.uint8), np.ones((side, side), np.uint8)).astype(bool)


@njit(nogil=True, cache=True, error_model="numpy")
def _touch(here, there, cells, motion, found):
    """Mark the cells in which something has changed, or where they land.

    ``here`` and ``there`` count the changed pixels of source and reference, see ``Counts``.
    """
    for p in range(cells.shape[0]):
        u, v = int(np.rint(motion[p, 0])), int(np.rint(motion[p, 6]))
        found[p] = _count_inside(here, cells[p], 0, 0) + _count_inside(there, cells[p], u, v) > 0


@njit(nogil=True, cache=True, error_model="numpy")
def _count_inside(counts, box, u, v):
    """Return how many pixels of a mask lie in a box (x0, y0, x1, y1) moved by (u, v)."""
    height, width = counts.shape[0] - 1, counts.shape[1] - 1
    x0, x1 = min(max(box[0] + u, 0), width), min(max(box[2] + u, 0), width)
    y0, y1 = min(max(box[1] + v, 0), height), min(max(box[3] + v, 0), height)
    return counts[y1, x1] - counts[y0, x1] - counts[y1, x0] + counts[y0, x0]


def with_pixels_of(before: ViewRegistration, source: PreparedView) -> ViewRegistration:
    """Return a registration of the previous frame with the pixels of this one."""
    registered = replace(before.registered, observed=source.view.luma - before.offset)
    return replace(before, registered=registered, renewed=np.zeros(before.offset.shape, bool))
