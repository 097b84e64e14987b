"""Which pixels to trust, and why not the others: registration weights and verification.

Thesis §2.2, Eq. 3 and Eq. 4. *Deviation*: as printed Eq. 4 zeroes small weights and
small depth differences, the good ones; here the large ones are rejected.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT, INLINED, LEAN
from pipeline.frames import GreyImage, Mask, Positions, Rejection
from pipeline.threads import map_threads, shares

_NO_MOTION, _OUTSIDE, _WEIGHT, _DEPTH, _EDGE, _OCCLUDED = (
    int(Rejection.NO_MOTION), int(Rejection.OUTSIDE), int(Rejection.WEIGHT),
    int(Rejection.DEPTH), int(Rejection.EDGE), int(Rejection.OCCLUDED),
)  # fmt: skip
"""The bits as compiled loops know them."""

_NOWHERE = np.int32(-(2**31))
"""What stands for the coefficients of a pixel that lands outside the reference."""

_FAR = np.float32(1e9)
"""Displacement that stands for none, LR pixels."""

NO_WEIGHT = 1e6
"""Square that stands for a registration weight that there is none of, grey levels²."""

EDGE_JUMP = 0.5
"""Difference of adjacent pixels' displacements that makes an edge, LR pixels."""

EDGE_REACH = 4
"""How far from an edge pixels are held to a stricter T_w, LR pixels."""

EDGE_STRICTNESS = 0.5
"""That T_w, as a share of T_w."""

_BITS = {
    reason.name.lower(): reason.value.bit_length() - 1
    for reason in Rejection
    if reason.name and reason.value
}
"""Which bit of the flags says so, by a reason's lower-case name."""


def registration_weights(
    reference_coefficients: npt.NDArray[np.float32],
    position: Positions,
    source: GreyImage,
    offset: npt.NDArray[np.float32],
    *,
    before: tuple[GreyImage, Mask] | None = None,
) -> GreyImage:
    """Return I_W = I_ref(x + u, y + v) − I_n(x, y) + ζ — Eq. (3); NaN where there is none.

    Parameters
    ----------
    reference_coefficients : (H' + 4, W' + 4) float32
        Spline coefficients of the reference's luma.
    position : (H, W, 2) float32
        Landing points, LR pixels of the reference.
    source, offset : (H, W) float32
        Luma of the source and intensity term ζ, grey levels.
    before : (weights, pixels to renew), optional
        Where only some are wanted: what the others keep.
    """
    weights, renewed = before or (np.empty(source.shape, np.float32), np.ones(source.shape, bool))
    weights = weights.copy()
    width, taps = source.shape[1], reference_coefficients.reshape(-1)

    def weigh(rows: slice) -> None:
        lines = tuple(np.empty(width, np.float32) for _ in range(3))
        _weigh(
            reference_coefficients, taps, position[rows], source[rows], offset[rows],
            renewed[rows], lines, np.empty(width, np.int32), weights[rows],
        )  # fmt: skip

    map_threads(weigh, shares(len(weights)))
    return weights


@njit(**LEAN)
def _weigh(reference, taps, position, source, offset, renewed, lines, places, weights):
    """Write the registration weights of some pixels; ``lines`` and ``places`` are scratch."""
    along, down, value = lines
    height, width = reference.shape[0] - 4, reference.shape[1] - 4
    line = np.int64(reference.shape[1])
    columns = weights.shape[1]
    for y in range(weights.shape[0]):
        row = np.uint64(y)
        wanted = False
        for k in range(columns):
            x = np.uint64(k)
            wanted |= renewed[row, x]
            along[x], down[x] = position[row, x, 0], position[row, x, 1]
        if not wanted:
            continue
        _place_row(along, down, np.float32(height), np.float32(width), np.int32(line), places)
        start = np.int64(0)  # typed: a literal has what it goes to compiled twice
        while start < columns:
            place = places[np.uint64(start)]
            end = start + 1
            while end < columns and places[np.uint64(end)] == place:
                end += 1
            if place == _NOWHERE:
                for k in range(start, end):
                    value[np.uint64(k)] = np.float32(np.nan)
            else:
                _sample_beside(taps, np.int64(place), line, along, down, start, end, value)
            start = end
        for k in range(columns):
            x = np.uint64(k)
            weight = value[x] - source[row, x] + offset[row, x]
            weights[row, x] = weight if renewed[row, x] else weights[row, x]


