"""Landing points told by depth maps: what moves is not fitted where depth has proved right.

Depth-image-based warping, with depth maps that registration has corrected. A frame whose views were
fitted has shown at thousands of places at what nearness the parallax motion of two views holds.
What their depth map has to be corrected by for that, by a bilinear function of place and nearness,
is learned from those places; where something changes in a later frame, its depth map, so corrected,
says where it lands. Not in the thesis.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT, OPTIONS
from pipeline.frames import Mask, Rejection
from pipeline.registration.cleaning import next_run
from pipeline.registration.depth_vectors import put_landed
from pipeline.registration.records import ViewRegistration
from pipeline.registration.windows import along_parallax, some_landed
from pipeline.vectors import WIDE

ASKED = 600
"""Patches that a law is learned from, about."""

FEWEST = 30
"""Patches below which none is."""

ROUNDS = 6
"""Re-weightings of its fit."""

CUT = 3.0
"""Standard deviations from which a patch counts nothing."""

Nearness = npt.NDArray[np.float32]
"""(H, W), without NaN."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthLaw:
    """What a view's depth map is corrected by so that a parallax motion holds."""

    terms: npt.NDArray[np.float64]
    """(6,): of 1, d, x, y, x d and y d; d nearness, x and y from −½ to ½ across the view."""
    spread: float
    """How far patches land from where it says, standard deviation along the parallax, LR pixels."""


def learn_law(registration: ViewRegistration, nearness: Nearness) -> DepthLaw | None:
    """Return the law of two views, None where too little was fitted.

    Parameters
    ----------
    nearness : (H, W) float32
        Of the view, in the frame in which it was registered.
    """
    parallax = registration.parallax
    found = some_landed(registration, FEWEST, ASKED)
    if parallax is None or found is None:
        return None
    points, landed = found
    height, width = nearness.shape
    row, column = np.rint(points[:, 1]).astype(int), np.rint(points[:, 0]).astype(int)
    said = nearness[row, column].astype(float)
    told = along_parallax(points, landed, said, parallax)
    told = along_parallax(points, landed, told, parallax)
    across, down = (points[:, 0] + 0.5) / width - 0.5, (points[:, 1] + 0.5) / height - 0.5
    basis = np.stack([np.ones(len(said)), said, across, down, across * said, down * said], axis=1)
    terms, weights = np.zeros(6), np.ones(len(said))
    deviation = 0.0
    for _ in range(ROUNDS):
        weighted = basis * weights[:, None]
        terms = np.linalg.lstsq(weighted, (told - said) * weights, rcond=None)[0]
        away = np.abs(told - said - basis @ terms)
        deviation = 1.4826 * float(np.median(away))
        weights = np.fmax(0.0, 1 - (away / max(CUT * deviation, 1e-12)) ** 2)
    speed = np.linalg.norm(parallax.parallax(points[:, 0], points[:, 1], told), axis=-1)
    return DepthLaw(terms=terms, spread=deviation * float(np.median(speed)))


def landed_by_depth(
    before: ViewRegistration, law: DepthLaw, nearness: Nearness, changed: Mask,
    reference_shape: tuple[int, int], in_place: bool = False,
) -> ViewRegistration:  # fmt: skip
    """Return a registration of which the pixels that have changed land by their depth.

    Their verdict is whether they land inside the reference; the solver weighs the rest of it.

    Parameters
    ----------
    nearness : (H, W) float32
        Where something has changed; elsewhere it is not looked at.
    changed : (H, W) bool
    reference_shape : (int, int)
        Height and width of the reference, LR pixels.
    in_place : bool
        Whether the arrays of ``before`` may be written to.
    """
    registered, parallax, prior = before.registered, before.parallax, before.prior
    assert parallax is not None  # both are there where
    assert prior is not None  # a law was learned
    position, offset, flags = registered.position, before.offset, registered.flags
    if not in_place:
        position, offset, flags = position.copy(), offset.copy(), flags.copy()
    _land(
        nearness, law.terms, parallax.homography, parallax.epipole, np.float32(prior.offset_mean),
        *reference_shape, np.uint8(Rejection.OUTSIDE), changed, position, offset, flags,
    )  # fmt: skip
    return replace(
        before, offset=offset, registered=replace(registered, position=position, flags=flags)
    )


@njit(**OPTIONS)
def _land(
    nearness, terms, homography, epipole, offset, height, width, outside, wanted, position,
    offsets, flags,
):  # fmt: skip
    """Write where some pixels land, their intensity terms and whether they land inside.

    Stretches of a row of which none is wanted are not looked at, see :mod:`cleaning`.
    """
    lines = np.empty((2, nearness.shape[1]), np.float32)
    _land_rows(
        nearness, terms, homography, epipole, offset, height, width, outside, wanted, position,
        offsets, flags, lines[0], lines[1],
    )  # fmt: skip


@njit(**EXACT)
def _land_rows(
    nearness, terms, homography, epipole, offset, height, width, outside, wanted, position,
    offsets, flags, along_x, along_y,
):  # fmt: skip
    rows, columns = nearness.shape
    constant, slope, aslant, downwards, slope_x, slope_y = terms
    h00, h01, h02 = homography[0]
    h10, h11, h12 = homography[1]
    h20, h21, h22 = homography[2]
    least, right, under = np.float32(-0.5), np.float32(width - 0.5), np.float32(height - 0.5)
    inverse, nothing = 1.0 / columns, np.uint8(0)
    for row in range(rows):
        marks = wanted[row]
        start, end = next_run(marks, 0)
        if start >= columns:
            continue
        y = float(row)
        down = (y + 0.5) / rows - 0.5
        # what a row has in common
        of_row = (
            constant + downwards * down, slope + slope_y * down, aslant, slope_x, inverse,
            (h00, h01 * y + h02, epipole[0]), (h10, h11 * y + h12, epipole[1]),
            (h20, h21 * y + h22, epipole[2]),
        )  # fmt: skip
        while start < columns:
            end = min(end, columns)
            _land_run(nearness[row, start:end], start, of_row, along_x, along_y)
            points, whole_end = position[row].reshape(-1), end - (end - start) % WIDE
            for column in range(start, whole_end, WIDE):
                put_landed(
                    along_x, along_y, column - start, (least, right, under), marks, column, offset,
                    outside, points, offsets[row], flags[row],
                )  # fmt: skip
            for column in range(whole_end, end):
                if not marks[column]:
                    continue
                u, v = along_x[column - start], along_y[column - start]
                position[row, column, 0] = u
                position[row, column, 1] = v
                offsets[row, column] = offset
                is_inside = (u > least) & (v > least) & (u < right) & (v < under)
                flags[row, column] = nothing if is_inside else outside
            start, end = next_run(marks, end)


@njit(**EXACT)
def _land_run(nearness, start, of_row, along_x, along_y):
    """Write where a run of pixels lands, x and y, by what its row has in common."""
    at_row, rise, aslant, slope_x, inverse, to_u, to_v, to_scale = of_row
    for k in range(nearness.size):
        x = float(np.int32(start + k))
        across = (x + 0.5) * inverse - 0.5
        said = float(nearness[k])
        depth = said + at_row + aslant * across + said * (rise + slope_x * across)
        share = 1.0 / (to_scale[0] * x + to_scale[1] + to_scale[2] * depth)
        along_x[k] = (to_u[0] * x + to_u[1] + to_u[2] * depth) * share
        along_y[k] = (to_v[0] * x + to_v[1] + to_v[2] * depth) * share
