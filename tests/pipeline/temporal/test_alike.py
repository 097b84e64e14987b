"""What changes in all views alike is the scene; what one view has by itself is noise."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.temporal.alike import MOST, Alike, Looked, differences_alike

SHAPE = (96, 128)
AWAY = 5
"""By how much the other view shows the scene to the left, pixels."""
TRUTH = cv2.GaussianBlur(
    np.random.default_rng(0).normal(128, 200, (SHAPE[0], SHAPE[1] + AWAY)).astype(np.float32),
    (0, 0),
    1.5,
)


def _noise(number, deviation):
    """Return what one view has by itself."""
    return np.random.default_rng(number).normal(0, deviation, SHAPE).astype(np.float32)


def _asked(frames, means, flags=0, touched=False):
    """Return what two views tell of their means; the pictures of both as the scene lies in them."""
    places = np.stack(np.meshgrid(np.arange(SHAPE[1]), np.arange(SHAPE[0])), axis=-1)
    position = np.float32(places + np.array([AWAY, 0]))
    marks = np.full(SHAPE, touched)
    other = Looked(
        luma=frames[1], mean=means[1], touched=np.zeros(SHAPE, bool), position=position,
        flags=np.full(SHAPE, flags, np.uint8), offset=np.zeros(SHAPE, np.float32),
    )  # fmt: skip
    return Alike(differences_alike(frames[0], means[0], marks, [other]))


def _both(whole):
    return whole[:, : SHAPE[1]], whole[:, AWAY:]


def test_noise_of_its_own_is_what_a_mean_is_better_by():
    frames = [shown + _noise(k, 2.0) for k, shown in enumerate(_both(TRUTH))]
    means = [
        shown + np.float32(0.25) * (frame - shown) + _noise(5 + k, 0.9)
        for k, (shown, frame) in enumerate(zip(_both(TRUTH), frames, strict=True))
    ]
    found = _asked(frames, means)
    assert found.share_behind == 0
    assert found.way_on < 0.2


def test_a_scene_that_has_changed_leaves_the_means_behind():
    """By less than a tenth of the noise's power."""
    shifted = cv2.warpAffine(
        TRUTH, np.array([[1, 0, 0.06], [0, 1, 0]], np.float32), TRUTH.shape[::-1],
        flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT,
    )  # fmt: skip
    frames = [shown + _noise(k, 2.0) for k, shown in enumerate(_both(TRUTH))]
    means = [shown + _noise(5 + k, 1.0) for k, shown in enumerate(_both(shifted))]
    assert _asked(frames, means).share_behind > MOST


def test_means_move_on_to_frames_that_are_better():
    """What a codec had left as it was in each view has nothing to do with the other."""
    frames = list(_both(TRUTH))
    means = [shown + _noise(5 + k, 1.5) for k, shown in enumerate(frames)]
    found = _asked(frames, means)
    assert found.share_behind == 0
    assert found.way_on > 0.9


@pytest.mark.parametrize(("flags", "touched"), [(1, False), (0, True)])
def test_what_is_not_known_tells_nothing(flags, touched):
    frames = list(_both(TRUTH))
    found = _asked(frames, [frame + 3 for frame in frames], flags, touched)
    assert found.share_behind == found.way_on == 0
