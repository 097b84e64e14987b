"""Full-reference quality measures of luma, computed in float64.

PSNR (thesis §5), SSIM of Wang et al. 2004 [1]_, MS-SSIM of Wang et al. 2003 [2]_, and
a measure of two eyes together, :func:`binocular_psnr`. The module knows neither files
nor frames.

References
----------
.. [1] Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image quality
   assessment: from error visibility to structural similarity", IEEE Trans.
   Image Processing 13(4), 2004.
.. [2] Z. Wang, E. P. Simoncelli, A. C. Bovik, "Multi-scale structural similarity for
   image quality assessment", 37th Asilomar Conference on Signals, Systems and Computers,
   2003.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

SSIM_WINDOW = 11
"""Width of the SSIM window, pixels."""

SSIM_SIGMA = 1.5
"""Standard deviation of the SSIM window, pixels."""

SSIM_K1 = 0.01
SSIM_K2 = 0.03
"""Stabilising constants of [1], as fractions of the peak."""

MS_SSIM_EXPONENTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""β₁…β₅ of [2], finest scale first."""


def psnr(
    image: npt.ArrayLike, reference_image: npt.ArrayLike, *, peak: float = 255.0, border: int = 0
) -> float:
    """Return the peak signal-to-noise ratio, dB; ``inf`` for identical images.

    Parameters
    ----------
    image, reference_image : array_like of shape (H, W) or (H, W, C)
        Grey levels.
    peak : float
        Largest possible value, grey levels.
    border : int
        Pixels left out at each of the four borders.

    Notes
    -----
    10·log₁₀(peak² / mean squared error), the mean over all pixels that the
    border leaves. Zero error has no finite PSNR: infinity is the value, not
    an error; JSON writers turn it into null.

    Examples
    --------
    >>> import numpy as np
    >>> round(psnr(np.zeros((3, 5)), np.full((3, 5), 255.0)), 6)
    0.0
    """
    first, second = _cropped(image, reference_image, border)
    error = float(np.mean((first - second) ** 2))
    if error == 0:
        return math.inf
    return 10.0 * math.log10(peak * peak / error)


def ssim_map(
    image: npt.ArrayLike, reference_image: npt.ArrayLike, *, peak: float = 255.0
) -> npt.NDArray[np.float64]:
    """Return SSIM at every pixel whose whole window lies in the image.

    Returns
    -------
    ndarray of shape (H − 10, W − 10), float64
        −1..1; 1 where the windows are alike.

    Raises
    ------
    ValueError
        If the images differ in shape or are smaller than the window.
    """
    first, second = _cropped(image, reference_image, 0)
    luminance, structure = _ssim_terms(first, second, peak)
    return np.asarray(luminance * structure)


def ssim(
    image: npt.ArrayLike, reference_image: npt.ArrayLike, *, peak: float = 255.0, border: int = 0
) -> float:
    """Return the mean structural similarity, 1 for identical images.

    The border is cut first; then the mean is taken over the windows that lie
    wholly in what is left ("valid" region), as the authors' own program does.
    Their optional down-sampling to about 256 pixels is not done.
    """
    first, second = _cropped(image, reference_image, border)
    return float(np.mean(ssim_map(first, second, peak=peak)))


def ms_ssim(
    image: npt.ArrayLike, reference_image: npt.ArrayLike, *, peak: float = 255.0, border: int = 0
) -> float:
    """Return the multi-scale structural similarity, 1 for identical images.

    Notes
    -----
    Eq. (7) of [2]: contrast and structure at five scales, each half the size of the one
    before (mean of 2×2 pixels), luminance at the coarsest. An image whose coarsest scales
    would be smaller than the window is measured at as many scales as fit, their exponents
    scaled to the sum of all; figures of such small images compare among themselves only.
    Negative means of a scale count as 0.
    """
    first, second = _cropped(image, reference_image, border)
    terms = []
    for scale in range(len(MS_SSIM_EXPONENTS)):
        if scale and min(first.shape) // 2 < SSIM_WINDOW:
            break
        if scale:
            first, second = _halved(first), _halved(second)
        terms.append(_ssim_terms(first, second, peak))
    exponents = np.array(MS_SSIM_EXPONENTS[: len(terms)])
    exponents *= sum(MS_SSIM_EXPONENTS) / exponents.sum()
    means = [float(np.mean(structure)) for _, structure in terms[:-1]]
    luminance, structure = terms[-1]
    means.append(float(np.mean(luminance * structure)))
    return float(np.prod(np.maximum(means, 0.0) ** exponents))


