"""Registration of whole frames, held against the rendered scene's true motion."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest

from pipeline.errors import SceneError
from pipeline.frames import MultiViewFrame, Rejection, View
from pipeline.registration.method import METHODS, MotionModel, RegistrationMethod
from pipeline.registration.register import (
    Terms,
    Thresholds,
    ViewRegistration,
    prepare_views,
    register_views,
)
from pipeline.synthetic import SampleScene
from pipeline.threads import set_threads, thread_count

NOISE = 1.0
THRESHOLDS = Thresholds(weight=6.0, depth=0.1)


@dataclass(frozen=True)
class Truth:
    """A frame as a real rig delivers it, and its scene."""

    scene: SampleScene
    frame: MultiViewFrame


def _rendered(width: int, height: int, **options) -> Truth:
    of_frame = {"calibration": options.pop("calibration", False)}
    scene = SampleScene(width=width, height=height, num_views=4, **options)
    frame = scene.frame(0, psf_sigma=1.0, noise_sigma=NOISE, depth="stereo", **of_frame)
    return Truth(scene, frame)


@pytest.fixture(scope="module")
def small() -> Truth:
    return _rendered(160, 112)


@pytest.fixture(scope="module")
def calibrated() -> Truth:
    return _rendered(160, 112, calibration=True)


@pytest.fixture(scope="module")
def wide() -> Truth:
    """Disparities up to a tenth of the width, rotations of two degrees."""
    return _rendered(256, 192, max_disparity=24.0, rotation_degrees=2.0)


def _register(
    frame: MultiViewFrame, method: str | RegistrationMethod = "default", *, targets=None,
    sources=None,
) -> dict[str, list[ViewRegistration]]:  # fmt: skip
    ids = tuple(view.view_id for view in frame.views)
    prepared = prepare_views(frame.views, metric=frame.depth_is_metric)
    return register_views(
        prepared, targets or (frame.left, frame.right), sources or ids,
        Terms(
            method=METHODS[method] if isinstance(method, str) else method, noise=NOISE,
            thresholds=THRESHOLDS,
        ),
    )  # fmt: skip


def _errors(truth: Truth, target: int, registrations: list[ViewRegistration]) -> np.ndarray:
    """End-point errors of all verified pixels of the other views, LR pixels."""
    errors = []
    for number, registration in enumerate(registrations):
        if number == target:
            continue
        away = registration.registered.position - truth.scene.true_motion(number, target).position
        errors.append(np.linalg.norm(away, axis=-1)[registration.registered.verification_map])
    return np.concatenate(errors)


# --- how exact ---------------------------------------------------------------------------


def _all_errors(truth: Truth, found: dict[str, list[ViewRegistration]]) -> np.ndarray:
    left, right = truth.scene.reference_views
    assert list(found) == [truth.frame.left, truth.frame.right]
    return np.concatenate(
        [
            _errors(truth, left, found[truth.frame.left]),
            _errors(truth, right, found[truth.frame.right]),
        ]
    )


def test_verified_pixels_land_where_they_should(wide):
    """A quarter of a real rig's pixels, so that edges count twice as much as there."""
    found = _register(wide.frame)
    errors = _all_errors(wide, found)
    assert np.median(errors) <= 0.035
    assert np.percentile(errors, 95) <= 0.25
    assert (errors > 0.5).mean() <= 0.015
    for registrations in found.values():
        for registration in registrations:
            assert registration.registered.verification_map.mean() > 0.6


def test_a_second_reference_is_registered_as_well_through_the_first(wide):
    """Chained through the first reference, against registered on its own."""
    _, right = wide.scene.reference_views
    chained = _register(wide.frame)[wide.frame.right]
    direct = _register(wide.frame, targets=(wide.frame.right,))[wide.frame.right]
    errors, alone = (_errors(wide, right, found) for found in (chained, direct))
    assert np.median(errors) <= 1.2 * np.median(alone)
    assert (errors > 0.5).mean() <= (alone > 0.5).mean() + 0.005
    assert len(errors) >= 0.97 * len(alone)


def test_calibration_helps_and_does_not_need_the_images_to_start(calibrated, small):
    errors = _all_errors(calibrated, _register(calibrated.frame))
    uncalibrated = _all_errors(small, _register(small.frame))
    assert np.median(errors) <= 0.04
    assert np.median(errors) <= 1.1 * np.median(uncalibrated)
    assert (errors > 0.5).mean() <= 0.045


def test_refinement_is_better_than_calibration_alone(wide):
    """The depth is 8 bit, noisy and wrong at edges: mapping by it alone is not sub-pixel."""
    frame = wide.scene.frame(0, psf_sigma=1.0, noise_sigma=NOISE, depth="stereo", calibration=True)
    alone = _all_errors(wide, _register(frame, "calibration-only"))
    refined = _all_errors(wide, _register(frame))
    assert np.median(refined) < 0.75 * np.median(alone)
    assert np.percentile(refined, 95) < 0.75 * np.percentile(alone, 95)


