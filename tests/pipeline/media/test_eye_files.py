"""A file for each eye: known by the names, and by nothing else."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
from fractions import Fraction

import av
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.errors import OutputError, SceneError
from pipeline.export import Master, export
from pipeline.fingerprint import scene_files as files_of_job
from pipeline.job import FrameRange, InputOptions, Job, OutputOptions
from pipeline.media.decode import VideoReader
from pipeline.media.encode import write_segment
from pipeline.media.eye_files import eyes_beside, eyes_in
from pipeline.media.join import join_segments
from pipeline.media.layouts import describe_path
from pipeline.media.png import write_png
from pipeline.media.source import open_scene
from pipeline.media.timecode import later
from pipeline.media.video_format import Container, VideoCodec, VideoFormat
from pipeline.run import run_job
from pipeline.stereo import StereoLayout
from service.client import scene_files, scene_name
from tests.support.needed import program

SHAPE = (24, 36)


def texture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (*SHAPE, 3), np.uint8)


def write_video(path, seed, layout=StereoLayout.LEFT):
    kind = VideoFormat(
        container=Container.MKV, codec=VideoCodec.FFV1, layout=layout, fps=Fraction(24)
    )  # fmt: skip
    eyes = (texture(seed),) if layout is StereoLayout.LEFT else (texture(seed), texture(seed + 1))
    segment = path.with_name(".segment.mkv")
    write_segment(segment, kind, [eyes] * 2, first_frame=0)
    join_segments([segment], path, kind)
    segment.unlink()
    return path


def shown(scene):
    """The frame numbers, and the red of both eyes' first pixels in the first frame."""
    with open_scene(scene) as source:
        indices = source.info.frame_indices
        frame = source.read(indices.start)
        assert (frame.left, frame.right) == ("left", "right")
        lumas = [frame.view(eye).luma for eye in ("left", "right")]
        return list(indices), lumas


def is_luma_of(luma, picture) -> bool:
    expected = picture.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    return bool(np.abs(luma - expected).max() < 0.01)


@pytest.mark.parametrize(
    ("left", "right", "name"),
    [
        ("clip_left.mkv", "clip_right.mkv", "clip"), ("Shot 3_L.mkv", "Shot 3_R.mkv", "Shot 3"),
        ("RIGHT.mkv", "LEFT.mkv", ""), ("l-eye.mkv", "r-eye.mkv", "eye"),
        ("100% Left.mkv", "100% Right.mkv", "100"), ("für l.mkv", "für r.mkv", "für"),
    ],
)  # fmt: skip
def test_two_videos(tmp_path, left, right, name):
    if left == "RIGHT.mkv":
        left, right = right, left
    write_video(tmp_path / left, 1)
    write_video(tmp_path / right, 2)
    for scene in (tmp_path, tmp_path / left, tmp_path / right):
        indices, lumas = shown(scene)
        assert indices == [0, 1]
        assert is_luma_of(lumas[0], texture(1))
        assert is_luma_of(lumas[1], texture(2))
        assert set(scene_files(scene)) == {left, right}
    for scene in (tmp_path / left, tmp_path / right):
        assert scene_name(scene) == (name or tmp_path.name)


@pytest.mark.parametrize(
    ("left", "right", "first"),
    [
        ("left-{:04d}.png", "right-{:04d}.png", 7), ("L/shot_{:d}.png", "R/shot_{:d}.png", 9),
        ("left/a{:03d}.png", "right/b{:03d}.png", 0), ("100%_L_{:02d}.png", "100%_R_{:02d}.png", 1),
        ("{:04d}_L.png", "{:04d}_R.png", 1), ("shot 3 {:d} left.png", "shot 3 {:d} right.png", 8),
    ],
)  # fmt: skip
def test_two_rows_of_images(tmp_path, left, right, first):
    for number in range(first, first + 3):
        for place, seed in ((left, number), (right, 100 + number)):
            path = tmp_path / place.format(number)
            path.parent.mkdir(exist_ok=True)
            write_png(path, texture(seed))
    indices, lumas = shown(tmp_path)
    assert indices == [first, first + 1, first + 2]
    assert is_luma_of(lumas[0], texture(first))
    assert is_luma_of(lumas[1], texture(100 + first))


def test_two_images(tmp_path):
    write_png(tmp_path / "left.png", texture(1))
    write_png(tmp_path / "right.png", texture(2))
    indices, lumas = shown(tmp_path)
    assert indices == [0]
    assert is_luma_of(lumas[1], texture(2))


def test_what_a_job_wrote_as_pictures_is_a_scene(tmp_path):
    write_png(tmp_path / "left.png", texture(1))
    write_png(tmp_path / "right.png", texture(2))
    frames = tmp_path / "frames"
    run_job(Job(scene=tmp_path, settings=Settings(), output=OutputOptions(frames_dir=frames)))
    with open_scene(frames) as source:
        assert source.info.lr_shape == (2 * SHAPE[0], 2 * SHAPE[1])


