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
from pipeline.frames import GreyImage, Mask
from pipeline.grid import Grid
from pipeline.reconstruction.parts import Box, covering_boxes, on_hr_grid, widened, within
from pipeline.reconstruction.psf import Psf, psf_axes
from pipeline.reconstruction.restoration import Restoration
from pipeline.reconstruction.simd import LANES, PATCH, weigh_patch
from pipeline.reconstruction.system import HrImage
from pipeline.temporal.flow import Flow
from pipeline.threads import map_threads


@dataclass(frozen=True, kw_only=True)
class Trust:
    """How far another picture is trusted."""

    tolerated: float = 0.3
    """Prediction error that is tolerated beside one grey level, factor on the standard deviation of
    what is observed around a pixel: where there is much to see, much of it is aliased."""
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
        around = widened(wide, observed.shape, side)
        there = within(wide, around)
        error = observed[wide] - _observe(predicted[on_hr_grid(around, grid)], grid, psf)[there]
        inner = within(box, wide)
        trusted = _trusted(error, observed[wide], noise, trust.tolerated)[inner]
        correction = restoration.apply(error, grid)[on_hr_grid(inner, grid)]
        # contiguous, for one compilation
        _join(
            predicted, np.ascontiguousarray(correction), np.ascontiguousarray(trusted), wanted,
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
    for box in boxes:
        place = on_hr_grid(widened(box, wanted.shape, reach), grid)
        predicted[place] = shown[place]
    # writable, for one compilation
    other = np.require(other, requirements="W")

    def move(top: int) -> None:
        _move(
            other, flow, wanted, top, min(top + BAND, len(wanted)), grid.magnification_x,
            grid.magnification_y, np.float32(grid.offset_x), np.float32(grid.offset_y), _taps(),
            predicted,
        )  # fmt: skip

    map_threads(move, range(0, len(wanted), BAND))
    return predicted


def _trusted(
    error: GreyImage, observed: GreyImage, noise: float, tolerated: float
) -> npt.NDArray[np.float32]:
    """Return how far a prediction is to be trusted, 0..1, by its error around each pixel."""
    smooth = cv2.GaussianBlur(error, (_SIDE, _SIDE), LOW_PASS, borderType=cv2.BORDER_REFLECT)
    power = cv2.blur(smooth * smooth, (BOX, BOX), borderType=cv2.BORDER_REFLECT)
    side = (AROUND, AROUND)
    mean = cv2.blur(observed, side, borderType=cv2.BORDER_REFLECT)
    square = cv2.blur(observed * observed, side, borderType=cv2.BORDER_REFLECT)
    trusted = np.empty(error.shape, np.float32)
    share = np.float32(min(noise / QUIET, 1.0) ** 4)
    _weigh(power, mean, square, np.float32(noise * noise), np.float32(tolerated), share, trusted)
    return trusted


_SIDE = 7
_PASSED = 1.1 * float((cv2.getGaussianKernel(_SIDE, LOW_PASS) ** 2).sum() ** 2)
"""Power of noise that the low-pass leaves, and a tenth more."""


@njit(**LEAN)
def _weigh(power, mean, square, noise, tolerated, share, trusted):
    """Write (t² / (t² + c (e² − σ² g)))², t² a share of what is tolerated."""
    passed = np.float32(_PASSED)
    zero, constant = np.float32(0.0), np.float32(TOLERATED**2)
    factor, severity = tolerated * tolerated, np.float32(SEVERITY)
    for row in range(power.shape[0]):
        for column in range(power.shape[1]):
            seen = square[row, column] - mean[row, column] * mean[row, column] - noise
            bound = share * (constant + factor * max(seen, zero))
            excess = max(power[row, column] - passed * noise, zero)
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


def _observe(estimate: HrImage, grid: Grid, psf: Psf) -> npt.NDArray[np.float32]:
    """Return what the LR pixels of a part would observe of an estimate."""
    (along_x, first_x), (along_y, first_y) = _observing(grid, psf)
    seen = cv2.sepFilter2D(estimate, cv2.CV_32F, along_x, along_y, borderType=cv2.BORDER_REFLECT)
    return seen[first_y :: grid.magnification_y, first_x :: grid.magnification_x]


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
    height, width = other.shape
    rows, columns = wanted.shape
    pixels = other.reshape(-1)
    phases, middle = np.float32(PHASES), PATCH // 2
    scale_x, scale_y = np.float32(across), np.float32(down)
    # half a pixel, so that what is rounded down is the nearest pixel, and half a phase
    half = np.float32(0.5 + 0.5 / PHASES)
    # flow along an HR row, at LR columns, with one beyond either end
    room = np.empty((columns + 2, 2), np.float32)
    for y in range(top * down, bottom * down):
        row = y // down
        first, last = columns, -1
        for column in range(columns):
            if wanted[row, column]:
                first, last = min(first, column), column
        if last < 0:
            continue
        place = (y - offset_y) / scale_y
        upper = np.int64(np.floor(place))
        part = np.float32(place - upper)
        above, below = flow[max(upper, 0)], flow[min(upper + 1, rows - 1)]
        first, last = max(first - 1, 0), min(last + 2, columns)
        for column in range(first, last):
            for axis in range(2):
                near = above[column, axis]
                room[column + 1, axis] = near + part * (below[column, axis] - near)
        for axis in range(2):
            room[first, axis], room[last + 1, axis] = room[first + 1, axis], room[last, axis]
        for fine in range(across):
            place = (fine - offset_x) / scale_x
            left = np.int64(np.floor(place))
            part = np.float32(place - left)
            for column in range(first, last):
                if not wanted[row, column]:
                    continue
                here, beyond = room[column + 1 + left], room[column + 2 + left]
                at_x = scale_x * (here[0] + part * (beyond[0] - here[0])) + half
                at_y = scale_y * (here[1] + part * (beyond[1] - here[1])) + half
                whole_x, whole_y = np.int64(np.floor(at_x)), np.int64(np.floor(at_y))
                phase_x = np.int64((at_x - whole_x) * phases)
                phase_y = np.int64((at_y - whole_y) * phases)
                x = column * across + fine
                first_x = min(max(x + whole_x - middle, 0), width - LANES)
                first_y = min(max(y + whole_y - middle, 0), height - PATCH)
                out[y, x] = weigh_patch(
                    pixels, first_y * width + first_x, width, taps, phase_x * LANES,
                    phase_y * LANES,
                )  # fmt: skip
