"""The manifest: what is read, what is refused, and what is written."""

from __future__ import annotations

import copy
import json
import tempfile
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import SceneError
from pipeline.frames import Calibration
from pipeline.media.manifest import manifest_of, read_manifest, write_manifest
from pipeline.media.scene import (
    DepthEncoding,
    DepthKind,
    ImageFiles,
    PackedEye,
    PackedLayout,
    RawVideo,
    SceneDescription,
    VideoFile,
    ViewDescription,
)
from pipeline.media.ycbcr import YcbcrMatrix
from pipeline.media.yuv import Range


def camera_at(x: float, y: float = 0.0) -> dict:
    motion = np.eye(4)
    motion[:3, 3] = [-x, -y, 0]
    return {
        "intrinsics": [[50, 0, 12], [0, 50, 8], [0, 0, 1]],
        "world_to_camera": motion.tolist(),
    }


def manifest(**changes) -> dict:
    content = {
        "format": "depthsr-scene/1",
        "fps": "30000/1001",
        "first_frame": 4,
        "frame_count": 10,
        "views": [
            {"id": "a", "color": "a/%04d.png", "depth": "a-depth.mkv", **camera_at(0)},
            {
                "id": "b",
                "color": {"yuv": "b.yuv", "width": 6, "height": 4, "pixel_format": "yuv420p"},
                **camera_at(1),
            },
            {"id": "c", "color": "c.mp4", **camera_at(2)},
        ],
        "depth": {"kind": "inverse_depth", "scale": 0.5, "offset": 1, "unknown": 0},
        "stereo": {"left": "a", "right": "c"},
    }
    content.update(changes)
    return content


@pytest.fixture
def write(tmp_path):
    def write(content) -> str:
        text = content if isinstance(content, str) else json.dumps(content)
        (tmp_path / "scene.json").write_text(text)
        return tmp_path / "scene.json"

    return write


def test_everything_is_read(write, tmp_path):
    scene = read_manifest(write(manifest()))
    assert scene.root == tmp_path.resolve()
    assert scene.view_ids == ("a", "b", "c")
    assert scene.fps == Fraction(30000, 1001)
    assert (scene.first_frame, scene.frame_count) == (4, 10)
    assert (scene.left, scene.right) == ("a", "c")
    assert scene.view("a").color == ImageFiles(pattern="a/%04d.png")
    assert scene.view("a").color.path_of(12) == "a/0012.png"
    assert scene.view("a").depth == VideoFile(path="a-depth.mkv")
    assert scene.view("b").color == RawVideo(
        path="b.yuv", width=6, height=4, pixel_format="yuv420p"
    )
    assert scene.depth == DepthEncoding(
        kind=DepthKind.INVERSE_DEPTH, scale=0.5, offset=1.0, unknown=0.0
    )
    np.testing.assert_allclose(scene.view("c").calibration.centre, [2, 0, 0])
    with pytest.raises(KeyError):
        scene.view("d")


def test_what_may_be_missing_has_defaults(write):
    scene = read_manifest(
        write(
            {
                "format": "depthsr-scene/1",
                "views": [{"id": str(index), "color": f"{index}%%.png"} for index in range(5)],
            }
        )
    )
    assert (scene.left, scene.right) == ("2", "3")
    assert (scene.fps, scene.first_frame, scene.frame_count, scene.depth) == (None, 0, None, None)
    still = scene.view("0").color
    assert still.is_still
    assert still.path_of(7) == "0%.png"


def test_writing_and_reading_again_gives_the_same(tmp_path):
    views = (
        ViewDescription(
            view_id="links",
            color=ImageFiles(pattern="l/%03d.png"),
            depth=RawVideo(
                path="l.yuv",
                width=5,
                height=3,
                pixel_format="gray10le",
                matrix=YcbcrMatrix.BT709,
                range=Range.FULL,
            ),
            calibration=Calibration(
                intrinsics=np.array([[40.5, 0.25, 2], [0, 41, 1], [0, 0, 1]]),
                world_to_camera=np.eye(4),
            ),
        ),
        ViewDescription(view_id="rechts", color=VideoFile(path="r.mkv")),
    )
    scene = SceneDescription(
        root=tmp_path.resolve(),
        views=views,
        depth=DepthEncoding(kind=DepthKind.DEPTH, scale=0.1),
        fps=Fraction(24),
        first_frame=3,
        frame_count=2,
    )
    write_manifest(scene, tmp_path)
    again = read_manifest(tmp_path)
    assert manifest_of(again) == manifest_of(scene)
    assert again.view("links").depth == views[0].depth
    np.testing.assert_array_equal(
        again.view("links").calibration.intrinsics, views[0].calibration.intrinsics
    )
    assert again.depth == scene.depth


