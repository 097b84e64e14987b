"""Compiled loops over a picture and the mean of the frames before it, row by row."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import EXACT, LEAN, OPTIONS
from pipeline.reconstruction.rows import blur_ring, blur_row, mirror
from pipeline.temporal.lagging import add_row, add_tiles, ask_tiles, tile_of

PASSED = 1 / 6
"""Share of the noise's power that the smoothing of a difference leaves."""

TOLERATED = 1.5
"""Grey levels by which it may differ beside the noise."""

EXCESS = 2.5
"""Power of the noise in a box, over its mean, that still is noise."""

WIDE_BOX = 15
"""Side of the box over which the difference itself is averaged, LR pixels: what is too faint
for the small box, a shadow say, but wide."""

WIDE_TOLERATED = 0.4
"""Grey levels by which that mean may differ beside four standard deviations of its noise."""

CHANGE_REACH = 2
"""How far a change reaches into what is reconstructed, LR pixels."""

NARROW = 1
"""Pixels on each side of one that have changed with it somewhere: what changes is wider than a
pixel, what noise feigns is not."""


@njit(**OPTIONS)
def compare(
    luma, means, frames, most, noise, bound, gauss, box, wide_box, first, second, fine_before,
    restless, detail, fine, changed, reached, sums, numbers, mean, count,
):  # fmt: skip
    """Write how a picture differs from the mean before it, and the mean that it has joined.

    Rows stream by: nothing but what is asked for leaves the processor's cache.

    Parameters
    ----------
    luma, means, frames : (H, W) float32
        The picture, the mean, and of how many frames it is one.
    most : int
        Weight of a mean against a picture, at most, frames.
    noise, bound : float
        Grey levels; the difference is cut off at the latter.
    gauss, box, wide_box : float32
        Half taps; the last ones reach farthest.
    first, second, fine_before, restless
        See :func:`lagging.add_row` and :func:`lagging.ask_tiles`.
    detail, fine : (H, W) float32
        Overwritten: what is smoothed, before it is cut off, less the mean of what is cut off over
        the wide box; and what is cut off less what is smoothed.
    changed, reached : (H, W) uint8
        Overwritten: where the mean square of what is smoothed, or the mean over the wide box, is
        more than noise; and what lies within ``CHANGE_REACH`` of it.
    sums, numbers
        See :func:`lagging.add_tiles`.
    mean, count : (H, W) float32
        Overwritten: the mean, which begins anew where something has changed, and of how many
        frames it is one.
    """
    # the row that leaves the wide box is still there when another one enters
    width, lines = luma.shape[1], 2 * wide_box.size
    _compare_rows(
        luma, means, frames, np.float32(most), np.float32(noise), np.float32(bound), gauss, box,
        wide_box, first, second, fine_before, restless, detail, fine, changed, reached, sums,
        numbers, mean, count,
        np.empty((5, lines, width), np.float32), np.empty((2, lines, width), np.uint8),
        np.empty(width + lines, np.float32), np.zeros(width + lines, np.uint8),
        np.empty((2, width), np.float32), np.zeros((8, width), np.float32),
    )  # fmt: skip


@njit(**LEAN)
def _compare_rows(
    luma, means, frames, most, noise, bound, gauss, box, wide_box, first, second, fine_before,
    restless, detail, fine, changed, reached, sums, numbers, mean, count, rings, masks, room,
    mask_room, pair, totals,
):  # fmt: skip
    height, width = luma.shape
    lines = rings.shape[1]
    reach, share = wide_box.size - 1, wide_box[0]
    smoothed, squares, boxes, cut_off, smooth = rings[0], rings[1], rings[2], rings[3], rings[4]
    calm, narrow, line, wide = masks[0], masks[1], pair[0], pair[1]
    total, asked_from, counted, products = totals[0], totals[1], totals[2], totals[3:]
    next_row = next_smooth = next_judged = next_narrow = next_changed = np.int64(0)
    for y in range(height):
        while next_changed < min(height, y + CHANGE_REACH + 1):
            c = next_changed
            while next_narrow < min(height, c + NARROW + 1):
                n = next_narrow
                while next_judged < min(height, n + NARROW + 1):
                    v = next_judged
                    while next_smooth < min(height, v + box.size):
                        u = next_smooth
                        while next_row < min(height, max(u + gauss.size, v + wide_box.size)):
                            at = next_row % lines
                            _differ(luma[next_row], means[next_row], bound, line, cut_off[at])
                            blur_row(line, gauss, room, smoothed[at])
                            blur_row(cut_off[at], wide_box, room, boxes[at])
                            next_row += 1
                        blur_ring(smoothed, u, gauss, height, width, smooth[u % lines])
                        _square(smooth[u % lines], line)
                        blur_row(line, box, room, squares[u % lines])
                        next_smooth += 1
                    blur_ring(squares, v, box, height, width, line)
                    # what a column holds of the wide box goes on from row to row
                    if v == 0:
                        for row in range(-reach, reach + 1):
                            _add(boxes[mirror(row, height) % lines], total)
                    else:
                        _exchange(
                            boxes[mirror(v + reach, height) % lines],
                            boxes[mirror(v - reach - 1, height) % lines], total,
                        )  # fmt: skip
                    _scale(total, share, wide)
                    _judge(frames[v], line, wide, noise, calm[v % lines])
                    _subtract(smooth[v % lines], wide, detail[v])
                    _subtract(cut_off[v % lines], smooth[v % lines], fine[v])
                    next_judged += 1
                _reach_row(calm, n, height, NARROW, mask_room, narrow[n % lines])
                _invert(narrow[n % lines])
                next_narrow += 1
            _reach_row(narrow, c, height, NARROW, mask_room, changed[c])
            average_row(luma[c], means[c], frames[c], changed[c], most, mean[c], count[c])
            next_changed += 1
        _reach_row(changed, y, height, CHANGE_REACH, mask_room, reached[y])
        at = tile_of(y, numbers.shape[0])
        if y == 0 or tile_of(y - 1, numbers.shape[0]) < at:
            ask_tiles(restless[at], asked_from)
        add_row(
            detail[y], fine[y], first[y], second[y], fine_before[y], frames[y], reached[y],
            asked_from, products, counted,
        )  # fmt: skip
        if y == height - 1 or tile_of(y + 1, numbers.shape[0]) > at:
            add_tiles(products, counted, at, sums, numbers)