def test_several_pairs_are_asked_about(tmp_path):
    for name in ("a_left", "a_right", "b_left", "b_right"):
        write_video(tmp_path / f"{name}.mkv", 1)
    with pytest.raises(SceneError, match=r"2 pairs of eyes \(a_left\.mkv is read as"):
        describe_path(tmp_path)
    description = describe_path(tmp_path / "b_right.mkv")
    assert [view.color.path for view in description.views] == ["b_left.mkv", "b_right.mkv"]


@pytest.mark.parametrize(
    "name", ["leftover.mkv", "left_right.mkv", "lEFT.mkv", "clip.mkv", "gefüleft.mkv"]
)
def test_other_names_are_no_eyes(tmp_path, name):
    write_video(tmp_path / name, 1)
    for other in {name.lower().replace("left", "right")} - {name}:
        shutil.copy(tmp_path / name, tmp_path / other)
    assert eyes_beside(tmp_path / name) is None
    assert eyes_in(tmp_path) is None
    with pytest.raises(SceneError, match=r"clip_left\.mov"):
        describe_path(tmp_path / name)


def test_a_row_with_a_gap_is_none_and_rows_that_begin_elsewhere_are_told(tmp_path):
    for number in (1, 2, 4):
        write_png(tmp_path / f"left-{number}.png", texture(number))
        write_png(tmp_path / f"right-{number}.png", texture(number))
    assert eyes_in(tmp_path) is None
    (tmp_path / "left-4.png").rename(tmp_path / "left-3.png")
    (tmp_path / "right-4.png").rename(tmp_path / "right-3.png")
    (tmp_path / "left-1.png").unlink()
    with pytest.raises(SceneError, match=r"left-%01d\.png begins with 2, right-%01d\.png with 1"):
        describe_path(tmp_path)


def test_a_video_that_says_it_holds_both_is_read_alone(tmp_path):
    both = write_video(tmp_path / "clip_L.mkv", 1, StereoLayout.SBS)
    write_video(tmp_path / "clip_R.mkv", 2)
    assert describe_path(both).layout == "stereo-video"
    assert list(scene_files(both)) == ["clip_L.mkv"]
    assert describe_path(tmp_path / "clip_R.mkv").layout == "eye-files"


def test_a_resumed_run_sees_a_change_of_either_eye(tmp_path):
    for name, seed in (("clip_L.mkv", 1), ("clip_R.mkv", 2)):
        write_video(tmp_path / name, seed)
    job = Job(
        scene=tmp_path / "clip_L.mkv", settings=Settings(),
        output=OutputOptions(output=tmp_path / "out.mkv"),
    )  # fmt: skip
    before = files_of_job(job)
    write_video(tmp_path / "clip_R.mkv", 3)
    assert files_of_job(job) != before


def test_hidden_files_are_not_looked_at(tmp_path):
    """As macOS lays one beside each file on disks of others."""
    for folder in ("L", "R"):
        (tmp_path / folder).mkdir()
        write_png(tmp_path / folder / "1.png", texture(1))
        (tmp_path / folder / "._1.png").write_bytes(b"fork")
    for name in ("._left.png", "._right.png", "._clip_L.mov", "._clip_R.mov"):
        (tmp_path / name).write_bytes(b"fork")
    assert shown(tmp_path)[0] == [1]


@pytest.mark.parametrize("longer", ["left", "right"])
def test_of_eyes_that_differ_in_length_what_both_have_is_read_and_said(tmp_path, longer):
    for name in ("left", "right"):
        for number in range(3 if name == longer else 2):
            write_png(tmp_path / f"{name}-{number}.png", texture(number))
    with open_scene(tmp_path) as source:
        assert list(source.info.frame_indices) == [0, 1]
        assert any("the first 2, which both eyes have" in text for text in source.info.warnings)


@pytest.mark.parametrize("output", [{"frames_dir": ""}, {"output": "out.mkv", "layout": "views"}])
def test_eyes_are_not_written_among_eyes(tmp_path, output):
    """Where a resumed run would take them for a second pair."""
    for key in {"frames_dir", "output"} & set(output):
        output = {**output, key: tmp_path / output[key]}
    write_video(tmp_path / "clip_L.mkv", 1)
    write_video(tmp_path / "clip_R.mkv", 2)
    job = Job(scene=tmp_path, settings=Settings(), output=OutputOptions(**output))
    with pytest.raises(OutputError, match="could not be told"):
        run_job(job)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["clip_L.mkv", "clip_R.mkv"]


def write_camera_file(
    path, *, rotation=0, aspect=Fraction(1), seed=1, fps=Fraction(24), timecode=None
):  # fmt: skip
    """Write two pictures of noise, 36 × 24, as a camera that is held otherwise, or anamorphic."""
    with av.open(str(path), "w") as output:
        stream = output.add_stream("libx264", rate=fps, options={"crf": "1"})
        if timecode is not None:
            stream.metadata["timecode"] = timecode
        stream.width, stream.height, stream.pix_fmt = SHAPE[1], SHAPE[0], "yuv444p"
        stream.codec_context.sample_aspect_ratio = aspect
        if rotation:
            stream.set_display_rotation(rotation)
        for number in range(2):
            frame = av.VideoFrame.from_ndarray(texture(seed), "rgb24")
            frame.pts = number
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    return path


