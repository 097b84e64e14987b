"""What the settings leave open, chosen: the method, the PSF, the filters, the thresholds."""

from __future__ import annotations

from dataclasses import replace

from pipeline.config import Settings, Solver
from pipeline.errors import ConfigurationError
from pipeline.learned_filters import learned_filters
from pipeline.reconstruction.learned import LearnedFilters
from pipeline.reconstruction.psf import BicubicPsf, GaussianPsf, Psf
from pipeline.registration.method import METHODS, RegistrationMethod
from pipeline.registration.records import Terms, Thresholds


def psf_of(settings: Settings) -> Psf:
    """Return the PSF that the settings tell."""
    if settings.psf == "auto":
        raise ConfigurationError("--psf auto: no estimate was made before the first frame")
    if settings.psf == "bicubic":
        return BicubicPsf(magnification=settings.grid.largest)
    return given_psf(settings)


def given_psf(settings: Settings) -> GaussianPsf:
    """Return the Gaussian of the settings: as given, or half of K wide."""
    sigma = settings.psf_sigma or 0.5 * settings.grid.largest
    return GaussianPsf.of(sigma, settings.psf_support)


def chosen_filters(settings: Settings, psf: Psf, noise: float) -> LearnedFilters | None:
    """Return the learned filters of the settings, None where there are none."""
    if settings.filters == "none" or settings.solver != Solver.FUSED:
        return None
    return learned_filters(settings.grid, psf.sigma, noise)


def chosen_method(settings: Settings) -> RegistrationMethod:
    """Return the registration method of the settings, with L and R where they are given."""
    method = METHODS[settings.registration]
    if settings.layers is not None:
        method = replace(method, num_layers=settings.layers)
    if settings.subregions is not None:
        method = replace(method, num_subregions=settings.subregions)
    return method


def terms_of(settings: Settings, noise: float) -> Terms:
    """Return on which terms views of that noise, grey levels, are registered."""
    return Terms(
        method=chosen_method(settings),
        noise=noise,
        thresholds=Thresholds(
            weight=settings.weight_threshold or default_weight_threshold(noise),
            depth=settings.depth_threshold,
        ),
    )


def default_weight_threshold(noise: float) -> float:
    """Return T_w for a noise, grey levels: noise of two pictures, and some aliasing."""
    return 3.0 + 3.0 * noise


def default_residual_threshold(noise: float) -> float:
    """Return T_R for a noise, grey levels: what no noise and little aliasing explains."""
    return 12.0 + 5.0 * noise
