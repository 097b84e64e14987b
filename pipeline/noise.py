"""How noisy an LR image is: the standard deviation of additive noise, from one image.

The thresholds T_w and T_R (thesis §2.2, §3.2) and the bound δ₀ of Eq. 7 are
"related with the noise process", which the thesis leaves to be known. Aliased
LR images make it hard to see: detail that was decimated looks like noise, and
estimators that take the whole image's least patch variances (Chen, Zhu & Heng
2015) or its median second difference (Immerkær 1996) call it noise. Here the
smoothest blocks are chosen by their *coarse* detail and measured by their
*fine* detail. In white noise the two are independent, so that the choice does
not bias the measure; in texture they are not, so that it is left out.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import OPTIONS
from pipeline.frames import GreyImage, View
from pipeline.threads import map_threads, shares

BLOCK = 8
"""Side of a block, LR pixels."""

CHOOSING_ORDER = 7
"""Cosine components of orders 1 to this (order: along x plus along y) choose the blocks."""

MEASURING_ORDER = 10
"""Cosine components of this order and above are taken for noise."""

CHOSEN_SHARE = 0.02
"""Share of the usable blocks that are measured."""

FEWEST_CHOSEN = 16
"""Blocks measured at least, where there are as many."""

MOST_BLOCKS = 16_000
"""Blocks looked at, at most: bounds the time, whatever the size of the image."""

CLIPPED = 0.05
"""Nearness to 0 or 255 that counts as clipped, grey levels: scaled 10-bit files are not exact."""

MAD_OF_UNIT_NORMAL = 0.6745
"""Median absolute value of a standard normal variable."""


def _cosines() -> npt.NDArray[np.float32]:
    """Return the orthonormal cosine (DCT-II) components along one axis, one a row."""
    order = np.arange(BLOCK)
    basis = np.cos(np.pi * order[:, None] * (2 * order + 1) / (2 * BLOCK)) * np.sqrt(2 / BLOCK)
    basis[0] /= np.sqrt(2)
    return basis.astype(np.float32)


_COSINES = _cosines()

_ORDERS = np.add.outer(np.arange(BLOCK), np.arange(BLOCK))

_CHOOSES = ((_ORDERS >= 1) & (_ORDERS <= CHOOSING_ORDER)).astype(np.float32)

_MEASURES = (_ORDERS >= MEASURING_ORDER).astype(np.float32)


def estimate_noise(image: GreyImage) -> float:
    """Return the standard deviation of the additive noise of one image, grey levels.

    Not in the thesis, which takes the noise as known.

    Parameters
    ----------
    image : ndarray of shape (H, W), float32
        Grey levels 0..255, LR pixels. NaN marks pixels without a value.

    Returns
    -------
    float
        ≥ 0. The rounding of 8-bit files (σ = 0.29) is part of it. 0 for a constant image.

    Notes
    -----
    The two per cent of the 8 × 8 blocks whose cosine components of orders 1 to 7 have least
    energy are measured: median over the blocks of the mean square of the fifteen components
    of order 10 and above, times what makes the median of a χ² variable its mean.

    *Clipping.* Blocks that touch 0 or 255, and constant blocks at the darkest or brightest
    level of the others (video black, a sky burnt out before it was graded) have lost their
    noise and are not used, unless there is hardly anything else.

    *Noise that is not white.* Fine detail is what is measured: noise that was smoothed with
    the image, by a decoder or a resampling, is underestimated. Noise that grows with
    brightness is measured where the image is smoothest.

    *Small images.* Where a side is below 8 pixels: the median absolute second difference
    along both axes, as far as they have three pixels; it takes texture for noise. 0 where
    no axis has three.

    References
    ----------
    .. [1] N. Ponomarenko, V. Lukin, M. Zriakhov, A. Kaarna, J. Astola, "An automatic approach
       to lossy compression of AVIRIS images", IGARSS 2007 (choice by low frequencies).
    .. [2] M. Colom, A. Buades, "Analysis and extension of the Ponomarenko et al. method,
       estimating a noise curve from a single image", IPOL 3, 2013.
    .. [3] E. B. Wilson, M. M. Hilferty, "The distribution of chi-square", PNAS 1931.
    """
    if min(image.shape) < BLOCK:
        return _from_second_differences(image)
    coarse, fine = _energies(image)
    count = len(coarse)
    if count == 0:
        return 0.0
    num_chosen = min(count, max(FEWEST_CHOSEN, round(CHOSEN_SHARE * count)))
    chosen = np.argpartition(coarse, num_chosen - 1)[:num_chosen]
    measured = int(_MEASURES.sum())
    median_over_mean = (1 - 2 / (9 * measured)) ** 3  # of χ², Wilson & Hilferty 1931
    return float(np.sqrt(np.median(fine[chosen]) / (measured * median_over_mean)))


def estimate_noise_of_views(views: Iterable[View]) -> float:
    """Return the median over the views of the noise of their luma, grey levels.

    The views of a frame come from like cameras; a view that shows nothing but texture,
    or is black, does not decide.

    Raises
    ------
    ValueError
        If there is no view.
    """
    estimates = map_threads(lambda view: estimate_noise(view.luma), views)
    if not estimates:
        raise ValueError("no views to estimate the noise of")
    return float(np.median(estimates))


def _energies(
    image: GreyImage,
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return what the components that choose, and those that measure, have of each usable block.

    Those are finite and not clipped.
    """
    rows, columns = (side - BLOCK + 1 for side in image.shape)
    # Odd, so as not to fall in step with the 8 × 8 blocks of compression.
    stride = 1
    while -(-rows // stride) * -(-columns // stride) > MOST_BLOCKS:
        stride += 2
    found = np.empty((4, -(-rows // stride), -(-columns // stride)), np.float32)
    # writable, for one compilation
    pixels = np.require(image, np.float32, ["C", "W"])

    def look(share: slice) -> None:
        _look_at_blocks(
            pixels, stride, _COSINES, _CHOOSES, _MEASURES, share.start, share.stop, found
        )

    map_threads(look, shares(found.shape[1]))
    found = found.reshape(4, -1)
    is_finite = np.isfinite(found[0])
    if not is_finite.all():
        found = found[:, is_finite]
    if found.shape[1] == 0:
        return found[0], found[1]
    coarse, fine, low, high = found
    usable = (low > CLIPPED) & (high < 255 - CLIPPED)
    if usable.any():
        darkest, brightest = low[usable].min(), high[usable].max()
        usable &= ~((low == high) & ((low == darkest) | (high == brightest)))
    if usable.sum() >= min(FEWEST_CHOSEN, len(usable)):
        return coarse[usable], fine[usable]
    return coarse, fine


@njit(**OPTIONS)
def _look_at_blocks(image, stride, cosines, chooses, measures, lo, hi, found):
    """Write of some blocks the energies that choose and that measure, least and largest level.

    Parameters
    ----------
    image : (H, W) float32
    stride : int
        From block to block, pixels.
    cosines : (BLOCK, BLOCK) float32
        Components along one axis, one a row.
    chooses, measures : (BLOCK, BLOCK) float32
        1 for the components of either kind, by their orders along y and x; else 0.
    lo, hi : int
        Rows of blocks, half-open.
    found : (4, rows, columns) float32
        Of blocks, those overwritten; NaN where a pixel is not finite.
    """
    columns = found.shape[2]
    # a row of blocks at once: what all have in one place lies together
    pixels = np.empty((BLOCK, BLOCK, columns), np.float32)
    halfway = np.empty((BLOCK, BLOCK, columns), np.float32)
    part, total = np.empty(columns, np.float32), np.empty(columns, np.float32)
    first = np.empty(columns, np.float32)
    for row in range(lo, hi):
        coarse, fine, low, high = found[0, row], found[1, row], found[2, row], found[3, row]
        for n in range(columns):
            first[n] = image[row * stride, n * stride]
            low[n] = high[n] = first[n]
            total[n] = coarse[n] = fine[n] = np.float32(0.0)
        for i in range(BLOCK):
            for j in range(BLOCK):
                line, out = image[row * stride + i, j:], pixels[j, i]
                for n in range(columns):
                    part[n] = line[n * stride]
                for n in range(columns):
                    low[n], high[n] = min(low[n], part[n]), max(high[n], part[n])
                    total[n] += part[n]
                    # differences of nearby levels lose nothing in float32
                    out[n] = part[n] - first[n]
        for order in range(BLOCK):
            for j in range(BLOCK):
                _component(pixels[j], cosines[order], halfway[order, j])
        for down in range(BLOCK):
            for across in range(BLOCK):
                _component(halfway[down], cosines[across], part)
                _add_squares(part, chooses[down, across], coarse)
                _add_squares(part, measures[down, across], fine)
        for n in range(columns):
            if total[n] - total[n] != 0:
                coarse[n] = np.float32(np.nan)


@njit(**OPTIONS)
def _component(lines, taps, out):
    """Write the weighted sum of BLOCK lines."""
    a, b, c, d = taps[0], taps[1], taps[2], taps[3]
    e, f, g, h = taps[4], taps[5], taps[6], taps[7]
    l0, l1, l2, l3, l4, l5, l6, l7 = (
        lines[0], lines[1], lines[2], lines[3], lines[4], lines[5], lines[6], lines[7]
    )  # fmt: skip
    for n in range(out.size):
        out[n] = (a * l0[n] + b * l1[n] + (c * l2[n] + d * l3[n])) + (
            e * l4[n] + f * l5[n] + (g * l6[n] + h * l7[n])
        )


@njit(**OPTIONS)
def _add_squares(line, share, out):
    if share > 0:
        for n in range(out.size):
            out[n] += line[n] * line[n]


def _from_second_differences(image: GreyImage) -> float:
    """Return the noise of an image that has no block, grey levels."""
    differences = np.concatenate(
        [np.diff(image.astype(np.float64), n=2, axis=axis).ravel() for axis in (0, 1)]
    )
    differences = np.abs(differences[np.isfinite(differences)])
    if differences.size == 0:
        return 0.0
    return float(np.median(differences) / MAD_OF_UNIT_NORMAL / np.sqrt(6))  # 1² + 2² + 1²
