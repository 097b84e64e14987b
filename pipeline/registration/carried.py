"""A view on a second reference, from how it lies on the first: no pixel of it is fitted twice.

Point transfer through the first reference. All cameras look at one instant, so that a surface which
a fit onto one reference has found lands on every other where the rig's geometry puts it, whether it
moves or not. The depth of a pixel is told by where it lands on the one; the parallax motion of the
other turns it into a landing point there. Not in the thesis.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit

from pipeline.compiled import EXACT
from pipeline.frames import Mask
from pipeline.registration import motions
from pipeline.registration.kernels import FITTED
from pipeline.registration.motions import FittedMotions
from pipeline.registration.parallax import ParallaxMotion
from pipeline.registration.parallax_kernels import land_one, nearness_one
from pipeline.registration.prepare import PreparedView
from pipeline.registration.records import ViewRegistration
from pipeline.registration.window_fits import windows_of
from pipeline.registration.windows import Landed

RELIABLE = 0.5
"""Share of a patch's pixels within the robust cut-off below which its depth is not believed."""


def carry_motions(lead: ViewRegistration, onto: ParallaxMotion, offset: float) -> FittedMotions:
    """Return the motions of a view's patches on another reference than they were fitted on.

    Parameters
    ----------
    lead : ViewRegistration
        The view on the reference on which it was fitted.
    onto : ParallaxMotion
        Of the view onto the other.
    offset : float
        What is added to ζ, grey levels.
    """
    fitted, parallax = lead.motions, lead.parallax
    assert fitted is not None  # both are there where windows
    assert parallax is not None  # were fitted
    patches = windows_of(fitted)
    x, y, size = motions.centres(patches)
    motion = fitted.motion.copy()
    _carry_patches(
        x, y, size, patches.planes, believed(fitted), parallax.matrix, onto.matrix, motion,
    )  # fmt: skip
    motion[:, motions.OFFSET] += offset
    return replace(fitted, motion=motion, sums=None)


def carry_pixels(
    source: PreparedView, lead: ViewRegistration, onto: ParallaxMotion, offset: float,
    kept: Landed, renewed: Mask,
) -> Landed:  # fmt: skip
    """Return landing points on another reference; parameters are those of :func:`carry_motions`.

    Parameters
    ----------
    kept : Landed
        What the pixels keep that are not to be renewed.
    renewed : (H, W) bool
    """
    fitted, parallax = lead.motions, lead.parallax
    assert fitted is not None  # both are there where windows
    assert parallax is not None  # were fitted
    position, offsets = kept.position.copy(), kept.offset.copy()
    _carry_pixels(
        source.fine.nearness, lead.registered.position, lead.offset, lead.patch_labels,
        believed(fitted), renewed, parallax.matrix, onto.matrix, np.float32(offset), position,
        offsets,
    )  # fmt: skip
    return Landed(labels=lead.patch_labels, position=position, offset=offsets)


def believed(fitted: FittedMotions) -> Mask:
    """Return whether the depth that a patch's motion tells is to be believed, (P,) bool."""
    return (fitted.status == FITTED) & (fitted.reliable > RELIABLE)


@njit(**EXACT)
def _nearness_of(matrix, x, y, landed_x, landed_y, nearness):
    """Return the nearness at which a point comes closest to where it has landed."""
    nearness = nearness_one(matrix, x, y, landed_x, landed_y, nearness)
    return nearness_one(matrix, x, y, landed_x, landed_y, nearness)


@njit(nogil=True, cache=True, error_model="numpy")
def _carry_patches(x, y, size, planes, trusted, matrix, onto, motion):
    """Replace affine motions onto one reference by those onto another, in place."""
    for p in range(motion.shape[0]):
        base_u = base_v = 0.0
        theta = motion[p].copy()
        for number in range(3):
            # the middle, then half the window's side along each axis
            right = 1.0 if number == 1 else 0.0
            down = 1.0 if number == 2 else 0.0
            px, py = x[p] + size[p] * right, y[p] + size[p] * down
            nearness = planes[p, 0] + planes[p, 1] * right + planes[p, 2] * down
            if trusted[p]:
                nearness = _nearness_of(
                    matrix, px, py,
                    px + theta[0] + theta[1] * right + theta[2] * down,
                    py + theta[6] + theta[7] * right + theta[8] * down, nearness,
                )  # fmt: skip
            u, v, _, _ = land_one(onto, px, py, nearness)
            u -= px + base_u
            v -= py + base_v
            motion[p, number], motion[p, 6 + number] = u, v
            if number == 0:
                base_u, base_v = u, v


@njit(nogil=True, cache=True, error_model="numpy")
def _carry_pixels(
    nearness, landed, offsets, labels, trusted, renewed, matrix, onto, offset, position,
    out_offsets,
):  # fmt: skip
    """Write where some pixels land on another reference, and their intensity terms."""
    for row in range(renewed.shape[0]):
        for column in range(renewed.shape[1]):
            if not renewed[row, column]:
                continue
            label = labels[row, column]
            if label < 0:
                position[row, column, 0] = np.nan
                position[row, column, 1] = np.nan
                out_offsets[row, column] = 0
                continue
            x, y = float(column), float(row)
            depth = float(nearness[row, column])
            if trusted[label]:
                depth = _nearness_of(
                    matrix, x, y, float(landed[row, column, 0]),
                    float(landed[row, column, 1]), depth,
                )  # fmt: skip
            u, v, _, _ = land_one(onto, x, y, depth)
            position[row, column, 0] = u
            position[row, column, 1] = v
            out_offsets[row, column] = offsets[row, column] + offset
