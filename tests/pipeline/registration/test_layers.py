"""Depth layers (Eq. 1): every pixel has exactly one, and cuts lie where the depth has a gap."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.registration.layers import layer_labels, layer_thresholds

NEARNESS = hnp.arrays(
    np.float32,
    hnp.array_shapes(min_dims=2, max_dims=2, min_side=1, max_side=24),
    elements=st.floats(0, 255, width=32),
)


def _two_surfaces(near_share: float) -> np.ndarray:
    """A far surface of 10 to 30 and a near one of 70 to 90, (40, 60)."""
    rng = np.random.default_rng(4)
    nearness = rng.uniform(10, 30, (40, 60))
    near = rng.random((40, 60)) < near_share
    nearness[near] = rng.uniform(70, 90, near.sum())
    return nearness.astype(np.float32)


@given(nearness=NEARNESS, num_layers=st.integers(1, 12), min_support=st.integers(1, 40))
def test_every_pixel_is_in_exactly_one_layer(nearness, num_layers, min_support):
    thresholds = layer_thresholds(nearness, num_layers, min_support=min_support)
    assert thresholds[0] == -np.inf
    assert thresholds[-1] == np.inf
    assert (np.diff(thresholds) > 0).all()
    assert 1 <= len(thresholds) - 1 <= num_layers
    inside = [(low <= nearness) & (nearness < high) for low, high in pairwise(thresholds)]
    np.testing.assert_array_equal(np.sum(inside, axis=0), 1)
    labels = layer_labels(nearness, thresholds)
    assert labels.dtype == np.int32
    np.testing.assert_array_equal(labels, np.argmax(inside, axis=0))


@given(nearness=NEARNESS, num_layers=st.integers(2, 12), min_support=st.integers(1, 40))
def test_no_layer_has_fewer_pixels_than_asked_for(nearness, num_layers, min_support):
    thresholds = layer_thresholds(nearness, num_layers, min_support=min_support)
    counts = np.bincount(layer_labels(nearness, thresholds).ravel(), minlength=len(thresholds) - 1)
    if len(thresholds) > 2:
        assert counts.min() >= min_support
    else:
        assert counts.tolist() == [nearness.size]


def test_a_pixel_on_a_threshold_belongs_to_the_nearer_layer_alone():
    """Eq. 1 as printed closes both ends: the pixel would be in two layers."""
    nearness = np.array([[1.0, 2.0, 3.0], [np.nextafter(np.float32(2), 0), 2.0, 9.0]], np.float32)
    labels = layer_labels(nearness, np.array([-np.inf, 2.0, 3.0, np.inf]))
    assert labels.tolist() == [[0, 1, 2], [0, 1, 2]]


@pytest.mark.parametrize("near_share", [0.15, 0.5, 0.8])
def test_the_cut_falls_into_the_gap_between_two_surfaces(near_share):
    nearness = _two_surfaces(near_share)
    _, threshold, _ = layer_thresholds(nearness, 2)
    assert nearness[nearness < 50].max() < threshold < nearness[nearness > 50].min()
    counts = np.bincount(layer_labels(nearness, layer_thresholds(nearness, 2)).ravel())
    assert counts[1] == (nearness > 50).sum()


def test_the_cut_keeps_away_from_the_rims_of_a_wide_gap():
    nearness = np.repeat(np.float32([10, 90]), 500).reshape(20, 50)
    _, threshold, _ = layer_thresholds(nearness, 2)
    assert 25 < threshold < 75


@pytest.mark.parametrize("num_layers", [3, 5, 11])
def test_the_gap_stays_a_cut_among_more_layers(num_layers):
    nearness = _two_surfaces(0.4)
    thresholds = layer_thresholds(nearness, num_layers, min_support=40)
    labels = layer_labels(nearness, thresholds)
    assert labels[nearness < 50].max() < labels[nearness > 50].min()
    assert 2 <= len(thresholds) - 1 <= num_layers


def test_layers_of_a_ramp_are_about_equally_large():
    nearness = np.tile(np.linspace(0, 100, 90, dtype=np.float32), (7, 1))
    counts = np.bincount(layer_labels(nearness, layer_thresholds(nearness, 6)).ravel())
    assert len(counts) == 6
    assert counts.min() >= 0.4 * nearness.size / 6
    assert counts.max() <= 1.6 * nearness.size / 6


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (3, 5)])
def test_a_flat_map_is_one_layer(shape):
    thresholds = layer_thresholds(np.full(shape, 7, np.float32), 11)
    assert thresholds.tolist() == [-np.inf, np.inf]
    assert not layer_labels(np.full(shape, 7, np.float32), thresholds).any()


def test_layers_are_numbered_from_far_to_near():
    nearness = _two_surfaces(0.5)
    labels = layer_labels(nearness, layer_thresholds(nearness, 4))
    order = np.argsort(nearness, axis=None)
    assert (np.diff(labels.ravel()[order]) >= 0).all()


def test_the_unit_of_nearness_does_not_matter():
    nearness = _two_surfaces(0.4)
    labels = layer_labels(nearness, layer_thresholds(nearness, 7))
    scaled = (nearness * np.float32(2**-8)).astype(np.float32)
    np.testing.assert_array_equal(layer_labels(scaled, layer_thresholds(scaled, 7)), labels)