def binocular_psnr(
    errors: tuple[npt.ArrayLike, npt.ArrayLike],
    position: npt.ArrayLike,
    seen_by_both: npt.ArrayLike,
    *,
    peak: float = 255.0,
    border: int = 0,
) -> float:
    """Return how far the errors of the two eyes agree, dB; ``inf`` where they are the same.

    Parameters
    ----------
    errors : pair of array_like of shape (H, W)
        Left and right picture minus their truths, grey levels.
    position : array_like of shape (H, W, 2)
        Where each pixel of the left picture lies in the right one, as (x, y), pixels.
    seen_by_both : array_like of shape (H, W), bool
        Pixels of the left picture whose surface the right eye sees, too.
    border : int
        Pixels left out at each border of either picture.

    Notes
    -----
    Not in the thesis. 10·log₁₀(peak² / mean of (e_L(p) − e_R(q(p)))²) over the pixels p
    that both eyes see, q(p) being the same surface point in the right eye. An error that is
    the same in both eyes fuses into a stable, if wrong, surface; one that is in one eye only
    is seen as shimmer and rivalry, which a mean of two PSNRs cannot tell. Independent
    errors of equal power come out 3 dB below PSNR, common ones far above it.
    """
    left, right = (np.asarray(error, np.float32) for error in errors)
    place = np.asarray(position, np.float32)
    height, width = left.shape
    x, y = place[..., 0], place[..., 1]
    use = np.asarray(seen_by_both, bool) & np.isfinite(x) & np.isfinite(y)
    with np.errstate(invalid="ignore"):
        use &= (x >= border) & (x <= width - 1 - border)
        use &= (y >= border) & (y <= height - 1 - border)
    inner = np.zeros((height, width), bool)
    inner[border : height - border, border : width - border] = True
    use &= inner
    if not use.any():
        return math.nan
    moved = cv2.remap(right, np.where(use, x, 0), np.where(use, y, 0), cv2.INTER_LINEAR)
    error = float(np.mean((left[use].astype(float) - moved[use]) ** 2))
    return math.inf if error == 0 else 10.0 * math.log10(peak * peak / error)


def _ssim_terms(
    first: npt.NDArray[np.float64], second: npt.NDArray[np.float64], peak: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the luminance term, and contrast times structure, of [1] where windows fit."""
    if first.ndim != 2 or min(first.shape) < SSIM_WINDOW:
        raise ValueError(
            f"SSIM needs a grey image of {SSIM_WINDOW}×{SSIM_WINDOW} pixels or more, "
            f"not one of shape {first.shape}"
        )
    offsets = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    taps = np.exp(-(offsets**2) / (2 * SSIM_SIGMA**2))
    taps /= taps.sum()
    half = SSIM_WINDOW // 2

    def mean(values: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        smooth = cv2.sepFilter2D(values, cv2.CV_64F, taps, taps)
        return np.asarray(smooth[half:-half, half:-half])

    mean_1, mean_2 = mean(first), mean(second)
    variance_1 = mean(first * first) - mean_1 * mean_1
    variance_2 = mean(second * second) - mean_2 * mean_2
    covariance = mean(first * second) - mean_1 * mean_2
    c1, c2 = (SSIM_K1 * peak) ** 2, (SSIM_K2 * peak) ** 2
    luminance = (2 * mean_1 * mean_2 + c1) / (mean_1**2 + mean_2**2 + c1)
    structure = (2 * covariance + c2) / (variance_1 + variance_2 + c2)
    return luminance, structure  # their product is Eq. (13) of [1]


def _halved(image: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the mean of every 2×2 pixels; an odd last row or column is left out."""
    height, width = (side - side % 2 for side in image.shape)
    even = image[:height, :width]
    return np.asarray((even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4)


def _cropped(
    image: npt.ArrayLike, reference_image: npt.ArrayLike, border: int
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    first = np.asarray(image, dtype=np.float64)
    second = np.asarray(reference_image, dtype=np.float64)
    if first.shape != second.shape:
        raise ValueError(f"images differ in shape: {first.shape} and {second.shape}")
    height, width = first.shape[:2]
    if border < 0 or 2 * border >= min(height, width):
        raise ValueError(f"a border of {border} pixels leaves nothing of {width}×{height}")
    inner = (slice(border, height - border), slice(border, width - border))
    return first[inner], second[inner]
