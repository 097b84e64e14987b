"""How good on real scenes: Set 1 (METHOD §4), K = 2, left view, nothing tuned to the scene.

The floors are those that the project has set itself, not what is measured.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from pipeline.degradation import Degradation
from pipeline.evaluate import Set1Result, evaluate_set1
from pipeline.frames import MultiViewFrame
from pipeline.media.source import open_scene

SCENES = ("lytro_2067", "flower", "cones", "art", "kitti")
SMALL_SCENES = tuple(scene for scene in SCENES if scene != "flower")
CONDITIONS = ((1.7, 0.0), (1.7, 2.0), (1.0, 0.0), (1.0, 2.0))
"""σ_psf in HR pixels, noise in grey levels."""

OVER_BICUBIC = 0.8
OVER_SINGLE_VIEW = -0.02
"""Least gains in every cell, dB."""

MEAN_OVER_BICUBIC = 2.7
"""Least mean gain without noise, dB."""

NOISY_OVER_SINGLE_VIEW = {
    ("lytro_2067", 1.0): 1.8,
    ("lytro_2067", 1.7): 1.2,
    ("flower", 1.0): 0.8,
    ("flower", 1.7): 0.5,
}
"""Least gains over single-view at noise 2, dB; by scene and σ_psf."""

THESIS_ABOVE = 0.2
"""By how much the thesis' own solvers may be better than the default, dB."""

Measure = Callable[[str, float, float], Set1Result]


@pytest.fixture(scope="module")
def measure(scenes_dir: Path) -> Measure:
    """Run a cell: scene, σ_psf, noise; each is run once."""

    @cache
    def frame(scene: str) -> MultiViewFrame:
        with open_scene(scenes_dir / scene) as source:
            return source.read(source.info.frame_indices.start)

    @cache
    def run(scene: str, psf_sigma: float, noise: float) -> Set1Result:
        thesis = () if scene == "flower" else ("pocs", "pocs-simplified")
        return evaluate_set1(
            frame(scene),
            Degradation(psf_sigma=psf_sigma, psf_support=7, noise_sigma=noise, seed=1),
            scene=scene,
            methods=("bicubic", "single-view", *thesis, "default"),
        )

    return run


@pytest.mark.parametrize(("psf_sigma", "noise"), CONDITIONS)
@pytest.mark.parametrize("scene", SCENES)
def test_better_than_bicubic_and_no_worse_than_one_view(measure, scene, psf_sigma, noise):
    result = measure(scene, psf_sigma, noise)
    score = result.score(result.scores[0].view_id, "default")
    assert score.gain_over_bicubic >= OVER_BICUBIC
    assert score.gain_over_single_view >= OVER_SINGLE_VIEW


@pytest.mark.parametrize(("psf_sigma", "noise"), CONDITIONS)
@pytest.mark.parametrize("scene", SMALL_SCENES)
def test_the_thesis_solvers_are_not_better(measure, scene, psf_sigma, noise):
    result = measure(scene, psf_sigma, noise)
    psnr = {score.method: score.psnr for score in result.scores}
    for method in ("pocs", "pocs-simplified"):
        assert psnr[method] <= psnr["default"] + THESIS_ABOVE


@pytest.mark.parametrize(("scene", "psf_sigma"), list(NOISY_OVER_SINGLE_VIEW))
def test_under_noise_more_views_gain_much(measure, scene, psf_sigma):
    result = measure(scene, psf_sigma, 2.0)
    score = result.score(result.scores[0].view_id, "default")
    assert score.gain_over_single_view >= NOISY_OVER_SINGLE_VIEW[scene, psf_sigma]


def test_the_mean_gain_over_bicubic_without_noise(measure):
    gains = []
    for scene in SCENES:
        for psf_sigma in (1.7, 1.0):
            result = measure(scene, psf_sigma, 0.0)
            gains.append(result.score(result.scores[0].view_id, "default").gain_over_bicubic)
    assert len(gains) == 10
    assert sum(gains) / len(gains) >= MEAN_OVER_BICUBIC


def test_the_readme_tells_the_figures_of_now(measure):
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^(\w+) +([\w-]+) +(\d\S+) +(\d\S+) +([+-]\S+) +([+-]\S+)$", readme, re.M)
    result = measure("lytro_2067", 1.0, 2.0)
    assert [method for _, method, *_ in rows] == [
        "bicubic", "single-view", "pocs-simplified", "default",
    ]  # fmt: skip
    for view, method, *said in rows:
        score = result.score(view, method)
        psnr, ssim, over_bicubic, over_single_view = map(float, said)
        assert psnr == pytest.approx(score.psnr, abs=0.02)
        assert ssim == pytest.approx(score.ssim, abs=0.0005)
        assert over_bicubic == pytest.approx(score.gain_over_bicubic, abs=0.02)
        assert over_single_view == pytest.approx(score.gain_over_single_view, abs=0.02)


@pytest.mark.parametrize("number", [0, 4])
def test_frames_before_and_after_gain_on_a_moving_stereo_video(scenes_dir, number):
    """Two views from a car: nothing stands still. Frame 0 has no frame before it."""
    with open_scene(scenes_dir / "kitti") as source:
        near = [other for other in (number - 1, number + 1) if other in source.info.frame_indices]
        around = tuple(source.read(other) for other in near)
        frame = source.read(number)
    degradation = Degradation(psf_sigma=1.0, noise_sigma=2.0)
    scores = [
        evaluate_set1(frame, degradation, methods=("default",), neighbours=neighbours).scores[0]
        for neighbours in ((), around)
    ]
    assert scores[1].psnr > scores[0].psnr + (0.2 if number == 0 else 0.5)
