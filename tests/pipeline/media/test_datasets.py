"""Folders of MSR 3D video and Middlebury."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.media.layouts import describe_path
from pipeline.media.source import open_scene
from tests.support.datasets import (
    HEIGHT,
    MIDDLEBURY_CALIBRATION,
    MSR_INTRINSICS,
    color,
    disparity,
    msr_motion,
    write_msr,
    write_stills,
)


def test_msr_views_are_put_left_to_right(tmp_path):
    with open_scene(write_msr(tmp_path / "MSR3DVideo-Breakdancers")) as source:
        info = source.info
        assert info.layout == "msr-3d-video"
        assert info.view_ids == ("cam3", "cam2", "cam1", "cam0")
        assert (info.left, info.right) == ("cam2", "cam1")
        assert info.frame_indices == range(3)
        assert info.fps == 15
        assert info.has_calibration
        assert info.depth_is_metric
        assert info.warnings == ()
        frame = source.read(1)
    centres = [view.calibration.centre[0] for view in frame.views]
    np.testing.assert_allclose(centres, [-12, -8, -4, 0], atol=1e-4)
    assert frame.view("cam2").luma.mean() == pytest.approx(85, abs=2)


def test_msr_calibration_sees_points_where_msr_s_own_formula_does(tmp_path):
    frame = open_scene(write_msr(tmp_path / "Breakdancers")).read(0)
    points = np.array([[1.0, 2.0, 60.0], [-15.0, -6.0, 80.0], [4.0, 8.0, 110.0]])
    for camera in range(4):
        seen = MSR_INTRINSICS @ msr_motion(camera) @ np.column_stack([points, np.ones(3)]).T
        expected = np.stack([seen[0] / seen[2], HEIGHT - 1 - seen[1] / seen[2]])
        mirrored = np.column_stack([points * [1, -1, 1], np.ones(3)]).T
        ours = frame.view(f"cam{camera}").calibration.projection @ mirrored
        np.testing.assert_allclose(ours[:2] / ours[2], expected, atol=1e-3)


def test_msr_depth_runs_along_the_world_s_axis(tmp_path):
    frame = open_scene(write_msr(tmp_path / "Breakdancers")).read(0)
    for view in frame.views:
        camera = view.calibration
        for column, world_z in ((3, 120.0), (30, 44.0)):
            depth = 1 / view.depth_map[7, column]
            ray = np.linalg.inv(camera.intrinsics) @ [column, 7, 1]
            rotation, shift = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
            world = rotation.T @ (depth * ray - shift)
            assert world[2] == pytest.approx(world_z, rel=1e-4)


def test_msr_without_calibration_runs_right_to_left_by_number(tmp_path):
    info = open_scene(write_msr(tmp_path / "MSR3DVideo-Ballet", calibration=False)).info
    assert info.view_ids == ("cam3", "cam2", "cam1", "cam0")
    assert not info.depth_is_metric
    assert "from right to left" in info.warnings[0]


def test_msr_of_another_name_has_relative_depth(tmp_path):
    source = open_scene(write_msr(tmp_path / "dinner", calibration=False))
    assert source.info.depth_kind == "disparity"
    assert "neither Breakdancers nor Ballet" in source.info.warnings[1]
    np.testing.assert_allclose(source.read(0).views[0].depth_map[0, [0, -1]], [0, 1])


def test_a_gap_in_an_msr_scene_is_named(tmp_path):
    folder = write_msr(tmp_path / "Ballet", frames=(7, 8, 9, 10))
    (folder / "cam1/color-cam1-f009.jpg").unlink()
    with pytest.raises(SceneError, match=r"view 'cam1', frame 9: .*color-cam1-f009\.jpg"):
        open_scene(folder)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda text: text.replace("9.000000", "nine"), "not a calibration of numbers"),
        (lambda text: text + "4\n1 2 3\n", "which is not 24 for each camera"),
        (lambda text: "\n\n".join(text.split("\n\n")[:3]), "has no camera 3"),
        (lambda text: text.replace("9.000000", "nan"), "which is not 24 for each camera"),
    ],
)
def test_a_spoilt_msr_calibration_is_an_error(tmp_path, spoil, said):
    folder = write_msr(tmp_path / "Breakdancers")
    path = folder / "calibParams-breakdancers.txt"
    path.write_text(spoil(path.read_text()))
    with pytest.raises(SceneError, match=said):
        describe_path(folder)


MIDDLEBURY = {
    "2001": ("im", ".ppm", ".pgm", 43, range(9), (2, 6), 96, 12.0, False),
    "2003 quarter": ("im", ".png", ".png", 450, (2, 6), (2, 6), 100, 25.0, True),
    "2003 half": ("im", ".png", ".png", 900, (2, 6), (2, 6), 100, 50.0, True),
    "2005 third": ("view", ".png", ".png", 463, range(7), (1, 5), 120, 40.0, True),
    "2006 half": ("view", ".png", ".png", 640, (1, 5), (1, 5), 120, 60.0, True),
    "2006 full": ("view", ".png", ".png", 1300, (1, 5), (1, 5), 120, 120.0, True),
}


@pytest.mark.parametrize("year", MIDDLEBURY)
def test_middlebury_scenes_have_their_scale(tmp_path, year):
    prefix, color_kind, depth_kind, width, views, known, stored, expected, unknown = MIDDLEBURY[
        year
    ]
    files = {f"{prefix}{view}{color_kind}": color(width) for view in views}
    files |= {f"disp{view}{depth_kind}": disparity(width, stored) for view in known}
    with open_scene(write_stills(tmp_path / "teddy", files), views=None) as source:
        info = source.info
        assert info.layout.startswith(f"middlebury-{year[:4].replace('2006', '2005')}")
        assert info.view_ids == tuple(f"{prefix}{view}" for view in views)
        assert (info.left, info.right) == tuple(f"{prefix}{view}" for view in known)
        assert info.has_depth == tuple(view in known for view in views)
        assert "taken for the 20" in info.warnings[0]
    with open_scene(tmp_path / "teddy", views=[f"{prefix}{view}" for view in known]) as source:
        depth_map = source.read(0).views[0].depth_map
    assert depth_map[5, 7] == pytest.approx(expected)
    assert np.isnan(depth_map[5, 0]) == unknown


def test_middlebury_2014_is_metric_and_its_cameras_agree_with_its_disparity(middlebury_2014):
    with open_scene(middlebury_2014) as source:
        assert source.info.layout == "middlebury-2014"
        assert source.info.depth_is_metric
        assert (source.info.left, source.info.right) == ("im0", "im1")
        left, right = source.read(0).views
    assert np.isnan(left.depth_map[2, 3])
    assert np.isnan(left.depth_map).sum() == 1
    stored = np.linspace(3, 30, 18 * 44).reshape(18, 44)[10, 31]
    depth = 1 / left.depth_map[10, 31]
    assert depth == pytest.approx(160 * 90.5 / (stored + 6.25), rel=1e-5)
    point = np.append(depth * (np.linalg.inv(left.calibration.intrinsics) @ [31, 10, 1]), 1)
    seen = right.calibration.projection @ point
    np.testing.assert_allclose(seen[:2] / seen[2], [31 - stored, 10], atol=1e-4)


def test_middlebury_2014_without_a_second_map_or_calibration(middlebury_2014):
    (middlebury_2014 / "disp1.pfm").unlink()
    assert open_scene(middlebury_2014).info.has_depth == (True, False)
    (middlebury_2014 / "calib.txt").unlink()
    info = open_scene(middlebury_2014).info
    assert (info.depth_kind, info.depth_is_metric) == ("disparity", False)
    assert "no calib.txt" in info.warnings[0]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("cam1=", "kam1=", "not a Middlebury calibration"),
        ("90.5 0 20.25", "90.5 x 20.25", "not a Middlebury calibration"),
        ("baseline=160", "baseline=0", "focal length or baseline out of"),
    ],
)
def test_a_spoilt_middlebury_calibration_is_an_error(middlebury_2014, old, new, said):
    (middlebury_2014 / "calib.txt").write_text(MIDDLEBURY_CALIBRATION.replace(old, new))
    with pytest.raises(SceneError, match=rf"calib\.txt: {said}"):
        describe_path(middlebury_2014)


def test_a_calibration_of_another_size_is_not_used(middlebury_2014):
    (middlebury_2014 / "calib.txt").write_text(
        MIDDLEBURY_CALIBRATION.replace("width=44", "width=2880")
    )
    info = open_scene(middlebury_2014).info
    assert not info.has_calibration
    assert "another image size" in info.warnings[0]
