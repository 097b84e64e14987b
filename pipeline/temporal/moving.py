"""A moving camera told from a cut: what it shows is found again elsewhere in the picture before.

Not in the thesis. Looked for in coarse pictures and by normalised correlation, so that motion
between the pixels does not hide it. What is found again much brighter or darker has not moved, but
been lit: a flash is a cut.
"""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage

COARSE_WIDTH = 110
"""Patches are looked for at the coarsest octave at least this wide, pixels."""

HALF, SPACING = 8, 16
"""Half side of the patches, and how far apart they lie, pixels of that octave."""

REACH = (0.09, 0.12)
"""How far they may have moved, shares of width and height."""

PLAIN = 4.0
"""Standard deviation below which a patch shows too little to be found again, grey levels."""

ALIKE = 0.9
"""Correlation of a patch that is found again."""

AS_BRIGHT = 12.0
"""Difference of its mean from where it is found, at most, grey levels."""

FOUND = 0.45
"""Share of the patches found again from which the camera has moved, and nothing been cut."""

FEWEST = 8
"""Patches below which nothing is said."""


def has_moved(now: GreyImage, before: GreyImage) -> bool:
    """Return whether two pictures show the same from another place."""
    share, count = found_again(now, before, FOUND)
    return count >= FEWEST and share >= FOUND


def found_again(now: GreyImage, before: GreyImage, asked: float = np.inf) -> tuple[float, int]:
    """Return the share of the patches of a picture that are found in another, and how many are.

    Parameters
    ----------
    now, before : (H, W) float32
        LR pictures of one view; pictures of unequal sizes share nothing.
    asked : float
        Once the share has come to this, or no longer can, those left are not looked for.

    Returns
    -------
    share : float
        0..1; 0 where there is no patch to look for.
    count : int
        Patches looked for, or that would have been.
    """
    if now.shape != before.shape:
        return 0.0, 0
    picture, other = _coarse(now), _coarse(before)
    height, width = picture.shape
    reach_x, reach_y = (
        int(np.ceil(share * side)) for share, side in zip(REACH, (width, height), strict=True)
    )
    means, means_there = _patch_means(picture), _patch_means(other)
    plain = _patch_means(picture * picture) - means**2 < PLAIN**2
    places = [
        (y, x)
        for y in range(HALF, height - HALF, SPACING)
        for x in range(HALF, width - HALF, SPACING)
        if not plain[y, x]
    ]
    count, found = len(places), 0
    for number, (y, x) in enumerate(places):
        if found >= asked * count or found + count - number < asked * count:
            break
        patch = picture[y - HALF : y + HALF + 1, x - HALF : x + HALF + 1]
        top, left = max(0, y - HALF - reach_y), max(0, x - HALF - reach_x)
        around = other[top : y + HALF + 1 + reach_y, left : x + HALF + 1 + reach_x]
        scores = cv2.matchTemplate(around, patch, cv2.TM_CCOEFF_NORMED)
        _, score, _, (column, row) = cv2.minMaxLoc(scores)
        there = means_there[top + row + HALF, left + column + HALF]
        found += score >= ALIKE and abs(means[y, x] - there) <= AS_BRIGHT
    return found / count if count else 0.0, count


def _patch_means(image: GreyImage) -> npt.NDArray[np.float64]:
    """Return the mean of the patch around each pixel."""
    side = 2 * HALF + 1
    return cv2.boxFilter(image, cv2.CV_64F, (side, side))


def _coarse(image: GreyImage) -> GreyImage:
    while image.shape[1] >= 2 * COARSE_WIDTH:
        image = cv2.pyrDown(image)
    return image
