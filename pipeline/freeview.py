"""A view between two cameras, at SR resolution: the future work that the thesis names.

The two super-resolved neighbours are moved towards each other along the motion that
registration found between them. For cameras on a line, a point seen at x₀ in one and x₁ in
the other lies at (1 − t)·x₀ + t·x₁ from the place t of the way between them; for cameras
near a line, this is close. Every pixel of either neighbour lands with its nearness; the
nearest surface wins; what both see is blended by t, what one sees is taken from it, and
what neither sees continues the farther side of the gap.

Works on arrays alone: neither depth maps nor cameras are known here beyond nearness.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numba as nb
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, Mask
from pipeline.grid import Grid

HrField = npt.NDArray[np.float32]
"""(K·H, K·W, 2) float32 displacement as (u, v), HR pixels."""

FAR = np.float32(-1e30)
"""Nearness of no surface."""

SAME_SURFACE = 1.5
"""Distance, HR pixels, within which what two neighbours say of a place is one surface."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Neighbour:
    """One of the two views that the new one lies between."""

    luma: GreyImage
    """(K·H, K·W) float32, super-resolved."""
    chroma: npt.NDArray[np.float32] | None
    """(K·H, K·W, 2) float32, or None."""
    motion: HrField
    """Displacement of each pixel to the other neighbour."""
    nearness: npt.NDArray[np.float32]
    """(K·H, K·W): larger is nearer; the same scale in both neighbours."""


@dataclass(frozen=True, kw_only=True, eq=False)
class IntermediateView:
    """A picture that no camera took."""

    luma: GreyImage
    """(K·H, K·W) float32, 0..255."""
    chroma: npt.NDArray[np.float32] | None
    seen: Mask
    """(K·H, K·W): seen by a neighbour; elsewhere the picture is a guess."""


def hr_motion(
    position: npt.NDArray[np.float32], trusted: Mask, nearness: npt.NDArray[np.float32], grid: Grid
) -> tuple[HrField, npt.NDArray[np.float32]]:
    """Return motion and nearness on the HR grid of a view registered onto its neighbour.

    Parameters
    ----------
    position : ndarray of shape (H, W, 2)
        Landing points as (x, y), LR pixels of the neighbour; NaN where none.
    trusted : ndarray of shape (H, W), bool
        Where the landing point may be believed; elsewhere that of the nearest trusted pixel of
        like nearness would be a guess, so that the point itself is kept where there is one.
    nearness : ndarray of shape (H, W)

    Notes
    -----
    Each HR pixel takes the motion of the LR pixel nearest to it on its own surface: depth
    edges stay sharp, at the resolution of the LR grid. Within a surface it is linear.
    """
    height, width = trusted.shape
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    motion = position - np.stack((columns, rows), axis=-1)
    known = np.isfinite(motion).all(axis=-1)
    motion = _filled(np.nan_to_num(motion), known if known.any() else np.ones_like(known))
    steady = cv2.medianBlur(np.ascontiguousarray(motion), 5)
    motion = np.where(trusted[..., None], motion, steady)
    hr_height, hr_width = grid.hr_shape((height, width))
    hr_rows, hr_columns = np.mgrid[:hr_height, :hr_width].astype(np.float32)
    x = (hr_columns - grid.offset_x) / grid.magnification_x
    y = (hr_rows - grid.offset_y) / grid.magnification_y
    fine = _edge_kept(np.ascontiguousarray(motion, np.float32), x, y)
    near = cv2.remap(
        nearness.astype(np.float32), x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE
    )
    scale = np.array([grid.magnification_x, grid.magnification_y], np.float32)
    return fine * scale, near


