"""Live cameras, relayed into a stream."""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from pipeline.errors import ConfigurationError
from pipeline.media.instants import Instant
from pipeline.media.live_frames import EncodedPicture
from pipeline.media.live_manifest import LiveManifest, live_manifest, without_paths
from pipeline.media.manifest import MANIFEST_FORMAT
from pipeline.media.scene_source import with_pair
from service.bus.keys import Part
from service.streams.feed import Feed, header_of


@dataclass(frozen=True, kw_only=True)
class Relayed:
    """What was sent."""

    frames: int
    pictures: int
    bytes: int
    incomplete: int
    """Frames that some camera had no picture for."""


def manifest_of_cameras(
    names: Iterable[str],
    fps: Fraction,
    rig: Mapping[str, Any] | None = None,
    left: str | None = None,
    right: str | None = None,
) -> LiveManifest:
    """Return the manifest of cameras.

    Parameters
    ----------
    names : iterable of str
        Of the cameras, left to right.
    fps : Fraction
        Frames a second.
    rig : mapping, optional
        Manifest of a scene that these cameras took: its order of views, calibration and stereo
        pair are theirs.
    left, right : str, optional
        The cameras that are the eyes, in place of the rig's pair or the two in the middle.

    Raises
    ------
    ConfigurationError
        If the rig's views are not the cameras, or the eyes no pair.
    SceneError
        If the rig, or the names, make no scene.
    """
    names = list(names)
    content: dict[str, Any] = {
        "format": MANIFEST_FORMAT, "views": [{"id": name} for name in names]
    }  # fmt: skip
    if rig is not None:
        content = live_manifest(rig).content
        there = [view["id"] for view in content["views"]]
        if sorted(there) != sorted(names):
            raise ConfigurationError(
                f"--camera: the scene has the views {', '.join(there)}, "
                f"there are cameras {', '.join(names)}"
            )
        content.pop("depth", None)
        content["views"] = [view | {"depth": False} for view in content["views"]]
    content["fps"] = f"{fps.numerator}/{fps.denominator}"
    scene = with_pair(live_manifest(content).scene, left, right)
    return LiveManifest(scene=scene, content=without_paths(scene))


def relay(feed: Feed, instants: Iterable[Instant[EncodedPicture]], views: int) -> Relayed:
    """Send every instant; return what was sent once there are no more."""
    frames = incomplete = 0
    for instant in instants:
        feed.tell(time.monotonic())
        for view_id, picture in instant.pictures.items():
            header = header_of(picture, frame_index=frames, capture_time_ns=instant.taken)
            feed.put(view_id, Part.COLOR, picture, header)
        frames += 1
        incomplete += len(instant.pictures) < views
    return Relayed(
        frames=frames, pictures=feed.pictures, bytes=feed.bytes, incomplete=incomplete
    )  # fmt: skip
