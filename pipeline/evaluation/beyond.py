"""Whether another view ever does harm: other K, PSF and noise than Set 1 has, both eyes.

The last frame of each real scene, so that nothing that Set 1 measures is measured again.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.config import Settings
from pipeline.degradation import Degradation
from pipeline.evaluate import evaluate_set1
from pipeline.evaluation.floors import OVER_SINGLE, Verdict, in_every_cell
from pipeline.evaluation.tables import Table, signed
from pipeline.frames import MultiViewFrame
from pipeline.media.source import open_scene
from pipeline.reconstruction.psf import GaussianPsf

SIGMAS = {2: (0.7, 1.0, 2.3), 3: (1.0, 1.8), 4: (1.5, 3.0)}
"""σ_psf by K, HR pixels."""

NOISES = (0.0, 1.0, 2.0, 5.0, 10.0)
"""Grey levels."""

SUPPORT = 7
"""Least width of the PSF, HR pixels."""

SEED = 3

METHODS = ("bicubic", "single-view", "default")


@dataclass(frozen=True, kw_only=True)
class Condition:
    """What is measured at every noise."""

    scene: str
    magnification: int
    psf_sigma: float
    """HR pixels."""
    eye: str
    """``left`` or ``right``."""

    @property
    def name(self) -> str:
        """All of it in a few letters."""
        return f"{self.scene} K {self.magnification} σ {self.psf_sigma:g} {self.eye}"


@dataclass(frozen=True, kw_only=True)
class Gains:
    """A condition, and PSNR at each of :data:`NOISES`, dB."""

    condition: Condition
    bicubic: tuple[float, ...]
    single_view: tuple[float, ...]
    default: tuple[float, ...]

    @property
    def over_single(self) -> tuple[float, ...]:
        """What the other views bring, dB."""
        return _differences(self.default, self.single_view)

    @property
    def over_bicubic(self) -> tuple[float, ...]:
        """What everything brings, dB."""
        return _differences(self.default, self.bicubic)


def _differences(these: Sequence[float], those: Sequence[float]) -> tuple[float, ...]:
    return tuple(this - that for this, that in zip(these, those, strict=True))


def conditions(scene: str) -> Iterator[Condition]:
    """Yield what is measured of a scene."""
    for magnification, sigmas in SIGMAS.items():
        for sigma in sigmas:
            for eye in ("left", "right"):
                yield Condition(scene=scene, magnification=magnification, psf_sigma=sigma, eye=eye)


def read_last(folder: Path, scene: str) -> MultiViewFrame:
    """Return the last frame of a scene."""
    with open_scene(folder / scene) as source:
        return source.read(source.info.frame_indices[-1])


def measure(frame: MultiViewFrame, condition: Condition, settings: Settings) -> Gains:
    """Return what the methods make of one eye, at every noise."""
    found: dict[str, list[float]] = {method: [] for method in METHODS}
    for noise in NOISES:
        result = evaluate_set1(
            frame,
            Degradation(
                magnification_x=condition.magnification,
                magnification_y=condition.magnification,
                psf_sigma=condition.psf_sigma,
                psf_support=max(SUPPORT, GaussianPsf.of(condition.psf_sigma).support),
                noise_sigma=noise,
                seed=SEED,
            ),
            scene=condition.scene,
            views=(frame.left if condition.eye == "left" else frame.right,),
            methods=METHODS,
            settings=settings,
        )
        for score in result.scores:
            found[score.method].append(score.psnr)
    return Gains(
        condition=condition,
        bicubic=tuple(found["bicubic"]),
        single_view=tuple(found["single-view"]),
        default=tuple(found["default"]),
    )


def from_json(record: dict[str, Any]) -> Gains:
    """Return the gains of a plain record."""
    lists = {key: tuple(value) for key, value in record.items() if key != "condition"}
    return Gains(condition=Condition(**record["condition"]), **lists)


def table(found: Sequence[Gains]) -> Table:
    """Return what the other views bring at each noise, and the least over bicubic."""
    head = ("scene", "K", "σ_psf", "eye", *(f"noise {noise:g}" for noise in NOISES))
    return Table(
        head=(*head, "least over bicubic"),
        rows=tuple(
            (
                gains.condition.scene,
                f"{gains.condition.magnification}",
                f"{gains.condition.psf_sigma:g}",
                gains.condition.eye,
                *(signed(gain) for gain in gains.over_single),
                signed(min(gains.over_bicubic)),
            )
            for gains in found
        ),
        left=("scene", "eye"),
    )


def verdicts(found: Sequence[Gains]) -> list[Verdict]:
    """Return whether the other views never did harm."""
    cells = {
        f"{gains.condition.name} noise {noise:g}": gain
        for gains in found
        for noise, gain in zip(NOISES, gains.over_single, strict=True)
    }
    floor = f"each of {len(cells)} cells: default ≥ single-view {signed(OVER_SINGLE)} dB"
    return [in_every_cell(floor, cells, OVER_SINGLE, digits=3)]
