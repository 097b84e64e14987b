"""What of a target is reconstructed again in a chain, and how thoroughly.

The measurements that chose the constants: docs/experiments.md#warm-frames, and
docs/experiments.md#a-camera-that-moves for ``MOVED``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from pipeline.config import Solver
from pipeline.frames import GreyImage, Mask
from pipeline.reconstruction.again import Due
from pipeline.reconstruction.fused import FusedTuning, by_power
from pipeline.superresolve.memory import Solved
from pipeline.superresolve.registered import RegisteredFrame

WARM = FusedTuning(
    prior_strength=0.2, alone=0.0, together=4, hold=2.8, data_share=0.04, gain=None,
    stretch=None, nearly=1.5, settled_noise_powers=(1.0, -2.0),
)  # fmt: skip
"""Work from the previous frame's result; see :class:`FusedTuning` for that from a cold start."""

NEW = replace(WARM, together=14, settled=0.08)
"""The same where the previous frame does not show it."""

QUIET = 1.0
"""Noise below which that takes as many steps as a cold start, grey levels: there is more to find,
and what of the reference alone has not been found yet passes for disagreement of the others."""

MOVED = FusedTuning(
    together=5, prior_strength=0.125, prior_noise_powers=(1.75, 1.75),
    prior_psf_powers=(-1.0, -1.35), gain=7.0, nearly=1.0, stretch=4.5,
    agreeing=(0.65, 0.6), corrections=1,
)  # fmt: skip
"""Work from a cold start where the camera has moved, of two views and at σ_psf 1: few steps smooth
by themselves, and leave less to the prior. What is left to do after so few lies where the last one
goes, which is not asked how far. Landing points are corrected where views agree less than is enough
for a cold start to be worth it. More views need no more steps as it is."""

MOVED_FROM = 1.0
"""Noise from which so few steps are enough: with less of it there is more to find, grey levels."""

MOVED_PSF_POWERS = (-1.3, 1.0)
"""They grow with σ_psf to the first power below σ_psf 1, to the second above; …"""

MOVED_NOISE_POWERS = (-0.46, 0.3)
"""… and with the noise likewise, below and above noise 2."""

STILL = replace(WARM, together=2, prior_detail=(0.25, 0.5))
"""The same where nothing has changed but the mean of the observations. The prior says more in what
is rich in detail than elsewhere in a chain: where it says little, frames long ago are seen for
longer, and a picture jumps where segments meet."""

HELD = replace(STILL, prior_strength=0.1, stretch=1.5)
"""The same where a rate is held, and no segments meet: what is seen there is a mean of several
frames, and has less noise than the prior of one frame is for; the last step is not measured."""

SELDOM = 3
"""Turns of which one is enough, where a rate is held, for what was made of means of more than half
as many frames before."""

MOSTLY_CHANGED = 0.9
"""Share of the pixels, halos included, from which what has changed is not worth being cut out:
all is reconstructed again at once."""


