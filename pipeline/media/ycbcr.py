"""The matrices of Y'CbCr, and RGB and grey pictures as limited-range planes of 4:2:0.

Done here, at the matrix that the file will name, and not left to a converter's
default, so that what a player shows is what was meant. Pure arithmetic: knows
no files, no codecs.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.media.colorimetry import BT709, BT2020
from pipeline.stereo import Picture

HD_LINES = 720
"""Pictures of this height or more use BT.709; players that read no tags guess by it too."""


class YcbcrMatrix(StrEnum):
    """Which RGB a Y'CbCr picture is made of."""

    BT601 = "bt601"
    """ITU-R BT.601 (SMPTE 170M), for standard definition."""

    BT709 = "bt709"
    """ITU-R BT.709, for high definition."""

    BT2020 = "bt2020"
    """ITU-R BT.2020, of luminance that is not constant."""

    @property
    def luma_weights(self) -> tuple[float, float, float]:
        """How much red, green and blue count for luma, dimensionless; 1 together."""
        red, blue = {
            YcbcrMatrix.BT601: (0.299, 0.114),
            YcbcrMatrix.BT709: (0.2126, 0.0722),
            YcbcrMatrix.BT2020: (0.2627, 0.0593),
        }[self]
        return red, 1 - red - blue, blue


MATRIX_CODES = {YcbcrMatrix.BT601: 6, YcbcrMatrix.BT709: 1, YcbcrMatrix.BT2020: 9}
"""Code points of ITU-T H.273 that are written."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Yuv420:
    """A colour picture as limited-range Y'CbCr 4:2:0 planes of 8 bits."""

    luma: npt.NDArray[np.uint8]
    """(H, W)."""
    blue_difference: npt.NDArray[np.uint8]
    """(H/2, W/2)."""
    red_difference: npt.NDArray[np.uint8]
    """(H/2, W/2)."""
    matrix: YcbcrMatrix

    @property
    def planes(self) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
        """All three."""
        return self.luma, self.blue_difference, self.red_difference

    @property
    def shape(self) -> tuple[int, int, int]:
        """That of the picture in RGB."""
        return (*self.luma.shape, 3)

    @property
    def dtype(self) -> np.dtype:
        """That of the samples."""
        return self.luma.dtype


def matrix_for(height: int, primaries: int = BT709) -> YcbcrMatrix:
    """Return the matrix that goes with a picture of this many lines and these primaries."""
    if primaries == BT2020:
        return YcbcrMatrix.BT2020
    return YcbcrMatrix.BT709 if height >= HD_LINES else YcbcrMatrix.BT601


def to_yuv420(
    picture: Picture, matrix: YcbcrMatrix, *, coded_bits: int
) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Return the limited-range planes of a picture.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3) RGB or (H, W) grey, uint8 or uint16
        Full range of its type; H and W even.
    matrix : YcbcrMatrix
    coded_bits : int
        8 or 10.

    Returns
    -------
    luma : ndarray of shape (H, W), uint8 (8 bits) or uint16 (10 bits)
    blue_difference, red_difference : ndarray of shape (H/2, W/2), the same type
        Chroma sites are the usual ones of 4:2:0 video: on even columns, midway
        between rows. A grey picture's are neutral, in the middle of the range.

    Notes
    -----
    ITU-R BT.709-6 §3.5: with samples 0..1, Y = (219·E'y + 16)·2ⁿ⁻⁸ and
    C = (224·E'c + 128)·2ⁿ⁻⁸, rounded once at full resolution and once after
    the chroma filter (1 2 1 across, 1 1 down).
    """
    luma, *chroma = _full_planes(picture, matrix, coded_bits)
    blue_difference, red_difference = (_subsample(plane) for plane in chroma)
    return luma, blue_difference, red_difference


def to_yuv422(
    picture: Picture, matrix: YcbcrMatrix, *, coded_bits: int
) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Return the limited-range planes of a picture whose chroma is to lose every other column.

    As :func:`to_yuv420`, but that blue and red difference have the shape of luma still, low-passed
    across, so that their even columns are those of 4:2:2.
    """
    luma, *chroma = _full_planes(picture, matrix, coded_bits)
    kernel = np.array([[1, 2, 1]], np.float32) / 4
    blue_difference, red_difference = (
        cv2.filter2D(plane, -1, kernel, borderType=cv2.BORDER_REPLICATE) for plane in chroma
    )
    return luma, blue_difference, red_difference


def _full_planes(
    picture: Picture, matrix: YcbcrMatrix, coded_bits: int
) -> tuple[npt.NDArray, npt.NDArray, npt.NDArray]:
    """Return limited-range planes of one size."""
    if coded_bits > 8 and picture.dtype == np.uint8:
        picture = picture.astype(np.uint16) * np.uint16(257)
    full, scale = np.iinfo(picture.dtype).max, 2.0 ** (coded_bits - 8)
    coded_type = np.uint8 if coded_bits == 8 else np.uint16
    if picture.ndim == 2:
        levels = np.arange(full + 1) * (219 * scale / full) + 16 * scale
        luma = np.rint(levels).astype(coded_type)[picture]
        neutral = np.full(luma.shape, 128 * scale, coded_type)
        return luma, neutral, neutral
    to_ycbcr = ycbcr_of_rgb(matrix) * (scale / full)
    offset = np.array([[16.0], [128.0], [128.0]]) * scale
    ycbcr = cv2.transform(picture, np.hstack([to_ycbcr, offset]).astype(np.float32))
    luma, blue_difference, red_difference = cv2.split(ycbcr.astype(coded_type, copy=False))
    return luma, blue_difference, red_difference


def ycbcr_of_rgb(matrix: YcbcrMatrix) -> npt.NDArray[np.float64]:
    """Return the (3, 3) matrix from RGB 0..1 to Y 0..219 and Cb, Cr −112..112."""
    luma = np.array(matrix.luma_weights)
    blue_difference = (np.array([0.0, 0.0, 1.0]) - luma) / (2 * (1 - luma[2]))
    red_difference = (np.array([1.0, 0.0, 0.0]) - luma) / (2 * (1 - luma[0]))
    return np.stack([219 * luma, 224 * blue_difference, 224 * red_difference])


def _subsample(plane: npt.NDArray) -> npt.NDArray:
    """Return a chroma plane at half its height and width."""
    kernel = np.array([[1, 2, 1], [1, 2, 1]], np.float32) / 8
    mixed = cv2.filter2D(plane, -1, kernel, anchor=(1, 0), borderType=cv2.BORDER_REPLICATE)
    return np.ascontiguousarray(mixed[::2, ::2])
