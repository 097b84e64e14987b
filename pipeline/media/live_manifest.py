"""The manifest of a live source: that of a scene, whose pictures come later.

It is a scene's manifest without paths (docs/scene.md). A view may say whether it
sends depth (``"depth": true``); where no view says anything, all do if the
manifest has ``depth``. A whole ``scene.json`` is understood too: its paths then
only tell which views have depth, and nothing is opened.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

from pipeline.errors import SceneError
from pipeline.media.manifest import manifest_of, parse_manifest, read_json
from pipeline.media.scene import SceneDescription

NAME = Path("manifest")
"""What errors call it."""

STAND_IN = "live-%d.png"
"""Stands where a scene on disk has a path; never opened."""

UNTOLD_FPS = Fraction(25)
"""Rate of a source that does not tell its own, frames a second."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LiveManifest:
    """What a live source says of itself."""

    scene: SceneDescription
    """Views left to right, calibration, meaning of depth, the stereo pair; paths are stand-ins."""
    content: dict[str, Any]
    """The same as plain values, without paths, in one form."""

    @property
    def fps(self) -> Fraction:
        """Frames a second."""
        return self.scene.fps or UNTOLD_FPS

    @property
    def view_ids(self) -> tuple[str, ...]:
        """Ids of the views, left to right."""
        return self.scene.view_ids

    @property
    def depth_ids(self) -> frozenset[str]:
        """Ids of the views that send depth."""
        return frozenset(view.view_id for view in self.scene.views if view.depth is not None)

    @property
    def pair(self) -> tuple[str, str]:
        """Ids of the left and the right reference."""
        assert self.scene.left is not None
        assert self.scene.right is not None
        return self.scene.left, self.scene.right


def read_live_manifest(raw: bytes) -> LiveManifest:
    """Return the manifest of these bytes of JSON.

    Raises
    ------
    SceneError
        If it is no JSON or no manifest; the message names view and key.
    """
    return live_manifest(read_json(raw, NAME))


def live_manifest(content: Any) -> LiveManifest:
    """Return the manifest of plain values; see :func:`read_live_manifest`."""
    scene = parse_manifest(_with_stand_ins(content), NAME)
    return LiveManifest(scene=scene, content=without_paths(scene))


def without_paths(scene: SceneDescription) -> dict[str, Any]:
    """Return the manifest that a live source of this scene sends."""
    content = manifest_of(scene)
    for entry in content["views"]:
        del entry["color"]
        entry["depth"] = "depth" in entry
    del content["first_frame"]
    content.pop("frame_count", None)
    return content


def _with_stand_ins(content: Any) -> Any:
    """Return the content with a path for everything that a view will send."""
    if not isinstance(content, dict) or not isinstance(content.get("views"), list):
        return content  # for the parser to complain about
    told = any(
        isinstance(view, dict) and {"color", "depth"} & set(view) for view in content["views"]
    )
    views = []
    for view in content["views"]:
        if not isinstance(view, dict):
            views.append(view)
            continue
        sends = view.get("depth") if told else content.get("depth")
        if told and sends not in (None, True, False) and not isinstance(sends, (str, dict)):
            raise SceneError(
                f"depth: must be true or false, not {sends!r}", path=NAME, view=str(view.get("id"))
            )
        entry = {key: value for key, value in view.items() if key not in ("color", "depth")}
        entry["color"] = STAND_IN
        if sends:
            entry["depth"] = STAND_IN
        views.append(entry)
    return {**content, "views": views}