@njit(**INLINED)
def _place_row(along, down, height, width, line, places):
    """Write which coefficients pixels of a row land on, and replace points by what is beyond them.

    As long as a place, less the number of the pixel, stays the same, pixels land beside each other.
    """
    half, zero, one = np.float32(0.5), np.float32(0.0), np.int32(1)
    for k in range(places.size):
        x = np.uint64(k)
        right, below = along[x] + half, down[x] + half
        inside = (right > zero) & (below > zero) & (right < width) & (below < height)
        i, j = np.int32(below if inside else zero), np.int32(right if inside else zero)
        along[x] -= np.float32(j)
        down[x] -= np.float32(i)
        places[x] = (i + one) * line + j + one - np.int32(k) if inside else _NOWHERE


@njit(**INLINED)
def _sample_beside(taps, place, line, along, down, start, end, value):
    """Write samples of a spline beside each other, the first coefficient of k at place + k."""
    half, three_quarters = np.float32(0.5), np.float32(0.75)
    for k in range(start, end):
        x = np.uint64(k)
        one, two = np.uint64(1), np.uint64(2)
        a, b, c = np.uint64(place + k), np.uint64(place + line + k), np.uint64(place + 2 * line + k)
        tx, ty = along[x], down[x]
        x0 = half * (half - tx) * (half - tx)
        x1 = three_quarters - tx * tx
        x2 = half * (half + tx) * (half + tx)
        y0 = half * (half - ty) * (half - ty)
        y1 = three_quarters - ty * ty
        y2 = half * (half + ty) * (half + ty)
        above = x0 * taps[a] + x1 * taps[a + one] + x2 * taps[a + two]
        own = x0 * taps[b] + x1 * taps[b + one] + x2 * taps[b + two]
        below = x0 * taps[c] + x1 * taps[c + one] + x2 * taps[c + two]
        value[x] = y0 * above + y1 * own + y2 * below


@njit(nogil=True, cache=True, error_model="numpy")
def _nearest_landing(position, nearness, nearest):
    """Write the largest nearness that lands on each reference pixel, in place."""
    half, zero = np.float32(0.5), np.float32(0.0)
    height, width = np.float32(nearest.shape[0]), np.float32(nearest.shape[1])
    for row in range(position.shape[0]):
        for column in range(position.shape[1]):
            x, y = position[row, column, 0] + half, position[row, column, 1] + half
            if not (x > zero and y > zero and x < width and y < height):
                continue
            # not negative, and unsigned numbers need no check that they are
            i, j = np.uint64(y), np.uint64(x)
            nearest[i, j] = max(nearest[i, j], nearness[row, column])


@njit(**EXACT)
def _flag(
    position, squares, nearness, known, reference, reference_known, nearest, jumps, beside, limits,
    renewed, flags,
):  # fmt: skip
    """Write the rejection bits of some pixels.

    ``squares`` are the mean squares of the weights around each; ``jumps`` and ``beside`` say
    which pixels are next to a jump and which within reach of one; limits are T_w², T_D, the
    z-buffer's margin and the stricter T_w² beside jumps.
    """
    height, width = reference.shape
    half = np.float32(0.5)
    right, bottom = np.float32(width) - half, np.float32(height) - half
    largest, depth, margin, strict = limits[0], limits[1], limits[2], limits[3]
    for y in range(flags.shape[0]):
        row = np.uint64(y)
        for x in range(flags.shape[1]):
            column = np.uint64(x)
            if not renewed[row, column]:
                continue
            u, v = position[row, column, 0], position[row, column, 1]
            square = squares[row, column]
            bits = np.uint8(0)
            if jumps[row, column] or (beside[row, column] and square > strict):
                bits = np.uint8(_EDGE)
            if not (u > -half and v > -half and u < right and v < bottom):
                seen = np.isfinite(u) and np.isfinite(v)
                flags[row, column] = bits | np.uint8(_OUTSIDE if seen else _NO_MOTION)
                continue
            # not negative, and unsigned numbers need no check that they are
            i, j = np.uint64(v + 0.5), np.uint64(u + 0.5)
            if square > largest:
                bits |= np.uint8(_WEIGHT)  # Eq. (4), first case
            d = nearness[row, column]
            says = known[row, column] and reference_known[i, j]
            if says and abs(reference[i, j] - d) > depth:
                # a pixel beside an edge may belong to the surface next door
                away = _nearest_depth(reference, reference_known, np.int64(i), np.int64(j), d)
                if away > depth:
                    bits |= np.uint8(_DEPTH)  # Eq. (4), second case
            if nearest[i, j] > d + margin:
                bits |= np.uint8(_OCCLUDED)
            flags[row, column] = bits


