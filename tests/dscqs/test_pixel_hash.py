from __future__ import annotations

import hashlib

import numpy as np
import pytest

from dscqs.pixel_hash import hash_frames


def test_planes_of_every_frame_in_order():
    frames = np.random.default_rng(1).integers(0, 256, (2, 3, 5, 3), np.uint8)
    parts = [
        hashlib.sha256(b"".join(frame[..., plane].tobytes() for plane in range(3))).digest()
        for frame in frames
    ]
    assert hash_frames(frames) == hashlib.sha256(b"".join(parts)).hexdigest()
    assert hash_frames(frames) != hash_frames(frames[::-1])


@pytest.mark.parametrize(
    "frame",
    [np.zeros((3, 5), np.uint8), np.zeros((3, 5, 3), np.uint16), np.zeros((3, 5, 4), np.uint8)],
)
def test_other_shapes_and_types_are_refused(frame):
    with pytest.raises(ValueError, match=r"not \(H, W, 3\) uint8"):
        hash_frames([frame])
