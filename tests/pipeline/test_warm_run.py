"""A real job whose frames start warm: the same bytes whether done at once or resumed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.events import SegmentFinished
from pipeline.job import FrameRange, InputOptions, Job, OutputOptions
from pipeline.line import WATCHED, warm_up
from pipeline.media.layouts import describe_path
from pipeline.media.scene_source import SceneSource
from pipeline.metrics import psnr
from pipeline.run import Tools, run_job
from pipeline.synthetic import SampleScene, write_scene

NUM_FRAMES = 8
CHAINED = ("swift", "warm")
"""What carries something from frame to frame."""


def _job(
    manifest: Path, folder: Path, segment_length: int = 4, temporal: str = "warm"
) -> Job:  # fmt: skip
    folder.mkdir()
    return Job(
        scene=manifest,
        settings=Settings(temporal=temporal),
        output=OutputOptions(
            frames_dir=folder / "frames", report=folder / "report.json",
            segment_length=segment_length,
        ),
    )  # fmt: skip


def _pictures(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "frames").glob("*.png"))}


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    scene = SampleScene(width=128, height=96, num_views=4)
    folder = tmp_path_factory.mktemp("warm") / "scene"
    return write_scene(folder, scene, num_frames=NUM_FRAMES, noise_sigma=2.0)


@pytest.fixture(scope="module")
def whole(manifest, tmp_path_factory):
    """The folder of an undisturbed run in two segments."""
    folder = tmp_path_factory.mktemp("whole") / "job"
    run_job(_job(manifest, folder))
    return folder


def _until_it_has_forgotten(temporal: str) -> int:
    """Return the first frame before which a segment sees nothing of the scene's first one."""
    return WATCHED + warm_up(temporal) + 1


@pytest.fixture(scope="module")
def long_manifest(tmp_path_factory):
    scene = SampleScene(width=160, height=120, num_views=2)
    folder = tmp_path_factory.mktemp("long") / "scene"
    longest = max(map(_until_it_has_forgotten, CHAINED))
    return write_scene(folder, scene, num_frames=longest + 1, noise_sigma=2.0)


@pytest.mark.parametrize("temporal", CHAINED)
def test_the_picture_does_not_jump_where_segments_meet(long_manifest, tmp_path, temporal):
    """The second segment sees nothing of the first frames, which the uncut run began with."""
    length = _until_it_has_forgotten(temporal)
    for name, segment_length in (("cut", length), ("uncut", length + 1)):
        job = _job(long_manifest, tmp_path / name, segment_length, temporal)
        run_job(replace(job, input=InputOptions(frames=FrameRange(start=0, stop=length + 1))))
    cut, uncut = _pictures(tmp_path / "cut"), _pictures(tmp_path / "uncut")
    assert cut.keys() == uncut.keys()
    differing = [name for name in cut if cut[name] != uncut[name]]
    assert differing == [f"{eye}-{length:06}.png" for eye in ("left", "right")]
    for name in differing:
        pictures = (cv2.imdecode(np.frombuffer(of[name], np.uint8), 0) for of in (cut, uncut))
        assert psnr(*pictures) >= 50


def test_nothing_outside_the_frames_asked_for_is_read(manifest, tmp_path):
    job = _job(manifest, tmp_path / "part")
    asked, read = range(3, 5), []

    class Watched(SceneSource):
        def read(self, frame_index):
            read.append(frame_index)
            return super().read(frame_index)

    def open_watched(path, *, input_layout, **options):
        return Watched(describe_path(path, input_layout), **options)

    job = replace(job, input=InputOptions(frames=FrameRange(start=3, stop=5)))
    run_job(job, tools=Tools(open_scene=open_watched))
    assert read == list(asked)


@pytest.mark.parametrize("temporal", CHAINED)
def test_a_resumed_run_equals_an_undisturbed_one(manifest, whole, tmp_path, temporal):
    if temporal != "warm":
        whole = tmp_path / "whole"
        run_job(_job(manifest, whole, temporal=temporal))
    cut = _job(manifest, tmp_path / "cut", temporal=temporal)

    def die(event):
        if isinstance(event, SegmentFinished):
            raise RuntimeError("boom")

    with pytest.raises(RuntimeError, match="boom"):
        run_job(cut, on_event=die)
    summary = run_job(cut, resume=True)
    assert 0 < summary.frames_computed < NUM_FRAMES
    expected = _pictures(whole)
    assert len(expected) == 2 * NUM_FRAMES
    assert _pictures(tmp_path / "cut") == expected


def test_the_report_says_how_each_frame_started(whole):
    frames = json.loads((whole / "report.json").read_text())["frames"]
    shares = [target["start"]["warm_share"] for frame in frames for target in frame["targets"]]
    assert [frame["frame_index"] for frame in frames] == list(range(NUM_FRAMES))
    assert shares[:2] == [0.0, 0.0]
    # a segment is warmed up, so that its first frame starts warm too
    assert min(shares[2:]) > 0.35
