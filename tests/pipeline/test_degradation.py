from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.degradation import (
    Degradation,
    degrade_frame,
    degrade_image,
    eight_bit_luma,
    gaussian_taps,
)
from pipeline.errors import ConfigurationError, SceneError
from pipeline.frames import Calibration, MultiViewFrame, View


def _frame(height: int = 13, width: int = 22, **options) -> MultiViewFrame:
    rng = np.random.default_rng(11)
    calibration = Calibration(
        intrinsics=np.array([[90.0, 0, 10.5], [0, 80.0, 6.0], [0, 0, 1]]), world_to_camera=np.eye(4)
    )
    views = tuple(
        View(
            view_id=name,
            luma=rng.integers(0, 256, (height, width)).astype(np.float32),
            depth_map=rng.uniform(5, 50, (height, width)).astype(np.float32),
            calibration=calibration,
        )
        for name in ("a", "b")
    )
    return MultiViewFrame(frame_index=3, views=views, left="a", right="b", **options)


def _colour_view(colours: np.ndarray) -> View:
    """A view as the readers make it: unrounded luma and chroma, float32."""
    blue, green, red = np.moveaxis(colours.astype(np.float32), -1, 0)
    luma = np.float32(0.299) * red + np.float32(0.587) * green + np.float32(0.114) * blue
    chroma = np.stack(
        ((blue - luma) / np.float32(1.772) + 128, (red - luma) / np.float32(1.402) + 128), axis=-1
    )
    return View(view_id="a", luma=luma, chroma=chroma.astype(np.float32))


def test_gaussian_by_hand():
    taps = gaussian_taps(1.0, 3)
    side = np.exp(-0.5)
    np.testing.assert_allclose(taps, np.array([side, 1, side]) / (1 + 2 * side))
    assert gaussian_taps(1.7, 7).sum() == pytest.approx(1)
    assert gaussian_taps(1.7, 1).tolist() == [1.0]


def test_eight_bit_luma_is_opencvs_for_random_colours():
    colours = np.random.default_rng(2).integers(0, 256, (300, 401, 3), dtype=np.uint8)
    expected = cv2.cvtColor(colours, cv2.COLOR_BGR2GRAY)
    np.testing.assert_array_equal(eight_bit_luma(_colour_view(colours)), expected)


def test_blur_is_the_direct_sum_with_a_reflecting_border():
    image = np.random.default_rng(1).integers(0, 256, (8, 12), dtype=np.uint8)
    settings = Degradation(psf_sigma=1.3, psf_support=5)
    result = degrade_image(image, settings)
    taps = gaussian_taps(1.3, 5)
    padded = np.pad(image.astype(float), 2, mode="reflect")
    for row, column in ((0, 0), (1, 2), (3, 5), (2, 4)):
        window = padded[2 * row : 2 * row + 5, 2 * column : 2 * column + 5]
        assert result[row, column] == np.rint((np.outer(taps, taps) * window).sum())


def test_without_blur_decimation_keeps_every_kth_pixel():
    frame = _frame()
    degraded = degrade_frame(
        frame, Degradation(magnification_x=3, magnification_y=2, psf_support=1)
    )
    assert degraded.frame.lr_shape == (6, 7)
    assert degraded.truth["b"].shape == (12, 21)
    expected = frame.view("b").luma[:12:2, :21:3]
    np.testing.assert_array_equal(degraded.frame.view("b").luma, expected)


def test_disparity_and_intrinsics_shrink_with_the_pixels():
    frame = _frame()
    view = degrade_frame(frame, Degradation()).frame.view("a")
    expected = frame.view("a").depth_map[:12:2, ::2] / 2
    np.testing.assert_allclose(view.depth_map, expected)
    np.testing.assert_allclose(view.calibration.intrinsics, [[45, 0, 5.25], [0, 40, 3], [0, 0, 1]])


def test_metric_nearness_keeps_its_values():
    frame = _frame(depth_is_metric=True)
    view = degrade_frame(frame, Degradation()).frame.view("a")
    np.testing.assert_array_equal(view.depth_map, frame.view("a").depth_map[:12:2, ::2])


def test_a_point_keeps_its_camera_ray():
    """HR pixel (K·i, K·j) and LR pixel (i, j) look along one ray."""
    frame = _frame()
    degraded = degrade_frame(frame, Degradation(magnification_x=2, magnification_y=3))
    for view, point in ((frame.view("a"), (8, 6)), (degraded.frame.view("a"), (4, 2))):
        ray = np.linalg.inv(view.calibration.intrinsics) @ [*point, 1]
        np.testing.assert_allclose(ray, [(8 - 10.5) / 90, 0, 1])


def test_noise_has_its_size_and_its_seed():
    flat = np.full((200, 301), 128, np.uint8)
    settings = Degradation(magnification_x=1, magnification_y=1, noise_sigma=3, seed=7)
    noisy = degrade_image(flat, settings, np.random.default_rng(1))
    assert noisy.std() == pytest.approx(np.hypot(3, np.sqrt(1 / 12)), rel=0.02)
    assert noisy.mean() == pytest.approx(128, abs=0.05)
    frame = _frame()
    once, again = degrade_frame(frame, settings), degrade_frame(frame, settings)
    other = degrade_frame(
        frame, Degradation(noise_sigma=3, seed=8, magnification_x=1, magnification_y=1)
    )
    luma = once.frame.view("a").luma
    np.testing.assert_array_equal(luma, again.frame.view("a").luma)
    assert np.any(luma != other.frame.view("a").luma)
    noise = [degrade_frame(frame, settings).frame.view(v).luma - frame.view(v).luma for v in "ab"]
    assert np.any(noise[0] != noise[1])


def test_result_is_whole_grey_levels_within_range():
    frame = degrade_frame(_frame(), Degradation(noise_sigma=40)).frame
    luma = frame.view("a").luma
    assert luma.dtype == np.float32
    assert luma.min() >= 0
    assert luma.max() <= 255
    np.testing.assert_array_equal(luma, np.rint(luma))
    assert frame.bit_depth == 8


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"psf_support": 4}, "--psf-support: must be an odd number"),
        ({"psf_sigma": 0.0}, "--psf-sigma"),
        ({"noise_sigma": -1.0}, "--noise"),
        ({"magnification_x": 0}, "--magnification"),
        ({"seed": -1}, "--seed"),
    ],
)
def test_impossible_settings_are_refused(options, said):
    with pytest.raises(ConfigurationError, match=said):
        Degradation(**options)


def test_image_too_small_is_refused():
    with pytest.raises(ConfigurationError, match="too wide for an image of 22×12"):
        degrade_frame(_frame(), Degradation(psf_support=25))
    with pytest.raises(SceneError, match="too few to decimate"):
        degrade_frame(_frame(height=1), Degradation())
