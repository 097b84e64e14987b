from __future__ import annotations

import hashlib
import json
import os
import resource
import signal
import subprocess
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.errors import ConfigurationError, Interrupted, OutputError
from pipeline.media.decode import VideoReader
from pipeline.media.encode import check_size, write_segment
from pipeline.media.join import join_segments
from pipeline.media.video_format import (
    Container,
    VideoCodec,
    VideoFormat,
    suggested_name,
    view_path,
)
from pipeline.stereo import StereoLayout, pack, unpack
from tests.support.needed import program
from tests.support.waiting import PATIENCE

NTSC = Fraction(30000, 1001)

HEIGHT, WIDTH = 48, 80
"""Size of one eye in most tests."""

LOSSY = [
    (Container.MKV, VideoCodec.H264),
    (Container.MP4, VideoCodec.H264),
    (Container.WEBM, VideoCodec.VP9),
    (Container.MKV, VideoCodec.AV1),
    (Container.MP4, VideoCodec.HEVC),
    (Container.MOV, VideoCodec.PRORES),
]


@pytest.fixture(scope="session")
def ffprobe() -> Callable[[Path], dict]:
    """Gives what ffprobe says of a file's stream, its duration under ``format_duration``."""
    path = program("ffprobe")

    def probe(video: Path) -> dict:
        done = subprocess.run(
            [
                path,
                "-v",
                "error",
                "-count_frames",
                *["-show_streams", "-show_format", "-of", "json"],
                video,
            ],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stderr == ""
        said = json.loads(done.stdout)
        (stream,) = said["streams"]
        return stream | {"format_duration": said["format"]["duration"]}

    return probe


def video_format(
    container: Container = Container.MKV,
    codec: VideoCodec = VideoCodec.H264,
    layout: StereoLayout = StereoLayout.SBS,
    fps: Fraction = NTSC,
) -> VideoFormat:
    return VideoFormat(container=container, codec=codec, layout=layout, fps=fps)


def moving_eyes(
    numbers: range, height: int = HEIGHT, width: int = WIDTH, dtype: type = np.uint8
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield (left, right) RGB pictures that depend on nothing but the frame number."""
    y, x = np.mgrid[:height, :width].astype(np.float64)
    scale = 257 if dtype == np.uint16 else 1
    for number in numbers:
        waves = [np.sin((x + 3 * number) / 9), np.cos(y / 7 + number / 5), np.sin((x - y) / 11)]
        left = ((np.stack(waves, axis=-1) * 100 + 128) * scale).astype(dtype)
        yield left, np.roll(left, 5, axis=1)


def flat_eyes(colour: tuple[int, ...], height: int, width: int, dtype: type = np.uint8):
    scale = 257 if dtype == np.uint16 else 1
    eye = np.broadcast_to(np.array(colour) * scale, (height, width, 3)).astype(dtype)
    return eye, eye


def write_and_join(
    folder: Path, name: str, video: VideoFormat, segments: list[list]
) -> tuple[Path, list[Path]]:
    """Write lists of frames as segments and join them."""
    paths, first_frame = [], 100
    for index, frames in enumerate(segments):
        path = folder / f"{name}-{index}.mkv"
        assert write_segment(path, video, iter(frames), first_frame=first_frame) == len(frames)
        first_frame += len(frames)
        paths.append(path)
    out = folder / f"{name}.{video.container}"
    assert join_segments(paths, out, video) == first_frame - 100
    return out, paths


def decoded(path: Path, pixels: str | None = None) -> list[np.ndarray]:
    with av.open(str(path)) as container:
        return [frame.to_ndarray(format=pixels) for frame in container.decode(video=0)]


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_quick_coding_is_as_good(tmp_path):
    frames = list(moving_eyes(range(5)))
    worst = []
    for is_quick in (False, True):
        video = replace(video_format(), is_quick=is_quick)
        out, _ = write_and_join(tmp_path, f"quick-{is_quick}", video, [frames[:3], frames[3:]])
        errors = [
            np.abs(picture.astype(float) - np.concatenate(eyes, axis=1)).mean()
            for picture, eyes in zip(decoded(out, "rgb24"), frames, strict=True)
        ]
        worst.append(max(errors))
    assert worst[1] <= 1.05 * worst[0]


# Stereo layout


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


# Colour


@pytest.mark.parametrize(("container", "codec"), LOSSY)
@pytest.mark.parametrize(("height", "matrix"), [(96, "smpte170m"), (720, "bt709")])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colours_are_tagged_and_come_back(
    tmp_path, ffprobe, container, codec, height, matrix, dtype
):
    for colour in [(220, 40, 60), (20, 160, 230)]:
        frames = [flat_eyes(colour, height, 64, dtype)] * 2
        out, _ = write_and_join(tmp_path, "v", video_format(container, codec), [frames])

        shown = decoded(out, "rgb24")[-1]

        assert np.abs(shown[4:-4, 4:-4].astype(int) - colour).max() <= 3
    said = ffprobe(out)
    assert (said["color_range"], said["color_space"]) == ("tv", matrix)
    if codec is not VideoCodec.VP9:  # its stream says the matrix only
        assert (said["color_primaries"], said["color_transfer"]) == ("bt709", "bt709")
    pixels = {VideoCodec.VP9: "yuv420p", VideoCodec.HEVC: "yuv420p10le",
              VideoCodec.PRORES: "yuv422p10le"}  # fmt: skip
    usual = "yuv420p10le" if dtype == np.uint16 else "yuv420p"
    assert said["pix_fmt"] == pixels.get(codec, usual)


@pytest.mark.parametrize(("container", "codec"), LOSSY)
def test_grey_sources_get_neutral_chroma(tmp_path, container, codec):
    grey = [(left[..., 0], right[..., 0]) for left, right in moving_eyes(range(3))]
    out, _ = write_and_join(tmp_path, "v", video_format(container, codec), [grey])

    planes = decoded(out, "yuv420p")[1]
    luma, chroma = planes[:HEIGHT], planes[HEIGHT:]
    expected = 16 + pack(*grey[1], StereoLayout.SBS) * (219 / 255)

    assert np.abs(chroma.astype(int) - 128).max() <= 1
    assert np.sqrt(np.mean((luma - expected) ** 2)) < 2


# Lossless


@pytest.mark.parametrize("layout", [StereoLayout.SBS, StereoLayout.HALF_TAB, StereoLayout.LEFT])
@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize(
    ("dtype", "pixels"), [(np.uint8, ("rgb24", "gray")), (np.uint16, ("gbrp16le", "gray16le"))]
)
def test_ffv1_gives_back_every_sample_also_of_odd_sizes(tmp_path, layout, grey, dtype, pixels):
    rng = np.random.default_rng(5)
    shape = (7, 13) if grey else (7, 13, 3)
    top = np.iinfo(dtype).max + 1
    eyes = [tuple(rng.integers(0, top, (2, *shape), dtype=dtype)) for _ in range(5)]
    video = video_format(codec=VideoCodec.FFV1, layout=layout)

    out, _ = write_and_join(tmp_path, "v", video, [eyes[:3], eyes[3:]])

    found = decoded(out, pixels[grey])
    assert len(found) == len(eyes)
    for picture, pair in zip(found, eyes, strict=True):
        assert np.array_equal(picture, pack(*pair, layout))


# Sizes


@pytest.mark.parametrize(("container", "codec"), LOSSY)
@pytest.mark.parametrize(
    ("layout", "size"),
    [
        (StereoLayout.SBS, (18, 44)),
        (StereoLayout.HALF_SBS, (18, 24)),
        (StereoLayout.TAB, (36, 22)),
        (StereoLayout.RIGHT, (18, 22)),
    ],
)
def test_odd_sizes_are_padded_eye_by_eye(tmp_path, ffprobe, container, codec, layout, size):
    video = video_format(container, codec, layout)
    out, _ = write_and_join(
        tmp_path, "v", video, [list(moving_eyes(range(2), height=17, width=21))]
    )

    said = ffprobe(out)

    assert (said["height"], said["width"]) == size
    assert said["nb_read_frames"] == "2"


@pytest.mark.parametrize("shape", [(3, 5), (1, 40), (40, 1), (1, 1)])
@pytest.mark.parametrize("codec", [VideoCodec.H264, VideoCodec.VP9, VideoCodec.FFV1])
def test_tiny_pictures_can_be_written(tmp_path, shape, codec):
    eye = np.full((*shape, 3), 130, np.uint8)
    out, _ = write_and_join(tmp_path, "v", video_format(codec=codec), [[(eye, eye)] * 2])

    found = decoded(out, "rgb24")

    assert len(found) == 2
    assert np.abs(found[0].astype(int) - 130).max() <= 3


@pytest.mark.parametrize("shape", [(2, 2), (80, 4), (24, 200), (66, 16)])
def test_sizes_that_av1_waits_for_ever_on_are_refused_before_the_work(tmp_path, shape):
    av1 = video_format(codec=VideoCodec.AV1, layout=StereoLayout.LEFT)
    with pytest.raises(OutputError, match=f"av1 takes no pictures of {shape[1]}×{shape[0]}"):
        check_size(tmp_path / "out.mkv", av1, shape, 1)
    with pytest.raises(OutputError, match="choose another codec"):
        write_segment(tmp_path / "s.mkv", av1, [(np.zeros((*shape, 3), np.uint8),)], first_frame=0)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("codec", "shape"),
    [
        (VideoCodec.AV1, (4, 4)), (VideoCodec.AV1, (16, 64)), (VideoCodec.AV1, (32, 200)),
        (VideoCodec.HEVC, (16, 16)), (VideoCodec.HEVC, (15, 31)),
    ],
)  # fmt: skip
def test_smallest_pictures_that_encoders_take(tmp_path, codec, shape):
    form = video_format(codec=codec, layout=StereoLayout.LEFT)
    out, _ = write_and_join(tmp_path, "v", form, [[(np.full((*shape, 3), 90, np.uint8),)]])
    assert len(decoded(out, "rgb24")) == 1


@pytest.mark.parametrize("shape", [(2, 2), (14, 200), (200, 13)])
def test_sizes_that_hevc_does_not_take_are_refused_before_the_work(tmp_path, shape):
    form = video_format(codec=VideoCodec.HEVC, layout=StereoLayout.LEFT)
    with pytest.raises(OutputError, match="hevc takes no pictures of"):
        check_size(tmp_path / "out.mkv", form, shape, 1)


# Segments


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


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="no such scheduling here")
@pytest.mark.parametrize("codec", VideoCodec)
def test_no_encoder_makes_the_process_a_real_time_one(tmp_path, codec):
    """SVT-AV1 does so where root runs it; whatever the process starts later would inherit it."""
    before = os.sched_getscheduler(0)
    seen = []

    def frames():
        for eyes in moving_eyes(range(3), height=144, width=176):
            yield eyes
            seen.extend(os.sched_getscheduler(int(task)) for task in os.listdir("/proc/self/task"))

    write_segment(tmp_path / "s.mkv", video_format(codec=codec), frames(), first_frame=0)
    assert set(seen) == {before}
    assert os.sched_getscheduler(0) == before


WRITE_SEGMENTS = """
import os, sys
from pathlib import Path
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
sys.path.insert(0, sys.argv[1])
from test_encode import moving_eyes, video_format
from pipeline.media.encode import write_segment
from pipeline.media.video_format import VideoCodec
folder, codecs = Path(sys.argv[2]), sys.argv[3:]
for codec in codecs:
    for index in (1, 0):
        numbers = range(index * 6, index * 6 + 6)
        write_segment(
            folder / f"{codec}-{index}.mkv",
            video_format(codec=VideoCodec(codec)),
            moving_eyes(numbers, height=144, width=176),
            first_frame=100 + index * 6,
        )
"""


def test_bytes_do_not_depend_on_process_order_or_cores(tmp_path):
    """One run here; one in another process on one core, last segment first."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    here = str(Path(__file__).parent)
    codecs = [codec.value for codec in VideoCodec]
    subprocess.run(
        [sys.executable, "-c", WRITE_SEGMENTS, here, str(elsewhere), *codecs], check=True
    )
    for codec in codecs:
        eyes = list(moving_eyes(range(12), height=144, width=176))
        video = video_format(codec=VideoCodec(codec))
        out, paths = write_and_join(tmp_path, codec, video, [eyes[:6], eyes[6:]])

        others = [elsewhere / path.name for path in paths]
        assert [digest(path) for path in paths] == [digest(path) for path in others], codec
        assert join_segments(others, elsewhere / out.name, video) == 12
        assert digest(elsewhere / out.name) == digest(out)


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


# Trouble


@pytest.mark.parametrize("error", [Interrupted, ValueError("bad frame"), KeyboardInterrupt])
def test_an_error_among_the_frames_passes_and_leaves_no_file(tmp_path, error):
    def frames() -> Iterator:
        yield from moving_eyes(range(3))
        raise error

    with pytest.raises(error if isinstance(error, type) else type(error)):
        write_segment(tmp_path / "s.mkv", video_format(), frames(), first_frame=0)
    assert list(tmp_path.iterdir()) == []


def test_no_frames_are_no_segment(tmp_path):
    with pytest.raises(OutputError, match="there are no frames"):
        write_segment(tmp_path / "s.mkv", video_format(), [], first_frame=0)
    assert list(tmp_path.iterdir()) == []


def test_frames_of_two_sizes_are_refused(tmp_path):
    eyes = [*moving_eyes(range(1)), *moving_eyes(range(1), width=WIDTH + 8)]
    with pytest.raises(
        OutputError, match=r"frame 41 is 176×48 RGB uint8, the frames before are 160×48"
    ):
        write_segment(tmp_path / "s.mkv", video_format(), eyes, first_frame=40)
    assert list(tmp_path.iterdir()) == []


def test_one_eye_is_no_pair(tmp_path):
    with pytest.raises(OutputError, match="'sbs' takes two eyes"):
        write_segment(
            tmp_path / "s.mkv",
            video_format(),
            [pair[:1] for pair in moving_eyes(range(1))],
            first_frame=0,
        )


KILLED = """
import os, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_encode import moving_eyes, video_format
from pipeline.media.encode import write_segment
from pipeline.media.join import join_segments
folder = Path(sys.argv[2])
video = video_format()

def wait(*ignored):
    print("in the middle", flush=True)
    time.sleep(600)

def frames():
    yield from moving_eyes(range(40), height=240, width=320)
    wait()

if sys.argv[3] == "segment":
    write_segment(folder / "final.mkv", video, frames(), first_frame=0)
else:
    write_segment(folder / "s.mkv", video, moving_eyes(range(9)), first_frame=0)
    os.replace = wait
    join_segments([folder / "s.mkv"], folder / "final.mkv", video)
"""


@pytest.mark.parametrize("stage", ["segment", "join"])
def test_killed_in_the_middle_nothing_has_the_final_name(tmp_path, stage):
    here = str(Path(__file__).parent)
    with subprocess.Popen(
        [sys.executable, "-c", KILLED, here, str(tmp_path), stage],
        stdout=subprocess.PIPE, text=True,
    ) as writer:  # fmt: skip
        assert writer.stdout.readline() == "in the middle\n"
        writer.send_signal(signal.SIGKILL)
        writer.wait(PATIENCE)

    left = [path.name for path in tmp_path.iterdir() if path.name != "s.mkv"]
    assert len(left) == 1
    assert left[0].startswith(".final.mkv.")


@contextmanager
def file_size_limited_to(size: int) -> Iterator[None]:
    """Forbids files above a size, as a full disk would.

    The limit is the whole process's, and pytest's own report may go to a file: it must be gone
    before the test returns, not only at a fixture's end.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ("container", "codec"), [(Container.MKV, VideoCodec.FFV1), (Container.MP4, VideoCodec.H264)]
)
def test_running_out_of_space_at_any_point_is_an_error(tmp_path, container, codec):
    video = video_format(container, codec)
    eyes = list(moving_eyes(range(3), height=64, width=96))
    out, (segment,) = write_and_join(tmp_path, "v", video, [eyes])
    kept = tmp_path / "kept"
    kept.mkdir()

    for size in (0, 1000, segment.stat().st_size - 1, segment.stat().st_size // 2):
        with (
            file_size_limited_to(size),
            pytest.raises(OutputError, match="grew beyond the allowed size"),
        ):
            write_segment(kept / "s.mkv", video, eyes, first_frame=100)
    for size in (0, 1000, out.stat().st_size - 1, out.stat().st_size // 2):
        with (
            file_size_limited_to(size),
            pytest.raises(OutputError, match="grew beyond the allowed size"),
        ):
            join_segments([segment], kept / out.name, video)
    assert list(kept.iterdir()) == []


def test_a_missing_folder_is_an_output_error(tmp_path):
    with pytest.raises(OutputError, match="the folder does not exist"):
        write_segment(
            tmp_path / "missing" / "s.mkv", video_format(), moving_eyes(range(1)), first_frame=0
        )


# Formats


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


def test_a_lower_crf_gives_a_better_and_larger_file(tmp_path):
    sizes, errors = [], []
    eyes = list(moving_eyes(range(2)))
    for crf in (10, 45):
        video = VideoFormat.for_path(Path("a.mkv"), layout=StereoLayout.LEFT, fps=NTSC, crf=crf)
        path = tmp_path / f"{crf}.mkv"
        write_segment(path, video, eyes, first_frame=0)
        sizes.append(path.stat().st_size)
        errors.append(np.mean((decoded(path, "rgb24")[0] - eyes[0][0].astype(float)) ** 2))

    assert sizes[0] > sizes[1]
    assert errors[0] < errors[1]


def test_names_carry_the_marks_players_look_for():
    names = {layout: suggested_name("clip", layout, Container.MP4) for layout in StereoLayout}

    assert names[StereoLayout.SBS] == "clip_3D_SBS_LR.mp4"
    assert names[StereoLayout.HALF_SBS] == "clip_3D_HSBS_LR.mp4"
    assert names[StereoLayout.TAB] == "clip_3D_TAB.mp4"
    assert names[StereoLayout.HALF_TAB] == "clip_3D_HTAB.mp4"
    assert "3D" not in names[StereoLayout.LEFT]
    assert len(set(names.values())) == len(StereoLayout)
    assert view_path(Path("out/clip.mkv"), "cam3") == Path("out/clip.cam3.mkv")


def test_pictures_shown_again_are_the_pictures_that_equal_ones_would_be(tmp_path):
    first, second = moving_eyes(range(2))
    again, _ = write_and_join(tmp_path, "again", video_format(), [[first, first, second, second]])
    copies = [tuple(map(np.copy, eyes)) for eyes in (first, first, second, second)]
    anew, _ = write_and_join(tmp_path, "anew", video_format(), [copies])
    assert digest(again) == digest(anew)
