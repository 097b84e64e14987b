from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest

from pipeline.errors import OutputError, SceneError
from pipeline.media.encode import write_segment
from pipeline.media.join import join_segments
from pipeline.media.lossless import open_lossless, to_8_bits, write_lossless_webm
from pipeline.media.video_format import Container, VideoCodec, VideoFormat
from pipeline.stereo import StereoLayout, pack


def _frames(count=5, height=34, width=52, deep=False, seed=3):
    chance = np.random.default_rng(seed)
    kind = np.uint16 if deep else np.uint8
    return [
        chance.integers(0, np.iinfo(kind).max + 1, (height, width, 3)).astype(kind)
        for _ in range(count)
    ]


def test_a_clip_decodes_to_the_samples_that_went_in(tmp_path):
    frames = _frames()
    assert write_lossless_webm(tmp_path / "a.webm", frames, Fraction(30000, 1001)) == 5
    clip = open_lossless(tmp_path / "a.webm")
    assert abs(clip.fps - Fraction(30000, 1001)) < Fraction(1, 50)
    assert np.array_equal(list(clip.frames()), frames)


def test_the_same_frames_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_lossless_webm(tmp_path / name, _frames(), Fraction(25))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("deep", [False, True])
@pytest.mark.parametrize("grey", [False, True])
def test_results_in_ffv1_are_read_as_they_are(tmp_path, deep, grey):
    eyes = [_frames(deep=deep, seed=seed) for seed in (1, 2)]
    if grey:
        eyes = [[frame[:, :, 0] for frame in eye] for eye in eyes]
    video_format = VideoFormat(
        codec=VideoCodec.FFV1, container=Container.MKV, layout=StereoLayout.SBS, fps=Fraction(25)
    )
    segment = tmp_path / "segment.mkv"
    write_segment(segment, video_format, zip(*eyes, strict=True), first_frame=0)
    join_segments([segment], tmp_path / "out.mkv", video_format)
    clip = open_lossless(tmp_path / "out.mkv")
    assert (clip.fps, clip.stereo_mode) == (25, "left_right")
    expected = [
        to_8_bits(pack(left, right, StereoLayout.SBS)) for left, right in zip(*eyes, strict=True)
    ]
    assert np.array_equal(list(clip.frames()), expected)


def test_sixteen_bits_are_rounded_to_nearest():
    levels = np.arange(65536, dtype=np.uint16).reshape(256, 256)
    assert np.array_equal(to_8_bits(levels)[:, :, 1], np.rint(levels / 257).astype(np.uint8))


def test_a_lossy_result_is_refused(tmp_path):
    video_format = VideoFormat(
        codec=VideoCodec.H264, container=Container.MKV, layout=StereoLayout.SBS, fps=Fraction(25)
    )
    pairs = zip(_frames(), _frames(), strict=True)
    write_segment(tmp_path / "a.mkv", video_format, pairs, first_frame=0)
    with pytest.raises(SceneError, match="ffv1, or --frames-dir"):
        open_lossless(tmp_path / "a.mkv")


def test_frames_of_two_sizes_or_none_are_refused(tmp_path):
    with pytest.raises(OutputError, match="another size"):
        write_lossless_webm(
            tmp_path / "a.webm", [*_frames(1), *_frames(1, height=36)], Fraction(25)
        )
    with pytest.raises(OutputError, match="no frames"):
        write_lossless_webm(tmp_path / "a.webm", [], Fraction(25))
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_video_is_refused(tmp_path):
    (tmp_path / "a.mkv").write_bytes(b"nothing of that kind")
    with pytest.raises(SceneError):
        open_lossless(tmp_path / "a.mkv")
