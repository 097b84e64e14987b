"""The default solver: all trusted observations at once, weighted, with an edge-preserving prior.

A maximum-a-posteriori estimate. Not in the thesis, which visits LR pixels one after another
(Eq. 9, Eq. 10; see ``pocs``); the constraints and the PSF are the same. Two rounds:

1. the reference view alone is enlarged and sharpened by a linear filter (``restoration``), and
   corrected by learned ones (``learned``);
2. every other view's pixels are predicted from that result, and weighted by how well
   they agree with it around them, once a view that agrees badly has been aligned anew
   (``realign``); then all are fused.

So no view can do harm by having been misregistered. The prior smooths first differences, the less
so the larger those around them are, by re-weighting (a Cauchy prior); it and the weights follow the
noise.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage, Mask, Positions, RegisteredView, Rejection
from pipeline.grid import Grid
from pipeline.reconstruction import agreement, kernels
from pipeline.reconstruction.learned import REACH, LearnedFilters
from pipeline.reconstruction.parts import (
    Box,
    CutView,
    covering_boxes,
    on_hr_grid,
    widened,
    within,
)
from pipeline.reconstruction.psf import Psf, SeparableTaps, psf_taps, sampling_taps
from pipeline.reconstruction.realign import ROUNDS, realigned
from pipeline.reconstruction.restoration import Restoration, bicubic_filter, restoration_of
from pipeline.reconstruction.system import (
    DATA_SHARE,
    NUM_BANDS,
    HrImage,
    NormalEquations,
    sample,
    spline_coefficients,
)
from pipeline.reconstruction.tables import Table, table_of
from pipeline.threads import map_threads

IMPOSSIBLE = np.uint8(
    Rejection.NO_MOTION
    | Rejection.OUTSIDE
    | Rejection.OCCLUDED
    | Rejection.DEPTH
    | Rejection.RESIDUAL
)
"""Reasons that exclude a pixel here. The others (weight, edge) are suspicions: hard constraints
must do without such pixels (POCS), weighted ones are left to the agreement weights."""

LARGEST_ERROR = 50.0
"""Prediction errors are cut off here before they are averaged, grey levels."""

ROWS = 32
"""Statistics are taken of every n-th row of a view that has n times as many rows or more, n being
``SPARSEST`` at most."""

SPARSEST = 8

Pixel = TypeVar("Pixel", bound=np.generic)

SMALLEST_NOISE = 0.3
"""Noise below which nothing gets easier: the rounding of 8-bit input, grey levels."""

CORRECTED_FROM = 1.0
"""Noise from which landing points are corrected: with less of it, views differ by what no shift
explains, grey levels."""

WORTH = 0.2
"""Share of a correction up to which it is not worth its time."""

AROUND = 2.5
"""σ of the window over which detail is averaged, LR pixels."""

SMOOTHED = 0.9
"""Variance of what that is smoothed by where it is averaged on half as many rows and columns: means
of two by two pixels, and what lies between these when they are enlarged; LR pixels squared."""

SMALLEST_SIGMA = 0.5
"""σ_psf below which nothing changes, HR pixels."""


@dataclass(frozen=True, kw_only=True)
class FusedTuning:
    """The constants of the solver, measured on the sample and on real scenes."""

    prior_strength: float = 0.185
    """λ at noise 1 and σ_psf 1, where a picture is flat."""
    prior_noise_powers: tuple[float, float] = (1.92, 1.6)
    """λ grows with the noise to the first power below noise 1, to the second above …"""
    prior_psf_powers: tuple[float, float] = (-1.0, -1.5)
    """… and with σ_psf to the first power below σ_psf 1, to the second above: what a wide PSF has
    removed no prior should smooth again; a narrow one removes little."""
    prior_detail: tuple[float, float] = (0.25, 0.42)
    """With the geometric mean of 1 + d² around a pixel, d the differences of neighbours in grey
    levels, λ falls to this power, down to this share: where much is seen, much can be lost. Below
    noise 1 the power falls with its square: then a PSF that is not quite right costs most, and the
    less, the more the prior says."""
    edge_scale: tuple[float, float] = (4.0, 0.4)
    """Root mean square of the differences around a pixel below which the prior is quadratic:
    constant and factor on the noise, grey."""
    agreement: tuple[float, float] = (1.0, 2.0)
    """Prediction error that is tolerated: constant a, and factor b on the noise, grey."""
    severity: float = 3.0
    """Factor c on the excess of the low-passed error."""
    low_pass: float = 0.8
    """σ of the low-pass on the prediction error, LR pixels."""
    window: float = 1.0
    """σ of the window of 5 × 5 LR pixels over which its square is averaged, LR pixels."""
    expected: float = 1.5
    """What of that average is no excess, as a multiple of what noise alone makes in the mean."""
    doubt: tuple[float, float] = (0.08, 0.6)
    """Share of a view's mean excess that is added to that of each of its pixels, for each view
    beside the reference, and at most: a view that is often wrong is less to be believed where it
    seems right, and the more of them, the more often they are wrong together."""
    agreeing: tuple[float, float] = (0.75, 0.65)
    """Mean weight, without doubt, of what may have one, from which a view's landing points are left
    as they are, and down to which they are corrected in part; below, in full, …"""
    corrections: int = ROUNDS
    """… in so many steps."""
    alone: float = 0.9
    """Conjugate-gradient steps from the reference alone, before the others are weighed, at noise
    1; in inverse proportion to the noise, rounded down."""
    together: int = 28
    """Conjugate-gradient steps from all views, at most."""
    only: int = 18
    """The same where the reference is the only view."""
    hold: float = 2.2
    """Steps for which the prior is held quadratic at noise 1, at least one; in inverse proportion
    to the noise: the less there is, the less the prior says."""
    data_share: float = DATA_SHARE
    """What the preconditioner adds for the observations."""
    gain: float | None = 20.0
    """How many times as much of what the PSF has removed the preconditioner takes, more or less,
    going by how much is observed around each pixel, so that what few views see comes to rest as
    soon as what all see; None: by the PSF as it is, the same everywhere."""
    stretch: float | None = 2.3
    """How many times as far as the step before it the last one from all views goes; None: as far as
    its direction tells, which costs a multiplication by the matrix."""
    nearly: float = 1.8
    """That one is taken where so many times the share is left at which a descent has come far
    enough."""
    settled: float = 0.05
    """Share of its first gradient at which a descent has come far enough, at noise 1 and σ_psf
    1; …"""
    settled_psf_powers: tuple[float, float] = (2.0, -1.0)
    """… with σ_psf to the first power below σ_psf 1, to the second above: behind a narrow PSF there
    is aliasing to undo, behind a wide one little that is still seen; …"""
    settled_noise_powers: tuple[float, float] = (1.0, -2.3)
    """… and with the noise to the first power below noise 1, to the second above: the less there
    is, the longer it pays to go on; the more there is, the more of the first gradient is noise."""


@dataclass(frozen=True, kw_only=True, eq=False)
class FusedResult:
    """What the solver made, and of what."""

    estimate: HrImage
    """(K·H, K·W) float32, grey levels, not clipped."""
    weights: tuple[GreyImage, ...]
    """Per registered view, (H, W) float32 0..1."""
    flags: tuple[npt.NDArray[np.uint8], ...]
    """Per registered view: its flags, with the residual test added."""
    misfits: tuple[float, ...]
    """Per registered view: RMS of observed − simulated over trusted pixels, grey levels."""
    density: HrImage
    """(K·H, K·W): weight of the observations that land on each HR pixel or just behind it."""
    iterations: int
    residuals: tuple[float, ...]
    """RMS of the weighted residual after each round, grey levels."""
    stop_reason: str
    phases: tuple[float, float] | None = None
    """Share of HR pixels on which trusted pixels of the reference land, and of all views, 0..1,
    where that was told on the way, see ``coverage``."""


def initial_estimate(reference: GreyImage, grid: Grid) -> HrImage:
    """Return the reference view enlarged by bicubic interpolation at the grid's phase."""
    return filtered(reference, bicubic_filter(grid), grid)


