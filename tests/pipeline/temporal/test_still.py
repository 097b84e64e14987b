"""What stands still is averaged; what changes begins anew, however faint or small it is."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.temporal.still import MOST_FRAMES, first_seen, seen_again

NOISE = 2.0
HEIGHT, WIDTH = 72, 96


@pytest.fixture(scope="module")
def ground():
    chance = np.random.default_rng(0)
    coarse = chance.uniform(40, 210, (HEIGHT, WIDTH)).astype(np.float32)
    return cv2.GaussianBlur(coarse, (0, 0), 1.0)


def _noisy(picture, seed):
    return (picture + np.random.default_rng(seed).normal(0, NOISE, picture.shape)).astype(
        np.float32
    )


def _seen(pictures):
    still = first_seen(_noisy(pictures[0], 0))
    for seed, picture in enumerate(pictures[1:], 1):
        still = seen_again(_noisy(picture, seed), still, NOISE)
    return still


def test_the_noise_of_what_stands_still_falls_with_the_root_of_the_frames(ground):
    still = _seen([ground] * MOST_FRAMES)
    assert still.changed.mean() < 0.002
    error = (still.mean - ground)[still.count == MOST_FRAMES]
    assert error.std() == pytest.approx(NOISE / np.sqrt(MOST_FRAMES), rel=0.03)
    assert abs(error.mean()) < 0.1


def test_older_frames_fade(ground):
    still = _seen([ground] * (MOST_FRAMES + 8))
    assert still.count.max() == MOST_FRAMES
    error = (still.mean - ground)[still.count == MOST_FRAMES]
    assert error.std() < NOISE / np.sqrt(MOST_FRAMES)


def test_where_something_comes_and_goes_nothing_of_it_stays(ground):
    shown = ground.copy()
    shown[30:36, 40:46] += 60
    still = _seen([ground, ground, shown])
    inside = (slice(30, 36), slice(40, 46))
    assert still.changed[inside].all()
    assert (still.count[inside] == 1).all()
    assert still.changed.mean() < 0.03
    gone = seen_again(_noisy(ground, 9), still, NOISE)
    assert gone.changed[inside].all()
    assert (gone.mean - ground)[inside].mean() == pytest.approx(0, abs=1.5)


def test_a_faint_wide_shadow_is_noticed(ground):
    shaded = ground.copy()
    shaded[20:60, 30:80] -= 2
    still = _seen([ground] * 4 + [shaded])
    assert still.changed[30:50, 40:70].mean() > 0.95


def test_a_slow_change_does_not_hide_behind_small_steps(ground):
    """Half a grey level a frame, for sixteen frames: the mean is never far behind."""
    pictures = [ground + np.float32(0.5 * number) for number in range(16)]
    still = _seen(pictures)
    assert abs((still.mean - pictures[-1]).mean()) < 1.5


def test_another_size_is_another_picture(ground):
    still = seen_again(ground[:40], first_seen(ground), NOISE)
    assert still.changed.all()
    np.testing.assert_array_equal(still.mean, ground[:40])
