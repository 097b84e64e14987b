"""How two eyes share one picture: packing and unpacking, left eye first.

Not in the thesis, which shows its results on a display that takes side by side
pictures. The module knows arrays only: nothing of files, codecs or players.

Pictures are (H, W, 3) RGB or (H, W) grey, uint8 or uint16, using the whole
range of their type (0..255 or 0..65535), encoded for display (sRGB-like gamma).
"""

from __future__ import annotations

import functools
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.errors import ConfigurationError, OutputError

Picture = npt.NDArray[Any]
"""(H, W, 3) RGB or (H, W) grey, uint8 or uint16, full range of the type."""


class StereoLayout(StrEnum):
    """How the views of a frame are laid out in what is written."""

    SBS = "sbs"
    """Side by side, each eye in full: (H, 2·W)."""

    HALF_SBS = "half-sbs"
    """Side by side, each eye squeezed to half its width: (H, W)."""

    TAB = "tab"
    """Left eye on top, right eye below, each in full: (2·H, W)."""

    HALF_TAB = "half-tab"
    """Left eye on top, right eye below, each squeezed to half its height: (H, W)."""

    ANAGLYPH = "anaglyph"
    """One picture for red-cyan glasses, red over the left eye: (H, W, 3)."""

    LEFT = "left"
    """The left eye alone: (H, W)."""

    RIGHT = "right"
    """The right eye alone: (H, W)."""

    VIEWS = "views"
    """Every view in a file of its own: (H, W) each."""

    @property
    def side_by_side(self) -> bool:
        """Whether the eyes sit beside each other."""
        return self in (StereoLayout.SBS, StereoLayout.HALF_SBS)

    @property
    def top_bottom(self) -> bool:
        """Whether the eyes sit above each other."""
        return self in (StereoLayout.TAB, StereoLayout.HALF_TAB)

    @property
    def packed(self) -> bool:
        """Whether a player has to take the picture apart into two eyes."""
        return self.side_by_side or self.top_bottom

    @property
    def half(self) -> bool:
        """Whether each eye is squeezed to half its size along one axis."""
        return self in (StereoLayout.HALF_SBS, StereoLayout.HALF_TAB)


SQUEEZE_LOBES = 3
"""Lobes of the Lanczos window that low-passes an eye before it is halved."""

DUBOIS_LEFT = np.array(
    [[0.437, 0.449, 0.164], [-0.062, -0.062, -0.024], [-0.048, -0.050, -0.017]], np.float32
)
"""(3, 3), linear RGB of the left eye → its part of the linear RGB of the anaglyph [1]_."""

DUBOIS_RIGHT = np.array(
    [[-0.011, -0.032, -0.007], [0.377, 0.761, 0.009], [-0.026, -0.093, 1.234]], np.float32
)
"""(3, 3), linear RGB of the right eye → its part of the linear RGB of the anaglyph [1]_."""


def pack(left: Picture, right: Picture, layout: StereoLayout, *, multiple: int = 1) -> Picture:
    """Return one picture that holds both eyes, left first.

    Parameters
    ----------
    left, right : ndarray of shape (H, W, 3) or (H, W), uint8 or uint16
        The eyes, of one shape and type.
    layout : StereoLayout
        Any but ``views``.
    multiple : int
        Each eye *as it lies in the packed picture* gets a height and a width
        that are multiples of this, by repeating its last row and column (2 for
        4:2:0 video, so that no chroma sample belongs to both eyes).

    Returns
    -------
    ndarray
        A new array of the input's type; for ``left`` and ``right`` it may be
        the input itself. Half layouts first repeat a last odd column (row).

    Raises
    ------
    OutputError
        If the eyes differ in shape or type.
    ConfigurationError
        If the layout is ``views``, which is no single picture.

    Examples
    --------
    >>> eye = np.zeros((4, 6, 3), np.uint8)
    >>> pack(eye, eye, StereoLayout.SBS).shape, pack(eye, eye, StereoLayout.HALF_SBS).shape
    ((4, 12, 3), (4, 6, 3))
    """
    _check_eyes(left, right)
    eyes = (left, right)
    if layout is StereoLayout.LEFT:
        return pad_to_multiple(left, multiple, multiple)
    if layout is StereoLayout.RIGHT:
        return pad_to_multiple(right, multiple, multiple)
    if layout is StereoLayout.ANAGLYPH:
        return pad_to_multiple(anaglyph(left, right), multiple, multiple)
    if layout is StereoLayout.VIEWS:
        raise ConfigurationError("layout 'views' is one picture a view, it cannot be packed")
    if layout.side_by_side:
        wide = multiple * (2 if layout.half else 1)
        padded = [pad_to_multiple(eye, multiple, wide) for eye in eyes]
        if layout.half:
            padded = [squeeze_width(eye) for eye in padded]
        return np.concatenate(padded, axis=1)
    high = multiple * (2 if layout.half else 1)
    padded = [pad_to_multiple(eye, high, multiple) for eye in eyes]
    if layout.half:
        padded = [squeeze_height(eye) for eye in padded]
    return np.concatenate(padded, axis=0)


