"""Folders and videos without a manifest."""

from __future__ import annotations

import shutil
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from pipeline.colour import to_rgb
from pipeline.errors import SceneError
from pipeline.media.layouts import LEAST_MANIFEST, describe_path
from pipeline.media.source import open_scene
from service.client import scene_files

HEIGHT, WIDTH = 24, 36

# MSR 3D video: cameras 0 to 3 on an arc, numbered from right to left, y up, rows from the bottom

MSR_INTRINSICS = np.array([[45.0, 0.3, 17.0], [0, 46.0, 9.0], [0, 0, 1]])


def msr_motion(camera: int) -> np.ndarray:
    """Return MSR's 3×4 [R | t]: centre at x = −4 · camera, turned inwards."""
    angle = np.deg2rad(-3.0 * camera)
    rotation = np.array(
        [
            [np.cos(angle), 0.02, -np.sin(angle)],
            [-0.02, 1, 0],
            [np.sin(angle), 0, np.cos(angle)],
        ]
    )
    left, _, right = np.linalg.svd(rotation)
    rotation = left @ right
    centre = np.array([-4.0 * camera, 0.3 * camera, 0.5 * camera])
    return np.column_stack([rotation, -rotation @ centre])


def write_msr(folder: Path, *, frames=(0, 1, 2), cameras=4, calibration=True) -> Path:
    folder.mkdir(parents=True)
    for camera in range(cameras):
        (folder / f"cam{camera}").mkdir()
        for frame in frames:
            level = 40 * camera + 5 * frame
            name = f"cam{camera}/%s-cam{camera}-f{frame:03d}"
            color = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
            cv2.imwrite(str(folder / (name % "color" + ".jpg")), color)
            depth = np.full((HEIGHT, WIDTH, 3), 0, np.uint8)
            depth[:, WIDTH // 2 :] = 255
            cv2.imwrite(str(folder / (name % "depth" + ".png")), depth)
    if calibration:
        text = ""
        for camera in range(cameras):
            rows = [*MSR_INTRINSICS, [0.0], [0.0], *msr_motion(camera)]
            text += f"{camera}\n"
            text += "\n".join("\t".join(f"{value:.6f}" for value in row) for row in rows)
            text += "\n\n"
        (folder / "calibParams-breakdancers.txt").write_text(text)
    return folder


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


# Middlebury


def write_stills(folder: Path, files: dict[str, np.ndarray]) -> Path:
    folder.mkdir()
    for name, samples in files.items():
        assert cv2.imwrite(str(folder / name), samples)
    return folder


def color(width: int, height: int = 18) -> np.ndarray:
    return np.random.default_rng(width).integers(0, 256, (height, width, 3), dtype=np.uint8)


def disparity(width: int, value: int, height: int = 18) -> np.ndarray:
    stored = np.full((height, width), value, np.uint8)
    stored[:, 0] = 0
    return stored


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


def write_pfm(path: Path, samples: np.ndarray) -> None:
    head = f"Pf\n{samples.shape[1]} {samples.shape[0]}\n-0.003922\n".encode()
    path.write_bytes(head + samples[::-1].astype("<f4").tobytes())


CALIB = """cam0=[90.5 0 20.25; 0 90.5 9.5; 0 0 1]
cam1=[90.5 0 26.5; 0 90.5 9.5; 0 0 1]
doffs=6.25
baseline=160
width=44
height=18
ndisp=40
"""


@pytest.fixture
def middlebury_2014(tmp_path) -> Path:
    folder = write_stills(tmp_path / "Adirondack", {"im0.png": color(44), "im1.png": color(44)})
    (folder / "calib.txt").write_text(CALIB)
    disparities = np.linspace(3, 30, 18 * 44).reshape(18, 44)
    disparities[2, 3] = np.inf
    write_pfm(folder / "disp0.pfm", disparities)
    write_pfm(folder / "disp1.pfm", disparities)
    return folder


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
    (middlebury_2014 / "calib.txt").write_text(CALIB.replace(old, new))
    with pytest.raises(SceneError, match=rf"calib\.txt: {said}"):
        describe_path(middlebury_2014)


def test_a_calibration_of_another_size_is_not_used(middlebury_2014):
    (middlebury_2014 / "calib.txt").write_text(CALIB.replace("width=44", "width=2880"))
    info = open_scene(middlebury_2014).info
    assert not info.has_calibration
    assert "another image size" in info.warnings[0]


# stereo video files


def write_stereo(path: Path, size: tuple[int, int], *, split: str = "x", **settings) -> Path:
    """Write two frames whose left or upper half is reddish, the other one blueish."""
    height, width = size
    with av.open(str(path), "w") as output:
        stream = output.add_stream(settings.pop("codec", "libx264"), rate=Fraction(24))
        stream.height, stream.width, stream.pix_fmt = height, width, "yuv444p"
        if "aspect" in settings:
            stream.codec_context.sample_aspect_ratio = settings["aspect"]
        stream.options = settings.get("options", {})
        stream.metadata.update(settings.get("metadata", {}))
        for _ in range(2):
            rgb = np.full((height, width, 3), (200, 60, 40), np.uint8)
            if split == "x":
                rgb[:, width // 2 :] = (40, 60, 200)
            else:
                rgb[height // 2 :] = (40, 60, 200)
            output.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, "rgb24")))
        output.mux(stream.encode())
    return path


