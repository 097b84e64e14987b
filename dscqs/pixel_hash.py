"""The hash of decoded pixels, the same here and in the browser (``dscqs/page/pixel-hash.js``)."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

import numpy as np
import numpy.typing as npt


def hash_frames(frames: Iterable[npt.NDArray[np.uint8]]) -> str:
    """Return the hash of a still (one frame) or of a video.

    For each frame the SHA-256 of its R, then G, then B plane; over all frames the SHA-256 of
    those digests one after the other. Planes, because that is how lossless RGB video is decoded.

    Parameters
    ----------
    frames : iterable of ndarray of shape (H, W, 3), uint8
        RGB, rows from the top; both eyes where the stimulus has both.

    Returns
    -------
    str
        64 hexadecimal digits.

    Raises
    ------
    ValueError
        If a frame has another shape or type.
    """
    total = PixelHash()
    for frame in frames:
        total.add(frame)
    return total.hexdigest()


class PixelHash:
    """The hash of :func:`hash_frames`, fed frame by frame."""

    def __init__(self) -> None:
        self._total = hashlib.sha256()

    def add(self, frame: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint8]:
        """Take a frame in, and return it."""
        if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
            raise ValueError(f"a frame is {frame.shape} {frame.dtype}, not (H, W, 3) uint8")
        self._total.update(hashlib.sha256(frame.transpose(2, 0, 1).tobytes()).digest())
        return frame

    def hexdigest(self) -> str:
        """Return the hash of the frames so far: 64 hexadecimal digits."""
        return self._total.hexdigest()
