"""Full-reference quality measures of luma: PSNR and SSIM, computed in float64.

Values are those of thesis §5 (PSNR) and of Wang et al. 2004 (SSIM). The
module knows neither files nor frames.

References
----------
.. [1] Z. Wang, A. C. Bovik, H. R. Sheikh, E. P. Simoncelli, "Image quality
   assessment: from error visibility to structural similarity", IEEE Trans.
   Image Processing 13(4), 2004.
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
    numerator = (2 * mean_1 * mean_2 + c1) * (2 * covariance + c2)  # Eq. (13) of [1]
    denominator = (mean_1**2 + mean_2**2 + c1) * (variance_1 + variance_2 + c2)
    return np.asarray(numerator / denominator)


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
