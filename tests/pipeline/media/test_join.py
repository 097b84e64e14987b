"""Segments joined: one video, whose stereo layout players are told."""

from __future__ import annotations

import subprocess
import zlib
from contextlib import closing
from dataclasses import replace
from fractions import Fraction

import av
import numpy as np
import pytest

from pipeline.errors import OutputError
from pipeline.media.decode import VideoReader
from pipeline.media.encode import write_segment
from pipeline.media.join import join_segments
from pipeline.media.video_format import (
    Container,
    VideoCodec,
)
from pipeline.stereo import StereoLayout, unpack
from tests.support.encoded import (
    HEIGHT,
    LOSSY,
    NTSC,
    WIDTH,
    decoded,
    digest,
    moving_eyes,
    video_format,
    write_and_join,
)
from tests.support.needed import program


@pytest.mark.parametrize(
    ("container", "codec"), [form for form in LOSSY if form[0] is not Container.MOV]
)
@pytest.mark.parametrize(
    ("layout", "kind"),
    [(StereoLayout.SBS, "side by side"), (StereoLayout.HALF_TAB, "top and bottom")],
)
def test_players_are_told_the_layout_by_the_container(
    tmp_path, ffprobe, container, codec, layout, kind
):
    video = video_format(container, codec, layout)
    out, _ = write_and_join(tmp_path, "v", video, [list(moving_eyes(range(3)))])

    (told,) = ffprobe(out)["side_data_list"]

    assert told["side_data_type"] == "Stereo 3D"
    assert (told["type"], told["inverted"]) == (kind, 0)


@pytest.mark.parametrize("container", [Container.MKV, Container.MP4])
@pytest.mark.parametrize(
    ("layout", "kind"),
    [(StereoLayout.SBS, 1), (StereoLayout.HALF_SBS, 1), (StereoLayout.TAB, 2)],
)
def test_h264_carries_the_layout_in_the_bare_stream(tmp_path, container, layout, kind):
    video = video_format(container, layout=layout)
    segments = [list(moving_eyes(range(4))), list(moving_eyes(range(4, 7)))]
    out, _ = write_and_join(tmp_path, "v", video, segments)
    bare = tmp_path / "bare.h264"  # no container that could say it instead
    subprocess.run(
        [program("ffmpeg"), "-v", "error", "-i", str(out), "-c", "copy", "-f", "h264", str(bare)],
        check=True,
    )

    with av.open(str(bare), format="h264") as stream:
        said = [
            (np.frombuffer(bytes(data), np.int32)[:2].tolist(), frame.key_frame)
            for frame in stream.decode(video=0)
            for data in frame.side_data
            if data.type.name == "STEREO3D"
        ]

    assert said == [([kind, 0], True)] * len(segments)  # not inverted: left (top) eye first


@pytest.mark.parametrize("codec", [VideoCodec.H264, VideoCodec.VP9])
@pytest.mark.parametrize(("layout", "mode"), [(StereoLayout.SBS, 2), (StereoLayout.TAB, 1)])
def test_mp4_has_the_stereo_box(tmp_path, codec, layout, mode):
    video = video_format(Container.MP4, codec, layout)
    out, _ = write_and_join(tmp_path, "v", video, [list(moving_eyes(range(2)))])

    content = out.read_bytes()
    at = content.index(b"st3d")

    assert content[at + 4 : at + 9] == bytes([0, 0, 0, 0, mode])


