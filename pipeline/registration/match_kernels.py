"""Compiled loops that look for patches of one picture in another, by normalised correlation."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import EXACT

OPTIONS = {**EXACT, "_nrt": True}
"""Of the loops that make arrays."""


@njit(**EXACT)
def pick(texture, spacing, radius, floor, points):
    """Write the place of most texture in each block of a grid; return how many there are.

    Parameters
    ----------
    texture : (H, W) float32
    spacing, radius : int
        Side of the blocks, and how far they stay from the sides, pixels.
    floor : float32
        Texture up to which a place is left out.
    points : (N, 2) int64
        Written: x, y.
    """
    height, width = texture.shape
    count = 0
    for top in range(radius, height - radius, spacing):
        for left in range(radius, width - radius, spacing):
            best_x, best_y = left, top
            for y in range(top, min(top + spacing, height - radius)):
                for x in range(left, min(left + spacing, width - radius)):
                    if texture[y, x] > texture[best_y, best_x]:
                        best_x, best_y = x, y
            if texture[best_y, best_x] > floor:
                points[count, 0], points[count, 1] = best_x, best_y
                count += 1
    return count


@njit(**EXACT)
def _sum_boxes(picture, side, total, square):
    """Write the sums of the pixels of each box, and of their squares, where its corner is."""
    count = total.shape[1]
    for y in range(total.shape[0]):
        for x in range(count):
            total[y, x] = square[y, x] = np.float32(0.0)
        for a in range(side):
            for b in range(side):
                for x in range(count):
                    value = picture[np.uint64(y + a), np.uint64(x + b)]
                    total[y, x] += value
                    square[y, x] += value * value


@njit(**EXACT)
def _normalised(cross, total, square, energy, side):
    """Return the correlation of a zero-mean patch with a box of such sums."""
    spread = square - total * total / (side * side)
    return cross / np.sqrt(energy * max(spread, np.float32(1e-3)) + np.float32(1e-3))


@njit(**EXACT)
def _correlation(patch, energy, reference, boxes, left, top):
    """Return the normalised cross-correlation of a zero-mean patch with one box."""
    side = patch.shape[0]
    cross = np.float32(0.0)
    for a in range(side):
        for b in range(side):
            cross += patch[a, b] * reference[top + a, left + b]
    return _normalised(cross, boxes[0][top, left], boxes[1][top, left], energy, side)


@njit(**EXACT)
def _correlate_along(patch, energy, halves, boxes, left, top, count, cross, scores):
    """Write the correlations with the boxes at every second column, many beside each other."""
    side = patch.shape[0]
    for n in range(count):
        cross[n] = np.float32(0.0)
    for a in range(side):
        row = np.uint64(top + a)
        for b in range(side):
            tap = patch[a, b]
            half = halves[(left + b) & 1]
            first = (left + b) >> 1
            for n in range(count):
                cross[n] += tap * half[row, np.uint64(first + n)]
    total, square = boxes[0][top], boxes[1][top]
    for n in range(count):
        x = np.uint64(left + 2 * n)
        scores[n] = _normalised(cross[n], total[x], square[x], energy, side)


@njit(**EXACT)
def _take_patch(source, px, py, radius, patch):
    """Write the pixels around a point less their mean; return the sum of their squares."""
    side = patch.shape[0]
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
    return energy


@njit(**EXACT)
def _climb(patch, energy, reference, boxes, px, py, radius, near):
    """Go to the very top of the correlation, one pixel at a time; see :func:`search`.

    Returns
    -------
    x, y : int
        Where that is.
    top : int
        Number of the largest of ``near``, (3, 3), the correlations there; 4: the middle.
    """
    height, width = reference.shape
    top = 4
    for _ in range(3):
        for i in range(3):
            for j in range(3):
                cx = px + j - 1
                cy = py + i - 1
                if radius <= cx < width - radius and radius <= cy < height - radius:
                    near[i, j] = _correlation(
                        patch, energy, reference, boxes, cx - radius, cy - radius
                    )
                else:
                    near[i, j] = -2.0
        top = 4
        for m in range(9):
            if near[m // 3, m % 3] > near[top // 3, top % 3]:
                top = m
        if top == 4:
            break
        py += top // 3 - 1
        px += top % 3 - 1
    return px, py, top


@njit(**OPTIONS)
def search(source, reference, points, radius, reach_x, reach_y, shift, score):
    """Write for each point the shift of best normalised cross-correlation, to sub-pixels.

    Every second column is tried, then the neighbours of the best.

    Parameters
    ----------
    source, reference : (H, W), (H', W') float32
    points : (N, 2) int64
    radius : int
        Half the side of the patches.
    reach_x, reach_y : int
        The largest shifts.
    shift, score : (N, 2), (N,) float32
        Written.
    """
    height, width = reference.shape
    side = 2 * radius + 1
    patch = np.empty((side, side), np.float32)
    near = np.empty((3, 3), np.float32)
    cross = np.empty(reach_x + 1, np.float32)
    scores = np.empty(reach_x + 1)
    halves = np.zeros((2, height, (width + 1) // 2), np.float32)
    for y in range(height):
        for x in range(width):
            halves[x & 1, y, x >> 1] = reference[y, x]
    boxes = (
        np.empty((height - 2 * radius, width - 2 * radius), np.float32),
        np.empty((height - 2 * radius, width - 2 * radius), np.float32),
    )
    _sum_boxes(reference, side, boxes[0], boxes[1])
    for k in range(points.shape[0]):
        px, py = points[k, 0], points[k, 1]
        energy = _take_patch(source, px, py, radius, patch)
        best = -2.0
        best_x = 0
        best_y = 0
        for dy in range(-reach_y, reach_y + 1):
            cy = py + dy
            if cy < radius or cy >= height - radius:
                continue
            first = max(-reach_x, radius - px)
            last = min(reach_x, width - radius - 1 - px)
            count = max(0, (last - first) // 2 + 1)
            _correlate_along(
                patch, energy, halves, boxes, px + first - radius, cy - radius, count, cross,
                scores,
            )  # fmt: skip
            for n in range(count):
                if scores[n] > best:
                    best = scores[n]
                    best_x = first + 2 * n
                    best_y = dy
        x, y, top = _climb(patch, energy, reference, boxes, px + best_x, py + best_y, radius, near)
        best_x, best_y = x - px, y - py
        highest = near[top // 3, top % 3]
        sub_x = np.float32(0.0)
        sub_y = np.float32(0.0)
        if top == 4 and near[1, 0] > -1.5 and near[1, 2] > -1.5:
            bend = near[1, 0] - 2 * highest + near[1, 2]
            if bend < 0:
                sub_x = np.float32(0.5) * (near[1, 0] - near[1, 2]) / bend
        if top == 4 and near[0, 1] > -1.5 and near[2, 1] > -1.5:
            bend = near[0, 1] - 2 * highest + near[2, 1]
            if bend < 0:
                sub_y = np.float32(0.5) * (near[0, 1] - near[2, 1]) / bend
        shift[k, 0] = best_x + sub_x
        shift[k, 1] = best_y + sub_y
        score[k] = highest
