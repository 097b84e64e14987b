"""A motion turned round: pixels go back to where those that land on them came from."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.frames import RegisteredView, Rejection
from pipeline.registration.inverse import inverted
from pipeline.registration.records import ViewRegistration

HEIGHT, WIDTH = 40, 60
Y, X = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
PLAIN = np.zeros((HEIGHT, WIDTH), np.float32)


def _landing(x, y, flags=None, labels=None):
    """Return a view whose pixels land at x and y, and differ by a term that grows to the right."""
    registered = RegisteredView(
        view_id="view", observed=PLAIN, position=np.stack([x, y], axis=-1).astype(np.float32),
        registration_weights=PLAIN, confidence=np.ones_like(PLAIN), is_reference=False,
        flags=np.zeros(PLAIN.shape, np.uint8) if flags is None else flags,
    )  # fmt: skip
    return ViewRegistration(
        registered=registered, motions=None, parallax=None, offset=(X / 10).astype(np.float32),
        patch_labels=np.zeros(PLAIN.shape, np.int32) if labels is None else labels,
    )  # fmt: skip


@pytest.mark.parametrize("stretch", [0.8, 1.0, 1.15])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (3.3, -1.7)])
def test_there_and_back_is_where_one_was(stretch, shift):
    lead = _landing(stretch * X + 0.05 * Y + shift[0], Y + 0.03 * X + shift[1])
    found = inverted(lead, PLAIN, PLAIN)
    matrix = np.array([[stretch, 0.05], [0.03, 1]])
    back = np.stack([X - shift[0], Y - shift[1]], axis=-1) @ np.linalg.inv(matrix).T
    lands = np.isfinite(found.position[..., 0])
    inside = (back > 1).all(axis=-1) & (back < [WIDTH - 2, HEIGHT - 2]).all(axis=-1)
    assert lands[inside].all(), "no holes, however it is stretched"
    away = np.linalg.norm(found.position - back, axis=-1)
    assert away[inside].max() < 0.2
    assert np.sqrt((away[inside] ** 2).mean()) < 0.06
    np.testing.assert_allclose(found.offset[inside], -back[..., 0][inside] / 10, atol=0.02)
    outside = (back < -1.5).any(axis=-1) | (back > [WIDTH + 0.5, HEIGHT + 0.5]).any(axis=-1)
    assert not lands[outside].any()
    assert (found.labels[outside] == -1).all()


def test_of_two_surfaces_that_land_on_a_pixel_the_one_of_its_depth_is_taken():
    """A near thing hides what is behind it; the depth of the pixels says which of them it is."""
    near = (X >= 20) & (X < 32)
    # what is near moves by 6, and lands upon what is behind
    lead = _landing(X + 6 * near, Y, labels=near.astype(np.int32))
    nearness = near.astype(np.float32)
    seen = ((X >= 26) & (X < 38)).astype(np.float32)
    found = inverted(lead, nearness, seen)
    moved = X - found.position[..., 0]
    np.testing.assert_allclose(moved[:, 28:36], 6, atol=1e-4)
    np.testing.assert_array_equal(found.labels[:, 28:36], 1)
    np.testing.assert_allclose(moved[:, :19], 0, atol=1e-4)
    np.testing.assert_allclose(moved[:, 39:], 0, atol=1e-4)
    # nobody has seen what lies where the near thing was
    assert np.isnan(moved[:, 21:25]).all()


@pytest.mark.parametrize("reason", ["NO_MOTION", "OUTSIDE", "OCCLUDED", "DEPTH"])
def test_what_is_not_seen_there_says_nothing(reason):
    flags = np.zeros(PLAIN.shape, np.uint8)
    flags[10:20, 10:20] = Rejection[reason]
    x = np.where(flags > 0, np.nan, X) if reason == "NO_MOTION" else X
    found = inverted(_landing(x, Y, flags), PLAIN, PLAIN)
    np.testing.assert_array_equal(np.isnan(found.position[..., 0]), flags > 0)


def test_a_suspicion_is_no_reason():
    flags = np.full(PLAIN.shape, Rejection.WEIGHT | Rejection.EDGE, np.uint8)
    found = inverted(_landing(X, Y, flags), PLAIN, PLAIN)
    np.testing.assert_array_equal(found.position, np.stack([X, Y], axis=-1))
