"""Estimating the PSF: scan σ, and see which predicts pixels that were held back.

Thesis §3.2 (PSF estimation) takes the σ whose result is "most plausible". Measured here
(not in the thesis): the reference view is reconstructed at each σ from itself and half of
the other views, and the pixels of the other half are predicted from it. The prediction
error is least near the true σ, or below it: a result smoothed by the prior needs less
blur to explain the pictures. A weak prior keeps that small.

One view alone cannot tell its PSF: any σ explains it, with another picture behind it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.frames import MultiViewFrame, RegisteredView
from pipeline.grid import Grid
from pipeline.noise import estimate_noise_of_views
from pipeline.psf_curve import PsfCurve
from pipeline.reconstruction.fused import FusedTuning, fuse
from pipeline.reconstruction.psf import GaussianPsf, sampling_taps
from pipeline.reconstruction.system import simulate
from pipeline.registration.layers import layer_labels, layer_thresholds
from pipeline.registration.register import Thresholds, prepare_views, register_views
from pipeline.superresolve import (
    chosen_method,
    default_residual_threshold,
    default_weight_threshold,
    given_psf,
)
from pipeline.threads import set_threads

SIGMAS = tuple(0.25 * 1.19**step for step in range(10))
"""The σ tried, in units of K."""

LARGEST_SIDE = 240
"""Only the middle of the picture is scanned, at most so many LR pixels wide and high."""

NUM_LAYERS = 3
"""Depth layers with a PSF of their own, unless the settings say otherwise."""

FEWEST_PIXELS = 2000
"""Held-out pixels below which a curve is not believed."""

FLAT = 0.01
"""Rise of the error over the curve, as a share, below which the curve says nothing."""

LARGEST_ERROR = 20.0
"""Prediction errors are cut off here, grey levels."""

PRIOR = (0.003, 0.008, 4.0)
"""Prior of the scan: constant, factor and power of the noise. Found on the rendered scene and
on two real ones at noise 0, 1 and 2: a stronger prior gives too small a σ, a weaker one, which
lets noise into the prediction, too large a one."""


def _tuning(noise: float) -> FusedTuning:
    """Return the solver's constants for the scan: brought to convergence."""
    constant, factor, power = PRIOR
    return FusedTuning(
        prior_strength=constant + factor * noise**power, prior_noise_power=0.0, settled=0.05,
        alone=(2, 12), together=(2, 12),
    )  # fmt: skip


def search_psf(frame: MultiViewFrame, settings: Settings) -> tuple[PsfCurve, ...]:
    """Return the curve of prediction errors over σ, and the σ it tells.

    Parameters
    ----------
    frame : MultiViewFrame
        All of its views are used; the left one is the reference, or the first.
    settings : Settings
        Grid, registration and noise; ``psf_support``, where given, is kept.
        ``psf_per_layer`` asks for a curve for each depth layer besides.

    Returns
    -------
    tuple of PsfCurve
        The whole view first. Where the views cannot tell, σ is the default and
        ``remark`` says why.
    """
    set_threads(settings.threads)
    ids = [view.view_id for view in frame.views]
    target = frame.left if frame.left in ids else ids[0]
    noise = settings.noise_sigma
    if noise is None:
        noise = estimate_noise_of_views(frame.views)
    default = given_psf(replace(settings, psf="given"))
    sigmas = tuple(float(sigma * max(_magnifications(settings.grid))) for sigma in SIGMAS)
    if len(ids) < 2:
        return (_unknown(target, sigmas, default, "one view alone cannot tell its PSF"),)
    prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
    found = register_views(
        prepared, [target], ids, chosen_method(settings), noise=noise,
        thresholds=Thresholds(
            weight=settings.weight_threshold or default_weight_threshold(noise),
            depth=settings.depth_threshold,
        ),
    )[target]  # fmt: skip
    shape = frame.view(target).luma.shape
    views, lr_shape = _middle([item.registered for item in found], (shape[0], shape[1]))
    layers = None
    if settings.psf_per_layer:
        count = settings.layers or NUM_LAYERS
        layers = {}
        for view_id, view in prepared.items():
            nearness = view.levels[0].nearness
            layers[view_id] = layer_labels(nearness, layer_thresholds(nearness, count))
    return _scan(views, lr_shape, settings, noise, sigmas, layers, target, default)


def _magnifications(grid: Grid) -> tuple[int, int]:
    return grid.magnification_x, grid.magnification_y


def _middle(
    views: Sequence[RegisteredView], lr_shape: tuple[int, int]
) -> tuple[list[RegisteredView], tuple[int, int]]:
    """Return the views as registered onto the middle of the reference, and its shape."""
    rows, columns = (min(side, LARGEST_SIDE) for side in lr_shape)
    top, left = (lr_shape[0] - rows) // 2, (lr_shape[1] - columns) // 2
    origin = np.array([left, top], np.float32)
    moved = []
    for view in views:
        if view.is_reference:
            inner = (slice(top, top + rows), slice(left, left + columns))
            moved.append(
                replace(
                    view,
                    observed=view.observed[inner],
                    position=view.position[inner] - origin,
                    registration_weights=view.registration_weights[inner],
                    flags=view.flags[inner],
                    confidence=view.confidence[inner],
                )
            )
        else:
            moved.append(replace(view, position=view.position - origin))
    return moved, (rows, columns)