@pytest.mark.parametrize("rotation", [0, 90, 180, -90])
def test_video_is_turned_as_it_says(tmp_path, rotation):
    """As FFmpeg's program turns it."""
    film = write_camera_file(tmp_path / "a_L.mov", rotation=rotation)
    write_camera_file(tmp_path / "a_R.mov", rotation=rotation, seed=2)
    with open_scene(tmp_path) as source:
        height, width = source.info.lr_shape
        luma = source.read(1).view("left").luma
    assert (height, width) == (SHAPE[::-1] if rotation % 180 else SHAPE)
    command = [program("ffmpeg"), "-v", "error", "-i", str(film), "-f", "rawvideo"]
    command += ["-pix_fmt", "yuv444p", "-frames:v", "1", "-"]
    planes = subprocess.run(command, check=True, capture_output=True).stdout
    seen = np.frombuffer(planes, np.uint8).reshape(3, height, width)[0]
    assert np.corrcoef(luma.ravel(), seen.ravel())[0, 1] > 0.999


@pytest.mark.parametrize(
    ("aspect", "rotation", "shape", "shown", "ending"),
    [
        (Fraction(4, 3), 0, (48, 72), Fraction(4, 3), "mp4"),
        (Fraction(4, 3), 0, (48, 72), Fraction(4, 3), "mkv"),
        (Fraction(4, 3), 90, (72, 48), Fraction(3, 4), "mp4"),
        (Fraction(2), 0, (24, 72), Fraction(1), "mp4"),
        (Fraction(287, 288), 0, (48, 72), Fraction(1), "mp4"),
    ],
)
def test_pixels_that_are_not_square_stay_so(tmp_path, aspect, rotation, shape, shown, ending):
    for eye in "LR":
        write_camera_file(tmp_path / f"a_{eye}.mov", rotation=rotation, aspect=aspect)
    out = tmp_path / "results" / f"out.{ending}"
    out.parent.mkdir()
    job = Job(
        scene=tmp_path, settings=Settings(), output=OutputOptions(output=out),
        magnification_is_default=True,
    )  # fmt: skip
    run_job(job)
    with contextlib.closing(VideoReader(out)) as reader:
        assert (reader.height, reader.width // 2) == shape
        assert reader.pixel_aspect == shown


@pytest.mark.parametrize("ending", ["mov", "mp4", "mkv"])
def test_a_time_code_goes_along_from_the_first_frame_written(tmp_path, ending):
    """Into the result, through a master, into what is exported of it; with drop-frame numbers."""
    for eye, timecode in (("L", "01:00:59;29"), ("R", "01:00:59;28")):
        path = tmp_path / f"a_{eye}.mov"
        write_camera_file(path, fps=Fraction(30000, 1001), timecode=timecode)
    out, master = (tmp_path / "results" / name for name in (f"out.{ending}", "master.mkv"))
    out.parent.mkdir()
    with open_scene(tmp_path) as source:
        assert any("right 01:00:59;28; views are paired" in text for text in source.info.warnings)
    frames = InputOptions(frames=FrameRange(start=1))
    for path, codec in ((out, "h264"), (master, "ffv1")):
        output = OutputOptions(output=path, codec=codec)
        run_job(Job(scene=tmp_path, settings=Settings(), input=frames, output=output))
    made = Master(
        path=master, fps=Fraction(30000, 1001), first_frame=1, layout=StereoLayout.SBS
    )  # fmt: skip
    exported = out.with_name(f"exported.{ending}")
    export(made, OutputOptions(output=exported))
    for path in (out, exported):
        command = [program("ffprobe"), "-v", "error", "-show_streams", "-of", "json", str(path)]
        told = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
        tags = [
            {key.lower(): value for key, value in stream["tags"].items()}
            for stream in told["streams"]
        ]
        assert {item["timecode"] for item in tags} == {"01:01:00;02"}
        assert {item.get("handler_name", "VideoHandler") for item in tags} == {"VideoHandler"}


@pytest.mark.parametrize("fps", [Fraction(25), Fraction(30000, 1001), Fraction(60000, 1001)])
def test_time_codes_go_on_by_one_and_begin_anew_each_day(fps):
    mark = ":" if fps == 25 else ";"
    rate = round(fps)
    a_day = 24 * 3600 * rate - (0 if mark == ":" else 24 * 54 * rate // 15)
    code, seen = f"09:59:58{mark}00", set()
    for _ in range(3 * 60 * rate):
        seen.add(code)
        code = later(code, 1, fps)
    assert len(seen) == 3 * 60 * rate
    assert later(code, a_day, fps) == code
    assert later("00:00:00" + mark + "00", -1 % a_day, fps) == f"23:59:59{mark}{rate - 1}"
    assert later("later", 0, fps) is None
