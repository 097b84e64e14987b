"""A scene on disk, and its twin in memory, as sources of frames."""

from __future__ import annotations

import json
import os
import threading
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import cv2
import numpy as np
import pytest

from pipeline.colour import to_grey, to_rgb
from pipeline.errors import ConfigurationError, SceneError
from pipeline.media.source import MemorySource, open_scene
from tests.support.waiting import PATIENCE


def edit(folder, change) -> None:
    content = json.loads((folder / "scene.json").read_text())
    change(content)
    (folder / "scene.json").write_text(json.dumps(content))


@pytest.fixture(params=["disk", "memory"])
def source(request, write_scene):
    """Frames 5, 6 and 7 of two views of 18×26 (rows × columns), from either kind of source."""
    opened = open_scene(write_scene(first=5))
    if request.param == "disk":
        return opened
    return MemorySource(list(opened.frames()), fps=Fraction(15))


def test_sources_agree_on_what_they_hold(source):
    with source:
        info = source.info
        assert info.view_ids == info.all_view_ids == ("v0", "v1")
        assert info.lr_shape == (18, 26)
        assert info.frame_indices == range(5, 8)
        assert info.num_frames == 3
        assert info.fps == Fraction(15)
        assert (info.left, info.right) == ("v0", "v1")
        assert (info.bit_depth, info.is_color, info.has_depth) == (8, True, (True, True))
        assert info.depth_kind == "disparity"
        assert not info.depth_is_metric
        assert not info.has_calibration
        assert info.pixel_aspect == 1


def test_frames_are_the_same_in_any_order(source):
    in_order = {frame.frame_index: frame for frame in source.frames()}
    assert list(in_order) == [5, 6, 7]
    assert [frame.frame_index for frame in source.frames(6, 8)] == [6, 7]
    assert [frame.frame_index for frame in source.frames(stop=6)] == [5]
    for index in (7, 5, 6, 6):
        for view, expected in zip(source.read(index).views, in_order[index].views, strict=True):
            np.testing.assert_array_equal(view.luma, expected.luma)
            np.testing.assert_array_equal(view.depth_map, expected.depth_map)
            assert not view.luma.flags.writeable


@pytest.mark.parametrize("index", [-1, 0, 4, 8])
def test_a_frame_that_is_not_there_is_named(source, index):
    with pytest.raises(SceneError, match=f"frame {index}: no such frame; there are 5 to 7"):
        source.read(index)


def test_pictures_come_back_bit_for_bit(write_scene):
    for channels in (1, 3):
        for dtype, bits in ((np.uint8, 8), (np.uint16, 16)):
            folder = write_scene(channels=channels, dtype=dtype, frames=2)
            with open_scene(folder) as source:
                assert source.info.bit_depth == bits
                assert source.info.is_color == (channels == 3)
                view = source.read(1).view("v1")
            stored = cv2.imread(str(folder / "v1/color-001.png"), cv2.IMREAD_UNCHANGED)
            if channels == 3:
                back = to_rgb(view.luma, view.chroma, bits)[..., ::-1]
            else:
                back = to_grey(view.luma, bits)
            np.testing.assert_array_equal(back, stored)


def test_depth_is_on_the_colour_grid_in_nearness(write_scene):
    folder = write_scene(frames=1)
    depth = np.full((6, 13), 40, np.uint8)
    depth[:, 7:] = 0
    cv2.imwrite(str(folder / "v0/depth-000.png"), np.repeat(depth[..., None], 3, 2))
    depth_map = open_scene(folder).read(0).view("v0").depth_map
    assert depth_map.shape == (18, 26)
    np.testing.assert_array_equal(depth_map[:, :14], 10.0)
    assert np.isnan(depth_map[:, 14:]).all()


@pytest.mark.parametrize("shape", [(3, 5), (1, 9), (9, 1), (1, 1)])
@pytest.mark.parametrize("depth", [True, False])
def test_tiny_pictures_are_read(write_scene, shape, depth):
    frame = open_scene(write_scene(shape=shape, depth=depth, views=3)).read(1)
    for view in frame.views:
        assert view.luma.shape == view.depth_map.shape == shape
        assert view.depth_is_estimated == (not depth)
        assert np.isnan(view.depth_map).all() == (not depth)


# errors


def test_a_missing_file_names_file_view_and_frame(write_scene):
    folder = write_scene(first=5, frame_count=3)
    (folder / "v1/depth-006.png").unlink()
    with pytest.raises(
        SceneError, match=r"view 'v1', frame 6: .*v1/depth-006\.png: the file is missing; frame_co"
    ):
        open_scene(folder)


