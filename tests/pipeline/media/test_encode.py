"""Pictures encoded into segments: their colours, sizes, bytes, and what goes wrong."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import av
import numpy as np
import pytest

from pipeline.errors import Interrupted, OutputError
from pipeline.media.encode import check_size, in_time, write_segment
from pipeline.media.join import join_segments
from pipeline.media.video_format import (
    Container,
    VideoCodec,
    VideoFormat,
)
from pipeline.stereo import StereoLayout, pack
from tests.support.encoded import (
    HEIGHT,
    LOSSY,
    NTSC,
    WIDTH,
    decoded,
    digest,
    flat_eyes,
    moving_eyes,
    video_format,
    write_and_join,
)
from tests.support.waiting import PATIENCE


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_quick_coding_is_as_good(tmp_path, dtype):
    frames = list(moving_eyes(range(5), dtype=dtype))
    scale = 257 if dtype == np.uint16 else 1
    worst = []
    for is_quick in (False, True):
        video = replace(video_format(), is_quick=is_quick)
        out, _ = write_and_join(tmp_path, f"quick-{is_quick}", video, [frames[:3], frames[3:]])
        errors = [
            np.abs(picture / 1.0 - np.concatenate(eyes, axis=1) / scale).mean()
            for picture, eyes in zip(decoded(out, "rgb24"), frames, strict=True)
        ]
        worst.append(max(errors))
    assert worst[1] <= 1.05 * worst[0]


def test_quick_coding_holds_no_frame_back(tmp_path):
    """What is held back would be coded all at once at the end of a segment."""
    out, _ = write_and_join(
        tmp_path, "quick", replace(video_format(), is_quick=True), [list(moving_eyes(range(8)))]
    )
    with av.open(str(out)) as container:
        times = [packet.pts for packet in container.demux(video=0) if packet.size]
    assert times == sorted(times), "none waits for one after it"
    assert len(times) == 8


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


@pytest.mark.parametrize(
    ("shown", "said", "expected"),
    [
        ([0], [5411126631571865638], [0]),
        ([0], [-8604168327759790941], [0]),
        ([0, 3, 1, 2], [77, -2, -1, 0], [-1, 0, 1, 2]),
        ([0, 2, 1], [-2, -1, 0], [-2, -1, 0]),
        ([4, 5], [None, None], [None, None]),
    ],
)
def test_no_packet_is_decoded_after_it_is_shown(shown, said, expected):
    """x265 leaves times of decoding unset where there are fewer frames than it keeps back."""
    packets = [SimpleNamespace(pts=pts, dts=dts) for pts, dts in zip(shown, said, strict=True)]
    assert [packet.dts for packet in in_time(packets)] == expected


@pytest.mark.parametrize("shape", [(2, 2), (14, 200), (200, 13)])
def test_sizes_that_hevc_does_not_take_are_refused_before_the_work(tmp_path, shape):
    form = video_format(codec=VideoCodec.HEVC, layout=StereoLayout.LEFT)
    with pytest.raises(OutputError, match="hevc takes no pictures of"):
        check_size(tmp_path / "out.mkv", form, shape, 1)


# Segments


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
from tests.support.encoded import moving_eyes, video_format
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
    here = str(Path(__file__).parents[3])
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
from tests.support.encoded import moving_eyes, video_format
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
    here = str(Path(__file__).parents[3])
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


def test_pictures_shown_again_are_the_pictures_that_equal_ones_would_be(tmp_path):
    first, second = moving_eyes(range(2))
    again, _ = write_and_join(tmp_path, "again", video_format(), [[first, first, second, second]])
    copies = [tuple(map(np.copy, eyes)) for eyes in (first, first, second, second)]
    anew, _ = write_and_join(tmp_path, "anew", video_format(), [copies])
    assert digest(again) == digest(anew)
