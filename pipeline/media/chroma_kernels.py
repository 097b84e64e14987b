"""Chroma that a video has at half size, at each pixel of luma: one pass, in compiled code."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, error_model="numpy")
def write_doubled(blue, red, levels, out):
    """Write both planes twice as wide and high, by straight lines, and what each value stands for.

    Between two rows lie two at a quarter from either; a column lies on one of chroma, the next one
    midway between two. All of that are eighths of whole numbers, so that nothing is rounded.

    Parameters
    ----------
    blue, red : ndarray of shape (H, W), uint8
        Cb and Cr as stored.
    levels : ndarray of shape (2041,) or longer, float32
        What a stored value of n / 8 stands for, at n.
    out : ndarray of shape (2·H or 2·H − 1, 2·W or 2·W − 1, 2), float32
        Overwritten.
    """
    height, width = blue.shape
    rows, columns = out.shape[:2]
    quarters = np.empty((2, width + 1), np.int16)
    eighths = np.empty((2 * width, 2), np.int16)
    for row in range(rows):
        near = row >> 1
        far = min(max(near + 2 * (row & 1) - 1, 0), height - 1)
        for plane, stored in enumerate((blue, red)):
            line = quarters[plane]
            for column in range(width):
                line[column] = 3 * np.int16(stored[near, column]) + np.int16(stored[far, column])
            line[width] = line[width - 1]
        for column in range(width):
            for plane in range(2):
                here, after = quarters[plane, column], quarters[plane, column + 1]
                eighths[2 * column, plane] = 2 * here
                eighths[2 * column + 1, plane] = here + after
        for column in range(columns):
            for plane in range(2):
                out[row, column, plane] = levels[eighths[column, plane]]
