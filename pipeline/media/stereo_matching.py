"""Disparity between two neighbouring views, by semi-global matching.

Both directions are matched and held against each other; what does not agree is unknown.
The range of disparities, of either sign, is found on a small copy of the pictures first.
Not in the thesis, which is given its depth.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import DepthMap, GreyImage

SMALLEST_SIDE = 12
"""Pictures narrower or lower than this are not matched, pixels."""

SMALLEST_CONTRAST = 1.0
"""Pictures of a smaller standard deviation show nothing to match, grey levels."""

COARSE_WIDTH = 256
"""Width of the small copies on which the range is found, pixels."""

COARSE_RANGE = (-0.25, 0.5)
"""Disparities searched on the small copies, as parts of the width."""

CONSISTENCY = 1.0
"""The two directions may differ by this much, pixels."""

FINE_SPAN, FINEST = 64.0, 4
"""Pairs whose disparities span less than the first (pixels) are matched on widened pictures,
up to the second times as wide: matching of whole pixels prefers whole disparities."""

RANGE_PERCENTILES = (0.5, 99.5)
"""Disparities beyond these are taken for mismatches when the range is measured, per cent."""

RANGE_MARGIN = 0.1
"""What is added to a measured range at each end, as a part of it."""

FRACTION_BITS = 4
"""OpenCV gives disparities in 1/16 pixel."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PairMatch:
    """Disparities x_left − x_right of corresponding points, pixels; they grow with nearness."""

    left: DepthMap
    """(H, W) float32 on the left view's grid, NaN where unknown."""
    right: DepthMap
    """(H, W) float32 on the right view's grid, NaN where unknown."""


def match_pair(left: GreyImage, right: GreyImage) -> PairMatch:
    """Return disparities between two pictures whose rows correspond.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), float32
        Luma, 0..255, of the left and the right camera. The right one sees things shifted to
        the left, the nearer the more; nothing forbids negative disparities (light fields,
        cameras that turn inwards).

    Returns
    -------
    PairMatch
        New arrays; all NaN where pictures are too small or too flat to be matched.

    Notes
    -----
    Semi-global matching (Hirschmüller 2008) as OpenCV's ``StereoSGBM`` has it, 3 paths. Its
    result does not depend on the number of threads.
    """
    unknown = PairMatch(
        left=np.full(left.shape, np.nan, np.float32), right=np.full(right.shape, np.nan, np.float32)
    )
    if min(left.shape) < SMALLEST_SIDE or min(left.std(), right.std()) < SMALLEST_CONTRAST:
        return unknown
    left8, right8 = _stretched(left, right)
    span = _coarse_range(left8, right8)
    if span is None:
        return unknown
    coarse_pixel = max(1.0, left.shape[1] / COARSE_WIDTH)
    margin = 2 * coarse_pixel + RANGE_MARGIN * (span[1] - span[0])
    fineness = int(np.clip(FINE_SPAN / max(span[1] - span[0], 1.0), 1, FINEST))
    low = int(np.floor((span[0] - margin) * fineness))
    high = int(np.ceil((span[1] + margin) * fineness))
    forward, backward = _both_directions(
        _widened(left8, fineness), _widened(right8, fineness), low, high
    )
    match = _consistent(
        _narrowed(forward, fineness), _narrowed(backward, fineness), CONSISTENCY / fineness**0.5
    )
    return PairMatch(left=_without_outliers(match.left), right=_without_outliers(match.right))


def disparity_range(left: GreyImage, right: GreyImage) -> tuple[float, float] | None:
    """Return the lowest and highest disparity between two pictures, roughly.

    Parameters
    ----------
    left, right : ndarray of shape (H, W), float32
        As for :func:`match_pair`.

    Returns
    -------
    tuple of float or None
        Pixels, found on small copies; None where nothing can be matched.
    """
    if min(left.shape) < SMALLEST_SIDE or min(left.std(), right.std()) < SMALLEST_CONTRAST:
        return None
    return _coarse_range(*_stretched(left, right))


