"""The normal equations of super-resolution, gathered once on the HR grid.

Because the PSF is common to all views, an observation is a sample of *one* blurred
image g = B f, taken at its landing point (thesis Eq. 6, Eq. 8). Sampled with a quadratic
B-spline of nine taps s, all observations together enter the normal equations

    (Bᵀ M B + λ P) f = Bᵀ b,   M = Σ w s sᵀ,   b = Σ w s y.

Each observation, w and w y, is shared, linearly, by the four places around it of a lattice of half
HR pixels: M ≈ Sᵀ W S and b ≈ Sᵀ c with S the samples there and W, c the weights and values that
they have come to, W four numbers a pixel. An iteration then costs two separable blurs and S forth
and back, however many views there are. Since y is what is observed beyond what an estimate
predicts where it lands, only what is changed feels the lattice. The pixels of the reference view
itself lie on it. The weighted graph Laplacian P is the edge-preserving prior.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.reconstruction import descent, kernels, sweeps
from pipeline.reconstruction.half_pixels import LATTICE, LEAD, pitch_of
from pipeline.reconstruction.psf import SeparableTaps
from pipeline.reconstruction.rows import LINE, whole
from pipeline.reconstruction.simd import TOGETHER
from pipeline.reconstruction.sweeps import BEHIND, PAD
from pipeline.reconstruction.tables import Table, table_of
from pipeline.threads import map_threads
from pipeline.vectors import LARGEST

NUM_BANDS = 4
"""Bands of HR rows that are worked on side by side, at most; fixed, so that sums never reorder."""

BAND_ROWS = 64
"""HR rows that a band has at least, where there is more than one."""

AT_ONCE = 600_000
"""HR pixels of one band up to which a descent is one call; of more, each sweep is, so that between
two of them it may be stopped."""

TILE = 64_000
"""HR pixels of the rows that are gathered together: their sums stay in the processor's cache."""

NEGLIGIBLE = 5e-4
"""Share of the middle tap below which outer taps are left out."""

PRIOR_SHARE = 0.5
"""Of the preconditioner: how much of the prior's diagonal it takes for what the PSF removed …"""

DATA_SHARE = 0.025
"""… and what it adds for the observations. From 0.02 to 0.045 Set 1 changes by 0.002 dB."""

LEAST_DENSITY = 0.05
"""What it adds to the weight of what is observed around an HR pixel, where it goes by that."""

HrImage = npt.NDArray[np.float32]
"""(K·H, K·W) float32."""

Number = TypeVar("Number", bound=np.generic)

ON_ITSELF = tuple(map(np.float32, (1, 0, 1, 0)))
"""What coordinates are multiplied by and what is added, x and y, where the grids are one."""

KeptImage = npt.NDArray[np.float32 | np.uint16]
"""(K·H, K·W) float32, or uint16: the bits of float16."""

Counts = npt.NDArray[np.uint8 | np.uint16]
"""Weights, in units of their own."""

NOTHING: HrImage = np.empty((0, 0), np.float32)