def test_unequal_numbers_of_frames_are_named(write_scene):
    folder = write_scene(first=5)
    (folder / "v1/color-007.png").unlink()
    with pytest.raises(
        SceneError, match=r"view 'v1', frame 7: .*color-007\.png: .*others .* go on to frame 7"
    ):
        open_scene(folder)


def test_more_frames_promised_than_there_are(write_scene):
    with pytest.raises(SceneError, match=r"view 'v0', frame 3: .*frame_count is 4"):
        open_scene(write_scene(frame_count=4))


def test_fewer_frames_asked_than_there_are(write_scene):
    assert open_scene(write_scene(frame_count=2)).info.frame_indices == range(2)


def test_no_frame_at_all(write_scene):
    with pytest.raises(SceneError, match=r"view 'v0', frame 9: .*color-009\.png: the file is mis"):
        open_scene(write_scene(first_frame=9))


def test_one_image_beside_a_sequence(write_scene):
    folder = write_scene()
    edit(folder, lambda scene: scene["views"][1].update(depth="v1/depth-000.png"))
    with pytest.raises(SceneError, match=r"view 'v1', frame 1: .*one image, and so one frame"):
        open_scene(folder)


def test_unequal_sizes_are_named_when_opened_and_when_read(write_scene):
    folder = write_scene()
    cv2.imwrite(str(folder / "v1/color-002.png"), np.zeros((18, 25, 3), np.uint8))
    with (
        open_scene(folder) as source,
        pytest.raises(SceneError, match=r"view 'v1', frame 2: v1/color-002\.png: 25×18 .* 26×18"),
    ):
        source.read(2)
    cv2.imwrite(str(folder / "v1/color-000.png"), np.zeros((17, 26, 3), np.uint8))
    with pytest.raises(SceneError, match=r"v1/color-000\.png, view 'v1', frame 0: 26×17 pixels"):
        open_scene(folder)


def test_a_truncated_png_is_named(write_scene):
    folder = write_scene()
    path = folder / "v1/color-001.png"
    path.write_bytes(path.read_bytes()[:-20])
    with open_scene(folder) as source:
        source.read(0)
        with pytest.raises(
            SceneError, match=r"view 'v1', frame 1: .*v1/color-001\.png: truncated PNG"
        ):
            source.read(1)


def test_nan_in_float_depth_is_named(write_scene):
    folder = write_scene(frames=1)
    edit(folder, lambda scene: scene["views"][0].update(depth="v0.pfm"))
    depth = np.ones((18, 26), "<f4")
    depth[3, 4] = np.nan
    (folder / "v0.pfm").write_bytes(b"Pf\n26 18\n-1\n" + depth[::-1].tobytes())
    with (
        open_scene(folder) as source,
        pytest.raises(
            SceneError, match=r"view 'v0', frame 0: .*v0\.pfm: NaN in .* row 3, column 4"
        ),
    ):
        source.read(0)


def test_depth_in_colours_and_colour_in_floats_are_refused(write_scene):
    folder = write_scene(frames=1)
    edit(folder, lambda scene: scene["views"][0].update(depth="v0/color-000.png"))
    with pytest.raises(SceneError, match=r"view 'v0', frame 0: .*a depth map in colour"):
        open_scene(folder).read(0)
    (folder / "v0.pfm").write_bytes(b"Pf\n26 18\n-1\n" + bytes(4 * 26 * 18))
    edit(folder, lambda scene: scene["views"][0].update(color="v0.pfm"))
    with pytest.raises(SceneError, match=r"v0\.pfm: a colour image of floating-point samples"):
        open_scene(folder).read(0)


def test_a_file_that_is_a_link_out_of_the_folder_is_refused(write_scene, tmp_path):
    folder = write_scene()
    (tmp_path / "other.png").write_bytes((folder / "v0/color-001.png").read_bytes())
    (folder / "v0/color-001.png").unlink()
    os.symlink(tmp_path / "other.png", folder / "v0/color-001.png")
    with pytest.raises(SceneError, match=r"view 'v0'.*leads out of the scene's folder"):
        open_scene(folder)


def test_colour_after_grey_is_refused_and_grey_after_colour_is_neutral(write_scene):
    folder = write_scene()
    grey = np.full((18, 26), 77, np.uint8)
    cv2.imwrite(str(folder / "v0/color-001.png"), grey)
    view = open_scene(folder).read(1).view("v0")
    np.testing.assert_array_equal(to_rgb(view.luma, view.chroma, 8), 77)
    for name in ("v0", "v1"):
        cv2.imwrite(str(folder / name / "color-000.png"), grey)
    with open_scene(folder) as source, pytest.raises(SceneError, match="scene began in grey"):
        source.read(2)


