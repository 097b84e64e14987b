"""The learned filters that are shipped: read once, and handed out for a PSF and a noise."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from pipeline.grid import Grid
from pipeline.reconstruction.learned import MAGNIFICATION, LearnedFilters, LearnedTables

TABLES = Path(__file__).with_name("learned_filters.npz")
"""Written by ``python -m benchmarks.learn``."""


def learned_filters(grid: Grid, psf_sigma: float, noise: float) -> LearnedFilters | None:
    """Return the filters for a PSF (HR pixels) and a noise (grey levels); None for another K."""
    if (grid.magnification_x, grid.magnification_y) != (MAGNIFICATION, MAGNIFICATION):
        return None
    return _filters(psf_sigma, noise)


@functools.lru_cache(maxsize=8)
def _filters(psf_sigma: float, noise: float) -> LearnedFilters:
    return _tables().at(psf_sigma, noise)


@functools.cache
def _tables() -> LearnedTables:
    with np.load(TABLES) as stored:
        return LearnedTables(**stored)
