"""Every setting of a super-resolution job: one frozen record, checked once.

Each field carries its help text, unit and choices as metadata, so that the
command line, the HTTP schema and the documentation are made from this one
table. The module touches nothing outside.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from pipeline.errors import ConfigurationError
from pipeline.grid import Grid, Sampling

REGISTRATION_PRESETS = (
    "default", "a", "b", "c", "d", "e", "f", "g", "h", "j", "k", "l", "calibration-only",
)  # fmt: skip
"""``default`` is our best; a…l are the methods of thesis Table 1 (it has no row i)."""

CALIBRATED_PRESETS = ("e", "calibration-only")
"""Those that start from camera matrices, which say nothing of how the rig itself moves."""

MAGNIFICATIONS = ("2", "3", "4", "2x1", "1x2")
"""K, or K along x, then along y: 2x1 restores halves side by side, 1x2 halves top and bottom."""


class Solver(StrEnum):
    """How the constraints are turned into an image."""

    FUSED = "fused"
    """All observations gathered once on the HR grid; robust, regularised least squares."""

    POCS = "pocs"
    """Thesis Eq. 9: exact bounded projections, one LR pixel after another."""

    POCS_SIMPLIFIED = "pocs-simplified"
    """Thesis Eq. 10: under-relaxed projections, one LR pixel after another."""


def setting(default: Any, help: str, *, unit: str = "", choices: tuple[str, ...] = ()) -> Any:
    """Return a dataclass field that carries its help text, unit and choices."""
    return field(default=default, metadata={"help": help, "unit": unit, "choices": choices})


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings of the mathematics: what is computed, not where it is read or written.

    Raises
    ------
    ConfigurationError
        If a value is out of range; the message names the option and the rule.
    """

    magnification: str = setting(
        "2", "finer grid: K, or K along x then y", unit="times", choices=MAGNIFICATIONS
    )
    sampling: str = setting(
        "area",
        "where an LR pixel sits on the HR grid: amid the K × K that it covers (cameras, ordinary "
        "down-scalers), or where every K-th pixel was kept",
        choices=tuple(phase.value for phase in Sampling),
    )
    registration: str = setting(
        "default",
        "registration method: the default, or a row of thesis Table 1",
        choices=REGISTRATION_PRESETS,
    )
    layers: int | None = setting(None, "depth layers L (default: the method's)", unit="layers")
    subregions: int | None = setting(
        None, "sub-regions R of a layer (default: the method's)", unit="patches"
    )
    weight_threshold: float | None = setting(
        None,
        "T_w: largest trusted |registration weight| (default: from the noise)",
        unit="grey levels",
    )
    depth_threshold: float = setting(
        0.1, "T_D: largest trusted depth difference", unit="fraction of the scene's depth range"
    )
    residual_threshold: float | None = setting(
        None,
        "T_R: largest trusted reconstruction residual (default: from the noise)",
        unit="grey levels",
    )
    solver: str = setting(
        "fused", "reconstruction method", choices=tuple(solver.value for solver in Solver)
    )
    filters: str = setting(
        "learned", "what corrects the fused result and its initial estimate",
        choices=("learned", "none"),
    )  # fmt: skip
    sweeps: int = setting(8, "sweeps over all constraints (pocs solvers)", unit="sweeps")
    residual_bound: float | None = setting(
        None, "δ₀ of Eq. 7 (default: twice the noise)", unit="grey levels"
    )
    psf: str = setting(
        "given",
        "take the PSF as given, as that of antialiased bicubic reduction, or estimate it",
        choices=("given", "bicubic", "auto"),
    )
    psf_sigma: float | None = setting(
        None, "σ of the Gaussian PSF (default: K/2)", unit="HR pixels"
    )
    psf_support: int | None = setting(
        None, "width of the PSF, odd (default: six σ and one)", unit="HR pixels"
    )
    psf_per_layer: bool = setting(False, "with --psf auto: one σ for each depth layer")
    noise_sigma: float | None = setting(
        None, "standard deviation of the noise (default: estimated)", unit="grey levels"
    )
    chroma: str = setting(
        "bicubic", "how colour is enlarged: bicubic, or super-resolved as luma is",
        choices=("bicubic", "sr"),
    )  # fmt: skip
    temporal: str = setting(
        "cold",
        "how frames of a video are computed: each on its own, from the one before it (warm: "
        "faster), or mostly by depth maps (swift: fastest, for fixed cameras)",
        choices=("cold", "swift", "warm"),
    )  # fmt: skip
    temporal_window: int = setting(
        0, "frames before and after each one whose pixels are further constraints", unit="frames"
    )
    realtime: bool = setting(
        False, "hold the rate of a live stream: leave out work, and frames where that is not enough"
    )
    rate: float | None = setting(
        None, "rate to hold with --realtime (default: the scene's)", unit="frames a second"
    )
    threads: int = setting(0, "threads of the hot loops (0: one a core)", unit="threads")

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            choices = item.metadata["choices"]
            value = getattr(self, item.name)
            if choices and value not in choices:
                raise ConfigurationError(
                    f"{option_name(item.name)}: {value!r} is not one of {', '.join(choices)}"
                )
        _check(self.layers is None or 1 <= self.layers <= 64, "layers", "1 to 64", self.layers)
        _check(
            self.subregions is None or 1 <= self.subregions <= 64,
            "subregions", "1 to 64", self.subregions,
        )  # fmt: skip
        for name in ("weight_threshold", "residual_threshold"):
            value = getattr(self, name)
            _check(value is None or 0 < value <= 255, name, "above 0, up to 255", value)
        share = self.depth_threshold
        _check(0 < share <= 1, "depth_threshold", "above 0, up to 1", share)
        _check(1 <= self.sweeps <= 1000, "sweeps", "1 to 1000", self.sweeps)
        bound = self.residual_bound
        _check(bound is None or 0 <= bound <= 255, "residual_bound", "0 to 255", bound)
        sigma, support = self.psf_sigma, self.psf_support
        _check(sigma is None or 0.2 <= sigma <= 12, "psf_sigma", "0.2 to 12 HR pixels", sigma)
        _check(
            support is None or (support % 2 == 1 and 1 <= support <= 63),
            "psf_support", "an odd number from 1 to 63", support,
        )  # fmt: skip
        noise = self.noise_sigma
        _check(noise is None or 0 <= noise <= 64, "noise_sigma", "0 to 64 grey levels", noise)
        _check(0 <= self.threads <= 256, "threads", "0 to 256", self.threads)
        window = self.temporal_window
        _check(0 <= window <= 2, "temporal_window", "0 to 2", window)
        _check(
            window == 0 or self.temporal != "swift",
            "temporal_window", "0 with --temporal swift", window,
        )  # fmt: skip
        _check(
            window == 0 or self.registration not in CALIBRATED_PRESETS,
            "temporal_window", f"0 with --registration {self.registration}", window,
        )  # fmt: skip
        rate = self.rate
        _check(rate is None or 0 < rate <= 1000, "rate", "above 0, up to 1000", rate)
        _check(
            not self.realtime or self.temporal == "warm",
            "temporal", "warm with --realtime", self.temporal,
        )  # fmt: skip
        _check(
            self.psf == "given" or sigma is None,
            "psf_sigma", f"left out with --psf {self.psf}", sigma,
        )  # fmt: skip
        if self.psf == "bicubic":
            _check(support is None, "psf_support", "left out with --psf bicubic", support)
            _check(self.solver == "fused", "solver", "fused with --psf bicubic", self.solver)

    @property
    def grid(self) -> Grid:
        """The HR grid that K and the sampling phase make."""
        along_x, _, along_y = self.magnification.partition("x")
        return Grid(
            magnification_x=int(along_x),
            magnification_y=int(along_y or along_x),
            sampling=Sampling(self.sampling),
        )


def option_name(name: str) -> str:
    """Return the command-line option of a field.

    >>> option_name("psf_sigma")
    '--psf-sigma'
    """
    return "--" + re.sub("_", "-", name)


def _check(holds: bool, name: str, rule: str, value: object) -> None:
    if not holds:
        raise ConfigurationError(f"{option_name(name)}: must be {rule}, not {value}")
