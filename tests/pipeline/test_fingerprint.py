from __future__ import annotations

import dataclasses
import itertools
import os
from pathlib import Path

import pytest

from pipeline.config import Settings
from pipeline.fingerprint import make_fingerprint, scene_files
from pipeline.job import InputOptions, Job, OutputOptions


@pytest.fixture
def scene(tmp_path) -> Path:
    folder = tmp_path / "scene"
    (folder / "cam0").mkdir(parents=True)
    (folder / "scene.json").write_text("{}")
    (folder / "cam0" / "color-000.png").write_bytes(b"picture")
    return folder


def _job(scene: Path, **output) -> Job:
    return Job(scene=scene, output=OutputOptions(**{"output": scene / "out.mkv", **output}))


def _print(job: Job) -> dict:
    return make_fingerprint(job, range(3), ("a", "b"))


def test_files_of_a_scene_without_what_the_job_itself_writes(scene):
    job = _job(
        scene, report=scene / "report.json", frames_dir=scene / "frames", debug_dir=scene / "debug"
    )
    before = scene_files(job)
    assert [name for name, _, _ in before] == ["scene.json", "cam0/color-000.png"]
    for name in (
        "out.mkv",
        "report.json",
        ".out.mkv.depthsr/job.json",
        "frames/left.png",
        "debug/x.png",
    ):
        (scene / name).parent.mkdir(exist_ok=True)
        (scene / name).write_bytes(b"x")
    assert scene_files(job) == before
    assert scene_files(dataclasses.replace(job, scene=scene / "scene.json")) == before


def test_pictures_written_beside_the_scenes_own_are_not_the_scenes(scene):
    job = _job(scene, frames_dir=scene, debug_dir=scene, layout="views")
    before = scene_files(job, ("cam0",))
    for name in (
        "left-000003.png",
        "cam0-000003.png",
        "frame-000003-cam0-layers.png",
        "out.cam0.mkv",
    ):
        (scene / name).write_bytes(b"x")
    assert scene_files(job, ("cam0",)) == before
    (scene / "cam1-000003.png").write_bytes(b"x")
    assert len(scene_files(job, ("cam0",))) == len(before) + 1


def test_a_video_is_one_file(scene):
    video = scene / "clip.mkv"
    video.write_bytes(b"video")
    assert [name for name, _, _ in scene_files(_job(video))] == ["clip.mkv"]


def test_a_changed_or_added_file_changes_it(scene):
    job = _job(scene)
    prints = [_print(job)]
    picture = scene / "cam0" / "color-000.png"
    os.utime(picture, ns=(1, 1))
    prints.append(_print(job))
    picture.write_bytes(b"other")
    prints.append(_print(job))
    (scene / "cam0" / "color-001.png").write_bytes(b"picture")
    prints.append(_print(job))
    assert all(first != second for first, second in itertools.pairwise(prints))


def test_whatever_changes_the_result_changes_it_and_threads_do_not(scene):
    job = _job(scene)
    base = _print(job)
    assert base == _print(job)
    assert base == _print(dataclasses.replace(job, settings=Settings(threads=3)))
    others = [
        dataclasses.replace(job, settings=Settings(noise_sigma=1.0)),
        dataclasses.replace(job, settings=Settings(magnification="3")),
        dataclasses.replace(job, input=InputOptions(views=("a",))),
        _job(scene, layout="tab"),
        _job(scene, quality=20),
        _job(scene, segment_length=5),
        _job(scene, frames_dir=scene / "frames"),
    ]
    for other in others:
        assert _print(other) != base
    assert make_fingerprint(job, range(4), ("a", "b")) != base
    assert make_fingerprint(job, range(3), ("a",)) != base
