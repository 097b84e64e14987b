"""The default solver: all trusted observations at once, weighted, with an edge-preserving prior.

Not in the thesis, which visits LR pixels one after another (Eq. 9, Eq. 10; see ``pocs``);
the constraints and the PSF are the same. Two rounds:

1. the reference view alone is reconstructed;
2. every other view's pixels are predicted from that result, and weighted by how well
   they agree with it around them; then all are fused.

So no view can do harm by having been misregistered. The prior (Charbonnier penalty of the
first differences, by iterative re-weighting) and the weights follow the noise.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, RegisteredView, Rejection
from pipeline.grid import Grid
from pipeline.reconstruction.psf import Psf, psf_taps, sampling_taps
from pipeline.reconstruction.system import HrImage, NormalEquations, sample, spline_coefficients

IMPOSSIBLE = np.uint8(
    Rejection.NO_MOTION
    | Rejection.OUTSIDE
    | Rejection.OCCLUDED
    | Rejection.DEPTH
    | Rejection.RESIDUAL
)
"""Reasons that exclude a pixel here. The others (weight, edge) are suspicions: hard constraints
must do without such pixels (POCS), weighted ones are left to the agreement weights."""

LARGEST_ERROR = 50.0
"""Prediction errors are cut off here before they are averaged, grey levels."""

SMALLEST_NOISE = 0.3
"""Noise below which nothing gets easier: the rounding of 8-bit input, grey levels."""


@dataclass(frozen=True, kw_only=True)
class FusedTuning:
    """The constants of the solver, measured on the sample and on real scenes."""

    prior_strength: float = 0.078
    """λ at noise 1 and σ_psf 1."""
    prior_noise_power: float = 1.6
    """λ grows with the noise to this power …"""
    prior_psf_power: float = -1.5
    """… and with σ_psf to this one: what a wide PSF has removed no prior should smooth again."""
    edge_scale: tuple[float, float] = (4.0, 4.0)
    """Difference below which the prior is quadratic: constant and factor on the noise, grey."""
    agreement: tuple[float, float] = (1.0, 2.0)
    """Prediction error that is tolerated: constant a, and factor b on the noise, grey."""
    severity: float = 4.0
    """Factor c on the excess of the low-passed error."""
    low_pass: float = 0.8
    """σ of the low-pass on the prediction error, LR pixels."""
    box: int = 5
    """Side of the box over which its square is averaged, LR pixels."""
    alone: tuple[int, int] = (2, 8)
    """Re-weightings, and at most so many conjugate-gradient steps each: reference alone."""
    together: tuple[int, int] = (4, 8)
    """The same for all views."""
    settled: float = 0.3
    """Share of its first residual at which a descent has come far enough, at noise 1 and above;
    in proportion to the noise below: the less there is, the longer it pays to go on."""
    only: tuple[int, int] = (4, 8)
    """The same where the reference is the only view: as much work as for many."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FusedResult:
    """What the solver made, and of what."""

    estimate: HrImage
    """(K·H, K·W) float32, grey levels, not clipped."""
    weights: tuple[GreyImage, ...]
    """Per registered view, (H, W) float32 0..1."""
    flags: tuple[npt.NDArray[np.uint8], ...]
    """Per registered view: its flags, with the residual test added."""
    simulated: tuple[GreyImage, ...]
    """Per registered view, (H, W): what the estimate predicts; NaN outside."""
    density: HrImage
    """(K·H, K·W): weight of the observations around each HR pixel."""
    iterations: int
    residuals: tuple[float, ...]
    """RMS of the weighted residual after each round, grey levels."""
    stop_reason: str


def initial_estimate(reference: GreyImage, grid: Grid) -> HrImage:
    """Return the reference view enlarged by bicubic interpolation at the grid's phase."""
    height, width = grid.hr_shape(reference.shape)
    matrix = np.array(
        [
            [1 / grid.magnification_x, 0, -grid.offset_x / grid.magnification_x],
            [0, 1 / grid.magnification_y, -grid.offset_y / grid.magnification_y],
        ]
    )
    return cv2.warpAffine(
        reference, matrix, (width, height),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE,
    )  # fmt: skip


def prior_strength(noise: float, psf_sigma: float, tuning: FusedTuning) -> float:
    """Return λ for a noise (grey levels) and a PSF (HR pixels)."""
    noise = max(noise, SMALLEST_NOISE)
    psf_sigma = max(psf_sigma, 0.5)
    return (
        tuning.prior_strength * noise**tuning.prior_noise_power * psf_sigma**tuning.prior_psf_power
    )


def agreement_weights(
    error: GreyImage, noise: float, tuning: FusedTuning
) -> npt.NDArray[np.float32]:
    """Return the weight of each LR pixel from the prediction error around it, (H, W) 0..1.

    The error is low-passed first: what the reference view alone cannot predict, because it
    is aliased, is exactly what the other views bring, and lies near the LR Nyquist limit;
    a wrong position shows at lower frequencies too. With e² the local mean of the squared
    low-passed error and σ² g the noise that the low-pass lets through, the weight is
    (t² / (t² + c (e² − σ² g)))², t² = σ² + (bσ)² + a²; see :class:`FusedTuning`.

    Parameters
    ----------
    error : (H, W) float32
        Simulated − observed, grey levels; NaN where there is nothing to compare.
    noise : float
        Grey levels.
    """
    constant, factor = tuning.agreement
    missing = ~np.isfinite(error)
    kernel = cv2.getGaussianKernel(7, tuning.low_pass)[:, 0]
    passed = float((kernel**2).sum() ** 2)
    bounded = np.where(missing, np.float32(0), np.clip(error, -LARGEST_ERROR, LARGEST_ERROR))
    smooth = cv2.sepFilter2D(bounded, cv2.CV_32F, kernel, kernel, borderType=cv2.BORDER_REFLECT)
    box = (tuning.box, tuning.box)
    local = cv2.blur(smooth * smooth, box, borderType=cv2.BORDER_REFLECT)
    excess = np.maximum(local - np.float32(1.1 * passed * noise**2), 0)
    tolerated = np.float32(noise**2 + (factor * noise) ** 2 + constant**2)
    weight = tolerated / (tolerated + np.float32(tuning.severity) * excess)
    weight *= weight
    weight[missing] = 0
    return weight


