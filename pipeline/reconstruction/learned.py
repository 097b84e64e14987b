"""Learned filters: what is still missing of a picture, estimated from its surroundings.

Not in the thesis. Each pixel gets a filter of 7 × 7 taps by what its surroundings look like:
the direction, the strength and the coherence of its edges (the structure tensor), and how many
views have seen it; a least-squares fit on pictures of which the truth is known says which taps
(Y. Romano, J. Isidoro, P. Milanfar, RAISR, IEEE Trans. Computational Imaging 3(1), 2017). Here
they correct two pictures: the linear restoration that the solver starts from, and what it has made
of all views. They were learned by ``python -m benchmarks.learn``, for K = 2, 3 and 4 and a grid of
PSF and noise, between which they are interpolated.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage
from pipeline.reconstruction import filter_kernels
from pipeline.reconstruction.filter_kernels import ANGLES, COHERENCES, LOADS, STRENGTHS
from pipeline.reconstruction.simd import FOLDED, LANES, PATCH, WIDE
from pipeline.reconstruction.system import on_lines
from pipeline.threads import map_threads

RADIUS = PATCH // 2
"""Of a patch, pixels."""

SURROUNDINGS = 1.2
"""σ of the window of the structure tensor, pixels."""

AROUND = 0.9
"""σ of the window over which views are counted, LR pixels."""

REACH = filter_kernels.HALO
"""Pixels to each side that tell what becomes of one, without the number of views."""

TRUST = 0.65
"""Share of its correction that a result gets: pictures are not those that were learned from. Below
noise …"""

TRUSTED_FROM = 2.0
"""… less, in proportion: the less noise, the less there is to gain, and the more is lost by a PSF
that is not quite the one it was told, grey levels."""

BAND = 128
"""Rows that one thread works on at once."""

Taps = npt.NDArray[np.float32]
"""(classes, 24): taps of the pixels before the middle one, row by row, which are those of the
pixels opposite, too; that of the middle makes the sum zero."""


@dataclass(frozen=True, eq=False)
class FilterBank:
    """Filters by class, ready to be applied.

    Parameters
    ----------
    taps : (classes, 24) float32
    """

    taps: Taps

    @functools.cached_property
    def kernels(self) -> npt.NDArray[np.float32]:
        """(4 · classes, FOLDED · LANES): down to the middle row, for each of the four mirrorings.

        What lies opposite each other has the same tap.
        """
        half = self.taps
        rest = -2 * half.sum(axis=1, keepdims=True)
        whole = np.concatenate((half, rest, half[:, ::-1]), axis=1).reshape(-1, PATCH, PATCH)
        mirrored = (
            whole, whole.transpose(0, 2, 1), whole[:, :, ::-1],
            whole[:, :, ::-1].transpose(0, 2, 1),
        )  # fmt: skip
        folded = on_lines((4, len(half), FOLDED, LANES), np.float32)
        folded[..., PATCH:] = 0
        for number, kernels in enumerate(mirrored):
            folded[number, :, :, :PATCH] = kernels[:, :FOLDED]
        return folded.reshape(4 * len(half), FOLDED * LANES)

    def apply(
        self,
        image: GreyImage,
        views: GreyImage | None = None,
        share: float = 1.0,
        inner: tuple[slice, slice] | None = None,
    ) -> npt.NDArray[np.float32]:
        """Return the image, cut off at 0 and 255, with a share of its correction, (H, W) float32.

        Parameters
        ----------
        image : (H, W) float32
            Grey levels.
        views : (H, W) float32, optional
            How many views observe what lies around each pixel; needed where the classes tell.
        share : float
            Of the correction.
        inner : (rows, columns), optional
            Pixels that are asked for; default: all.
        """
        rows, columns = inner or tuple(slice(0, size) for size in image.shape)
        out = np.empty((rows.stop - rows.start, columns.stop - columns.start), np.float32)
        # contiguous and writable, for one compilation
        image = np.require(image, np.float32, ["C", "W"])
        left, right = max(columns.start - REACH, 0), min(columns.stop + REACH, image.shape[1])

        def work(band: tuple[int, int]) -> None:
            lo, hi = band
            padded, kinds = _padded_and_kinds(
                image, views, (rows.start + lo, rows.start + hi), slice(left, right)
            )
            filter_kernels.apply(
                padded, kinds, columns.start - left, self.kernels, np.float32(share), out[lo:hi]
            )

        map_threads(work, bands(len(out)))
        return out


@dataclass(frozen=True, kw_only=True, eq=False)
class LearnedFilters:
    """The filters for one K, PSF and noise."""

    magnification: int
    of_one: FilterBank
    """For the linear restoration of one view."""
    of_all: FilterBank
    """For what the solver makes of all views."""
    trust: float
    """Share of its correction that this gets."""

    def finished(
        self,
        estimate: GreyImage,
        density: GreyImage,
        inner: tuple[slice, slice] | None = None,
    ) -> npt.NDArray[np.float32]:
        """Return what the solver has made, corrected, (K·H, K·W) float32.

        Parameters
        ----------
        estimate, density : (K·H, K·W) float32
            See :class:`fused.FusedResult`.
        inner : (rows, columns), optional
            Pixels that are asked for; default: all.
        """
        views = views_seen(density, self.magnification)
        return self.of_all.apply(estimate, views, self.trust, inner)


@dataclass(frozen=True, kw_only=True, eq=False)
class LearnedTables:
    """The taps for one K, at a grid of PSF and noise."""

    magnification: int
    sigmas: npt.NDArray[np.float32]
    """Ascending σ_psf, HR pixels."""
    noises: npt.NDArray[np.float32]
    """Ascending standard deviations, grey levels."""
    of_one: npt.NDArray[np.float16]
    of_all: npt.NDArray[np.float16]
    """(sigmas, noises, classes, 24) each."""

    def at(self, psf_sigma: float, noise: float) -> LearnedFilters:
        """Return the filters there, interpolated; beyond the grid those at its ends."""
        shares = [
            (row, column, share * other)
            for row, share in _neighbours(self.sigmas, psf_sigma)
            for column, other in _neighbours(self.noises, noise)
        ]

        def mixed(table: npt.NDArray[np.float16]) -> FilterBank:
            taps = np.zeros(table.shape[2:], np.float32)
            for row, column, share in shares:
                taps += share * table[row, column].astype(np.float32)
            return FilterBank(taps)

        return LearnedFilters(
            magnification=self.magnification,
            of_one=mixed(self.of_one),
            of_all=mixed(self.of_all),
            trust=TRUST * min(noise / TRUSTED_FROM, 1.0),
        )


def _neighbours(nodes: npt.NDArray[np.float32], value: float) -> list[tuple[int, np.float32]]:
    """Return the nodes on both sides of a value and their shares; the ends hold beyond them."""
    place = float(np.interp(value, nodes, np.arange(nodes.size)))
    first = min(int(place), nodes.size - 2)
    share = np.float32(place - first)
    return [(first, np.float32(1) - share), (first + 1, share)]


def bands(height: int) -> Iterable[tuple[int, int]]:
    """Return half-open row ranges that are worked on one by one."""
    return [(lo, min(lo + BAND, height)) for lo in range(0, height, BAND)]


def num_classes(tells_views: bool) -> int:
    """Return how many classes there are, by whether they tell the number of views."""
    loads = len(LOADS) + 1 if tells_views else 1
    return ANGLES * (len(STRENGTHS) + 1) * (len(COHERENCES) + 1) * loads


def kinds_of(
    image: GreyImage, views: GreyImage | None, band: tuple[int, int]
) -> npt.NDArray[np.int16]:
    """Return the class of each pixel of some rows, and how it is mirrored."""
    columns = slice(0, image.shape[1])
    return _padded_and_kinds(image, views, band, columns)[1][:, columns]


def _padded_and_kinds(
    image: GreyImage, views: GreyImage | None, band: tuple[int, int], columns: slice
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.int16]]:
    """Return a part of an image as :func:`filter_kernels.apply` takes it, and its kinds."""
    (lo, hi), halo, left, width = band, filter_kernels.HALO, columns.start, columns.stop
    width -= left
    padded = np.empty((hi - lo + 2 * halo, width + 2 * RADIUS + 2 * LANES), np.float32)
    filter_kernels.pad(image, lo - halo, hi + halo, left, width, RADIUS, 0.0, 255.0, padded)
    kinds = np.empty((hi - lo, width + WIDE), np.int16)
    kinds[:, width:] = 0
    filter_kernels.classify(
        padded, RADIUS, left, width, image.shape[0], lo, hi, _window(),
        image if views is None else views, int(views is not None), kinds,
    )  # fmt: skip
    return padded, kinds


@functools.cache
def _window() -> npt.NDArray[np.float32]:
    """Return the half taps of the window of the structure tensor."""
    side = 2 * filter_kernels.REACH + 1
    return cv2.getGaussianKernel(side, SURROUNDINGS)[filter_kernels.REACH :, 0].astype(np.float32)


def views_seen(density: GreyImage, magnification: int) -> npt.NDArray[np.float32]:
    """Return how many views observe what lies around each HR pixel, (K·H, K·W) float32.

    Parameters
    ----------
    density : (K·H, K·W) float32
        See :class:`fused.FusedResult`.
    magnification : int
        K; the mean is taken over about one LR pixel to each side.
    """
    height, width = density.shape
    lr_size = max(1, width // magnification), max(1, height // magnification)
    cells = cv2.resize(density, lr_size, interpolation=cv2.INTER_AREA)
    around = cv2.GaussianBlur(cells, (0, 0), AROUND) * np.float32(magnification**2)
    return np.asarray(cv2.resize(around, (width, height), interpolation=cv2.INTER_LINEAR))