def test_displacements_differ_along_x_and_y(wide):
    """What is tested here is not a shift along x alone."""
    motion = wide.scene.true_motion(0, wide.scene.reference_views[0]).displacement
    spread = np.percentile(motion, 95, axis=(0, 1)) - np.percentile(motion, 5, axis=(0, 1))
    assert spread[0] > 5
    assert spread[1] > 1


# --- all methods -------------------------------------------------------------------------

MEDIAN_ERROR = {
    "default": 0.05, "calibration-only": 0.08,
    **dict.fromkeys("efhjkl", 0.1), **dict.fromkeys("abcdg", 0.4),
}  # fmt: skip
"""LR pixels. One layer (a, c) or mere translation (b, d, g) is too poor for slanted surfaces."""


@pytest.mark.parametrize("name", list(METHODS))
def test_every_method_registers_something_and_says_what(calibrated, name):
    frame = calibrated.frame
    found = _register(frame, name)
    assert np.median(_all_errors(calibrated, found)) < MEDIAN_ERROR[name]
    for target, registrations in found.items():
        assert [item.registered.view_id for item in registrations] == ["cam0", "cam1", "cam2",
                                                                      "cam3"]  # fmt: skip
        for item in registrations:
            view = item.registered
            assert view.is_reference == (view.view_id == target)
            assert view.flags.shape == view.observed.shape == view.position.shape[:2] == (112, 160)
            has_motion = np.isfinite(view.position).all(axis=-1)
            np.testing.assert_array_equal(has_motion, view.flags & Rejection.NO_MOTION == 0)
            assert has_motion.mean() > 0.9
            assert view.verification_map.mean() > 0.1
            assert not view.flags.any() if view.is_reference else view.flags.any()
            trusted = np.abs(view.registration_weights[view.verification_map])
            assert np.median(trusted) < THRESHOLDS.weight
            assert ((view.confidence >= 0) & (view.confidence <= 1)).all()


@pytest.mark.parametrize("name", ["e", "calibration-only"])
def test_methods_that_need_calibration_say_so(small, name):
    with pytest.raises(SceneError, match=r"view 'cam\d': .*calibrat.*--registration"):
        _register(small.frame, name)


@pytest.mark.parametrize("model", list(MotionModel))
@pytest.mark.parametrize("base", ["default", "h"])
def test_models_and_destination_support_can_be_combined_freely(small, base, model):
    method = replace(METHODS[base], model=model, destination_support=True)
    found = _register(small.frame, method, targets=(small.frame.left,))
    errors = _errors(small, small.scene.reference_views[0], found[small.frame.left])
    assert np.median(errors) < (0.12 if base == "default" else 1.0)


def test_windows_of_translation_alone_do_not_lean(wide):
    """A slanted surface is shifted by each as a whole: no slope, and less exact for it."""
    found = {
        model: _register(wide.frame, replace(METHODS["default"], model=model))
        for model in (MotionModel.TRANSLATION, MotionModel.AFFINE)
    }
    for registrations in found[MotionModel.TRANSLATION].values():
        for item in registrations:
            if not item.registered.is_reference:
                assert np.abs(item.motions.motion[:, [1, 2, 7, 8]]).max() < 1e-3
    shifted, affine = (np.median(_all_errors(wide, one)) for one in found.values())
    assert affine < 0.75 * shifted


def test_an_intensity_offset_between_views_is_taken_off(small):
    """A camera that exposes 5 grey levels more: its pixels come back at the reference's level."""
    views = list(small.frame.views)
    views[0] = replace(views[0], luma=np.minimum(views[0].luma + 5, 255).astype(np.float32))
    brighter = replace(small.frame, views=tuple(views))
    target = (small.frame.left,)
    plain, shifted = (
        _register(frame, targets=target)[small.frame.left][0].registered
        for frame in (small.frame, brighter)
    )
    moved = np.linalg.norm(shifted.position - plain.position, axis=-1)
    assert np.median(moved) < 0.01
    trusted = plain.verification_map & shifted.verification_map
    assert trusted.mean() > 0.7
    assert np.median(np.abs(shifted.observed - plain.observed)[trusted]) < 0.3


# --- references and sources --------------------------------------------------------------


def test_the_reference_is_its_own_unmoved_observation(small):
    own = _register(small.frame)[small.frame.left][1].registered
    assert own.is_reference
    assert not own.flags.any()
    assert not own.registration_weights.any()
    x, y = np.meshgrid(np.arange(160), np.arange(112))
    np.testing.assert_array_equal(own.position, np.stack([x, y], axis=-1))
    np.testing.assert_array_equal(own.observed, small.frame.view(small.frame.left).luma)