@njit(**EXACT)
def _nearest_depth(reference, known, i, j, d):
    """Return by how much the nearness around a pixel differs from another one at least."""
    away = np.inf
    for k in range(max(i - 1, 0), min(i + 2, reference.shape[0])):
        for m in range(max(j - 1, 0), min(j + 2, reference.shape[1])):
            if known[k, m]:
                away = min(away, abs(reference[k, m] - d))
    return away


@njit(**EXACT)
def _jumps(position, limit, wanted, rows, down, right, jumps):
    """Mark both pixels of adjacent ones whose displacements differ by more than the limit.

    A pixel without a motion makes a jump to one that has. ``wanted`` are the pixels that are
    compared with those to their right and below.

    Parameters
    ----------
    rows : (4, W) float32
        Scratch: displacements of two rows, along x and y of each.
    down, right : (W,), (W + 1,) uint8
        Scratch, zero: jumps from the row above, and from the pixel to the left.
    """
    height = jumps.shape[0]
    above, above_y, own, own_y = rows[0], rows[1], rows[2], rows[3]
    for y in range(height):
        if y % 2 == 0:
            u, v, next_u, next_v = above, above_y, own, own_y
        else:
            u, v, next_u, next_v = own, own_y, above, above_y
        if y == 0:
            _displacements(position, np.int64(0), u, v)  # typed, as above
        row = np.uint64(y)
        if y + 1 < height:
            _displacements(position, y + 1, next_u, next_v)
            _mark_jumps(u, v, next_u, next_v, limit, wanted[row], down, right, jumps[row])
        else:  # below the last row there is none
            _mark_jumps(u, v, u, v, limit, wanted[row], down, right, jumps[row])


@njit(**EXACT)
def _displacements(position, y, u, v):
    """Write the displacements of a row, something far away where there is none."""
    row = np.uint64(y)
    for k in range(u.size):
        x = np.uint64(k)
        along = position[row, x, 0] - np.float32(k)
        below = position[row, x, 1] - np.float32(y)
        moves = (abs(along) < np.inf) & (abs(below) < np.inf)
        u[x] = along if moves else _FAR
        v[x] = below if moves else _FAR


@njit(**EXACT)
def _mark_jumps(u, v, next_u, next_v, limit, wanted, down, right, jumps):
    """Write the jumps of a row, ``down`` those of the next one from it; see :func:`_jumps`."""
    for k in range(u.size - 1):
        x, beside = np.uint64(k), np.uint64(k + 1)
        apart = (abs(u[beside] - u[x]) > limit) | (abs(v[beside] - v[x]) > limit)
        right[beside] = apart & wanted[x]
    for k in range(u.size):
        x, beside = np.uint64(k), np.uint64(k + 1)
        apart = (abs(next_u[x] - u[x]) > limit) | (abs(next_v[x] - v[x]) > limit)
        apart &= wanted[x]
        jumps[x] = down[x] | apart | right[x] | right[beside]
        down[x] = apart


def verify(
    position: Positions,
    weights: GreyImage,
    nearness: npt.NDArray[np.float32],
    known: npt.NDArray[np.bool_],
    reference_nearness: npt.NDArray[np.float32],
    reference_known: npt.NDArray[np.bool_],
    *,
    weight_threshold: float,
    depth_threshold: float,
    before: tuple[npt.NDArray[np.uint8], Mask] | None = None,
) -> npt.NDArray[np.uint8]:
    """Return the :class:`Rejection` bits of every pixel — Eq. (4), and occlusion.

    |I_W| is taken as its root mean square over 3 × 3 pixels, so that one noisy pixel
    on a good patch is kept and one lucky pixel on a bad patch is not. Beside a jump of the
    motion a pixel sees two surfaces: next to it none is trusted, and a little farther only
    those that fit well.

    Parameters
    ----------
    position : (H, W, 2) float32
        Landing points, LR pixels of the reference.
    weights : (H, W) float32
        Registration weights, grey levels.
    nearness, reference_nearness : (H, W), (H', W') float32
        Without NaN.
    known, reference_known : bool arrays of those shapes
        Where depth is not a guess.
    weight_threshold : float
        T_w, grey levels.
    depth_threshold : float
        T_D, units of nearness; ∞ leaves depth out.
    before : (bits, pixels to renew), optional
        Where only some are wanted: what the others keep.
    """
    limits = np.array(
        [
            weight_threshold**2, depth_threshold, depth_threshold,
            (EDGE_STRICTNESS * weight_threshold) ** 2,
        ],
        np.float32,
    )  # fmt: skip
    flags, renewed = before or (np.empty(weights.shape, np.uint8), np.ones(weights.shape, bool))
    flags = flags.copy()

    def find_jumps() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.uint8]]:
        near = renewed
        if before is not None:
            box = np.ones((2 * EDGE_REACH + 1, 2 * EDGE_REACH + 1), np.uint8)
            near = cv2.dilate(renewed.view(np.uint8), box).view(np.bool_)
        jumps = jumps_of_motion(position, near)
        return jumps, within_reach(jumps, EDGE_REACH)

    def find_nearest() -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        nearest = np.full(reference_nearness.shape, -np.inf, np.float32)
        _nearest_landing(position, nearness, nearest)
        return nearest, mean_squares(weights)

    tasks: tuple[Callable[[], tuple[npt.NDArray, npt.NDArray]], ...] = find_jumps, find_nearest
    (jumps, beside), (nearest, squares) = map_threads(lambda task: task(), tasks)

    def flag(rows: slice) -> None:
        _flag(
            position[rows], squares[rows], nearness[rows], known[rows], reference_nearness,
            reference_known, nearest, jumps[rows], beside[rows], limits, renewed[rows],
            flags[rows],
        )  # fmt: skip

    map_threads(flag, shares(len(flags)))
    return flags