@njit(**LEAN)
def _differ(own, mean, bound, out, cut_off):
    for x in range(out.size):
        away = own[x] - mean[x]
        out[x] = away
        cut_off[x] = min(max(away, -bound), bound)


@njit(**LEAN)
def _add(row, total):
    for x in range(total.size):
        total[x] += row[x]


@njit(**LEAN)
def _exchange(entering, leaving, total):
    for x in range(total.size):
        total[x] += entering[x] - leaving[x]


@njit(**LEAN)
def _scale(row, share, out):
    for x in range(out.size):
        out[x] = share * row[x]


@njit(**LEAN)
def _square(row, out):
    for x in range(row.size):
        out[x] = row[x] * row[x]


@njit(**LEAN)
def _subtract(row, other, out):
    for x in range(out.size):
        out[x] = row[x] - other[x]


@njit(**LEAN)
def _judge(frames, power, wide, noise, calm):
    """Mark the pixels of a row whose surroundings differ from their mean by no more than noise."""
    one = np.float32(1.0)
    excess = np.float32(EXCESS * PASSED)
    tolerated = np.float32(TOLERATED * TOLERATED)
    spread = np.float32(16.0 / (WIDE_BOX * WIDE_BOX))
    margin = np.float32(WIDE_TOLERATED)
    for x in range(frames.size):
        # of a frame and of a mean of so many; times their number, which spares a division
        number = frames[x]
        variance = noise * noise * (number + one)
        is_strong = (power[x] - tolerated) * number > excess * variance
        # without a root: farther than the margin, and that by more than four deviations
        beyond = abs(wide[x]) - margin
        is_wide = (beyond > 0) & (beyond * beyond * number > spread * variance)
        calm[x] = not (is_strong | is_wide)


@njit(**LEAN)
def _reach_row(ring, y, height, reach, room, out):
    """Write what marks of row y and around reach, from a ring that holds the rows it needs.

    Parameters
    ----------
    ring : (lines, W) uint8
    room : (≥ W + 2·reach,) uint8
        Scratch.
    """
    lines, width = ring.shape[0], out.size
    own = room[reach : reach + width]
    for x in range(width):
        own[x] = ring[y % lines, x]
    for k in range(1, reach + 1):
        _join(ring[max(y - k, 0) % lines], ring[min(y + k, height - 1) % lines], own)
        room[reach - k] = room[reach + width - 1 + k] = 0
    for x in range(width):
        out[x] = own[x]
    for k in range(1, reach + 1):
        _join(room[reach - k :], room[reach + k :], out)


@njit(**LEAN)
def _join(first, second, out):
    for x in range(out.size):
        out[x] |= first[x] | second[x]


@njit(**LEAN)
def _invert(marks):
    for x in range(marks.size):
        marks[x] ^= np.uint8(1)


@njit(**EXACT)
def average_row(now, before, frames, begins, most, mean, count):
    """Write the means that a row has joined; where something has changed it begins a new one.

    Parameters
    ----------
    now, before, frames : (W,) float32
        The row, the means before it, and of how many frames they are.
    begins : (W,) uint8
    most : float32
        Weight of a mean against a frame, at most, frames.
    mean, count : (W,) float32
        Overwritten.
    """
    one = np.float32(1.0)
    # without a branch, many at once
    for x in range(now.size):
        goes_on = min(frames[x] + one, most)
        count[x] = one if begins[x] else goes_on
    for x in range(now.size):
        mean[x] = before[x] + (now[x] - before[x]) / count[x]


@njit(**LEAN)
def take_frames(before, restored, count, again, frames):
    """Write of how many frames pixels were the mean when a target was made of all views.

    Parameters
    ----------
    before : (H, W) float32
        The same after the frame before; it counts where ``restored`` is infinite, else nothing.
    restored : (H, W) float32
        See ``reconstruction.alone.Restored.frames``.
    count : (H, W) float32
        Of how many frames the pixels are the mean now.
    again : (H, W) bool
        Where that counts.
    frames : (H, W) float32
        Overwritten.
    """
    never, nothing = np.float32(np.inf), np.float32(0.0)
    for row in range(frames.shape[0]):
        own, alone, out = before[row], restored[row], frames[row]
        now, marks = count[row], again[row]
        # without a branch, many at once
        for x in range(out.size):
            kept = own[x] if alone[x] == never else nothing
            out[x] = now[x] if marks[x] else kept