def _stretched(
    left: GreyImage, right: GreyImage
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
    """Return both pictures in 8 bits, with one gain that uses the range."""
    low = min(float(np.percentile(image[::2, ::2], 0.5)) for image in (left, right))
    high = max(float(np.percentile(image[::2, ::2], 99.5)) for image in (left, right))
    gain = 255.0 / max(high - low, 1.0)
    first, second = (
        np.clip((image - low) * gain + 0.5, 0, 255).astype(np.uint8) for image in (left, right)
    )
    return first, second


def _coarse_range(
    left: npt.NDArray[np.uint8], right: npt.NDArray[np.uint8]
) -> tuple[float, float] | None:
    height, width = left.shape
    shrink = max(1.0, width / COARSE_WIDTH)
    size = (max(SMALLEST_SIDE, round(width / shrink)), max(SMALLEST_SIDE, round(height / shrink)))
    small = [
        np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)
        for image in (left, right)
    ]
    low, high = (round(part * size[0]) for part in COARSE_RANGE)
    match = _consistent(*_both_directions(small[0], small[1], low, high), CONSISTENCY)
    known = match.left[np.isfinite(match.left)]
    if known.size < max(16, 0.02 * match.left.size):
        return None
    lowest, highest = np.percentile(known, RANGE_PERCENTILES) * (width / size[0])
    return float(lowest), float(highest)


def _widened(image: npt.NDArray[np.uint8], times: int) -> npt.NDArray[np.uint8]:
    """Return the image, so many times as wide; column x becomes column x · times."""
    if times == 1:
        return image
    height, width = image.shape
    place = np.array([[1.0 / times, 0, 0], [0, 1, 0]])
    wide = cv2.warpAffine(
        image,
        place,
        ((width - 1) * times + 1, height),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(wide, np.uint8)


def _narrowed(disparity: DepthMap, times: int) -> DepthMap:
    """Return the disparities of a widened pair on the grid and in the pixels of the pair."""
    return disparity[:, ::times] / np.float32(times)


def _without_outliers(disparity: DepthMap) -> DepthMap:
    """Return the map without the few values that lie far off all others."""
    known = disparity[np.isfinite(disparity)]
    if not known.size:
        return disparity
    low, high = np.percentile(known, RANGE_PERCENTILES)
    margin = 1.0 + RANGE_MARGIN * (high - low)
    with np.errstate(invalid="ignore"):
        inside = (disparity >= low - margin) & (disparity <= high + margin)
    return np.where(inside, disparity, np.float32(np.nan)).astype(np.float32, copy=False)


def _both_directions(
    left: npt.NDArray[np.uint8], right: npt.NDArray[np.uint8], low: int, high: int
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    forward = _matched(left, right, low, high)
    backward = _matched(right[:, ::-1], left[:, ::-1], low, high)
    return forward, np.ascontiguousarray(backward[:, ::-1])


def _matched(
    image: npt.NDArray[np.uint8], other: npt.NDArray[np.uint8], low: int, high: int
) -> npt.NDArray[np.float32]:
    """Return the disparity of each pixel of ``image``, NaN where OpenCV gives none."""
    count = -(-(high - low + 1) // 16) * 16
    before, after = max(0, low + count), max(0, -low)  # columns OpenCV leaves out
    padded = [
        cv2.copyMakeBorder(picture, 0, 0, before, after, cv2.BORDER_REPLICATE)
        for picture in (image, other)
    ]
    block = 5
    matcher = cv2.StereoSGBM.create(
        minDisparity=low,
        numDisparities=count,
        blockSize=block,
        P1=8 * block * block,
        P2=32 * block * block,
        disp12MaxDiff=-1,
        preFilterCap=31,
        uniquenessRatio=5,
        speckleWindowSize=60,
        speckleRange=2,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    fixed = matcher.compute(padded[0], padded[1])[:, before : before + image.shape[1]]
    disparity = fixed.astype(np.float32)
    disparity /= 1 << FRACTION_BITS
    disparity[fixed < low << FRACTION_BITS] = np.nan
    return disparity


def _consistent(
    forward: npt.NDArray[np.float32], backward: npt.NDArray[np.float32], tolerance: float
) -> PairMatch:
    """Return both maps without what the other one contradicts."""
    return PairMatch(
        left=_confirmed(forward, backward, -1.0, tolerance),
        right=_confirmed(backward, forward, 1.0, tolerance),
    )


def _confirmed(
    disparity: npt.NDArray[np.float32],
    other: npt.NDArray[np.float32],
    direction: float,
    tolerance: float,
) -> DepthMap:
    width = disparity.shape[1]
    columns = np.arange(width, dtype=np.float32)[None, :]
    with np.errstate(invalid="ignore"):
        landing = np.rint(columns + direction * disparity)
        inside = (landing >= 0) & (landing < width)
    landing = np.where(inside, landing, 0).astype(np.intp)
    met = np.take_along_axis(other, landing, axis=1)
    with np.errstate(invalid="ignore"):
        agrees = inside & (np.abs(met - disparity) <= tolerance)
    return np.where(agrees, disparity, np.float32(np.nan)).astype(np.float32, copy=False)
