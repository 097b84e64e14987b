"""What moves, made better by a picture that shows it too: of the frame before, or of the other eye.

Not in the thesis, which starts from such a picture and forgets it. Where a view is made of itself
alone, a super-resolved picture of the same thing holds what this view cannot know, its aliased
detail, and has other noise. It is moved to where the thing is now (:mod:`pipeline.temporal.flow`),
and put right by what is observed: the linear restoration of what the observed pixels differ by from
those that it predicts, a part of it, is added, as a Kalman filter with a fixed gain does (Elad &
Feuer, Superresolution Restoration of an Image Sequence, IEEE Trans. Image Processing 8(3), 1999).
How far it is trusted each pixel says for itself, by how well it predicts what is observed around
it: what is new, uncovered, lit or found wrongly stays as the view alone has it.

The measurements that chose the constants: docs/experiments.md#what-moves-followed.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import LEAN, OPTIONS
from pipeline.frames import GreyImage, Mask, frozen
from pipeline.grid import Grid
from pipeline.reconstruction.parts import Box, covering_boxes, on_hr_grid, widened, within
from pipeline.reconstruction.psf import Psf, psf_axes
from pipeline.reconstruction.restoration import Restoration, weigh_row
from pipeline.reconstruction.rows import mirror
from pipeline.reconstruction.simd import LANES, PATCH, WIDE, weigh_eight
from pipeline.reconstruction.system import HrImage
from pipeline.temporal.flow import Flow
from pipeline.threads import map_threads


@dataclass(frozen=True, kw_only=True)
class Trust:
    """How far another picture is trusted."""

    tolerated: float = 0.3
    """Prediction error that is tolerated beside one grey level, factor on the standard deviation of
    what is observed around a pixel, along the axes that are enlarged: where there is much to see,
    much of it is aliased."""
    gain: float = 0.5
    """Share of what is observed and was not predicted that is added to it, once it is moved."""


LOW_PASS = 0.8
"""σ of the low-pass on the prediction error, LR pixels."""

BOX = 3
"""Side of the box over which its square is averaged, LR pixels."""

AROUND = 5
"""Side of the box whose pixels' standard deviation is looked at, LR pixels."""

TOLERATED = 1.0
"""Prediction error that is tolerated by itself, grey levels."""

QUIET = 2.0
"""Noise below which that falls with its square, grey levels: the better an eye is by itself, the
less it takes for another picture to be worse."""

ONE_PIXEL = 3.0
"""Factor on the power of noise that a single pixel's squared error has to exceed: it is no mean of
several."""

SEVERITY = 4.0
"""Factor on the excess of the squared error over what noise makes."""

BAND = 32
"""Rows that a thread moves at once, LR pixels."""

PHASES = 16
"""Places between two pixels at which a moved picture is sampled."""


