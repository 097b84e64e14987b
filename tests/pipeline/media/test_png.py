from __future__ import annotations

import struct
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.errors import ConfigurationError, OutputError
from pipeline.media.png import encode_png, png_path, write_png

GREY, RGB = 0, 2
"""Colour types of PNG."""


def noise(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    return np.random.default_rng(3).integers(0, np.iinfo(dtype).max + 1, shape, dtype=dtype)


def read_with_ffmpeg(path: Path) -> np.ndarray:
    """Return the samples by another program than the one that wrote them."""
    with av.open(str(path)) as container:
        frame = next(container.decode(video=0))
        name = frame.format.name
        if not name.endswith("be"):
            return frame.to_ndarray()
        samples = np.frombuffer(bytes(frame.planes[0]), ">u2")
        lines = samples.reshape(frame.height, frame.planes[0].line_size // 2)
        channels = 3 if name.startswith("rgb") else 1
        picture = lines[:, : frame.width * channels].reshape(frame.height, frame.width, channels)
        return picture.astype(np.uint16) if channels == 3 else picture[..., 0].astype(np.uint16)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("shape", [(7, 11), (7, 11, 3), (1, 9), (9, 1, 3), (64, 33, 3)])
def test_every_sample_comes_back(tmp_path, shape, dtype):
    picture = noise(shape, dtype)

    write_png(tmp_path / "p.png", picture)

    again = read_with_ffmpeg(tmp_path / "p.png")
    assert again.dtype == dtype
    assert np.array_equal(again, picture)
    assert [path.name for path in tmp_path.iterdir()] == ["p.png"]


@pytest.mark.parametrize(
    ("shape", "dtype", "bits", "colour"),
    [
        ((4, 6), np.uint8, 8, GREY),
        ((4, 6), np.uint16, 16, GREY),
        ((4, 6, 3), np.uint8, 8, RGB),
        ((4, 6, 3), np.uint16, 16, RGB),
    ],
)
def test_the_header_says_what_is_in_the_file(shape, dtype, bits, colour):
    content = encode_png(noise(shape, dtype))

    assert content[:8] == b"\x89PNG\r\n\x1a\n"
    width, height, depth, kind = struct.unpack(">IIBB", content[16:26])
    assert (height, width, depth, kind) == (4, 6, bits, colour)


def test_red_is_red():
    picture = np.zeros((2, 3, 3), np.uint8)
    picture[..., 0] = 255

    container = av.CodecContext.create("png", "r")
    (frame,) = container.decode(av.Packet(encode_png(picture)))

    assert (frame.to_ndarray(format="rgb24")[0, 0] == (255, 0, 0)).all()


def test_the_same_picture_gives_the_same_bytes():
    picture = noise((40, 50, 3), np.uint16)

    assert encode_png(picture) == encode_png(picture.copy())


def test_names_carry_eye_or_view_and_source_frame_number():
    folder = Path("frames")

    assert png_path(folder, "left", 0).name == "left-000000.png"
    assert png_path(folder, "right", 123).name == "right-000123.png"
    assert png_path(folder, "cam 3", 7_654_321).name == "cam 3-7654321.png"


@pytest.mark.parametrize("name", ["", "../up", "a/b", "a\\b", ".hidden", "nul\0"])
def test_names_that_lead_elsewhere_are_refused(name):
    with pytest.raises(ConfigurationError, match="file name"):
        png_path(Path("frames"), name, 0)


@pytest.mark.parametrize(
    "picture",
    [
        np.zeros((4, 6), np.float32),
        np.zeros((4, 6, 2), np.uint8),
        np.zeros((0, 6), np.uint8),
        np.zeros((4, 6, 3, 1), np.uint8),
    ],
)
def test_arrays_that_are_no_picture_are_refused(tmp_path, picture):
    with pytest.raises(OutputError, match="shape"):
        write_png(tmp_path / "p.png", picture)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="the folder does not exist"):
        write_png(tmp_path / "missing" / "p.png", np.zeros((4, 6), np.uint8))
