from __future__ import annotations

import cv2
import numpy as np
import pytest

from pipeline.colour import RGB_TO_YCC, Picture, picture_from_rgb
from pipeline.colour import to_rgb as rgb_of
from pipeline.grid import Grid, Sampling
from pipeline.media.coded import coded
from pipeline.media.colorimetry import BT2020
from pipeline.media.ycbcr import YcbcrMatrix, matrix_for, to_yuv420
from pipeline.superresolve.colours import EnlargedColour

COLOURS = np.array(
    [
        (0, 0, 0),
        (255, 255, 255),
        (255, 0, 0),
        (0, 255, 0),
        (0, 0, 255),
        (220, 40, 60),
        (17, 99, 203),
    ]
)

PRIMARIES = {
    # Y'CbCr of white, red, green and blue, 8 bits (ITU-R BT.601-7, BT.709-6, BT.2020-2).
    YcbcrMatrix.BT601: {1: (235, 128, 128), 2: (81, 90, 240), 3: (145, 54, 34), 4: (41, 240, 110)},
    YcbcrMatrix.BT709: {1: (235, 128, 128), 2: (63, 102, 240), 3: (173, 42, 26), 4: (32, 240, 118)},
    YcbcrMatrix.BT2020: {1: (235, 128, 128), 2: (74, 97, 240), 3: (164, 47, 25), 4: (29, 240, 119)},
}

RED_BLUE = {
    YcbcrMatrix.BT601: (0.299, 0.114),
    YcbcrMatrix.BT709: (0.2126, 0.0722),
    YcbcrMatrix.BT2020: (0.2627, 0.0593),
}


def patch(colour: np.ndarray, dtype: type = np.uint8) -> np.ndarray:
    scale = 257 if dtype == np.uint16 else 1
    return np.broadcast_to(colour * scale, (6, 10, 3)).astype(dtype)


def to_rgb(code: np.ndarray, matrix: YcbcrMatrix, bits: int) -> np.ndarray:
    """Return RGB 0..255 by the standard's own formulas, the other way round."""
    red, blue = RED_BLUE[matrix]
    y, cb, cr = code / 2.0 ** (bits - 8)
    luma, blue_difference, red_difference = (y - 16) / 219, (cb - 128) / 224, (cr - 128) / 224
    r = luma + 2 * (1 - red) * red_difference
    b = luma + 2 * (1 - blue) * blue_difference
    g = (luma - red * r - blue * b) / (1 - red - blue)
    return 255 * np.array([r, g, b])


@pytest.mark.parametrize("matrix", list(YcbcrMatrix))
def test_primaries_get_the_code_values_of_the_standard(matrix):
    for index, expected in PRIMARIES[matrix].items():
        planes = to_yuv420(patch(COLOURS[index]), matrix, coded_bits=8)
        found = [int(plane[0, 0]) for plane in planes]
        assert np.abs(np.subtract(found, expected)).max() <= 1, (index, found)


@pytest.mark.parametrize("matrix", list(YcbcrMatrix))
@pytest.mark.parametrize(("dtype", "bits", "tolerance"), [(np.uint8, 8, 1.6), (np.uint16, 10, 0.5)])
def test_colours_come_back_by_the_inverse_formula(matrix, dtype, bits, tolerance):
    for colour in COLOURS:
        planes = to_yuv420(patch(colour, dtype), matrix, coded_bits=bits)
        code = np.array([plane[1, 2] for plane in planes], float)
        np.testing.assert_allclose(to_rgb(code, matrix, bits), colour, atol=tolerance)


def test_16_bit_pictures_can_be_coded_with_8_bits():
    colour = COLOURS[5]
    narrow = to_yuv420(patch(colour), YcbcrMatrix.BT709, coded_bits=8)
    wide = to_yuv420(patch(colour, np.uint16), YcbcrMatrix.BT709, coded_bits=8)

    for ours, theirs in zip(wide, narrow, strict=True):
        assert ours.dtype == np.uint8
        assert np.abs(ours.astype(int) - theirs).max() <= 1


@pytest.mark.parametrize(("dtype", "bits"), [(np.uint8, 8), (np.uint16, 8), (np.uint16, 10)])
def test_grey_has_neutral_chroma_and_the_whole_limited_range(dtype, bits):
    ramp = np.tile(np.linspace(0, np.iinfo(dtype).max, 24).astype(dtype), (4, 1))

    luma, *chroma = to_yuv420(ramp, YcbcrMatrix.BT601, coded_bits=bits)

    scale = 2 ** (bits - 8)
    assert (luma[0, 0], luma[0, -1]) == (16 * scale, 235 * scale)
    assert (np.diff(luma[0].astype(int)) > 0).all()
    for plane in chroma:
        assert plane.shape == (2, 12)
        assert (plane == 128 * scale).all()


def test_chroma_sits_on_even_columns_and_between_rows():
    picture = np.zeros((4, 12, 3), np.uint8)
    picture[:, 6:, 2] = 255  # blue from column 6 on

    _, blue_difference, _ = to_yuv420(picture, YcbcrMatrix.BT709, coded_bits=8)

    # Column 6 is the first blue one: its sample, at index 3, takes a quarter from column 5.
    row = blue_difference[0].astype(float)
    assert row[2] == 128
    assert row[4] == 240
    assert row[3] == pytest.approx(128 + 0.75 * 112, abs=1)


def test_the_matrix_goes_by_the_number_of_lines():
    assert matrix_for(719) is YcbcrMatrix.BT601
    assert matrix_for(720) is YcbcrMatrix.BT709
    assert matrix_for(480, BT2020) is YcbcrMatrix.BT2020


