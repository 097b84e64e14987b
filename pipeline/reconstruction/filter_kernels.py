"""Compiled loops of the learned filters: which filter a pixel gets, and its weighted sum."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.reconstruction.rows import copy_row, make_lines, mirror, whole
from pipeline.reconstruction.simd import (
    LANES,
    PATCH,
    WIDE,
    blur_across,
    blur_along,
    kinds_wide,
    weigh_patches,
)

ANGLES = 4
"""Directions that are told apart between 0° and 45°; the others are mirror images of these."""

TANGENTS = tuple(np.float32(np.tan(np.deg2rad(degrees))) for degrees in (22.5, 45.0, 67.5))
"""Of twice the angles between them."""

STRENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Limits between classes of the root of the larger eigenvalue, grey levels a pixel."""

COHERENCES = (0.65, 0.35)
"""The same of the coherence (√λ₁ − √λ₂) / (√λ₁ + √λ₂)."""

LOADS = (1.2, 1.7, 2.4, 3.4, 4.8)
"""The same of the number of views."""

_ENERGIES = tuple(np.float32(strength**2) for strength in STRENGTHS)
_RATIOS = tuple(np.float32(((1 - c) / (1 + c)) ** 2) for c in COHERENCES)
_LOADS = tuple(np.float32(load) for load in LOADS)

_TINY = np.float32(1e-12)
"""Energy below which a structure has no direction, grey levels squared."""


def _factors(loads: int) -> tuple[np.int32, ...]:
    """Return what one mirroring, angle, strength, coherence and number of views counts in a kind.

    Parameters
    ----------
    loads : int
        How many numbers of views are told apart.
    """
    of_strength = (len(COHERENCES) + 1) * loads
    of_angle = (len(STRENGTHS) + 1) * of_strength
    return tuple(map(np.int32, (ANGLES * of_angle, of_angle, of_strength, loads, 1)))


_FACTORS, _FACTORS_OF_VIEWS = _factors(1), _factors(len(LOADS) + 1)

HALO = 5
"""Rows above and below one that tell its kinds and what is added to it."""

REACH = 4
"""Pixels to each side in the window of the structure tensor."""

STRIP = 256
"""Columns that are told at once, about: rows of the tensor then stay in the first cache."""

LEAD = WIDE
"""Pixels before the first one of a line, which begins on one of the processor's cache, and behind
its last sixteen."""

BESIDE = REACH + 1
"""Columns on each side of a pixel that tell its kind."""


@njit(**OPTIONS)
def pad(image, lo, hi, left, width, side, lowest, highest, padded):
    """Write a part of an image with a margin, reflected about the edge of the image.

    Parameters
    ----------
    image : (H, W) float32
    lo, hi : int
        Its rows, half-open; may lie outside the image.
    left, width : int
        Its first column, and how many.
    side : int
        Columns before the first one.
    lowest, highest : float
        Grey levels beyond are cut off.
    padded : (hi − lo, ≥ width + 2 · side) float32
    """
    height, columns = image.shape
    least, most = np.float32(lowest), np.float32(highest)
    for row in range(lo, hi):
        own, line = image[mirror(row, height)], padded[row - lo]
        inner, source = line[side : side + width], own[left : left + width]
        for x in range(width):
            inner[x] = min(max(source[x], least), most)
        for k in range(side):
            line[k] = min(max(own[mirror(left + k - side, columns)], least), most)
        for k in range(side + width, line.size):
            line[k] = min(max(own[mirror(left + k - side, columns)], least), most)


@njit(**LEAN)
def _reflected(index, size):
    """Return the index reflected about the outermost pixels, as often as need be."""
    if size == 1:
        return 0
    index %= 2 * size - 2
    return index if index < size else 2 * size - 2 - index


@njit(**LEAN)
def _reflect(line, width):
    """Write the ``REACH`` pixels before and behind the ``width`` of a line."""
    for k in range(1, REACH + 1):
        line[LEAD - k] = line[LEAD + _reflected(-k, width)]
        line[LEAD + width - 1 + k] = line[LEAD + _reflected(width - 1 + k, width)]


