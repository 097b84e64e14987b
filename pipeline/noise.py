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

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, View
from pipeline.threads import map_threads

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


def _components() -> tuple[npt.NDArray[np.float32], int]:
    """Return the orthonormal cosine (DCT-II) components that are needed, and how many choose.

    Returns
    -------
    components : (BLOCK², M) float32
        One a column; those that choose first, then those that measure.
    num_choosing : int
    """
    order = np.arange(BLOCK)
    basis = np.cos(np.pi * order[:, None] * (2 * order + 1) / (2 * BLOCK)) * np.sqrt(2 / BLOCK)
    basis[0] /= np.sqrt(2)
    both = np.kron(basis, basis)
    orders = (order[:, None] + order).ravel()
    choosing = both[(orders >= 1) & (orders <= CHOOSING_ORDER)]
    measuring = both[orders >= MEASURING_ORDER]
    components = np.concatenate([choosing, measuring]).T.astype(np.float32)
    return np.ascontiguousarray(components), len(choosing)


_COMPONENTS, _NUM_CHOOSING = _components()


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
    blocks = _usable_blocks(image)
    if len(blocks) == 0:
        return 0.0
    # not NumPy's product: its last bits follow the number of cores
    energies = np.square(cv2.gemm(np.ascontiguousarray(blocks), _COMPONENTS, 1.0, None, 0.0))
    coarse = energies[:, :_NUM_CHOOSING].sum(axis=1)
    num_chosen = min(len(blocks), max(FEWEST_CHOSEN, round(CHOSEN_SHARE * len(blocks))))
    chosen = np.argpartition(coarse, num_chosen - 1)[:num_chosen]
    fine = energies[chosen, _NUM_CHOOSING:]
    median_over_mean = (1 - 2 / (9 * fine.shape[1])) ** 3  # of χ², Wilson & Hilferty 1931
    return float(np.sqrt(np.median(fine.mean(axis=1)) / median_over_mean))


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


def _usable_blocks(image: GreyImage) -> npt.NDArray[np.float32]:
    """Return (N, BLOCK²) blocks, less their upper left pixel, that are finite and not clipped."""
    windows = np.lib.stride_tricks.sliding_window_view(image, (BLOCK, BLOCK))
    # Odd, so as not to fall in step with the 8 × 8 blocks of compression.
    stride = 1
    while -(-windows.shape[0] // stride) * -(-windows.shape[1] // stride) > MOST_BLOCKS:
        stride += 2
    blocks = windows[::stride, ::stride].reshape(-1, BLOCK * BLOCK)
    blocks = blocks[np.isfinite(blocks).all(axis=1)]
    if len(blocks) == 0:
        return blocks
    low, high = blocks.min(axis=1), blocks.max(axis=1)
    usable = (low > CLIPPED) & (high < 255 - CLIPPED)
    if usable.any():
        darkest, brightest = low[usable].min(), high[usable].max()
        usable &= ~((low == high) & ((low == darkest) | (high == brightest)))
    if usable.sum() >= min(FEWEST_CHOSEN, len(blocks)):
        blocks = blocks[usable]
    # Differences of nearby levels lose nothing in float32.
    return blocks - blocks[:, :1]


def _from_second_differences(image: GreyImage) -> float:
    """Return the noise of an image that has no block, grey levels."""
    differences = np.concatenate(
        [np.diff(image.astype(np.float64), n=2, axis=axis).ravel() for axis in (0, 1)]
    )
    differences = np.abs(differences[np.isfinite(differences)])
    if differences.size == 0:
        return 0.0
    return float(np.median(differences) / MAD_OF_UNIT_NORMAL / np.sqrt(6))  # 1² + 2² + 1²
