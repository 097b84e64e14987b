"""Frames before and after as constraints: they gain, and segments come out the same."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.errors import ConfigurationError, SceneError
from pipeline.frames import MultiViewFrame, View
from pipeline.job import Job, OutputOptions
from pipeline.metrics import psnr
from pipeline.run import run_job
from pipeline.superresolve import superresolve
from pipeline.synthetic import SampleScene, write_scene
from pipeline.temporal.neighbours import in_windows, with_neighbours

NOISE = 2.0
SCENE = SampleScene(width=128, height=96, num_views=2)
LEFT = SCENE.view_ids[SCENE.reference_views[0]]


@pytest.fixture(scope="module")
def frames():
    return [SCENE.frame(number, noise_sigma=NOISE) for number in range(3)]


def _made(frame, **others):
    settings = Settings(psf_sigma=1.0, noise_sigma=NOISE, sampling="decimation")
    return superresolve(frame, settings, targets=(LEFT,), **others)


def _psnr(result, number):
    picture = SCENE.render_hr(SCENE.reference_views[0], number / SCENE.fps)
    truth = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return psnr(result.images[LEFT].luma, truth, border=8)


def test_neighbours_gain_and_are_in_the_report(frames):
    alone = _made(frames[1])
    wide = _made(frames[1], neighbours=(frames[0], frames[2]))
    assert _psnr(wide, 1) > _psnr(alone, 1) + 0.1
    names = [view.view_id for view in wide.report.targets[0].views]
    assert names[:2] == list(SCENE.view_ids)
    assert names[2:] == [f"{view}@{where}" for where in ("-1", "+1") for view in SCENE.view_ids]
    assert list(wide.images) == [LEFT]


def test_neighbours_that_show_something_else_do_no_harm(frames):
    other = replace(
        frames[0],
        views=tuple(
            replace(
                view,
                luma=np.ascontiguousarray(view.luma[::-1, ::-1]),
                depth_map=np.ascontiguousarray(view.depth_map[::-1, ::-1]),
            )
            for view in frames[0].views
        ),
    )
    assert _psnr(_made(frames[1], neighbours=(other,)), 1) > _psnr(_made(frames[1]), 1) - 0.05


def test_of_neighbours_only_their_pictures_and_depth_are_used(frames):
    wide, names = with_neighbours(frames[1], (frames[0],), SCENE.view_ids)
    added = wide.view(names[0])
    assert added.calibration is None
    assert added.luma is not None
    small = View(view_id=LEFT, luma=np.zeros((8, 8), np.float32))
    odd = MultiViewFrame(frame_index=0, views=(small,), left=LEFT, right=LEFT)
    with pytest.raises(SceneError, match="another size"):
        with_neighbours(frames[1], (odd,), (LEFT,))


@pytest.mark.parametrize("window", [0, 1, 2])
def test_every_frame_comes_once_with_those_around_it(window):
    for count in range(7):
        found = list(in_windows(iter(range(count)), window))
        assert [frame for frame, _ in found] == list(range(count))
        for frame, near in found:
            assert list(near) == [
                other
                for other in range(max(0, frame - window), min(count, frame + window + 1))
                if other != frame
            ]


def test_no_more_frames_are_held_than_a_window_needs():
    drawn = []

    def frames():
        for number in range(50):
            drawn.append(number)
            yield number

    for frame, _ in in_windows(frames(), 1):
        assert len(drawn) <= frame + 2


def test_segments_read_their_neighbours_and_come_out_the_same(tmp_path):
    manifest = write_scene(
        tmp_path / "scene", SampleScene(width=104, height=80, num_views=2), num_frames=4,
        noise_sigma=NOISE,
    )  # fmt: skip
    pictures = []
    for length in (2, 4):
        folder = tmp_path / str(length)
        folder.mkdir()
        job = Job(
            scene=manifest,
            settings=Settings(temporal_window=1),
            output=OutputOptions(frames_dir=folder / "frames", segment_length=length),
        )
        run_job(job)
        pictures.append({path.name: path.read_bytes() for path in (folder / "frames").iterdir()})
    assert len(pictures[0]) == 8
    assert pictures[0] == pictures[1]


def test_methods_that_start_from_calibration_have_no_window():
    with pytest.raises(ConfigurationError, match="--temporal-window: must be 0 with"):
        Settings(registration="e", temporal_window=1)
