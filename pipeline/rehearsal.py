"""A very small scene that is made before the first frame of a real one, where a rate is held.

Kernels are read from the disk, or compiled, when they are first used. Frames of a scene that wait
for that come late, and the controller takes it for what such frames cost.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import repeat

import numpy as np

from pipeline.colour import picture_from_rgb
from pipeline.config import Settings
from pipeline.effort import FULL, Effort
from pipeline.errors import Interrupted
from pipeline.frames import MultiViewFrame, View
from pipeline.registration.again import AGAIN
from pipeline.stereo import Picture
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker

log = logging.getLogger(__name__)

WIDTH, HEIGHT = 96, 72
"""Of the pictures, pixels: large enough for patches, pyramids and a PSF."""

VIEWS = 4
"""Most views: the eyes, and others of which one is looked at in turn."""

NOISE = 1.0
"""Of the pictures, grey levels."""

PAN, NOISE_OF_OTHERS = 7, 16.0
"""By how much the cameras have moved in the last frame, pixels, and the noise there of views that
are no eyes, which disagree and are corrected."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallFrame:
    """A frame of the small scene."""

    effort: Effort
    """What is to be put into it."""
    pictures: tuple[Picture, ...]
    """(HEIGHT, WIDTH, 3) uint8 RGB of each view."""
    depth: tuple[Picture, ...]
    """(HEIGHT, WIDTH) uint8 or uint16 of each view, as ``SampleScene.stereo_depth`` stores it."""


def small_scene(num_views: int) -> SampleScene:
    """Return the scene of which the frames are."""
    return SampleScene(width=WIDTH, height=HEIGHT, num_views=num_views)


def small_frames(
    scene: SampleScene, efforts: Sequence[Effort], is_eye: Callable[[int], bool]
) -> Iterator[SmallFrame]:
    """Yield a frame for each effort, and before them as many as it takes to keep something.

    Parameters
    ----------
    efforts : sequence of Effort
        What may be put into a frame, most first.
    is_eye : callable
        Of a view's number.
    """
    seen = [scene.observe(picture) for picture in scene.render_all(0.0)]
    depth = tuple(scene.stereo_depth(number, 0) for number in range(scene.num_views))
    still = max(AGAIN) + 1  # frames in which all is registered, before some of it is kept
    each = [*repeat(FULL, still + 1), *efforts, FULL]
    for number, effort in enumerate(each):
        is_last = number == len(each) - 1
        pictures = []
        for place, picture in enumerate(seen):
            noise = NOISE_OF_OTHERS if is_last and not is_eye(place) else NOISE
            picture = np.roll(picture, PAN * is_last, axis=1)
            pictures.append(_changed(picture, place, number, max(0, number - still), noise))
        yield SmallFrame(effort=effort, pictures=tuple(pictures), depth=depth)


def _changed(picture: Picture, place: int, number: int, moved: int, noise: float) -> Picture:
    """Return a picture with noise, and turned round in a part that has moved so many pixels."""
    changed = picture + np.random.default_rng([place, number]).normal(0.0, noise, picture.shape)
    if moved:
        columns = slice(moved, moved + WIDTH // 4)
        changed[:, columns] = 255 - changed[:, columns]
    return np.clip(np.rint(changed), 0, 255).astype(np.uint8)


@contextmanager
def as_far_as_it_goes() -> Iterator[None]:
    """Let a rehearsal fail: the first frame will tell, and of small pictures it may not be true."""
    try:
        yield
    except (Interrupted, MemoryError):
        raise  # as in a frame
    except Exception as error:
        log.warning("what is to come could not be rehearsed: %r", error)


def rehearsed(settings: Settings) -> Settings:
    """Return the settings of a rehearsal: those of the frames to come, no PSF to be looked for."""
    return replace(settings, psf="given", psf_per_layer=False)


def rehearse(
    settings: Settings,
    efforts: Sequence[Effort],
    *,
    num_views: int,
    num_eyes: int,
    has_depth: bool,
    stop: Callable[[], bool] | None = None,
) -> None:
    """Make a frame with each effort, of as many views as a scene has, or a few of them.

    Parameters
    ----------
    num_eyes : int
        Eyes that are made, 1 or 2.
    has_depth : bool
        Whether views have depth maps.
    stop : callable, optional
        Polled often.

    Raises
    ------
    Interrupted
        Once ``stop`` says so.
    """
    scene = small_scene(min(max(num_views, 2), VIEWS))
    left, right = (scene.view_ids[place] for place in scene.reference_views)
    worker = Worker(rehearsed(settings), targets=(left, right)[:num_eyes], stop=stop)
    scale, offset = scene.depth_scale
    for number, small in enumerate(
        small_frames(scene, efforts, lambda place: place in scene.reference_views)
    ):
        views = []
        for view_id, picture, stored in zip(
            scene.view_ids, small.pictures, small.depth, strict=True
        ):
            read = picture_from_rgb(picture, 255)
            nearness = np.where(stored > 0, stored * scale + offset, np.nan).astype(np.float32)
            views.append(
                View(
                    view_id=view_id,
                    luma=read.luma,
                    chroma=read.chroma,
                    depth_map=nearness if has_depth else None,
                )
            )
        frame = MultiViewFrame(frame_index=number, views=tuple(views), left=left, right=right)
        worker.take(frame, effort=small.effort)
