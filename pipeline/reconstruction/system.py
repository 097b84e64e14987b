"""The normal equations of super-resolution, gathered once on the HR grid.

Because the PSF is common to all views, an observation is a sample of *one* blurred
image g = B f, taken at its landing point (thesis Eq. 6, Eq. 8). Sampled with a quadratic
B-spline of nine taps s, all observations together enter the normal equations

    (Bᵀ M B + λ P) f = Bᵀ b,   M = Σ w s sᵀ,   b = Σ w s y,

where M is a symmetric 5 × 5 stencil on the HR grid: 13 numbers a pixel. An iteration
then costs two separable blurs and one stencil, however many views there are.
The weighted graph Laplacian P is the edge-preserving prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from pipeline.reconstruction import kernels
from pipeline.reconstruction.psf import SeparableTaps, blur
from pipeline.threads import map_threads

PAD = 2
"""Zero pixels around stencil and image, so that the stencil needs no border case."""

NUM_BANDS = 4
"""Bands of HR rows that are worked on side by side; fixed, so that sums never reorder."""

HrImage = npt.NDArray[np.float32]
"""(K·H, K·W) float32."""


def bands(height: int) -> list[tuple[int, int]]:
    """Return the half-open row ranges of the bands of an HR image."""
    edges = np.linspace(0, height, min(NUM_BANDS, height) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


def padded(image: HrImage, mode: str) -> HrImage:
    """Return the image with ``PAD`` pixels around it: zeros ("constant") or "symmetric"."""
    return np.pad(image, PAD, mode=mode)  # type: ignore[call-overload]


class NormalEquations:
    """Accumulates observations, then applies the system's matrix and solves it.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the HR grid.
    taps : SeparableTaps
        From the estimate to spline coefficients, see :func:`psf.sampling_taps`.
    """

    def __init__(self, shape: tuple[int, int], taps: SeparableTaps) -> None:
        self.shape = shape
        self.taps = taps
        height, width = shape
        self._couplings = np.zeros((kernels.NUM_COUPLINGS, height + 4, width + 4), np.float32)
        self._rhs = np.zeros(shape, np.float32)

    def gather(self, observations: Sequence[tuple[HrImage, HrImage, HrImage, HrImage]]) -> None:
        """Add observations: (x, y, value, weight) of each view, (H, W) float32, HR pixels."""
        inner = self._couplings[:, PAD:-PAD, PAD:-PAD]

        def add(band: tuple[int, int]) -> None:
            for x, y, value, weight in observations:
                kernels.gather_observations(x, y, value, weight, *band, inner, self._rhs)

        map_threads(add, bands(self.shape[0]))

    @property
    def density(self) -> HrImage:
        """(KH, KW): weight of the observations around each HR pixel (the stencil's diagonal)."""
        return self._couplings[0, PAD:-PAD, PAD:-PAD]

    def apply(self, image: HrImage, prior: npt.NDArray[np.float32], strength: float) -> HrImage:
        """Return (Bᵀ M B + λ P) times the image, a new array.

        Parameters
        ----------
        prior : (4, KH + 2, KW + 2) float32
            Edge weights, see :func:`kernels.edge_weights`.
        strength : float
            λ.
        """
        coefficients = padded(blur(image, self.taps), "constant")
        sampled = np.empty(self.shape, np.float32)
        split = bands(self.shape[0])
        map_threads(
            lambda band: kernels.apply_couplings(self._couplings, coefficients, *band, sampled),
            split,
        )
        result = blur(sampled, self.taps)
        surrounded = padded(image, "constant")
        map_threads(
            lambda band: kernels.apply_prior(prior, surrounded, *band, strength, result), split
        )
        return result

    def edge_weights(self, estimate: HrImage, scale: float) -> npt.NDArray[np.float32]:
        """Return the prior's weights at an estimate, (4, KH + 2, KW + 2) float32."""
        height, width = self.shape
        weights = np.zeros((4, height + 2, width + 2), np.float32)
        map_threads(
            lambda band: kernels.edge_weights(estimate, scale, *band, weights), bands(height)
        )
        return weights

    def descend(
        self, estimate: HrImage, prior: npt.NDArray[np.float32], strength: float, iterations: int
    ) -> HrImage:
        """Return the estimate after so many steps of conjugate gradients, a new array."""
        estimate = estimate.copy()
        residual = blur(self._rhs, self.taps)
        residual -= self.apply(estimate, prior, strength)
        direction = residual.copy()
        energy = float(np.vdot(residual, residual))
        for _ in range(iterations):
            applied = self.apply(direction, prior, strength)
            curvature = float(np.vdot(direction, applied))
            if not (energy > 0 and curvature > 0):
                break
            step = np.float32(energy / curvature)
            estimate += step * direction
            residual -= step * applied
            previous, energy = energy, float(np.vdot(residual, residual))
            direction *= np.float32(energy / previous)
            direction += residual
        return estimate


def simulate(
    estimate: HrImage, taps: SeparableTaps, x: HrImage, y: HrImage
) -> npt.NDArray[np.float32]:
    """Return what LR pixels at HR points (x, y) would observe of the estimate; NaN outside.

    Thesis Eq. 8, the sum. Adjoint of the gathering of a residual with unit weights.
    """
    coefficients = padded(blur(estimate, taps), "symmetric")
    return sample(coefficients, x, y)


def sample(coefficients: HrImage, x: HrImage, y: HrImage) -> npt.NDArray[np.float32]:
    """Return spline samples (H, W) at HR points of coefficients padded by ``PAD``."""
    out = np.empty(x.shape, np.float32)
    map_threads(
        lambda band: kernels.sample_spline(coefficients, x, y, *band, out), bands(x.shape[0])
    )
    return out
