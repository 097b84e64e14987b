"""Recognise scenes: by their manifest, as known dataset folders, stereo video, files of one eye.

What is guessed is said in the description's notes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from pipeline.errors import ConfigurationError, SceneError
from pipeline.media.datasets import (
    middlebury_2001_or_2003,
    middlebury_2005,
    middlebury_2014,
    msr_3d_video,
)
from pipeline.media.eye_files import eyes_in
from pipeline.media.images import IMAGE_SUFFIXES
from pipeline.media.manifest import MANIFEST_NAME, read_manifest
from pipeline.media.scene import PackedLayout, SceneDescription
from pipeline.media.stereo_video import describe_stereo_video

LEAST_MANIFEST = (
    '{"format": "depthsr-scene/1", "views": [{"id": "left", "color": "left-%04d.png"}, '
    '{"id": "right", "color": "right-%04d.png"}]}'
)
"""What the manifest of a scene must say, for a message."""


def describe_path(path: Path, input_layout: str | None = None) -> SceneDescription:
    """Return the description of whatever lies at a path.

    Parameters
    ----------
    path : Path
        A folder with or without a manifest, a manifest, or a video file: of both eyes, or of
        one with the other's beside it.
    input_layout : str or None
        How a video file's views are packed, where it does not say: one of
        :class:`PackedLayout`.

    Raises
    ------
    SceneError
        If nothing is there, or nothing that is known.
    ConfigurationError
        If ``input_layout`` is no layout, or the path is no video file.
    """
    if input_layout is not None and input_layout not in list(PackedLayout):
        raise ConfigurationError(
            f"--input-layout: {input_layout!r} is not one of {', '.join(PackedLayout)}"
        )
    if not path.exists():
        raise SceneError("there is no such file or folder", path=path)
    is_manifest = path.is_file() and path.suffix.lower() == ".json"
    if path.is_dir() or is_manifest:
        if input_layout is not None:
            raise ConfigurationError(
                f"--input-layout: only for a video file that holds both views, not for {path}"
            )
        return read_manifest(path) if is_manifest else describe_folder(path)
    if path.suffix.lower() in IMAGE_SUFFIXES:
        raise SceneError("one image; a scene is a folder, a manifest or a stereo video", path=path)
    return describe_stereo_video(path, input_layout)


def describe_folder(folder: Path) -> SceneDescription:
    """Return the description of a folder, by its manifest or by the names of its files."""
    if (folder / MANIFEST_NAME).exists():
        return read_manifest(folder)
    folder = folder.resolve()
    recognisers: tuple[Callable[[Path], SceneDescription | None], ...] = (
        msr_3d_video,
        middlebury_2014,
        middlebury_2005,
        middlebury_2001_or_2003,
        eyes_in,
    )
    for recognise in recognisers:
        description = recognise(folder)
        if description is not None:
            return description
    raise SceneError(
        f"no {MANIFEST_NAME} here, and no layout that is known: MSR 3D video "
        "(cam0/color-cam0-f000.jpg), Middlebury 2001–2014 (im2.png with disp2.png, "
        "view1.png with disp1.png, im0.png with im1.png), a video or images for each eye "
        "(clip_left.mov with clip_right.mov, left-0001.png with right-0001.png). Write a "
        f"{MANIFEST_NAME} that names the pictures, such as {LEAST_MANIFEST}; its keys are in "
        "docs/scene.md",
        path=folder,
    )
