"""Luma and chroma of RGB pictures, and the way back.

Luma is BT.601 full-range (the weights of OpenCV's ``COLOR_BGR2GRAY``), kept unrounded;
chroma is full-range BT.601 Cb and Cr (JFIF) around 128. Both are float32 on the scale
0..255 whatever the bit depth of the file, so that 8- and 16-bit pictures meet on one scale
and come back bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import ChromaImage, GreyImage

RED_WEIGHT, GREEN_WEIGHT, BLUE_WEIGHT = 0.299, 0.587, 0.114
"""BT.601 luma weights, dimensionless."""

CHROMA_CENTRE = 128.0
"""Cb and Cr of grey, grey levels."""

RGB_TO_YCC = np.array(
    [
        [RED_WEIGHT, GREEN_WEIGHT, BLUE_WEIGHT],
        [
            -0.5 * RED_WEIGHT / (1 - BLUE_WEIGHT),
            -0.5 * GREEN_WEIGHT / (1 - BLUE_WEIGHT),
            0.5,
        ],
        [0.5, -0.5 * GREEN_WEIGHT / (1 - RED_WEIGHT), -0.5 * BLUE_WEIGHT / (1 - RED_WEIGHT)],
    ]
)
"""(3, 3) float64: RGB to (Y, Cb − 128, Cr − 128)."""

YCC_TO_RGB = np.linalg.inv(RGB_TO_YCC).round(15)
"""(3, 3) float64: the inverse of :data:`RGB_TO_YCC`; what is zero is exactly so."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Picture:
    """A picture as the pipeline holds it."""

    luma: GreyImage
    """(H, W) float32, 0..255."""

    chroma: ChromaImage | None = None
    """(H, W, 2) float32 Cb and Cr around 128, or None for grey."""


def picture_from_grey(samples: npt.NDArray, peak: float) -> Picture:
    """Return grey samples on the scale 0..255.

    Parameters
    ----------
    samples : ndarray of shape (H, W), uint8 or uint16
        Stored samples.
    peak : float
        The stored value of white: 255, 1023 or 65535, say.

    Returns
    -------
    Picture
        New arrays; no chroma.
    """
    luma = samples.astype(np.float32)
    if peak != 255:
        luma *= np.float32(255.0 / peak)
    return Picture(luma=luma)


def combined(
    planes: Sequence[npt.NDArray],
    weights: Sequence[float],
    offset: float = 0.0,
    depth: int = cv2.CV_32F,
) -> npt.NDArray:
    """Return a weighted sum of planes.

    Parameters
    ----------
    planes : sequence of (H, W) arrays
        Of types that OpenCV knows; those of no weight are not looked at.
    weights : sequence of float
        One a plane.
    offset : float
        Added to the sum.
    depth : int
        OpenCV's number of the result's type; integers are rounded to the nearest and clipped.

    Returns
    -------
    ndarray of shape (H, W)
        A new array.

    Examples
    --------
    >>> combined([np.full((1, 3), 2, np.uint8), np.ones((1, 3), np.uint8)], [3.0, 0.5], -1.0)
    array([[5.5, 5.5, 5.5]], dtype=float32)
    """
    terms = [(plane, weight) for plane, weight in zip(planes, weights, strict=True) if weight]
    (total, scale), *others = terms or [(planes[0], 0.0)]
    *between, (last, weight) = others or [(total, 0.0)]
    for plane, share in between:
        total, scale = cv2.addWeighted(total, scale, plane, share, 0.0, dtype=cv2.CV_32F), 1.0
    mixed = cv2.addWeighted(total, scale, last, weight, offset, dtype=depth)
    return np.asarray(mixed).reshape(planes[0].shape)


def picture_from_rgb(rgb: npt.NDArray, peak: float, *, with_chroma: bool = True) -> Picture:
    """Return luma and chroma of an RGB picture, unrounded.

    Parameters
    ----------
    rgb : ndarray of shape (H, W, 3), uint8 or uint16
        Stored samples, red first.
    peak : float
        The stored value of white: 255, 1023 or 65535, say.
    with_chroma : bool
        False: luma alone is wanted.

    Returns
    -------
    Picture
        New arrays.
    """
    planes = cv2.split(rgb)
    of_luma, *of_chroma = RGB_TO_YCC * (255.0 / peak)
    luma = combined(planes, of_luma)
    if not with_chroma:
        return Picture(luma=luma)
    chroma = interleaved([combined(planes, row, CHROMA_CENTRE) for row in of_chroma])
    return Picture(luma=luma, chroma=chroma)


def to_grey(luma: GreyImage, bit_depth: int) -> npt.NDArray:
    """Return the luma as integers for a grey file.

    Parameters
    ----------
    luma : ndarray of shape (H, W), float32
        Grey levels 0..255; values outside are clipped.
    bit_depth : int
        8 gives uint8; anything above gives uint16 *on the full scale 0..65535* (PNG knows no
        10 bits): a 10-bit sample v becomes round(v · 65535 / 1023).

    Returns
    -------
    ndarray of shape (H, W), uint8 or uint16
        A new array, rounded to the nearest.
    """
    return _quantised([luma], [1.0], 0.0, bit_depth)


def to_rgb(luma: GreyImage, chroma: ChromaImage | None, bit_depth: int) -> npt.NDArray:
    """Return luma and chroma as an RGB picture of integers: the way back of a reader.

    Parameters
    ----------
    luma : ndarray of shape (H, W), float32
        Grey levels 0..255.
    chroma : ndarray of shape (H, W, 2), float32, or None
        Cb and Cr around 128; None gives grey in three channels.
    bit_depth : int
        As for :func:`to_grey`.

    Returns
    -------
    ndarray of shape (H, W, 3), uint8 or uint16
        A new array, red first; clipped and rounded to the nearest.
    """
    if chroma is None:
        return interleaved([to_grey(luma, bit_depth)] * 3)
    planes = (luma, *cv2.split(chroma))
    return interleaved(
        [_quantised(planes, row, -row[1:].sum() * CHROMA_CENTRE, bit_depth) for row in YCC_TO_RGB]
    )


def interleaved(planes: Sequence[npt.NDArray]) -> npt.NDArray:
    """Return planes (H, W) as one picture (H, W, channels)."""
    return np.asarray(cv2.merge(planes)).reshape(*planes[0].shape, len(planes))


def _quantised(
    planes: Sequence[npt.NDArray], weights: Sequence[float], offset: float, bit_depth: int
) -> npt.NDArray:
    """Return a weighted sum of planes on the scale 0..255 as integers."""
    peak, depth = (255, cv2.CV_8U) if bit_depth <= 8 else (65535, cv2.CV_16U)
    scale = peak / 255
    return combined(planes, [scale * weight for weight in weights], scale * offset, depth)
