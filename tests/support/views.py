"""Views of a known picture, where they are known to land."""

from __future__ import annotations

import math

import numpy as np

from pipeline.frames import RegisteredView, Rejection
from pipeline.grid import Grid, Sampling
from pipeline.reconstruction.psf import GaussianPsf, psf_axes

PSF = GaussianPsf(sigma=1.0, support=7)
LR_SHAPE = (40, 54)

PHASES = [
    (magnification, sampling)
    for magnification in ((2, 2), (3, 3), (4, 4), (2, 1), (1, 2), (3, 2))
    for sampling in Sampling
]


def make_grid(along_x: int = 2, along_y: int = 2, sampling: Sampling = Sampling.DECIMATION) -> Grid:
    return Grid(magnification_x=along_x, magnification_y=along_y, sampling=sampling)


def make_truth(shape: tuple[int, int], seed: int = 3) -> np.ndarray:
    """Blocks of random grey with sharp edges, a grating and some grain, (KH, KW)."""
    rng = np.random.default_rng(seed)
    blocks = np.kron(rng.uniform(40, 210, (shape[0] // 7 + 1, shape[1] // 9 + 1)), np.ones((7, 9)))
    y, x = np.mgrid[: shape[0], : shape[1]]
    grating = 15 * np.sin(0.9 * x + 0.5 * y)
    grain = rng.normal(0, 3, shape)
    return np.clip(blocks[: shape[0], : shape[1]] + grating + grain, 0, 255).astype(np.float32)


def _taps(psf: GaussianPsf | None, position: float, size: int) -> np.ndarray:
    """(size,) float64: the PSF along one axis at a fractional place, reflected about the edges."""
    centre = math.floor(position + 0.5)
    reach = 0 if psf is None else psf.support // 2
    taps = [1.0] if psf is None else psf.taps_at(position - centre)
    row = np.zeros(size)
    for at, tap in enumerate(taps, start=centre - reach):
        at %= 2 * size
        row[at if at < size else 2 * size - 1 - at] += tap
    return row


def observe(truth, grid, lr_shape, shift, psf=PSF, noise=0.0, seed=0) -> np.ndarray:
    """What a view shifted by (x, y) LR pixels shows of an HR image (Eq. 6), (H, W) float32."""
    along_x, along_y = psf_axes(psf, grid)
    columns = [
        _taps(along_x, (c + shift[0]) * grid.magnification_x + grid.offset_x, truth.shape[1])
        for c in range(lr_shape[1])
    ]
    rows = [
        _taps(along_y, (r + shift[1]) * grid.magnification_y + grid.offset_y, truth.shape[0])
        for r in range(lr_shape[0])
    ]
    seen = np.array(rows) @ truth.astype(np.float64) @ np.array(columns).T
    seen += np.random.default_rng([seed, 7]).normal(0, noise, lr_shape) if noise else 0.0
    return np.clip(np.rint(seen), 0, 255).astype(np.float32)


def make_view(observed, shift=(0.0, 0.0), *, is_reference=False, flags=None) -> RegisteredView:
    """A view whose pixels land ``shift`` LR pixels (x, y) from where they are."""
    observed = np.asarray(observed, np.float32)
    rows, columns = observed.shape
    x, y = np.meshgrid(np.arange(columns) + shift[0], np.arange(rows) + shift[1])
    position = np.stack([x, y], axis=-1).astype(np.float32)
    outside = (x <= -0.5) | (y <= -0.5) | (x >= columns - 0.5) | (y >= rows - 0.5)
    if flags is None:
        flags = np.where(outside, np.uint8(Rejection.OUTSIDE), np.uint8(0))
    return RegisteredView(
        view_id=f"{shift}", observed=observed, position=position,
        registration_weights=np.zeros_like(observed), flags=flags,
        confidence=np.ones_like(observed), is_reference=is_reference,
    )  # fmt: skip
