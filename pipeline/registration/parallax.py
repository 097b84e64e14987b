"""The motion of a whole view: a homography plus parallax along an epipole.

A pixel p of nearness d lands at ``H p + d e`` (homogeneous). With pinhole
cameras that is exact, whatever factor and offset the nearness carries, since H
absorbs the offset; with calibration it is known, without it is fitted to
sparse matches. It gives each patch its start and says in which direction a
wrong depth moves it. Not in the thesis, which starts from layer-global motion
or from calibration (§2.2, Figure 5); the latter is :func:`from_calibration`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.frames import Calibration
from pipeline.registration.kernels import copy, solve

MIN_MATCHES = 8
"""Fewest matches that a fit is believed from."""

ALONG = 0.1
"""How much a distance along the parallax counts where nearness is not to be believed."""

TRIALS = 300
"""Random samples drawn when nothing is known."""

VOTERS = 300
"""Matches, evenly spread, that vote on each sample."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ParallaxMotion:
    """Where a source pixel of known nearness lands in the reference view, LR pixels."""

    homography: npt.NDArray[np.float64]
    """(3, 3), acts on (x, y, 1)."""

    epipole: npt.NDArray[np.float64]
    """(3,), times nearness."""

    num_inliers: int = 0
    """Matches that support the fit; 0 from calibration."""

    residual: float = float("nan")
    """Median distance of those matches, LR pixels."""

    def land(self, x: npt.ArrayLike, y: npt.ArrayLike, nearness: npt.ArrayLike) -> npt.NDArray:
        """Return landing points (…, 2) of source points, as (x, y) in reference pixels."""
        x, y, nearness = np.broadcast_arrays(
            np.asarray(x, float), np.asarray(y, float), np.asarray(nearness, float)
        )
        point = (
            self.homography[:, 0] * x[..., None]
            + self.homography[:, 1] * y[..., None]
            + self.homography[:, 2]
            + self.epipole * nearness[..., None]
        )
        return point[..., :2] / point[..., 2:]

    def parallax(self, x: npt.ArrayLike, y: npt.ArrayLike, nearness: npt.ArrayLike) -> npt.NDArray:
        """Return the derivative (…, 2) of the landing point with nearness, pixels a unit."""
        x, y, nearness = np.broadcast_arrays(
            np.asarray(x, float), np.asarray(y, float), np.asarray(nearness, float)
        )
        landed = self.land(x, y, nearness)
        depth = (
            self.homography[2, 0] * x
            + self.homography[2, 1] * y
            + self.homography[2, 2]
            + self.epipole[2] * nearness
        )
        return (self.epipole[:2] - landed * self.epipole[2]) / depth[..., None]

    def speed(self, x: float, y: float, nearness: float) -> float:
        """Return the length of that derivative at one point, pixels a unit."""
        (ax, bx, cx), (ay, by, cy), (az, bz, cz) = self.homography.tolist()
        ex, ey, ez = self.epipole.tolist()
        depth = az * x + bz * y + cz + ez * nearness
        u = (ax * x + bx * y + cx + ex * nearness) / depth
        v = (ay * x + by * y + cy + ey * nearness) / depth
        return math.hypot(ex - u * ez, ey - v * ez) / abs(depth)


def identity() -> ParallaxMotion:
    """Return the motion of a view onto itself."""
    return ParallaxMotion(homography=np.eye(3), epipole=np.zeros(3))


def from_calibration(source: Calibration, reference: Calibration) -> ParallaxMotion:
    """Return the motion that two calibrated cameras define, for nearness = 1 / depth.

    Thesis §2.2 (initialisation from calibration): p' ~ K' R K⁻¹ p + (1/z) K' t.
    """
    relative = reference.world_to_camera @ np.linalg.inv(source.world_to_camera)
    return ParallaxMotion(
        homography=reference.intrinsics @ relative[:3, :3] @ np.linalg.inv(source.intrinsics),
        epipole=reference.intrinsics @ relative[:3, 3],
    )


@njit(nogil=True, cache=True, error_model="numpy")
def _correlation(patch, energy, reference, cx, cy, radius):
    """Return the normalised cross-correlation of a zero-mean patch with the image at (cx, cy)."""
    side = 2 * radius + 1
    cross = np.float32(0.0)
    total = np.float32(0.0)
    square = np.float32(0.0)
    for a in range(side):
        for b in range(side):
            value = reference[cy + a - radius, cx + b - radius]
            cross += patch[a, b] * value
            total += value
            square += value * value
    return _normalised(cross, total, square, energy, side)


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def _normalised(cross, total, square, energy, side):
    """Return the correlation of a zero-mean patch with what the sums were taken of."""
    spread = square - total * total / (side * side)
    return cross / np.sqrt(energy * max(spread, np.float32(1e-3)) + np.float32(1e-3))


