"""Motions of many patches: how they start, how they are fitted down a pyramid (thesis Eq. 2).

A motion is 13 numbers: u and v coefficients of the basis 1, X, Y, X², XY, Y² and the
intensity term ζ, with X and Y measured from the middle of the patch's window in units
of half its larger side, displacements in LR pixels. Written this way the coefficients
of one patch are all of the size of pixels, which keeps the fits well conditioned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pipeline.registration import kernels, parallax_kernels
from pipeline.registration.kernels import TOO_FEW
from pipeline.registration.method import MotionModel
from pipeline.registration.parallax import ParallaxMotion
from pipeline.registration.patches import Patches
from pipeline.registration.prepare import PreparedView

Motions = npt.NDArray[np.float64]
"""(P, 13) float64, see the module docstring."""

MOTION_SIZE = 13
OFFSET = 12
"""Column of the intensity term ζ, grey levels."""

MIDDLE = (0, 6)
"""Columns of u and v at the window's middle, LR pixels."""

TOLERANCE = 0.02
"""A fit stops when no point of the patch moves more, pixels of its level."""

NO_DESTINATION = np.zeros((0, 0), np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedMotions:
    """The motions of a view's patches, and how well they were determined."""

    patches: Patches
    motion: Motions
    status: npt.NDArray[np.int32]
    """(P,): ``kernels.FITTED``, or why the start was kept."""
    scale: npt.NDArray[np.float32]
    """(P,): robust residual scale, grey levels."""
    reliable: npt.NDArray[np.float32]
    """(P,): share of the support within the robust cut-off, 0..1."""
    sums: npt.NDArray[np.float64] | None = None
    """(P, 35): what the last step was made of, see ``window_kernels``; None for strips."""


@dataclass(frozen=True, kw_only=True)
class Pass:
    """One run over all patches at one pyramid level."""

    level: int
    iterations: int
    stride: int = 1
    """Every so many rows and columns take part."""


@dataclass(frozen=True, kw_only=True)
class FitPrior:
    """How firmly a motion is held at its start, in directions the texture leaves open."""

    along: float
    """Standard deviation of the mean displacement along the parallax, LR pixels."""
    across: float
    """The same across it, LR pixels."""
    linear: float = 4.0
    """Factor on the precision for the linear terms."""
    quadratic: float = 16.0
    """The same for the quadratic terms."""
    offset_mean: float = 0.0
    """Where ζ is held, grey levels."""
    offset_sigma: float = 10.0
    """How firmly, grey levels."""

    def precision(self, directions: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the precision of the mean displacement of patches, (P, 2, 2), px⁻².

        Parameters
        ----------
        directions : (P, 2) float64
            Unit vectors along which ``along`` holds.
        """
        outer = directions[:, :, None] * directions[:, None, :]
        return outer / self.along**2 + (np.eye(2) - outer) / self.across**2


def centres(patches: Patches) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Return x, y of the windows' middles and half their larger side, each (P,), pixels."""
    count = len(patches.windows)
    x, y, size = np.empty(count), np.empty(count), np.empty(count)
    parallax_kernels.centres_all(patches.windows, x, y, size)
    return x, y, size


def landed_centres(fitted: FittedMotions) -> tuple[npt.NDArray, npt.NDArray]:
    """Return the windows' middles and where they land, x and y, (P, 2) each, LR pixels."""
    x, y, _ = centres(fitted.patches)
    u, v = (fitted.motion[:, column] for column in MIDDLE)
    return np.column_stack([x, y]), np.column_stack([x + u, y + v])


def least_scale(noise: float, level: int) -> float:
    """Return the robust scale below which none is believed, grey levels.

    Parameters
    ----------
    noise : float
        Of the LR picture, grey levels; what smoothing leaves of it counts.
    level : int
        Of the pyramid, 0 the finest.
    """
    return max(noise * (0.6 if level == 0 else 0.4), 0.3)


def no_motion(patches: Patches) -> Motions:
    """Return zero motions."""
    return np.zeros((len(patches.windows), MOTION_SIZE))


def from_parallax(
    patches: Patches, parallax: ParallaxMotion, model: MotionModel = MotionModel.AFFINE
) -> Motions:
    """Return the motions that the planes of the patches have under a parallax motion.

    Thesis Figure 5: points around the patch's centre are carried over at the depth of
    the patch (ours: of its fitted plane) and the affine motion between them is taken, or
    that of the centre alone where the model is translation.
    """
    x, y, size = centres(patches)
    motion = no_motion(patches)
    parallax_kernels.start_all(
        parallax.matrix, x, y, size, patches.planes, model is not MotionModel.TRANSLATION, motion
    )
    return motion


def from_parents(
    patches: Patches, parents: Patches, parent_motion: Motions, parent: npt.NDArray[np.intp]
) -> Motions:
    """Return the motions of parent patches, rewritten about the windows of their children.

    Parameters
    ----------
    parent : (P,) int
        For each child the number of its parent.
    """
    x, y, size = centres(patches)
    parent_x, parent_y, parent_size = (values[parent] for values in centres(parents))
    ratio = size / parent_size
    bx, by = (x - parent_x) / parent_size, (y - parent_y) / parent_size
    motion = no_motion(patches)
    for first in (0, 6):
        c, ax, ay, qxx, qxy, qyy = parent_motion[parent, first : first + 6].T
        motion[:, first] = c + ax * bx + ay * by + qxx * bx**2 + qxy * bx * by + qyy * by**2
        motion[:, first + 1] = ratio * (ax + 2 * qxx * bx + qxy * by)
        motion[:, first + 2] = ratio * (ay + 2 * qyy * by + qxy * bx)
        motion[:, first + 3 : first + 6] = (ratio**2)[:, None] * np.stack([qxx, qxy, qyy], axis=1)
    motion[:, OFFSET] = parent_motion[parent, OFFSET]
    return motion


def parallax_directions(patches: Patches, parallax: ParallaxMotion | None) -> npt.NDArray:
    """Return unit vectors (P, 2) in which a wrong depth moves each patch; x where none."""
    x, y, _ = centres(patches)
    if parallax is None:
        return np.tile([1.0, 0.0], (len(x), 1))
    directions = np.empty((len(x), 2))
    parallax_kernels.directions_all(parallax.matrix, x, y, patches.planes[:, 0], directions)
    return directions


def fit_motions(
    source: PreparedView,
    reference: PreparedView,
    patches: Patches,
    start: Motions,
    passes: Sequence[Pass],
    prior: FitPrior,
    directions: npt.NDArray[np.float64],
    *,
    model: MotionModel,
    noise: float,
    min_support: int,
    destination_margin: float | None = None,
) -> FittedMotions:
    """Return the motions of all patches, refined from their start by robust Gauss–Newton.

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
    destination_margin : float, optional
        With destination support: how far beyond the patch's range, units of nearness.
    """
    motion = start.copy()
    count = len(patches.windows)
    status = np.full(count, TOO_FEW, np.int32)
    quality = np.full((count, 2), np.inf, np.float32)
    strength = np.array([1.0, prior.linear, prior.quadratic])
    for run in passes:
        if run.level >= min(len(source.levels), len(reference.levels)):
            continue
        finer = 2.0**run.level
        at, onto = source.levels[run.level], reference.levels[run.level]
        height, width = at.image.shape
        windows = patches.windows // int(finer)
        windows[:, 2:] = np.minimum(-(-patches.windows[:, 2:] // int(finer)), [width, height])
        motion[:, :OFFSET] /= finer
        kernels.fit_patches(
            at.image, at.gradient_x, at.gradient_y, onto.coefficients, at.nearness,
            NO_DESTINATION if destination_margin is None else onto.nearness,
            destination_margin or 0.0, windows, patches.ranges, int(model), motion,
            prior.precision(directions) * finer**2, strength, prior.offset_mean,
            prior.offset_sigma**-2, least_scale(noise, run.level),
            max(int(0.5 * min_support / finer**2), 1), run.iterations, TOLERANCE, run.stride,
            status, quality,
        )  # fmt: skip
        motion[:, :OFFSET] *= finer
    return FittedMotions(
        patches=patches, motion=motion, status=status, scale=quality[:, 0], reliable=quality[:, 1]
    )
