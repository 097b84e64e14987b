from __future__ import annotations

import cv2
import numpy as np

from pipeline.compile_ahead import kinds_of_settings
from pipeline.config import REGISTRATION_PRESETS, Solver
from pipeline.demo import DemoSize, format_demo, run_demo
from pipeline.media.source import open_scene


def test_a_small_demo_writes_what_it_promises(tmp_path):
    size = DemoSize(width=64, height=48, num_views=3, num_frames=2)
    result = run_demo(tmp_path / "demo", size=size)
    assert sorted(path.name for path in (tmp_path / "demo").iterdir()) == [
        "before-after.png", "scene", "set1", "side-by-side.mkv",
    ]  # fmt: skip
    assert result.measured == (0,)
    assert set(result.psnr) == {"bicubic", "single view", "all views"}
    assert result.psnr["bicubic"] > 15
    assert result.psnr["all views"] > result.psnr["bicubic"] - 0.5
    with open_scene(result.scene) as scene:
        assert scene.info.lr_shape == (48, 64)
        assert len(scene.info.view_ids) == 3
    picture = cv2.imread(str(result.picture))
    assert picture.shape[1] > 3 * 72
    with open_scene(result.video) as video:  # it says itself that it is side by side
        assert video.info.lr_shape == (96, 128)
        assert len(video.info.frame_indices) == 2
    eyes = {
        (condition, eye): cv2.imread(str(result.set1 / condition / f"{eye}-000000.png"))
        for condition in ("original", "bicubic", "sr") for eye in ("left", "right")
    }  # fmt: skip
    assert {picture.shape for picture in eyes.values()} == {(96, 128, 3)}
    for eye, other in (("left", "right"), ("right", "left")):  # an eye's pictures are of that eye
        truth, twin = (eyes["original", one].astype(float) for one in (eye, other))
        for condition in ("bicubic", "sr"):
            made = eyes[condition, eye].astype(float)
            assert np.abs(made - truth).mean() < np.abs(made - twin).mean()
    text = format_demo(result)
    assert "super-resolution of 3 views" in text
    assert f"{result.psnr['bicubic']:.2f} dB" in text


def test_compiling_ahead_reaches_every_solver_and_preset():
    kinds = kinds_of_settings().values()
    assert {settings.solver for settings in kinds} == {solver.value for solver in Solver}
    assert {settings.registration for settings in kinds} == set(REGISTRATION_PRESETS)