def test_what_a_manifest_cannot_say_is_not_written(tmp_path):
    eyes = tuple(
        ViewDescription(
            view_id=name,
            color=PackedEye(path="a.mkv", layout=PackedLayout.SIDE_BY_SIDE, second=second),
        )
        for name, second in (("left", False), ("right", True))
    )
    with pytest.raises(SceneError, match="one half of a stereo picture"):
        write_manifest(SceneDescription(root=tmp_path, views=eyes), tmp_path)
    assert not (tmp_path / "scene.json").exists()


def test_calibration_orders_the_views_and_says_so(write):
    content = manifest(stereo={"left": "b", "right": "a"})
    for view, x in zip(content["views"], (2.0, 0.0, 3.0), strict=True):
        view.update(camera_at(x))
    scene = read_manifest(write(content))
    assert scene.view_ids == ("b", "a", "c")
    assert "b, a, c" in scene.notes[0]


def test_views_without_calibration_keep_their_order(write):
    content = manifest()
    for key in ("intrinsics", "world_to_camera"):
        del content["views"][1][key]
    content["views"][0].update(camera_at(9))
    assert read_manifest(write(content)).view_ids == ("a", "b", "c")


def changed(path: str, value) -> dict:
    """Return the manifest with one value put at a dotted path; ... removes it."""
    content = copy.deepcopy(manifest())
    *parents, last = [int(part) if part.isdecimal() else part for part in path.split(".")]
    place = content
    for part in parents:
        place = place[part]
    if value is ...:
        del place[last]
    else:
        place[last] = value
    return content


ROTATED = [[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]

BAD = [
    ("format", "depthsr-scene/2", r"format: must be 'depthsr-scene/1'"),
    ("format", ..., "format: must be"),
    ("colour", 1, "unknown key 'colour'; known are format"),
    ("views.0.colour", "x", r"view 'a': unknown key 'colour'; known are id, color"),
    ("depth.unit", "m", "depth: unknown key 'unit'"),
    ("stereo.middle", "b", "stereo: unknown key 'middle'"),
    ("views.1.color.stride", 8, r"view 'b': color: unknown key 'stride'"),
    ("views", {}, "views: must be a list"),
    ("views", [], "views: two or more are needed, there is none"),
    ("views.1.id", "a", "view 'a': views: this id occurs twice"),
    ("views.1.id", "", r"views\[1\]: id '' must be"),
    ("views.1.id", "b,c", "must be free of commas"),
    ("views.1.id", "../b", "must be free of commas, slashes"),
    ("views.1.id", 3, r"views\[1\]: id must be a text"),
    ("views.0.color", ..., "view 'a': missing: color"),
    ("views.0.color", 5, "view 'a': color: must be a path, or raw video"),
    ("views.0.color", "", "view 'a': color: must be a path"),
    ("views.0.color", "/tmp/%04d.png", "view 'a': color: must be relative"),
    ("views.0.color", "../%04d.png", "view 'a': color: leads out of the scene's folder"),
    ("views.0.color", "a/../../x.png", "leads out of the scene's folder"),
    ("views.0.depth", "../d.png", "view 'a': depth: leads out of"),
    ("views.0.color", "a/%s.png", "color: bad pattern 'a/%s.png'"),
    ("views.0.color", "%d/%d.png", "color: bad pattern"),
    ("views.0.color", "a/%", "color: bad pattern"),
    ("views.0.color", "a/%4d.png", "color: bad pattern"),
    ("views.0.color", "a/%n%04d.png", "color: bad pattern"),
    ("views.0.color", "a/%04d.mp4", "a pattern must name image files"),
    ("views.1.color.yuv", "../b.yuv", "view 'b': color: yuv: leads out of"),
    ("views.1.color.width", 0, "color: width: must be a whole number from 1 up, not 0"),
    ("views.1.color.height", 4.5, "color: height: must be a whole number"),
    ("views.1.color.pixel_format", "rgb24", "color: pixel_format 'rgb24' is not supported"),
    ("views.1.color.matrix", "bt470", "color: matrix must be one of bt601"),
    ("views.1.color.range", "tv", "color: range must be one of limited, full, not 'tv'"),
    ("views.0.intrinsics", ..., "view 'a': intrinsics: missing; a calibration is both"),
    ("views.2.world_to_camera", ..., "view 'c': world_to_camera: missing"),
    ("views.0.intrinsics", [[1, 0], [0, 1]], "intrinsics: must be 3 rows of 3 finite numbers"),
    ("views.0.intrinsics", [[0, 0, 1], [0, 1, 1], [0, 0, 1]], "focal lengths must be above 0"),
    ("views.0.intrinsics", [[1, 0, 1], [0, 1, 1], [0, 0, 2]], "upper triangular"),
    ("views.0.world_to_camera", [[1, 0, 0, 0]] * 3, "must be 4 rows of 4 finite numbers"),
    ("views.0.world_to_camera", [[1, 0, 0, True]] * 4, "must be 4 rows of 4 finite numbers"),
    ("views.0.world_to_camera", [[1, 0, 0, 0]] * 4, "the last row must be 0, 0, 0, 1"),
    ("views.0.world_to_camera", ROTATED, "its 3×3 part mirrors"),
    ("views.0.world_to_camera", (np.diag([2, 2, 2, 1])).tolist(), "is not a rotation"),
    ("depth", ..., "depth: missing, but views have depth maps"),
    ("depth.kind", ..., "depth: missing: kind"),
    ("depth.kind", "distance", "depth: kind must be one of disparity"),
    ("depth.scale", 0, "depth: scale must not be 0"),
    ("depth.scale", None, "depth: scale must be a finite number"),
    ("depth.unknown", "0", "depth: unknown must be a finite number"),
    ("depth.offset", 10**400, "depth: offset must be a finite number"),
    ("stereo.right", ..., "stereo: missing: right"),
    ("stereo.left", 1, "stereo: left must be a view's id"),
    ("stereo.left", "z", "stereo: left is 'z', which is no view; there are a, b, c"),
    ("stereo.left", "c", "stereo: left 'c' must stand left of right 'c'"),
    ("fps", "0/1", "fps: must be above 0"),
    ("fps", "15/0", "fps: must be frames a second such as 15/1"),
    ("fps", "fast", "fps: must be frames a second"),
    ("fps", "-15", "fps: must be frames a second"),
    ("fps", "1e999999999", "fps: must be frames a second"),
    ("fps", True, "fps: must be frames a second"),
    ("fps", 5000, "fps: must be above 0, up to 1000"),
    ("first_frame", -1, "first_frame: must be a whole number from 0 up"),
    ("frame_count", 0, "frame_count: must be a whole number from 1 up"),
    ("frame_count", "8", "frame_count: must be a whole number"),
]


@pytest.mark.parametrize(("path", "value", "said"), BAD, ids=[f"{p}={v}"[:50] for p, v, _ in BAD])
def test_a_bad_manifest_is_one_line_that_names_file_and_key(write, path, value, said):
    file = write(changed(path, value))
    with pytest.raises(SceneError, match=said) as caught:
        read_manifest(file)
    assert str(file) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1]", "must be a JSON object"),
        ("{", "not JSON as it should be"),
        ('{"format": "depthsr-scene/1", "format": 1}', "key occurs twice: 'format'"),
        ('{"format": NaN}', "NaN is not a number"),
        ('{"format": "\\ud800"}', "not JSON as it should be"),
        ("[" * 100_000, "not JSON as it should be"),
    ],
)
def test_what_is_not_a_json_object_is_refused(write, text, said):
    with pytest.raises(SceneError, match=said):
        read_manifest(write(text))


