"""How much of a scene is measured for a report. Light: the command line reads its help here."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

CHAPTERS = ("fidelity", "registration", "spectra", "psf", "left-out", "ablations", "peers")
"""Keys of the chapters, in their order."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is measured."""

    psf_sigmas: tuple[float, ...] = (1.0, 1.7)
    """HR pixels."""
    noises: tuple[float, ...] = (0.0, 2.0)
    """Grey levels."""
    num_seeds: int = 3
    """Seeds of the noise, from 1 on; without noise there is one."""
    chapters: tuple[str, ...] = CHAPTERS
    peers_folder: Path | None = None
    """Where it is kept what the networks of others make of a picture; None: nowhere."""
    warm_frames: int = 4
    """Frames of a video that the warm start is tried on."""
