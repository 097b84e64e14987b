"""The point spread function (PSF): a unit-sum kernel on the HR grid (thesis §3.1.1, §3.2).

Holds the PSF itself and the spline that lets one blur serve every sub-pixel
position: instead of evaluating a K_psf × K_psf kernel for each LR pixel, the
estimate is blurred once and sampled with a quadratic B-spline. The prefilter
that turns blurred pixels into spline coefficients is folded into the blur.
Knows nothing of views or files.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.grid import Grid

Taps = npt.NDArray[np.float64]
"""(odd,) float64, symmetric one-dimensional kernel."""


@dataclass(frozen=True, kw_only=True)
class GaussianPsf:
    """A separable, truncated, unit-sum Gaussian (thesis Figure 8).

    Examples
    --------
    >>> psf = GaussianPsf(sigma=1.7, support=7)
    >>> psf.taps_at(0.0).shape, round(float(psf.taps_at(0.3).sum()), 6)
    ((7,), 1.0)
    """

    sigma: float
    """σ_psf, HR pixels, > 0."""

    support: int
    """K_psf, HR pixels, odd."""

    @classmethod
    def of(cls, sigma: float, support: int | None = None) -> GaussianPsf:
        """Return the PSF of that σ; the support defaults to the odd number above six σ."""
        return cls(sigma=sigma, support=support or 2 * int(np.ceil(3 * sigma)) + 1)

    def taps_at(self, fraction: float) -> Taps:
        """Return the unit-sum taps of a PSF centred ``fraction`` HR pixels right of the middle tap.

        "We obtain the 2D discrete PSF coefficients by sampling the continuous PSF
        generating function at integer locations of the HR grid" (thesis §3.1.1).
        """
        offsets = np.arange(self.support) - self.support // 2 - fraction
        taps = np.exp(-0.5 * (offsets / self.sigma) ** 2)
        return taps / taps.sum()

    @property
    def energy(self) -> float:
        """Σh² of the two-dimensional kernel at a whole HR position: Eq. 10's step over Eq. 9's."""
        return float((self.taps_at(0.0) ** 2).sum() ** 2)


@dataclass(frozen=True, kw_only=True)
class BicubicPsf:
    """What software that reduces pictures by antialiased bicubic interpolation sees through.

    The cubic of Keys (1981) with a = −½, stretched by K: MATLAB's ``imresize``, Pillow,
    FFmpeg's ``bicubic``. Unlike a Gaussian it has negative lobes and keeps more of what
    the LR grid can hold.
    """

    magnification: int
    """K, the factor that the picture was reduced by."""

    @property
    def support(self) -> int:
        """HR pixels, odd: all that the stretched cubic reaches from between two pixels."""
        return 4 * self.magnification + 1

    @property
    def sigma(self) -> float:
        """σ of the Gaussian that passes frequencies most alike, HR pixels."""
        return 0.4 * self.magnification

    def taps_at(self, fraction: float) -> Taps:
        """Return the unit-sum taps of a PSF centred ``fraction`` HR pixels right of the middle."""
        x = np.abs(np.arange(self.support) - self.support // 2 - fraction) / self.magnification
        inner = (1.5 * x - 2.5) * x * x + 1
        outer = ((-0.5 * x + 2.5) * x - 4) * x + 2
        taps = np.where(x <= 1, inner, np.where(x < 2, outer, 0.0))
        return np.asarray(taps / taps.sum())


Psf = GaussianPsf | BicubicPsf


SPLINE_POLE = np.sqrt(8.0) - 3.0
"""Pole of the quadratic B-spline's interpolation prefilter (Unser 1999, Table 1)."""

PREFILTER_REACH = 4
"""Taps kept on each side: |pole|⁵ is below 2·10⁻⁴."""


def coefficient_taps(taps: Taps) -> Taps:
    """Return the taps that blur *and* turn pixels into quadratic-spline coefficients.

    The interpolation prefilter's impulse response is
    ``(1 + z) / (1 - z)``-scaled ``z**|k|`` with z the pole (Unser 1999); truncated and
    renormalised to unit sum it is convolved with the PSF.

    Parameters
    ----------
    taps : (K_psf,) float64
        Symmetric unit-sum PSF taps, HR pixels.

    Returns
    -------
    (K_psf + 2·PREFILTER_REACH,) float64
        Symmetric unit-sum taps.
    """
    reach = np.abs(np.arange(-PREFILTER_REACH, PREFILTER_REACH + 1))
    prefilter = SPLINE_POLE**reach
    return np.convolve(taps, prefilter / prefilter.sum())


@dataclass(frozen=True, kw_only=True, eq=False)
class SeparableTaps:
    """One kernel for each axis of the HR grid."""

    x: Taps
    y: Taps


def psf_axes(psf: Psf, grid: Grid) -> tuple[Psf | None, Psf | None]:
    """Return the PSF along x and along y: None, no blur, along an axis that is not enlarged.

    Side-by-side material is squeezed along x alone; along y its pixels are as they were.
    """
    return (
        psf if grid.magnification_x > 1 else None,
        psf if grid.magnification_y > 1 else None,
    )


@functools.lru_cache(maxsize=8)
def psf_taps(psf: Psf, grid: Grid) -> SeparableTaps:
    """Return the taps of the PSF along both axes, at whole HR positions."""
    x, y = (np.ones(1) if axis is None else axis.taps_at(0.0) for axis in psf_axes(psf, grid))
    return SeparableTaps(x=x, y=y)


@functools.lru_cache(maxsize=8)
def sampling_taps(psf: Psf, grid: Grid) -> SeparableTaps:
    """Return the taps from an estimate to the spline coefficients that observations sample."""
    x, y = (
        coefficient_taps(np.ones(1) if axis is None else axis.taps_at(0.0))
        for axis in psf_axes(psf, grid)
    )
    return SeparableTaps(x=x, y=y)


def blur(image: npt.NDArray, taps: SeparableTaps) -> npt.NDArray[np.float32]:
    """Return the image convolved with separable symmetric taps, a new array.

    The border reflects about the edge of the outermost pixel
    (``BORDER_REFLECT``): with symmetric taps that makes the operator its own
    adjoint, which conjugate gradients rely on. A kernel wider than the image
    is fine.
    """
    along_x, along_y = taps.x.astype(np.float32), taps.y.astype(np.float32)
    reach_x, reach_y = along_x.size // 2, along_y.size // 2
    height, width = image.shape
    if reach_x < width and reach_y < height:
        return cv2.sepFilter2D(image, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_REFLECT)
    padded = np.pad(image, ((reach_y, reach_y), (reach_x, reach_x)), mode="symmetric")
    full = cv2.sepFilter2D(padded, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_CONSTANT)
    return np.ascontiguousarray(full[reach_y : reach_y + height, reach_x : reach_x + width])
