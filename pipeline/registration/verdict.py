"""From landing points to a registered view: weights (Eq. 3), verification (Eq. 4), the record."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, Mask, Positions, RegisteredView
from pipeline.registration.prepare import PreparedView
from pipeline.registration.records import Thresholds
from pipeline.registration.verification import (
    EDGE_REACH,
    nearest_landing,
    registration_weights,
    verify,
)

Box = tuple[slice, slice]
"""Rows and columns of a part of an image."""

MARGIN = EDGE_REACH + 2
"""How far a verdict looks, LR pixels."""


def registered_view(
    source: PreparedView,
    reference: PreparedView,
    position: Positions,
    offset: GreyImage,
    thresholds: Thresholds,
    *,
    before: tuple[RegisteredView, Mask, Sequence[Box]] | None = None,
) -> RegisteredView:
    """Return a view with its landing points weighed and verified.

    Parameters
    ----------
    position : (H, W, 2) float32
        Landing points, LR pixels of the reference.
    offset : (H, W) float32
        Intensity term ζ, grey levels.
    before : (registered, pixels to renew, boxes that hold them), optional
        Where only some pixels have changed: what the others keep.
    """
    luma = source.view.luma
    if before is None:
        whole = (slice(0, luma.shape[0]), slice(0, luma.shape[1]))
        weights = np.empty(luma.shape, np.float32)
        flags = np.empty(luma.shape, np.uint8)
        renewed = np.ones(luma.shape, bool)
        boxes: Sequence[Box] = (whole,)
    else:
        old, renewed, boxes = before
        weights, flags = old.registration_weights.copy(), old.flags.copy()
    for box in boxes:
        fresh = registration_weights(
            reference.raw_coefficients, position[box], luma[box], offset[box]
        )
        np.copyto(weights[box], fresh, where=renewed[box])
    depth_range = max(source.depth_range, reference.depth_range)
    says_depth = source.depth_range > 0 and reference.depth_range > 0
    fine, onto = source.levels[0], reference.levels[0]
    nearest = nearest_landing(position, fine.nearness, onto.nearness.shape)
    for box in boxes:
        wider = _widened(box, luma.shape)
        bits = verify(
            position, weights, fine.nearness, source.known, onto.nearness, reference.known,
            weight_threshold=thresholds.weight,
            depth_threshold=thresholds.depth * depth_range if says_depth else np.inf,
            nearest=nearest, box=wider,
        )  # fmt: skip
        inner = tuple(
            slice(part.start - outer.start, part.stop - outer.start)
            for part, outer in zip(box, wider, strict=True)
        )
        np.copyto(flags[box], bits[inner], where=renewed[box])
    return RegisteredView(
        view_id=source.view.view_id,
        observed=luma - offset,
        position=position,
        registration_weights=weights,
        flags=flags,
        confidence=np.ones(flags.shape, np.float32) if before is None else before[0].confidence,
    )


def _widened(box: Box, shape: tuple[int, ...]) -> Box:
    rows, columns = (
        slice(max(part.start - MARGIN, 0), min(part.stop + MARGIN, size))
        for part, size in zip(box, shape, strict=True)
    )
    return rows, columns


def boxes_of(cells: npt.NDArray[np.bool_], side: int, shape: tuple[int, ...]) -> list[Box]:
    """Return the boxes around connected groups of cells, each cell ``side`` pixels wide."""
    count, _, stats, _ = cv2.connectedComponentsWithStats(cells.astype(np.uint8), connectivity=8)
    boxes = []
    for x, y, width, height, _ in stats[1:count]:
        boxes.append(
            (
                slice(int(y) * side, min((int(y) + int(height)) * side, shape[0])),
                slice(int(x) * side, min((int(x) + int(width)) * side, shape[1])),
            )
        )
    return boxes