def halves(source) -> list[str]:
    """Return which colour the left and the right view have."""
    names = []
    for view in source.read(1).views:
        red, _, blue = to_rgb(view.luma, view.chroma, 8).reshape(-1, 3).mean(axis=0)
        names.append("red" if red > blue + 60 else "blue" if blue > red + 60 else "mixed")
    return names


@pytest.mark.parametrize(
    ("layout", "size", "split", "eye", "aspect"),
    [
        ("sbs", (24, 80), "x", (24, 40), 1),
        ("half-sbs", (24, 40), "x", (24, 20), 2),
        ("tab", (48, 40), "y", (24, 40), 1),
        ("half-tab", (24, 40), "y", (12, 40), Fraction(1, 2)),
    ],
)
def test_an_untold_video_is_read_as_it_is_told(tmp_path, layout, size, split, eye, aspect):
    path = write_stereo(tmp_path / "clip.mkv", size, split=split)
    said = r"clip\.mkv: does not say .*: the input layout must \(--input-layout: sbs, half-sbs"
    with pytest.raises(SceneError, match=said):
        open_scene(path)
    with open_scene(path, input_layout=layout) as source:
        info = source.info
        assert info.layout == "stereo-video"
        assert (info.input_layout, info.pixel_aspect) == (layout, aspect)
        assert info.lr_shape == eye
        assert info.view_ids == (info.left, info.right) == ("left", "right")
        assert info.frame_indices == range(2)
        assert info.has_depth == (False, False)
        assert halves(source) == ["red", "blue"]


@pytest.mark.parametrize(
    ("name", "size", "settings", "layout", "order"),
    [
        ("a.mkv", (24, 80), {"metadata": {"stereo_mode": "left_right"}}, "sbs", "red blue"),
        ("a.mkv", (24, 80), {"metadata": {"stereo_mode": "right_left"}}, "sbs", "blue red"),
        ("a.mp4", (24, 80), {"options": {"x264-params": "frame-packing=3"}}, "sbs", "red blue"),
        ("a.mp4", (24, 40), {"options": {"x264-params": "frame-packing=3"}}, "half-sbs",
         "red blue"),
        ("a.mp4", (24, 64), {"options": {"x264-params": "frame-packing=3"}, "aspect": 2},
         "half-sbs", "red blue"),
        ("a_3D_HSBS_LR.mp4", (24, 64), {}, "half-sbs", "red blue"),
        ("a_3D_SBS_LR.mp4", (24, 64), {}, "sbs", "red blue"),
        ("a.half-sbs.mp4", (24, 64), {}, "half-sbs", "red blue"),
        ("a.3d.lr.mp4", (24, 64), {}, "sbs", "red blue"),
        ("Side by side.mp4", (24, 64), {}, "sbs", "red blue"),
    ],
)  # fmt: skip
def test_tags_and_names_tell_side_by_side(tmp_path, name, size, settings, layout, order):
    path = write_stereo(tmp_path / name, size, **settings)
    with open_scene(path) as source:
        assert source.info.input_layout == layout
        assert f"read as {layout}: sbs by the" in source.info.warnings[0]
        assert "if that is wrong, give the input layout" in source.info.warnings[0]
        assert halves(source) == order.split()


@pytest.mark.parametrize(
    ("name", "size", "layout"),
    [("a.3D.TAB.mkv", (48, 40), "tab"), ("a_3d_HTAB.mkv", (24, 40), "half-tab"),
     ("a_3D_OU.mkv", (24, 40), "half-tab")],
)  # fmt: skip
def test_names_tell_top_bottom(tmp_path, name, size, layout):
    with open_scene(write_stereo(tmp_path / name, size, split="y")) as source:
        assert source.info.input_layout == layout
        assert halves(source) == ["red", "blue"]


