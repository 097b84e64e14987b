"""How far apart two eyes' pictures lie, found from their pixels."""

from __future__ import annotations

import numpy as np


def light_of(codes: np.ndarray) -> np.ndarray:
    """Return the light of sRGB codes of 8 bits, 0…1."""
    part = codes / 255
    return np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)


def shift_between(left: np.ndarray, right: np.ndarray) -> float:
    """How far the left picture lies to the right of the other: slope of the cross spectrum."""
    window = np.hanning(left.shape[1])
    spectra = [np.fft.rfft((eye - eye.mean()) * window, axis=1) for eye in (left, right)]
    cross = (spectra[1] * spectra[0].conj()).sum(axis=0)[2:16]
    frequency = 2 * np.pi * np.arange(2, 16) / left.shape[1]
    weight = np.abs(cross)
    phase = np.unwrap(np.angle(cross))
    return float((weight * phase * frequency).sum() / (weight * frequency**2).sum())
