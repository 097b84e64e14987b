"""The motion of one view onto another, turned round: where the other's pixels land on the one.

The inverse of a warp, by splatting. Of two views of one instant either fit tells both ways. Pixels
of the view that was fitted are spread over those of the other around which they land, as far as
they are believed to show what is seen there; each of these is then sent back to where they came
from. Not in the thesis.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT
from pipeline.frames import Rejection
from pipeline.registration.records import ViewRegistration
from pipeline.registration.windows import Landed
from pipeline.threads import map_threads, shares

UNSEEN = np.uint8(Rejection.NO_MOTION | Rejection.OUTSIDE | Rejection.OCCLUDED | Rejection.DEPTH)
"""Reasons for which a pixel is taken not to show what lies where it lands."""

ONE_SURFACE = 0.5
"""Difference of two pixels' displacements up to which they show one surface, LR pixels."""


def inverted(
    lead: ViewRegistration,
    nearness: npt.NDArray[np.float32],
    onto: npt.NDArray[np.float32],
) -> Landed:
    """Return where the pixels of a reference land on a view that was registered onto it.

    Parameters
    ----------
    lead : ViewRegistration
        The view onto the reference.
    nearness, onto : (H, W), (H', W') float32
        Of the view and of the reference: where two surfaces of the view land on one pixel, the
        one whose nearness is that of the pixel is taken.

    Returns
    -------
    Landed
        Of the reference's (H', W') pixels, labelled by the patches of the view.
    """
    position = np.empty((*onto.shape, 2), np.float32)
    offset = np.empty(onto.shape, np.float32)
    labels = np.empty(onto.shape, np.int32)
    total, nearest = np.zeros(onto.shape, np.float32), np.empty(onto.shape, np.float32)

    def spread(rows: slice) -> None:
        _spread(
            lead.registered.position, lead.registered.flags, lead.offset, lead.patch_labels,
            nearness, onto, UNSEEN, ONE_SURFACE, rows.start, rows.stop, total, nearest, position,
            offset, labels,
        )  # fmt: skip

    map_threads(spread, shares(len(onto)))
    return Landed(labels=labels, position=position, offset=offset)


@njit(**EXACT)
def _spread(
    landed, flags, offset, labels, nearness, onto, unseen, one_surface, lo, hi, total, nearest,
    position, offsets, out_labels,
):  # fmt: skip
    """Write the mean of where the pixels around came from, and of their terms with minus.

    To the rows ``lo`` to ``hi``. ``total`` (zero) and ``nearest``, of the shape of ``onto``, are
    scratch.
    """
    width = onto.shape[1]
    one, zero = np.float32(1.0), np.float32(0.0)
    apart = np.float32(one_surface)
    for row in range(landed.shape[0]):
        i = np.uint64(row)
        for column in range(landed.shape[1]):
            j = np.uint64(column)
            if flags[i, j] & unseen:
                continue
            u, v = landed[i, j, 0], landed[i, j, 1]
            left, top = int(np.floor(u)), int(np.floor(v))
            here, label, term = nearness[i, j], labels[i, j], offset[i, j]
            for below in range(max(top, lo), min(top + 2, hi)):
                down = np.float32(below) - v
                # places are not negative, and unsigned numbers need no check that they are
                y = np.uint64(below)
                for beside in range(max(left, 0), min(left + 2, width)):
                    right = np.float32(beside) - u
                    weight = (one - abs(right)) * (one - abs(down))
                    if weight <= zero:
                        continue
                    x = np.uint64(beside)
                    # the view's pixels move from this one on as the reference's do
                    px, py = np.float32(column) + right, np.float32(row) + down
                    known = total[y, x]
                    away = abs(onto[y, x] - here)
                    if known > zero:
                        alike = (
                            abs(px * known - position[y, x, 0]) <= apart * known
                            and abs(py * known - position[y, x, 1]) <= apart * known
                        )
                        if not alike:
                            if away > nearest[y, x] or (away == nearest[y, x] and weight <= known):
                                continue
                            known = zero
                    if known == zero:
                        total[y, x] = weight
                        position[y, x, 0] = weight * px
                        position[y, x, 1] = weight * py
                        offsets[y, x] = -(weight * term)
                        nearest[y, x] = away
                        out_labels[y, x] = label
                        continue
                    total[y, x] = known + weight
                    position[y, x, 0] += weight * px
                    position[y, x, 1] += weight * py
                    offsets[y, x] -= weight * term
                    nearest[y, x] = min(nearest[y, x], away)
    for below in range(lo, hi):
        y = np.uint64(below)
        for beside in range(width):
            x = np.uint64(beside)
            if total[y, x] > zero:
                share = one / total[y, x]
                position[y, x, 0] *= share
                position[y, x, 1] *= share
                offsets[y, x] *= share
            else:
                position[y, x, 0] = np.nan
                position[y, x, 1] = np.nan
                offsets[y, x] = zero
                out_labels[y, x] = -1
