from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.baselines import bicubic
from pipeline.config import Settings
from pipeline.debug_pictures import (
    REASONS,
    TRUSTED,
    choose_crops,
    crops_picture,
    verification_colours,
    write_debug_pictures,
)
from pipeline.drawing import curve_plot, diverging, heat, label_colours, text_width, titled
from pipeline.errors import Interrupted
from pipeline.frames import RegisteredView, Rejection
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage, TargetDebug

NAMES = (
    "layers", "patches", "registration-weights", "verification", "solver-weights",
    "contributions", "before-after",
)  # fmt: skip


def _result(height: int, width: int, view_ids: tuple[str, ...]) -> FrameResult:
    rng = np.random.default_rng(6)
    reference = view_ids[0]
    registered = tuple(
        RegisteredView(
            view_id=view_id,
            observed=rng.uniform(0, 255, (height, width)).astype(np.float32),
            position=np.full((height, width, 2), np.nan, np.float32),
            registration_weights=rng.normal(0, 9, (height, width)).astype(np.float32),
            flags=rng.integers(0, 128, (height, width)).astype(np.uint8),
            confidence=np.ones((height, width), np.float32),
            is_reference=view_id == reference,
        )
        for view_id in view_ids
    )
    labels = {
        view_id: rng.integers(-1, 5, (height, width)).astype(np.int32) for view_id in view_ids
    }
    grid = Settings().grid
    debug = TargetDebug(
        view_id=reference,
        registered=registered,
        weights=tuple(view.confidence for view in registered),
        patch_labels=labels,
        layer_labels=labels,
        contribution_count=rng.uniform(0, 8, grid.hr_shape((height, width))).astype(np.float32),
    )
    image = SuperResolvedImage(view_id=reference, luma=bicubic(registered[0].observed, grid) + 9)
    report = FrameReport(
        frame_index=4, noise_sigma=1.0, noise_is_estimated=True, psf_sigma=1.0, psf_support=7,
        psf_is_estimated=False, targets=(), timings={},
    )  # fmt: skip
    return FrameResult(
        frame_index=4, images={reference: image}, report=report, debug={reference: debug}
    )


@pytest.mark.parametrize(("height", "width"), [(40, 57), (3, 5), (1, 9), (200, 611)])
def test_all_pictures_are_written_whatever_the_size(tmp_path, height, width):
    written = write_debug_pictures(
        tmp_path, _result(height, width, ("left eye/0", "b", "c", "d", "e", "f")), Settings().grid
    )
    assert [path.name for path in written] == [
        f"frame-000004-left_eye_0-{name}.png" for name in NAMES
    ]
    for path in written:
        picture = cv2.imread(str(path))
        assert picture is not None
        assert picture.shape[1] < 2000
        assert picture.std() > 3, f"{path.name} is empty"


def test_a_single_view_has_pictures_of_itself_only(tmp_path):
    written = write_debug_pictures(tmp_path, _result(20, 31, ("a",)), Settings().grid)
    names = {path.stem.split("a-", 1)[1] for path in written}
    assert names == {"layers", "patches", "solver-weights", "contributions", "before-after"}


def test_a_stop_is_heeded_before_each_picture(tmp_path):
    """All of a large frame take seconds."""
    left = iter(range(3))

    def check():
        if next(left, None) is None:
            raise Interrupted

    with pytest.raises(Interrupted):
        write_debug_pictures(tmp_path, _result(20, 31, ("a", "b")), Settings().grid, check=check)
    assert len(list(tmp_path.iterdir())) == 3


def test_every_reason_has_a_colour_of_its_own():
    assert {reason for reason, _, _ in REASONS} == set(Rejection)
    colours = {TRUSTED, *(colour for _, colour, _ in REASONS)}
    assert len(colours) == len(REASONS) + 1
    flags = np.array([[0, *(reason.value for reason, _, _ in REASONS)]], np.uint8)
    shown = [tuple(int(v) for v in pixel) for pixel in verification_colours(flags)[0]]
    assert shown == [TRUSTED, *(colour for _, colour, _ in REASONS)]


def test_crops_lie_inside_apart_and_where_the_difference_is():
    before = np.zeros((90, 140), np.float32)
    after = before.copy()
    after[50:60, 100:110] = 80
    after[5:10, 5:10] = 60
    crops = choose_crops(before, after, size=24, count=3)
    assert len(crops) == 3
    top, left, height, width = crops[0]
    assert (height, width) == (24, 24)
    assert top <= 50
    assert top + 24 >= 60
    assert left <= 100
    assert left + 24 >= 110
    covered = np.zeros_like(before)
    for top, left, height, width in crops:
        assert 0 <= top <= 90 - height
        assert 0 <= left <= 140 - width
        covered[top : top + height, left : left + width] += 1
    assert covered.max() == 1
    assert covered[7, 7] == 1


def test_crops_of_colour_and_grey_stand_side_by_side():
    grey, colour = np.full((30, 50), 7.0), np.full((30, 50, 3), (200, 10, 30))
    picture = crops_picture({"grey": grey, "colour": colour}, [(0, 0, 20, 30), (5, 5, 20, 30)])
    assert picture.shape[1] == 2 * 30 * 4 + 12
    assert tuple(picture[-1, -1]) == (200, 10, 30)
    assert tuple(picture[-1, 0]) == (7, 7, 7)


def test_colours_mean_what_they_should():
    assert len({tuple(colour) for colour in label_colours(40).tolist()}) == 40
    low, middle, high, unknown = diverging(np.array([[-5.0, 0.0, 5.0, np.nan]]), 5.0)[0].tolist()
    assert low[2] > low[0]
    assert min(middle) > 240
    assert high[0] > high[2]
    assert unknown == [150, 150, 150]
    brightness = heat(np.linspace(0, 1, 9)[np.newaxis], 1.0)[0].astype(int).sum(axis=1)
    assert (np.diff(brightness) > 0).all()


def test_a_long_title_is_cut_to_fit():
    canvas = np.zeros((10, 60, 3), np.uint8)
    long = titled(canvas, "a title that is much too long for it")
    assert long.shape == (36, 60, 3)
    assert text_width("ab") < text_width("abc")


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ([0.5, 1.0, 1.5], [3.0, 1.0, 2.0]),
        ([1.0], [5.0]),
        ([1.0, 2.0], [7.0, 7.0]),
        ([1.0], [float("nan")]),
    ],
)
def test_curves_are_drawn_whatever_the_values(x, y):
    plot = curve_plot(x, y, title="PSF", x_label="σ", y_label="error", marked=1.0)
    assert plot.shape == (440, 720, 3)
    assert plot.std() > 3
