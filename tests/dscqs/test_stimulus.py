"""Padding: decoders see no difference, lengths tell nothing, damage is found."""

from __future__ import annotations

import os
import subprocess

import cv2
import numpy as np
import pytest

from dscqs.errors import StimulusError
from dscqs.stimulus import RANDOM_BYTES, freshen, inspect, pad, padded_length
from pipeline.media.png import encode_png


def _png(width=64, height=24, seed=9) -> bytes:
    picture = np.random.default_rng(seed).integers(0, 256, (height, width, 3), np.uint8)
    picture[:, seed * 4 :] = 0
    return encode_png(picture)


@pytest.fixture(scope="module")
def webm(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("webm") / "clip.webm"
    subprocess.run(
        [
            "ffmpeg", "-v", "error", "-f", "lavfi", "-i", "testsrc2=s=96x48:r=10:d=0.5",
            "-c:v", "libvpx-vp9", "-lossless", "1", str(path),
        ],
        check=True,
    )  # fmt: skip
    return path.read_bytes()


def _pictures(data: bytes, tmp_path) -> str:
    path = tmp_path / "clip.webm"
    path.write_bytes(data)
    done = subprocess.run(
        ["ffmpeg", "-v", "warning", "-i", str(path), "-f", "framemd5", "-"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    assert done.stderr == ""
    return done.stdout


def test_pictures_are_as_before_whatever_the_filler():
    data = _png(seed=3)
    padded = pad(data, padded_length([len(data), 9000]))
    served = freshen(padded, os.urandom(RANDOM_BYTES))
    assert inspect(served) == inspect(data)
    before, after = (
        cv2.imdecode(np.frombuffer(one, np.uint8), cv2.IMREAD_UNCHANGED) for one in (data, served)
    )
    assert np.array_equal(before, after)


def test_clips_are_as_before_whatever_the_filler(webm, tmp_path):
    served = freshen(pad(webm, padded_length([len(webm)])), os.urandom(RANDOM_BYTES))
    assert inspect(served) == inspect(webm)
    assert (inspect(webm).width, inspect(webm).height, inspect(webm).codec) == (96, 48, "vp9")
    assert _pictures(served, tmp_path) == _pictures(webm, tmp_path)


@pytest.mark.parametrize("kind", ["png", "webm"])
def test_lengths_are_equal_and_bytes_never(kind, webm):
    files = [_png(seed=seed) for seed in range(4)] if kind == "png" else [webm, webm[:]]
    length = padded_length([len(data) for data in files])
    padded = [pad(data, length) for data in files]
    served = [freshen(one, os.urandom(RANDOM_BYTES)) for one in padded for _ in range(5)]
    assert {len(data) for data in served} == {length}
    assert len(set(served)) == len(served)


@pytest.mark.parametrize("at", [9, 20, 45, 200, -5])
def test_a_flipped_byte_of_a_picture_is_found(at):
    data = bytearray(_png())
    data[at] ^= 1
    with pytest.raises(StimulusError, match=r"^ballet/sr: is damaged"):
        inspect(bytes(data), "ballet/sr")


@pytest.mark.parametrize("cut", [5, 30, 400])
def test_a_file_cut_short_is_found(cut, webm):
    for data in (_png(), webm):
        with pytest.raises(StimulusError):
            inspect(data[:cut])


def test_other_files_are_refused():
    with pytest.raises(StimulusError, match="neither a PNG nor a WebM"):
        inspect(b"GIF89a")
