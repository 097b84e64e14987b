"""Video files whose pictures hold both eyes: how they lie, and whether they are squeezed."""

from __future__ import annotations

import re
import shlex
from fractions import Fraction
from pathlib import Path

from pipeline.errors import SceneError
from pipeline.media.decode import VideoReader
from pipeline.media.eye_files import eyes_beside
from pipeline.media.scene import PackedEye, PackedLayout, SceneDescription, ViewDescription

HALF_TOP_BOTTOM_FROM = Fraction(5, 2)
"""An eye at least this many times as wide as high was squeezed vertically."""

HALF_SIDE_BY_SIDE_BELOW = Fraction(1)
"""An eye less than this many times as wide as high was squeezed horizontally."""

SPATIAL = (
    "holds its eyes as two layers of HEVC (MV-HEVC: spatial video of Apple), of which only one can "
    "be read: write each into a file of its own, with FFmpeg 7.1 or newer: ffmpeg -i FILE "
    "-map 0:v:0:vpos:left -c:v ffv1 {} -map 0:v:0:vpos:right -c:v ffv1 {}"
)
"""What is said of spatial video, with names for its eyes."""


def describe_stereo_video(path: Path, input_layout: str | None = None) -> SceneDescription:
    """Return the description of a video file whose pictures hold two views, or that has a twin.

    How they lie is taken from ``input_layout``, else from the container's tag or the stream's
    frame-packing message, else from the file's name (``clip_3D_HSBS.mkv``). Whether an eye is
    squeezed to half is in no such tag: the name, the pixel aspect and the eye's proportions
    tell, in this order, and a note says what was taken. Where nothing tells how they lie, and
    the file is named as one eye's with the other's beside it, the two are the scene.

    Raises
    ------
    SceneError
        If it is no video, its eyes are layers of HEVC, or nothing says how they lie.
    """
    with_video = VideoReader(path)
    try:
        tag, aspect = with_video.stereo, with_video.pixel_aspect
        width, height = with_video.width, with_video.height
        holds_layers = with_video.holds_layers
    finally:
        with_video.close()
    if holds_layers:
        left, right = (shlex.quote(f"{path.stem}_{eye}.mkv") for eye in ("left", "right"))
        raise SceneError(SPATIAL.format(left, right), path=path)
    file = path.resolve()
    notes: list[str] = []
    right_first = tag is not None and tag.right_first
    if input_layout is not None:
        layout = PackedLayout(input_layout)
    else:
        named, named_half = _layout_in_name(path.stem)
        arrangement = tag.arrangement if tag is not None else named
        if arrangement is None:
            beside = eyes_beside(path)
            if beside is not None:
                return beside
            raise SceneError(
                "does not say how its views are packed: the input layout must "
                f"(--input-layout: {', '.join(PackedLayout)}). If it is one eye's, name the "
                "other's alike (clip_left.mov, clip_right.mov)",
                path=path,
            )
        half, because = named_half, "name"
        if half is None:
            half, because = _looks_half(arrangement, width, height, aspect)
        layout = PackedLayout(f"half-{arrangement}" if half else arrangement)
        origin = tag.origin if tag is not None else "file name"
        notes.append(
            f"read as {layout.value}: {arrangement} by the {origin}, "
            f"{'half' if half else 'full'} size by the {because}; "
            "if that is wrong, give the input layout (--input-layout)"
        )
    views = tuple(
        ViewDescription(
            view_id=view_id,
            color=PackedEye(path=file.name, layout=layout, second=second != right_first),
        )
        for view_id, second in (("left", False), ("right", True))
    )
    return SceneDescription(
        root=file.parent,
        source=path,
        views=views,
        left="left",
        right="right",
        layout="stereo-video",
        notes=tuple(notes),
    )


_NAMES_OF = {
    "sbs": ("sbs", None),
    "fsbs": ("sbs", False),
    "hsbs": ("sbs", True),
    "tab": ("tab", None),
    "ftab": ("tab", False),
    "htab": ("tab", True),
}
_NAMES_BESIDE_3D = {
    "lr": ("sbs", None),
    "ou": ("tab", None),
    "hou": ("tab", True),
    "tb": ("tab", None),
}


def _layout_in_name(stem: str) -> tuple[str | None, bool | None]:
    """Return (``sbs``, ``tab`` or None; half, full or None) as the tokens of a name say."""
    tokens = [token for token in re.split(r"[^a-z0-9]+", stem.lower()) if token]
    known = _NAMES_OF | (_NAMES_BESIDE_3D if "3d" in tokens else {})
    for place, token in enumerate(tokens):
        if token in known:
            arrangement, half = known[token]
            if place and tokens[place - 1] in ("half", "h"):
                half = True
            return arrangement, half
    text = " ".join(tokens)
    for words, arrangement in (("side by side", "sbs"), ("top bottom", "tab")):
        if words in text:
            return arrangement, True if f"half {words}" in text else None
    return None, None


def _looks_half(
    arrangement: str, width: int, height: int, aspect: Fraction | None
) -> tuple[bool, str]:
    squeezed = Fraction(2) if arrangement == "sbs" else Fraction(1, 2)
    if aspect == squeezed:
        return True, "pixel aspect"
    if arrangement == "sbs":
        return Fraction(width, 2 * height) < HALF_SIDE_BY_SIDE_BELOW, "proportions"
    return Fraction(2 * width, height) >= HALF_TOP_BOTTOM_FROM, "proportions"
