"""The motion of a whole view: a homography plus parallax along an epipole.

A pixel p of nearness d lands at ``H p + d e`` (homogeneous): plane plus parallax. With pinhole
cameras that is exact, whatever factor and offset the nearness carries, since H absorbs the offset;
with calibration it is known, without it is fitted to sparse matches. It gives each patch its start
and says in which direction a wrong depth moves it. Not in the thesis, which starts from
layer-global motion or from calibration (§2.2, Figure 5); the latter is :func:`from_calibration`.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import Calibration
from pipeline.registration import match_kernels, parallax_kernels
from pipeline.registration.parallax_kernels import NUM_TERMS

MIN_MATCHES = 8
"""Fewest matches that a fit is believed from."""

ALONG = 0.1
"""How much a distance along the parallax counts where nearness is not to be believed."""

TRIALS = 300
"""Random samples drawn when nothing is known."""

RIDGE = np.array([1e-9, 1e-3, 1e-3, 1e-3])
"""Of the terms of 1, x, y and nearness in each of them."""

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

    @functools.cached_property
    def matrix(self) -> npt.NDArray[np.float64]:
        """(3, 4): both beside each other, as the compiled loops take them."""
        return np.column_stack([self.homography, self.epipole]).astype(float, order="C")

    def land(self, x: npt.ArrayLike, y: npt.ArrayLike, nearness: npt.ArrayLike) -> npt.NDArray:
        """Return landing points (…, 2) of source points, as (x, y) in reference pixels."""
        return self._landed(x, y, nearness)[0]

    def parallax(self, x: npt.ArrayLike, y: npt.ArrayLike, nearness: npt.ArrayLike) -> npt.NDArray:
        """Return the derivative (…, 2) of the landing point with nearness, pixels a unit."""
        return self._landed(x, y, nearness)[1]

    def _landed(
        self, x: npt.ArrayLike, y: npt.ArrayLike, nearness: npt.ArrayLike
    ) -> tuple[npt.NDArray, npt.NDArray]:
        points = np.broadcast_arrays(*(np.asarray(one, float) for one in (x, y, nearness)))
        shape = (*points[0].shape, 2)
        landed, speed = np.empty((points[0].size, 2)), np.empty((points[0].size, 2))
        parallax_kernels.land_all(self.matrix, *(one.ravel() for one in points), landed, speed)
        return landed.reshape(shape), speed.reshape(shape)

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
    points = np.empty((-(-height // spacing) * -(-width // spacing), 2), np.int64)
    floor = np.float32(0.1 * float(np.median(texture)) + 1.0)
    points = points[: match_kernels.pick(texture, spacing, radius, floor, points)]
    shift = np.zeros((len(points), 2), np.float32)
    score = np.zeros(len(points), np.float32)
    reach_x = max(4, int(reach[0] * width))
    reach_y = max(3, int(reach[1] * height))
    match_kernels.search(source, reference, points, radius, reach_x, reach_y, shift, score)
    good = score > min_score
    return points[good].astype(float), points[good] + shift[good].astype(float)


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
    scratch = np.empty(count)
    centre = points.mean(axis=0)
    size = max(float(np.abs(points - centre).max()), 1.0)
    d_centre, d_size = _spread(nearness, scratch)
    depth_counts = bool(nearness.min() < nearness.max())
    basis = np.empty((3, count))
    basis[:2] = ((points - centre) / size).T
    basis[2] = (nearness - d_centre) / d_size if depth_counts else 0.0
    weights = np.empty(count)
    if start is not None:
        parallax_kernels.agree(start.matrix, points, landed, nearness, tolerance, weights)
    else:
        _sampled_inliers(
            basis, np.ascontiguousarray((landed - points).T), size, tolerance, seed, weights
        )
    if np.count_nonzero(weights) < MIN_MATCHES:
        return None
    # x' (1 + c) = a, y' (1 + c) = b with a, b, c linear in the basis (c without constant)
    target = np.ascontiguousarray(((landed - centre) / size).T)
    # the projective part is small; it is held unless the matches insist
    hold = np.full(NUM_TERMS, 1e-9)
    hold[8:] = (0.3 / size) ** 2 * weights.sum() / 0.05**2 / 10
    if not depth_counts:
        hold[[3, 7, 10]] = 1e9
    along, floor = (1.0, 0.5) if directions is None else (ALONG, 0.1)
    unit = np.zeros((2, count))
    if directions is None:
        unit[0] = 1.0
    else:
        unit[:] = directions.T
    solution, distance = np.zeros(NUM_TERMS), np.empty(count)
    rooms = (
        np.empty((6, count)), np.empty((6, 10)), np.empty((NUM_TERMS, NUM_TERMS)),
        np.empty(NUM_TERMS),
    )  # fmt: skip
    for number in range(rounds):
        if not parallax_kernels.refit(
            basis, target, unit, along, size, hold, weights, distance, solution, *rooms
        ):
            return None
        first = number < rounds // 4
        if parallax_kernels.weigh_again(distance, weights, first, floor, scratch) < MIN_MATCHES:
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


def _spread(nearness: npt.NDArray[np.float64], scratch: npt.NDArray) -> tuple[float, float]:
    """Return the median and the ninetieth percentile of the distances from it, 1 where none."""
    count = len(nearness)
    scratch[:] = nearness
    centre = parallax_kernels.middle_of(scratch, count)
    np.abs(nearness - centre, out=scratch)
    size = parallax_kernels.of_rank(scratch, count, int(0.9 * (count - 1)))
    return centre, 1.0 if size < 1e-12 * max(1.0, abs(centre)) else size


def _sampled_inliers(
    basis: npt.NDArray[np.float64],
    shift: npt.NDArray[np.float64],
    size: float,
    tolerance: float,
    seed: int,
    weights: npt.NDArray[np.float64],
) -> None:
    """Write 1 where a match agrees with the best of many five-point fits, else 0, (M,).

    The displacement is affine in place and nearness here; least squares with a small ridge.
    """
    count = basis.shape[1]
    chosen = np.random.default_rng(seed).integers(0, count, (TRIALS, 5))
    voters = np.unique(np.linspace(0, count - 1, VOTERS).astype(int))
    terms = np.empty((2, 4))
    rooms = (
        np.empty((4, 4)), np.empty(4), np.empty((2, 4)), np.empty((3, len(voters))),
        np.empty((2, len(voters))),
    )  # fmt: skip
    parallax_kernels.vote(basis, shift, chosen, voters, RIDGE, tolerance, 0.3 * size, terms, rooms)
    away = terms[:, :1] + terms[:, 1:] @ basis - shift
    weights[:] = (away**2).sum(axis=0) < tolerance**2
