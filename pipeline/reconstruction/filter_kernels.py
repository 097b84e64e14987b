"""Compiled loops of the learned filters: which filter a pixel gets, and its weighted sum."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.reconstruction.rows import OPTIONS
from pipeline.reconstruction.simd import LANES, PATCH, weigh_patch

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


@njit(**OPTIONS)
def classify(xx, xy, yy, views, tells_views, kinds):
    """Write the kind of each pixel: mirroring · number of classes + class.

    Mirroring 0: none, 1: about the diagonal, 2: left and right, 3: left and right, then about the
    diagonal. Class: angle, strength, coherence and number of views, the last running fastest.

    Parameters
    ----------
    xx, xy, yy : (H, W) float32
        Structure tensor, grey levels squared.
    views : (H, W) float32
        How many views observe what lies around each pixel.
    tells_views : int
        1 where the classes tell how many, 0 where they do not.
    kinds : (H, W) int16
        Overwritten.
    """
    loads = 1 + len(_LOADS) * tells_views
    count = ANGLES * (len(_ENERGIES) + 1) * (len(_RATIOS) + 1) * loads
    half = np.float32(0.5)
    for row in range(kinds.shape[0]):
        for column in range(kinds.shape[1]):
            across = xx[row, column] - yy[row, column]
            slant = np.float32(2.0) * xy[row, column]
            spread = np.sqrt(across * across + slant * slant)
            total = xx[row, column] + yy[row, column]
            larger = half * (total + spread)
            smaller = half * (total - spread)
            mirroring = np.int32(2) * (slant < 0) + (across < 0)
            slant, across = abs(slant), abs(across)
            angle = strength = roundness = load = np.int32(0)
            for limit in TANGENTS:
                angle += slant > limit * across
            for limit in _ENERGIES:
                strength += larger >= limit
            for limit in _RATIOS:
                roundness += smaller > limit * larger + _TINY
            for limit in _LOADS:
                load += views[row, column] >= limit
            found = (angle * (len(_ENERGIES) + 1) + strength) * (len(_RATIOS) + 1) + roundness
            kinds[row, column] = mirroring * count + found * loads + load * tells_views


@njit(**OPTIONS)
def apply(padded, kinds, taps, out):
    """Write each pixel plus the weighted sum of the patch around it.

    Parameters
    ----------
    padded : (H + 6, W + 6 or more) float32
        The image with a margin of half a patch, and eight pixels from the last patch's first.
    kinds : (H, W) int16
        Of :func:`classify`.
    taps : (kinds, PATCH · LANES) float32
        In rows of LANES, the last lane zero.
    out : (H, W) float32
        Overwritten.
    """
    pixels, weights = padded.reshape(-1), taps.reshape(-1)
    pitch, middle = padded.shape[1], PATCH // 2
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            at = row * pitch + column
            first = kinds[row, column] * (PATCH * LANES)
            more = weigh_patch(pixels, at, pitch, weights, first)
            out[row, column] = padded[row + middle, column + middle] + more
