"""The learned filters that are shipped: read once, and handed out for a PSF and a noise."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from pipeline.grid import Grid
from pipeline.reconstruction.learned import LearnedFilters, LearnedTables

TABLES = Path(__file__).with_name("learned_filters.npz")
"""Written by ``python -m benchmarks.learn``."""

NAMES = ("sigmas", "noises", "of_one", "of_all")
"""What the file holds for each K, by the names of :class:`LearnedTables`."""


def learned_filters(grid: Grid, psf_sigma: float, noise: float) -> LearnedFilters | None:
    """Return the filters for a PSF (HR pixels) and a noise (grey levels).

    None for a K that they were not learned for: where it is another along x than along y.
    """
    if grid.magnification_x != grid.magnification_y:
        return None
    return _filters(grid.magnification_x, psf_sigma, noise)


@functools.lru_cache(maxsize=8)
def _filters(magnification: int, psf_sigma: float, noise: float) -> LearnedFilters | None:
    tables = _tables().get(magnification)
    return None if tables is None else tables.at(psf_sigma, noise)


@functools.cache
def _tables() -> dict[int, LearnedTables]:
    """Return the tables by K."""
    with np.load(TABLES) as stored:
        return {
            int(magnification): LearnedTables(
                magnification=int(magnification),
                **{name: stored[f"{name}_{magnification}"] for name in NAMES},
            )
            for magnification in stored["magnifications"]
        }
