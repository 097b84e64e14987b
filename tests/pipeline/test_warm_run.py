"""A real job whose frames start warm: the same bytes whether done at once or resumed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from pipeline.config import Settings
from pipeline.events import SegmentFinished
from pipeline.job import Job, OutputOptions
from pipeline.run import run_job
from pipeline.synthetic import SampleScene, write_scene

NUM_FRAMES = 8


def _job(manifest: Path, folder: Path, temporal: str = "warm") -> Job:
    folder.mkdir()
    return Job(
        scene=manifest,
        settings=Settings(temporal=temporal),
        output=OutputOptions(
            frames_dir=folder / "frames", report=folder / "report.json", segment_length=4
        ),
    )


def _pictures(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted((folder / "frames").glob("*.png"))}


@pytest.fixture(scope="module")
def manifest(tmp_path_factory):
    scene = SampleScene(width=128, height=96, num_views=4)
    folder = tmp_path_factory.mktemp("warm") / "scene"
    return write_scene(folder, scene, num_frames=NUM_FRAMES, noise_sigma=2.0)


def test_a_resumed_run_equals_an_undisturbed_one(manifest, tmp_path):
    whole = _job(manifest, tmp_path / "whole")
    run_job(whole)
    cut = _job(manifest, tmp_path / "cut")

    def die(event):
        if isinstance(event, SegmentFinished):
            raise RuntimeError("boom")

    with pytest.raises(RuntimeError, match="boom"):
        run_job(cut, on_event=die)
    summary = run_job(cut, resume=True)
    assert 0 < summary.frames_computed < NUM_FRAMES
    expected = _pictures(tmp_path / "whole")
    assert len(expected) == 2 * NUM_FRAMES
    assert _pictures(tmp_path / "cut") == expected


def test_the_report_says_how_each_frame_started(manifest, tmp_path):
    job = _job(manifest, tmp_path / "job")
    run_job(job)
    frames = json.loads(job.output.report.read_text())["frames"]
    shares = [target["start"]["warm_share"] for frame in frames for target in frame["targets"]]
    assert [frame["frame_index"] for frame in frames] == list(range(NUM_FRAMES))
    assert shares[:2] == [0.0, 0.0]
    # a segment is warmed up, so that its first frame starts warm too
    assert min(shares[2:]) > 0.35