def mean_squares(weights: GreyImage) -> npt.NDArray[np.float32]:
    """Return the mean of the squares of 3 × 3 weights, those beyond the sides as those at them."""
    squares = np.empty(weights.shape, np.float32)
    _square(weights, np.float32(NO_WEIGHT), squares)
    return cv2.blur(squares, (3, 3), borderType=cv2.BORDER_REPLICATE)


@njit(nogil=True, cache=True, error_model="numpy")
def _square(weights, nothing, out):
    """Write the squares of weights, and something large where there is none."""
    for row in range(weights.shape[0]):
        for column in range(weights.shape[1]):
            square = weights[row, column] * weights[row, column]
            out[row, column] = square if square < np.inf else nothing


def jumps_of_motion(position: Positions, wanted: Mask | None = None) -> npt.NDArray[np.uint8]:
    """Return which pixels lie at a jump of the motion, (H, W), 1 where they do.

    A jump is a difference of more than ``EDGE_JUMP`` between the displacements of two
    adjacent pixels, so that a slanted surface has none; a pixel without a motion makes one.
    Looked for at pixels wanted, by default at all.
    """
    height, width = position.shape[:2]
    jumps = np.empty((height, width), np.uint8)
    if wanted is None:
        wanted = np.ones(jumps.shape, np.bool_)
    _jumps(
        position, np.float32(EDGE_JUMP), wanted, np.empty((4, width), np.float32),
        np.zeros(width, np.uint8), np.zeros(width + 1, np.uint8), jumps,
    )  # fmt: skip
    return jumps


def within_reach(jumps: npt.NDArray[np.uint8], reach: int) -> npt.NDArray[np.uint8]:
    """Return which pixels lie within reach of a jump; both pixels of it are within reach one."""
    side = 2 * (reach - 1) + 1
    return cv2.dilate(jumps, np.ones((side, side), np.uint8))


def count_rejections(flags: npt.NDArray[np.uint8]) -> dict[str, int]:
    """Return how many pixels carry each reason, by its lower-case name; all reasons listed."""
    counts = np.zeros(8, np.int64)
    flat = np.ascontiguousarray(flags).reshape(-1)
    whole = flat.size // 8 * 8
    _count_by_eights(flat[:whole].view(np.uint64), counts)
    rest = np.zeros(8, np.uint8)
    rest[: flat.size - whole] = flat[whole:]
    _count_by_eights(rest.view(np.uint64), counts)
    return {name: int(counts[bit]) for name, bit in _BITS.items()}


@njit(**LEAN)
def _count_by_eights(words, counts):
    """Count the bits of bytes, eight bytes at once, in place: the lowest one first."""
    lowest, evens = np.uint64(0x0101010101010101), np.uint64(0x00FF00FF00FF00FF)
    # so many that no byte's count is more than it holds
    for start in range(0, words.size, 240):
        some = words[start : start + 240]
        for bit in range(8):
            shift, total = np.uint64(bit), np.uint64(0)
            for k in range(some.size):
                total += (some[k] >> shift) & lowest
            total = (total & evens) + ((total >> np.uint64(8)) & evens)
            counts[bit] += np.int64((total * np.uint64(0x0001000100010001)) >> np.uint64(48))
