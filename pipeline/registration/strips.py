"""The thesis' registration of a view: depth layers × strips, Table 1's methods."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from pipeline.frames import Positions
from pipeline.registration import kernels, motions
from pipeline.registration.kernels import FITTED
from pipeline.registration.layers import layer_labels, layer_thresholds
from pipeline.registration.method import Initialisation, MotionModel, RegistrationMethod
from pipeline.registration.motions import FitPrior, FittedMotions, Pass
from pipeline.registration.patches import Patches, layer_strips
from pipeline.registration.prepare import PreparedView
from pipeline.registration.verification import registration_weights
from pipeline.registration.windows import MIN_SUPPORT, calibrated_parallax

FREE = FitPrior(along=1e3, across=1e3, linear=1.0, quadratic=1.0, offset_sigma=10.0)
"""The thesis' fits: nothing is held."""

STRIP_PASSES = tuple(Pass(level=level, iterations=8) for level in (4, 3, 2, 1, 0))


def register_strips(
    source: PreparedView, reference: PreparedView, method: RegistrationMethod, noise: float
) -> tuple[FittedMotions, npt.NDArray[np.int32], Positions, npt.NDArray[np.float32]]:
    """Register by L layers × R strips: Table 1's methods."""
    nearness = source.fine.nearness
    thresholds = layer_thresholds(nearness, method.num_layers, min_support=MIN_SUPPORT)
    whole = layer_strips(nearness, thresholds, 1)
    patches = layer_strips(nearness, thresholds, method.num_subregions)
    parent = np.repeat(np.arange(len(whole.windows)), method.num_subregions)
    margin = 0.1 * source.depth_range if method.destination_support else None

    def fit(of: Patches, start: motions.Motions, passes: Sequence[Pass]) -> FittedMotions:
        return motions.fit_motions(
            source, reference, of, start, passes, FREE, motions.parallax_directions(of, None),
            model=method.model, noise=noise, min_support=MIN_SUPPORT, destination_margin=margin,
        )  # fmt: skip

    whole_start = motions.no_motion(whole)
    if method.initialisation is Initialisation.CALIBRATION:
        whole_start = motions.from_parallax(whole, calibrated_parallax(source, reference))
        if method.model is MotionModel.TRANSLATION:
            whole_start[:, [1, 2, 7, 8]] = 0.0
    inherits = method.initialisation in (Initialisation.LAYER, Initialisation.CALIBRATION)
    layers = None
    if inherits or method.best_of_layer_and_patch:
        # a start that is nearly right must not be thrown away at the coarse levels
        near = method.initialisation is Initialisation.CALIBRATION
        layers = fit(whole, whole_start, STRIP_PASSES[-2:] if near else STRIP_PASSES)
    if inherits and layers is not None:
        start = motions.from_parents(patches, whole, layers.motion, parent)
        fitted = fit(patches, start, STRIP_PASSES[-2:])
    else:
        fitted = fit(patches, motions.no_motion(patches), STRIP_PASSES)
    edges = np.linspace(0, nearness.shape[1], method.num_subregions + 1).round()
    strip = np.searchsorted(edges[1:-1], np.arange(nearness.shape[1]), side="right")
    labels = layer_labels(nearness, thresholds) * method.num_subregions + strip[None, :]
    labels = labels.astype(np.int32)
    position, offset = _follow(fitted, labels)
    if method.best_of_layer_and_patch and layers is not None:
        parent_position, parent_offset = _follow(layers, parent[labels].astype(np.int32))
        luma, onto = source.view.luma, reference.raw_coefficients
        own = np.abs(registration_weights(onto, position, luma, offset))
        other = np.abs(registration_weights(onto, parent_position, luma, parent_offset))
        take = (other < own) | (np.isnan(own) & np.isfinite(other))
        position = np.where(take[..., None], parent_position, position)
        offset = np.where(take, parent_offset, offset)
    return fitted, labels, np.ascontiguousarray(position), np.ascontiguousarray(offset)


def _follow(
    fitted: FittedMotions, labels: npt.NDArray[np.int32]
) -> tuple[Positions, npt.NDArray[np.float32]]:
    """Return where each pixel lands by the motion of its patch; NaN where that was not fitted."""
    position = np.empty((*labels.shape, 2), np.float32)
    offset = np.empty(labels.shape, np.float32)
    kernels.follow_patches(
        fitted.patches.windows, fitted.motion, fitted.status == FITTED, labels, position, offset
    )
    return position, offset
