"""The median by counting is the median."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from pipeline.reconstruction.median import median_magnitude


@given(values=arrays(np.float32, st.integers(1, 60), elements=st.floats(width=32)))
def test_it_is_that_of_numpy(values):
    magnitudes = np.abs(values[np.isfinite(values)]).astype(np.float64)
    found = median_magnitude(values)
    if magnitudes.size == 0:
        assert math.isnan(found)
    else:
        assert found == np.median(magnitudes)


@pytest.mark.parametrize("count", [1001, 1000])
def test_many_values_many_of_them_equal(count):
    values = np.random.default_rng(0).normal(0, 3, (1, count)).astype(np.float32)
    values[:, ::3] = 1.25
    assert median_magnitude(values) == np.median(np.abs(values).astype(np.float64))


def test_of_nothing_there_is_none():
    assert math.isnan(median_magnitude(np.full((3, 5), np.nan, np.float32)))