def _reconstructed(
    views: Sequence[RegisteredView],
    lr_shape: tuple[int, int],
    settings: Settings,
    noise: float,
    psf: GaussianPsf,
) -> npt.NDArray[np.float32]:
    threshold = settings.residual_threshold or default_residual_threshold(noise)
    return fuse(
        views,
        settings.grid,
        lr_shape,
        psf,
        noise=noise,
        residual_threshold=threshold,
        tuning=_tuning(noise),
    ).estimate  # fmt: skip


def _predicted(
    estimate: npt.NDArray[np.float32], view: RegisteredView, grid: Grid, psf: GaussianPsf
) -> npt.NDArray[np.float32]:
    x, y = (np.ascontiguousarray(axis) for axis in grid.to_hr(view.position))
    return simulate(estimate, sampling_taps(psf, grid), x, y)


def _scan(
    views: Sequence[RegisteredView],
    lr_shape: tuple[int, int],
    settings: Settings,
    noise: float,
    sigmas: tuple[float, ...],
    layers: dict[str, npt.NDArray[np.int32]] | None,
    target: str,
    default: GaussianPsf,
) -> tuple[PsfCurve, ...]:
    """Return the curves of one set of pictures."""
    others = [view for view in views if not view.is_reference]
    held_out = others[::2]
    kept = [view for view in views if not any(view is other for other in held_out)]
    num_layers = 1 + max(int(labels.max()) for labels in layers.values()) if layers else 0
    sums = np.zeros((1 + num_layers, len(sigmas)))
    counts = np.zeros((1 + num_layers, len(sigmas)))
    for column, sigma in enumerate(sigmas):
        psf = GaussianPsf.of(sigma, settings.psf_support)
        estimate = _reconstructed(kept, lr_shape, settings, noise, psf)
        for view in held_out:
            error = _predicted(estimate, view, settings.grid, psf) - view.observed
            good = np.isfinite(error) & (view.flags == 0)
            square = np.minimum(np.nan_to_num(error) ** 2, LARGEST_ERROR**2)
            sums[0, column] += square[good].sum()
            counts[0, column] += good.sum()
            for layer in range(num_layers):
                inside = good & (layers[view.view_id] == layer) if layers else good
                sums[1 + layer, column] += square[inside].sum()
                counts[1 + layer, column] += inside.sum()
    with np.errstate(invalid="ignore", divide="ignore"):
        errors = np.sqrt(sums / counts)
    return tuple(
        _curve(target, None if row == 0 else row - 1, sigmas, errors[row], counts[row],
               settings, default)
        for row in range(1 + num_layers)
    )  # fmt: skip


def _curve(
    target: str,
    layer: int | None,
    sigmas: tuple[float, ...],
    errors: npt.NDArray[np.float64],
    counts: npt.NDArray[np.float64],
    settings: Settings,
    default: GaussianPsf,
) -> PsfCurve:
    """Return one curve: σ at its lowest point, or the default where it tells nothing."""
    remark = ""
    if counts.min() < FEWEST_PIXELS:
        remark = "too few pixels of other views can be trusted to tell the PSF"
    elif not np.isfinite(errors).all() or np.ptp(errors) < FLAT * errors.min():
        remark = "every σ predicts the other views alike: they cannot tell the PSF"
    best = int(np.argmin(np.nan_to_num(errors, nan=np.inf)))
    if not remark and best in (0, len(sigmas) - 1):
        remark = f"the best σ lies beyond the range tried ({sigmas[0]:.2f} to {sigmas[-1]:.2f})"
    if remark:
        return replace(
            _unknown(target, sigmas, default, remark),
            errors=tuple(float(error) for error in errors), layer=layer,
        )  # fmt: skip
    left, middle, right = errors[best - 1 : best + 2] ** 2
    bend = left - 2 * middle + right
    offset = 0.5 * (left - right) / bend if bend > 0 else 0.0
    ratio = sigmas[1] / sigmas[0]
    sigma = float(sigmas[best] * ratio**offset)
    return PsfCurve(
        view_id=target, sigmas=sigmas, errors=tuple(float(error) for error in errors),
        sigma=sigma, support=GaussianPsf.of(sigma, settings.psf_support).support, layer=layer,
    )  # fmt: skip


def _unknown(target: str, sigmas: tuple[float, ...], default: GaussianPsf, reason: str) -> PsfCurve:
    return PsfCurve(
        view_id=target, sigmas=sigmas, errors=(float("nan"),) * len(sigmas),
        sigma=default.sigma, support=default.support,
        remark=f"PSF: {reason}; σ {default.sigma:g} is assumed",
    )  # fmt: skip