def test_sources_come_back_in_their_order_and_targets_need_not_be_among_them(small):
    found = _register(small.frame, targets=("cam3", "cam0"), sources=("cam2", "cam1"))
    assert list(found) == ["cam3", "cam0"]
    for registrations in found.values():
        assert [item.registered.view_id for item in registrations] == ["cam2", "cam1"]
        for item in registrations:
            assert item.registered.verification_map.mean() > 0.5


def test_registering_again_or_on_another_number_of_threads_changes_no_bit(small):
    before = thread_count()
    try:
        results = []
        for threads in (1, 2):
            set_threads(threads)
            results.append(_register(small.frame))
    finally:
        set_threads(before)
    for target, registrations in results[0].items():
        for one, two in zip(registrations, results[1][target], strict=True):
            for name in ("position", "flags", "observed", "registration_weights"):
                np.testing.assert_array_equal(
                    getattr(one.registered, name), getattr(two.registered, name)
                )


# --- poor input --------------------------------------------------------------------------


def _with_view(frame: MultiViewFrame, number: int, **changes) -> MultiViewFrame:
    views = list(frame.views)
    views[number] = replace(views[number], **changes)
    return replace(frame, views=tuple(views))


@pytest.mark.parametrize("name", ["default", "h"])
def test_a_black_view_is_flagged_and_harms_no_other(small, name):
    black = _with_view(small.frame, 3, luma=np.zeros((112, 160), np.float32))
    left = small.frame.left
    found, plain = (_register(frame, name, targets=(left,))[left] for frame in (black, small.frame))
    assert found[3].registered.verification_map.mean() < 0.05
    for number in range(3):
        np.testing.assert_array_equal(
            found[number].registered.position, plain[number].registered.position
        )


def test_a_black_first_reference_does_not_spoil_the_second(small):
    left, right = small.scene.reference_views
    black = _with_view(small.frame, left, luma=np.zeros((112, 160), np.float32))
    chained = _register(black)[black.right]
    direct = _register(black, targets=(black.right,))[black.right]
    assert chained[left].registered.verification_map.mean() < 0.05
    errors, alone = (
        _errors(small, right, [found[number] for number in range(len(found))])
        for found in (chained, direct)
    )
    assert np.median(errors) <= 1.2 * np.median(alone)
    assert len(errors) >= 0.95 * len(alone)


@pytest.mark.parametrize("depth", ["none", "unknown", "flat", "mostly unknown"])
@pytest.mark.parametrize("number", [0, 1])
def test_poor_depth_is_one_layer_and_no_reason_to_stop(small, depth, number):
    depth_map = None
    if depth != "none":
        depth_map = np.full((112, 160), 0.3 if depth == "flat" else np.nan, np.float32)
        if depth == "mostly unknown":
            depth_map[50:60, 70:90] = small.frame.views[number].depth_map[50:60, 70:90]
    frame = _with_view(small.frame, number, depth_map=depth_map)
    for target, registrations in _register(frame).items():
        for item in registrations:
            view = item.registered
            assert not (view.is_reference and view.flags.any())
            assert view.verification_map.mean() > 0.25, (target, view.view_id)
            if not view.is_reference and depth in ("none", "unknown", "flat"):
                touched = frame.views[number].view_id in (view.view_id, target)
                assert not (touched and (view.flags & Rejection.DEPTH).any())


@pytest.mark.parametrize("name", ["default", *"abcdfghjkl"])
@pytest.mark.parametrize("shape", [(3, 5), (1, 23), (23, 1), (1, 1), (9, 14)])
def test_tiny_images_are_registered_or_flagged(name, shape):
    rng = np.random.default_rng(7)
    views = tuple(
        View(
            view_id=view_id,
            luma=rng.uniform(0, 255, shape).astype(np.float32),
            depth_map=rng.uniform(1, 2, shape).astype(np.float32),
        )
        for view_id in ("a", "b", "c")
    )
    frame = MultiViewFrame(frame_index=0, views=views, left="a", right="b")
    found = _register(frame, name)
    for target, registrations in found.items():
        for item in registrations:
            view = item.registered
            assert view.flags.shape == shape
            assert view.is_reference == (view.view_id == target)
            assert not view.is_reference or not view.flags.any()
            without = ~np.isfinite(view.position).all(axis=-1)
            assert (view.flags[without] & Rejection.NO_MOTION != 0).all()


def test_views_of_other_scenes_are_not_trusted(small):
    """Noise in place of a picture: what is verified is left to chance."""
    luma = np.random.default_rng(3).uniform(0, 255, (112, 160)).astype(np.float32)
    frame = _with_view(small.frame, 0, luma=luma)
    found = _register(frame, targets=(frame.left,))[frame.left][0].registered
    assert found.verification_map.mean() < 0.02