@njit(**OPTIONS)
def classify(padded, side, first, width, height, lo, hi, window, views, tells_views, kinds):
    """Write the kinds of rows ``lo`` to ``hi``: mirroring · number of classes + class.

    Mirroring 0: none, 1: about the diagonal, 2: left and right, 3: left and right, then about the
    diagonal. Class: angle, strength, coherence and number of views, the last running fastest.

    The structure tensor streams by: products of Sobel's differences, smoothed along rows and kept
    for as many rows as are smoothed along columns.

    Parameters
    ----------
    padded : (hi − lo + 2 · HALO, ≥ side + W) float32
        Rows ``lo`` − HALO to ``hi`` + HALO of the image.
    side : int
        Column of its first pixel.
    first, width : int
        Which column of the image that is, and how many there are; of those at either end that are
        none of the image's, the outermost ``HALO`` have kinds of their own.
    height : int
        H.
    window : (REACH + 1,) float32
        Half taps of what smooths the tensor.
    views : (H, W) float32
        How many views observe what lies around each pixel.
    tells_views : int
        1 where the classes tell how many, 0 where they do not.
    kinds : (hi − lo, ≥ W + WIDE) int16
        Overwritten; any kinds behind the last pixel.
    """
    strips = max(1, (width + STRIP // 2) // STRIP)
    widest = min(width, width // strips + WIDE + 2 * BESIDE)
    length, lines = LEAD + whole(widest) + LEAD, 2 * REACH + 2
    rooms = (
        # the tensor's three numbers: rows smoothed along x, their products, and two rows smoothed
        make_lines(3 * lines, length).reshape(3, lines, length),
        make_lines(3, length),
        make_lines(2 * 3, length).reshape(2, 3, length),
        make_lines(1, length)[0],
        make_lines(1, length)[0],
    )
    left = np.int64(0)  # typed: a literal has what it goes to compiled twice
    for strip in range(1, strips + 1):
        right = width if strip == strips else strip * width // strips // WIDE * WIDE
        a, b = max(np.int64(0), left - BESIDE), min(width, right + BESIDE)
        _classify_rows(
            padded, side + a, b - a, height, lo, hi, window, views, tells_views, left, right,
            left - a, first, kinds, rooms,
        )  # fmt: skip
        left = right


@njit(**LEAN)
def _classify_rows(
    padded, side, width, height, lo, hi, window, views, tells_views, left, right, start, before,
    kinds, rooms,
):  # fmt: skip
    """Write the kinds of columns ``left`` to ``right``, of which ``start`` more are read before.

    ``before`` those of the part lie as many of the image's, and of ``views``.
    """
    ring, products, tensor, sums, steps = rooms
    flat, rows, numbers = ring.reshape(-1), products.reshape(-1), tensor.reshape(-1)
    lines, length = ring.shape[1], ring.shape[2]
    taps = window[0], window[1], window[2], window[3], window[4]
    next_row = max(0, lo - REACH)
    for y in range(lo, hi):
        # two rows at once: most of what they are smoothed from is the same
        second = (y - lo) % 2
        if second == 0:
            while next_row < min(height, y + 1 + REACH + 1):
                v = next_row
                _differ(
                    padded[_reflected(v - 1, height) - lo + HALO, side:],
                    padded[v - lo + HALO, side:],
                    padded[_reflected(v + 1, height) - lo + HALO, side:],
                    width, sums, steps, products,
                )  # fmt: skip
                for plane in range(3):
                    _reflect(products[plane], width)
                    first, to = plane * length + LEAD, (plane * lines + v % lines) * length
                    for x in range(0, width, WIDE):
                        blur_along(rows, first + x, taps, flat, to + x)
                next_row += 1
            a4, a3, a2, a1, own, b1, b2, b3, b4, b5 = (
                _reflected(y - 4, height) % lines * length,
                _reflected(y - 3, height) % lines * length,
                _reflected(y - 2, height) % lines * length,
                _reflected(y - 1, height) % lines * length,
                y % lines * length,
                _reflected(y + 1, height) % lines * length,
                _reflected(y + 2, height) % lines * length,
                _reflected(y + 3, height) % lines * length,
                _reflected(y + 4, height) % lines * length,
                _reflected(y + 5, height) % lines * length,
            )
            for plane in range(3):
                for x in range(0, width, WIDE):
                    at = plane * lines * length + x
                    blur_across(
                        flat,
                        (
                            at + a4, at + a3, at + a2, at + a1, at + own, at + b1, at + b2,
                            at + b3, at + b4, at + b5,
                        ),
                        taps, numbers, plane * length + x, 3 * length,
                    )  # fmt: skip
        if tells_views:
            copy_row(views[y, before + left : before + right], steps)
        line, tensors = kinds[y - lo, left:], second * 3 * length + start
        for x in range(0, right - left, WIDE):
            if tells_views:
                kinds_wide(
                    numbers, tensors + x, length, steps, TANGENTS, _ENERGIES, _RATIOS, _LOADS,
                    _TINY, _FACTORS_OF_VIEWS, line, x,
                )  # fmt: skip
            else:
                kinds_wide(
                    numbers, tensors + x, length, steps, TANGENTS, _ENERGIES, _RATIOS, (), _TINY,
                    _FACTORS, line, x,
                )  # fmt: skip


@njit(**LEAN)
def _differ(above, own, below, width, sums, steps, products):
    """Write the products of a row's differences along x and y, an eighth of Sobel's.

    Parameters
    ----------
    above, own, below : (≥ W,) float32
    sums, steps, products : float32
        Rows with ``LEAD`` more pixels on each side, the first two to work in.
    """
    two, eighth = np.float32(2.0), np.float32(0.125)
    inner, steps_inner = sums[LEAD:], steps[LEAD:]
    for x in range(width):
        inner[x] = above[x] + two * own[x] + below[x]
    for x in range(width):
        steps_inner[x] = below[x] - above[x]
    _reflect(sums, width)
    _reflect(steps, width)
    before, after = sums[LEAD - 1 :], sums[LEAD + 1 :]
    left, right = steps[LEAD - 1 :], steps[LEAD + 1 :]
    xx, xy, yy = products[0, LEAD:], products[1, LEAD:], products[2, LEAD:]
    for x in range(width):
        across = eighth * (after[x] - before[x])
        down = eighth * (left[x] + two * steps_inner[x] + right[x])
        xx[x] = across * across
        xy[x] = across * down
        yy[x] = down * down


@njit(**OPTIONS)
def apply(padded, kinds, first, taps, share, out):
    """Write each pixel plus a share of the weighted sum of the patch around it.

    Parameters
    ----------
    padded : (H + 2 · HALO, ≥ W + 6 + LANES) float32
        The image with a margin of half a patch at the left, and eight pixels from the last patch's
        first at the right.
    kinds : (H, ≥ W + LANES) int16
        Of :func:`classify`; any kinds behind the last pixel.
    first : int
        Of the pixels written, in each row.
    taps : (kinds, FOLDED · LANES) float32
        See :func:`simd.weigh_patches`.
    share : float32
    out : (H, ≤ W) float32
        Overwritten.
    """
    pixels, weights = padded.reshape(-1), taps.reshape(-1)
    pitch, middle, width = padded.shape[1], PATCH // 2, out.shape[1]
    more = np.empty(width + LANES, np.float32)
    for row in range(out.shape[0]):
        at, own_kinds = (row + HALO - middle) * pitch + first, kinds[row, first:]
        for x in range(0, width, LANES):
            weigh_patches(pixels, at + x, pitch, weights, own_kinds, x, more)
        own, line = padded[row + HALO, middle + first :], out[row]
        for x in range(width):
            line[x] = own[x] + share * more[x]
