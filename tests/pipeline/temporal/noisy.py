"""Pictures as a camera leaves them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
import numpy.typing as npt

from benchmarks.changes import seen
from pipeline.frames import GreyImage


def noisy(pictures: Iterable[GreyImage], seed: int = 3) -> Iterator[npt.NDArray[np.uint8]]:
    """Yield 8-bit pictures of (H, W) with a camera's noise."""
    chance = np.random.default_rng(seed)
    for picture in pictures:
        yield seen(picture, chance)
