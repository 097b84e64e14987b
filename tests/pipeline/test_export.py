"""Other forms of a master: read back by others, true to a code value, whole after a kill."""

from __future__ import annotations

import json
import subprocess
from fractions import Fraction

import cv2
import numpy as np
import pytest

from pipeline.errors import Interrupted, OutputError
from pipeline.export import Master, export
from pipeline.job import OutputOptions
from pipeline.media.decode import VideoReader
from pipeline.media.encode import write_segment
from pipeline.media.join import join_segments
from pipeline.media.video_format import Container, VideoCodec, VideoFormat, suggested_name
from pipeline.stereo import StereoLayout, pack
from pipeline.stop import StopFlag
from tests.support.needed import program
from tests.support.waiting import PATIENCE

HEIGHT, WIDTH, FRAMES, FIRST = 96, 256, 5, 7
BARS = ((191, 191, 191), (191, 191, 0), (0, 191, 191), (0, 191, 0),
        (191, 0, 191), (191, 0, 0), (0, 0, 191), (16, 16, 16))  # fmt: skip
"""Colour bars of three quarters, and near black."""


def _chart() -> np.ndarray:
    """A grey ramp of all codes over colour bars: one eye."""
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    bars = np.array(BARS, np.uint8)[np.arange(WIDTH) // (WIDTH // len(BARS))][None]
    return np.vstack([np.repeat(ramp, HEIGHT // 2, 0), np.repeat(bars, HEIGHT // 2, 0)])


@pytest.fixture(scope="module")
def master(tmp_path_factory) -> Master:
    """The chart, upside down in the right eye, for five frames."""
    folder = tmp_path_factory.mktemp("master")
    layout, fps = StereoLayout.SBS, Fraction(15)
    form = VideoFormat(container=Container.MKV, codec=VideoCodec.FFV1, layout=layout, fps=fps)
    chart = _chart()
    write_segment(
        folder / "one.mkv", form, [(chart, chart[::-1])] * FRAMES, first_frame=FIRST
    )  # fmt: skip
    join_segments([folder / "one.mkv"], folder / "master.mkv", form)
    return Master(path=folder / "master.mkv", fps=fps, first_frame=FIRST, layout=layout)


def _options(path, **options) -> OutputOptions:
    return OutputOptions(output=path, segment_length=2, **options)


def _streams(path):
    words = ["-v", "error", "-show_streams", "-show_frames", "-of", "json"]
    command = [program("ffprobe"), *words, str(path)]
    said = json.loads(subprocess.run(command, capture_output=True, check=True).stdout)
    return said["streams"][0], said["frames"]


def _decoded(path, tmp_path) -> np.ndarray:
    """Return the first frame as FFmpeg's own converter gives it: (H, W, 3)."""
    picture = tmp_path / "decoded.png"
    exactly = ["-pix_fmt", "rgb24", "-sws_flags", "accurate_rnd+full_chroma_int+bicubic"]
    command = [program("ffmpeg"), "-v", "error", "-y", "-i", str(path), "-frames:v", "1", *exactly]
    command.append(str(picture))
    subprocess.run(command, check=True)
    return cv2.cvtColor(cv2.imread(str(picture)), cv2.COLOR_BGR2RGB)


FORMS = [
    ("mp4", "h264", "sbs"), ("mp4", "h264", "half-sbs"), ("mp4", "h264", "tab"),
    ("mp4", "h264", "half-tab"), ("mkv", "h264", "sbs"), ("mkv", "h264", "half-sbs"),
    ("mkv", "ffv1", "tab"), ("webm", "vp9", "sbs"), ("webm", "av1", "tab"),
    ("mp4", "h264", "anaglyph"), ("webm", "vp9", "left"), ("mp4", "hevc", "sbs"),
    ("mkv", "hevc", "half-tab"), ("mkv", "prores", "sbs"), ("mov", "prores", "left"),
]  # fmt: skip


@pytest.mark.parametrize(("container", "codec", "layout"), FORMS)
def test_every_form_says_what_it_is(master, tmp_path, container, codec, layout):
    path = tmp_path / suggested_name("clip", StereoLayout(layout), Container(container))
    assert export(master, _options(path, layout=layout, codec=codec)) == FRAMES
    stream, frames = _streams(path)
    assert len(frames) == FRAMES
    shape = {
        "sbs": (2 * WIDTH, HEIGHT), "tab": (WIDTH, 2 * HEIGHT),
    }.get(layout, (WIDTH, HEIGHT))  # fmt: skip
    assert (stream["width"], stream["height"]) == shape
    kinds = {"sbs": "side by side", "tab": "top and bottom"}
    kind = kinds.get(layout.removeprefix("half-"))
    data = [item for item in stream.get("side_data_list", ()) if "Stereo" in item["side_data_type"]]
    if kind is None:
        assert data == []
        return
    assert [item["type"] for item in data] == [kind]
    if codec == "h264":
        mode = "left_right" if "sbs" in layout else "top_bottom"
        assert frames[0]["tags"]["stereo_mode"] == mode
    if layout.startswith("half"):
        assert stream["sample_aspect_ratio"] == ("2:1" if "sbs" in layout else "1:2")


def _mediainfo(path) -> str:
    """Return how mediainfo says that the eyes lie; empty where it says nothing."""
    command = [program("mediainfo"), "--Inform=Video;%MultiView_Layout%", str(path)]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def _mpv(path) -> str:
    """Return the stereo mode that mpv takes a file for."""
    words = [program("mpv"), "--no-config", "--vo=null", "--ao=null", "--frames=1",
             "--term-playing-msg=IN=${video-params/stereo-in}", str(path)]  # fmt: skip
    said = subprocess.run(
        words, capture_output=True, text=True, check=True, timeout=PATIENCE
    ).stdout
    return said.partition("IN=")[2].split()[0]


@pytest.mark.parametrize(
    ("container", "codec", "layout"),
    [
        ("mkv", "h264", "sbs"), ("mkv", "h264", "half-tab"), ("webm", "vp9", "half-sbs"),
        ("webm", "av1", "tab"),
    ],
)  # fmt: skip
def test_players_and_probes_of_others_read_matroska_and_webm(
    master, tmp_path, container, codec, layout
):
    path = tmp_path / f"clip.{container}"
    export(master, _options(path, layout=layout, codec=codec))
    beside = "sbs" in layout
    lies = "Side by Side" if beside else "Top-Bottom"
    assert _mediainfo(path) == f"{lies} (left eye first)"
    assert _mpv(path) == ("sbs2l" if beside else "ab2l")


@pytest.mark.parametrize("layout", ["sbs", "tab"])
def test_of_mp4_players_and_probes_of_others_read_what_they_read_of_ffmpeg_s_own(
    master, tmp_path, layout
):
    ours, source, theirs = (tmp_path / name for name in ("ours.mp4", "source.mkv", "theirs.mp4"))
    export(master, _options(ours, layout=layout))
    export(master, _options(source, layout=layout))
    command = [program("ffmpeg"), "-v", "error", "-i", str(source), "-c", "copy",
               "-strict", "unofficial", str(theirs)]  # fmt: skip
    subprocess.run(command, check=True)
    assert b"st3d" in ours.read_bytes()
    assert b"st3d" in theirs.read_bytes()
    assert (_mediainfo(ours), _mpv(ours)) == (_mediainfo(theirs), _mpv(theirs))


@pytest.mark.parametrize(
    ("container", "codec", "quality"),
    [
        ("mp4", "h264", None), ("mkv", "h264", None), ("webm", "vp9", None), ("webm", "av1", None),
        ("mp4", "hevc", None), ("mov", "prores", None),
        ("mkv", "ffv1", None), ("mp4", "h264", 1), ("webm", "vp9", 1), ("webm", "av1", 1),
    ],
)  # fmt: skip
def test_grey_ramp_and_colour_bars_survive_within_a_code_value(
    master, tmp_path, container, codec, quality
):
    path = tmp_path / f"chart.{container}"
    export(master, _options(path, layout="sbs", codec=codec, quality=quality))
    seen = _decoded(path, tmp_path).astype(int)
    chart = _chart().astype(int)
    left = seen[:, :WIDTH]
    # What limited range can tell apart: 220 levels for 256 codes.
    ramp = np.abs(left[4:44, 2:-2] - chart[4:44, 2:-2])
    assert ramp.max() <= 1
    inner = np.abs(left[60:90] - chart[60:90]).reshape(30, len(BARS), -1, 3)[:, :, 6:-6]
    assert inner.max() <= 1


def _ramp(height, width, *, levels=256, low=0, high=255) -> np.ndarray:
    """Return grey from left to right in equal steps."""
    values = np.rint(np.linspace(low, high, levels)).astype(np.uint8)
    row = values[np.arange(width) * levels // width]
    return np.broadcast_to(row[None, :, None], (height, width, 3))


def _bars(height, width, *, scale: float) -> np.ndarray:
    """Return the primaries, their mixtures, white and black, upright."""
    on = np.array([(r, g, b) for g in (1, 0) for r in (1, 0) for b in (1, 0)])
    row = np.rint(255 * scale * on).astype(np.uint8)[np.arange(width) * len(on) // width]
    return np.broadcast_to(row[None], (height, width, 3))


CHARTS = {
    "small": np.vstack([_ramp(54, 192), _bars(54, 192, scale=0.75)]),
    "full bars": np.vstack([_bars(90, 320, scale=1), _ramp(90, 320)]),
    "odd": np.vstack([_ramp(135, 479), _bars(136, 479, scale=0.75)]),
    "downwards": _ramp(270, 480).transpose(1, 0, 2),
    "steps": np.vstack([_ramp(60, 640, levels=n, low=16, high=235) for n in (8, 11, 16)]),
    "HD": np.vstack([_ramp(360, 640), _bars(360, 640, scale=1)]),
}
"""Ramps, steps and bars, at sizes that codecs' blocks do not divide."""

REACH = 12
"""How far from an edge blocks of the codecs still mix both sides, pixels."""


def _far_from_edges(picture) -> np.ndarray:
    """Return where no edge, of more than the step of a ramp, is within reach: (H, W)."""
    signed = picture.astype(int)
    edges = np.zeros(picture.shape[:2], np.uint8)
    for axis in (0, 1):
        steep = np.abs(np.diff(signed, axis=axis)).max(2) > 4
        for side in (np.s_[1:], np.s_[:-1]):
            edges[side if axis == 0 else (slice(None), side)] |= steep
    around = np.ones((2 * REACH - 1, 2 * REACH - 1), np.uint8)
    return cv2.dilate(edges, around) == 0


@pytest.mark.parametrize(
    ("container", "codec"),
    [("mp4", "h264"), ("mp4", "hevc"), ("mov", "prores"), ("webm", "vp9"), ("webm", "av1")],
)
@pytest.mark.parametrize("chart", CHARTS)
def test_every_pixel_of_charts_of_many_kinds_is_within_a_code_value(
    tmp_path, chart, container, codec
):
    eye = CHARTS[chart]
    path = tmp_path / f"chart.{container}"
    form = VideoFormat.for_path(
        path, layout=StereoLayout.SBS, fps=Fraction(15), codec=VideoCodec(codec)
    )
    write_segment(tmp_path / "one.mkv", form, [(eye, eye[::-1])] * 2, first_frame=0)
    join_segments([tmp_path / "one.mkv"], path, form)
    meant = pack(eye, eye[::-1], StereoLayout.SBS, multiple=2)
    judged = _far_from_edges(meant)
    assert judged.mean() > 0.2
    off = np.abs(_decoded(path, tmp_path).astype(int) - meant)[judged]
    assert off.max() <= 1


def test_pictures_are_the_master_bit_for_bit(master, tmp_path):
    options = OutputOptions(frames_dir=tmp_path / "frames", segment_length=2)
    assert export(master, options) == FRAMES
    names = sorted(path.name for path in (tmp_path / "frames").glob("*.png"))
    assert names[0] == "left-000007.png"
    assert len(names) == 2 * FRAMES
    right = cv2.imread(str(tmp_path / "frames" / "right-000009.png"))
    assert np.array_equal(cv2.cvtColor(right, cv2.COLOR_BGR2RGB), _chart()[::-1])


def test_the_lossless_form_is_the_master_bit_for_bit(master, tmp_path):
    path = tmp_path / "again.mkv"
    export(master, _options(path, layout="sbs", codec="ffv1"))
    one, other = VideoReader(master.path), VideoReader(path)
    for index in range(FRAMES):
        assert np.array_equal(one.stored(index), other.stored(index))
    one.close()
    other.close()


def test_interrupted_it_goes_on_and_ends_with_the_same_bytes(master, tmp_path):
    whole, broken = tmp_path / "whole.mp4", tmp_path / "broken.mp4"
    export(master, _options(whole, layout="half-sbs"))
    stop, seen = StopFlag(), []

    def hear(event):
        seen.append(type(event).__name__)
        if seen.count("FrameFinished") == 3:
            stop.set()

    with pytest.raises(Interrupted):
        export(master, _options(broken, layout="half-sbs"), on_event=hear, stop=stop)
    assert not broken.exists()
    again = []
    export(master, _options(broken, layout="half-sbs"), on_event=again.append)
    assert again[0].frames_done == 2
    assert broken.read_bytes() == whole.read_bytes()
    assert not list(tmp_path.glob(".*"))


def test_one_eye_is_no_pair(master, tmp_path):
    alone = Master(path=master.path, fps=master.fps, first_frame=0, layout=StereoLayout.LEFT)
    with pytest.raises(OutputError, match="needs both"):
        export(alone, _options(tmp_path / "o.mkv", layout="sbs"))
    with pytest.raises(OutputError, match="another job"):
        export(master, _options(tmp_path / "o.mkv", layout="views"))
