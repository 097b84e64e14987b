"""The course of a descent: the same in one compiled call as sweep by sweep."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.grid import Grid, Sampling
from pipeline.reconstruction import descent
from pipeline.reconstruction.psf import GaussianPsf, psf_taps, sampling_taps
from pipeline.reconstruction.system import BAND_ROWS, NormalEquations

PSF = GaussianPsf(sigma=1.0, support=7)
GRID = Grid(magnification_x=2, magnification_y=2, sampling=Sampling.AREA)


@given(
    steps=st.integers(1, 12),
    hold=st.integers(1, 4),
    settled=st.sampled_from([0.0, 0.05, 0.3]),
    stretch=st.sampled_from([None, 1.0, 2.5]),
    seed=st.integers(0, 1000),
)
def test_compiled_rules_are_those_that_are_read(steps, hold, settled, stretch, seed):
    rules = descent.rules_of(steps, hold, settled, stretch)
    state, compiled = descent.begun(rules), descent.begun(rules)
    rng, energy = np.random.default_rng(seed), 1.0
    while state[descent.DONE] < steps:
        renewed = descent.renews(rules, state)
        assert descent._renews(rules, compiled) == renewed
        energy *= rng.uniform(0.1, 1.1)
        looked = energy, rng.normal()
        goes_on = descent.looked(rules, state, renewed, *looked)
        assert descent._looked(rules, compiled, renewed, *looked) == goes_on
        np.testing.assert_array_equal(compiled, state)
        if not goes_on:
            break
        curvature = rng.uniform(-0.05, 1)
        goes_on = descent.turned(rules, state, curvature)
        assert descent._turned(rules, compiled, curvature) == goes_on
        np.testing.assert_array_equal(compiled, state)
        if not goes_on:
            break
    assert state[descent.DONE] <= steps


@pytest.mark.parametrize("stretch", [None, 2.0])
@pytest.mark.parametrize("settled", [0.0, 0.1])
@pytest.mark.parametrize("strength", [0.0, 0.3])
def test_an_image_of_one_band_is_descended_as_one_of_several(stretch, settled, strength):
    rng = np.random.default_rng(5)
    shape = 2 * BAND_ROWS + 6, 45
    x, y = (rng.integers(0, size, (60, 40)).astype(np.float32) for size in shape[::-1])
    value = rng.uniform(0, 255, x.shape).astype(np.float32)
    start = rng.uniform(100, 150, shape).astype(np.float32)

    def descended(most_bands):
        system = NormalEquations(
            shape, sampling_taps(PSF, GRID), psf_taps(PSF, GRID), most_bands=most_bands
        )
        system.gather([(x, y, value, np.ones_like(x))])
        found = system.descend(start, 5.0, strength, 7, hold=2, settled=settled, stretch=stretch)
        return found, system.steps

    (one, steps), (several, steps_of_several) = descended(1), descended(4)
    assert steps == steps_of_several > 1
    assert np.abs(one - start).max() > 10
    np.testing.assert_array_equal(one, several)
