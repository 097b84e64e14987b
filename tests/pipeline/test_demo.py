from __future__ import annotations

import cv2
import pytest

from pipeline.compile_ahead import kinds_of_settings
from pipeline.config import REGISTRATION_PRESETS, Solver
from pipeline.demo import DemoSize, RenderedSource, format_demo, run_demo
from pipeline.errors import SceneError
from pipeline.media.source import open_scene
from pipeline.synthetic import SampleScene


def test_a_small_demo_writes_what_it_promises(tmp_path):
    size = DemoSize(width=64, height=48, num_views=3, num_frames=2)
    result = run_demo(tmp_path / "demo", size=size)
    assert sorted(path.name for path in (tmp_path / "demo").iterdir()) == [
        "before-after.png", "side-by-side.mkv",
    ]  # fmt: skip
    assert result.measured == (0,)
    assert set(result.psnr) == {"bicubic", "single view", "all views"}
    assert result.psnr["bicubic"] > 15
    assert result.psnr["all views"] > result.psnr["bicubic"] - 0.5
    picture = cv2.imread(str(result.picture))
    assert picture.shape[1] > 3 * 72
    with open_scene(result.video) as video:  # it says itself that it is side by side
        assert video.info.lr_shape == (96, 128)
        assert len(video.info.frame_indices) == 2
    text = format_demo(result)
    assert "super-resolution of 3 views" in text
    assert f"{result.psnr['bicubic']:.2f} dB" in text


def test_rendered_frames_are_a_source_like_any_other():
    scene = SampleScene(width=40, height=30, num_views=2)
    with RenderedSource(scene, 3, color=False, depth=None) as source:
        assert [frame.frame_index for frame in source.frames(1)] == [1, 2]
        frame = source.read(0)
        assert frame.lr_shape == source.info.lr_shape == (30, 40)
        assert (frame.left, frame.right) == (source.info.left, source.info.right)
        with pytest.raises(SceneError, match="frame 3: no such frame"):
            source.read(3)


def test_compiling_ahead_reaches_every_solver_and_preset():
    kinds = kinds_of_settings().values()
    assert {settings.solver for settings in kinds} == {solver.value for solver in Solver}
    assert {settings.registration for settings in kinds} == set(REGISTRATION_PRESETS)
    assert {settings.psf for settings in kinds} == {"given", "auto"}