# choices


def test_views_are_limited_and_the_pair_stays(write_scene):
    folder = write_scene(views=5)
    with open_scene(folder, views=["v4", "v1"]) as source:
        assert source.info.view_ids == ("v1", "v4")
        assert source.info.all_view_ids == ("v0", "v1", "v2", "v3", "v4")
        assert (source.info.left, source.info.right) == ("v2", "v3")
        assert [view.view_id for view in source.read(0).views] == ["v1", "v4"]


def test_one_view_without_depth_stays_without(write_scene):
    frame = open_scene(write_scene(depth=False), views=["v0"]).read(0)
    assert frame.views[0].depth_map is None


def test_the_pair_can_be_chosen(write_scene):
    folder = write_scene(views=4)
    info = open_scene(folder, left="v0", right="v3").info
    assert (info.left, info.right) == ("v0", "v3")
    info = open_scene(folder, left="v2").info
    assert (info.left, info.right) == ("v2", "v3")
    info = open_scene(folder, right="v1").info
    assert (info.left, info.right) == ("v0", "v1")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"left": "x"}, "--left: no view 'x'; there are v0, v1, v2"),
        ({"right": "x"}, "--right: no view 'x'"),
        ({"left": "v2", "right": "v1"}, "--left: left 'v2' must stand left of right 'v1'"),
        ({"left": "v2"}, "--left: left 'v2' must stand left of right"),
        ({"right": "v0"}, "--right: left '.*' must stand left of right 'v0'"),
        ({"views": ["v0", "y"]}, "--views: no view 'y'"),
        ({"views": []}, "--views: name one view or more"),
        ({"views": ["v0", "v0"]}, "--views: 'v0' occurs twice"),
        ({"input_layout": "sbs"}, "--input-layout: only for a video file"),
        ({"input_layout": "3d"}, "--input-layout: '3d' is not one of sbs"),
    ],
)
def test_choices_that_are_none_are_configuration_errors(write_scene, options, said):
    with pytest.raises(ConfigurationError, match=said):
        open_scene(write_scene(views=3), **options)


# other kinds of files, and what is missing


def test_raw_video_is_a_view(write_scene):
    folder = write_scene(frames=2, channels=1)
    frames = np.random.default_rng(1).integers(0, 256, (2, 18, 26), dtype=np.uint8)
    (folder / "a.yuv").write_bytes(frames.tobytes())
    raw = {"yuv": "a.yuv", "width": 26, "height": 18, "pixel_format": "gray"}
    edit(
        folder,
        lambda scene: scene["views"][1].update(color={**raw, "range": "full"}, depth=raw),
    )
    view = open_scene(folder).read(1).view("v1")
    np.testing.assert_array_equal(to_grey(view.luma, 8), frames[1])
    np.testing.assert_allclose(view.depth_map, np.where(frames[1], frames[1] / 4, np.nan))
    edit(folder, lambda scene: scene.update(frame_count=3))
    for name in ("v0", "v1"):
        for kind in ("color", "depth"):
            data = (folder / name / f"{kind}-000.png").read_bytes()
            (folder / name / f"{kind}-002.png").write_bytes(data)
    with pytest.raises(SceneError, match=r"view 'v1', frame 2: .*a\.yuv: the file holds 2 frames"):
        open_scene(folder)


def test_a_view_whose_depth_is_all_unknown_is_estimated(write_scene, make_texture):
    folder = write_scene(frames=1, shape=(60, 90), channels=1)
    far = make_texture((60, 110), 7)
    for name, shift in (("v0", 0), ("v1", 8)):
        cv2.imwrite(str(folder / name / "color-000.png"), far[:, shift : shift + 90])
        cv2.imwrite(str(folder / name / "depth-000.png"), np.full((60, 90), 32, np.uint8))
    cv2.imwrite(str(folder / "v1/depth-000.png"), np.zeros((60, 90), np.uint8))
    frame = open_scene(folder).read(0)
    assert [view.depth_is_estimated for view in frame.views] == [False, True]
    assert np.nanmedian(frame.view("v1").depth_map) == pytest.approx(8.0, abs=0.3)