def test_a_scene_of_one_view_is_refused(write):
    content = manifest()
    content["views"] = content["views"][:1]
    with pytest.raises(SceneError, match="views: two or more are needed, there is 1"):
        read_manifest(write(content))


def test_a_link_out_of_the_folder_is_refused_and_one_inside_is_not(write, tmp_path):
    inside = tmp_path / "scene"
    (inside / "real").mkdir(parents=True)
    (tmp_path / "elsewhere").mkdir()
    (inside / "within").symlink_to("real")
    (inside / "without").symlink_to("../elsewhere")
    for name, good in (("within", True), ("without", False), ("real/../real", True)):
        content = manifest()
        content["views"][0]["color"] = f"{name}/%04d.png"
        (inside / "scene.json").write_text(json.dumps(content))
        if good:
            assert read_manifest(inside).view("a").color.pattern == f"{name}/%04d.png"
        else:
            with pytest.raises(SceneError, match="view 'a': color: leads out of"):
                read_manifest(inside)


SCRAP = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=6),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=4), inner),
    max_leaves=6,
)


@given(st.sampled_from([path for path, _, _ in BAD]), SCRAP)
def test_any_value_anywhere_is_read_or_is_a_scene_error(path, value):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "scene.json"
        file.write_text(json.dumps(changed(path, value)))
        said = "read"
        try:
            assert len(read_manifest(file).views) >= 2
        except SceneError as error:
            said = str(error)
    assert said == "read" or said.startswith(str(file))


def test_a_manifest_that_is_a_link_stands_where_the_link_is(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "here").mkdir()
    (tmp_path / "elsewhere/scene.json").write_text(json.dumps(manifest()))
    (tmp_path / "here/scene.json").symlink_to("../elsewhere/scene.json")
    assert read_manifest(tmp_path / "here").root == (tmp_path / "here").resolve()