def filtered(view: GreyImage, taps: Restoration, grid: Grid) -> HrImage:
    """Return a view filtered onto a grid; beyond its border lies what is there, repeated."""
    side = taps.reach
    wide = cv2.copyMakeBorder(view, side, side, side, side, cv2.BORDER_REPLICATE)
    height, width = view.shape
    inside = on_hr_grid((slice(side, side + height), slice(side, side + width)), grid)
    return np.ascontiguousarray(taps.apply(wide, grid)[inside])


def estimate_alone(
    reference: GreyImage,
    grid: Grid,
    psf: Psf,
    noise: float,
    learned: LearnedFilters | None,
    wanted: Mask | None = None,
) -> HrImage:
    """Return the reference view enlarged and sharpened, and corrected by learned filters.

    Parameters
    ----------
    wanted : (H, W) bool, optional
        LR pixels that are needed; what lies far from them is left zero.
    """
    height, width = reference.shape
    restoration = restoration_of(reference, grid, psf, max(noise, SMALLEST_NOISE))
    if wanted is None:
        everywhere = slice(0, height), slice(0, width)
        return next(parts_alone(reference, restoration, grid, learned, [everywhere]))
    out = np.zeros(grid.hr_shape((height, width)), np.float32)
    boxes = covering_boxes(wanted)
    for box, part in zip(
        boxes, parts_alone(reference, restoration, grid, learned, boxes), strict=True
    ):
        out[on_hr_grid(box, grid)] = part
    return out


