from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from pipeline.errors import ConfigurationError, OutputError
from pipeline.stereo import (
    DUBOIS_LEFT,
    DUBOIS_RIGHT,
    StereoLayout,
    anaglyph,
    pack,
    pad_to_multiple,
    squeeze_height,
    squeeze_width,
    unpack,
)

FULL = (StereoLayout.SBS, StereoLayout.TAB)
HALF = (StereoLayout.HALF_SBS, StereoLayout.HALF_TAB)
SHAPES = st.tuples(st.integers(1, 12), st.integers(1, 17))
SQUEEZE = {"width": squeeze_width, "height": lambda picture: squeeze_height(picture)}


def smooth_picture(height: int, width: int, dtype: type, phase: float = 0.0) -> np.ndarray:
    """Return waves of 16 pixels and more: what half a resolution can hold."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    waves = [np.sin(x / 4 + y / 9 + phase), np.cos(x / 6 - y / 5), np.sin((x + y) / 7 - phase)]
    return ((np.stack(waves, axis=-1) * 0.45 + 0.5) * np.iinfo(dtype).max).astype(dtype)


@given(st.data(), st.sampled_from(FULL), st.sampled_from([np.uint8, np.uint16]), st.booleans())
def test_full_layouts_give_back_both_eyes_bit_for_bit(data, layout, dtype, grey):
    shape = data.draw(SHAPES) if grey else (*data.draw(SHAPES), 3)
    left, right = (data.draw(hnp.arrays(dtype, shape)) for _ in range(2))

    packed = pack(left, right, layout)
    again = unpack(packed, layout)

    assert packed.dtype == dtype
    assert np.array_equal(again[0], left)
    assert np.array_equal(again[1], right)


def test_left_eye_comes_first_side_by_side_and_on_top():
    left, right = np.full((4, 6), 10, np.uint8), np.full((4, 6), 200, np.uint8)

    beside = pack(left, right, StereoLayout.SBS)
    above = pack(left, right, StereoLayout.TAB)

    assert beside.shape == (4, 12)
    assert (beside[:, :6] == 10).all()
    assert above.shape == (8, 6)
    assert (above[:4] == 10).all()


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("layout", HALF)
def test_half_layouts_keep_the_size_of_one_eye_and_the_order_of_eyes(layout, dtype):
    left, right = (smooth_picture(48, 80, dtype, phase) for phase in (0.0, 2.0))

    packed = pack(left, right, layout)
    again = unpack(packed, layout)

    assert packed.shape == left.shape
    assert packed.dtype == dtype
    top = np.iinfo(dtype).max
    for eye, returned in zip((left, right), again, strict=True):
        error = (returned.astype(float) - eye) / top
        assert np.sqrt((error[4:-4, 4:-4] ** 2).mean()) < 0.01
    assert np.abs(again[0].astype(float) - right).mean() > 0.1 * top


@pytest.mark.parametrize(("name", "axis"), [("width", 1), ("height", 0)])
def test_squeezing_removes_what_half_the_size_cannot_hold(name, axis):
    stripes = np.zeros((40, 60), np.uint8)
    stripes[(slice(None), slice(None, None, 2)) if axis else slice(None, None, 2)] = 255

    squeezed = SQUEEZE[name](stripes)

    assert squeezed.shape[axis] == stripes.shape[axis] // 2
    inside = squeezed[6:-6, 6:-6].astype(float)
    assert np.abs(inside - 127.5).max() < 3  # plain decimation would give 0 or 255


@pytest.mark.parametrize(("name", "axis"), [("width", 1), ("height", 0)])
def test_squeezing_moves_nothing(name, axis):
    ramp = np.arange(100, 100 + 80, 2, dtype=np.uint16) * 100
    picture = np.tile(ramp, (30, 1)) if axis else np.tile(ramp[:, None], (1, 30))

    squeezed = SQUEEZE[name](picture)

    between = (ramp[0::2].astype(float) + ramp[1::2]) / 2
    line = squeezed[15] if axis else squeezed[:, 15]
    np.testing.assert_allclose(line[4:-4], between[4:-4], atol=1)


@pytest.mark.parametrize("layout", HALF)
def test_a_constant_picture_stays_constant(layout):
    eye = np.full((7, 9, 3), 201, np.uint8)

    assert (pack(eye, eye, layout) == 201).all()


@pytest.mark.parametrize(
    ("layout", "multiple", "shape"),
    [
        (StereoLayout.SBS, 1, (5, 14)),
        (StereoLayout.SBS, 2, (6, 16)),
        (StereoLayout.TAB, 2, (12, 8)),
        (StereoLayout.HALF_SBS, 1, (5, 8)),
        (StereoLayout.HALF_SBS, 2, (6, 8)),
        (StereoLayout.HALF_TAB, 1, (6, 7)),
        (StereoLayout.HALF_TAB, 2, (8, 8)),
        (StereoLayout.ANAGLYPH, 2, (6, 8)),
        (StereoLayout.LEFT, 2, (6, 8)),
    ],
)
def test_odd_eyes_are_padded_one_by_one(layout, multiple, shape):
    left, right = smooth_picture(5, 7, np.uint8), smooth_picture(5, 7, np.uint8, 1.0)

    packed = pack(left, right, layout, multiple=multiple)

    assert packed.shape[:2] == shape
    if layout.packed:
        eyes = np.split(packed, 2, axis=1 if layout.side_by_side else 0)
        for eye in eyes:
            assert eye.shape[0] % multiple == 0
            assert eye.shape[1] % multiple == 0


def test_padding_repeats_the_last_line_and_column():
    picture = np.arange(15, dtype=np.uint8).reshape(3, 5)

    padded = pad_to_multiple(picture, 2, 4)

    assert padded.shape == (4, 8)
    assert np.array_equal(padded[:3, :5], picture)
    assert np.array_equal(padded[3], padded[2])
    assert (padded[0, 5:] == picture[0, 4]).all()


@pytest.mark.parametrize("shape", [(3, 5), (1, 9), (9, 1), (1, 1), (3, 5, 3)])
@pytest.mark.parametrize(
    "layout", [layout for layout in StereoLayout if layout is not StereoLayout.VIEWS]
)
def test_tiny_pictures_can_be_packed(layout, shape):
    eye = np.full(shape, 77, np.uint8)

    for multiple in (1, 2):
        packed = pack(eye, eye, layout, multiple=multiple)
        assert packed.size > 0
        tolerance = 5 if layout is StereoLayout.ANAGLYPH else 0  # its greys are not quite grey
        assert np.abs(packed.astype(int) - 77).max() <= tolerance


def test_single_eye_layouts_take_the_right_eye():
    left, right = np.zeros((4, 6, 3), np.uint8), np.full((4, 6, 3), 9, np.uint8)

    assert (pack(left, right, StereoLayout.LEFT) == 0).all()
    assert (pack(left, right, StereoLayout.RIGHT) == 9).all()


def dubois_in_slow_motion(left: tuple, right: tuple) -> list[float]:
    """Return one anaglyph pixel by the steps of the note, in plain Python, 0..255."""

    def decode(value: float) -> float:
        value /= 255
        return value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4

    def encode(light: float) -> float:
        code = light * 12.92 if light <= 0.0031308 else 1.055 * light ** (1 / 2.4) - 0.055
        return 255 * code

    pixel = []
    for row in range(3):
        light = 0.0
        for eye, matrix in ((left, DUBOIS_LEFT), (right, DUBOIS_RIGHT)):
            part = sum(float(matrix[row, c]) * decode(eye[c]) for c in range(3))
            light += min(max(part, 0.0), 1.0)
        pixel.append(encode(min(light, 1.0)))
    return pixel


def test_anaglyph_follows_the_published_steps():
    rng = np.random.default_rng(7)
    left, right = (rng.integers(0, 256, (3, 5, 3), dtype=np.uint8) for _ in range(2))

    mixed = anaglyph(left, right)

    for index in np.ndindex(3, 5):
        expected = dubois_in_slow_motion(tuple(left[index]), tuple(right[index]))
        np.testing.assert_allclose(mixed[index], expected, atol=0.51)


def test_anaglyph_shows_red_to_the_left_eye_and_cyan_to_the_right():
    white, black = np.full((2, 3, 3), 255, np.uint8), np.zeros((2, 3, 3), np.uint8)

    assert (anaglyph(white, black) == (255, 0, 0)).all()
    assert (anaglyph(black, white) == (0, 255, 255)).all()


def test_anaglyph_keeps_grey_grey_at_zero_disparity():
    grey = np.tile(np.arange(0, 256, 5, dtype=np.uint8), (3, 1))

    mixed = anaglyph(grey, grey).astype(int)

    assert mixed.shape == (*grey.shape, 3)
    # The negative parts of one eye's matrix are clipped before adding, so light is a bit over.
    assert np.ptp(mixed, axis=2).max() <= 18
    assert np.abs(mixed[..., 0] - grey).max() <= 6


def test_anaglyph_of_16_bits_agrees_with_that_of_8():
    left, right = smooth_picture(6, 10, np.uint8), smooth_picture(6, 10, np.uint8, 1.0)

    narrow = anaglyph(left, right)
    wide = anaglyph(left.astype(np.uint16) * 257, right.astype(np.uint16) * 257)

    assert wide.dtype == np.uint16
    assert np.abs(wide / 257 - narrow).max() <= 0.51


def test_unpacking_stretches_like_a_bicubic_resize():
    left, right = smooth_picture(10, 16, np.uint8), smooth_picture(10, 16, np.uint8, 1.0)
    packed = pack(left, right, StereoLayout.HALF_TAB)

    first, second = unpack(packed, StereoLayout.HALF_TAB)

    assert first.shape == second.shape == left.shape
    stretched = cv2.resize(packed[:5], (16, 10), interpolation=cv2.INTER_CUBIC)
    assert np.array_equal(first, stretched)


def test_eyes_of_two_sizes_are_refused():
    with pytest.raises(OutputError, match=r"left eye is 6×4 uint8, right eye is 5×4 uint8"):
        pack(np.zeros((4, 6), np.uint8), np.zeros((4, 5), np.uint8), StereoLayout.SBS)
    with pytest.raises(OutputError, match="uint16"):
        anaglyph(np.zeros((4, 6), np.uint8), np.zeros((4, 6), np.uint16))


def test_layouts_that_are_no_pair_are_refused():
    eye = np.zeros((4, 6), np.uint8)
    with pytest.raises(ConfigurationError, match="views"):
        pack(eye, eye, StereoLayout.VIEWS)
    with pytest.raises(ConfigurationError, match="anaglyph"):
        unpack(eye, StereoLayout.ANAGLYPH)
    with pytest.raises(OutputError, match="width 7 is odd"):
        unpack(np.zeros((4, 7), np.uint8), StereoLayout.SBS)
