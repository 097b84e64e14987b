"""The course of a descent by conjugate gradients: when the prior is weighed anew, when it ends.

A state machine that knows nothing of images: it is told what was found, and says what comes next.
What is small is descended in one compiled call, :func:`descend`: between calls threads wait for the
interpreter's lock. Of what is large each sweep is one, by the same rules.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from pipeline.compiled import EXACT, OPTIONS
from pipeline.reconstruction.sweeps import look_and_sharpen, total, turn_and_apply

SHORT_HOLD = 2
"""Steps for which the prior is held, at most, where the end of a descent is not looked for only
when the prior has been weighed anew: after more of them the gradient may grow by that."""

STEPS, HOLD, SETTLED, STRETCH = range(4)
"""Of the rules: see :func:`rules_of`; no stretch is a negative one."""

DONE, HELD, STEP, STRETCHED, FACTOR, ENERGY, ALONG, FIRST = range(8)
"""Of the state: steps done, and since the prior was weighed; how far the last one goes along the
direction, and along the sharpened gradient beside; by how much the direction before counts in the
next one; the product of the gradient with its sharpened self, and with that direction; and the
former at first."""

Rules = npt.NDArray[np.float64]

State = npt.NDArray[np.float64]


def rules_of(steps: int, hold: int, settled: float, stretch: float | None) -> Rules:
    """Return the rules of a descent; parameters are those of ``NormalEquations.descend``."""
    return np.array([steps, hold, settled, -1.0 if stretch is None else stretch])


def begun(rules: Rules) -> State:
    """Return the state before the first step: the prior is due."""
    state = np.zeros(8)
    state[HELD] = rules[HOLD]
    return state


def renews(rules: Rules, state: State) -> bool:
    """Return whether the prior is weighed anew for the next step.

    What is due for a last step that is stretched, or just before, is weighed for the last but one.
    A descent that ends so does not weigh it for its second step either.

    >>> state = begun(rules_of(5, 2, 0.1, 2.0))
    >>> for state[DONE], state[HELD] in ((1, 2), (2, 2), (3, 3), (4, 1)):
    ...     print(bool(renews(rules_of(5, 2, 0.1, 2.0), state)))
    True
    False
    True
    False
    """
    held, hold, left = state[HELD], rules[HOLD], rules[STEPS] - state[DONE]
    if rules[STRETCH] >= 0 and state[DONE] == 1 and left > 2:
        return False
    if rules[STRETCH] < 0 or state[DONE] == 0 or left > 3:
        return held >= hold
    if left == 2:
        return held >= hold - 1
    return left == 3 and held >= hold == 1


def looked(rules: Rules, state: State, renewed: bool, energy: float, along: float) -> bool:
    """Take note of a look where the last step has led; return whether to turn from there.

    Parameters
    ----------
    renewed : bool
        Whether the prior was weighed anew for it.
    energy, along : float
        The gradient times its sharpened self, and times the direction.
    """
    before, taken, stretch = state[ENERGY], state[STEP], rules[STRETCH]
    state[STEP], state[ENERGY], state[ALONG] = 0.0, energy, along
    if state[DONE] == 0:
        state[FIRST] = energy
    if renewed:
        state[HELD] = 0
    has_settled = energy <= rules[SETTLED] ** 2 * state[FIRST] and (
        renewed or rules[HOLD] <= SHORT_HOLD
    )
    if stretch < 0 and renewed and has_settled:
        return False
    factor = state[FACTOR] = energy / before if state[DONE] > 0 else 0.0
    is_last = has_settled or state[DONE] == rules[STEPS] - 1
    # a gradient that has grown, the prior being weighed anew, tells no length
    if stretch >= 0 and 0 < factor < 1 and is_last:
        state[STRETCHED] = stretch * taken
        state[STEP] = state[STRETCHED] * factor
        state[DONE] += 1
        return False
    return True


def turned(rules: Rules, state: State, curvature: float) -> bool:
    """Take note of the curvature along the next direction; return whether to look from there."""
    slope = state[ENERGY] + state[FACTOR] * state[ALONG]
    if not (slope > 0 and curvature > 0):
        return False
    state[STEP] = slope / curvature
    state[HELD] += 1
    state[DONE] += 1
    if rules[STRETCH] >= 0 or state[HELD] < rules[HOLD] or rules[HOLD] > SHORT_HOLD:
        return True
    # what falls on as it fell will have settled, and need not be looked at
    left = state[FACTOR] * state[ENERGY]
    return not 0 < left <= rules[SETTLED] ** 2 * state[FIRST]


_renews, _looked, _turned = njit(**EXACT)(renews), njit(**EXACT)(looked), njit(**EXACT)(turned)


@njit(**OPTIONS)
def descend(
    rules, state, scale, strength, share, least, balance, rows_a_line, nothing, taps_x, taps_y,
    sharpening_x, sharpening_y, masses, units, local, estimate, direction, residual, swept,
    prior, sums,
):  # fmt: skip
    """Descend from where the state says, all rows of an image at once; all is changed in place.

    Parameters
    ----------
    rules, state
        See :func:`renews`, :func:`looked` and :func:`turned`.
    nothing : (0, 0) float32
        What there is to explain beside ``residual``.
    swept : (KH, KW), kept
        What the last sweep has written: the sharpened gradient, or the matrix times a direction.

    Others are those of :func:`sweeps.weigh_prior`, :func:`sweeps.look_and_sharpen` and
    :func:`sweeps.turn_and_apply`.
    """
    height, none, none_kept = estimate.shape[0], estimate[:0].copy(), swept[:0].copy()
    beyond, of_kept = (none, none), (none_kept, none_kept)
    # typed: a literal has what it goes to compiled twice
    first, writes = np.int64(0), rules.size > 0
    of_two, of_three = (of_kept, of_kept), (beyond, of_kept, of_kept)
    while state[DONE] < rules[STEPS]:
        renewed = _renews(rules, state)
        look_and_sharpen(
            state[STEP], estimate, direction, residual, swept, of_three, prior, strength, share,
            least, balance, rows_a_line, sharpening_x, sharpening_y, first, height, swept, scale,
            local, renewed, sums,
        )  # fmt: skip
        if not _looked(rules, state, renewed, total(sums[0]), total(sums[1])):
            return
        turn_and_apply(
            swept, state[FACTOR], direction, of_two, taps_x, taps_y, masses, units, nothing, prior,
            strength, first, height, writes, swept, sums,
        )  # fmt: skip
        if not _turned(rules, state, total(sums[0]) + total(sums[1])):
            return