@pytest.mark.parametrize(
    ("container", "codec"),
    [
        (Container.MP4, VideoCodec.HEVC), (Container.MOV, VideoCodec.HEVC),
        (Container.MOV, VideoCodec.PRORES),
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    ("layout", "arrangement", "kind"),
    [(StereoLayout.SBS, "sbs", b"side"), (StereoLayout.HALF_TAB, "tab", b"over")],
)
def test_apple_s_boxes_say_where_the_eyes_lie(
    tmp_path, ffprobe, container, codec, layout, arrangement, kind
):
    """FFmpeg (8, inside PyAV) reads them; of MOV nothing else tells it."""
    video = video_format(container, codec, layout)
    out, _ = write_and_join(tmp_path, "v", video, [list(moving_eyes(range(3)))])
    content = out.read_bytes()
    at = content.index(b"vexu")
    assert content[at + 4 + 21 :].startswith(b"\0\0\0\x18pack\0\0\0\x10pkin\0\0\0\0" + kind)
    with closing(VideoReader(out)) as reader:
        assert reader.stereo is not None
        assert (reader.stereo.arrangement, reader.stereo.right_first) == (arrangement, False)
        assert reader.picture(2).luma.any()
    assert ffprobe(out)["tags"]["handler_name"] == "VideoHandler"


@pytest.mark.parametrize(
    "layout", [StereoLayout.ANAGLYPH, StereoLayout.LEFT, StereoLayout.RIGHT, StereoLayout.VIEWS]
)
def test_pictures_of_one_eye_are_not_called_stereo(tmp_path, ffprobe, layout):
    eyes = list(moving_eyes(range(2)))
    frames = [pair[:1] for pair in eyes] if layout is StereoLayout.VIEWS else eyes
    out, _ = write_and_join(tmp_path, "v", video_format(layout=layout), [frames])

    said = ffprobe(out)

    assert "side_data_list" not in said
    assert (said["width"], said["height"]) == (WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("container", "codec"), [*LOSSY, (Container.MKV, VideoCodec.FFV1), (Container.MP4, "av1")]
)
@pytest.mark.parametrize("width", [80, 300])
@pytest.mark.parametrize(
    ("layout", "sample"), [(StereoLayout.HALF_SBS, "2:1"), (StereoLayout.HALF_TAB, "1:2")]
)
def test_squeezed_eyes_have_oblong_samples(
    tmp_path, ffprobe, container, codec, width, layout, sample
):
    video = video_format(container, VideoCodec(codec), layout)
    out, _ = write_and_join(tmp_path, "v", video, [list(moving_eyes(range(1), width=width))])

    said = ffprobe(out)

    assert (said["width"], said["height"]) == (width, HEIGHT)
    assert said["sample_aspect_ratio"] == sample


@pytest.mark.parametrize(
    ("layout", "sample"),
    [("sbs", "2:1"), ("tab", "2:1"), ("left", "2:1"), ("half-sbs", "4:1"), ("half-tab", "1:1")],
)
@pytest.mark.parametrize("container", [Container.MKV, Container.MP4])
@pytest.mark.parametrize("width", [80, 300])
def test_eyes_that_stay_squeezed_are_said_to_be(
    tmp_path, ffprobe, container, layout, sample, width
):
    layout = StereoLayout(layout)
    video = replace(video_format(container, layout=layout), pixel_aspect=Fraction(2))
    eyes = [
        picture if layout.packed else picture[:1] for picture in moving_eyes(range(1), width=width)
    ]
    out, _ = write_and_join(tmp_path, "v", video, [eyes])
    assert ffprobe(out)["sample_aspect_ratio"] == sample


def test_full_layouts_have_square_samples(tmp_path, ffprobe):
    for container in (Container.MKV, Container.MP4):
        out, _ = write_and_join(
            tmp_path, "v", video_format(container), [list(moving_eyes(range(1)))]
        )
        assert ffprobe(out)["sample_aspect_ratio"] == "1:1"


def test_correcting_the_display_size_keeps_the_checksum_right(tmp_path):
    video = video_format(layout=StereoLayout.HALF_SBS)
    out, _ = write_and_join(tmp_path, "v", video, [list(moving_eyes(range(1)))])

    content = out.read_bytes()
    tracks_id = bytes.fromhex("1654ae6b")
    at = content.index(tracks_id, content.index(tracks_id) + 4)  # the first is the seek head's
    size = int.from_bytes(content[at + 4 : at + 6], "big") & 0x3FFF
    tracks = content[at + 6 : at + 6 + size]

    assert tracks[:2] == bytes.fromhex("bf84")
    assert int.from_bytes(tracks[2:6], "little") == zlib.crc32(tracks[6:])
    assert bytes([0x54, 0xB0, 0x81, WIDTH]) in tracks
    assert bytes([0x54, 0xBA, 0x81, HEIGHT]) in tracks


def test_left_eye_is_left_after_encoding(tmp_path):
    dark, bright = np.full((2, HEIGHT, WIDTH), [[[40]], [[200]]], np.uint8)
    out, _ = write_and_join(tmp_path, "v", video_format(), [[(dark, bright)] * 2])

    left, right = unpack(decoded(out, "gray")[0], StereoLayout.SBS)

    assert np.abs(left.astype(int) - 40).max() <= 3
    assert np.abs(right.astype(int) - 200).max() <= 3


@pytest.mark.parametrize("fps", [NTSC, Fraction(24), Fraction(15), Fraction(25, 2)])
@pytest.mark.parametrize(
    ("container", "codec"), [*LOSSY, (Container.MP4, VideoCodec.AV1), (Container.MKV, "ffv1")]
)
def test_joined_segments_are_one_video(tmp_path, ffprobe, container, codec, fps):
    video = video_format(container, VideoCodec(codec), fps=fps)
    lengths, first = (9, 9, 4), 0
    segments = []
    for length in lengths:
        segments.append(list(moving_eyes(range(first, first + length))))
        first += length
    out, paths = write_and_join(tmp_path, "v", video, segments)

    said = ffprobe(out)

    assert said["nb_read_frames"] == str(first)
    assert Fraction(said["r_frame_rate"]) == Fraction(said["avg_frame_rate"]) == fps
    assert float(said["format_duration"]) == pytest.approx(float(first / fps), abs=2e-3)
    assert float(said["start_time"]) == 0
    with av.open(str(out)) as joined:
        packets = [packet for packet in joined.demux(video=0) if packet.size]
        decoding = [packet.dts for packet in packets if packet.dts is not None]
        assert (np.diff(decoding) > 0).all()
        assert len(decoding) >= len(packets) - 1
    with av.open(str(out)) as joined:
        shown = list(joined.decode(video=0))
    tick = 0 if container is Container.MP4 else Fraction(1, 2000)
    for number, frame in enumerate(shown):
        assert abs(frame.pts * frame.time_base - number / fps) <= tick
    frames = [frame.to_ndarray(format="rgb24") for frame in shown]
    alone = [picture for path in paths for picture in decoded(path, "rgb24")]
    assert len(frames) == len(alone) == first
    assert all(np.array_equal(ours, theirs) for ours, theirs in zip(frames, alone, strict=True))


@pytest.mark.parametrize(("container", "codec"), LOSSY)
def test_frames_come_in_order_and_can_be_sought(tmp_path, container, codec):
    levels = [20 + 9 * number for number in range(24)]
    frames = [(np.full((HEIGHT, WIDTH), level, np.uint8),) * 2 for level in levels]
    segments = [frames[start : start + 8] for start in range(0, 24, 8)]
    out, _ = write_and_join(
        tmp_path, "v", video_format(container, codec, fps=Fraction(24)), segments
    )

    shown = [int(np.median(picture)) for picture in decoded(out, "gray")]
    assert np.abs(np.subtract(shown, levels)).max() <= 2

    with av.open(str(out)) as joined:
        stream = joined.streams.video[0]
        for wanted in (17, 8, 23, 0):
            joined.seek(round(wanted / 24 / stream.time_base), stream=stream)
            first = next(joined.decode(stream))
            assert first.key_frame
            landed = round(first.pts * stream.time_base * 24)
            # the segment's own key frame, or one that is nothing else
            assert landed == (wanted if codec is VideoCodec.PRORES else wanted // 8 * 8)
            assert abs(int(np.median(first.to_ndarray(format="gray"))) - levels[landed]) <= 2


def test_mp4_can_be_played_while_it_loads(tmp_path):
    out, _ = write_and_join(
        tmp_path, "v", video_format(Container.MP4), [list(moving_eyes(range(3)))]
    )
    content = out.read_bytes()

    assert content.index(b"moov") < content.index(b"mdat")


@pytest.mark.parametrize("container", [Container.MP4, Container.WEBM])
def test_joining_twice_gives_the_same_bytes(tmp_path, container):
    codec = VideoCodec.VP9 if container is Container.WEBM else VideoCodec.H264
    video = video_format(container, codec, StereoLayout.HALF_SBS)
    out, paths = write_and_join(tmp_path, "v", video, [list(moving_eyes(range(3)))])
    before = digest(out)

    assert join_segments(paths, out, video) == 3
    assert digest(out) == before


def test_segments_in_the_wrong_order_are_refused(tmp_path):
    out, paths = write_and_join(tmp_path, "v", video_format(), [list(moving_eyes(range(3)))] * 3)
    out.unlink()

    with pytest.raises(OutputError, match=r"starts with frame 106, but .* ends with frame 102"):
        join_segments([paths[0], paths[2]], out, video_format())
    with pytest.raises(OutputError, match="no segments"):
        join_segments([], out, video_format())
    assert not out.exists()


def test_segments_of_two_kinds_are_refused(tmp_path):
    eyes = list(moving_eyes(range(2)))
    write_segment(tmp_path / "a.mkv", video_format(), eyes, first_frame=0)
    write_segment(tmp_path / "b.mkv", video_format(layout=StereoLayout.TAB), eyes, first_frame=2)

    with pytest.raises(OutputError, match=r"b\.mkv: this segment is of another kind"):
        join_segments([tmp_path / "a.mkv", tmp_path / "b.mkv"], tmp_path / "o.mkv", video_format())
    assert not (tmp_path / "o.mkv").exists()


@pytest.mark.parametrize("damage", ["missing", "empty", "noise", "foreign"])
def test_damaged_segments_are_named(tmp_path, damage):
    path = tmp_path / "s.mkv"
    if damage == "foreign":
        with av.open(str(path), "w", format="matroska") as container:
            stream = container.add_stream("ffv1", rate=24)
            stream.codec_context.height, stream.codec_context.width = 8, 8
            container.mux(stream.encode(av.VideoFrame(8, 8, "yuv420p")))
            container.mux(stream.encode(None))
    elif damage != "missing":
        path.write_bytes(b"" if damage == "empty" else bytes(range(256)) * 40)

    with pytest.raises(OutputError, match=r"s\.mkv: this segment is missing or damaged"):
        join_segments([path], tmp_path / "o.mkv", video_format())
    assert not (tmp_path / "o.mkv").exists()