@functools.cache
def bands(height: int, most: int = NUM_BANDS) -> list[tuple[int, int]]:
    """Return the half-open row ranges of the bands of an HR image, so many at most."""
    edges = np.linspace(0, height, max(1, min(most, height // BAND_ROWS)) + 1).astype(int)
    return [(int(a), int(b)) for a, b in pairwise(edges)]


def half_taps(taps: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return symmetric taps from the middle one outwards, without negligible ones, unit sum.

    >>> half_taps(np.array([1e-5, 0.25, 0.5, 0.25, 1e-5]))
    array([0.5 , 0.25], dtype=float32)
    """
    half = taps[taps.size // 2 :]
    half = half[: np.flatnonzero(np.abs(half) >= NEGLIGIBLE * np.abs(half[0]))[-1] + 1]
    return (half / (half[0] + 2 * half[1:].sum())).astype(np.float32)


def on_lines(shape: tuple[int, ...], kind: type[Number]) -> npt.NDArray[Number]:
    """Return an array of whatever its memory held that begins on a line of the cache."""
    line = 4 * LINE
    size = math.prod(shape) * np.dtype(kind).itemsize
    found = np.empty(size + line, np.uint8)
    first = -found.ctypes.data % line
    return found[first : first + size].view(kind).reshape(shape)


def low_pass(half: npt.NDArray[np.float32], gain: float) -> npt.NDArray[np.float32]:
    """Return the half taps of a low-pass by which a preconditioner undoes a blur.

    Where B is the transfer of the blur, I + gain · (I − H)² is to be 1 / B²; where that is more
    than 1 + gain, H is to be nothing. As many taps as the blur has, unit sum, by least squares,
    the lowest tenth of the frequencies counting sixteen times.

    Parameters
    ----------
    half : (reach + 1,) float32
        Half taps of the blur.
    gain : float
    """
    frequencies = np.linspace(0, np.pi, 400)
    waves = 2 * np.cos(np.outer(frequencies, np.arange(half.size)))
    waves[:, 0] = 1
    transfer = np.maximum(np.abs(waves @ half.astype(float)), 1e-3)
    wanted = np.maximum(1 - np.sqrt(np.maximum(transfer**-2 - 1, 0) / gain), 0)
    weights = np.where(frequencies < np.pi / 10, 4.0, 1.0)
    weights[0] = 1e3  # what is constant passes
    taps = np.linalg.lstsq(waves * weights[:, None], wanted * weights)[0]
    return (taps / (taps[0] + 2 * taps[1:].sum())).astype(np.float32)


@functools.lru_cache(maxsize=16)
def _low_passes(
    taps: SeparableTaps, gain: float | None
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return half taps along x and along y of what a preconditioner undoes a blur by."""
    x, y = _halves(taps)
    return (x, y) if gain is None else (low_pass(x, gain), low_pass(y, gain))


@functools.lru_cache(maxsize=16)
def _halves(taps: SeparableTaps) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return the half taps along x and along y."""
    return half_taps(taps.x), half_taps(taps.y)


class NormalEquations:
    """Accumulates observations, then solves the system that they make.

    Parameters
    ----------
    shape : (int, int)
        Height and width of the HR grid.
    taps : SeparableTaps
        From the estimate to spline coefficients, see :func:`psf.sampling_taps`.
    sharpening : SeparableTaps
        The PSF, for the preconditioner.
    level : float
        Grey level about which is worked: what is rounded is the difference to it.
    local : (KH, KW) float32, optional
        m, the share of λ that there is at each pixel, 0..1; default: 1.
    most_bands : int
        Bands of HR rows, at most.
    cell : (int, int)
        Rows and columns of HR pixels over which the weight of what is observed is averaged.
    gain : float, optional
        That times as much, at most, it takes of what the PSF has removed, more or less, and goes
        by how much is observed around each pixel; default: by the PSF as it is, the same
        everywhere.
    short : bool
        Whether what is left to do, and what is done about it, is kept in sixteen bits a number,
        and the weight of what is observed in eight, relative to the largest one in its row, in
        place of 32 and 16: half of it crosses memory. Good to a hundredth of what is changed, which
        is less than what is left to change where a descent ends.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        taps: SeparableTaps,
        sharpening: SeparableTaps,
        level: float = 0.0,
        local: HrImage | None = None,
        most_bands: int = NUM_BANDS,
        cell: tuple[int, int] = (1, 1),
        gain: float | None = None,
        short: bool = False,
    ) -> None:
        self.shape = shape
        self._cell, self._is_balanced = cell, gain is not None
        self._level = np.float32(level)
        local = np.ones(shape, np.float32) if local is None else local
        self._local = cv2.copyMakeBorder(local, 0, 0, LEAD, BEHIND, cv2.BORDER_REPLICATE)
        self._along, self._sharpening = _halves(taps), _low_passes(sharpening, gain)
        height, width = shape
        self._origin: HrImage | None = None
        self._masses: Counts = on_lines(
            (height, LATTICE, whole(width)), np.uint8 if short else np.uint16
        )
        self._masses[:, :, width:] = 0  # what lies behind a row stays zero
        self._units = np.empty(height, np.float32)
        self._rhs = np.empty(shape, np.float32)
        self._has_gathered = False
        self._density: HrImage | None = None
        self._bands = bands(shape[0], most_bands)
        self._sums = np.empty((2, height))
        self._kept_in: type[np.uint16] | type[np.float32] = np.uint16 if short else np.float32
        self._scratch: tuple[HrImage, KeptImage, KeptImage, KeptImage] | None = None
        self.steps = 0

    def gather(
        self,
        observations: Sequence[tuple[HrImage, HrImage, HrImage, HrImage]],
        predicted_by: HrImage | None = None,
    ) -> None:
        """Take observations in place of all before: (x, y, value, weight) of each view.

        All are (H, W) float32, x and y in HR pixels.

        Parameters
        ----------
        predicted_by : (KH, KW) float32, optional
            An estimate, of which the values are what is observed beyond what it predicts; a
            descent that starts there need not work out what is left to explain. Without it the
            points are to lie on the lattice, as a reference's own do: beside it M is not quite
            theirs, and what is far from the start feels that.
        """
        # held, since the table only says where they lie
        held = [tuple(map(np.ascontiguousarray, images)) for images in observations]
        self.gather_table(table_of(held), predicted_by)

    def gather_table(
        self,
        table: Table,
        predicted_by: HrImage | None = None,
        regular: int = -1,
        grid: tuple[np.float32, ...] = ON_ITSELF,
    ) -> None:
        """Do what :meth:`gather` does with a table of observations, see ``kernels.WEIGHT``.

        Parameters
        ----------
        regular, grid
            See ``kernels.gather_band``.
        """
        height, width = self.shape
        self._origin, self._has_gathered, self._density = predicted_by, True, None
        level = self._level if predicted_by is None else np.float32(0)
        stretches = [
            rows * (1 - (-columns // TOGETHER)) for rows, columns in table[:, -2:].tolist()
        ]
        starts = np.cumsum([0, *stretches])
        landing = np.empty((2, starts[-1]), np.int32)
        map_threads(
            lambda some: kernels.landing_rows(table, starts, *some, height, landing),
            self.shares_of(len(table)),
        )
        # how many bands are swept does not change in what order is added up
        parts = bands(height)
        tile = min(max(TILE // width, 1), max(hi - lo for lo, hi in parts) + 2)
        map_threads(
            lambda band: kernels.gather_band(
                table, starts, landing, regular, grid, level, *band, tile, height, width,
                self._masses, self._units, self._rhs,
            ),
            parts,
        )  # fmt: skip

    def shares_of(self, count: int) -> list[tuple[int, int]]:
        """Return half-open ranges of so many views that are worked on side by side.

        All at once where there is one band: what is small takes no longer than its calls.
        """
        return [(0, count)] if len(self._bands) == 1 else [(k, k + 1) for k in range(count)]

    @property
    def density(self) -> HrImage:
        """(KH, KW): weight of the observations at the places that belong to each HR pixel."""
        if not self._has_gathered:
            self.gather([])
        if self._density is None:
            out = np.empty(self.shape, np.float32)
            map_threads(
                lambda band: kernels.sum_places(self._masses, self._units, *band, out),
                self._bands,
            )
            self._density = out
        return self._density

    def descend(
        self,
        estimate: HrImage,
        scale: float,
        strength: float,
        steps: int,
        *,
        hold: int = 1,
        settled: float = 0.0,
        data_share: float = DATA_SHARE,
        stretch: float | None = None,
        stop: Callable[[], bool] | None = None,
    ) -> HrImage:
        """Return the estimate after some steps of conjugate gradients, a new array.

        Down Σ w (s·Bf − y)² + λ / scale · Σ m (f ⟨d²⟩ + (1 − f) scale² log(1 + ⟨d²⟩ / scale²)),
        d the differences of neighbours (diagonals counting half), the mean around ⟨·⟩ and the
        floor f those of :func:`sweeps.weigh_prior`. Its weights are held for ``hold`` steps,
        then computed anew; the directions go on being conjugate (Fletcher and Reeves).
        Preconditioned, see :meth:`_look`.

        Parameters
        ----------
        scale : float
            Root mean square of the differences below which the prior is quadratic, grey levels.
        strength : float
            λ.
        steps : int
            At most; ``steps`` of the system counts them.
        settled : float
            Where the (preconditioned) gradient has fallen to this share of what it was, the next
            step is the last one. Without ``stretch`` it ends there, the prior being weighed anew,
            or where it will have fallen to that, should the step to come lower it as the one before
            did.
        data_share : float
            What the preconditioner adds for the observations.
        stretch : float, optional
            How many times as far as the step before it the last step goes; its direction is not
            multiplied by the matrix then. What is due for the last of ``steps`` is weighed for the
            one before it. Default: as far as the matrix tells.
        stop : callable, optional
            Polled before every step, or, where one call makes all, before that; true ends the work.
        """
        if not self._has_gathered:
            self.gather([])
        # the sharpened gradient, and then the matrix times a direction, in place of one another
        image, residual, direction, swept = self._rooms()
        balance = self._balance()
        np.subtract(estimate, self._level, out=image)
        prior = self._room_for_weights()
        unit = _unit(strength, scale)
        self._write_residual(estimate, image, prior, residual)
        rules = descent.rules_of(steps, hold, settled, stretch)
        state = descent.begun(rules)

        def is_stopped() -> bool:
            return stop is not None and stop()

        is_one_call = len(self._bands) == 1 and math.prod(self.shape) <= AT_ONCE
        if is_one_call and not is_stopped():
            descent.descend(
                rules, state, scale, unit, PRIOR_SHARE, data_share, *balance, NOTHING, *self._along,
                *self._sharpening, self._masses, self._units, self._local, image, direction,
                residual, swept, prior, self._sums,
            )  # fmt: skip
        while not is_one_call and state[descent.DONE] < steps and not is_stopped():
            renewed = descent.renews(rules, state)
            energy, along = self._look(
                state[descent.STEP], image, direction, residual, swept, renewed, prior, scale,
                unit, data_share, balance, swept,
            )  # fmt: skip
            if not descent.looked(rules, state, renewed, energy, along):
                break
            curvature = self._turn(
                swept, state[descent.FACTOR], direction, prior, unit, swept, writes=True
            )
            if not descent.turned(rules, state, curvature):
                break
        done, step, stretched = state[[descent.DONE, descent.STEP, descent.STRETCHED]].tolist()
        self.steps += int(done)
        out = np.empty(self.shape, np.float32)
        map_threads(
            lambda band: sweeps.advance(
                step, direction, stretched, swept, self._level, *band, image, out
            ),
            self._bands,
        )
        return out

    def _write_residual(
        self, estimate: HrImage, image: HrImage, prior: npt.NDArray[np.uint16],
        residual: KeptImage,
    ) -> None:  # fmt: skip
        """Write Bᵀ (b − M B x) of an estimate, ``image`` being its difference to the level."""
        if estimate is self._origin:
            map_threads(
                lambda band: sweeps.blur_kept(self._rhs, *self._along, *band, residual),
                self._bands,
            )
            return
        away = image if self._origin is None else estimate - self._origin
        first, factor, second = _in_two(away) if self._kept_in is np.uint16 else (away, 0.0, away)
        self._turn(first, factor, second, prior, 0.0, residual, self._rhs)

    def _balance(self) -> tuple[HrImage, int]:
        """Return what the preconditioner takes a pixel's gradient times, and its rows a line.

        1 / √(w + ``LEAST_DENSITY``), w the mean weight of what is observed in the pixel's cell; or
        1 everywhere.
        """
        height, width = self.shape
        rows, columns = self._cell
        size = (-(-width // columns), -(-height // rows)) if self._is_balanced else (1, 1)
        lines = on_lines((size[1], whole(width)), np.float32)
        if not self._is_balanced:
            lines[:] = 1
            return lines, height
        cells = cv2.resize(self.density, size, interpolation=cv2.INTER_AREA)
        found = 1 / np.sqrt(cells + np.float32(LEAST_DENSITY))
        lines[:, :width] = cv2.resize(found, (width, size[1]), interpolation=cv2.INTER_NEAREST)
        lines[:, width:] = 1  # read, though nothing comes of it
        return lines, rows

    def _rooms(self) -> tuple[HrImage, KeptImage, KeptImage, KeptImage]:
        """Return arrays to work in, of whatever they held."""
        if self._scratch is None:
            residual, direction, swept = (on_lines(self.shape, self._kept_in) for _ in range(3))
            self._scratch = on_lines(self.shape, np.float32), residual, direction, swept
        return self._scratch

    def _room_for_weights(self) -> npt.NDArray[np.uint16]:
        """Return an array for the prior's weights, zero only where none will be written."""
        height, width = self.shape
        weights = on_lines((4, height + 1, pitch_of(width)), np.uint16)
        weights[:, 0] = 0
        weights[1:, height] = 0
        return weights

    def _turn(
        self, sharpened: KeptImage, factor: float, direction: KeptImage,
        prior: npt.NDArray[np.uint16], unit: float, out: KeptImage, rhs: HrImage = NOTHING, *,
        writes: bool = False,
    ) -> float:  # fmt: skip
        """Write the matrix times the next direction, that one in place; return its curvature."""
        reach = 2 * self._along[1].size
        bands = [
            (band, tuple(rows_beyond(read, *band, reach) for read in (sharpened, direction)))
            for band in self._bands
        ]
        map_threads(
            lambda item: sweeps.turn_and_apply(
                sharpened, factor, direction, item[1], *self._along, self._masses, self._units,
                rhs, prior, unit, *item[0], writes, out, self._sums,
            ),
            bands,
        )  # fmt: skip
        return float(sweeps.total(self._sums[0]) + sweeps.total(self._sums[1]))

    def _look(
        self, step: float, image: HrImage, direction: KeptImage, residual: KeptImage,
        applied: KeptImage, renew: bool, prior: npt.NDArray[np.uint16], scale: float, unit: float,
        data_share: float, balance: tuple[HrImage, int], sharpened: KeptImage,
    ) -> tuple[float, float]:  # fmt: skip
        """Take a step in place, and write the preconditioned gradient; return two products of it.

        The preconditioner is a (I + (I − G) e (I − G)) a. a is the inverse root of how much is
        observed around a pixel (Jacobi), or 1; G is the PSF, or a steeper :func:`low_pass` made
        for it. What the PSF has removed is told by the prior alone, weakly and differently from
        pixel to pixel: e is the inverse of its diagonal, times a², and of what little the
        observations say. Symmetric, and positive definite as e > 0.
        """
        is_alone = len(self._bands) == 1
        if renew and not is_alone:
            map_threads(
                lambda band: sweeps.weigh_prior(
                    step, image, direction, scale, self._local, *band, prior
                ),
                self._bands,
            )
        reach = 2 * self._sharpening[1].size - 1
        bands = [
            (
                band,
                tuple(rows_beyond(read, *band, reach) for read in (image, residual, applied)),
            )
            for band in self._bands
        ]
        map_threads(
            lambda item: sweeps.look_and_sharpen(
                step, image, direction, residual, applied, item[1], prior, unit, PRIOR_SHARE,
                data_share, *balance, *self._sharpening, *item[0], sharpened, scale, self._local,
                renew and is_alone, self._sums,
            ),
            bands,
        )  # fmt: skip
        return float(sweeps.total(self._sums[0])), float(sweeps.total(self._sums[1]))


def rows_beyond(
    image: npt.NDArray[Number], lo: int, hi: int, reach: int
) -> tuple[npt.NDArray[Number], npt.NDArray[Number]]:
    """Return copies of so many rows before ``lo`` and from ``hi`` on, as far as the image goes.

    Bands change their rows in place, side by side: what one reads of another is set aside before.
    """
    # none at the edge of the image, beyond which nothing is read
    return image[max(0, lo - reach) : lo].copy(), image[hi : hi + reach].copy()


def _in_two(image: HrImage) -> tuple[KeptImage, float, KeptImage]:
    """Return images of sixteen bits, and what the second counts, that add up to one of more."""
    most = np.clip(image, -LARGEST, LARGEST).astype(np.float16)
    rest = np.clip(image - most, -LARGEST, LARGEST).astype(np.float16)
    return most.view(np.uint16), 1.0, rest.view(np.uint16)


def _unit(strength: float, scale: float) -> float:
    """Return λ in units of the prior's weights."""
    return strength / (scale * sweeps.TOP)


def simulate(
    estimate: HrImage, taps: SeparableTaps, x: HrImage, y: HrImage
) -> npt.NDArray[np.float32]:
    """Return what LR pixels at HR points (x, y) would observe of the estimate; NaN outside.

    Thesis Eq. 8, the sum. Adjoint of the gathering of a residual with unit weights.
    """
    return sample(spline_coefficients(estimate, taps), x, y)


def spline_coefficients(estimate: HrImage, taps: SeparableTaps) -> HrImage:
    """Return B times the estimate, with ``PAD`` pixels around it, reflected about its edge."""
    along = _halves(taps)
    height, width = estimate.shape
    out = np.empty((height + 2 * PAD, width + 2 * PAD), np.float32)
    image = np.ascontiguousarray(estimate, np.float32)
    map_threads(lambda band: sweeps.blur_band(image, *along, *band, PAD, out), bands(height))
    sweeps.reflect_margin(PAD, out)
    return out


def sample(coefficients: HrImage, x: HrImage, y: HrImage) -> npt.NDArray[np.float32]:
    """Return spline samples (H, W) at HR points of coefficients padded by ``PAD``."""
    out = np.empty(x.shape, np.float32)
    map_threads(
        lambda band: kernels.sample_spline(coefficients, x, y, *band, out), bands(x.shape[0])
    )
    return out
