"""From landing points to a registered view: weights (Eq. 3), verification (Eq. 4), the record."""

from __future__ import annotations

import numpy as np

from pipeline.frames import GreyImage, Mask, Positions, RegisteredView
from pipeline.registration.prepare import PreparedView
from pipeline.registration.records import Thresholds
from pipeline.registration.verification import registration_weights, verify


def registered_view(
    source: PreparedView,
    reference: PreparedView,
    position: Positions,
    offset: GreyImage,
    thresholds: Thresholds,
    *,
    before: tuple[RegisteredView, Mask, Mask] | None = None,
) -> RegisteredView:
    """Return a view with its landing points weighed and verified.

    Parameters
    ----------
    position : (H, W, 2) float32
        Landing points, LR pixels of the reference.
    offset : (H, W) float32
        Intensity term ζ, grey levels.
    before : (registered, pixels to weigh, pixels to verify), optional
        Where only some pixels have changed: what the others keep.
    """
    luma = source.view.luma
    known_weights = known_flags = None
    if before is not None:
        old, landed, judged = before
        known_weights, known_flags = (old.registration_weights, landed), (old.flags, judged)
    weights = registration_weights(
        reference.raw_coefficients, position, luma, offset, before=known_weights
    )
    depth_range = max(source.depth_range, reference.depth_range)
    says_depth = source.depth_range > 0 and reference.depth_range > 0
    fine, onto = source.fine, reference.fine
    flags = verify(
        position, weights, fine.nearness, source.known, onto.nearness, reference.known,
        weight_threshold=thresholds.weight,
        depth_threshold=thresholds.depth * depth_range if says_depth else np.inf,
        before=known_flags,
    )  # fmt: skip
    return RegisteredView(
        view_id=source.view.view_id,
        observed=luma - offset,
        position=position,
        registration_weights=weights,
        flags=flags,
        confidence=np.ones(flags.shape, np.float32) if before is None else before[0].confidence,
    )
