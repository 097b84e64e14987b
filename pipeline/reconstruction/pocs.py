"""The thesis' own solvers: projections onto convex sets, one LR pixel after another (Eq. 7-10).

Exact and sequential: the reference that the default solver is held against.
Every trusted LR pixel is a constraint on the HR estimate; a sweep visits all
of them in a fixed order and each visit sees what the visits before it left.
Nothing is gathered onto a grid or approximated. Knows nothing of motion,
depth or files.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import OPTIONS
from pipeline.frames import GreyImage, RegisteredView, Rejection, frozen
from pipeline.grid import Grid
from pipeline.reconstruction.psf import BicubicPsf, Psf

SETTLED = 1e-3
"""Relative change of the RMS residual between sweeps below which POCS stops."""

LANES = 8
"""HR columns handled together: the PSF's window is widened to a multiple by zero taps."""

NEGLIGIBLE = 6.0
"""σ beyond which a tap is below float32's last digit, and left out."""

NARROWEST = 0.1
"""Smallest σ that is sampled, HR pixels."""

_NO_MOTION = np.uint8(Rejection.NO_MOTION)
_OUTSIDE = np.uint8(Rejection.OUTSIDE)


class StopReason(StrEnum):
    """Why the sweeps ended."""

    SETTLED = "residual-settled"
    """The RMS residual changed by less than a thousandth between two sweeps."""

    SWEEPS = "sweeps-done"
    """As many sweeps were done as were asked for."""

    NO_CONSTRAINTS = "no-constraints"
    """No LR pixel is trusted, or all of them were beyond T_R."""

    STOPPED = "stopped"
    """The caller asked for it between two sweeps."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PocsResult:
    """What the sweeps made of the initial estimate, and an account of them."""

    estimate: GreyImage
    """(KH, KW) float32, grey levels; *not* clipped: it may leave 0..255 where edges overshoot."""

    sweeps_done: int
    """Whole sweeps over all constraints."""

    residuals: tuple[float, ...]
    """Per sweep: RMS of the residuals at the visits, before their step, grey levels.
    Visits beyond T_R do not count; NaN where none was left."""

    active: tuple[int, ...]
    """Per view: constraints within T_R in the last sweep."""

    dropped: tuple[int, ...]
    """Per view: constraints beyond T_R in the last sweep."""

    flags: tuple[npt.NDArray[np.uint8], ...]
    """Per view: (H, W) uint8, the view's own flags and what was found here: RESIDUAL for the
    pixels beyond T_R in the last sweep, NO_MOTION for those without a position, OUTSIDE
    for those beyond the HR image."""

    stop_reason: StopReason


def pocs(
    registered: Sequence[RegisteredView],
    grid: Grid,
    hr_shape: tuple[int, int],
    psf_x: Psf | None,
    psf_y: Psf | None,
    initial_estimate: GreyImage,
    *,
    sweeps: int,
    residual_bound: float,
    residual_threshold: float,
    simplified: bool,
    stop: Callable[[], bool] | None = None,
) -> PocsResult:
    """Return the initial estimate projected onto every trusted LR pixel's constraint set, in turn.

    Thesis §3.1.2 and §3.2, Eq. (7)-(10).

    Parameters
    ----------
    registered : sequence of RegisteredView
        N views of (H, W) LR pixels; their sizes may differ. An LR pixel whose flags
        are 0 is a constraint; ``confidence`` is not used, a set has no weight.
    grid : Grid
        From LR to HR coordinates of the reference view, decimation or area phase.
    hr_shape : (int, int)
        (KH, KW), HR pixels.
    psf_x, psf_y : GaussianPsf or None
        PSF along x and along y, h_psf(k, l) = h_x(k)·h_y(l), σ in HR pixels. None: no blur
        along that axis (its magnification is 1); the simulated pixel is then
        interpolated linearly between the two nearest HR pixels.
    initial_estimate : ndarray of shape (KH, KW), float32
        Grey levels, finite; not changed.
    sweeps : int
        Sweeps at most, ≥ 0.
    residual_bound : float
        δ₀ of Eq. (7), grey levels, ≥ 0; Eq. (10) has none.
    residual_threshold : float
        T_R, grey levels, > 0; ``inf`` trusts every residual.
    simplified : bool
        True: Eq. (10). False: Eq. (9).
    stop : callable, optional
        Asked before each sweep; true ends the work with what there is.

    Returns
    -------
    PocsResult
        New arrays, read-only.

    Raises
    ------
    ValueError
        If a shape does not fit, the initial estimate is not finite, or a number is
        out of range.

    Notes
    -----
    *Order.* Views as given, in each rows from top to bottom, in each row columns from
    left to right. The result depends on it, slightly.

    *PSF.* Sampled at the whole HR positions of a K_psf × K_psf window around the HR
    pixel nearest to the landing point, unit-sum at every fraction. At the border the
    taps outside are reflected about the edge of the outermost HR pixel, axis by axis:
    the sum stays one, and at whole positions it is the blur of the default solver,
    whose results are compared with these.

    *T_R.* Tested at every visit: a pixel beyond it is left out at this visit and tried
    again in the next sweep. A NaN among the observed grey levels is beyond it.

    *Eq. (10)* multiplies the residual by h instead of h / Σh²: for a unit-sum PSF that
    is Eq. (9) with δ₀ = 0, relaxed by the factor Σh² (0.08 for σ = 1). It is slower but does
    not amplify noise as much; Eq. (9) does unless δ₀ is about twice the noise.

    *Cost.* About 2·K_psf² multiply-adds a constraint and sweep, on top of 4·K_psf for the
    taps, which are computed anew at every visit from two numbers kept for each LR pixel.
    """
    _check(registered, hr_shape, initial_estimate, sweeps, residual_bound, residual_threshold)
    axis_x = _Axis.of(psf_x, grid.magnification_x, grid.offset_x, hr_shape[1])
    axis_y = _Axis.of(psf_y, grid.magnification_y, grid.offset_y, hr_shape[0])
    height, width = hr_shape
    # A margin of zeros: windows never leave the array, and no tap is left there.
    padded = np.zeros((height + 2 * axis_y.reach, width + 2 * axis_x.reach + LANES), np.float32)
    inside = padded[axis_y.reach : axis_y.reach + height, axis_x.reach : axis_x.reach + width]
    inside[:] = initial_estimate

    sets = [_ConstraintSets.of(view, axis_x, axis_y) for view in registered]
    residuals: list[float] = []
    reason = StopReason.SWEEPS
    while len(residuals) < sweeps:
        if stop is not None and stop():
            reason = StopReason.STOPPED
            break
        square_sum, num_active = 0.0, 0
        for item in sets:
            view_sum, item.active, item.dropped = sweep_view(
                padded,
                item.observed,
                item.position,
                item.tilt,
                item.beyond,
                axis_x,
                axis_y,
                float(residual_bound),
                float(residual_threshold),
                bool(simplified),
            )
            square_sum += view_sum
            num_active += item.active
        residuals.append(math.sqrt(square_sum / num_active) if num_active else math.nan)
        if num_active == 0:
            reason = StopReason.NO_CONSTRAINTS
            break
        if len(residuals) > 1 and abs(residuals[-2] - residuals[-1]) <= SETTLED * residuals[-2]:
            reason = StopReason.SETTLED
            break
    return PocsResult(
        estimate=frozen(np.ascontiguousarray(inside)),
        sweeps_done=len(residuals),
        residuals=tuple(residuals),
        active=tuple(item.active for item in sets),
        dropped=tuple(item.dropped for item in sets),
        flags=tuple(frozen(item.final_flags()) for item in sets),
        stop_reason=reason,
    )


class _Axis(NamedTuple):
    """One axis of grid and PSF, as the kernels take it."""

    magnification: int
    offset: float
    """Of the grid, HR pixels."""
    size: int
    """HR pixels."""
    falloff: float
    """1 / σ², HR pixels⁻²; 0: no blur, linear interpolation."""
    reach: int
    """HR pixels on each side of the nearest one."""

    @classmethod
    def of(cls, psf: Psf | None, magnification: int, offset: float, size: int) -> _Axis:
        if psf is None:
            falloff, reach = 0.0, 1
        elif isinstance(psf, BicubicPsf):
            raise ValueError("these projections see through a Gaussian; the fused solver need not")
        elif psf.sigma < NARROWEST:
            raise ValueError(f"a PSF of σ {psf.sigma} HR pixels falls between the pixels: use None")
        else:
            falloff = 1 / psf.sigma**2
            reach = min(psf.support // 2, 1 + math.ceil(NEGLIGIBLE * psf.sigma))
        return cls(
            magnification=magnification, offset=offset, size=size, falloff=falloff, reach=reach
        )


@dataclass(kw_only=True, eq=False)
class _ConstraintSets:
    """The constraints of one view, and what the last sweep found of them."""

    observed: npt.NDArray[np.float32]
    position: npt.NDArray[np.float32]
    flags: npt.NDArray[np.uint8]
    tilt: npt.NDArray[np.float32]
    beyond: npt.NDArray[np.bool_]
    active: int = 0
    dropped: int = 0

    @classmethod
    def of(cls, view: RegisteredView, axis_x: _Axis, axis_y: _Axis) -> _ConstraintSets:
        shape = view.observed.shape
        position = frozen(np.ascontiguousarray(view.position, np.float32))
        flags = np.array(view.flags, np.uint8, order="C")
        tilt = np.empty((*shape, 2), np.float32)
        tilt_of_view(position, flags, axis_x, axis_y, tilt)
        return cls(
            observed=frozen(np.ascontiguousarray(view.observed, np.float32)),
            position=position,
            flags=flags,
            tilt=frozen(tilt),
            beyond=np.zeros(shape, np.bool_),
        )

    def final_flags(self) -> npt.NDArray[np.uint8]:
        """Return the flags of the view, those found here added."""
        self.flags[self.beyond] |= np.uint8(Rejection.RESIDUAL)
        return self.flags


def _check(
    registered: Sequence[RegisteredView],
    hr_shape: tuple[int, int],
    initial_estimate: npt.NDArray,
    sweeps: int,
    residual_bound: float,
    residual_threshold: float,
) -> None:
    if initial_estimate.shape != tuple(hr_shape):
        raise ValueError(f"the initial estimate is {initial_estimate.shape}, not {hr_shape}")
    if not np.isfinite(initial_estimate).all():
        raise ValueError("the initial estimate is not finite everywhere")
    if sweeps < 0:
        raise ValueError(f"sweeps must be 0 or more, not {sweeps}")
    if not 0 <= residual_bound < math.inf:
        raise ValueError(f"residual_bound must be 0 or more and finite, not {residual_bound}")
    if not residual_threshold > 0:
        raise ValueError(f"residual_threshold must be above 0, not {residual_threshold}")
    for view in registered:
        shape = view.observed.shape
        if view.position.shape != (*shape, 2) or view.flags.shape != shape:
            raise ValueError(f"view {view.view_id!r}: position or flags do not fit {shape}")


@njit(**OPTIONS)
def tilt_of_view(
    position: npt.NDArray,
    flags: npt.NDArray,
    axis_x: _Axis,
    axis_y: _Axis,
    tilt: npt.NDArray,
) -> None:
    """Write how each constraint's sub-pixel fraction bends its taps, in place; NaN: none.

    The taps of a Gaussian at offsets o from its nearest pixel, whose centre is a fraction
    t off, are exp(−(o − t)² / 2σ²) = exp(−o² / 2σ²) · exp(t / σ²)^o · constant; the constant
    goes when the sum is made one. So a single number, exp(t / σ²), holds all of them exactly.

    Parameters
    ----------
    position : (H, W, 2) float32
        Landing points (x, y), LR pixels of the reference view.
    flags : (H, W) uint8
        Modified in place: NO_MOTION and OUTSIDE are added where the position says so.
    axis_x, axis_y : _Axis
        Grid and PSF along x and y.
    tilt : (H, W, 2) float32
        Overwritten: exp(t / σ²) along x and y, or t where there is no blur.
    """
    rows, columns = flags.shape
    half = 0.5
    for row in range(rows):
        for column in range(columns):
            x = position[row, column, 0] * axis_x.magnification + axis_x.offset
            y = position[row, column, 1] * axis_y.magnification + axis_y.offset
            if np.isnan(x) or np.isnan(y):
                flags[row, column] |= _NO_MOTION
            elif not (-half <= x < axis_x.size - half and -half <= y < axis_y.size - half):
                flags[row, column] |= _OUTSIDE
            if flags[row, column] != 0:
                tilt[row, column, 0] = np.nan
                tilt[row, column, 1] = np.nan
                continue
            tilt[row, column, 0] = _tilt(x - np.floor(x + half), axis_x.falloff)
            tilt[row, column, 1] = _tilt(y - np.floor(y + half), axis_y.falloff)


@njit(**OPTIONS)
def _nearest(landing: float, axis: _Axis) -> int:
    """Return the HR pixel nearest to a landing point."""
    return int(np.floor(landing * axis.magnification + axis.offset + 0.5))


@njit(**OPTIONS)
def _tilt(fraction: float, falloff: float) -> float:
    """Return what bends the taps, or the fraction itself where there is no blur."""
    return np.exp(fraction * falloff) if falloff > 0 else fraction


@njit(**OPTIONS)
def _gaussian(falloff: float, reach: int) -> npt.NDArray:
    """Return exp(−o² / 2σ²) at whole offsets −reach…reach, float64."""
    offsets = np.arange(-reach, reach + 1)
    return np.exp(-0.5 * falloff * offsets * offsets)


@njit(**OPTIONS)
def _write_taps(
    tilt: float,
    gaussian: npt.NDArray,
    axis: _Axis,
    centre: int,
    taps: npt.NDArray,
) -> float:
    """Write the taps of one constraint along one axis; return what makes their sum one."""
    reach, size = axis.reach, axis.size
    if axis.falloff > 0:
        total = gaussian[reach]
        taps[reach] = total
        inverse = 1.0 / tilt
        rising = 1.0
        falling = 1.0
        for offset in range(1, reach + 1):
            rising *= tilt
            falling *= inverse
            right = gaussian[reach + offset] * rising
            left = gaussian[reach - offset] * falling
            taps[reach + offset] = right
            taps[reach - offset] = left
            total += right + left
        scale = 1.0 / total
    else:
        taps[0] = max(-tilt, 0.0)
        taps[1] = 1.0 - abs(tilt)
        taps[2] = max(tilt, 0.0)
        scale = 1.0
    if centre < reach or centre + reach >= size:
        first = centre - reach
        for index in range(2 * reach + 1):
            at = first + index
            if at < 0 or at >= size:
                at %= 2 * size
                if at >= size:
                    at = 2 * size - 1 - at
                taps[at - first] += taps[index]
                taps[index] = 0.0
    return scale


@njit(**OPTIONS)
def sweep_view(
    estimate: npt.NDArray,
    observed: npt.NDArray,
    position: npt.NDArray,
    tilt: npt.NDArray,
    beyond: npt.NDArray,
    axis_x: _Axis,
    axis_y: _Axis,
    residual_bound: float,
    residual_threshold: float,
    simplified: bool,
) -> tuple[float, int, int]:
    """Project the estimate onto the constraint sets of one view, one after another, in place.

    Thesis §3.1.2, Eq. (8)-(10): rows from top to bottom, columns from left to right.

    Parameters
    ----------
    estimate : (KH + 2·reach along y, KW + 2·reach along x + LANES) float32
        Grey levels; modified in place. The margin is zero and stays so.
    observed : (H, W) float32
        Grey levels.
    position : (H, W, 2) float32
        Landing points (x, y), LR pixels of the reference view.
    tilt : (H, W, 2) float32
        From :func:`tilt_of_view`; NaN: no constraint.
    beyond : (H, W) bool
        Overwritten where there are constraints: True where |residual| > T_R.
    axis_x, axis_y : _Axis
        Grid and PSF along x and y.
    residual_bound, residual_threshold : float
        δ₀ and T_R, grey levels.
    simplified : bool
        Eq. (10) and not Eq. (9).

    Returns
    -------
    square_sum : float
        Sum of the squared residuals within T_R, before their steps.
    num_active, num_beyond : int
        Constraints within and beyond T_R.

    Notes
    -----
    Eight columns are written out by hand, so that they share one vector register.
    """
    zero = np.float32(0.0)
    strips = (2 * axis_x.reach + LANES) // LANES
    taps_x = np.zeros(strips * LANES, np.float32)
    taps_y = np.zeros(2 * axis_y.reach + 1, np.float32)
    gaussian_x = _gaussian(axis_x.falloff, axis_x.reach)
    gaussian_y = _gaussian(axis_y.falloff, axis_y.reach)
    square_sum = 0.0
    num_active = 0
    num_beyond = 0
    for row in range(observed.shape[0]):
        for column in range(observed.shape[1]):
            tilt_x = tilt[row, column, 0]
            if np.isnan(tilt_x):
                continue
            tilt_y = tilt[row, column, 1]
            # the window's first pixel is the centre less the reach, plus the margin
            left = _nearest(position[row, column, 0], axis_x)
            top = _nearest(position[row, column, 1], axis_y)
            scale_x = _write_taps(tilt_x, gaussian_x, axis_x, left, taps_x)
            scale_y = _write_taps(tilt_y, gaussian_y, axis_y, top, taps_y)
            scale = np.float32(scale_x * scale_y)

            simulated = zero
            for strip in range(strips):
                o = strip * LANES
                x = left + o
                s0, s1, s2, s3, s4, s5, s6, s7 = zero, zero, zero, zero, zero, zero, zero, zero
                for tap in range(taps_y.size):
                    w = taps_y[tap]
                    line = estimate[top + tap]
                    s0 += w * line[x]
                    s1 += w * line[x + 1]
                    s2 += w * line[x + 2]
                    s3 += w * line[x + 3]
                    s4 += w * line[x + 4]
                    s5 += w * line[x + 5]
                    s6 += w * line[x + 6]
                    s7 += w * line[x + 7]
                simulated += (
                    (s0 * taps_x[o] + s1 * taps_x[o + 1])
                    + (s2 * taps_x[o + 2] + s3 * taps_x[o + 3])
                    + (s4 * taps_x[o + 4] + s5 * taps_x[o + 5])
                    + (s6 * taps_x[o + 6] + s7 * taps_x[o + 7])
                )
            residual = observed[row, column] - scale * simulated  # Eq. (8)

            if not abs(residual) <= residual_threshold:  # T_R; so is NaN
                beyond[row, column] = True
                num_beyond += 1
                continue
            beyond[row, column] = False
            num_active += 1
            square_sum += residual * residual
            if simplified:
                step = np.float32(residual) * scale  # Eq. (10)
            elif abs(residual) <= residual_bound:
                continue  # Eq. (9), second case: within the set
            else:
                energy_x = zero
                energy_y = zero
                for index in range(taps_x.size):
                    energy_x += taps_x[index] * taps_x[index]
                for index in range(taps_y.size):
                    energy_y += taps_y[index] * taps_y[index]
                outside = residual - residual_bound if residual > 0 else residual + residual_bound
                # Eq. (9); scale·taps / (scale²·energies), one scale cancels
                step = np.float32(outside / (scale * energy_x * energy_y))
            for strip in range(strips):
                o = strip * LANES
                x = left + o
                for tap in range(taps_y.size):
                    w = step * taps_y[tap]
                    line = estimate[top + tap]
                    t0 = line[x] + w * taps_x[o]
                    t1 = line[x + 1] + w * taps_x[o + 1]
                    t2 = line[x + 2] + w * taps_x[o + 2]
                    t3 = line[x + 3] + w * taps_x[o + 3]
                    t4 = line[x + 4] + w * taps_x[o + 4]
                    t5 = line[x + 5] + w * taps_x[o + 5]
                    t6 = line[x + 6] + w * taps_x[o + 6]
                    t7 = line[x + 7] + w * taps_x[o + 7]
                    line[x] = t0
                    line[x + 1] = t1
                    line[x + 2] = t2
                    line[x + 3] = t3
                    line[x + 4] = t4
                    line[x + 5] = t5
                    line[x + 6] = t6
                    line[x + 7] = t7
    return square_sum, num_active, num_beyond
