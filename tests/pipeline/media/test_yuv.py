"""Raw planar YUV."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.colour import to_grey, to_rgb
from pipeline.errors import SceneError
from pipeline.media.ycbcr import YcbcrMatrix
from pipeline.media.yuv import (
    Range,
    RawVideoFile,
    parse_pixel_format,
    picture_from_planes,
)

WEIGHTS = {"bt601": (0.299, 0.114), "bt709": (0.2126, 0.0722), "bt2020": (0.2627, 0.0593)}


def planes_of(rgb: np.ndarray, matrix: str, value_range: str, bits: int) -> list[np.ndarray]:
    """Return Y, Cb, Cr as the standards define them, rounded: an independent encoder."""
    red, blue = WEIGHTS[matrix]
    r, g, b = (rgb[..., channel] / 255 for channel in range(3))
    y = red * r + (1 - red - blue) * g + blue * b
    cb, cr = (b - y) / (2 - 2 * blue), (r - y) / (2 - 2 * red)
    step, peak = 2 ** (bits - 8), 2**bits - 1
    if value_range == "limited":
        planes = [(16 + 219 * y) * step, (128 + 224 * cb) * step, (128 + 224 * cr) * step]
    else:
        planes = [y * peak, 128 * step + cb * peak, 128 * step + cr * peak]
    return [np.rint(np.clip(plane, 0, peak)).astype("u1" if bits == 8 else "<u2")
            for plane in planes]  # fmt: skip


@pytest.mark.parametrize("matrix", WEIGHTS)
@pytest.mark.parametrize("value_range", ["limited", "full"])
@pytest.mark.parametrize(("name", "bits"), [("yuv444p", 8), ("yuv444p10le", 10)])
def test_matrix_and_range_are_honoured(tmp_path, matrix, value_range, name, bits):
    rgb = np.random.default_rng(2).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    planes = planes_of(rgb, matrix, value_range, bits)
    (tmp_path / "a.yuv").write_bytes(b"".join(plane.tobytes() for plane in planes))
    file = RawVideoFile(
        tmp_path / "a.yuv",
        width=7,
        height=5,
        pixel_format=name,
        matrix=YcbcrMatrix(matrix),
        value_range=Range(value_range),
    )
    picture = file.picture(0)
    error = np.abs(to_rgb(picture.luma, picture.chroma, 8).astype(int) - rgb).max()
    assert error <= (2 if bits == 8 else 1)


@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.sampled_from(["yuv420p", "yuv422p", "yuv444p", "yuv420p10le", "yuv422p12le", "yuv420p16le"]),
    st.tuples(st.integers(16, 235), st.integers(16, 240), st.integers(16, 240)),
)
def test_a_uniform_picture_of_any_size_stays_uniform(width, height, name, values):
    layout = parse_pixel_format(name)
    step = 2 ** (layout.bits - 8)
    planes = tuple(
        np.full(shape, value * step, layout.dtype)
        for shape, value in zip(layout.plane_shapes(width, height), values, strict=True)
    )
    assert layout.frame_bytes(width, height) == sum(plane.nbytes for plane in planes)
    picture = picture_from_planes(planes, layout, YcbcrMatrix.BT601, Range.LIMITED)
    assert picture.luma.shape == picture.chroma.shape[:2] == (height, width)
    np.testing.assert_allclose(picture.luma, (values[0] - 16) * 255 / 219, atol=1e-3)
    for channel in (0, 1):
        expected = 128 + (values[1 + channel] - 128) * 255 / 224
        np.testing.assert_allclose(picture.chroma[..., channel], expected, atol=1e-3)


def test_chroma_sits_on_even_columns_and_between_rows():
    layout = parse_pixel_format("yuv420p16le")
    luma = np.full((8, 12), 30000, np.uint16)
    ramp = 30000 + 100 * np.arange(6)[None, :] + 700 * np.arange(4)[:, None]
    picture = picture_from_planes(
        (luma, ramp.astype(np.uint16), np.full((4, 6), 32768, np.uint16)),
        layout,
        YcbcrMatrix.BT601,
        Range.FULL,
    )
    stored = (picture.chroma[..., 0] - 128) * 65535 / 255 + 32768
    x, y = np.arange(12) / 2, (np.arange(8) + 0.5) / 2 - 0.5
    expected = 30000 + 100 * x[None, :] + 700 * y[:, None]
    np.testing.assert_allclose(stored[1:-1, :-1], expected[1:-1, :-1], atol=1.0)


@given(st.integers(1, 19), st.integers(1, 19), st.integers(0, 2**32 - 1))
def test_samples_of_8_bits_show_what_the_same_ones_of_10_show(width, height, seed):
    eight, ten = parse_pixel_format("yuv420p"), parse_pixel_format("yuv420p10le")
    rng = np.random.default_rng(seed)
    planes = [rng.integers(0, 256, shape) for shape in eight.plane_shapes(width, height)]
    shown = [
        picture_from_planes(
            tuple((plane << (layout.bits - 8)).astype(layout.dtype) for plane in planes),
            layout, YcbcrMatrix.BT601, Range.LIMITED,
        )
        for layout in (eight, ten)
    ]  # fmt: skip
    np.testing.assert_allclose(shown[0].luma, shown[1].luma, atol=1e-4)
    np.testing.assert_allclose(shown[0].chroma, shown[1].chroma, atol=1e-4)


def test_frames_are_found_at_random_and_limited_grey_is_stretched(tmp_path):
    frames = np.random.default_rng(0).integers(64, 940, (4, 3, 5)).astype("<u2")
    (tmp_path / "a.yuv").write_bytes(frames.tobytes())
    limited = RawVideoFile(
        tmp_path / "a.yuv", width=5, height=3, pixel_format="gray10le",
        value_range=Range.LIMITED,
    )  # fmt: skip
    assert limited.num_frames == 4
    for index in (2, 0, 3):
        expected = np.clip((frames[index].astype(float) - 64) * 255 / 876, 0, 255)
        np.testing.assert_allclose(limited.picture(index).luma, expected, atol=1e-3)
    depth = RawVideoFile(tmp_path / "a.yuv", width=5, height=3, pixel_format="gray10le")
    np.testing.assert_array_equal(depth.samples(1), frames[1])


def test_full_grey_comes_back_exactly(tmp_path):
    frame = np.arange(15, dtype=np.uint8).reshape(3, 5) * 17
    (tmp_path / "a.yuv").write_bytes(frame.tobytes())
    file = RawVideoFile(
        tmp_path / "a.yuv", width=5, height=3, pixel_format="gray", value_range=Range.FULL
    )
    np.testing.assert_array_equal(to_grey(file.picture(0).luma, 8), frame)


@pytest.mark.parametrize("size", [0, 1, 23, 25])
def test_a_file_of_broken_frames_is_an_error(tmp_path, size):
    (tmp_path / "a.yuv").write_bytes(bytes(size))
    with pytest.raises(SceneError, match=r"a\.yuv: truncated, or not 4×4 yuv420p"):
        RawVideoFile(tmp_path / "a.yuv", width=4, height=4, pixel_format="yuv420p")


@pytest.mark.parametrize("name", ["rgb24", "nv12", "yuv420p10", "yuv411p", "gray8", "", None, 7])
def test_other_formats_are_refused_by_name(name):
    with pytest.raises(ValueError, match="is not supported"):
        parse_pixel_format(name)
