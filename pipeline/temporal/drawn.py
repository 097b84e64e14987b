"""What a codec draws anew: whether a frame is better than the mean of those before it.

Not in the thesis. A codec leaves a picture as it was for some frames, and then draws it better:
that is no noise, and a mean of old frames is worse than the last one. Noise of its own a frame has
more of than a mean, and most of it is finer than detail; what is drawn better takes the place of
what was there before, and is as coarse as the picture is.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import LEAN
from pipeline.frames import GreyImage
from pipeline.temporal.lagging import CALM, LEAST, UNIT, Differences, tile_of, tiles_of

COARSE = 0.8
"""Power of detail by which a frame differs from the mean, over that of what is finer, from which
a tile is drawn anew where all that is new of the finest adds to it as noise does: a camera's noise
has ``lagging.PASSED``, that of a codec up to 0.6, rarely more."""

ADDED = 0.5
"""How much less is enough where it does not: over the share that is missing."""

SETTLED = 3 / 5
"""Share of what is new of the finest by which noise adds to it, of a mean of four frames."""

MUCH = 1 / 4
"""Share of the tiles beyond which a picture is drawn anew."""

NOTHING = 0.02
"""Power of what is finer than detail that is none, grey levels²: rounding alone makes more."""


def is_drawn_anew(
    luma: GreyImage,
    mean: GreyImage,
    frames: npt.NDArray[np.float32],
    detail: Differences,
    fine: Differences,
    reached: npt.NDArray[np.uint8],
) -> bool:
    """Return whether a picture that comes from a codec is better than the mean before it.

    Parameters
    ----------
    luma, mean : (H, W) float32
        Grey levels.
    frames : (H, W) float32
        Of how many the mean is one.
    detail, fine : (H, W) int16
        How they differ, see :func:`still_kernels.compare`.
    reached : (H, W) uint8
        Whether something has changed near by: there nothing is asked.
    """
    sums = np.zeros((6, *tiles_of(luma.shape)))
    _add_up(luma, mean, frames, detail, fine, reached, sums)
    numbers = sums[5].ravel()
    seen = numbers >= LEAST / 4
    if not seen.any():
        return False
    own, finer, more, new, alone = sums[:5].reshape(5, -1)[:, seen] / numbers[seen]
    if np.quantile(finer, CALM) <= NOTHING:
        return False
    count = 1 / np.average(alone, weights=numbers[seen])
    missing = SETTLED - (count - 1) / (count + 1)
    coarse = own / np.maximum(finer, NOTHING)
    added = more / np.maximum(new, NOTHING)
    drawn = (own > NOTHING) & (coarse > COARSE + ADDED * (added + missing))
    return bool(drawn.mean() > MUCH)


@njit(**LEAN)
def _add_up(luma, mean, frames, detail, fine, reached, sums):
    """Add up, of squares of 2×2 pixels that stand still, what each tile has.

    That is the power of detail and of what is finer, in how the picture differs from the mean; by
    how much the picture has more of the finest, what differs along both axes, than the mean; what
    is new of that; one over the frames of the mean; and how many squares there are.
    """
    rows, columns = sums.shape[1:]
    scale, quarter = UNIT * UNIT / 4, np.float32(0.25)
    for y in range(0, luma.shape[0] - 1, 2):
        at = tile_of(y, rows)
        for x in range(0, luma.shape[1] - 1, 2):
            if reached[y, x] | reached[y, x + 1] | reached[y + 1, x] | reached[y + 1, x + 1]:
                continue
            coarse = finer = 0.0
            for j in range(y, y + 2):
                for i in range(x, x + 2):
                    coarse += np.float64(detail[j, i]) * np.float64(detail[j, i])
                    finer += np.float64(fine[j, i]) * np.float64(fine[j, i])
            now = luma[y, x] - luma[y, x + 1] - (luma[y + 1, x] - luma[y + 1, x + 1])
            old = mean[y, x] - mean[y, x + 1] - (mean[y + 1, x] - mean[y + 1, x + 1])
            tile = tile_of(x, columns)
            sums[0, at, tile] += scale * coarse
            sums[1, at, tile] += scale * finer
            sums[2, at, tile] += quarter * (now * now - old * old)
            sums[3, at, tile] += quarter * (now - old) * (now - old)
            sums[4, at, tile] += np.float32(1.0) / frames[y, x]
            sums[5, at, tile] += 1
