"""Compiled sweeps over bands of HR rows: the system's matrix, the preconditioner, the steps.

A sweep lets rows stream through blur, stencil, blur and prior while they are in the
processor's cache: each array is read or written once. A band computes the rows that it needs
of its neighbours anew, so that bands may run side by side, and no sum depends on how many do.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.reconstruction.rows import OPTIONS, blur_ring, blur_row, dot_row
from pipeline.reconstruction.simd import LANES, prior_eight, stencil_eight

PAD = 2
"""Pixels before the first one of a row, and rows before the first row, of padded arrays."""

TAIL = 10
"""Numbers behind the last pixel of a row of a padded array, for loops by eights."""


@njit(**OPTIONS)
def _stencil(couplings, units, v, ring, above2, above, own, below, below2, width, out):
    plane, pitch, length = (
        couplings.shape[1] * couplings.shape[2],
        couplings.shape[2],
        ring.shape[1],
    )
    first = (v + PAD) * pitch + PAD
    for x in range(0, width, LANES):
        at = PAD + x
        stencil_eight(
            couplings, first + x, plane, pitch, units[v + 2], units[v + 1], units[v], ring,
            above2 * length + at, above * length + at, own * length + at,
            below * length + at, below2 * length + at, out, x,
        )  # fmt: skip


@njit(**OPTIONS)
def _regular_along_x(across, row, width, out):
    """Write a row times the symmetric five-band matrix of samples at regular columns."""
    a0, a1, a2 = across[0], across[1], across[2]
    b1, b2 = across[3], across[4]
    m1, m2, p1, p2 = row[1:], row, row[3:], row[4:]
    own = row[2:]
    for x in range(width):
        out[x] = a2[x] * own[x] + (a1[x] * m1[x] + b1[x] * p1[x])
    for x in range(width):
        out[x] += a0[x] * m2[x] + b2[x] * p2[x]


@njit(**OPTIONS)
def _regular_along_y(down, ring, v, width, out):
    """Write a row times the five-band matrix of samples at regular rows."""
    lines = ring.shape[0]
    out[:width] = np.float32(0.0)
    for d in range(5):
        factor = down[d, v]
        if factor != 0:
            line = ring[(v + d - 2) % lines]
            for x in range(width):
                out[x] += factor * line[PAD + x]


@njit(**OPTIONS)
def apply_band(
    image, taps_x, taps_y, regular, across, down, couplings, units, prior, strength, lo, hi, out
):
    """Write (Bᵀ M B + λ P) times the image into rows ``lo`` to ``hi``.

    Parameters
    ----------
    image, out : (KH, KW) float32
    taps_x, taps_y : float32
        Half taps of B.
    regular : bool
        Whether M is that of samples at regular places, ``down`` ⊗ ``across``; else
        it is ``couplings``.
    across, down : (5, KW), (5, KH) float32
        Couplings of each column (row) with those −2 … 2 beside it.
    couplings : (13, KH + 4, ≥ KW + 2 + TAIL) uint16
        Padded by two in front; see ``kernels.spread_cells``.
    units : (KH + 4,) float32
        What a unit of the couplings is worth in each row.
    prior : (4, KH + 2, ≥ KW + TAIL) float32
        See ``kernels.edge_weights``.
    strength : float
        λ.

    Returns
    -------
    float
        The scalar product of these rows with those of the image.
    """
    height, width = image.shape
    reach = taps_y.size - 1
    lines = 2 * reach + 1
    blurred = np.empty((lines, width), np.float32)
    back = np.empty((lines, width), np.float32)
    # the last of these lines stays zero: what lies outside the image
    spline = np.zeros((6, PAD + width + TAIL), np.float32)
    around = np.zeros((4, 1 + width + TAIL), np.float32)
    room = np.empty(width + 2 * (taps_x.size - 1), np.float32)
    line = np.zeros(width + TAIL, np.float32)
    length = around.shape[1]
    prior_plane, prior_pitch = prior.shape[1] * prior.shape[2], prior.shape[2]
    end_back = min(height, hi + reach)
    next_back = max(0, lo - reach)
    end_spline = min(height, end_back + 2)
    next_spline = max(0, next_back - 2)
    end_blurred = min(height, end_spline + reach)
    next_blurred = max(0, next_spline - reach)
    s = np.float32(strength)
    total = 0.0
    for y in range(lo, hi):
        while next_back < min(end_back, y + reach + 1):
            v = next_back
            while next_spline < min(end_spline, v + 3):
                while next_blurred < min(end_blurred, next_spline + reach + 1):
                    blur_row(image[next_blurred], taps_x, room, blurred[next_blurred % lines])
                    next_blurred += 1
                row = spline[next_spline % 5]
                if regular:
                    blur_ring(blurred, next_spline, taps_y, height, width, line[2:])
                    line[:2] = 0
                    line[2 + width : 4 + width] = 0
                    _regular_along_x(across, line, width, row[PAD:])
                else:
                    blur_ring(blurred, next_spline, taps_y, height, width, row[PAD:])
                next_spline += 1
            if regular:
                _regular_along_y(down, spline[:5], v, width, line)
            else:
                _stencil(
                    couplings, units, v, spline,
                    (v - 2) % 5 if v >= 2 else 5, (v - 1) % 5 if v >= 1 else 5, v % 5,
                    (v + 1) % 5 if v + 1 < height else 5, (v + 2) % 5 if v + 2 < height else 5,
                    width, line,
                )  # fmt: skip
            blur_row(line[:width], taps_x, room, back[v % lines])
            next_back += 1
        blur_ring(back, y, taps_y, height, width, line)
        if y == lo:
            if y > 0:
                around[(y - 1) % 3, 1 : 1 + width] = image[y - 1]
            around[y % 3, 1 : 1 + width] = image[y]
        if y + 1 < height:
            around[(y + 1) % 3, 1 : 1 + width] = image[y + 1]
        above = (y - 1) % 3 if y > 0 else 3
        below = (y + 1) % 3 if y + 1 < height else 3
        first = (y + 1) * prior_pitch + 1
        for x in range(0, width, LANES):
            at = 1 + x
            prior_eight(
                prior, first + x, prior_plane, prior_pitch, around, above * length + at,
                y % 3 * length + at, below * length + at, s, line, x,
            )  # fmt: skip
        out[y] = line[:width]
        total += dot_row(image[y], line[:width])
    return total


@njit(**OPTIONS)
def change_prior(image, before, after, strength, lo, hi, residual):
    """Add λ (P − P') times the image to rows of the residual, in place: the prior is now P'.

    Parameters
    ----------
    image, residual : (KH, KW) float32
    before, after : (4, KH + 2, ≥ KW + TAIL) float32
        Edge weights of P and of P'.
    strength : float
        λ.
    """
    height, width = image.shape
    around = np.zeros((4, 1 + width + TAIL), np.float32)
    line = np.zeros(width + TAIL, np.float32)
    length = around.shape[1]
    plane, pitch = before.shape[1] * before.shape[2], before.shape[2]
    s = np.float32(strength)
    for y in range(lo, hi):
        for near in range(max(0, y - 1) if y == lo else y + 1, min(height, y + 2)):
            around[near % 3, 1 : 1 + width] = image[near]
        above = (y - 1) % 3 if y > 0 else 3
        below = (y + 1) % 3 if y + 1 < height else 3
        first = (y + 1) * pitch + 1
        line[:] = 0
        for x in range(0, width, LANES):
            up, own, down = above * length + 1 + x, y % 3 * length + 1 + x, below * length + 1 + x
            prior_eight(before, first + x, plane, pitch, around, up, own, down, s, line, x)
            prior_eight(after, first + x, plane, pitch, around, up, own, down, -s, line, x)
        target = residual[y]
        for x in range(width):
            target[x] += line[x]


@njit(**OPTIONS)
def sharpen_band(image, taps_x, taps_y, softness, lo, hi, out):
    """Write the preconditioned image into rows ``lo`` to ``hi``: r + (1 − G) e (1 − G) r.

    Parameters
    ----------
    image, out : (KH, KW) float32
    taps_x, taps_y : float32
        Half taps of G.
    softness : (KH, KW) float32
        e, > 0.

    Returns
    -------
    float
        The scalar product of these rows with those of the image.
    """
    height, width = image.shape
    reach = taps_y.size - 1
    lines = 2 * reach + 1
    blurred = np.empty((lines, width), np.float32)
    fine = np.empty((lines, width), np.float32)
    smoothed = np.empty((lines, width), np.float32)
    room = np.empty(width + 2 * (taps_x.size - 1), np.float32)
    line = np.empty(width, np.float32)
    end_fine = min(height, hi + reach)
    next_fine = max(0, lo - reach)
    end_blurred = min(height, end_fine + reach)
    next_blurred = max(0, next_fine - reach)
    total = 0.0
    for y in range(lo, hi):
        while next_fine < min(end_fine, y + reach + 1):
            v = next_fine
            while next_blurred < min(end_blurred, v + reach + 1):
                blur_row(image[next_blurred], taps_x, room, blurred[next_blurred % lines])
                next_blurred += 1
            blur_ring(blurred, v, taps_y, height, width, line)
            _soften(image[v], line, softness[v], fine[v % lines])
            blur_row(fine[v % lines], taps_x, room, smoothed[v % lines])
            next_fine += 1
        blur_ring(smoothed, y, taps_y, height, width, line)
        total += _sharp(image[y], fine[y % lines], line, out[y])
    return total


@njit(**OPTIONS)
def _soften(row, blurred, softness, out):
    for x in range(row.size):
        out[x] = softness[x] * (row[x] - blurred[x])


@njit(**OPTIONS)
def _sharp(row, fine, smoothed, out):
    total = np.float32(0.0)
    for x in range(row.size):
        value = row[x] + (fine[x] - smoothed[x])
        out[x] = value
        total += row[x] * value
    return total


@njit(**OPTIONS)
def advance(step, direction, applied, estimate, residual, lo, hi):
    """Take one step of conjugate gradients in rows of estimate and residual, in place."""
    s = np.float32(step)
    for y in range(lo, hi):
        along, image = direction[y], estimate[y]
        for x in range(along.size):
            image[x] += s * along[x]
        along, image = applied[y], residual[y]
        for x in range(along.size):
            image[x] -= s * along[x]


@njit(**OPTIONS)
def turn(factor, sharpened, direction, lo, hi):
    """Write the next conjugate direction, sharpened + factor · direction, in place."""
    f = np.float32(factor)
    for y in range(lo, hi):
        new, old = sharpened[y], direction[y]
        for x in range(new.size):
            old[x] = new[x] + f * old[x]


@njit(**OPTIONS)
def blur_band(image, taps_x, taps_y, lo, hi, out):
    """Write the blurred image into rows ``lo`` to ``hi`` of (KH, KW) float32."""
    height, width = image.shape
    reach = taps_y.size - 1
    lines = 2 * reach + 1
    blurred = np.empty((lines, width), np.float32)
    room = np.empty(width + 2 * (taps_x.size - 1), np.float32)
    end_blurred, next_blurred = min(height, hi + reach), max(0, lo - reach)
    for y in range(lo, hi):
        while next_blurred < min(end_blurred, y + reach + 1):
            blur_row(image[next_blurred], taps_x, room, blurred[next_blurred % lines])
            next_blurred += 1
        blur_ring(blurred, y, taps_y, height, width, out[y])