def between(left: Neighbour, right: Neighbour, at: float) -> IntermediateView:
    """Return the view that lies ``at`` of the way from the left neighbour to the right one.

    Parameters
    ----------
    at : float
        0 is the left neighbour, 1 the right one.
    """
    if not 0 <= at <= 1:
        raise ValueError(f"a view between two others lies at 0 to 1, not {at}")
    from_left = _landed(left, at)
    from_right = _landed(right, 1 - at)
    (moved_l, near_l), (moved_r, near_r) = from_left, from_right
    sees_l, sees_r = near_l > FAR, near_r > FAR
    # both motions as displacement left → right, so that they can be compared
    apart = np.linalg.norm(moved_l + moved_r, axis=-1)
    one_surface = sees_l & sees_r & (apart < SAME_SURFACE)
    left_wins = sees_l & (~sees_r | one_surface | (near_l >= near_r))
    right_wins = sees_r & (~sees_l | one_surface | (near_r > near_l))
    share_l = np.where(left_wins, np.float32(1 - at), np.float32(0))
    share_r = np.where(right_wins, np.float32(at), np.float32(0))
    alone_l, alone_r = left_wins & ~right_wins, right_wins & ~left_wins
    share_l = np.where(alone_l, np.float32(1), share_l)
    share_r = np.where(alone_r, np.float32(1), share_r)
    total = share_l + share_r
    seen = total > 0
    total = np.where(seen, total, np.float32(1))
    places = [_source(moved_l, at), _source(moved_r, 1 - at)]
    shares = [share_l / total, share_r / total]

    def mixed(pictures: tuple[npt.NDArray, npt.NDArray]) -> npt.NDArray[np.float32]:
        made = np.zeros_like(pictures[0], dtype=np.float32)
        for picture, (x, y), share in zip(pictures, places, shares, strict=True):
            moved = cv2.remap(picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
            made += moved * (share if made.ndim == 2 else share[..., None])
        return _continued(made, seen, np.maximum(near_l, near_r))

    luma = np.clip(mixed((left.luma, right.luma)), 0.0, 255.0)
    chroma = None
    if left.chroma is not None and right.chroma is not None:
        chroma = np.clip(mixed((left.chroma, right.chroma)), 0.0, 255.0)
    return IntermediateView(luma=luma, chroma=chroma, seen=seen)


def _source(moved: HrField, at: float) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    """Return where in its neighbour each pixel of the new view comes from, x and y."""
    height, width = moved.shape[:2]
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    step = np.float32(at)
    return columns - step * moved[..., 0], rows - step * moved[..., 1]


def _landed(neighbour: Neighbour, at: float) -> tuple[HrField, npt.NDArray[np.float32]]:
    """Return motion and nearness of the nearest surface at each pixel of the new view."""
    motion, nearness = neighbour.motion, neighbour.nearness
    landed = np.zeros_like(motion)
    depth = np.full(nearness.shape, FAR, np.float32)
    _splat(np.ascontiguousarray(motion), np.ascontiguousarray(nearness), np.float32(at), landed,
           depth)  # fmt: skip
    return _cracks_closed(landed, depth)


@nb.njit(cache=True, nogil=True)
def _splat(motion, nearness, at, landed, depth):  # type: ignore[no-untyped-def]
    """Let every pixel land on the four pixels around its place; the nearest one stays."""
    height, width = nearness.shape
    for row in range(height):
        for column in range(width):
            x = column + at * motion[row, column, 0]
            y = row + at * motion[row, column, 1]
            left, top = int(np.floor(x)), int(np.floor(y))
            near = nearness[row, column]
            for to_row in range(top, top + 2):
                for to_column in range(left, left + 2):
                    if (
                        0 <= to_row < height
                        and 0 <= to_column < width
                        and abs(x - to_column) < 0.75
                        and abs(y - to_row) < 0.75
                        and near > depth[to_row, to_column]
                    ):
                        depth[to_row, to_column] = near
                        landed[to_row, to_column, 0] = motion[row, column, 0]
                        landed[to_row, to_column, 1] = motion[row, column, 1]


def _cracks_closed(
    landed: HrField, depth: npt.NDArray[np.float32]
) -> tuple[HrField, npt.NDArray[np.float32]]:
    """Fill what stretching has left open: single pixels between landed ones."""
    empty = depth == FAR
    kernel = np.ones((3, 3), np.float32)
    kernel[1, 1] = 0
    full = (~empty).astype(np.float32)
    count = cv2.filter2D(full, cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT)
    crack = empty & (count >= 5)
    safe = np.maximum(count, 1)
    for plane in range(2):
        sums = cv2.filter2D(
            landed[..., plane] * full, cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT
        )
        landed[..., plane] = np.where(crack, sums / safe, landed[..., plane])
    sums = cv2.filter2D(
        np.where(empty, 0, depth), cv2.CV_32F, kernel, borderType=cv2.BORDER_CONSTANT
    )
    return landed, np.where(crack, sums / safe, depth)


def _edge_kept(
    motion: npt.NDArray[np.float32], x: npt.NDArray[np.float32], y: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """Return motion at points: linear, but from the nearest pixel where it jumps."""
    linear = cv2.remap(motion, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    nearest = cv2.remap(motion, x, y, cv2.INTER_NEAREST, borderMode=cv2.BORDER_REPLICATE)
    jumps = np.linalg.norm(linear - nearest, axis=-1) > 0.5
    return np.where(jumps[..., None], nearest, linear)


def _filled(values: npt.NDArray[np.float32], known: Mask) -> npt.NDArray[np.float32]:
    """Return values (H, W, C) with the unknown ones taken from the nearest known pixel."""
    if known.all():
        return values
    _, labels = cv2.distanceTransformWithLabels(
        (~known).astype(np.uint8), cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL
    )
    index = np.zeros(labels.max() + 1, np.intp)
    index[labels[known]] = np.flatnonzero(known.ravel())
    return values.reshape(-1, values.shape[-1])[index[labels]]


def _continued(
    picture: npt.NDArray[np.float32], seen: Mask, nearness: npt.NDArray[np.float32]
) -> npt.NDArray[np.float32]:
    """Fill what neither neighbour sees, in each row from the farther of its two sides."""
    if seen.all():
        return picture
    height, width = seen.shape
    columns = np.broadcast_to(np.arange(width), (height, width))
    before = np.maximum.accumulate(np.where(seen, columns, -1), axis=1)
    after = np.minimum.accumulate(np.where(seen, columns, width)[:, ::-1], axis=1)[:, ::-1]
    rows = np.broadcast_to(np.arange(height)[:, None], (height, width))
    has_before, has_after = before >= 0, after < width
    near_before = np.where(has_before, nearness[rows, np.maximum(before, 0)], np.inf)
    near_after = np.where(has_after, nearness[rows, np.minimum(after, width - 1)], np.inf)
    take = np.where(near_before <= near_after, np.maximum(before, 0), np.minimum(after, width - 1))
    result = np.where(seen if picture.ndim == 2 else seen[..., None], picture, picture[rows, take])
    return np.asarray(result, np.float32)
