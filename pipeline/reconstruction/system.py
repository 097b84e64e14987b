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
"""Pixels around stencil and images, so that the loops need no border case."""

NUM_BANDS = 4
"""Bands of HR rows that are worked on side by side; fixed, so that sums never reorder."""

SHARPENING = 16.0
"""β of the preconditioner; halves the iterations against none, little changed from 4 to 25."""

HrImage = npt.NDArray[np.float32]
"""(K·H, K·W) float32."""


def bands(height: int) -> list[tuple[int, int]]:
    """Return the half-open row ranges of the bands of an HR image."""
    edges = np.linspace(0, height, min(NUM_BANDS, height) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


def padded(image: HrImage) -> HrImage:
    """Return the image with ``PAD`` pixels around it, reflected about its edge."""
    return np.pad(image, PAD, mode="symmetric")


class NormalEquations:
    """Accumulates observations, then applies the system's matrix and solves it.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the HR grid.
    taps : SeparableTaps
        From the estimate to spline coefficients, see :func:`psf.sampling_taps`.
    sharpening : SeparableTaps
        The PSF, for the preconditioner.
    """

    def __init__(
        self, shape: tuple[int, int], taps: SeparableTaps, sharpening: SeparableTaps
    ) -> None:
        self.shape = shape
        self.taps = taps
        self.sharpening = sharpening
        height, width = shape
        # the padding also keeps the planes from lying a power of two apart in memory,
        # where they would compete for the same lines of the processor's cache
        self._couplings = np.zeros((kernels.NUM_COUPLINGS, height + 4, width + 4), np.float32)
        self._rhs = np.zeros(shape, np.float32)
        self._bands = bands(shape[0])
        self.steps = 0

    def gather(self, observations: Sequence[tuple[HrImage, HrImage, HrImage, HrImage]]) -> None:
        """Add observations: (x, y, value, weight) of each view, (H, W) float32, HR pixels."""
        inner = self._couplings[:, PAD:-PAD, PAD:-PAD]

        def add(band: tuple[int, int]) -> None:
            for x, y, value, weight in observations:
                kernels.gather_observations(x, y, value, weight, *band, inner, self._rhs)

        map_threads(add, self._bands)

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
        coefficients = np.pad(blur(image, self.taps), PAD)
        sampled = np.empty(self.shape, np.float32)
        map_threads(
            lambda band: kernels.apply_couplings(self._couplings, coefficients, *band, sampled),
            self._bands,
        )
        result = blur(sampled, self.taps)
        surrounded = np.pad(image, PAD)
        map_threads(
            lambda band: kernels.apply_prior(prior, surrounded, *band, strength, result),
            self._bands,
        )
        return result

    def edge_weights(self, estimate: HrImage, scale: float) -> npt.NDArray[np.float32]:
        """Return the prior's weights at an estimate, (4, KH + 2, KW + 2) float32."""
        height, width = self.shape
        weights = np.zeros((4, height + 2, width + 2), np.float32)
        map_threads(lambda band: kernels.edge_weights(estimate, scale, *band, weights), self._bands)
        return weights

    def descend(
        self,
        estimate: HrImage,
        prior: npt.NDArray[np.float32],
        strength: float,
        iterations: int,
        *,
        settled: float = 0.0,
    ) -> HrImage:
        """Return the estimate after some steps of conjugate gradients, a new array.

        Preconditioned, see :meth:`_sharpen`. Ends after ``iterations`` steps, or when the
        (preconditioned) residual has fallen to the share ``settled`` of what it was;
        ``steps`` counts them.
        """
        estimate = estimate.copy()
        residual = blur(self._rhs, self.taps)
        residual -= self.apply(estimate, prior, strength)
        sharpened = self._sharpen(residual)
        direction = sharpened.copy()
        first = energy = self._dot(residual, sharpened)
        for iteration in range(iterations):
            applied = self.apply(direction, prior, strength)
            curvature = self._dot(direction, applied)
            if not (energy > 0 and curvature > 0):
                break
            self._advance(energy / curvature, direction, applied, estimate, residual)
            self.steps += 1
            if iteration + 1 == iterations:
                break
            sharpened = self._sharpen(residual)
            previous, energy = energy, self._dot(residual, sharpened)
            if energy < settled**2 * first:
                break
            self._turn(energy / previous, sharpened, direction)
        return estimate

    def _dot(self, first: HrImage, second: HrImage) -> float:
        """Return the scalar product; the bands are fixed, so it is the same on any machine."""
        return float(sum(map_threads(lambda band: kernels.dot(first, second, *band), self._bands)))

    def _advance(
        self, step: float, direction: HrImage, applied: HrImage, estimate: HrImage,
        residual: HrImage,
    ) -> None:  # fmt: skip
        map_threads(
            lambda band: kernels.advance(step, direction, applied, estimate, residual, *band),
            self._bands,
        )

    def _turn(self, factor: float, sharpened: HrImage, direction: HrImage) -> None:
        map_threads(lambda band: kernels.turn(factor, sharpened, direction, *band), self._bands)

    def _sharpen(self, image: HrImage) -> HrImage:
        """Return (1 + β) I − β G times the image: the preconditioner, a new array.

        What the PSF has weakened converges slowly; a step of unsharp masking with the PSF
        itself weighs it up. Symmetric, and positive definite as 0 ≤ G ≤ 1.
        """
        blurred = blur(image, self.sharpening)
        result = np.empty(self.shape, np.float32)
        map_threads(
            lambda band: kernels.sharpen(image, blurred, SHARPENING, *band, result), self._bands
        )
        return result


def simulate(
    estimate: HrImage, taps: SeparableTaps, x: HrImage, y: HrImage
) -> npt.NDArray[np.float32]:
    """Return what LR pixels at HR points (x, y) would observe of the estimate; NaN outside.

    Thesis Eq. 8, the sum. Adjoint of the gathering of a residual with unit weights.
    """
    coefficients = padded(blur(estimate, taps))
    return sample(coefficients, x, y)


def sample(coefficients: HrImage, x: HrImage, y: HrImage) -> npt.NDArray[np.float32]:
    """Return spline samples (H, W) at HR points of coefficients padded by ``PAD``."""
    out = np.empty(x.shape, np.float32)
    map_threads(
        lambda band: kernels.sample_spline(coefficients, x, y, *band, out), bands(x.shape[0])
    )
    return out