def put_right(
    estimate: HrImage,
    shown: HrImage,
    other: HrImage,
    flow: Flow,
    observed: GreyImage,
    wanted: Mask,
    restoration: Restoration,
    grid: Grid,
    psf: Psf,
    noise: float,
    trust: Trust,
) -> None:
    """Make the pixels wanted of a view better by another picture, in place.

    Parameters
    ----------
    estimate, shown : (K·H, K·W) float32
        The view made of itself alone, grey levels; the same clipped to 0..255.
    other : (K·H, K·W) float32
        The other picture.
    flow : (H, W, 2) float32
        Where pixels of the view are in that.
    observed : (H, W) float32
        The view's pixels.
    wanted : (H, W) bool
    restoration : Restoration
        The linear filter for the view.
    noise : float
        Standard deviation of the observed pixels, grey levels.
    """
    reach = max(restoration.reach, AROUND)
    side = -(-psf.support // min(grid.magnification_x, grid.magnification_y))
    boxes = covering_boxes(wanted)
    predicted = _moved_here(shown, other, flow, wanted, grid, boxes, reach + side)

    def put(box: Box) -> None:
        wide = widened(box, observed.shape, reach)
        error = _unexplained(observed, predicted, wide, grid, psf)
        inner = within(box, wide)
        trusted = _trusted(error, observed[wide], noise, trust.tolerated, grid)[inner]
        correction = restoration.apply(error, grid, inner)
        # contiguous, for one compilation
        _join(
            predicted, correction, np.ascontiguousarray(trusted), wanted,
            np.float32(trust.gain), box[0].start, box[1].start, grid.magnification_x,
            grid.magnification_y, np.empty(correction.shape[1], np.float32), estimate, shown,
        )  # fmt: skip

    map_threads(put, boxes)


def _moved_here(
    shown: HrImage,
    other: HrImage,
    flow: Flow,
    wanted: Mask,
    grid: Grid,
    boxes: Sequence[Box],
    reach: int,
) -> HrImage:
    """Return a view whose pixels wanted are those of another picture, moved, (K·H, K·W) float32.

    Parameters
    ----------
    boxes : sequence of Box
        That hold those pixels.
    reach : int
        What lies farther from them is not written, LR pixels.
    """
    predicted = np.empty_like(shown)
    wide = [widened(box, wanted.shape, reach) for box in boxes]
    # writable, for one compilation
    other = np.require(other, requirements="W")

    def move(top: int) -> None:
        bottom = min(top + BAND, len(wanted))
        for rows, columns in wide:
            part = slice(max(rows.start, top), min(rows.stop, bottom))
            if part.start < part.stop:
                place = on_hr_grid((part, columns), grid)
                predicted[place] = shown[place]
        _move(
            other, flow, wanted, top, bottom, grid.magnification_x, grid.magnification_y,
            np.float32(grid.offset_x), np.float32(grid.offset_y), _taps(), predicted,
        )  # fmt: skip

    map_threads(move, range(0, len(wanted), BAND))
    return predicted


def _trusted(
    error: GreyImage, observed: GreyImage, noise: float, tolerated: float, grid: Grid
) -> npt.NDArray[np.float32]:
    """Return how far a prediction is to be trusted, 0..1, by its error at and around each pixel."""
    smooth = cv2.GaussianBlur(error, (_SIDE, _SIDE), LOW_PASS, borderType=cv2.BORDER_REFLECT)
    power = cv2.blur(smooth * smooth, (BOX, BOX), borderType=cv2.BORDER_REFLECT)
    # what varies along an axis that is not enlarged is no aliased detail
    along = (
        AROUND if grid.magnification_x > 1 else 1,
        AROUND if grid.magnification_y > 1 else 1,
    )  # fmt: skip
    side = (AROUND, AROUND)
    mean = cv2.blur(observed, along, borderType=cv2.BORDER_REFLECT)
    if along != side:
        mean = np.sqrt(cv2.blur(mean * mean, along[::-1], borderType=cv2.BORDER_REFLECT))
    square = cv2.blur(observed * observed, side, borderType=cv2.BORDER_REFLECT)
    trusted = np.empty(error.shape, np.float32)
    share = np.float32(min(noise / QUIET, 1.0) ** 4)
    _weigh(
        smooth, power, mean, square, np.float32(noise * noise), np.float32(tolerated), share,
        trusted,
    )  # fmt: skip
    return trusted


_SIDE = 7
_PASSED = 1.1 * float((cv2.getGaussianKernel(_SIDE, LOW_PASS) ** 2).sum() ** 2)
"""Power of noise that the low-pass leaves, and a tenth more."""


@njit(**LEAN)
def _weigh(smooth, power, mean, square, noise, tolerated, share, trusted):
    """Write (t² / (t² + c (e² − σ² g)))², t² a share of what is tolerated.

    e² is the mean around a pixel or its own, whichever says more: where an edge is put beside its
    place, few pixels tell. The latter is measured against ``ONE_PIXEL`` times the noise.
    """
    passed = np.float32(_PASSED)
    own_share = np.float32(ONE_PIXEL * _PASSED)
    zero, constant = np.float32(0.0), np.float32(TOLERATED**2)
    factor, severity = tolerated * tolerated, np.float32(SEVERITY)
    for row in range(power.shape[0]):
        for column in range(power.shape[1]):
            seen = square[row, column] - mean[row, column] * mean[row, column] - noise
            bound = share * (constant + factor * max(seen, zero))
            own = smooth[row, column] * smooth[row, column] - own_share * noise
            excess = max(max(power[row, column] - passed * noise, own), zero)
            of_all = bound / (bound + severity * excess)
            trusted[row, column] = of_all * of_all


@njit(**LEAN)
def _join(
    predicted, correction, trusted, wanted, gain, top, left, across, down, shares, estimate, shown
):  # fmt: skip
    """Add to a box of what was made what is predicted and put right, as far as it is trusted."""
    black, white, nothing = np.float32(0.0), np.float32(255.0), np.float32(0.0)
    first = left * across
    for row in range(trusted.shape[0]):
        for column in range(trusted.shape[1]):
            share = trusted[row, column] if wanted[top + row, left + column] else nothing
            for fine in range(column * across, (column + 1) * across):
                shares[fine] = share
        for fine in range(row * down, (row + 1) * down):
            y = top * down + fine
            moved, more = predicted[y, first:], correction[fine]
            own, seen = estimate[y, first:], shown[y, first:]
            # without a branch, eight at once
            for x in range(shares.size):
                better = moved[x] + gain * more[x]
                value = own[x] + shares[x] * (better - own[x])
                own[x] = value
                clipped = min(max(value, black), white)
                seen[x] = clipped if shares[x] > nothing else seen[x]


def _unexplained(
    observed: GreyImage, predicted: HrImage, box: Box, grid: Grid, psf: Psf
) -> npt.NDArray[np.float32]:
    """Return what LR pixels of a box differ by from what they would observe of a picture."""
    rows, columns = box
    error = np.empty((rows.stop - rows.start, columns.stop - columns.start), np.float32)
    (along_x, first_x), (along_y, first_y) = _observing(grid, psf)
    _subtract_observed(
        frozen(observed), predicted, along_x, along_y, first_x, first_y, grid.magnification_x,
        grid.magnification_y, rows.start, columns.start, error,
    )  # fmt: skip
    return error


@njit(**OPTIONS)
def _subtract_observed(
    observed, predicted, along_x, along_y, first_x, first_y, across, down, top, left, error
):  # fmt: skip
    """Write what LR pixels differ by from weighted sums of HR pixels, reflected about the edge.

    Parameters
    ----------
    observed, predicted : (H, W), (K·H, K·W) float32
    along_x, along_y : (odd,) float32
        Taps.
    first_x, first_y : int
        HR pixel amid those of the first LR pixel.
    across, down : int
        K along x and along y.
    top, left : int
        Of the first LR pixel that is written.
    error : (h, w) float32
        Overwritten.
    """
    # HR columns, those of every phase side by side, with room for sixteens
    width = error.shape[1] + along_x.size // across + 1
    steps = np.empty(along_x.size, np.int64)
    for k in range(steps.size):
        steps[k] = k % across * (width + WIDE) + k // across
    _subtract_rows(
        observed, predicted.reshape(-1), predicted.shape, along_x, along_y, first_x, first_y,
        across, down, top, left, np.empty(along_y.size, np.int64), steps,
        np.empty((error.shape[1] - 1) * across + along_x.size, np.float32),
        np.zeros((across, width + WIDE), np.float32),
        np.empty(error.shape[1] + WIDE, np.float32), error,
    )  # fmt: skip


@njit(**LEAN)
def _subtract_rows(
    observed, pixels, shape, along_x, along_y, first_x, first_y, across, down, top, left, places,
    steps, line, phases, seen, error,
):  # fmt: skip
    height, width = shape
    reach_y, columns = along_y.size // 2, error.shape[1]
    begin = left * across + first_x - along_x.size // 2
    first, last = max(begin, 0), min(begin + line.size, width)
    for row in range(error.shape[0]):
        for k in range(places.size):
            y = mirror((top + row) * down + first_y + k - reach_y, height)
            places[k] = y * width + first
        weigh_row(pixels, places, last - first, along_y, 0, line, first - begin)
        for x in range(first - begin):
            line[x] = line[mirror(begin + x, width) - begin]
        for x in range(last - begin, line.size):
            line[x] = line[mirror(begin + x, width) - begin]
        for phase in range(across):
            count = (line.size - phase + across - 1) // across
            _take_every(line[phase:], across, phases[phase, :count])
        size = columns + WIDE - 1
        weigh_row(phases.reshape(-1), steps, size - size % WIDE, along_x, 0, seen, 0)
        own, out = observed[top + row, left:], error[row]
        for x in range(columns):
            out[x] = own[x] - seen[x]


@njit(**LEAN)
def _take_every(row, step, out):
    """Write every so many of the elements of a row."""
    if step == 2:
        for x in range(out.size):
            out[x] = row[2 * x]
    else:
        for x in range(out.size):
            out[x] = row[x * step]


@functools.lru_cache(maxsize=8)
def _observing(grid: Grid, psf: Psf) -> list[tuple[npt.NDArray[np.float32], int]]:
    """Return, along x and along y, the taps of an observed pixel, and the HR pixel amid them."""
    return [
        (np.ones(1, np.float32), 0)
        if axis is None
        else (axis.taps_at(offset - centre).astype(np.float32), centre)
        for axis, offset in zip(psf_axes(psf, grid), (grid.offset_x, grid.offset_y), strict=True)
        for centre in [int(np.floor(offset + 0.5))]
    ]


@functools.cache
def _taps() -> npt.NDArray[np.float32]:
    """Return the taps of a Lanczos window, (PHASES · LANES,), from half a pixel back to half on."""
    half = PATCH / 2
    away = np.arange(PATCH) - PATCH // 2 - (np.arange(PHASES)[:, None] / PHASES - 0.5)
    along = np.sinc(away) * np.sinc(away / half) * (np.abs(away) < half)
    taps = np.zeros((PHASES, LANES), np.float32)
    taps[:, :PATCH] = along / along.sum(axis=1, keepdims=True)
    return taps.reshape(-1)


@njit(**OPTIONS)
def _move(other, flow, wanted, top, bottom, across, down, offset_x, offset_y, taps, out):
    """Write the HR pixels of the LR pixels wanted, of some rows, as another picture has them."""
    columns = wanted.shape[1]
    _move_rows(
        other, flow, wanted, top, bottom, across, down, offset_x, offset_y, taps, out,
        # with one LR column beyond either end, and room for eights
        np.empty((2, columns + 2), np.float32), np.empty((2, columns * across), np.float32),
        np.empty((3, columns * across + LANES), np.int32),
        np.empty(columns * across + LANES, np.float32),
    )  # fmt: skip


@njit(**LEAN)
def _move_rows(
    other, flow, wanted, top, bottom, across, down, offset_x, offset_y, taps, out, coarse, fine,
    places, line,
):  # fmt: skip
    pixels, columns = other.reshape(-1), wanted.shape[1]
    for row in range(top, bottom):
        own, end = wanted[row], 0
        while end < columns:
            start = end
            while start < columns and not own[start]:
                start += 1
            end = start
            while end < columns and own[end]:
                end += 1
            # a run of them at once
            size = (end - start) * across
            for y in range(row * down, (row + 1) * down if size > 0 else row * down):
                place = (y - offset_y) / np.float32(down)
                upper = np.int64(np.floor(place))
                _flow_between(
                    flow[max(upper, 0)], flow[min(upper + 1, wanted.shape[0] - 1)],
                    np.float32(place - upper), start, end, coarse,
                )  # fmt: skip
                for axis in range(2):
                    _spread_out(coarse[axis], end - start, across, offset_x, fine[axis, :size])
                _place(fine, size, start * across, y, across, down, other.shape, places)
                for x in range(0, size, LANES):
                    weigh_eight(pixels, other.shape[1], taps, places, x, line)
                target = out[y, start * across : end * across]
                for x in range(size):
                    target[x] = line[x]


@njit(**LEAN)
def _flow_between(above, below, part, start, end, out):
    """Write the flow between two rows, x and y apart, from one column before to one behind."""
    first, last = max(start - 1, 0), min(end + 1, above.shape[0])
    shift = 1 - start
    for column in range(first, last):
        for axis in range(2):
            near = above[column, axis]
            out[axis, column + shift] = near + part * (below[column, axis] - near)
    for axis in range(2):
        if start == 0:
            out[axis, 0] = out[axis, 1]
        if end == above.shape[0]:
            out[axis, end + shift] = out[axis, end + shift - 1]


@njit(**LEAN)
def _spread_out(coarse, columns, across, offset, out):
    """Write the flow at the HR pixels of LR columns, of that at these and one to either side."""
    for fine in range(across):
        place = (fine - offset) / np.float32(across)
        left = np.int64(np.floor(place))
        part = np.float32(place - left)
        here, beyond, target = coarse[1 + left :], coarse[2 + left :], out[fine:]
        for column in range(columns):
            target[column * across] = here[column] + part * (beyond[column] - here[column])


@njit(**LEAN)
def _place(flow, size, start, y, across, down, shape, places):
    """Write where pixels of a row are in another picture, and eight more; see ``weigh_eight``."""
    phases, middle = np.float32(PHASES), PATCH // 2
    scale_x, scale_y, zero = np.float32(across), np.float32(down), np.int32(0)
    most_x, most_y = np.int32(shape[1] - LANES), np.int32(shape[0] - PATCH)
    lanes, pitch = np.int32(LANES), np.int32(shape[1])
    left, upper = np.int32(start - middle), np.int32(y - middle)
    # half a pixel, so that what is rounded down is the nearest pixel, and half a phase
    half = np.float32(0.5 + 0.5 / PHASES)
    along_x, along_y = flow[0, :size], flow[1, :size]
    first, tap_x, tap_y = places[0], places[1], places[2]
    for x in range(along_x.size):
        at_x, at_y = scale_x * along_x[x] + half, scale_y * along_y[x] + half
        # of where it is not known any pixels will do
        at_x, at_y = at_x if at_x == at_x else half, at_y if at_y == at_y else half
        whole_x, whole_y = np.floor(at_x), np.floor(at_y)
        column = min(max(left + np.int32(x) + np.int32(whole_x), zero), most_x)
        line = min(max(upper + np.int32(whole_y), zero), most_y)
        first[x] = line * pitch + column
        tap_x[x] = np.int32((at_x - whole_x) * phases) * lanes
        tap_y[x] = np.int32((at_y - whole_y) * phases) * lanes
    for x in range(along_x.size, along_x.size + LANES):
        for plane in range(3):
            places[plane, x] = 0