def fuse(
    registered: Sequence[RegisteredView],
    grid: Grid,
    lr_shape: tuple[int, int],
    psf: Psf,
    *,
    noise: float,
    residual_threshold: float,
    tuning: FusedTuning | None = None,
    start: HrImage | None = None,
    most_steps: int | None = None,
    stop: Callable[[], bool] | None = None,
) -> FusedResult:
    """Reconstruct a reference view from all registered views.

    Parameters
    ----------
    registered : sequence of RegisteredView
        The reference itself (``is_reference``) is among them.
    lr_shape : (int, int)
        Height and width of the reference view, LR pixels.
    noise : float
        Standard deviation, grey levels.
    residual_threshold : float
        T_R, grey levels: pixels of other views predicted worse are left out (thesis §3.2).
    start : (K·H, K·W) float32, optional
        Initial estimate; default: the reference, bicubic.
    most_steps : int, optional
        Conjugate-gradient steps from all views, at most; default: as many as it takes.
    stop : callable, optional
        Polled between re-weightings; true ends the work early.

    Returns
    -------
    FusedResult
    """
    tuning = tuning or FusedTuning()
    noise = max(noise, SMALLEST_NOISE)
    taps = sampling_taps(psf, grid)
    shape = grid.hr_shape(lr_shape)
    points = [_points(view, grid) for view in registered]
    strength = prior_strength(noise, psf.sigma, tuning)
    settled = tuning.settled * min(1.0, noise)
    scale = tuning.edge_scale[0] + tuning.edge_scale[1] * noise
    reference = next(index for index, view in enumerate(registered) if view.is_reference)
    own = registered[reference]
    ones = np.ones(lr_shape, np.float32)
    system = NormalEquations(shape, taps, psf_taps(psf, grid), float(own.observed.mean()))
    system.gather_regular(own.observed, grid)
    estimate = start if start is not None else initial_estimate(own.observed, grid)
    residuals = []
    stop_reason = "iterations"
    priors: list[npt.NDArray[np.float32] | None] = [None, None]

    def solve(estimate: HrImage, plan: tuple[int, int], most: int | None) -> HrImage:
        nonlocal stop_reason
        begun = system.steps
        before = None
        for turn in range(plan[0]):
            left = plan[1] if most is None else min(plan[1], most - (system.steps - begun))
            if left <= 0:
                stop_reason = "steps"
                break
            if stop is not None and stop():
                stop_reason = "stopped"
                break
            prior = priors[turn % 2] = system.edge_weights(estimate, scale, priors[turn % 2])
            estimate = system.descend(
                estimate, prior, strength, left, settled=settled, goes_on_from=before
            )
            before = prior
        return estimate

    estimate = solve(
        estimate,
        tuning.alone if len(registered) > 1 else tuning.only,
        None if len(registered) > 1 else most_steps,
    )
    weights = [ones] * len(registered)
    flags = [view.flags.copy() for view in registered]
    if len(registered) > 1:
        coefficients = spline_coefficients(estimate, taps)
        for index, view in enumerate(registered):
            if index == reference:
                continue
            error = sample(coefficients, *points[index]) - view.observed
            flags[index][np.abs(error) > residual_threshold] |= np.uint8(Rejection.RESIDUAL)
            weight = agreement_weights(error, noise, tuning)
            weight[flags[index] & IMPOSSIBLE != 0] = 0
            weights[index] = weight
        system.gather(
            [
                (*points[index], view.observed, weights[index])
                for index, view in enumerate(registered)
            ]
        )
        estimate = solve(estimate, tuning.together, most_steps)
    coefficients = spline_coefficients(estimate, taps)
    simulated = tuple(sample(coefficients, *point) for point in points)
    residuals.append(_weighted_rms(simulated, registered, weights))
    return FusedResult(
        estimate=estimate,
        weights=tuple(weights),
        flags=tuple(flags),
        simulated=simulated,
        density=system.density,
        iterations=system.steps,
        residuals=tuple(residuals),
        stop_reason=stop_reason,
    )


def _points(view: RegisteredView, grid: Grid) -> tuple[HrImage, HrImage]:
    """Return x and y of a view's landing points, HR pixels."""
    x, y = grid.to_hr(view.position)
    return np.ascontiguousarray(x), np.ascontiguousarray(y)


def _weighted_rms(
    simulated: Sequence[GreyImage],
    registered: Sequence[RegisteredView],
    weights: Sequence[GreyImage],
) -> float:
    """Return the root mean square of observed − simulated over all views, weighted, grey."""
    total = weight_sum = 0.0
    for image, view, weight in zip(simulated, registered, weights, strict=True):
        square = np.nan_to_num((image - view.observed) ** 2)
        total += float(np.vdot(square, weight))
        weight_sum += float(weight.sum(dtype=np.float64))
    return float(np.sqrt(total / weight_sum)) if weight_sum > 0 else 0.0