def held(rgb: np.ndarray) -> Picture:
    """Return a picture as the pipeline holds it, with what super-resolution leaves unrounded."""
    picture = picture_from_rgb(rgb.astype(np.uint8), 255.0)
    rng = np.random.default_rng(3)
    return Picture(
        luma=picture.luma + rng.uniform(-0.4, 0.4, picture.luma.shape).astype(np.float32),
        chroma=picture.chroma + rng.uniform(-0.4, 0.4, picture.chroma.shape).astype(np.float32),
    )


@pytest.mark.parametrize("matrix", list(YcbcrMatrix))
def test_without_rgb_between_planes_differ_by_its_roundings(matrix):
    rows, columns = np.mgrid[:38, :66]
    waves = [np.sin(columns / 5), np.cos(rows / 7), np.sin((rows - columns) / 9)]
    picture = held(128 + 90 * np.stack(waves, axis=-1))
    direct = coded(picture.luma, picture.chroma, matrix)
    assert (direct.shape, direct.matrix) == ((38, 66, 3), matrix)
    by_rgb = to_yuv420(rgb_of(picture.luma, picture.chroma, 8), matrix, coded_bits=8)
    for ours, theirs in zip(direct.planes, by_rgb, strict=True):
        difference = np.abs(ours.astype(int) - theirs)
        assert difference.max() == 1
        assert difference.mean() < 0.25


@pytest.mark.parametrize("matrix", list(YcbcrMatrix))
def test_without_rgb_between_the_primaries_are_those_of_the_standard(matrix):
    for index, expected in PRIMARIES[matrix].items():
        picture = picture_from_rgb(patch(COLOURS[index]), 255.0)
        found = [int(plane[1, 2]) for plane in coded(picture.luma, picture.chroma, matrix).planes]
        assert np.abs(np.subtract(found, expected)).max() <= 1, (index, found)


@pytest.mark.parametrize("matrix", list(YcbcrMatrix))
def test_colours_outside_rgb_are_shown_as_rgb_clips_them(matrix):
    luma, chroma = np.full((4, 6), 200, np.float32), np.full((4, 6, 2), (128, 220), np.float32)
    code = np.array([plane[1, 2] for plane in coded(luma, chroma, matrix).planes], float)
    shown = np.clip(to_rgb(code, matrix, 8), 0, 255)
    np.testing.assert_allclose(shown, rgb_of(luma, chroma, 8)[1, 2], atol=2)


def test_an_odd_last_row_and_column_is_coded_twice():
    picture = held(np.arange(5 * 7 * 3).reshape(5, 7, 3))
    odd = coded(picture.luma, picture.chroma, YcbcrMatrix.BT601)
    assert odd.shape == (6, 8, 3)
    wide = ((0, 1), (0, 1))
    even = coded(
        np.pad(picture.luma, wide, "edge"),
        np.pad(picture.chroma, (*wide, (0, 0)), "edge"),
        YcbcrMatrix.BT601,
    )
    for ours, theirs in zip(odd.planes, even.planes, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def enlarged(magnification: int, sampling: Sampling) -> tuple[np.ndarray, EnlargedColour]:
    """Return luma on an HR grid and the colour of a view to go with it."""
    grid = Grid(magnification_x=magnification, magnification_y=magnification, sampling=sampling)
    rng = np.random.default_rng(8)
    chroma = cv2.GaussianBlur(rng.uniform(0, 255, (21, 34, 2)).astype(np.float32), (0, 0), 1.2)
    luma = rng.uniform(60, 190, grid.hr_shape((21, 34))).astype(np.float32)
    return luma, EnlargedColour(chroma=chroma, grid=grid)


@pytest.mark.parametrize("sampling", list(Sampling))
@pytest.mark.parametrize("magnification", [2, 4])
def test_colour_made_at_half_size_is_the_whole_halved_but_for_the_first_column(
    magnification, sampling
):
    luma, colour = enlarged(magnification, sampling)
    small = coded(luma, colour.halved(), YcbcrMatrix.BT709).planes
    whole = coded(luma, colour.whole(), YcbcrMatrix.BT709).planes
    for ours, theirs in zip(small[1:], whole[1:], strict=True):
        difference = np.abs(ours.astype(int) - theirs)
        assert difference[:, 1:].max() <= 1  # rounded the other way
        assert difference[:, 1:].mean() < 0.01
        assert difference.max() <= 3


@pytest.mark.parametrize("matrix", list(YcbcrMatrix))
def test_a_player_shows_the_luma_that_colour_at_half_size_was_coded_with(matrix):
    luma, colour = enlarged(2, Sampling.AREA)
    planes = coded(luma, colour.halved(), matrix).planes
    code = np.stack([planes[0], *(plane.repeat(2, 0).repeat(2, 1) for plane in planes[1:])])
    shown = np.tensordot(RGB_TO_YCC[0], to_rgb(code.astype(float), matrix, 8), axes=1)
    assert np.abs(shown - luma).max() < 1.5  # three codes rounded


def test_colour_at_half_size_there_is_where_both_magnifications_are_even():
    chroma = np.full((4, 6, 2), 128, np.float32)
    for across, down in [(2, 1), (1, 2), (3, 3), (2, 3)]:
        grid = Grid(magnification_x=across, magnification_y=down, sampling=Sampling.AREA)
        assert EnlargedColour(chroma=chroma, grid=grid).halved() is None