def unpack(picture: Picture, layout: StereoLayout) -> tuple[Picture, Picture]:
    """Return the (left, right) eyes of a packed picture.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3) or (H, W), uint8 or uint16
    layout : StereoLayout
        ``sbs``, ``half-sbs``, ``tab`` or ``half-tab``.

    Returns
    -------
    left, right : ndarray
        Views of ``picture`` in the full layouts; new arrays, stretched to
        twice the width (height) by bicubic interpolation, in the half ones.

    Raises
    ------
    ConfigurationError
        If the layout does not hold two eyes.
    OutputError
        If the packed side is odd and so cannot be two equal eyes.
    """
    if not layout.packed:
        raise ConfigurationError(f"layout {layout.value!r} does not hold two eyes")
    axis = 1 if layout.side_by_side else 0
    side = picture.shape[axis]
    if side % 2:
        raise OutputError(
            f"{'width' if axis else 'height'} {side} is odd: not two equal eyes ({layout.value})"
        )
    left, right = np.split(picture, 2, axis=axis)
    if not layout.half:
        return left, right
    return _stretch(left, axis), _stretch(right, axis)


def pad_to_multiple(picture: Picture, along_y: int, along_x: int) -> Picture:
    """Return the picture with its last row and column repeated up to multiples.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3) or (H, W)
    along_y, along_x : int
        ≥ 1; the returned height and width are multiples of them.

    Returns
    -------
    ndarray
        The input itself where nothing is missing.
    """
    down, across = -picture.shape[0] % along_y, -picture.shape[1] % along_x
    if not (down or across):
        return picture
    return np.pad(picture, ((0, down), (0, across), (0, 0))[: picture.ndim], mode="edge")


def squeeze_width(picture: Picture) -> Picture:
    """Return the picture at half its width, low-passed against aliasing.

    Column j of the result lies midway between columns 2·j and 2·j + 1: a
    symmetric Lanczos kernel of 12 taps that is cut off at the new Nyquist
    frequency. Borders repeat the last column.

    Parameters
    ----------
    picture : ndarray of shape (H, W, 3) or (H, W), W even

    Returns
    -------
    ndarray of shape (H, W/2, 3) or (H, W/2)
    """
    return _halve(picture, _squeeze_kernel().reshape(1, -1))[:, ::2]


def squeeze_height(picture: Picture) -> Picture:
    """Return the picture at half its height; see :func:`squeeze_width`."""
    return _halve(picture, _squeeze_kernel().reshape(-1, 1))[::2]


def anaglyph(left: Picture, right: Picture) -> Picture:
    """Return the red-cyan anaglyph of two eyes after Dubois' least-squares method.

    Parameters
    ----------
    left, right : ndarray of shape (H, W, 3) or (H, W), uint8 or uint16
        The eyes, of one shape and type, sRGB-encoded.

    Returns
    -------
    ndarray of shape (H, W, 3)
        RGB of the input's type, sRGB-encoded, also for grey eyes.

    Notes
    -----
    As the author specifies: sRGB is decoded to linear light, each eye's part is
    clipped to 0..1 before the two are added, the sum is clipped and encoded
    again. (FFmpeg's ``arcd`` skips the light domain and uses matrices for CRTs.)

    References
    ----------
    .. [1] E. Dubois, "Conversion of a Stereo Pair to Anaglyph with the
       Least-Squares Projection Method", University of Ottawa, March 2009.
    .. [2] E. Dubois, "A projection method to generate anaglyph stereo images",
       Proc. IEEE ICASSP 2001, vol. 3, pp. 1661-1664.
    """
    _check_eyes(left, right)
    linear = np.zeros((*left.shape[:2], 3), np.float32)
    for eye, matrix in ((left, DUBOIS_LEFT), (right, DUBOIS_RIGHT)):
        rgb = eye if eye.ndim == 3 else np.repeat(eye[:, :, np.newaxis], 3, axis=2)
        part = cv2.transform(_decode_srgb(rgb.dtype.str)[rgb], matrix)
        linear += np.clip(part, 0.0, 1.0)
    return _encode_srgb(np.clip(linear, 0.0, 1.0), left.dtype)


def _check_eyes(left: Picture, right: Picture) -> None:
    if left.shape != right.shape or left.dtype != right.dtype:
        raise OutputError(
            f"left eye is {left.shape[1]}×{left.shape[0]} {left.dtype}, "
            f"right eye is {right.shape[1]}×{right.shape[0]} {right.dtype}: they must be alike"
        )


@functools.cache
def _squeeze_kernel() -> npt.NDArray[np.float32]:
    """Return the (12,) taps at −5.5 … 5.5 columns from the new column's centre, sum 1."""
    reach = 2 * SQUEEZE_LOBES
    at = (np.arange(-reach, reach) + 0.5) / 2
    taps = np.sinc(at) * np.sinc(at / SQUEEZE_LOBES)
    return (taps / taps.sum()).astype(np.float32)


def _halve(picture: Picture, kernel: npt.NDArray[np.float32]) -> Picture:
    """Return the picture filtered so that sample 2·j holds new sample j."""
    anchor = (max(kernel.shape[1] // 2 - 1, 0), max(kernel.shape[0] // 2 - 1, 0))
    return cv2.filter2D(picture, -1, kernel, anchor=anchor, borderType=cv2.BORDER_REPLICATE)


def _stretch(picture: Picture, axis: int) -> Picture:
    height, width = picture.shape[:2]
    size = (2 * width, height) if axis else (width, 2 * height)
    return cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC)


@functools.cache
def _decode_srgb(dtype: str) -> npt.NDArray[np.float32]:
    """Return the table from sample value to linear light 0..1 (IEC 61966-2-1)."""
    encoded = np.linspace(0.0, 1.0, np.iinfo(dtype).max + 1)
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    return linear.astype(np.float32)


def _encode_srgb(linear: npt.NDArray[np.float32], dtype: np.dtype) -> Picture:
    """Return linear light 0..1 as samples of ``dtype`` (IEC 61966-2-1)."""
    encoded = np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.rint(encoded * np.iinfo(dtype).max).astype(dtype)