def parts_alone(
    reference: GreyImage,
    restoration: Restoration,
    grid: Grid,
    learned: LearnedFilters | None,
    boxes: Sequence[Box],
) -> Iterator[HrImage]:
    """Yield boxes of LR pixels of what :func:`estimate_alone` returns, on the HR grid.

    Parameters
    ----------
    restoration : Restoration
        The filter for the reference.
    """
    reach = 0 if learned is None else -(-REACH // min(grid.magnification_x, grid.magnification_y))
    for box in boxes:
        near = widened(box, reference.shape, reach)
        estimate = restoration.apply(reference, grid, near)
        inner = on_hr_grid(within(box, near), grid)
        if learned is None:
            yield estimate[inner]
        else:
            yield learned.of_one.apply(estimate, inner=inner)


@dataclass(frozen=True, kw_only=True, eq=False)
class Begun:
    """What :func:`fuse` begins with, and needs no view for but the reference."""

    estimate: HrImage
    """(K·H, K·W), see :func:`estimate_alone`."""
    local: HrImage
    """(K·H, K·W), see :func:`local_strength`."""
    coefficients: HrImage | None = None
    """Of the estimate, see ``system.spline_coefficients``; None where steps from the reference
    alone come first."""


def begun_alone(
    reference: GreyImage,
    grid: Grid,
    psf: Psf,
    noise: float,
    learned: LearnedFilters,
    tuning: FusedTuning,
) -> Begun:
    """Return what a reconstruction begins with; parameters are those of :func:`fuse`."""
    noise = max(noise, SMALLEST_NOISE)
    begun = _begun(reference, grid, psf, noise, learned, tuning)
    if int(tuning.alone / noise) > 0:
        return begun
    return replace(
        begun, coefficients=spline_coefficients(begun.estimate, sampling_taps(psf, grid))
    )  # fmt: skip


def _begun(
    reference: GreyImage,
    grid: Grid,
    psf: Psf,
    noise: float,
    learned: LearnedFilters | None,
    tuning: FusedTuning,
    start: HrImage | None = None,
) -> Begun:
    """Return what a reconstruction begins with, from a start or from the reference alone."""
    if start is not None:
        return Begun(estimate=start, local=local_strength(start, grid, noise, tuning))
    estimate, left = estimate_alone(reference, grid, psf, noise, learned), 0.0
    if learned is None:
        left = noise**2 * restoration_of(reference, grid, psf, noise).roughness
    local = local_strength(estimate, grid, noise, tuning, left, is_halved=True)
    return Begun(estimate=estimate, local=local)


def prior_strength(noise: float, psf_sigma: float, tuning: FusedTuning) -> float:
    """Return λ for a noise (grey levels) and a PSF (HR pixels)."""
    noise = max(noise, SMALLEST_NOISE)
    of_psf = by_power(max(psf_sigma, SMALLEST_SIGMA), tuning.prior_psf_powers)
    return tuning.prior_strength * by_power(noise, tuning.prior_noise_powers) * of_psf


def local_strength(
    estimate: HrImage,
    grid: Grid,
    noise: float,
    tuning: FusedTuning,
    left: float = 0.0,
    *,
    is_halved: bool = False,
) -> npt.NDArray[np.float32]:
    """Return the share of λ that there is at each HR pixel, by the detail seen around it.

    Parameters
    ----------
    noise : float
        Of the observations, grey levels.
    left : float
        Mean square of the differences that noise makes in the estimate, grey levels squared.
    is_halved : bool
        Whether detail is averaged on half of the LR rows and columns, which tells nearly the same
        and takes half the time. Of boxes it is not: each would be halved from a border of its own.
    """
    height, width = estimate.shape
    squares = np.empty_like(estimate)
    kernels.square_steps(estimate, squares)
    lr_size = width // grid.magnification_x, height // grid.magnification_y
    cells = cv2.resize(squares, lr_size, interpolation=cv2.INTER_AREA)
    power, least = tuning.prior_detail
    power *= min(noise, 1.0) ** 2
    logarithms = np.log(np.maximum(cells / 2 - np.float32(left), 0) + 1)
    sigma = AROUND
    if is_halved:
        half = -(-lr_size[0] // 2), -(-lr_size[1] // 2)
        logarithms = cv2.resize(logarithms, half, interpolation=cv2.INTER_AREA)
        sigma = math.sqrt(AROUND**2 - SMOOTHED) / 2
    detail = cv2.GaussianBlur(logarithms, (0, 0), sigma)
    local = np.maximum(np.exp(-power * detail), np.float32(least))
    return np.asarray(cv2.resize(local, (width, height), interpolation=cv2.INTER_LINEAR))


def settled_share(noise: float, psf_sigma: float, tuning: FusedTuning) -> float:
    """Return the share of its first gradient at which a descent has come far enough."""
    of_psf = by_power(max(psf_sigma, SMALLEST_SIGMA), tuning.settled_psf_powers)
    return tuning.settled * by_power(noise, tuning.settled_noise_powers) * of_psf


def by_power(value: float, powers: tuple[float, float]) -> float:
    """Return a value to the first power where it is below one, to the second above."""
    below, above = powers
    return value ** (below if value < 1 else above)


def weigh_by_agreement(
    observations: Table, some: tuple[int, int], reference: int, noise: float, others: int,
    tuning: FusedTuning, threshold: float, agreeing: npt.NDArray[np.float64],
) -> None:  # fmt: skip
    """Write the weight of each LR pixel from the prediction error around it, 0..1.

    The error is low-passed first: what the reference view alone cannot predict, because it
    is aliased, is exactly what the other views bring, and lies near the LR Nyquist limit;
    a wrong position shows at lower frequencies too. With e² the local mean of the squared
    low-passed error and σ² g what noise alone makes of it, the excess is x = e² − n σ² g, or
    nothing, and the weight (t² / (t² + c (x + r x̄)))², t² = σ² + (bσ)² + a², x̄ the mean of the
    view's excesses, each cut off at t²; see :class:`FusedTuning`.

    Parameters
    ----------
    observations : Table
        See ``kernels.FLAGS``: changed in place.
    some : (int, int)
        Those that are looked at, half-open.
    reference : int
        The one whose weights are not written.
    noise : float
        Grey levels.
    others : int
        Views beside the reference.
    threshold : float
        T_R, grey levels: pixels predicted worse are flagged.
    agreeing : (N,) float64
        The mean that the weights would have without r; overwritten.
    """
    agreement.weigh_views(
        observations, *some, reference, *agreement_terms(noise, others, tuning, threshold), agreeing
    )  # fmt: skip


def agreement_terms(
    noise: float, others: int, tuning: FusedTuning, threshold: float
) -> tuple[float | np.uint8 | npt.NDArray[np.float32], ...]:
    """Return what :func:`agreement.weigh_views` takes between the reference and ``agreeing``."""
    constant, factor = tuning.agreement
    low_pass, window, passed = _smoothing(tuning.low_pass, tuning.window)
    each, most = tuning.doubt
    return (
        float(threshold), np.uint8(Rejection.RESIDUAL), IMPOSSIBLE, LARGEST_ERROR, low_pass, window,
        tuning.expected * passed * noise**2, noise**2 + (factor * noise) ** 2 + constant**2,
        tuning.severity, min(each * others, most),
    )  # fmt: skip


@functools.cache
def _smoothing(
    low_pass: float, window: float
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], float]:
    """Return the half taps of two Gaussians, and the power of noise that the first one leaves."""
    first, second = (
        cv2.getGaussianKernel(side, sigma)[:, 0] for side, sigma in ((7, low_pass), (5, window))
    )
    return (
        first[3:].astype(np.float32), second[2:].astype(np.float32), float((first**2).sum() ** 2)
    )  # fmt: skip


def equations_of(
    shape: tuple[int, int], grid: Grid, psf: Psf, level: float, local: HrImage,
    tuning: FusedTuning, most_bands: int,
) -> NormalEquations:  # fmt: skip
    """Return the system of an HR image, before anything is gathered.

    Parameters
    ----------
    shape : (int, int)
        HR pixels.
    level : float
        Grey level about which is worked.
    local : (KH, KW) float32
        See :func:`local_strength`.
    most_bands : int
        See :func:`fuse`.
    """
    return NormalEquations(
        shape, sampling_taps(psf, grid), psf_taps(psf, grid), level, local, most_bands,
        (grid.magnification_y, grid.magnification_x), tuning.gain, short=True,
    )  # fmt: skip


def descended(
    system: NormalEquations, estimate: HrImage, noise: float, psf: Psf, tuning: FusedTuning,
    steps: int, stretch: float | None, stop: Callable[[], bool] | None,
) -> HrImage:  # fmt: skip
    """Return an estimate after so many steps at most, as the tuning, noise and PSF ask for.

    Parameters
    ----------
    noise : float
        Grey levels, ``SMALLEST_NOISE`` or more.
    stretch : float, optional
        See ``NormalEquations.descend``.
    """
    settled = settled_share(noise, psf.sigma, tuning)
    return system.descend(
        estimate, tuning.edge_scale[0] + tuning.edge_scale[1] * noise,
        prior_strength(noise, psf.sigma, tuning), steps,
        hold=max(1, round(tuning.hold / noise)), data_share=tuning.data_share,
        settled=settled if stretch is None else tuning.nearly * settled,
        stretch=stretch, stop=stop,
    )  # fmt: skip


def fuse(
    registered: Sequence[RegisteredView | CutView],
    grid: Grid,
    lr_shape: tuple[int, int],
    psf: Psf,
    *,
    noise: float,
    residual_threshold: float,
    tuning: FusedTuning | None = None,
    start: HrImage | None = None,
    begun: Begun | None = None,
    learned: LearnedFilters | None = None,
    most_steps: int | None = None,
    judged: bool = True,
    most_bands: int = NUM_BANDS,
    stop: Callable[[], bool] | None = None,
) -> FusedResult:
    """Reconstruct a reference view from all registered views.

    Parameters
    ----------
    registered : sequence of RegisteredView or CutView
        The reference itself (``is_reference``) is among them.
    lr_shape : (int, int)
        Height and width of the reference view, LR pixels.
    noise : float
        Standard deviation, grey levels.
    residual_threshold : float
        T_R, grey levels: pixels of other views predicted worse are left out (thesis §3.2).
    start : (K·H, K·W) float32, optional
        Initial estimate; default: the reference, enlarged and sharpened.
    begun : Begun, optional
        What there is of that default already, by :func:`begun_alone`.
    learned : LearnedFilters, optional
        They correct the default initial estimate; the result is the caller's to finish.
    most_steps : int, optional
        Conjugate-gradient steps from all views, at most; default: as many as it takes.
    judged : bool
        Whether to measure what is left over; else ``misfits`` and ``residuals`` are empty.
    most_bands : int
        Bands of HR rows that are worked on side by side, at most.
    stop : callable, optional
        Polled between steps; true ends the work early.

    Returns
    -------
    FusedResult
    """
    tuning = tuning or FusedTuning()
    noise = max(noise, SMALLEST_NOISE)
    taps = sampling_taps(psf, grid)
    shape = grid.hr_shape(lr_shape)
    reference = next(index for index, view in enumerate(registered) if view.is_reference)
    own = registered[reference]
    ones = np.ones(lr_shape, np.float32)
    begun = begun or _begun(own.observed, grid, psf, noise, learned, tuning, start)
    estimate = begun.estimate
    system = equations_of(
        shape, grid, psf, float(own.observed.mean()), begun.local, tuning, most_bands
    )
    stop_reason = "iterations"

    def solve(estimate: HrImage, plan: int, most: int | None, stretch: float | None) -> HrImage:
        nonlocal stop_reason
        if stop is not None and stop():
            stop_reason = "stopped"
            return estimate
        if most is not None and most < plan:
            stop_reason = "steps"
        steps = plan if most is None else min(plan, most)
        return descended(system, estimate, noise, psf, tuning, steps, stretch, stop)

    is_alone = len(registered) == 1
    steps_alone = tuning.only if is_alone else int(tuning.alone / noise)
    # those of others are written where they are sampled
    points = [_room_for_points(view) for view in registered]
    if is_alone or steps_alone > 0:
        points[reference] = landing_points(own, grid)
    if steps_alone > 0:
        system.gather([(*points[reference], own.observed, ones)])
        estimate = solve(estimate, steps_alone, most_steps if is_alone else None, None)
    weights = [
        ones if index == reference else np.empty(view.observed.shape, np.float32)
        for index, view in enumerate(registered)
    ]
    flags = [view.flags.copy() for view in registered]
    phases = None
    if not is_alone:
        coefficients = begun.coefficients
        if coefficients is None:
            coefficients = spline_coefficients(estimate, taps)
        is_correctable = learned is not None and noise >= CORRECTED_FROM
        observed = [np.ascontiguousarray(view.observed) for view in registered]
        beyond = [np.empty_like(image) for image in observed]
        agreeing, is_corrected = np.ones(len(registered)), [False] * len(registered)

        def row(index: int) -> tuple[npt.NDArray, ...]:
            return *points[index], beyond[index], weights[index], observed[index], flags[index]

        table = table_of(row(index) for index in range(len(registered)))

        positions = [
            (np.ascontiguousarray(view.position),)
            for view in registered
            if not isinstance(view, CutView)
        ]
        of_positions, to_hr = table_of(positions), _to_hr(grid)
        # the reference's own pixels, as a rule
        is_regular = bool(positions) and kernels.lies_as_itself(positions[reference][0])
        regular = reference if is_regular else -1
        # what lands elsewhere in the end is not told here
        tells = judged and is_regular and len(positions) == len(registered)
        landed = np.zeros(coefficients.size if tells else 0, np.uint8)

        terms = agreement_terms(noise, len(registered) - 1, tuning, residual_threshold)

        def weigh(some: tuple[int, int], *, lands: bool) -> None:
            if lands:
                agreement.land_and_weigh(
                    coefficients, of_positions, to_hr, regular, landed, table, *some, reference,
                    *terms, agreeing,
                )  # fmt: skip
            else:
                kernels.sample_views(coefficients, table, *some)
                weigh_by_agreement(
                    table, some, reference, noise, len(registered) - 1, tuning, residual_threshold,
                    agreeing,
                )  # fmt: skip

        def weigh_and_correct(some: tuple[int, int]) -> None:
            weigh(some, lands=bool(positions))
            for index in range(*some) if is_correctable else ():
                view = registered[index]
                share = _share_corrected(agreeing[index], view, tuning)
                if share > 0:
                    points[index] = realigned(
                        coefficients, points[index], view.observed, noise, grid,
                        rounds=tuning.corrections, share=share,
                    )  # fmt: skip
                    np.copyto(flags[index], view.flags)
                    is_corrected[index] = True
                    table[index] = table_of([row(index)])
                    weigh((index, index + 1), lands=False)

        map_threads(weigh_and_correct, system.shares_of(len(registered)))
        if tells and not any(is_corrected):
            filled = np.count_nonzero(flags[reference] == 0), np.count_nonzero(landed[1:])
            phases = filled[0] / estimate.size, filled[1] / estimate.size
        system.gather_table(table, estimate, regular, to_hr)
        estimate = solve(estimate, tuning.together, most_steps, tuning.stretch)
    residuals: tuple[float, ...] = ()
    misfits: tuple[float, ...] = ()
    if judged:
        some = [(some_rows(x), some_rows(y)) for x, y in points]
        misfit, misfits = left_over(estimate, taps, some, registered, flags, weights)
        residuals = (misfit,)
    return FusedResult(
        estimate=estimate,
        weights=tuple(weights),
        flags=tuple(flags),
        misfits=misfits,
        density=system.density,
        iterations=system.steps,
        residuals=residuals,
        stop_reason=stop_reason,
        phases=phases,
    )


def _share_corrected(agreeing: float, view: RegisteredView | CutView, tuning: FusedTuning) -> float:
    """Return how much of a view's correction is made, 0..1, by the mean of its weights."""
    none, full = tuning.agreeing
    if agreeing >= none:
        return 0.0  # whatever is possible, which takes time to count
    possible = _possible(view)
    lacking, most = none * possible - agreeing, (none - full) * possible
    return min(lacking / most, 1.0) if lacking > WORTH * most else 0.0


def _possible(view: RegisteredView | CutView) -> float:
    """Return the share of a view's pixels that may have a weight."""
    return float(np.count_nonzero(view.flags & IMPOSSIBLE == 0)) / view.flags.size


def some_rows(image: npt.NDArray[Pixel]) -> npt.NDArray[Pixel]:
    """Return the rows of an image that statistics are content with, see ``ROWS``; contiguous."""
    return np.ascontiguousarray(image[:: max(1, min(image.shape[0] // ROWS, SPARSEST))])


def left_over(
    estimate: HrImage,
    taps: SeparableTaps,
    points: Sequence[tuple[HrImage, HrImage]],
    registered: Sequence[RegisteredView | CutView],
    flags: Sequence[npt.NDArray[np.uint8]],
    weights: Sequence[GreyImage],
) -> tuple[float, tuple[float, ...]]:
    """Return the RMS of observed − simulated, grey: weighted, and of each view's trusted pixels.

    Measured on :func:`some_rows`. A view of which none is trusted has NaN.

    Parameters
    ----------
    points : sequence of ((h, W), (h, W)) float32
        Where those rows of each view land, x and y, HR pixels.
    """
    coefficients = spline_coefficients(estimate, taps)

    def compare(index: int) -> tuple[float, float, float, float]:
        return agreement.left_over(
            sample(coefficients, *points[index]), some_rows(registered[index].observed),
            some_rows(flags[index]), some_rows(weights[index]),
        )  # fmt: skip

    found = map_threads(compare, range(len(registered)))
    square, total = (sum(parts[number] for parts in found) for number in (0, 1))
    return (
        float(np.sqrt(square / total)) if total > 0 else 0.0,
        tuple(
            float(np.sqrt(trusted / count)) if count > 0 else float("nan")
            for _, _, trusted, count in found
        ),
    )


def landing_points(view: RegisteredView | CutView, grid: Grid) -> tuple[HrImage, HrImage]:
    """Return x and y of a view's landing points, HR pixels."""
    return (view.x, view.y) if isinstance(view, CutView) else _on_hr_grid(view.position, grid)


def some_landing_points(view: RegisteredView, grid: Grid) -> tuple[HrImage, HrImage]:
    """Return those of :func:`some_rows`."""
    return _on_hr_grid(some_rows(view.position), grid)


def finished(
    result: FusedResult,
    learned: LearnedFilters | None,
    before: tuple[HrImage, Sequence[Box], Grid] | None = None,
) -> HrImage:
    """Return what is shown of a result, corrected where there are learned filters.

    Parameters
    ----------
    before : (shown, boxes, grid), optional
        Where only boxes of LR pixels have been made anew: what the others show.
    """
    if learned is None:
        return result.estimate
    if before is None:
        return learned.finished(result.estimate, result.density)
    shown, boxes, grid = before
    out = shown.copy()
    lr_shape = (shown.shape[0] // grid.magnification_y, shown.shape[1] // grid.magnification_x)
    for box in boxes:
        wide = widened(box, lr_shape)
        fine = on_hr_grid(wide, grid)
        out[on_hr_grid(box, grid)] = learned.finished(
            np.ascontiguousarray(result.estimate[fine]),
            np.ascontiguousarray(result.density[fine]),
            on_hr_grid(within(box, wide), grid),
        )
    return out


def _room_for_points(view: RegisteredView | CutView) -> tuple[HrImage, HrImage]:
    """Return x and y of landing points, where they are known, or arrays for them."""
    if isinstance(view, CutView):
        return view.x, view.y
    x, y = (np.empty(view.position.shape[:2], np.float32) for _ in range(2))
    return x, y


def _on_hr_grid(position: Positions, grid: Grid) -> tuple[HrImage, HrImage]:
    x, y = (np.empty(position.shape[:2], np.float32) for _ in range(2))
    kernels.split_points(np.ascontiguousarray(position), *_to_hr(grid), 0, len(x), x, y)
    return x, y


def _to_hr(grid: Grid) -> tuple[np.float32, ...]:
    """Return what LR coordinates are multiplied by on the HR grid and what is added, x and y."""
    return (
        np.float32(grid.magnification_x), np.float32(grid.offset_x),
        np.float32(grid.magnification_y), np.float32(grid.offset_y),
    )  # fmt: skip
