"""How good on real scenes: Set 1, every method in every cell, the left view.

The scenes are no part of the project: they are found through ``DEPTHSR_SCENES``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from pipeline.config import Settings
from pipeline.degradation import Degradation
from pipeline.evaluate import evaluate_set1
from pipeline.evaluation.floors import Set1Cell
from pipeline.evaluation.tables import Table, number, signed
from pipeline.frames import MultiViewFrame
from pipeline.media.source import open_scene

SCENES = ("lytro_2067", "flower", "cones", "art", "kitti")
PSF_SIGMAS = (1.7, 1.0)
"""HR pixels."""
NOISES = (0.0, 2.0)
"""Grey levels."""
METHODS = ("bicubic", "lanczos", "single-view", "pocs", "pocs-simplified", "default")


def scenes_folder() -> Path | None:
    """Return the folder that DEPTHSR_SCENES names, None where there is none."""
    named = os.environ.get("DEPTHSR_SCENES", "")
    return Path(named) if named and Path(named).is_dir() else None


def read_scene(folder: Path, scene: str) -> MultiViewFrame:
    """Return the first frame of a scene."""
    with open_scene(folder / scene) as source:
        return source.read(source.info.frame_indices.start)


def conditions() -> Iterator[tuple[float, float]]:
    """Yield σ_psf and noise of every column."""
    for sigma in PSF_SIGMAS:
        for noise in NOISES:
            yield sigma, noise


def measure_cell(
    frame: MultiViewFrame, scene: str, psf_sigma: float, noise: float, settings: Settings
) -> Set1Cell:
    """Return the scores of all methods on the left view; K = 2, support 7, seed 1."""
    result = evaluate_set1(
        frame, Degradation(psf_sigma=psf_sigma, noise_sigma=noise, seed=1),
        scene=scene, methods=METHODS, settings=settings,
    )  # fmt: skip
    return Set1Cell(
        scene=scene,
        psf_sigma=psf_sigma,
        noise=noise,
        psnr={score.method: score.psnr for score in result.scores},
        ssim={score.method: score.ssim for score in result.scores},
    )


def psnr_table(cells: Sequence[Set1Cell]) -> Table:
    """Return PSNR of all methods, dB, and the gains of the default."""
    return Table(
        head=("scene", "σ_psf", "noise", *METHODS, "over bicubic", "over single-view"),
        rows=tuple(
            (
                cell.scene,
                f"{cell.psf_sigma:g}",
                f"{cell.noise:g}",
                *(number(cell.psnr[method]) for method in METHODS),
                signed(cell.gain("bicubic")),
                signed(cell.gain("single-view")),
            )
            for cell in cells
        ),
    )


def ssim_table(cells: Sequence[Set1Cell]) -> Table:
    """Return SSIM of all methods."""
    return Table(
        head=("scene", "σ_psf", "noise", *METHODS),
        rows=tuple(
            (
                cell.scene,
                f"{cell.psf_sigma:g}",
                f"{cell.noise:g}",
                *(number(cell.ssim[method], 4) for method in METHODS),
            )
            for cell in cells
        ),
    )
