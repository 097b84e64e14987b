"""Luma and chroma of RGB pictures, and the way back.

Luma is BT.601 full-range (the weights of OpenCV's ``COLOR_BGR2GRAY``), kept unrounded;
chroma is full-range BT.601 Cb and Cr (JFIF) around 128. Both are float32 on the scale
0..255 whatever the bit depth of the file, so that 8- and 16-bit pictures meet on one scale
and come back bit for bit.
"""

from __future__ import annotations

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

YCC_TO_RGB = np.linalg.inv(RGB_TO_YCC)
"""(3, 3) float64: the inverse of :data:`RGB_TO_YCC`."""


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


def picture_from_rgb(rgb: npt.NDArray, peak: float) -> Picture:
    """Return luma and chroma of an RGB picture, unrounded.

    Parameters
    ----------
    rgb : ndarray of shape (H, W, 3), uint8 or uint16
        Stored samples, red first.
    peak : float
        The stored value of white: 255, 1023 or 65535, say.

    Returns
    -------
    Picture
        New arrays.
    """
    scaled = rgb.astype(np.float32)
    if peak != 255:
        scaled *= np.float32(255.0 / peak)
    chroma = np.column_stack([RGB_TO_YCC[1:], [CHROMA_CENTRE, CHROMA_CENTRE]])
    return Picture(
        luma=_float32(cv2.transform(scaled, RGB_TO_YCC[:1])).reshape(scaled.shape[:2]),
        chroma=_float32(cv2.transform(scaled, chroma)).reshape(*scaled.shape[:2], 2),
    )


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
    return _quantised(luma, bit_depth)


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
        return cv2.merge([_quantised(luma, bit_depth)] * 3).reshape(*luma.shape, 3)
    ycc = np.dstack([luma, chroma]).astype(np.float32, copy=False)
    offset = -YCC_TO_RGB[:, 1:].sum(axis=1) * CHROMA_CENTRE
    rgb = cv2.transform(ycc, np.column_stack([YCC_TO_RGB, offset]))
    return _quantised(rgb.reshape(*luma.shape, 3), bit_depth)


def _float32(values: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """Return the same array with its type known."""
    return np.asarray(values, np.float32)


def _quantised(values: npt.NDArray, bit_depth: int) -> npt.NDArray:
    if bit_depth <= 8:
        return np.clip(np.rint(values), 0, 255).astype(np.uint8)
    scaled = values * np.float32(65535 / 255)
    return np.clip(np.rint(scaled, out=scaled), 0, 65535, out=scaled).astype(np.uint16)
