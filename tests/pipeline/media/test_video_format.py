"""Kinds of video: what goes together, and what files are called."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import pytest

from pipeline.errors import ConfigurationError
from pipeline.media.video_format import (
    Container,
    VideoCodec,
    VideoFormat,
    suggested_name,
    view_path,
)
from pipeline.stereo import StereoLayout
from tests.support.encoded import (
    NTSC,
    video_format,
)


@pytest.mark.parametrize(
    ("container", "codec"),
    [
        (Container.WEBM, VideoCodec.H264),
        (Container.WEBM, VideoCodec.FFV1),
        (Container.MP4, VideoCodec.FFV1),
    ],
)
def test_a_container_that_cannot_hold_the_codec_is_refused_by_name(container, codec):
    with pytest.raises(ConfigurationError, match=rf"\.{container} .*{codec}"):
        video_format(container, codec)


def test_the_suffix_chooses_container_and_codec():
    found = {
        name: VideoFormat.for_path(Path(name), layout=StereoLayout.SBS, fps=NTSC).codec
        for name in ("a.mkv", "a.MP4", "a.webm")
    }

    assert found == {"a.mkv": "h264", "a.MP4": "h264", "a.webm": "vp9"}
    for name in ("a.avi", "a", "mkv"):
        with pytest.raises(ConfigurationError, match=rf"{name}: .*must end in one of \.mp4, \.mkv"):
            VideoFormat.for_path(Path(name), layout=StereoLayout.SBS, fps=NTSC)


@pytest.mark.parametrize(
    ("codec", "crf", "words"),
    [("h264", 0, "1 to 51"), ("h264", 52, "1 to 51"), ("av1", 64, "1 to 63"), ("ffv1", 9, "ffv1")],
)
def test_a_quality_out_of_range_is_refused(codec, crf, words):
    with pytest.raises(ConfigurationError, match=words):
        VideoFormat.for_path(
            Path("a.mkv"), layout=StereoLayout.SBS, fps=NTSC, codec=VideoCodec(codec), crf=crf
        )


@pytest.mark.parametrize("fps", [Fraction(0), Fraction(-1), Fraction(1000)])
def test_a_frame_rate_out_of_range_is_refused(fps):
    with pytest.raises(ConfigurationError, match="frame rate"):
        video_format(fps=fps)


def test_names_carry_the_marks_players_look_for():
    names = {layout: suggested_name("clip", layout, Container.MP4) for layout in StereoLayout}

    assert names[StereoLayout.SBS] == "clip_3D_SBS_LR.mp4"
    assert names[StereoLayout.HALF_SBS] == "clip_3D_HSBS_LR.mp4"
    assert names[StereoLayout.TAB] == "clip_3D_TAB.mp4"
    assert names[StereoLayout.HALF_TAB] == "clip_3D_HTAB.mp4"
    assert "3D" not in names[StereoLayout.LEFT]
    assert len(set(names.values())) == len(StereoLayout)
    assert view_path(Path("out/clip.mkv"), "cam3") == Path("out/clip.cam3.mkv")
