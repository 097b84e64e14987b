"""Enlargement by swscale, the scaler inside FFmpeg: what players and converters do."""

from __future__ import annotations

from typing import Any

import av
import numpy as np
import numpy.typing as npt

KERNELS = ("BICUBIC", "LANCZOS", "SPLINE")
"""Of swscale's kernels, those meant for enlarging photographs."""


def enlarged(
    image: npt.NDArray[np.uint8], factors: tuple[int, int], kernel: str
) -> npt.NDArray[np.uint8]:
    """Return a grey picture (H, W) enlarged, (K·H, K·W), pixel areas aligned.

    Parameters
    ----------
    factors : (int, int)
        K along y and x.
    kernel : str
        One of :data:`KERNELS`.
    """
    height, width = image.shape
    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format="gray")
    scaled: Any = frame.reformat(
        width=width * factors[1], height=height * factors[0], format="gray", interpolation=kernel
    )
    return np.asarray(scaled.to_ndarray(), dtype=np.uint8)
