"""Luma and chroma straight to limited-range Y'CbCr 4:2:0, without RGB between.

For what is written at the pace of a live stream: a third of the time, and one rounding less.
Colours outside RGB, which RGB would clip, are left to the player's own clipping.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from pipeline.colour import CHROMA_CENTRE, YCC_TO_RGB
from pipeline.frames import ChromaImage, GreyImage
from pipeline.media.ycbcr import YcbcrMatrix, Yuv420, ycbcr_of_rgb
from pipeline.results import SuperResolvedImage
from pipeline.stereo import pad_to_multiple


def coded(luma: GreyImage, chroma: ChromaImage, matrix: YcbcrMatrix) -> Yuv420:
    """Return 8-bit planes of a picture as the pipeline holds it; see :func:`coded_together`."""
    return coded_together([(luma, chroma)], matrix)


def coded_together(
    pictures: Sequence[tuple[GreyImage, ChromaImage]],
    matrix: YcbcrMatrix,
    *,
    side_by_side: bool = True,
) -> Yuv420:
    """Return 8-bit planes of pictures as the pipeline holds them, packed into one.

    Parameters
    ----------
    pictures : sequence of (luma, chroma)
        Alike, left to right, or from top to bottom.

        - luma : ndarray of shape (H, W), float32; BT.601, grey levels 0..255.
        - chroma : ndarray of shape (H, W, 2) or (H/2, W/2, 2), float32; Cb and Cr around 128; the
          smaller one where 4:2:0 video has it (H and W are even then).
    matrix : YcbcrMatrix
        Of the result.
    side_by_side : bool
        Whether the first picture stands left of the others, and not above them.

    Returns
    -------
    Yuv420
        With an odd last row or column of each picture repeated. It differs from
        :func:`pipeline.media.ycbcr.to_yuv420` of the picture in RGB by the roundings of that.
    """
    luma, chroma = pictures[0]
    is_whole = luma.shape == chroma.shape[:2]
    height, width = (side + side % 2 for side in luma.shape)
    down, across = (1, len(pictures)) if side_by_side else (len(pictures), 1)
    planes = Yuv420(
        luma=np.empty((down * height, across * width), np.uint8),
        blue_difference=np.empty((down * height // 2, across * width // 2), np.uint8),
        red_difference=np.empty((down * height // 2, across * width // 2), np.uint8),
        matrix=matrix,
    )
    change = ycbcr_of_rgb(matrix) @ YCC_TO_RGB / 255
    offset = [16, 128, 128] - change[:, 1:].sum(axis=1) * CHROMA_CENTRE
    of_luma = np.array([*change[0], offset[0]], np.float32)
    # of luma nothing is left in them, so that they may be halved first
    of_chroma = np.hstack([change[1:, 1:], offset[1:, np.newaxis]]).astype(np.float32)
    for place, (luma, chroma) in enumerate(pictures):
        luma = pad_to_multiple(luma, 2, 2)
        if is_whole:
            chroma = pad_to_multiple(chroma, 2, 2)
        top, left = (0, place * width) if side_by_side else (place * height, 0)
        _write_luma(luma, chroma, 0 if is_whole else 1, of_luma, planes.luma, top, left)
        _write_chroma(
            _halved(chroma) if is_whole else chroma, of_chroma,
            planes.blue_difference, planes.red_difference, top // 2, left // 2,
        )  # fmt: skip
    return planes


def chroma_to_code(image: SuperResolvedImage) -> ChromaImage:
    """Return the chroma of an image in colour, halved where it can be made so."""
    assert image.colour is not None
    halved = image.colour.halved()
    if halved is not None:
        return halved
    assert image.chroma is not None
    return image.chroma


@njit(nogil=True, cache=True, error_model="numpy")
def _write_luma(luma, chroma, halvings, change, out, top, left):
    least, half, most = np.float32(0), np.float32(0.5), np.float32(255)
    of_luma, of_blue, of_red, offset = change
    width = luma.shape[1]
    of_chroma = np.empty(width, np.float32)
    for row in range(luma.shape[0]):
        if row & halvings == 0:
            colours = chroma[row >> halvings]
            if halvings:
                for column in range(width >> 1):
                    blue, red = colours[column]
                    mixed = of_blue * blue + of_red * red + offset
                    of_chroma[2 * column] = mixed
                    of_chroma[2 * column + 1] = mixed
            else:
                for column in range(width):
                    blue, red = colours[column]
                    of_chroma[column] = of_blue * blue + of_red * red + offset
        levels, line = luma[row], out[top + row][left : left + width]
        for column in range(width):
            level = of_luma * levels[column] + of_chroma[column]
            line[column] = np.uint8(np.int32(min(max(level, least), most) + half))


@njit(nogil=True, cache=True, error_model="numpy")
def _halved(chroma):
    """Return chroma halved, 1 2 1 across and 1 1 down, its first column repeated."""
    eighth = np.float32(1 / 8)
    out = np.empty((chroma.shape[0] // 2, chroma.shape[1] // 2, 2), np.float32)
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            left, middle, right = max(2 * column - 1, 0), 2 * column, 2 * column + 1
            blue = red = np.float32(0)
            for line in (2 * row, 2 * row + 1):
                before, here, after = chroma[line, left], chroma[line, middle], chroma[line, right]
                blue += before[0] + 2 * here[0] + after[0]
                red += before[1] + 2 * here[1] + after[1]
            out[row, column, 0] = blue * eighth
            out[row, column, 1] = red * eighth
    return out


@njit(nogil=True, cache=True, error_model="numpy")
def _write_chroma(chroma, mix, blue_difference, red_difference, top, left):
    least, half, most = np.float32(0), np.float32(0.5), np.float32(255)
    for row in range(chroma.shape[0]):
        blue_line = blue_difference[top + row][left : left + chroma.shape[1]]
        red_line = red_difference[top + row][left : left + chroma.shape[1]]
        for column in range(chroma.shape[1]):
            blue, red = chroma[row, column]
            level = mix[0, 0] * blue + mix[0, 1] * red + mix[0, 2]
            blue_line[column] = np.uint8(min(max(level, least), most) + half)
            level = mix[1, 0] * blue + mix[1, 1] * red + mix[1, 2]
            red_line[column] = np.uint8(min(max(level, least), most) + half)
