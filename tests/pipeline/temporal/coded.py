"""Pictures as a camera and a codec leave them."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pipeline.frames import GreyImage
from pipeline.media.decode import VideoReader
from pipeline.media.encode import write_segment
from pipeline.media.video_format import VideoFormat
from pipeline.stereo import StereoLayout

NOISE = 2.0


def noisy(pictures: Iterable[GreyImage], seed: int = 3) -> Iterator[npt.NDArray[np.uint8]]:
    """Yield 8-bit pictures of (H, W) with a camera's noise."""
    chance = np.random.default_rng(seed)
    for picture in pictures:
        seen = picture + chance.normal(0, NOISE, picture.shape)
        yield np.clip(np.rint(seen), 0, 255).astype(np.uint8)


def coded(
    path: Path, pictures: Iterable[npt.NDArray[np.uint8]], quality: int
) -> Iterator[GreyImage]:
    """Yield what is left of pictures in H.264 of a constant rate factor."""
    form = VideoFormat.for_path(path, layout=StereoLayout.LEFT, fps=Fraction(15), crf=quality)
    write_segment(path, form, ((picture,) for picture in pictures), first_frame=0)
    with contextlib.closing(VideoReader(path)) as film:
        for number in range(film.num_frames):
            yield film.picture(number).luma
