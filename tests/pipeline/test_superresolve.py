"""One frame through all stages: the result is better, and the report says how it came about."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.baselines import bicubic
from pipeline.config import REGISTRATION_PRESETS, Settings
from pipeline.errors import ConfigurationError, Interrupted, SceneError
from pipeline.frames import MultiViewFrame, RegisteredView, Rejection, View
from pipeline.grid import Sampling
from pipeline.metrics import psnr
from pipeline.reconstruction.coverage import phase_coverage
from pipeline.reconstruction.fused import fuse
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.results import FrameResult, TargetReport
from pipeline.superresolve import (
    chosen_method,
    default_residual_threshold,
    default_weight_threshold,
    given_psf,
    reconstruct,
    superresolve,
)
from pipeline.synthetic import SampleScene
from pipeline.threads import set_threads

WIDTH, HEIGHT = 112, 80
SETTINGS = Settings(sampling="decimation", psf_sigma=1.0, psf_support=7)
REASONS = {
    "no_motion", "outside", "weight", "depth", "residual", "edge", "occluded",
}  # fmt: skip


@pytest.fixture(scope="module")
def scene() -> SampleScene:
    return SampleScene(width=WIDTH, height=HEIGHT, num_views=3)


@pytest.fixture(scope="module")
def frame(scene) -> MultiViewFrame:
    """Three colour views, noise 1, depth as a stereo matcher delivers it; cam1 is left."""
    return scene.frame(0, psf_sigma=1.0, noise_sigma=1.0, depth="stereo", color=True)


@pytest.fixture(scope="module")
def result(frame) -> FrameResult:
    return superresolve(frame, SETTINGS, targets=("cam1", "cam2"), keep_intermediates=True)


@pytest.fixture(autouse=True)
def same_number_of_threads():
    """A job sets the number of threads; the next test shall not feel it."""
    yield
    set_threads(0)


def _grey(frame: MultiViewFrame) -> MultiViewFrame:
    return replace(frame, views=tuple(replace(view, chroma=None) for view in frame.views))


def _changed(frame: MultiViewFrame, view_id: str, **changes) -> MultiViewFrame:
    views = (replace(view, **changes) if view.view_id == view_id else view for view in frame.views)
    return replace(frame, views=tuple(views))


def _report(result: FrameResult, view_id: str) -> TargetReport:
    return next(report for report in result.report.targets if report.view_id == view_id)


# --- images ------------------------------------------------------------------------------


def test_the_targets_come_back_finer_in_range_and_read_only(frame, result):
    assert list(result.images) == ["cam1", "cam2"]
    assert result.frame_index == frame.frame_index
    for view_id, image in result.images.items():
        assert image.view_id == view_id
        assert image.luma.shape == (2 * HEIGHT, 2 * WIDTH)
        assert image.chroma.shape == (2 * HEIGHT, 2 * WIDTH, 2)
        assert image.luma.dtype == image.chroma.dtype == np.float32
        assert 0 <= image.luma.min() < image.luma.max() <= 255
        assert not image.luma.flags.writeable


def test_the_result_is_better_than_bicubic_and_than_one_view(scene, frame, result):
    truth = scene.truth(0).hr_luma
    for number, view_id in ((1, "cam1"), (2, "cam2")):
        single = superresolve(
            _grey(frame), SETTINGS, targets=(view_id,), observed_views=(view_id,)
        ).images[view_id]
        plain = bicubic(frame.view(view_id).luma, SETTINGS.grid)
        several, one, none = (
            psnr(image, truth[number], border=12)
            for image in (result.images[view_id].luma, single.luma, plain)
        )
        assert one > none + 0.5
        assert several > one + 0.5


def _with_true_motion(scene, frame, number: int) -> np.ndarray:
    """The reference view reconstructed from where every pixel really lands, seen or hidden."""
    registered = []
    for source, view in enumerate(frame.views):
        motion = scene.true_motion(source, number)
        visible = motion.visible | (source == number)
        registered.append(
            RegisteredView(
                view_id=view.view_id,
                observed=view.luma,
                position=motion.position.astype(np.float32),
                registration_weights=np.zeros_like(view.luma),
                flags=np.where(visible, 0, Rejection.OCCLUDED).astype(np.uint8),
                confidence=np.ones_like(view.luma),
                is_reference=source == number,
            )
        )
    fused = fuse(
        registered, SETTINGS.grid, frame.lr_shape, given_psf(SETTINGS), noise=1.0,
        residual_threshold=default_residual_threshold(1.0),
    )  # fmt: skip
    return np.clip(fused.estimate, 0, 255)


def test_estimated_motion_is_nearly_as_good_as_the_true_one(scene, frame, result):
    for number, view_id in ((1, "cam1"), (2, "cam2")):
        truth = scene.truth(0).hr_luma[number]
        best = psnr(_with_true_motion(scene, frame, number), truth, border=12)
        assert psnr(result.images[view_id].luma, truth, border=12) > best - 0.3


def test_the_gain_grows_with_the_views(scene, frame):
    truth = scene.truth(0).hr_luma[1]
    scores = []
    for views in (("cam1",), ("cam1", "cam2"), ("cam0", "cam1", "cam2")):
        image = superresolve(_grey(frame), SETTINGS, targets=("cam1",), observed_views=views)
        scores.append(psnr(image.images["cam1"].luma, truth, border=12))
    assert scores[0] + 0.3 < scores[1]
    assert scores[1] + 0.1 < scores[2]


@pytest.mark.parametrize("noise", [0.3, 2.0])
@pytest.mark.parametrize("num_views", [1, 3])
def test_a_view_cut_out_of_a_larger_picture_is_as_good_as_a_copy_of_it(noise, num_views):
    whole = SampleScene(width=64, height=48, num_views=3).frame(0, noise_sigma=noise)

    def cut_out(view):
        both = np.hstack([view.luma, view.luma])
        return replace(view, luma=both[:, : view.luma.shape[1]])

    cut = replace(whole, views=tuple(map(cut_out, whole.views)))
    assert not cut.views[0].luma.flags.c_contiguous
    names = tuple(view.view_id for view in whole.views)
    one, other = (
        superresolve(
            frame, Settings(noise_sigma=noise), targets=names[:1], observed_views=names[:num_views]
        )
        for frame in (whole, cut)
    )
    np.testing.assert_array_equal(one.images[names[0]].luma, other.images[names[0]].luma)


def test_an_eye_is_the_same_whether_the_other_is_asked_for_or_not(frame, result):
    alone = superresolve(_grey(frame), SETTINGS, targets=("cam1",))
    np.testing.assert_array_equal(alone.images["cam1"].luma, result.images["cam1"].luma)


@pytest.mark.parametrize(
    ("magnification", "sampling"),
    [("2", "area"), ("3", "area"), ("3", "decimation"), ("4", "area"), ("2x1", "area"),
     ("1x2", "decimation")],
)  # fmt: skip
def test_every_magnification_and_phase(frame, magnification, sampling):
    settings = Settings(magnification=magnification, sampling=sampling)
    small = _grey(frame)
    image = superresolve(small, settings, targets=("cam1",)).images["cam1"].luma
    assert image.shape == settings.grid.hr_shape(small.lr_shape)
    plain = bicubic(small.view("cam1").luma, settings.grid)
    # at the wrong phase it would differ by half a pixel of slope
    inner = np.s_[8:-8, 8:-8]
    assert np.abs((image - plain)[inner].mean()) < 0.5
    along_x = np.gradient(plain, axis=1)[inner]
    along_y = np.gradient(plain, axis=0)[inner]
    difference = (image - plain)[inner]
    for slope in (along_x, along_y):
        assert abs((difference * slope).sum() / (slope**2).sum()) < 0.05


def test_one_thread_or_two_give_the_same_bits(frame, result):
    for threads in (1, 2):
        again = superresolve(
            frame, replace(SETTINGS, threads=threads), targets=("cam1", "cam2"),
            keep_intermediates=True,
        )  # fmt: skip
        for view_id, image in result.images.items():
            np.testing.assert_array_equal(again.images[view_id].luma, image.luma)
            np.testing.assert_array_equal(again.images[view_id].chroma, image.chroma)
            np.testing.assert_array_equal(
                again.debug[view_id].contribution_count, result.debug[view_id].contribution_count
            )
        assert [report.views for report in again.report.targets] == [
            report.views for report in result.report.targets
        ]


def test_the_input_is_not_changed(frame):
    before = [view.luma.copy() for view in frame.views]
    superresolve(frame, SETTINGS, targets=("cam1",))
    for view, luma in zip(frame.views, before, strict=True):
        np.testing.assert_array_equal(view.luma, luma)


# --- colour ------------------------------------------------------------------------------


def test_grey_views_have_no_colour(frame):
    assert superresolve(_grey(frame), SETTINGS, targets=("cam1",)).images["cam1"].chroma is None


def test_colour_is_enlarged_or_super_resolved(scene, frame, result):
    by_bicubic = result.images["cam1"].chroma
    settings = replace(SETTINGS, chroma="sr")
    by_sr = superresolve(frame, settings, targets=("cam1",)).images["cam1"]
    np.testing.assert_array_equal(by_sr.luma, result.images["cam1"].luma)
    expected = bicubic(frame.view("cam1").chroma, SETTINGS.grid)
    np.testing.assert_allclose(by_bicubic, np.clip(expected, 0, 255), atol=0.1)
    assert by_sr.chroma.shape == by_bicubic.shape
    rgb = scene.render_hr(1, 0.0).astype(float)
    truth = 128 + np.stack(
        [
            rgb @ [-0.168736, -0.331264, 0.5],
            rgb @ [0.5, -0.418688, -0.081312],
        ],
        axis=-1,
    )  # fmt: skip
    inner = np.s_[8:-8, 8:-8]
    errors = [np.abs(chroma - truth)[inner].mean() for chroma in (by_bicubic, by_sr.chroma)]
    assert errors[1] < 0.95 * errors[0]


# --- report ------------------------------------------------------------------------------


def test_shares_are_shares_and_counts_are_of_pixels(frame, result):
    for target in result.report.targets:
        assert {view.view_id for view in target.views} == {"cam0", "cam1", "cam2"}
        assert len(target.views) == 3
        assert 0 < target.phase_coverage_reference <= 25.0
        assert target.phase_coverage_reference < target.phase_coverage <= 100
        assert target.iterations > 0
        assert target.stop_reason
        assert target.solver == "fused"
        assert all(math.isfinite(residual) and residual > 0 for residual in target.residuals)
        for view in target.views:
            shares = (view.registered_fraction, view.verified_fraction, view.weight_fraction)
            assert all(0 <= share <= 1 for share in shares)
            assert view.verified_fraction <= view.registered_fraction
            assert set(view.rejections) == REASONS
            assert all(0 <= count <= WIDTH * HEIGHT for count in view.rejections.values())
            trusted = view.verified_fraction * WIDTH * HEIGHT
            assert max(view.rejections.values()) <= WIDTH * HEIGHT - trusted + 0.5
            assert sum(view.rejections.values()) >= WIDTH * HEIGHT - trusted - 0.5
            assert view.median_absolute_weight >= 0
            assert 0 < view.residual_rms < 12


def test_the_reference_is_wholly_trusted_in_its_own_report(result):
    for target in result.report.targets:
        own = next(view for view in target.views if view.view_id == target.view_id)
        assert own.registered_fraction == own.verified_fraction == own.weight_fraction == 1
        assert not any(own.rejections.values())
        assert own.median_absolute_weight == 0


@pytest.mark.parametrize(
    ("sampling", "magnification"),
    [("decimation", "2"), ("area", "2"), ("decimation", "3"), ("area", "4"), ("area", "2x1")],
)
def test_phases_marked_on_the_way_are_those_that_are_counted(
    scene, monkeypatch, sampling, magnification
):
    seen, counted = [], reconstruct._phases

    def report(frame, target, registered, solved, start):
        seen.append((solved.phases, counted(frame, registered, solved)))
        return told(frame, target, registered, solved, start)

    told = reconstruct._report
    monkeypatch.setattr(reconstruct, "_report", report)
    settings = replace(SETTINGS, sampling=sampling, magnification=magnification)
    # so little noise that no landing point is corrected
    frame = scene.frame(0, noise_sigma=0.5, depth="stereo", sampling=Sampling(sampling))
    superresolve(frame, replace(settings, noise_sigma=0.5), targets=("cam1", "cam2"))
    assert len(seen) == 2
    for marked, expected in seen:
        assert marked == pytest.approx(expected, abs=1e-9)
        assert marked[1] > marked[0] > 0


def test_the_report_agrees_with_the_intermediates(result):
    assert set(result.debug) == {"cam1", "cam2"}
    for view_id, debug in result.debug.items():
        target = _report(result, view_id)
        assert debug.view_id == view_id
        for view, registered, weight in zip(
            target.views, debug.registered, debug.weights, strict=True
        ):
            assert view.view_id == registered.view_id
            assert view.verified_fraction == pytest.approx(registered.verification_map.mean())
            assert view.weight_fraction == pytest.approx(weight.mean(), abs=1e-5)
            for reason, count in view.rejections.items():
                bit = Rejection[reason.upper()]
                assert count == (registered.flags & bit != 0).sum()
        positions = [registered.position for registered in debug.registered]
        trusted = [registered.verification_map for registered in debug.registered]
        coverage = phase_coverage(positions, trusted, SETTINGS.grid, (HEIGHT, WIDTH))
        assert target.phase_coverage == pytest.approx(100 * coverage)
        assert target.phase_coverage_reference == pytest.approx(25.0)
        assert set(debug.patch_labels) == set(debug.layer_labels) == {"cam0", "cam1", "cam2"}
        for labels in (*debug.patch_labels.values(), *debug.layer_labels.values()):
            assert labels.shape == (HEIGHT, WIDTH)
            assert labels.min() >= -1
        assert debug.contribution_count.shape == (2 * HEIGHT, 2 * WIDTH)
        assert debug.contribution_count.min() >= 0


def test_intermediates_are_kept_on_request_only(frame):
    assert superresolve(_grey(frame), SETTINGS, targets=("cam1",)).debug == {}


def test_the_frame_report_says_what_was_used(frame, result):
    report = result.report
    assert (report.psf_sigma, report.psf_support, report.psf_is_estimated) == (1.0, 7, False)
    assert report.noise_is_estimated
    assert 0.3 < report.noise_sigma < 3
    assert report.frame_index == 0
    assert {"preparation", "registration", "reconstruction", "chroma"} <= set(report.timings)
    assert all(seconds >= 0 for seconds in report.timings.values())
    assert report.warnings == ()
    given = superresolve(_grey(frame), replace(SETTINGS, noise_sigma=2.5), targets=("cam1",))
    assert (given.report.noise_sigma, given.report.noise_is_estimated) == (2.5, False)


def test_noise_given_too_high_smooths(frame, result):
    smooth = superresolve(_grey(frame), replace(SETTINGS, noise_sigma=12), targets=("cam1",))
    roughness = [
        np.abs(np.diff(image.images["cam1"].luma, axis=1)).mean() for image in (smooth, result)
    ]
    assert roughness[0] < 0.8 * roughness[1]


# --- remarks -----------------------------------------------------------------------------


def _remark(frame: MultiViewFrame, **options) -> str:
    result = superresolve(_grey(frame), SETTINGS, targets=("cam1",), **options)
    return _report(result, "cam1").remark


def test_where_all_is_well_nothing_is_remarked(result):
    assert [target.remark for target in result.report.targets] == ["", ""]


def test_a_single_view_is_remarked(frame):
    assert _remark(frame, observed_views=("cam1",)) == "Only the reference view itself was used."


def _other_scene(seed: int) -> np.ndarray:
    """A smooth picture of nothing that the cameras see, without noise of its own."""
    grain = np.random.default_rng(seed).normal(0, 1, (HEIGHT, WIDTH))
    smooth = cv2.GaussianBlur(grain, (0, 0), 2.0)
    return np.clip(128 + 45 * smooth / smooth.std(), 0, 255).astype(np.float32)


def test_views_that_see_nothing_are_named(frame):
    one = _changed(frame, "cam0", luma=_other_scene(0))
    assert _remark(one) == "Nothing of cam0 could be verified."
    both = _changed(one, "cam2", luma=_other_scene(1))
    assert _remark(both) == "No other view sees what this one sees: the result is that of one view."


def test_views_from_the_same_place_are_remarked(frame):
    own = frame.view("cam1")
    noise = np.random.default_rng(1)
    views = tuple(
        replace(
            own, view_id=f"cam{number}",
            luma=(own.luma + noise.normal(0, 1, own.luma.shape)).astype(np.float32),
        )
        for number in range(3)
    )  # fmt: skip
    assert "hardly any new sub-pixel positions" in _remark(replace(frame, views=views))


# --- warnings and poor input -------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "level", "said"),
    [
        ("depth_map", None, "view cam0 has no depth"),
        ("depth_map", np.nan, "all of its depth is unknown"),
        ("depth_map", 2.0, "its depth is constant"),
        ("luma", 0.0, "view cam0 is one flat tone"),
    ],
)
def test_poor_views_are_warned_of_and_do_no_harm(scene, frame, name, level, said):
    flat = None if level is None else np.full((HEIGHT, WIDTH), level, np.float32)
    poor = _grey(_changed(frame, "cam0", **{name: flat}))
    result = superresolve(poor, SETTINGS, targets=("cam1",))
    assert len(result.report.warnings) == 1
    assert said in result.report.warnings[0]
    single = superresolve(
        _grey(frame), SETTINGS, targets=("cam1",), observed_views=("cam1",)
    ).images["cam1"]
    truth = scene.truth(0).hr_luma[1]
    assert psnr(result.images["cam1"].luma, truth, border=12) > psnr(single.luma, truth, border=12)


@pytest.mark.parametrize(("preset", "heeded"), [("default", False), ("a", True)])
def test_layers_that_a_method_does_not_cut_are_warned_of(frame, preset, heeded):
    settings = replace(SETTINGS, registration=preset, layers=5)
    result = superresolve(_grey(frame), settings, targets=("cam1",))
    said = [text for text in result.report.warnings if "--layers" in text]
    assert len(said) == (0 if heeded else 1)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (Settings(sweeps=4), "--sweeps has no effect on --solver fused"),
        (Settings(residual_bound=2.0), "--residual-bound has no effect on --solver fused"),
        (Settings(psf_per_layer=True), "--psf-per-layer has no effect without --psf auto"),
        (Settings(rate=25.0), "--rate has no effect without --realtime"),
        (Settings(solver="pocs", sweeps=4, residual_bound=2.0), None),
        (Settings(temporal="warm", realtime=True, rate=25.0), None),
    ],
)
def test_settings_without_effect_are_said(frame, settings, said):
    result = superresolve(_grey(frame), settings, targets=("cam1",), observed_views=("cam1",))
    assert result.report.warnings == (() if said is None else (said,))


@pytest.mark.parametrize("preset", REGISTRATION_PRESETS)
def test_every_registration_preset_gives_a_picture(scene, preset):
    frame = scene.frame(0, psf_sigma=1.0, noise_sigma=1.0, depth="stereo", calibration=True)
    settings = replace(SETTINGS, registration=preset)
    result = superresolve(frame, settings, targets=("cam1",))
    truth = scene.truth(0).hr_luma[1]
    single = superresolve(frame, settings, targets=("cam1",), observed_views=("cam1",))
    several, one = (psnr(r.images["cam1"].luma, truth, border=12) for r in (result, single))
    assert several > one - 0.02


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (3, 5)])
def test_tiny_frames(shape):
    rng = np.random.default_rng(2)
    views = tuple(
        View(
            view_id=name, luma=rng.uniform(90, 110, shape).astype(np.float32),
            depth_map=rng.uniform(1, 2, shape).astype(np.float32),
        )
        for name in "ab"
    )  # fmt: skip
    frame = MultiViewFrame(frame_index=4, views=views, left="a", right="b")
    for solver in ("fused", "pocs"):
        result = superresolve(frame, Settings(solver=solver), targets=("a", "b"))
        for image in result.images.values():
            assert image.luma.shape == (2 * shape[0], 2 * shape[1])
            assert np.isfinite(image.luma).all()


def test_a_target_that_is_not_observed_is_refused(frame):
    with pytest.raises(SceneError, match=r"view 'cam2', frame 0: .*not among the observed views"):
        superresolve(frame, SETTINGS, targets=("cam1", "cam2"), observed_views=("cam0", "cam1"))


def test_observed_views_limit_what_is_used(frame):
    # without learned filters: where sums come in another order, a pixel may get another one
    settings = replace(SETTINGS, filters="none")
    result = superresolve(
        _grey(frame), settings, targets=("cam1",), observed_views=("cam2", "cam1")
    )
    assert {view.view_id for view in result.report.targets[0].views} == {"cam1", "cam2"}
    without = replace(_grey(frame), views=tuple(_grey(frame).views[1:]))
    alone = superresolve(without, settings, targets=("cam1",))
    # and what descends is rounded to sixteen bits
    np.testing.assert_allclose(alone.images["cam1"].luma, result.images["cam1"].luma, atol=0.03)


# --- stop --------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["fused", "pocs"])
def test_a_stop_at_any_stage_interrupts(frame, solver):
    settings = replace(SETTINGS, solver=solver, sweeps=3)
    small = _grey(frame)
    polls = []

    def count() -> bool:
        polls.append(None)
        return False

    superresolve(small, settings, targets=("cam1",), stop=count)
    assert len(polls) >= 4, "polled between the stages and in the solver"
    for number in {*range(0, len(polls), len(polls) // 4), len(polls) - 1}:
        left = [number]

        def stop(left=left) -> bool:
            left[0] -= 1
            return left[0] < 0

        with pytest.raises(Interrupted):
            superresolve(small, settings, targets=("cam1",), stop=stop)


# --- solvers and settings ----------------------------------------------------------------


@pytest.mark.parametrize("solver", ["pocs", "pocs-simplified"])
def test_the_thesis_solvers_give_the_same_kind_of_result(scene, frame, result, solver):
    settings = replace(SETTINGS, solver=solver, sweeps=4)
    swept = superresolve(_grey(frame), settings, targets=("cam1",), keep_intermediates=True)
    target = _report(swept, "cam1")
    assert (target.solver, target.iterations, len(target.residuals)) == (solver, 4, 4)
    truth = scene.truth(0).hr_luma[1]
    ours, theirs, plain = (
        psnr(image, truth, border=12)
        for image in (
            result.images["cam1"].luma, swept.images["cam1"].luma,
            bicubic(frame.view("cam1").luma, SETTINGS.grid),
        )
    )  # fmt: skip
    assert plain < theirs < ours + 0.2
    for weight, registered in zip(
        swept.debug["cam1"].weights, swept.debug["cam1"].registered, strict=True
    ):
        np.testing.assert_array_equal(weight, registered.verification_map)


def test_settings_replace_what_a_method_has():
    assert chosen_method(Settings(registration="h")).num_layers == 11
    method = chosen_method(Settings(registration="h", layers=4, subregions=2))
    assert (method.num_layers, method.num_subregions) == (4, 2)


def test_an_estimated_psf_is_handed_over(frame):
    settings = replace(SETTINGS, psf="auto", psf_sigma=None, psf_support=None)
    with pytest.raises(ConfigurationError, match="--psf auto"):
        superresolve(_grey(frame), settings, targets=("cam1",))
    psf = GaussianPsf(sigma=1.3, support=9)
    estimated = superresolve(_grey(frame), settings, targets=("cam1",), psf=psf)
    report = estimated.report
    assert (report.psf_sigma, report.psf_support, report.psf_is_estimated) == (1.3, 9, True)
    given = replace(SETTINGS, psf_sigma=1.3, psf_support=9)
    same = superresolve(_grey(frame), given, targets=("cam1",))
    np.testing.assert_array_equal(estimated.images["cam1"].luma, same.images["cam1"].luma)


def test_layers_and_subregions_are_used(frame):
    labels = {}
    for layers, subregions in ((2, 1), (3, 4)):
        settings = replace(SETTINGS, registration="h", layers=layers, subregions=subregions)
        debug = superresolve(
            _grey(frame), settings, targets=("cam1",), keep_intermediates=True
        ).debug["cam1"]
        labels[layers] = np.unique(debug.patch_labels["cam0"])
        assert debug.layer_labels["cam0"].max() <= layers - 1
    assert labels[2].max() <= 1
    assert 4 <= labels[3].max() <= 11


def test_thresholds_of_the_settings_are_used(frame):
    counts = {}
    for name, low, high in (
        ("weight", {"weight_threshold": 1.0}, {"weight_threshold": 50.0}),
        ("depth", {"depth_threshold": 0.005}, {"depth_threshold": 0.9}),
        ("residual", {"residual_threshold": 4.0}, {"residual_threshold": 100.0}),
    ):
        for strictness, changes in (("strict", low), ("lenient", high)):
            report = superresolve(
                _grey(frame), replace(SETTINGS, **changes), targets=("cam1",)
            ).report.targets[0]
            counts[strictness] = sum(view.rejections[name] for view in report.views)
        assert counts["strict"] > 4 * counts["lenient"], name


def test_defaults_follow_the_noise_and_the_magnification():
    assert default_weight_threshold(0.0) > 0
    assert default_weight_threshold(4.0) > default_weight_threshold(1.0)
    assert default_residual_threshold(4.0) > default_residual_threshold(1.0)
    assert default_residual_threshold(1.0) > default_weight_threshold(1.0)
    assert given_psf(Settings()).sigma == 1.0
    assert given_psf(Settings(magnification="4")).sigma == 2.0
    assert given_psf(Settings(magnification="2x1")).sigma == 1.0
    psf = given_psf(Settings(psf_sigma=1.7, psf_support=7))
    assert (psf.sigma, psf.support) == (1.7, 7)
    assert Settings().grid.sampling is Sampling.AREA
