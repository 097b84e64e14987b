"""A very small stream of a source's kind, before its first frame.

Kernels are read from the disk, or compiled, when they are first used, and libraries likewise. A
stream whose first frame of each kind waits for that loses frames meanwhile, and its controller
takes it for what such frames cost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import repeat

import numpy as np

from pipeline.config import Settings
from pipeline.effort import FULL, Effort, depth_looked_at, nearest_views
from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_encode import LiveEncoder
from pipeline.media.live_frames import EncodedPicture, LiveFrames, PictureEncoding
from pipeline.media.png import encode_png
from pipeline.registration.again import AGAIN
from pipeline.stereo import Picture, StereoLayout
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker
from service.streams.outlets import FinishedFrame

WIDTH, HEIGHT = 96, 72
"""Of the pictures, pixels: large enough for patches, pyramids and a PSF."""

VIEWS = 4
"""Most views: the eyes, and others of which one is looked at in turn."""

NOISE = 1.0
"""Of the pictures, grey levels."""

PAN, NOISE_OF_OTHERS = 7, 16.0
"""By how much the cameras have moved in the last frame, pixels, and the noise there of views that
are no eyes, which disagree and are corrected."""


def rehearse(
    frames: LiveFrames, settings: Settings, efforts: Sequence[Effort], stop: Callable[[], bool]
) -> None:
    """Make a frame with each effort, of a source like this one, and encode what comes of it.

    Parameters
    ----------
    frames : LiveFrames
        Of the source.
    settings : Settings
    efforts : sequence of Effort
        What may be put into a frame, most first.
    stop : callable
        Polled often.

    Raises
    ------
    Interrupted
        Once ``stop`` says so.
    """
    manifest = frames.manifest
    left, right = manifest.pair
    names = nearest_views(manifest.view_ids, (left, right), VIEWS)
    given = replace(settings, psf="given", psf_per_layer=False)
    worker = Worker(given, targets=(left, right), stop=stop)
    scene = SampleScene(width=WIDTH, height=HEIGHT, num_views=len(names))
    seen = [scene.observe(picture) for picture in scene.render_all(0.0)]
    maps = [scene.stereo_depth(place, 0) for place in range(len(names))]
    still = max(AGAIN) + 1  # frames in which all is registered, before some of it is kept
    each = [*repeat(FULL, still + 1), *efforts, FULL]
    with closing(LiveEncoder(fps=manifest.fps, layout=StereoLayout.SBS)) as encoder:
        for number, effort in enumerate(each):
            is_last = number == len(each) - 1
            color, depth = {}, {}
            deep = depth_looked_at(effort, names, manifest.pair)
            for place, name in enumerate(names):
                noise = NOISE_OF_OTHERS if is_last and name not in manifest.pair else NOISE
                picture = np.roll(seen[place], PAN * is_last, axis=1)
                picture = _changed(picture, place, number, max(0, number - still), noise)
                color[name] = EncodedPicture(
                    encoding=PictureEncoding.JPEG, data=encode_jpeg(picture)
                )
                if name in deep and name in manifest.depth_ids:
                    data = encode_png(maps[place])
                    depth[name] = EncodedPicture(encoding=PictureEncoding.PNG, data=data)
            decoded, _ = frames.decode(color, depth)
            frame = frames.frame(number, decoded, depth=deep)
            images = worker.take(frame, effort=effort).images
            made = FinishedFrame(
                left=images[left], right=images[right], observed=None,
                frame_index=number, position=number, capture_time_ns=number,
            )  # fmt: skip
            encoder.encode(made.coded, number)


def _changed(picture: Picture, place: int, number: int, moved: int, noise: float) -> Picture:
    """Return a picture with noise, and turned round in a part that has moved so many pixels."""
    changed = picture + np.random.default_rng([place, number]).normal(0.0, noise, picture.shape)
    if moved:
        columns = slice(moved, moved + WIDTH // 4)
        changed[:, columns] = 255 - changed[:, columns]
    return np.clip(np.rint(changed), 0, 255).astype(np.uint8)
