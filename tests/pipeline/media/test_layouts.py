"""What a path is taken for, and what is sent of it."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.media.layouts import LEAST_MANIFEST
from pipeline.media.source import open_scene
from service.client import scene_files
from tests.support.datasets import (
    color,
    write_msr,
)


def _as_sent(scene: Path, target: Path) -> Path:
    """Copy the files that a service is sent of a scene; return the new scene."""
    for name, path in scene_files(scene).items():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(path, target / name)
    return target


@pytest.mark.parametrize("kind", ["manifest", "msr", "middlebury"])
def test_what_is_sent_of_a_folder_is_the_scene_and_nothing_else(
    tmp_path, kind, write_scene, middlebury_2014
):
    """A camera's card holds more than one scene, and results lie beside it."""
    folders = {
        "manifest": lambda: write_scene(views=3, frames=2, first=4),
        "msr": lambda: write_msr(tmp_path / "Breakdancers"),
        "middlebury": lambda: middlebury_2014,
    }
    scene = folders[kind]()
    needed = sum(path.is_file() for path in scene.rglob("*"))
    (scene / "out.mkv").write_bytes(b"result")
    (scene / "other").mkdir()
    (scene / "other" / "take.mov").write_bytes(b"take")
    sent = _as_sent(scene, tmp_path / "sent")
    assert sum(path.is_file() for path in sent.rglob("*")) == needed
    with open_scene(scene) as before, open_scene(sent) as after:
        for value in ("layout", "view_ids", "frame_indices", "has_depth", "has_calibration"):
            assert getattr(before.info, value) == getattr(after.info, value)
        first, second = (item.read(before.info.frame_indices.start) for item in (before, after))
    for one, other in zip(first.views, second.views, strict=True):
        np.testing.assert_array_equal(one.luma, other.luma)
        np.testing.assert_array_equal(one.depth_map, other.depth_map)


def test_a_manifest_of_another_name_is_sent_as_the_scene_s(write_scene, tmp_path):
    scene = write_scene()
    manifest = (scene / "scene.json").rename(scene / "rig.json")
    with open_scene(_as_sent(manifest, tmp_path / "sent")) as source:
        assert source.info.num_frames == 3


def test_what_is_no_scene_is_not_sent(tmp_path):
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(SceneError, match="no layout that is known"):
        scene_files(tmp_path)


def test_what_is_not_known_says_what_is(tmp_path):
    with pytest.raises(SceneError, match="there is no such file or folder"):
        open_scene(tmp_path / "nowhere")
    cv2.imwrite(str(tmp_path / "im2.png"), color(20))
    with pytest.raises(SceneError) as said:
        open_scene(tmp_path)
    text = str(said.value)
    assert "no scene.json here, and no layout that is known" in text
    assert "docs/scene.md" in text
    assert "\n" not in text
    with pytest.raises(SceneError, match=r"im2\.png: one image; a scene is"):
        open_scene(tmp_path / "im2.png")


def test_the_manifest_that_is_proposed_is_one(tmp_path):
    for eye in ("left", "right"):
        for frame in range(2):
            cv2.imwrite(str(tmp_path / f"{eye}-{frame:04d}.png"), color(20))
    (tmp_path / "scene.json").write_text(LEAST_MANIFEST)
    with open_scene(tmp_path) as source:
        assert source.info.layout == "manifest"
        assert (source.info.view_ids, source.info.num_frames) == (("left", "right"), 2)
