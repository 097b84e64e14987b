"""Image files, whole and cut short."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import SceneError
from pipeline.media.images import read_header, read_image

RNG = np.random.default_rng(5)
GREY8 = RNG.integers(0, 256, (5, 9), dtype=np.uint8)
RGB8 = RNG.integers(0, 256, (5, 9, 3), dtype=np.uint8)
GREY16 = RNG.integers(0, 65536, (5, 9), dtype=np.uint16)
RGB16 = RNG.integers(0, 65536, (5, 9, 3), dtype=np.uint16)


def encoded(suffix: str, samples: np.ndarray) -> bytes:
    stored = samples[..., ::-1] if samples.ndim == 3 else samples
    return cv2.imencode(suffix, stored)[1].tobytes()


def pfm(samples: np.ndarray, scale: float) -> bytes:
    kind = b"PF" if samples.ndim == 3 else b"Pf"
    head = kind + f"\n{samples.shape[1]} {samples.shape[0]}\n{scale}\n".encode()
    return head + samples[::-1].astype("<f4" if scale < 0 else ">f4").tobytes()


@pytest.mark.parametrize("suffix", [".png", ".tiff", ".pgm", ".ppm"])
@pytest.mark.parametrize("samples", [GREY8, RGB8, GREY16, RGB16])
def test_lossless_kinds_are_read_exactly(tmp_path, suffix, samples):
    if (suffix == ".pgm") != (samples.ndim == 2) and suffix in (".pgm", ".ppm"):
        suffix = ".ppm" if samples.ndim == 3 else ".pgm"
    path = tmp_path / f"a{suffix}"
    path.write_bytes(encoded(suffix, samples))
    image = read_image(path)
    assert image.samples.dtype == samples.dtype
    np.testing.assert_array_equal(image.samples, samples)
    assert image.peak == (255 if samples.dtype == np.uint8 else 65535)
    header = read_header(path)
    assert (header.height, header.width) == (5, 9)
    assert header.channels == (1 if samples.ndim == 2 else 3)
    assert header.bit_depth == (8 if samples.dtype == np.uint8 else 16)


@pytest.mark.parametrize("scale", [-1.0, 1.0])
@pytest.mark.parametrize("channels", [1, 3])
def test_pfm_rows_run_upwards_in_either_byte_order(tmp_path, scale, channels):
    samples = RNG.normal(size=(3, 5, channels)).astype(np.float32).squeeze()
    samples[0, 0] = np.inf
    (tmp_path / "a.pfm").write_bytes(pfm(samples, scale))
    np.testing.assert_array_equal(read_image(tmp_path / "a.pfm").samples, samples)
    header = read_header(tmp_path / "a.pfm")
    assert (header.width, header.height, header.is_float) == (5, 3, True)


def test_pnm_of_ten_bits_and_of_text(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5 # a remark\n3 1\n1023\n" + b"\x00\x01\x03\xff\x02\x00")
    image = read_image(tmp_path / "a.pgm")
    np.testing.assert_array_equal(image.samples, [[1, 1023, 512]])
    assert image.peak == 1023
    assert read_header(tmp_path / "a.pgm").bit_depth == 10
    (tmp_path / "b.ppm").write_bytes(b"P3\n2 1\n255\n1 2 3\n4 5 6\n")
    np.testing.assert_array_equal(read_image(tmp_path / "b.ppm").samples, [[[1, 2, 3], [4, 5, 6]]])


def test_alpha_is_dropped(tmp_path):
    rgba = np.dstack([RGB8, GREY8])
    cv2.imwrite(str(tmp_path / "a.png"), cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png").samples, RGB8)


@pytest.mark.parametrize("samples", [GREY8, RGB8])
def test_jpeg_has_size_and_channels_of_its_header(tmp_path, samples):
    path = tmp_path / "a.jpg"
    path.write_bytes(encoded(".jpg", cv2.resize(samples, (45, 35))))
    image, header = read_image(path), read_header(path)
    assert image.samples.shape[:2] == (header.height, header.width) == (35, 45)
    assert image.samples.ndim == (2 if header.channels == 1 else 3)


WHOLE = {
    ".png": encoded(".png", cv2.resize(RGB8, (23, 17))),
    ".jpg": encoded(".jpg", cv2.resize(RGB8, (23, 17))),
    ".pgm": encoded(".pgm", GREY16),
    ".pfm": pfm(GREY8.astype(np.float32), -1.0),
    ".tiff": encoded(".tiff", RGB16),
}


@given(st.sampled_from(sorted(WHOLE)), st.floats(0, 1, exclude_max=True))
def test_a_file_cut_anywhere_is_an_error_that_names_it(suffix, part):
    data = WHOLE[suffix]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"cut{suffix}"
        path.write_bytes(data[: int(part * len(data))])
        with pytest.raises(SceneError, match=f"cut{suffix}: "):
            read_image(path)


@given(st.integers(0, 2**32 - 1), st.integers(0, 255))
def test_a_damaged_file_is_read_or_is_a_scene_error(seed, value):
    rng = np.random.default_rng(seed)
    suffix = sorted(set(WHOLE) - {".tiff"})[rng.integers(4)]
    data = bytearray(WHOLE[suffix])
    data[rng.integers(len(data))] = value
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"hurt{suffix}"
        path.write_bytes(bytes(data))
        for read in (read_image, read_header):
            said = "hurt"
            try:
                assert read(path).peak > 0
            except SceneError as error:
                said = str(error)
            assert "hurt" in said


def test_a_png_with_a_wrong_checksum_is_named_damaged(tmp_path):
    data = bytearray(WHOLE[".png"])
    data[data.index(b"IDAT") + 9] ^= 1
    (tmp_path / "a.png").write_bytes(bytes(data))
    with pytest.raises(SceneError, match="wrong checksum of a chunk 'IDAT'"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("content", "said"), [(b"", "is empty"), (b"GIF89a....", "not an image of a known kind")]
)
def test_what_is_no_image_says_so(tmp_path, content, said):
    (tmp_path / "a.png").write_bytes(content)
    for read in (read_image, read_header):
        with pytest.raises(SceneError, match=said):
            read(tmp_path / "a.png")
    with pytest.raises(SceneError, match="cannot be read: No such file"):
        read_image(tmp_path / "b.png")
