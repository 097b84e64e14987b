"""Estimating the PSF: σ is the width of the sharpest edges of the picture.

Thesis §3.2 (PSF estimation) takes the σ whose result is "most plausible". Here (not in the
thesis) a plausible result is one with steps in it: an edge of the scene is as wide as the
PSF, or wider where it was soft itself, and the sharpest ones are steps. So the clean edges of
the left view are measured in the pixels of all views (see ``edge_widths``), and σ is the
width at which their distribution begins: the squared width of an edge is σ² and an excess of
its own, which is exponentially distributed, is measured with a known error, and a few edges
are no edges but lines.

What was tried before, the prediction of held-out pixels from reconstructions at many σ, tells
the width of the picture's spectrum: too large a σ for a soft picture, too small a one for a
crisp one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy  # what it has loads when it is named: few jobs come here

from pipeline.config import Settings
from pipeline.edge_widths import EdgeWidths, measure_edges
from pipeline.frames import MultiViewFrame
from pipeline.noise import estimate_noise_of_views
from pipeline.psf_curve import PsfCurve
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.registration.layers import layer_labels, layer_thresholds
from pipeline.registration.register import prepare_views, register_views
from pipeline.superresolve import given_psf, terms_of
from pipeline.threads import set_threads

SIGMAS = tuple(0.25 * 1.1**step for step in range(18))
"""The σ tried, in units of K."""

WIDEST = 1.5
"""Edges wider than that, in units of K, say nothing of the PSF."""

LINES = 0.05
"""Share of edges that are none, and may have any width."""

SPREAD = 0.05
"""Standard deviation of widths beyond their errors, in units of K: no edge is a perfect step."""

EXCESSES = tuple(0.02 * 1.1**step for step in range(44))
"""Mean excesses of the squared width that are tried, in units of K²."""

NUM_LAYERS = 3
"""Depth layers with a PSF of their own, unless the settings say otherwise."""

FEWEST_EDGES = 20
"""Clean edges below which a curve is not believed."""

APART, TOLD = 1.2, 2.0
"""Factor on σ either way that the edges have to tell from the best, by so much of the logarithm
of the likelihood."""


def search_psf(frame: MultiViewFrame, settings: Settings) -> tuple[PsfCurve, ...]:
    """Return how well each σ explains the edges' widths, and the σ they tell.

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
    unit = settings.grid.largest
    if len(ids) < 2:
        return (_unknown(target, unit, default, "one view alone cannot tell its PSF"),)
    prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
    found = register_views(prepared, [target], ids, terms_of(settings, noise))[target]
    edges = measure_edges([item.registered for item in found], settings.grid, noise)
    curves = [_curve(target, None, edges, unit, settings, default)]
    if settings.psf_per_layer:
        nearness = prepared[target].fine.nearness
        labels = layer_labels(nearness, layer_thresholds(nearness, settings.layers or NUM_LAYERS))
        at_edges = labels[edges.row, edges.column]
        curves += [
            _curve(target, layer, edges.chosen(at_edges == layer), unit, settings, default)
            for layer in range(1 + int(labels.max()))
        ]
    return tuple(curves)


def _curve(
    target: str,
    layer: int | None,
    edges: EdgeWidths,
    unit: int,
    settings: Settings,
    default: GaussianPsf,
) -> PsfCurve:
    """Return one curve: σ at its lowest point, or the default where it tells nothing."""
    sigmas = unit * np.array(SIGMAS)
    edges = edges.chosen(edges.width < WIDEST * unit)
    count = edges.width.size
    if count < FEWEST_EDGES:
        reason = f"only {count} clean edges are seen by several views, too few to tell the PSF"
        return _unknown(target, unit, default, reason, layer=layer)
    costs = np.array([_cost(sigma, edges, unit) for sigma in sigmas])
    best = int(np.argmin(costs))
    if best in (0, sigmas.size - 1):
        reason = f"the best σ lies beyond the range tried ({sigmas[0]:.2f} to {sigmas[-1]:.2f})"
        return _unknown(target, unit, default, reason, layer=layer, misfits=costs - costs.min())
    found = scipy.optimize.minimize_scalar(
        _cost, args=(edges, unit), bounds=(sigmas[best - 1], sigmas[best + 1]), method="bounded"
    )
    sigma, least = (found.x, found.fun) if found.fun < costs[best] else (sigmas[best], costs[best])
    misfits = costs - least
    beside = min(_cost(APART * sigma, edges, unit), _cost(sigma / APART, edges, unit)) - least
    if count * beside < TOLD:
        reason = "the edges fit every σ alike: they cannot tell the PSF"
        return _unknown(target, unit, default, reason, layer=layer, misfits=misfits)
    return PsfCurve(
        view_id=target, sigmas=tuple(sigmas.tolist()), misfits=tuple(misfits.tolist()),
        sigma=float(sigma), support=GaussianPsf.of(sigma, settings.psf_support).support,
        layer=layer,
    )  # fmt: skip


def _cost(sigma: float, edges: EdgeWidths, unit: int) -> float:
    """Return minus the mean logarithm of the likelihood of the edges' widths, the best excess."""
    square = edges.width**2
    error = 2 * edges.width * np.hypot(edges.error, SPREAD * unit)
    of_lines = np.log(LINES / (WIDEST * unit) ** 2)
    return float(
        min(
            -np.logaddexp(
                np.log1p(-LINES) + _log_density(square - sigma**2, error, excess * unit**2),
                of_lines,
            ).mean()
            for excess in EXCESSES
        )
    )


def _log_density(
    value: npt.NDArray[np.float64], error: npt.NDArray[np.float64], mean: float
) -> npt.NDArray[np.float64]:
    """Return the log density of an exponential variable plus a normal one of deviation error."""
    return np.asarray(
        scipy.special.log_ndtr(value / error - error / mean)
        + 0.5 * (error / mean) ** 2 - value / mean - np.log(mean)
    )  # fmt: skip


def _unknown(
    target: str,
    unit: int,
    default: GaussianPsf,
    reason: str,
    *,
    layer: int | None = None,
    misfits: npt.NDArray[np.float64] | None = None,
) -> PsfCurve:
    unknown = np.full(len(SIGMAS), np.nan)
    return PsfCurve(
        view_id=target, sigmas=tuple(unit * sigma for sigma in SIGMAS),
        misfits=tuple((unknown if misfits is None else misfits).tolist()),
        sigma=default.sigma, support=default.support, layer=layer,
        remark=f"PSF: {reason}; σ {default.sigma:g} is assumed",
    )  # fmt: skip