def parts_due(frame: RegisteredFrame, target: str, previous: Solved) -> list[Due] | None:
    """Return what of a target is reconstructed again; None: all of it.

    That is what has changed, boxes with something in them that the previous frame does not show
    more thoroughly than others, and a part of what has not, another one in each frame; all of
    it where the pixels are for the most part means of twice as many frames as they were, more
    thoroughly where those were made of the target alone. Parts that cost more together, with
    their halos, than the whole frame does are one.
    """
    still = frame.still.get(target)
    if still is None or previous.frames is None or frame.settings.solver != Solver.FUSED:
        return None
    changed = still.touched
    near = frame.near if len(frame.near) < len(frame.registrations[target]) else None
    new = as_cold_where_quiet(NEW, frame.noise)
    due = [Due(wanted=changed, noise=frame.noise, tuning=WARM)]
    if due[0].share > MOSTLY_CHANGED:
        return None
    unseen = changed & ~frame.matches[target].matched_pixels(changed.shape)
    with_unseen = np.zeros_like(changed)
    for box in due[0].boxes:
        if unseen[box].any():
            with_unseen[box] = changed[box]
    due = [
        Due(wanted=part, noise=frame.noise, tuning=tuning, views=near)
        for part, tuning in ((changed & ~with_unseen, WARM), (with_unseen, new))
        if part.any()
    ]
    again = ~changed
    ripe = (still.count >= 2 * previous.frames)[again]
    # means of what a codec leaves get better however many frames they are of
    is_all_due = still.noise_stays and frame.effort.is_full
    if ripe.size and ripe.mean() <= 0.5 and not is_all_due:
        assert frame.effort.refresh_every is not None  # for eyes alone only
        again = in_turn(again, frame.effort.refresh_every, frame.frame.frame_index)
    alone = again & (previous.frames == 0)
    due += [
        Due(wanted=part, noise=frame.noise, tuning=tuning)
        for part, tuning in ((again & ~alone, STILL), (alone, WARM))
        if part.any()
    ]
    if sum(part.share * part.tuning.together for part in due) > new.together:
        return [Due(wanted=np.ones_like(changed), noise=frame.noise, tuning=new, views=near)]
    return due


def as_cold_where_quiet(tuning: FusedTuning, noise: float) -> FusedTuning:
    """Return the work on what the previous frame does not show, at a noise in grey levels."""
    return tuning if noise >= QUIET else FusedTuning()


def in_turn(wanted: Mask, every: int, frame_index: int) -> Mask:
    """Return the part of the pixels wanted whose turn it is: all of them in so many frames."""
    part, rows = np.zeros_like(wanted), _rows_in_turn(wanted, every, frame_index)
    part[rows] = wanted[rows]
    return part


def _rows_in_turn(wanted: Mask, every: int, frame_index: int) -> slice:
    """Return the rows whose turn it is."""
    edges = np.linspace(0, len(wanted), every + 1).astype(int)
    turn = frame_index % every
    return slice(edges[turn], edges[turn + 1])


def in_turn_or_seldom(
    wanted: Mask, is_ripe: Callable[[slice], Mask], every: int, frame_index: int
) -> Mask:
    """Return the part of the pixels wanted whose turn it is; a share of them if they are not ripe.

    Parameters
    ----------
    is_ripe : callable
        Tells of some rows which pixels are. The others have every ``SELDOM``-th turn, a share of
        the columns in each, so that no frame costs more than the others.
    """
    part, rows = np.zeros_like(wanted), _rows_in_turn(wanted, every, frame_index)
    edges = np.linspace(0, wanted.shape[1], SELDOM + 1).astype(int)
    turn = frame_index // every % SELDOM
    columns = slice(edges[turn], edges[turn + 1])
    part[rows] = wanted[rows] & is_ripe(rows)
    part[rows, columns] = wanted[rows, columns]
    return part


def frames_solved(
    frame: RegisteredFrame, target: str, previous: Solved | None, due: Sequence[Due] | None
) -> npt.NDArray[np.float32] | None:
    """Return of how many frames a target's pixels were the mean when they were solved."""
    still = frame.still.get(target)
    if still is None or previous is None or previous.frames is None or due is None:
        return None if still is None else still.count
    frames = previous.frames.copy()
    for part in due:
        np.copyto(frames, still.count, where=part.wanted)
    return frames


def tuning_of(frame: RegisteredFrame, num_views: int, start: GreyImage | None) -> FusedTuning:
    """Return how a whole target is solved."""
    if start is not None:
        return WARM
    is_known = num_views == 2 and frame.noise >= MOVED_FROM and frame.settings.grid.largest == 2
    if not (frame.has_moved and is_known):
        return FusedTuning()
    growth = by_power(frame.psf.sigma, MOVED_PSF_POWERS)
    growth *= by_power(frame.noise / 2, MOVED_NOISE_POWERS)
    return replace(MOVED, together=round(MOVED.together * growth))
