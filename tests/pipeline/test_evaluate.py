from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from pipeline.baselines import bicubic, lanczos
from pipeline.degradation import Degradation, degrade_frame, eight_bit_luma
from pipeline.errors import ConfigurationError
from pipeline.evaluate import METHODS, evaluate_set1, format_table
from pipeline.frames import MultiViewFrame, View
from pipeline.media.source import open_scene
from pipeline.metrics import psnr
from pipeline.report import strict_json
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage

SCENES = ("lytro_2067", "flower", "cones", "art", "kitti")


def _frame(height: int = 91, width: int = 120) -> MultiViewFrame:
    rng = np.random.default_rng(8)
    views = tuple(
        View(
            view_id=name,
            luma=cv2.normalize(
                cv2.GaussianBlur(rng.uniform(0, 255, (height, width)), (0, 0), 1.5),
                None, 0, 255, cv2.NORM_MINMAX,
            ).astype(np.float32),
            depth_map=np.ones((height, width), np.float32),
        )
        for name in "abc"
    )  # fmt: skip
    return MultiViewFrame(frame_index=2, views=views, left="a", right="b")


class Recorder:
    """A super-resolution that notes how it was called and answers with Lanczos."""

    def __init__(self) -> None:
        self.calls: list[tuple] = []

    def __call__(self, frame, settings, *, targets, observed_views=None, keep_intermediates=False):
        self.calls.append((settings, targets, observed_views, frame))
        image = lanczos(frame.view(targets[0]).luma, settings.grid)
        report = FrameReport(
            frame_index=frame.frame_index, noise_sigma=1.0, noise_is_estimated=True, psf_sigma=1.0,
            psf_support=7, psf_is_estimated=False, targets=(), timings={},
        )  # fmt: skip
        return FrameResult(
            frame_index=frame.frame_index,
            images={targets[0]: SuperResolvedImage(view_id=targets[0], luma=image)},
            report=report,
        )


def test_every_method_gets_the_same_grey_frame_and_the_psf_used():
    recorder = Recorder()
    degradation = Degradation(psf_sigma=1.3, psf_support=5, noise_sigma=2, magnification_x=2)
    result = evaluate_set1(_frame(), degradation, superresolve=recorder)
    assert [score.method for score in result.scores] == list(METHODS)
    settings = [call[0] for call in recorder.calls]
    assert [item.solver for item in settings] == ["fused", "pocs", "pocs-simplified", "fused"]
    assert [call[2] for call in recorder.calls] == [("a",), None, None, None]
    for item, targets, _, frame in recorder.calls:
        assert targets == ("a",)
        assert (item.sampling, item.psf, item.psf_sigma, item.psf_support) == (
            "decimation", "given", 1.3, 5,
        )  # fmt: skip
        assert item.noise_sigma is None
        assert frame is recorder.calls[0][3]
        assert all(view.chroma is None for view in frame.views)
        assert frame.lr_shape == (45, 60)


def test_scores_are_those_of_the_rounded_images_without_the_border():
    frame = _frame()
    degradation = Degradation(psf_sigma=1.0)
    result = evaluate_set1(frame, degradation, superresolve=Recorder(), views=("b",))
    degraded = degrade_frame(frame, degradation)
    lr_luma = degraded.frame.view("b").luma
    image = np.clip(np.rint(bicubic(lr_luma, degradation.grid)), 0, 255)
    expected = psnr(image, degraded.truth["b"], border=24)
    assert result.score("b", "bicubic").psnr == pytest.approx(expected)
    default, single = result.score("b", "default"), result.score("b", "single-view")
    assert default.gain_over_bicubic == pytest.approx(default.psnr - expected)
    assert default.gain_over_single_view == 0 == single.gain_over_single_view
    with pytest.raises(KeyError):
        result.score("a", "bicubic")


def test_table_is_aligned_and_json_is_strict():
    told = []
    result = evaluate_set1(
        _frame(), Degradation(), scene="made up", superresolve=Recorder(),
        on_method=lambda view_id, method: told.append((view_id, method)),
    )  # fmt: skip
    assert told == [("a", method) for method in METHODS]
    lines = format_table(result).splitlines()
    assert "made up, frame 2, K = 2" in lines[0]
    assert len(lines) == 2 + len(METHODS)
    column = lines[1].index("PSNR dB") + len("PSNR dB")
    assert all(line[:column].split()[-1].count(".") == 1 for line in lines[2:])
    alone = evaluate_set1(_frame(), Degradation(), methods=("bicubic",))
    content = json.loads(strict_json(alone.as_json()))
    assert content["scores"][0]["gain_over_single_view"] is None
    assert content["hr_shape"] == [90, 120]


def test_bad_requests_are_refused():
    with pytest.raises(ConfigurationError, match="'z' is not a view"):
        evaluate_set1(_frame(), Degradation(), views=("z",), superresolve=Recorder())
    with pytest.raises(ConfigurationError, match="--methods: 'magic' is not one of bicubic, "):
        evaluate_set1(_frame(), Degradation(), methods=("magic",), superresolve=Recorder())
    with pytest.raises(ConfigurationError, match="too small"):
        evaluate_set1(_frame(58, 120), Degradation(), superresolve=Recorder())


@pytest.mark.parametrize("scene", SCENES)
def test_truth_of_real_scenes_is_opencvs_luma(scenes_dir, scene):
    """The frame's float luma, taken back to 8 bit, is exactly COLOR_BGR2GRAY of the file."""
    manifest = json.loads((scenes_dir / scene / "scene.json").read_text())
    with open_scene(scenes_dir / scene) as source:
        frame = source.read(source.info.frame_indices.start)
    path = manifest["views"][0]["color"]
    picture = cv2.imread(str(scenes_dir / scene / (path % 0 if "%" in path else path)))
    expected = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
    view = frame.view(manifest["views"][0]["id"])
    np.testing.assert_array_equal(eight_bit_luma(view), expected)


def test_bicubic_baseline_of_the_light_field(scenes_dir):
    """METHOD §5 gives 36.7 and 34.4 dB at noise 2, 37.7 dB without, measured independently."""
    with open_scene(scenes_dir / "lytro_2067") as source:
        frame = source.read(source.info.frame_indices.start)
    for sigma, noise, expected in ((1.0, 2.0, 36.7), (1.7, 2.0, 34.4), (1.0, 0.0, 37.7)):
        result = evaluate_set1(
            frame, Degradation(psf_sigma=sigma, noise_sigma=noise), methods=("bicubic",)
        )
        assert result.score(frame.left, "bicubic").psnr == pytest.approx(expected, abs=0.25)
