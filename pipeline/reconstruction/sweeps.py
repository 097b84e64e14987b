"""Compiled sweeps over bands of HR rows: the system's matrix, the preconditioner, the steps.

A sweep lets rows stream through blur, lattice, blur and prior while they are in the
processor's cache: each array is read or written once. Images that are *kept* from sweep to sweep
are float32, or uint16, the bits of float16, of which half as much crosses memory. A band computes
the rows that it needs of its neighbours anew, so that bands may run side by side; what it changes
it changes in place, and reads of its neighbours what was set aside before. What is summed is kept
row by row, so that no sum depends on the bands. What makes the rings for it, and what works in
them, are functions of their own.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from pipeline.compiled import LEAN, OPTIONS, PUT_IN_PLACE
from pipeline.reconstruction.half_pixels import (
    COEFFICIENTS,
    LEAD,
    NUM_LINES,
    NUM_STRIP_LINES,
    STRIP_LEAD,
    STRIP_PITCH,
    join_row,
    pitch_of,
    sample_row,
    start_of,
)
from pipeline.reconstruction.rows import (
    blur_room,
    blur_row,
    blur_two,
    copy_row,
    dot_row,
    lead_of,
    make_lines,
    make_room,
    mirror,
    sum_row,
    whole,
)
from pipeline.reconstruction.simd import (
    WIDE,
    bend_wide,
    move_one,
    move_wide,
    plus_one,
    plus_wide,
    pull_wide,
    round_row,
    share_row,
    squares_wide,
)

PAD = 2
"""Pixels before the first one of a row, and rows before the first row, of padded arrays."""

STRIP = 256
"""Columns for which the prior is weighed at once, about: the rows that are kept on the way then lie
in the first cache."""

BESIDE = 3
"""Columns on each side of a pixel that its weights of the prior are told by."""

TOP = 65000.0
"""Weight of the prior between two pixels that are alike, in units of which sixteen bits hold it."""

FLOOR = 0.005
"""Share of that weight which is left at the strongest edge: without it little would keep an image
together where nobody looks."""

BEHIND = 2 * WIDE
"""Numbers behind the last pixel of a row of local strengths: as many as loops by sixteens read."""

BENT_EVERY, BENT_FROM = 4, 64
"""Rows of which one tells what the prior makes of a direction's curvature, in images of so many or
more: how far a step goes need not be known better."""


WEIGHED = 32
"""Rows of the prior that are weighed together just before they are looked at: they and what they
are weighed by are still in the second cache then."""


@njit(**OPTIONS)
def turn_and_apply(
    sharpened, factor, direction, beyond, taps_x, taps_y, masses, units, rhs, prior, strength, lo,
    hi, writes, out, sums,
):  # fmt: skip
    """Write the next conjugate direction p, and Bᵀ M B p, into rows ``lo`` to ``hi``.

    Parameters
    ----------
    sharpened, direction : (KH, KW), kept
        p is ``sharpened`` + ``factor`` · ``direction``; a factor of zero does not read it.
    beyond : (of ``sharpened``, of ``direction``)
        Their rows before ``lo`` and from ``hi`` on, see ``system.rows_beyond``.
    taps_x, taps_y : float32
        Half taps of B.
    masses : (KH, 4, whole(KW)) uint8 or uint16
        Weight of what was observed at each place of the half-pixel lattice, zero behind the last
        pixel.
    units : (KH,) float32
        What a unit of them is worth in each row.
    rhs : (KH, KW) float32
        b, where Bᵀ (b − M B p) is wanted; else empty.
    prior : (4, KH + 1, pitch_of(KW)) uint16
        Weights of the prior, see :func:`look_and_sharpen`.
    strength : float
        λ, in units of the prior.
    writes : bool
        Whether p takes the place of ``direction``.
    out : (KH, KW), kept
        ``sharpened`` itself, or another one.
    sums : (2, KH) float64
        Of these rows, pᵀ Bᵀ M B p and λ pᵀ P p; the latter of one row of ``BENT_EVERY``, in the
        place of all.
    """
    width, lines = sharpened.shape[1], 2 * taps_y.size
    _turn_and_apply(
        sharpened, factor, direction, beyond, taps_x, taps_y, masses, units, rhs, prior, strength,
        lo, hi, writes, out, sums,
        make_lines(lines, whole(width)), make_lines(lines, whole(width)),
        make_lines(NUM_LINES, pitch_of(width)).reshape(-1),
        make_lines(NUM_STRIP_LINES, STRIP_PITCH).reshape(-1),
        # the last of these lines stays zero: what lies outside the image
        make_lines(3, pitch_of(width)),
        make_room(width, taps_x.size - 1), make_lines(2, whole(width)),
    )  # fmt: skip


@njit(**LEAN)
def _turn_and_apply(
    sharpened, factor, direction, beyond, taps_x, taps_y, masses, units, rhs, prior, strength, lo,
    hi, writes, out, sums, blurred, back, work, strip, around, room, two,
):  # fmt: skip
    height, width = sharpened.shape
    reach, lines = taps_y.size - 1, blurred.shape[0]
    length, plane, pitch = around.shape[1], prior.shape[1] * prior.shape[2], prior.shape[2]
    end_back = min(height, hi + reach)
    next_back = max(0, lo - reach)
    # of the lattice, each row of it adds to the rows beside it, too
    end_lattice, next_lattice = min(height, end_back + 1), max(0, next_back - 1)
    end_spline, next_spline = min(height, end_lattice + 1), max(0, next_lattice - 1)
    end_blurred, next_blurred = min(height, end_spline + reach), max(0, next_spline - reach)
    f, s = np.float32(factor), np.float32(strength)
    every = BENT_EVERY if height >= BENT_FROM else 1
    times = s * (height / ((height + every - 1) // every))
    own_room = room[lead_of(taps_x.size - 1) :]
    for y in range(lo, hi):
        if (y - lo) % 2 == 0:
            while next_back < min(end_back, y + reach + 2):
                v = next_back
                while next_lattice < min(end_lattice, v + 2):
                    while next_spline < min(end_spline, next_lattice + 2):
                        while next_blurred < min(end_blurred, next_spline + reach + 2):
                            _plus_row(
                                sharpened, f, direction, beyond, next_blurred, lo, hi, own_room
                            )
                            blur_room(room, width, taps_x, blurred[next_blurred % lines])
                            next_blurred += 1
                        blur_two(blurred, next_spline, taps_y, height, width, two)
                        for row in range(min(end_spline - next_spline, 2)):
                            place = start_of(COEFFICIENTS + (next_spline + row) % 4, width)
                            copy_row(two[row], work[place:])
                        next_spline += 2
                    sample_row(
                        work, strip, next_lattice, height, width, masses[next_lattice],
                        units[next_lattice],
                    )  # fmt: skip
                    next_lattice += 1
                join_row(work, v, height, width, own_room)
                if rhs.size > 0:
                    _subtract(rhs[v], own_room)
                blur_room(room, width, taps_x, back[v % lines])
                next_back += 1
            blur_two(back, y, taps_y, height, width, two)
        if y == lo:
            _combine(sharpened[y], f, direction[y], around[y % 2, LEAD:])
        below = (y + 1) % 2
        if y + 1 < height:
            _plus_row(sharpened, f, direction, beyond, y + 1, lo, hi, around[below, LEAD:])
        else:
            below = 2
        own, found = around[y % 2, LEAD : LEAD + width], two[(y - lo) % 2, :width]
        if writes:
            _keep_row(own, direction[y])
        sums[0, y], sums[1, y] = dot_row(own, found), 0.0
        _keep_row(found, out[y])
        if y % every > 0:
            continue
        first = (y + 1) * pitch + LEAD
        own_at, below_at = y % 2 * length + LEAD, below * length + LEAD
        for x in range(0, width, WIDE):
            bend_wide(
                prior, first + x, plane, around, own_at + x, below_at + x, own_room, x
            )  # fmt: skip
        sums[1, y] = times * sum_row(own_room[:width])


@njit(**LEAN)
def _plus_row(first, factor, second, beyond, row, lo, hi, out):
    """Write a row of one image + ``factor`` · that of another, before bands were worked on."""
    if row < lo:
        before, beside = beyond[0][0], beyond[1][0]
        _combine(
            before[row - lo + before.shape[0]], factor, beside[row - lo + beside.shape[0]], out
        )
    elif row >= hi:
        _combine(beyond[0][1][row - hi], factor, beyond[1][1][row - hi], out)
    else:
        _combine(first[row], factor, second[row], out)


@njit(**LEAN)
def _row_plus(image, beyond, row, lo, hi, factor, second, out):
    """Write a row of an image as it was before bands were worked on, + ``factor`` · ``second``."""
    if row < lo:
        _combine(beyond[0][row - lo + beyond[0].shape[0]], factor, second, out)
    elif row >= hi:
        _combine(beyond[1][row - hi], factor, second, out)
    else:
        _combine(image[row], factor, second, out)


@njit(**PUT_IN_PLACE)
def _keep_row(row, out):
    """Copy a row; see ``simd.plus_wide`` for how either may be kept."""
    size = row.size
    in_wholes = size - size % WIDE
    for x in range(0, in_wholes, WIDE):
        move_wide(row, out, x)
    for x in range(in_wholes, size):
        move_one(row, out, x)


@njit(**PUT_IN_PLACE)
def _combine(first, factor, second, out):
    if factor == 0:  # the other may hold anything
        _keep_row(first, out)
        return
    size = first.size
    in_wholes = size - size % WIDE
    for x in range(0, in_wholes, WIDE):
        plus_wide(first, x, factor, second, x, out, x)
    for x in range(in_wholes, size):
        plus_one(first, x, factor, second, x, out, x)


@njit(**LEAN)
def _subtract(row, line):
    """Write row − line into the line."""
    for x in range(row.size):
        line[x] = row[x] - line[x]


@njit(**OPTIONS)
def look_and_sharpen(
    step, estimate, direction, residual, applied, beyond, prior, strength, share, least, balance,
    rows_a_line, taps_x, taps_y, lo, hi, sharpened, scale, local, weighs, sums,
):  # fmt: skip
    """Take a step along the direction, look where it leads, and sharpen what is left to do.

    Changes rows ``lo`` to ``hi`` of the estimate x and of its residual Bᵀ (b − M B x), and writes
    those of the preconditioned gradient a (I + (I − G) e (I − G)) a r,
    r = Bᵀ (b − M B x) − λ P(x) x.

    Parameters
    ----------
    step : float
        Zero: x is as it was, nothing is read of p, and its product is zero.
    estimate : (KH, KW) float32
    direction, residual, applied : (KH, KW), kept
        x, the direction p, the residual, and Bᵀ M B p.
    beyond : (of the estimate, of the residual, of ``applied``)
        Their rows before ``lo`` and from ``hi`` on, see ``system.rows_beyond``.
    prior : (4, KH + 1, pitch_of(KW)) uint16
        Weights of the prior, see :func:`weigh_prior`. Row y in row y + 1, padded by ``LEAD`` in
        front; planes: right, below-left, below, below-right; zero where a neighbour is outside.
    strength : float
        λ, in units of the prior; its diagonals count half.
    share, least : float
        e is 1 / (share · a² · λ · Σ weights + least).
    balance : (⌈KH / rows_a_line⌉, whole(KW)) float32
        a, a line of it for so many rows.
    rows_a_line : int
    taps_x, taps_y : float32
        Half taps of G.
    sharpened : (KH, KW), kept
        ``applied`` itself, or another one.
    scale, local
        Of :func:`weigh_prior`.
    weighs : bool
        Whether that is done on the way, of a band that is all of the image; else what is read of
        the prior has been weighed.
    sums : (2, KH) float64
        Of these rows, the scalar products of r with its sharpened self and with p.
    """
    # rows are smoothed in pairs, and those of the two smoothings need not fall together
    width, lines = estimate.shape[1], 2 * taps_y.size + 1
    _look_and_sharpen(
        step, estimate, direction, residual, applied, beyond, prior, strength, share, least,
        balance, rows_a_line, taps_x, taps_y, lo, hi, sharpened, scale, local, weighs, sums,
        make_lines(lines, whole(width)), make_lines(lines, whole(width)),
        make_lines(lines, whole(width)), make_lines(lines, whole(width)),
        make_lines(lines, whole(width)),
        # the last line stays zero: what lies outside the image
        make_lines(4, pitch_of(width)),
        make_room(width, taps_x.size - 1), make_lines(2, whole(width)),
    )  # fmt: skip


@njit(**LEAN)
def _look_and_sharpen(
    step, estimate, direction, residual, applied, beyond, prior, strength, share, least, balance,
    rows_a_line, taps_x, taps_y, lo, hi, sharpened, scale, local, weighs, sums, gradient,
    softness, blurred, fine, smoothed, around, room, two,
):  # fmt: skip
    height, width = estimate.shape
    reach, lines = taps_y.size - 1, gradient.shape[0]
    length, size = around.shape[1], gradient.shape[1]
    plane, pitch = prior.shape[1] * prior.shape[2], prior.shape[2]
    s, lam = np.float32(step), np.float32(strength)
    share, least = np.float32(share), np.float32(least)
    end_fine = min(height, hi + reach)
    next_fine = max(0, lo - reach)
    end_row = min(height, end_fine + reach)
    next_row = max(0, next_fine - reach)
    for row in range(max(0, next_row - 1), next_row + 1):
        _row_plus(estimate, beyond[0], row, lo, hi, s, direction[row], around[row % 3, LEAD:])
    weighed = 0 if weighs else height
    own_room = room[lead_of(taps_x.size - 1) :]
    for y in range(lo, hi, 2):
        while next_fine < min(end_fine, y + reach + 2):
            v = next_fine
            while next_row < min(end_row, v + reach + 2):
                u = next_row
                if weighed < min(u + 4, height):
                    # two rows before them are read, and have to be as they were
                    more = min(weighed + WEIGHED, height)
                    weigh_prior(step, estimate, direction, scale, local, weighed, more, prior)
                    weighed = more
                above = (u - 1) % 3 if u > 0 else 3
                below = 3
                if u + 1 < height:
                    below = (u + 1) % 3
                    _row_plus(
                        estimate,
                        beyond[0],
                        u + 1,
                        lo,
                        hi,
                        s,
                        direction[u + 1],
                        around[below, LEAD:],
                    )
                row = gradient[u % lines]
                _plus_row(residual, -s, applied, beyond[1:], u, lo, hi, row)
                if lo <= u < hi:
                    copy_row(around[u % 3, LEAD : LEAD + width], estimate[u])
                    _keep_row(row[:width], residual[u])
                own = u // rows_a_line
                for x in range(0, width, WIDE):
                    at = LEAD + x
                    pull_wide(
                        prior, (u + 1) * pitch + at, plane, pitch, around,
                        above * length + at, u % 3 * length + at, below * length + at,
                        lam, share, least, balance, own * size + x,
                        gradient, softness, u % lines * size + x,
                    )  # fmt: skip
                if lo <= u < hi:
                    sums[1, u] = 0.0
                    if s != 0:
                        along = two[0, :width]
                        _keep_row(direction[u], along)
                        sums[1, u] = dot_row(row[:width], along)
                _times(row[:width], balance[own], own_room)
                blur_room(room, width, taps_x, blurred[u % lines])
                next_row += 1
            blur_two(blurred, v, taps_y, height, width, two)
            for row in range(min(end_fine - v, 2)):
                at = (v + row) % lines
                _soften(
                    gradient[at, :width], two[row], softness[at], fine[at], own_room
                )  # fmt: skip
                blur_room(room, width, taps_x, smoothed[at])
            next_fine += 2
        blur_two(smoothed, y, taps_y, height, width, two)
        for row in range(y, min(y + 2, hi)):
            sums[0, row] = _sharp(
                gradient[row % lines, :width], fine[row % lines], two[row - y],
                balance[row // rows_a_line],
            )  # fmt: skip
            _keep_row(two[row - y, :width], sharpened[row])


@njit(**LEAN)
def _soften(row, blurred, softness, out, also):
    for x in range(row.size):
        value = softness[x] * (row[x] - blurred[x])
        out[x] = value
        also[x] = value


@njit(**OPTIONS)
def total(sums):
    """Return the sum of numbers, from the first to the last: however many bands have made them."""
    found = 0.0
    for number in sums:
        found += number
    return found


@njit(**LEAN)
def _times(row, factors, also):
    """Multiply a row, in place, and write it elsewhere, too."""
    for x in range(row.size):
        value = row[x] * factors[x]
        row[x] = value
        also[x] = value


@njit(**LEAN)
def _sharp(row, fine, smoothed, balance):
    """Write what is sharpened in place of what is smoothed; return its product with the row."""
    total = np.float32(0.0)
    for x in range(row.size):
        value = row[x] + (fine[x] - smoothed[x])
        smoothed[x] = balance[x] * value
        total += row[x] * value
    return total


@njit(**OPTIONS)
def weigh_prior(step, estimate, direction, scale, local, lo, hi, prior):
    """Write the prior's weights a step from the estimate into its rows ``lo`` to ``hi``.

    With ⟨·⟩ the mean over the 3 × 3 pixels around, weighted 1 2 1 along both axes, a difference
    d between neighbours weighs ⟨m (f + (1 − f) scale² / (⟨d²⟩ + scale²))⟩ of :data:`TOP`, ⟨d²⟩
    over the differences in the same direction, those outside counting zero, f the :data:`FLOOR`,
    m the local strength. Flat parts are smoothed, edges and texture are kept, and no pixel alone
    passes for an edge because it is noisy.

    Parameters
    ----------
    step : float
    estimate : (KH, KW) float32
    direction : (KH, KW), kept
    scale : float
        Root mean square of the differences below which the prior is quadratic, grey levels.
    local : (KH, LEAD + KW + BEHIND) float32
        Local strength, 0..1, padded in front and behind.
    prior : (4, KH + 1, pitch_of(KW)) uint16
        See :func:`look_and_sharpen`.

    Notes
    -----
    The derivative, by d², of Σ m (f ⟨d²⟩ + (1 − f) scale² log(1 + ⟨d²⟩ / scale²)), which is
    concave in d²: a step down the quadratic of these weights is one down this sum.
    """
    width = estimate.shape[1]
    strips = max(1, (width + STRIP // 2) // STRIP)
    widest = min(width, width // strips + 2 * WIDE + BESIDE)
    length = STRIP_LEAD + whole(widest) + STRIP_LEAD
    rooms = (
        make_lines(2, length),
        make_lines(3 * 4, length).reshape(3, 4, length),
        make_lines(3 * 4, length).reshape(3, 4, length),
    )
    left = np.int64(0)  # typed: a literal has what it goes to compiled twice
    for strip in range(1, strips + 1):
        right = width if strip == strips else strip * width // strips // WIDE * WIDE
        _weigh_strip(step, estimate, direction, scale, local, lo, hi, left, right, prior, rooms)
        left = right


@njit(**LEAN)
def _weigh_strip(step, estimate, direction, scale, local, lo, hi, left, right, prior, rooms):
    around, squares, shares = rooms
    squares[:] = 0
    height, columns = estimate.shape
    # what is read, and where what is wanted begins in it
    a, b = max(0, left - WIDE), min(columns, right + BESIDE)
    width, start, count = b - a, left - a, (right - left + WIDE - 1) // WIDE
    length = around.shape[1]
    of_row = 4 * length
    pixels, all_squares, all_shares = around.reshape(-1), squares.reshape(-1), shares.reshape(-1)
    plane, pitch, weights = prior.shape[1] * prior.shape[2], prior.shape[2], prior.reshape(-1)
    s = np.float32(step)
    square, floor = np.float32((1 - FLOOR) * TOP * scale**2), np.float32(FLOOR * TOP / 16)
    least = np.float32(16.0 * scale**2)
    next_row = max(lo - 2, 0)
    next_share = lo - 1
    # of the first sixteen in a line, of which the last one lies beside what is wanted
    first = STRIP_LEAD + start - WIDE
    _combine(
        estimate[next_row, a:b], s, direction[next_row, a:b], around[next_row % 2, STRIP_LEAD:]
    )
    for y in range(lo, hi):
        while next_share < y + 2:
            while next_row < min(next_share + 2, height):
                below = min(next_row + 1, height - 1)
                if below > next_row:
                    _combine(
                        estimate[below, a:b], s, direction[below, a:b],
                        around[below % 2, STRIP_LEAD:],
                    )  # fmt: skip
                line = squares[next_row % 3]
                for x in range(STRIP_LEAD, STRIP_LEAD + width, WIDE):
                    squares_wide(
                        pixels, next_row % 2 * length + x, below % 2 * length + x, all_squares,
                        next_row % 3 * of_row + x, length,
                    )  # fmt: skip
                _nothing_beyond(line, left == 0, right == columns, below > next_row, width)
                next_row += 1
            if next_share + 1 >= height:
                squares[(next_share + 1) % 3] = 0
            share_row(
                all_squares, (next_share - 1) % 3 * of_row + first, next_share % 3 * of_row + first,
                (next_share + 1) % 3 * of_row + first, length, count + 2, square, least, floor,
                local[min(max(next_share, 0), height - 1)], LEAD + left - WIDE, all_shares,
                next_share % 3 * of_row + first, length,
            )  # fmt: skip
            next_share += 1
        for number in range(1 if y + 1 == height else 4):
            at = number * length + STRIP_LEAD + start
            round_row(
                all_shares, (y - 1) % 3 * of_row + at, y % 3 * of_row + at,
                (y + 1) % 3 * of_row + at, count, weights,
                number * plane + (y + 1) * pitch + LEAD + left,
            )  # fmt: skip
        if right == columns:
            prior[:, y + 1, LEAD + right :] = 0
            prior[0, y + 1, LEAD + right - 1] = 0
            prior[3, y + 1, LEAD + right - 1] = 0
        if left == 0:
            prior[:, y + 1, :LEAD] = 0
            prior[1, y + 1, LEAD] = 0


@njit(**LEAN)
def _nothing_beyond(squares, is_first, is_last, has_below, width):
    """Make zero what does not lie between two pixels of the image."""
    if not has_below:
        squares[1:] = 0
    if is_first:
        squares[1, STRIP_LEAD] = 0
    if is_last:
        squares[:, STRIP_LEAD + width :] = 0
        squares[0, STRIP_LEAD + width - 1] = 0
        squares[3, STRIP_LEAD + width - 1] = 0


@njit(**OPTIONS)
def advance(step, direction, more, towards, level, lo, hi, estimate, out):
    """Write rows of the estimate + step · direction + more · towards + level.

    Nothing is read of what is taken no times.
    """
    room = make_lines(2, whole(estimate.shape[1]))
    _advance(step, direction, more, towards, level, lo, hi, estimate, out, room)


@njit(**LEAN)
def _advance(step, direction, more, towards, level, lo, hi, estimate, out, room):
    s, t, base, width = np.float32(step), np.float32(more), np.float32(level), estimate.shape[1]
    along, beside = room[0, :width], room[1, :width]
    along[:], beside[:] = 0, 0
    for y in range(lo, hi):
        image, result = estimate[y], out[y]
        if s != 0:
            _keep_row(direction[y], along)
        if t != 0:
            _keep_row(towards[y], beside)
        for x in range(width):
            result[x] = image[x] + (s * along[x] + t * beside[x] + base)


@njit(**OPTIONS)
def blur_band(image, taps_x, taps_y, lo, hi, margin, out):
    """Write the blurred image into rows ``lo`` to ``hi`` of float32, with so many pixels around."""
    _blur_band(image, taps_x, taps_y, lo, hi, margin, out, _blur_rooms(image, taps_x, taps_y))


@njit(**OPTIONS)
def blur_kept(image, taps_x, taps_y, lo, hi, out):
    """Write the blurred image into rows ``lo`` to ``hi`` of one that is kept."""
    around = np.int64(0)  # typed: a literal has what it goes to compiled twice
    _blur_band(image, taps_x, taps_y, lo, hi, around, out, _blur_rooms(image, taps_x, taps_y))


@njit(**PUT_IN_PLACE)
def _blur_rooms(image, taps_x, taps_y):
    """Return a ring of rows that are blurred along x, room for one, and for two results."""
    width = image.shape[1]
    return (
        make_lines(2 * taps_y.size, whole(width)), make_room(width, taps_x.size - 1),
        make_lines(2, whole(width)),
    )  # fmt: skip


@njit(**PUT_IN_PLACE)
def _blur_band(image, taps_x, taps_y, lo, hi, margin, out, rooms):
    blurred, room, two = rooms
    height, width = image.shape
    reach, lines = taps_y.size - 1, blurred.shape[0]
    end_blurred, next_blurred = min(height, hi + reach), max(0, lo - reach)
    for y in range(lo, hi, 2):
        while next_blurred < min(end_blurred, y + reach + 2):
            blur_row(image[next_blurred], taps_x, room, blurred[next_blurred % lines])
            next_blurred += 1
        blur_two(blurred, y, taps_y, height, width, two)
        for row in range(y, min(y + 2, hi)):
            _keep_row(two[row - y, :width], out[row + margin, margin:])


@njit(**LEAN)
def reflect_margin(margin, image):
    """Write so many pixels around what lies inside, which is reflected about its edge."""
    height, width = image.shape[0] - 2 * margin, image.shape[1] - 2 * margin
    for y in range(margin, margin + height):
        own, row = image[y, margin : margin + width], image[y]
        for k in range(margin):
            row[k] = own[mirror(k - margin, width)]
            row[margin + width + k] = own[mirror(width + k, width)]
    for k in range(margin):
        copy_row(image[margin + mirror(k - margin, height)], image[k])
        copy_row(image[margin + mirror(height + k, height)], image[margin + height + k])