def test_a_source_knows_its_own_files_by_every_name(write_scene, tmp_path):
    folder = write_scene(frames=2)
    (tmp_path / "link.png").symlink_to(folder / "v1/depth-001.png")
    (folder / "other.png").write_bytes(b"not of the scene")
    with open_scene(folder, views=["v0"]) as source:
        for name in (
            "scene.json",
            "v0/color-000.png",
            "v1/color-001.png",
            "v0/../v1/depth-000.png",
        ):
            assert source.reads(folder / name)
        assert source.reads(tmp_path / "link.png")
        assert not source.reads(folder / "other.png")
        assert not source.reads(folder / "v0/color-002.png")


def test_calibration_makes_depth_metric_unless_it_is_disparity(write_scene):
    def calibrate(scene):
        for place, view in enumerate(scene["views"]):
            motion = np.eye(4)
            motion[0, 3] = -place
            view["intrinsics"] = [[30, 0, 12], [0, 30, 8], [0, 0, 1]]
            view["world_to_camera"] = motion.tolist()

    folder = write_scene(frames=1)
    edit(folder, calibrate)
    assert not open_scene(folder).info.depth_is_metric
    edit(folder, lambda scene: scene["depth"].update(kind="inverse_depth"))
    source = open_scene(folder)
    assert source.info.depth_is_metric
    assert source.info.has_calibration
    assert source.read(0).depth_is_metric
    edit(folder, lambda scene: [scene["views"][0].pop(key) for key in
                                ("intrinsics", "world_to_camera")])  # fmt: skip
    info = open_scene(folder).info
    assert not info.depth_is_metric
    assert "no calibration in: v0" in info.warnings[0]


def test_an_untold_rate_is_assumed_and_said(write_scene):
    info = open_scene(write_scene(fps=...)).info
    assert info.fps == 25
    assert any("fps is not said" in warning for warning in info.warnings)
    assert open_scene(write_scene(frames=1)).info.fps == 1


def test_several_threads_may_read(write_scene):
    with open_scene(write_scene(frames=3)) as source:
        expected = [frame.views[0].luma for frame in source.frames()]
        barrier = threading.Barrier(3)

        def read(index: int) -> np.ndarray:
            barrier.wait(PATIENCE)
            return source.read(index).views[0].luma

        with ThreadPoolExecutor(3) as pool:
            for luma, wanted in zip(pool.map(read, range(3)), expected, strict=True):
                np.testing.assert_array_equal(luma, wanted)


def test_memory_frames_must_be_alike(write_scene):
    frames = list(open_scene(write_scene()).frames())
    with pytest.raises(SceneError, match="frame numbers must follow one another"):
        MemorySource(frames[::2])
    with pytest.raises(SceneError, match="no frames"):
        MemorySource([])


# the real scenes


REAL = {
    "cones": (2, (375, 450), True, 1),
    "art": (2, (370, 463), True, 1),
    "flower": (8, (756, 1008), True, 1),
    "kitti": (2, (376, 1241), False, 8),
    "lytro_2067": (9, (383, 552), True, 1),
}


@pytest.mark.parametrize("name", REAL)
def test_real_scenes_are_understood(scenes_dir, name):
    num_views, shape, is_color, num_frames = REAL[name]
    with open_scene(scenes_dir / name) as source:
        info = source.info
        frame = source.read(info.frame_indices[-1])
    assert (len(info.view_ids), info.lr_shape) == (num_views, shape)
    assert (info.is_color, info.num_frames, info.bit_depth) == (is_color, num_frames, 8)
    assert info.warnings == ()
    for view in frame.views:
        known = view.depth_map[np.isfinite(view.depth_map)]
        assert known.size > 0.6 * view.depth_map.size
        assert np.ptp(known) > 0
        assert view.luma.std() > 5
    assert info.depth_is_metric == (name == "flower")


def test_some_views_only_are_read_without_depth(source):
    with source:
        for index, only in ((5, None), (6, ("v1",)), (7, ("v0", "v1")), (5, ("v0",))):
            frame, whole = source.read(index, only=only), source.read(index)
            names = only or ("v0", "v1")
            assert tuple(view.view_id for view in frame.views) == names
            for name in names:
                np.testing.assert_array_equal(frame.view(name).luma, whole.view(name).luma)
                assert (frame.view(name).depth_map is None) == (only is not None)
        frame, whole = source.read(5, colour=("v1",)), source.read(5)
        assert [view.chroma is not None for view in whole.views] == [True, True]
        assert [view.chroma is not None for view in frame.views] == [False, True]
        for view, expected in zip(frame.views, whole.views, strict=True):
            np.testing.assert_array_equal(view.luma, expected.luma)