@pytest.mark.parametrize(
    ("layout", "size", "eye"),
    [
        ("sbs", (9, 31), (9, 16)), ("half-sbs", (9, 31), (9, 16)),
        ("tab", (31, 9), (16, 9)), ("half-tab", (31, 9), (16, 9)),
        ("sbs", (9, 32), (9, 16)), ("tab", (32, 9), (16, 9)),
    ],
)  # fmt: skip
def test_of_an_odd_number_of_lines_none_is_lost_and_the_last_is_repeated(
    tmp_path, layout, size, eye
):
    """As many as an encoder that cuts the last one off leaves of two eyes."""
    picture = np.random.default_rng(2).integers(0, 256, (*size, 3), np.uint8)
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("ffv1", rate=Fraction(24))
        stream.height, stream.width, stream.pix_fmt = *size, "bgr0"
        output.mux(
            stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="bgr0"))
        )
        output.mux(stream.encode())
    with open_scene(path, input_layout=layout) as source:
        assert source.info.lr_shape == eye
        seen = [to_rgb(view.luma, view.chroma, 8) for view in source.read(0).views]
        is_said = any("the last one is repeated" in note for note in source.info.warnings)
    axis = 1 if "sbs" in layout else 0
    whole = np.concatenate(seen, axis=axis)
    expected = np.pad(
        picture,
        [(0, large - small) for large, small in zip(whole.shape, picture.shape, strict=True)],
        mode="edge",
    )
    assert np.abs(whole.astype(int) - expected).max() <= 1
    assert is_said == (size[axis] % 2 == 1)


# nothing that is known


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


def write_spatial(path: Path, *boxes: bytes) -> Path:
    """Write video of HEVC, with more boxes in the entry of its track; its index stands last."""
    with av.open(str(path), "w", format="mov") as output:
        options = {"x265-params": "log-level=none:bframes=0"}
        stream = output.add_stream("libx265", rate=Fraction(24), options=options)
        stream.height, stream.width, stream.pix_fmt = 48, 64, "yuv420p"
        stream.codec_context.codec_tag = "hvc1"
        for number in range(2):
            grey = np.full((72, 64), 128, np.uint8)
            frame = av.VideoFrame.from_ndarray(grey, "yuv420p")
            frame.pts = number
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    data = bytearray(path.read_bytes())
    added = b"".join(boxes)
    at = data.rindex(b"moov")
    for kind in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"hvc1"):
        at = data.index(kind, at)
        size = int.from_bytes(data[at - 4 : at], "big")
        data[at - 4 : at] = (size + len(added)).to_bytes(4, "big")
    data[at - 4 + size : at - 4 + size] = added
    path.write_bytes(data)
    return path


def box(kind: bytes, *content: bytes) -> bytes:
    inside = b"".join(content)
    return (8 + len(inside)).to_bytes(4, "big") + kind + inside


SECOND_LAYER = box(
    b"lhvC", bytes([1, 0xF0, 0, 0xFC, 0xCF, 1]),  # as of ISO/IEC 14496-15, with one array
    bytes([0xA7, 0, 1, 0, 6, 0x4E, 0x09, 5, 1, 0, 0x80]),  # of one message (SEI) of layer 1
)  # fmt: skip
BOTH_EYES = box(
    b"vexu",
    box(
        b"eyes", box(b"stri", bytes([0, 0, 0, 0, 3])), box(b"hero", bytes([0, 0, 0, 0, 1])),
        box(b"cams", box(b"blin", bytes([0, 0, 0, 0, 0, 0, 0x4B, 0x28]))),
    ),
)  # fmt: skip
"""What a phone writes: both views are there, the left one first, 19.24 mm apart."""


def test_eyes_in_layers_of_hevc_are_not_read_as_one_view(tmp_path):
    """Boxes as spatial video has them, made by hand: no encoder that can be had writes any."""
    film = write_spatial(tmp_path / "take 3.mov", SECOND_LAYER, BOTH_EYES)
    for layout in (None, "sbs"):
        with pytest.raises(SceneError) as told:
            describe_path(film, layout)
        assert "MV-HEVC" in str(told.value)
        assert "vpos:left -c:v ffv1 'take 3_left.mkv'" in str(told.value)
    film.rename(tmp_path / "clip_left.mov")
    write_spatial(tmp_path / "clip_right.mov")
    with open_scene(tmp_path) as source:
        assert any("MV-HEVC): left; " in text for text in source.info.warnings)


@pytest.mark.parametrize("boxes", [(), (SECOND_LAYER,), (BOTH_EYES,)])
def test_one_layer_or_an_alpha_channel_is_no_spatial_video(tmp_path, boxes):
    film = write_spatial(tmp_path / "clip_SBS.mov", *boxes)
    assert describe_path(film).layout == "stereo-video"


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


@pytest.mark.parametrize(
    ("times", "is_uneven"),
    [([0, 42, 83, 125, 167], False), ([0, 42, 83, 125, 208, 250], True), ([0], False)],
)
def test_frames_at_uneven_times_are_said(tmp_path, times, is_uneven):
    """They are paired by number, and the result shows as many a second as the file says."""
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("ffv1", rate=Fraction(24))
        stream.height, stream.width, stream.pix_fmt = 8, 16, "gray"
        stream.codec_context.time_base = Fraction(1, 1000)
        for time in times:
            frame = av.VideoFrame.from_ndarray(np.full((8, 16), 9, np.uint8), "gray")
            frame.pts, frame.time_base = time, Fraction(1, 1000)
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    with open_scene(path, input_layout="sbs") as source:
        said = [note for note in source.info.warnings if "unequal times in: left, right" in note]
        assert bool(said) == is_uneven
