"""Compiled loops over a picture and the mean of the frames before it, row by row."""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import EXACT, LEAN, OPTIONS
from pipeline.reconstruction.rows import make_lines, make_room, mirror, whole
from pipeline.temporal.lagging import (
    NUM_SUMS,
    UNIT,
    add_row,
    add_tiles,
    ask_tiles,
    tile_of,
)

PASSED = 1 / 6
"""Share of the noise's power that the smoothing of a difference leaves."""

TOLERATED = 1.5
"""Grey levels by which it may differ beside the noise."""

EXCESS = 2.5
"""Power of the noise in a box, over its mean, that still is noise."""

BOX = 5
"""Side of the box over which the square of the smoothed difference is averaged, LR pixels."""

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


LINES = 16
"""Rows kept of what streams by, a power of two: the one that leaves the wide box is still there
when another one enters."""

REACH, WIDE_REACH = 2, WIDE_BOX // 2
"""Pixels to each side that the Gaussian and the box reach, and the wide box."""


@njit(**OPTIONS)
def compare(
    luma, means, frames, most, noise, bound, gauss, first, second, fine_before, restless, detail,
    fine, changed, reached, sums, numbers, mean, count,
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
    gauss : (REACH + 1,) float32
        Half taps.
    first, second, fine_before, restless
        See :func:`lagging.add_row` and :func:`lagging.ask_tiles`.
    detail, fine : (H, W) int16
        Overwritten: what is smoothed, before it is cut off, less the mean of what is cut off over
        the wide box; and what is cut off less what is smoothed. In units of ``lagging.UNIT``.
    changed, reached : (H, W) uint8
        Overwritten: where the mean square of what is smoothed, or the mean over the wide box, is
        more than noise; and what lies within ``CHANGE_REACH`` of it.
    sums, numbers
        See :func:`lagging.add_tiles`.
    mean, count : (H, W) float32
        Overwritten: the mean, which begins anew where something has changed, and of how many
        frames it is one.
    """
    width = luma.shape[1]
    _compare_rows(
        luma, means, frames, np.float32(most), np.float32(noise), np.float32(bound), gauss, first,
        second, fine_before, restless, detail, fine, changed, reached, sums, numbers, mean, count,
        make_lines(4 * LINES, whole(width)).reshape(4, LINES, -1),
        np.empty((2, LINES, width), np.uint8),
        make_room(width, REACH), make_room(width, WIDE_REACH),
        np.zeros(width + 2 * CHANGE_REACH, np.uint8), make_lines(3, whole(width + 2 * WIDE_REACH)),
        make_lines(NUM_SUMS + 2, whole(width)),
    )  # fmt: skip


@njit(**LEAN)
def _compare_rows(
    luma, means, frames, most, noise, bound, gauss, first, second, fine_before, restless, detail,
    fine, changed, reached, sums, numbers, mean, count, rings, masks, room, total, mask_room, pair,
    totals,
):  # fmt: skip
    height, width = luma.shape
    smoothed, squares, cut_off, smooth = rings[0], rings[1], rings[2], rings[3]
    calm, narrow, line, wide, fives = masks[0], masks[1], pair[0], pair[1], pair[2]
    products, asked_from = totals[1:], totals[0, :width]
    own, own_total = room[REACH : REACH + width], total[WIDE_REACH : WIDE_REACH + width]
    line, wide = line[:width], wide[:width]
    next_row = next_smooth = next_judged = next_narrow = next_changed = np.int64(0)
    for y in range(height):
        while next_changed < min(height, y + CHANGE_REACH + 1):
            c = next_changed
            while next_narrow < min(height, c + NARROW + 1):
                n = next_narrow
                while next_judged < min(height, n + NARROW + 1):
                    v = next_judged
                    while next_smooth < min(height, v + REACH + 1):
                        u = next_smooth
                        while next_row < min(height, max(u + REACH, v + WIDE_REACH) + 1):
                            at = next_row % LINES
                            _differ(luma[next_row], means[next_row], bound, own, cut_off[at])
                            _mirror_ends(room, width, REACH)
                            _five(room, gauss, smoothed[at, :width])
                            next_row += 1
                        at = u % LINES
                        _five_rows(smoothed, u, height, gauss, smooth[at, :width])
                        _square(smooth[at], own)
                        _mirror_ends(room, width, REACH)
                        _box_five(room, squares[at, :width])
                        next_smooth += 1
                    _box_five_rows(squares, v, height, line)
                    # what a column holds of the wide box goes on from row to row
                    if v == 0:
                        for row in range(-WIDE_REACH, WIDE_REACH + 1):
                            _add(cut_off[mirror(row, height) % LINES], own_total)
                    else:
                        _exchange(
                            cut_off[mirror(v + WIDE_REACH, height) % LINES],
                            cut_off[mirror(v - WIDE_REACH - 1, height) % LINES], own_total,
                        )  # fmt: skip
                    _mirror_ends(total, width, WIDE_REACH)
                    _box_five(total, fives[: width + WIDE_BOX - BOX])
                    _three_fives(fives, wide)
                    _judge(frames[v], line, wide, noise, calm[v % LINES])
                    _subtract(smooth[v % LINES], wide, detail[v])
                    _subtract(cut_off[v % LINES], smooth[v % LINES], fine[v])
                    next_judged += 1
                _reach_row(calm, n, height, NARROW, mask_room, narrow[n % LINES])
                _invert(narrow[n % LINES])
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
            asked_from, products,
        )  # fmt: skip
        if y == height - 1 or tile_of(y + 1, numbers.shape[0]) > at:
            add_tiles(products, width, at, sums, numbers)


# each loop writes to one array, or reads few: else it is not worked on by vectors, since too many
# might overlap


@njit(**LEAN)
def _differ(own, mean, bound, out, cut_off):
    for x in range(out.size):
        away = own[x] - mean[x]
        out[x] = away
        cut_off[x] = min(max(away, -bound), bound)


@njit(**LEAN)
def _mirror_ends(room, width, reach):
    """Write what lies beyond the ends of a row that begins at ``reach``, reflected about them."""
    for k in range(1, reach + 1):
        room[reach - k] = room[reach + mirror(-k, width)]
        room[reach + width - 1 + k] = room[reach + mirror(width - 1 + k, width)]


@njit(**LEAN)
def _five(room, taps, out):
    middle, beside, beyond = taps[0], taps[1], taps[2]
    a, b, c, d, e = room, room[1:], room[2:], room[3:], room[4:]
    for x in range(out.size):
        out[x] = middle * c[x] + beside * (b[x] + d[x]) + beyond * (a[x] + e[x])


@njit(**LEAN)
def _box_five(room, out):
    a, b, c, d, e = room, room[1:], room[2:], room[3:], room[4:]
    for x in range(out.size):
        out[x] = (a[x] + b[x]) + (c[x] + d[x]) + e[x]


@njit(**LEAN)
def _three_fives(fives, out):
    share = np.float32(1 / (WIDE_BOX * WIDE_BOX))
    a, b, c = fives, fives[BOX:], fives[2 * BOX :]
    for x in range(out.size):
        out[x] = share * (a[x] + b[x] + c[x])


@njit(**LEAN)
def _around(y, height):
    """Return the lines of the rows around one, in their order."""
    return (
        mirror(y - 2, height) % LINES, mirror(y - 1, height) % LINES, y % LINES,
        mirror(y + 1, height) % LINES, mirror(y + 2, height) % LINES,
    )  # fmt: skip


@njit(**LEAN)
def _five_rows(ring, y, height, taps, out):
    middle, beside, beyond = taps[0], taps[1], taps[2]
    i, j, k, m, n = _around(y, height)
    a, b, c, d, e = ring[i], ring[j], ring[k], ring[m], ring[n]
    for x in range(out.size):
        out[x] = middle * c[x] + beside * (b[x] + d[x]) + beyond * (a[x] + e[x])


@njit(**LEAN)
def _box_five_rows(ring, y, height, out):
    share = np.float32(1 / (BOX * BOX))
    i, j, k, m, n = _around(y, height)
    a, b, c, d, e = ring[i], ring[j], ring[k], ring[m], ring[n]
    for x in range(out.size):
        out[x] = share * ((a[x] + b[x]) + (c[x] + d[x]) + e[x])


@njit(**LEAN)
def _add(row, total):
    for x in range(total.size):
        total[x] += row[x]


@njit(**LEAN)
def _exchange(entering, leaving, total):
    for x in range(total.size):
        total[x] += entering[x] - leaving[x]


@njit(**LEAN)
def _square(row, out):
    for x in range(out.size):
        out[x] = row[x] * row[x]


@njit(**LEAN)
def _subtract(row, other, out):
    scale, half = np.float32(1 / UNIT), np.float32(0.5)
    for x in range(out.size):
        out[x] = np.int16(np.floor(scale * (row[x] - other[x]) + half))


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
        Scratch, zero in its first ``reach`` and behind the row.
    """
    lines, width = ring.shape[0], out.size
    own = room[CHANGE_REACH : CHANGE_REACH + width]
    above, below = ring[max(y - 1, 0) % lines], ring[min(y + 1, height - 1) % lines]
    _join(above, ring[y % lines], below, own)
    if reach > 1:
        _join_more(ring[max(y - 2, 0) % lines], ring[min(y + 2, height - 1) % lines], own)
    beside = room[CHANGE_REACH - 1 :], room[CHANGE_REACH + 1 :]
    _join(beside[0], own, beside[1], out)
    if reach > 1:
        _join_more(room, room[2 * CHANGE_REACH :], out)


@njit(**LEAN)
def _join(first, second, third, out):
    for x in range(out.size):
        out[x] = first[x] | second[x] | third[x]


@njit(**LEAN)
def _join_more(first, second, out):
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
