"""Registering the views of a rig that has moved: other pictures, the same cameras.

What a fit from scratch finds first is how the cameras stand to one another, and of that nothing
has changed. Windows are cut and fitted anew, in fewer passes, from the parallax motion that the
frame before has left; where they no longer keep to it the rig has changed, and all is begun
anew.

The measurements that chose the constants: docs/experiments.md#a-camera-that-moves.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.registration import motions
from pipeline.registration.method import MotionModel
from pipeline.registration.motions import Pass
from pipeline.registration.prepare import PreparedView
from pipeline.registration.records import ViewRegistration
from pipeline.registration.window_fits import fit_windows
from pipeline.registration.windows import (
    FEWEST_PATCHES,
    MIN_SUPPORT,
    WindowFit,
    along_parallax,
    cut_view,
    spread_across,
    well_fitted,
)

MOVED_PASSES = (Pass(level=1, iterations=2), Pass(level=0, iterations=2))
"""The depth of what comes into view is that of the depth map, pixels off; a coarse pass first."""

STRAYED = 2.0
"""Spread across the parallax, times that to which fits are held, from which the rig has changed."""


def register_moved(
    source: PreparedView,
    reference: PreparedView,
    before: ViewRegistration,
    noise: float,
    model: MotionModel,
) -> WindowFit | None:
    """Return the windows of a view fitted onto a reference, from the geometry of a frame before.

    None where that frame has left none, or the windows do not keep to it.
    """
    parallax, prior = before.parallax, before.prior
    if parallax is None or prior is None:
        return None
    patches = cut_view(source, parallax)
    start = motions.from_parallax(patches, parallax, model)
    start[:, motions.OFFSET] = prior.offset_mean
    directions = motions.parallax_directions(patches, parallax)
    fitted, samples = fit_windows(
        source, reference, patches, start, MOVED_PASSES, prior, directions, noise=noise,
        min_support=MIN_SUPPORT,
    )  # fmt: skip
    good = well_fitted(fitted)
    if good.sum() < FEWEST_PATCHES:
        return None
    points, landed = motions.landed_centres(fitted)
    nearness = along_parallax(points, landed, patches.planes[:, 0], parallax)
    if spread_across(fitted, parallax, nearness) > STRAYED * prior.across:
        return None
    offset = float(np.median(fitted.motion[good, motions.OFFSET]))
    return WindowFit(
        fitted=fitted,
        parallax=parallax,
        prior=replace(prior, offset_mean=offset),
        samples=samples,
    )
