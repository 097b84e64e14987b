"""Each reason to reject a pixel (Eq. 4, occlusion, edges), provoked one at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.frames import Rejection
from pipeline.registration import kernels
from pipeline.registration.prepare import spline_coefficients
from pipeline.registration.verification import (
    EDGE_JUMP,
    EDGE_REACH,
    EDGE_STRICTNESS,
    count_rejections,
    jumps_of_motion,
    registration_weights,
    verify,
    within_reach,
)

HEIGHT, WIDTH = 16, 25
SHAPE = (HEIGHT, WIDTH)


def _identity(shape=SHAPE) -> np.ndarray:
    x, y = np.meshgrid(np.arange(shape[1]), np.arange(shape[0]))
    return np.stack([x, y], axis=-1).astype(np.float32)


def _flags(position=None, weights=None, nearness=None, known=None, **options) -> np.ndarray:
    """The flags of a view that agrees in everything, unless said otherwise."""
    shape = SHAPE if position is None else position.shape[:2]
    ones = np.ones(shape, np.float32)
    reference = options.pop("reference", 10 * ones)
    return verify(
        _identity(shape) if position is None else position,
        0 * ones if weights is None else weights.astype(np.float32),
        10 * ones if nearness is None else nearness.astype(np.float32),
        ones.astype(bool) if known is None else known,
        reference.astype(np.float32),
        options.pop("reference_known", np.ones(reference.shape, bool)),
        **{"weight_threshold": 6.0, "depth_threshold": 2.0, **options},
    )


def test_what_agrees_in_everything_is_trusted():
    assert not _flags().any()


def test_a_pixel_without_motion_says_so_and_nothing_else():
    position = _identity()
    position[5, 7] = np.nan
    position[9, 3, 1] = np.nan
    position[11, 20] = np.inf
    flags = _flags(position, weights=np.full(SHAPE, 100.0))
    for row, column in ((5, 7), (9, 3), (11, 20)):
        assert flags[row, column] & ~np.uint8(Rejection.EDGE) == Rejection.NO_MOTION
    assert (flags & Rejection.WEIGHT != 0).sum() == flags.size - 3
    assert (flags & Rejection.NO_MOTION != 0).sum() == 3


def test_outside_begins_half_a_pixel_beyond_the_outermost_pixels():
    shape = (4, 9)
    reference = np.full((6, 11), 10.0)
    for x, y, is_outside in (
        (-0.49, 2, False), (-0.51, 2, True), (10.49, 2, False), (10.51, 2, True),
        (3, -0.49, False), (3, -0.51, True), (3, 5.49, False), (3, 5.51, True), (1e9, 2, True),
    ):  # fmt: skip
        position = np.full((*shape, 2), (x, y), np.float32)
        flags = _flags(position, reference=reference) & Rejection.OUTSIDE
        assert (flags != 0).all() == (flags != 0).any() == is_outside, (x, y)


@pytest.mark.parametrize("sign", [1, -1])
def test_large_registration_weights_are_rejected_and_small_ones_are_not(sign):
    """Eq. 4 as printed zeroes the small ones; the sign does not matter."""
    weights = np.zeros(SHAPE)
    weights[:, :8] = sign * 5.9
    weights[:, 12:] = sign * 6.1
    flags = _flags(weights=weights)
    assert not flags[:, :10].any()
    assert (flags[:, 13:] == Rejection.WEIGHT).all()


def test_the_weight_of_a_pixel_is_the_rms_of_its_neighbourhood():
    weights = np.zeros(SHAPE)
    weights[8, 12] = 15.0  # 5 over nine pixels
    assert not _flags(weights=weights).any()
    weights[8, 12] = 18.9  # 6.3 over nine pixels
    found = np.argwhere(_flags(weights=weights) == Rejection.WEIGHT)
    np.testing.assert_array_equal([found.min(axis=0), found.max(axis=0)], [[7, 11], [9, 13]])
    assert len(found) == 9


def test_a_weight_that_is_not_a_number_is_the_worst_weight():
    weights = np.zeros(SHAPE)
    weights[3, 4] = np.nan
    flags = _flags(weights=weights)
    assert flags[3, 4] == Rejection.WEIGHT
    assert (flags != 0).sum() == 9


def test_an_infinite_weight_threshold_rejects_nothing():
    weights = np.random.default_rng(1).normal(0, 100, SHAPE)
    weights[4, 4] = np.nan
    assert not _flags(weights=weights, weight_threshold=np.inf).any()


@pytest.mark.parametrize("away", [2.5, -2.5])
def test_depth_that_differs_by_more_than_the_threshold_is_rejected(away):
    nearness = np.full(SHAPE, 10.0)
    nearness[4:13, 6:19] += away
    flags = _flags(nearness=nearness)
    differs = np.zeros(SHAPE, bool)
    differs[4:13, 6:19] = True
    np.testing.assert_array_equal(flags & Rejection.DEPTH != 0, differs)
    assert not _flags(nearness=nearness, depth_threshold=2.6).any()
    assert not _flags(nearness=nearness, depth_threshold=np.inf).any()


def test_beside_a_depth_edge_the_surface_next_door_counts_too():
    reference = np.full(SHAPE, 10.0)
    reference[:, 12:] = 30.0
    nearness = np.full(SHAPE, 10.0)
    nearness[:, 13:] = 30.0
    flags = _flags(nearness=nearness, reference=reference)
    assert not (flags & Rejection.DEPTH).any(), "one column of doubt is allowed"
    nearness[:, 12:15] = 10.0
    flags = _flags(nearness=nearness, reference=reference)
    columns = np.flatnonzero((flags & Rejection.DEPTH).any(axis=0))
    assert columns.tolist() == [13, 14]


@pytest.mark.parametrize("side", ["source", "reference"])
def test_unknown_depth_is_not_compared(side):
    unknown = np.ones(SHAPE, bool)
    unknown[:, 8:17] = False
    nearness = np.full(SHAPE, 10.0)
    nearness[:, 5:20] = 5.0
    key = "known" if side == "source" else "reference_known"
    flags = _flags(nearness=nearness, **{key: unknown}) & Rejection.DEPTH
    columns = np.flatnonzero(flags.any(axis=0))
    assert columns.tolist() == [5, 6, 7, 17, 18, 19]


def test_what_a_nearer_surface_of_the_same_view_covers_is_occluded():
    """Columns 0..4 are near and move ten to the right: onto the far columns 10..14."""
    position, nearness = _identity(), np.full(SHAPE, 10.0)
    nearness[:, :5] = 30.0
    position[:, :5, 0] += 10
    reference = np.full(SHAPE, 10.0)
    reference[:, 10:15] = 30.0
    flags = _flags(position, nearness=nearness, reference=reference)
    occluded = flags & Rejection.OCCLUDED != 0
    np.testing.assert_array_equal(np.flatnonzero(occluded.any(axis=0)), np.arange(10, 15))
    assert occluded[:, 10:15].all()
    assert not (flags[:, :3] & Rejection.OCCLUDED).any(), "the nearer surface itself is seen"
    assert not (_flags(position, nearness=nearness, reference=reference, depth_threshold=np.inf)
                & Rejection.OCCLUDED).any()  # fmt: skip


def test_beside_a_jump_of_the_motion_pixels_are_suspect():
    position = _identity()
    position[:, 12:, 1] += 1.4
    flags = _flags(position)[:-2]  # the last rows land outside
    assert np.flatnonzero((flags == Rejection.EDGE).all(axis=0)).tolist() == [11, 12]
    assert not np.delete(flags, [11, 12], axis=1).any()


def test_a_slanted_surface_has_no_jump():
    """A displacement that changes by 0.4 px from pixel to pixel is a slant, and no edge."""
    position = _identity()
    position *= np.float32(0.6)
    assert not (_flags(position) & Rejection.EDGE).any()


def test_a_little_farther_from_a_jump_a_stricter_weight_threshold_holds():
    position = _identity()
    position[:, 12:, 0] += 1.5
    for weight, columns in ((4.0, range(12 - EDGE_REACH, 12 + EDGE_REACH)), (1.0, (11, 12))):
        flags = _flags(position, weights=np.full(SHAPE, weight))
        assert (weight > EDGE_STRICTNESS * 6.0) == (len(columns) > 2)
        assert np.flatnonzero((flags & Rejection.EDGE).all(axis=0)).tolist() == list(columns)


def _beside_jump(position: np.ndarray, reach: int) -> np.ndarray:
    return within_reach(jumps_of_motion(position), reach) > 0


@pytest.mark.parametrize("axis", [0, 1])
def test_jumps_count_along_both_axes(axis):
    position = _identity()
    position[10:, :, axis] -= np.float32(2 * EDGE_JUMP)
    rows = np.flatnonzero(_beside_jump(position, 1).all(axis=1))
    assert rows.tolist() == [9, 10]
    assert _beside_jump(position, 1).sum() == 2 * WIDTH
    assert _beside_jump(position, 3).sum() == 6 * WIDTH
    sideways = np.ascontiguousarray(position.transpose(1, 0, 2)[..., ::-1])
    np.testing.assert_array_equal(_beside_jump(sideways, 3), _beside_jump(position, 3).T)
    position = _identity()
    position[10:, :, axis] -= np.float32(0.9 * EDGE_JUMP)
    assert not _beside_jump(position, 5).any()


def test_a_pixel_without_motion_is_a_jump():
    position = _identity()
    position[3, 4] = np.nan
    found = np.argwhere(_beside_jump(position, 1))
    assert sorted(map(tuple, found.tolist())) == [(2, 4), (3, 3), (3, 4), (3, 5), (4, 4)]


def test_flags_do_not_depend_on_images_being_square():
    """Rows and columns exchanged: so are the flags."""
    rng = np.random.default_rng(3)
    position = _identity() + rng.normal(0, 2, (*SHAPE, 2)).astype(np.float32)
    nearness, weights = rng.uniform(8, 13, SHAPE), rng.normal(0, 6, SHAPE)
    flags = _flags(position, weights, nearness)
    assert len(np.unique(flags)) > 6
    swapped = np.ascontiguousarray(position.transpose(1, 0, 2)[..., ::-1])
    turned = _flags(swapped, weights.T.copy(), nearness.T.copy())
    np.testing.assert_array_equal(turned.T, flags)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (6, 1)])
def test_tiny_images(shape):
    assert not _flags(_identity(shape)).any()
    assert (_flags(_identity(shape), weights=np.full(shape, 9.0)) == Rejection.WEIGHT).all()


@given(
    flags=hnp.arrays(
        np.uint8, st.sampled_from([(3, 5), (4, 8), (5, 9)]), elements=st.integers(0, 127)
    ),
)
def test_every_reason_is_counted_once_for_each_pixel_that_has_it(flags):
    counts = count_rejections(flags)
    assert list(counts) == [
        "no_motion", "outside", "weight", "depth", "residual", "edge", "occluded",
    ]  # fmt: skip
    for bit, count in enumerate(counts.values()):
        assert count == sum((int(value) >> bit) & 1 for value in flags.ravel())


# --- registration weights (Eq. 3) --------------------------------------------------------


def test_registration_weights_are_reference_minus_source_plus_offset():
    rng = np.random.default_rng(8)
    reference, source = rng.uniform(50, 200, (2, *SHAPE)).astype(np.float32)
    position = _identity()
    position[..., 0] += 3
    position[..., 1] -= 2
    offset = np.full(SHAPE, 4.5, np.float32)
    weights = registration_weights(spline_coefficients(reference), position, source, offset)
    inside = np.zeros(SHAPE, bool)
    inside[2:, :-3] = True
    np.testing.assert_array_equal(np.isfinite(weights), inside)
    expected = reference[:-2, 3:] - source[2:, :-3] + 4.5
    np.testing.assert_allclose(weights[2:, :-3], expected, atol=0.25)


def test_registration_weights_do_not_ask_how_pixels_land_beside_each_other():
    rng = np.random.default_rng(4)
    reference = spline_coefficients(rng.uniform(0, 255, (30, 40)).astype(np.float32))
    smooth = _identity() + np.float32([0.3, 0.4]) + 0.07 * _identity()[..., ::-1]
    scattered = rng.uniform(-3, 43, (*SHAPE, 2)).astype(np.float32)
    position = np.where(rng.random((*SHAPE, 1)) < 0.7, smooth, scattered)
    position[3, 4], position[7, :5], position[2, 9, 1] = np.nan, np.nan, np.inf
    renewed = rng.random(SHAPE) < 0.8
    renewed[5] = False
    kept = np.full(SHAPE, 7, np.float32)
    zeros = np.zeros(SHAPE, np.float32)
    found = registration_weights(reference, position, zeros, zeros, before=(kept, renewed))
    expected = [kernels.value_at(reference, *point) for point in position.reshape(-1, 2)]
    expected = np.where(renewed, np.array(expected).reshape(SHAPE), 7)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_a_view_onto_itself_has_no_registration_weights():
    image = np.random.default_rng(9).uniform(0, 255, SHAPE).astype(np.float32)
    weights = registration_weights(
        spline_coefficients(image), _identity(), image, np.zeros(SHAPE, np.float32)
    )
    np.testing.assert_allclose(weights, 0, atol=0.25)