@njit(nogil=True, cache=True, error_model="numpy", _nrt=False)
def _sum_along(patch, reference, left, top, count, sums):
    """Write the three sums of a correlation at every second column, many beside each other."""
    cross, total, square = sums[0], sums[1], sums[2]
    for n in range(count):
        cross[n] = total[n] = square[n] = np.float32(0.0)
    for a in range(patch.shape[0]):
        row = np.uint64(top + a)
        for b in range(patch.shape[1]):
            tap = patch[a, b]
            for n in range(count):
                value = reference[row, np.uint64(left + b + 2 * n)]
                cross[n] += tap * value
                total[n] += value
                square[n] += value * value


@njit(nogil=True, cache=True, error_model="numpy")
def _search(source, reference, points, radius, reach_x, reach_y, shift, score):
    """Write for each point the shift of best normalised cross-correlation, to sub-pixels.

    Every second column is tried, then the neighbours of the best.
    """
    height, width = source.shape
    side = 2 * radius + 1
    patch = np.empty((side, side), np.float32)
    near = np.empty((3, 3), np.float32)
    sums = np.empty((3, reach_x + 1), np.float32)
    for k in range(points.shape[0]):
        px, py = points[k, 0], points[k, 1]
        mean = np.float32(0.0)
        for a in range(side):
            for b in range(side):
                patch[a, b] = source[py + a - radius, px + b - radius]
                mean += patch[a, b]
        mean /= side * side
        energy = np.float32(0.0)
        for a in range(side):
            for b in range(side):
                patch[a, b] -= mean
                energy += patch[a, b] * patch[a, b]
        best = np.float32(-2.0)
        best_x = 0
        best_y = 0
        for dy in range(-reach_y, reach_y + 1):
            cy = py + dy
            if cy < radius or cy >= height - radius:
                continue
            first = max(-reach_x, radius - px)
            last = min(reach_x, width - radius - 1 - px)
            count = max(0, (last - first) // 2 + 1)
            _sum_along(patch, reference, px + first - radius, cy - radius, count, sums)
            for n in range(count):
                ncc = _normalised(sums[0, n], sums[1, n], sums[2, n], energy, side)
                if ncc > best:
                    best = ncc
                    best_x = first + 2 * n
                    best_y = dy
        # climb to the very top, one pixel at a time
        for _ in range(3):
            for i in range(3):
                for j in range(3):
                    cx = px + best_x + j - 1
                    cy = py + best_y + i - 1
                    if radius <= cx < width - radius and radius <= cy < height - radius:
                        near[i, j] = _correlation(patch, energy, reference, cx, cy, radius)
                    else:
                        near[i, j] = -2.0
            top = 4
            for m in range(9):
                if near[m // 3, m % 3] > near[top // 3, top % 3]:
                    top = m
            best = near[top // 3, top % 3]
            if top == 4:
                break
            best_y += top // 3 - 1
            best_x += top % 3 - 1
        sub_x = np.float32(0.0)
        sub_y = np.float32(0.0)
        if top == 4 and near[1, 0] > -1.5 and near[1, 2] > -1.5:
            bend = near[1, 0] - 2 * best + near[1, 2]
            if bend < 0:
                sub_x = np.float32(0.5) * (near[1, 0] - near[1, 2]) / bend
        if top == 4 and near[0, 1] > -1.5 and near[2, 1] > -1.5:
            bend = near[0, 1] - 2 * best + near[2, 1]
            if bend < 0:
                sub_y = np.float32(0.5) * (near[0, 1] - near[2, 1]) / bend
        shift[k, 0] = best_x + sub_x
        shift[k, 1] = best_y + sub_y
        score[k] = best


@njit(nogil=True, cache=True, error_model="numpy")
def _refit(basis, target, directions, along, size, hold, weights, distance, solution):
    """Fit the eleven-parameter model by weighted least squares; False where that is degenerate.

    Parameters
    ----------
    basis, target : (M, 4), (M, 2) float64
        1, x, y, nearness of the points, and where they land, all of order one.
    directions : (M, 2) float64
        Unit vectors; distances along them are multiplied by ``along``.
    size : float
        Pixels of one unit.
    hold : (11,) float64
        Ridge.
    weights : (M,) float64
    distance, solution : (M,), (11,) float64
        Modified: the matches' distances in pixels, the model.
    """
    count = basis.shape[0]
    matrix = np.zeros((11, 11))
    step = np.zeros(11)
    row = np.empty(11)
    for k in range(count):
        if weights[k] <= 0:
            continue
        denominator = 1.0
        for m in range(3):
            denominator += basis[k, 1 + m] * solution[8 + m]
        dx, dy = directions[k, 0], directions[k, 1]
        for side in range(2):
            nx = dx if side == 0 else -dy
            ny = dy if side == 0 else dx
            factor = np.sqrt(weights[k]) / denominator * (along if side == 0 else 1.0)
            for m in range(4):
                row[m] = factor * nx * basis[k, m]
                row[4 + m] = factor * ny * basis[k, m]
            goal = factor * (nx * target[k, 0] + ny * target[k, 1])
            for m in range(3):
                row[8 + m] = -goal * basis[k, 1 + m]
            for m in range(11):
                value = row[m]
                step[m] += value * goal
                for n in range(m + 1):
                    matrix[m, n] += value * row[n]
    for m in range(11):
        matrix[m, m] += hold[m]
    if not solve(matrix, step):
        return False
    copy(step, solution)
    for k in range(count):
        u = v = 0.0
        denominator = 1.0
        for m in range(4):
            u += basis[k, m] * solution[m]
            v += basis[k, m] * solution[4 + m]
        for m in range(3):
            denominator += basis[k, 1 + m] * solution[8 + m]
        u = u / denominator - target[k, 0]
        v = v / denominator - target[k, 1]
        dx, dy = directions[k, 0], directions[k, 1]
        distance[k] = size * np.hypot(along * (dx * u + dy * v), dx * v - dy * u)
    return True


def match_points(
    source: npt.NDArray[np.float32],
    reference: npt.NDArray[np.float32],
    *,
    spacing: int = 6,
    radius: int = 4,
    reach: tuple[float, float] = (0.25, 0.06),
    min_score: float = 0.7,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return matched points of two (coarse) images by exhaustive correlation search.

    Parameters
    ----------
    source, reference : (H, W) float32
    spacing, radius : int
        Grid of the points and half side of the patches, pixels of these images.
    reach : (float, float)
        Search range along x and y, fractions of width and height.
    min_score : float
        Smallest normalised cross-correlation that counts.

    Returns
    -------
    points, landed : (M, 2) float64
        (x, y) in the source and in the reference; M may be 0.
    """
    height, width = source.shape
    empty = np.empty((0, 2))
    if height < 2 * radius + 3 or width < 2 * radius + 3:
        return empty, empty
    smooth = cv2.GaussianBlur(source, (0, 0), 1.0)
    gradient = cv2.Sobel(smooth, cv2.CV_32F, 1, 0) ** 2 + cv2.Sobel(smooth, cv2.CV_32F, 0, 1) ** 2
    texture = cv2.boxFilter(gradient, -1, (2 * radius + 1, 2 * radius + 1))
    points = []
    floor = 0.1 * float(np.median(texture)) + 1.0
    for y in range(radius, height - radius, spacing):
        for x in range(radius, width - radius, spacing):
            block = texture[
                y : min(y + spacing, height - radius), x : min(x + spacing, width - radius)
            ]
            k = int(np.argmax(block))
            if block.flat[k] > floor:
                points.append((x + k % block.shape[1], y + k // block.shape[1]))
    if not points:
        return empty, empty
    starts = np.array(points, np.int64)
    shift = np.zeros((len(points), 2), np.float32)
    score = np.zeros(len(points), np.float32)
    reach_x = max(4, int(reach[0] * width))
    reach_y = max(3, int(reach[1] * height))
    _search(source, reference, starts, radius, reach_x, reach_y, shift, score)
    good = score > min_score
    return starts[good].astype(float), starts[good] + shift[good].astype(float)


def fit_parallax(
    points: npt.NDArray[np.float64],
    landed: npt.NDArray[np.float64],
    nearness: npt.NDArray[np.float64],
    *,
    start: ParallaxMotion | None = None,
    directions: npt.NDArray[np.float64] | None = None,
    tolerance: float = 6.0,
    rounds: int = 12,
    seed: int = 0,
) -> ParallaxMotion | None:
    """Return the homography plus parallax that most matches agree on, or None.

    Random sampling with an affine-plus-parallax model finds the inliers, unless
    a start tells them; then the eleven-parameter model is fitted by iteratively
    re-weighted least squares.

    Parameters
    ----------
    points, landed : (M, 2) float64
        Matches, LR pixels.
    nearness : (M,) float64
        Of the points, finite.
    start : ParallaxMotion, optional
        A motion whose inliers are taken instead of sampling for them.
    directions : (M, 2) float64, optional
        Unit vectors along the parallax: distances along them count little, as a point's
        nearness may be wrong.
    tolerance : float
        Distance of an inlier to begin with, LR pixels.
    rounds, seed : int
        Re-weightings, and the seed of the sampling.
    """
    count = len(points)
    if count < MIN_MATCHES:
        return None
    centre = points.mean(axis=0)
    size = max(float(np.abs(points - centre).max()), 1.0)
    d_centre = float(np.median(nearness))
    d_size = float(np.percentile(np.abs(nearness - d_centre), 90))
    if d_size < 1e-12 * max(1.0, abs(d_centre)):
        d_size = 1.0
    depth_counts = bool(np.ptp(nearness) > 0)
    basis = np.column_stack(
        [
            np.ones(count),
            (points - centre) / size,
            (nearness - d_centre) / d_size if depth_counts else np.zeros(count),
        ]
    )
    if start is not None:
        away = start.land(points[:, 0], points[:, 1], nearness) - landed
        inliers = (away**2).sum(axis=1) < tolerance**2
    else:
        inliers = _sampled_inliers(basis, landed - points, size, tolerance, seed)
    if inliers.sum() < MIN_MATCHES:
        return None
    # x' (1 + c) = a, y' (1 + c) = b with a, b, c linear in the basis (c without constant)
    target = (landed - centre) / size
    weights = inliers.astype(float)
    # the projective part is small; it is held unless the matches insist
    hold = np.full(11, 1e-9)
    hold[8:] = (0.3 / size) ** 2 * weights.sum() / 0.05**2 / 10
    if not depth_counts:
        hold[[3, 7, 10]] = 1e9
    along, floor = (1.0, 0.5) if directions is None else (ALONG, 0.1)
    unit = np.tile([1.0, 0.0], (count, 1)) if directions is None else directions
    solution = np.zeros(11)
    distance = np.empty(count)
    for number in range(rounds):
        if not _refit(basis, target, unit, along, size, hold, weights, distance, solution):
            return None
        sigma = max(1.4826 * float(np.median(distance[weights > 0])), 0.01)
        cut = max(4.0 * sigma, floor) * (2.0 if number < rounds // 4 else 1.0)
        weights = np.fmax(0.0, 1 - (distance / cut) ** 2) ** 2
        if np.count_nonzero(weights) < MIN_MATCHES:
            return None
    a, b, c = solution[:4], solution[4:8], solution[8:]
    # undo the normalisation
    to_unit = np.array(
        [[1 / size, 0, -centre[0] / size], [0, 1 / size, -centre[1] / size], [0, 0, 1]]
    )
    from_unit = np.array([[size, 0, centre[0]], [0, size, centre[1]], [0, 0, 1]])
    unit = np.array([[a[1], a[2], a[0]], [b[1], b[2], b[0]], [c[0], c[1], 1.0]])
    epipole = np.array([a[3], b[3], c[2]])
    homography = from_unit @ unit @ to_unit - np.outer(
        from_unit @ epipole * (d_centre / d_size), [0.0, 0.0, 1.0]
    )
    support = weights > 0
    return ParallaxMotion(
        homography=homography,
        epipole=from_unit @ epipole / d_size,
        num_inliers=int(support.sum()),
        residual=float(np.median(distance[support])),
    )


def _sampled_inliers(
    basis: npt.NDArray[np.float64],
    shift: npt.NDArray[np.float64],
    size: float,
    tolerance: float,
    seed: int,
) -> npt.NDArray[np.bool_]:
    """Return which matches agree with the best of many five-point fits, (M,) bool.

    The displacement is affine in place and nearness here; least squares with a small ridge.
    """
    count = len(basis)
    generator = np.random.default_rng(seed)
    chosen = generator.integers(0, count, (TRIALS, 5))
    block = basis[chosen]
    ridge = np.diag([1e-9, 1e-3, 1e-3, 1e-3])
    solutions = np.linalg.solve(
        np.einsum("tki,tkj->tij", block, block) + ridge,
        np.einsum("tki,tkc->tic", block, shift[chosen]),
    )
    voters = np.unique(np.linspace(0, count - 1, VOTERS).astype(int))
    distance2 = ((basis[voters] @ solutions - shift[voters]) ** 2).sum(axis=2)
    votes = np.maximum(0.0, 1 - distance2 / tolerance**2).sum(axis=1)
    votes[np.abs(solutions[:, 1:3]).max(axis=(1, 2)) > 0.3 * size] = -1.0
    best = solutions[int(np.argmax(votes))]
    return ((basis @ best - shift) ** 2).sum(axis=1) < tolerance**2
