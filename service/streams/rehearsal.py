"""A very small stream of a source's kind, before its first frame.

See :mod:`pipeline.rehearsal`; decoding and encoding load libraries of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing

from pipeline.config import Settings
from pipeline.effort import Effort, depth_looked_at, nearest_views
from pipeline.media.jpeg import encode_jpeg
from pipeline.media.live_encode import LiveEncoder
from pipeline.media.live_frames import EncodedPicture, LiveFrames, PictureEncoding
from pipeline.media.png import encode_png
from pipeline.rehearsal import VIEWS, rehearsed, small_frames, small_scene
from pipeline.stereo import StereoLayout
from pipeline.worker import Worker
from service.streams.outlets import FinishedFrame


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
    worker = Worker(rehearsed(settings), targets=(left, right), stop=stop)
    scene = small_scene(len(names))
    with closing(LiveEncoder(fps=manifest.fps, layout=StereoLayout.SBS)) as encoder:
        for number, small in enumerate(
            small_frames(scene, efforts, lambda place: names[place] in manifest.pair)
        ):
            color, depth = {}, {}
            deep = depth_looked_at(small.effort, names, manifest.pair)
            for name, picture, stored in zip(names, small.pictures, small.depth, strict=True):
                color[name] = EncodedPicture(
                    encoding=PictureEncoding.JPEG, data=encode_jpeg(picture)
                )
                if name in deep and name in manifest.depth_ids:
                    depth[name] = EncodedPicture(
                        encoding=PictureEncoding.PNG, data=encode_png(stored)
                    )
            decoded, _ = frames.decode(color, depth)
            frame = frames.frame(number, decoded, depth=deep)
            images = worker.take(frame, effort=small.effort).images
            made = FinishedFrame(
                left=images[left], right=images[right], observed=None,
                frame_index=number, position=number, capture_time_ns=number,
            )  # fmt: skip
            encoder.encode(made.coded, number)
