"""Video files, written with PyAV here and read by the pipeline."""

from __future__ import annotations

import contextlib
import json
import threading
from collections.abc import Collection
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.colour import to_grey, to_rgb
from pipeline.errors import SceneError
from pipeline.media.decode import VideoReader
from pipeline.media.source import open_scene
from tests.support.waiting import PATIENCE

RATE = Fraction(30000, 1001)
HEIGHT, WIDTH, NUM_FRAMES = 34, 62, 22


def rgb_frame(index: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Return a smooth picture, unlike for each frame, (H, W, 3) uint8."""
    row, column = np.mgrid[:height, :width]
    return np.stack(
        [
            128 + 90 * np.sin(column / 9 + index / 3),
            128 + 90 * np.cos(row / 7 - index / 5),
            30 + 8 * index + 0 * row,
        ],
        axis=-1,
    ).astype(np.uint8)


def write_video(
    path: Path,
    *,
    codec: str = "libx264",
    pixel_format: str = "yuv420p",
    options: dict[str, str] | None = None,
    matrix: int = 1,
    tagged: bool = True,
    container: dict[str, str] | None = None,
    metadata: dict[str, str] | None = None,
    size: tuple[int, int] = (HEIGHT, WIDTH),
    frames: int = NUM_FRAMES,
    keys: Collection[int] = (),
) -> Path:
    """Write a video; ``matrix`` is ISO/IEC 23091-2's number, 1 for BT.709 and 6 for BT.601.

    Key frames are those of the codec's own choice, and ``keys``.
    """
    with av.open(str(path), "w", options=container or {}) as output:
        stream = output.add_stream(codec, rate=RATE, options=options or {})
        stream.height, stream.width = size
        stream.pix_fmt = pixel_format
        if tagged:
            stream.codec_context.colorspace = matrix
            stream.codec_context.color_range = 1
        stream.metadata.update(metadata or {})
        for index in range(frames):
            frame = av.VideoFrame.from_ndarray(rgb_frame(index, *size), "rgb24")
            if pixel_format.startswith("yuv"):
                frame = frame.reformat(
                    format=pixel_format,
                    dst_colorspace="ITU709" if matrix == 1 else "ITU601",
                    dst_color_range="MPEG",
                )
            elif pixel_format != "rgb24":
                frame = frame.reformat(format=pixel_format)
            frame.pts, frame.time_base = index, 1 / RATE
            if index in keys:
                frame.pict_type = av.video.frame.PictureType.I
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    return path


B_FRAMES = {"crf": "6", "g": "7", "bf": "3"}

KINDS = {
    "h264.mp4": {"options": B_FRAMES},
    "h264.mkv": {"options": B_FRAMES, "matrix": 6},
    "h264.h264": {"options": B_FRAMES},
    "vp8.webm": {"codec": "libvpx", "matrix": 6,
                 "options": {"auto-alt-ref": "1", "lag-in-frames": "12", "b:v": "3M"}},
    "ffv1.mkv": {"codec": "ffv1", "pixel_format": "yuv444p10le"},
}  # fmt: skip


@pytest.mark.parametrize("name", KINDS)
def test_frames_come_in_presentation_order_and_at_random(tmp_path, name):
    reader = VideoReader(write_video(tmp_path / name, **KINDS[name]))
    assert (reader.height, reader.width) == (HEIGHT, WIDTH)
    assert reader.num_frames == NUM_FRAMES
    assert reader.is_color
    if not name.endswith(".h264"):
        assert abs(reader.fps - RATE) < 0.01
    in_order = [reader.picture(index) for index in range(NUM_FRAMES)]
    for index, picture in enumerate(in_order):
        back = to_rgb(picture.luma, picture.chroma, 8)
        error = np.abs(back.astype(int) - rgb_frame(index)).mean()
        assert error < 4, f"frame {index} is not itself: {error}"
    for index in (21, 3, 4, 15, 0, 7, 6, 14, 13):
        np.testing.assert_array_equal(reader.picture(index).luma, in_order[index].luma)
    reader.close()
    reader.close()


@pytest.mark.parametrize("matrix", [1, 6])
@pytest.mark.parametrize("pixel_format", ["yuv444p", "yuv444p10le"])
def test_the_tagged_matrix_is_honoured(tmp_path, matrix, pixel_format):
    path = write_video(
        tmp_path / "a.mkv", codec="ffv1", pixel_format=pixel_format, matrix=matrix, frames=1
    )
    reader = VideoReader(path)
    assert reader.bit_depth == (10 if "10" in pixel_format else 8)
    picture = reader.picture(0)
    back = to_rgb(picture.luma, picture.chroma, 8)
    assert np.abs(back.astype(int) - rgb_frame(0)).max() <= 3


@pytest.mark.parametrize("name", ["h264.mp4", "h264.mkv", "rgb.mkv"])
def test_luma_without_chroma_is_the_same(tmp_path, name):
    rgb = {"codec": "ffv1", "pixel_format": "bgr0", "tagged": False, "frames": 1}
    reader = VideoReader(write_video(tmp_path / name, **KINDS.get(name, rgb)))
    whole, grey = reader.picture(0), reader.picture(0, with_chroma=False)
    assert whole.chroma is not None
    assert grey.chroma is None
    np.testing.assert_array_equal(grey.luma, whole.luma)
    reader.close()


def test_an_untagged_small_video_is_taken_for_bt_601(tmp_path):
    path = write_video(
        tmp_path / "a.mkv", codec="ffv1", pixel_format="yuv444p", matrix=6, tagged=False, frames=1
    )
    picture = VideoReader(path).picture(0)
    back = to_rgb(picture.luma, picture.chroma, 8)
    assert np.abs(back.astype(int) - rgb_frame(0)).max() <= 3


@pytest.mark.parametrize(
    ("pixel_format", "bits"), [("gray", 8), ("gray10le", 10), ("gray16le", 16)]
)
def test_lossless_grey_is_exact(tmp_path, pixel_format, bits):
    stored = (
        np.random.default_rng(0).integers(0, 2**bits, (5, 7)).astype("u1" if bits == 8 else "<u2")
    )
    with av.open(str(tmp_path / "a.mkv"), "w") as output:
        stream = output.add_stream("ffv1", rate=5)
        stream.height, stream.width, stream.pix_fmt = 5, 7, pixel_format
        output.mux(stream.encode(av.VideoFrame.from_ndarray(stored, pixel_format)))
        output.mux(stream.encode())
    reader = VideoReader(tmp_path / "a.mkv")
    assert (reader.bit_depth, reader.is_color) == (bits, False)
    np.testing.assert_array_equal(reader.samples(0), stored)
    full = np.rint(stored * ((255 if bits == 8 else 65535) / (2**bits - 1)))
    np.testing.assert_array_equal(to_grey(reader.picture(0).luma, bits), full)


def test_lossless_rgb_is_exact(tmp_path):
    path = write_video(
        tmp_path / "a.mkv", codec="ffv1", pixel_format="bgr0", tagged=False, size=(3, 5), frames=3
    )
    reader = VideoReader(path)
    for index in (2, 0, 1):
        picture = reader.picture(index)
        np.testing.assert_array_equal(
            to_rgb(picture.luma, picture.chroma, 8), rgb_frame(index, 3, 5)
        )


@pytest.mark.parametrize("part", [0.25, 0.6, 0.97])
@pytest.mark.parametrize(
    ("name", "container"),
    [
        ("plain.mp4", {}),
        ("fast.mp4", {"movflags": "faststart"}),
        ("a.mkv", {}),
        ("a.webm", {}),
    ],
)
def test_a_truncated_video_is_an_error_that_names_it(tmp_path, name, container, part):
    kind = {"codec": "libvpx", "matrix": 6} if name.endswith("webm") else {"options": B_FRAMES}
    path = write_video(tmp_path / name, container=container, **kind)
    data = path.read_bytes()
    path.write_bytes(data[: int(part * len(data))])
    with pytest.raises(SceneError, match=rf"{name}.*cut short") as caught:
        VideoReader(path)
    assert "\n" not in str(caught.value)


def test_what_is_no_video_is_an_error(tmp_path):
    (tmp_path / "a.mp4").write_bytes(b"nothing of the kind" * 50)
    for name in ("a.mp4", "b.mp4"):
        with pytest.raises(SceneError, match=name):
            VideoReader(tmp_path / name)
    with av.open(str(tmp_path / "c.mkv"), "w") as output:
        stream = output.add_stream("pcm_s16le", rate=8000, layout="mono")
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), layout="mono")
        frame.sample_rate = 8000
        output.mux(stream.encode(frame))
    with pytest.raises(SceneError, match=r"c\.mkv: no video stream"):
        VideoReader(tmp_path / "c.mkv")


def test_a_frame_that_is_not_there_is_named(tmp_path):
    reader = VideoReader(write_video(tmp_path / "a.mkv", frames=3))
    for index in (-1, 3):
        with pytest.raises(SceneError, match=f"frame {index}: no such frame; the file holds 3"):
            reader.picture(index)


def test_another_thread_may_read(tmp_path):
    reader = VideoReader(write_video(tmp_path / "a.mp4", options=B_FRAMES))
    expected = reader.picture(9).luma
    found = []
    thread = threading.Thread(target=lambda: found.append(reader.picture(9).luma))
    thread.start()
    thread.join(PATIENCE)
    np.testing.assert_array_equal(found[0], expected)


@pytest.mark.parametrize(
    ("name", "options", "metadata", "expected"),
    [
        ("a.mkv", {}, {"stereo_mode": "left_right"}, ("sbs", False)),
        ("a.mkv", {}, {"stereo_mode": "bottom_top"}, ("tab", True)),
        ("a.mp4", {"x264-params": "frame-packing=3"}, {}, ("sbs", False)),
        ("a.mp4", {"x264-params": "frame-packing=4"}, {}, ("tab", False)),
        ("a.mp4", {}, {}, None),
    ],
)
def test_stereo_tags_are_found(tmp_path, name, options, metadata, expected):
    path = write_video(tmp_path / name, options=options, metadata=metadata, frames=3)
    tag = VideoReader(path).stereo
    assert (None if tag is None else (tag.arrangement, tag.right_first)) == expected


def video_scene(folder: Path, **changes) -> Path:
    manifest = {
        "format": "depthsr-scene/1",
        "views": [{"id": name, "color": f"{name}.mp4", "depth": f"{name}-d.mkv"} for name in "ab"],
        "depth": {"kind": "disparity", "scale": 0.5, "offset": 0, "unknown": None},
        **changes,
    }
    (folder / "scene.json").write_text(json.dumps(manifest))
    return folder


def test_a_scene_of_videos_starts_anywhere(tmp_path):
    for name in "ab":
        write_video(tmp_path / f"{name}.mp4", options=B_FRAMES)
        write_video(tmp_path / f"{name}-d.mkv", codec="ffv1", pixel_format="gray", tagged=False)
    video_scene(tmp_path, first_frame=100)
    with open_scene(tmp_path) as source:
        assert source.info.frame_indices == range(100, 100 + NUM_FRAMES)
        assert abs(source.info.fps - RATE) < 0.01
        in_order = [frame.view("b") for frame in source.frames()]
    for start in (108, 115):
        with open_scene(tmp_path) as source:
            for frame in source.frames(start, start + 3):
                view, expected = frame.view("b"), in_order[frame.frame_index - 100]
                np.testing.assert_array_equal(view.luma, expected.luma)
                np.testing.assert_array_equal(view.depth_map, expected.depth_map)
    assert in_order[5].depth_map.max() > 60


def test_views_of_a_scene_that_were_let_go_come_back_with_the_depth_of_the_same_frame(tmp_path):
    for name in "ab":
        write_video(tmp_path / f"{name}.mp4", options=B_FRAMES)
        write_video(
            tmp_path / f"{name}-d.mkv", codec="ffv1", pixel_format="gray", tagged=False,
            options={"g": "11"},
        )  # fmt: skip
    with open_scene(video_scene(tmp_path)) as source:
        in_order = list(source.frames())
    with open_scene(tmp_path) as source:
        for index in range(6):
            assert source.read(index, only=("a",)).view("a").luma.shape == (HEIGHT, WIDTH)
        assert source.approach(7), "a key frame of the other view"
        comes = [source.approach(index, depth=("a", "b")) for index in (9, 10, 11)]
        assert comes == [False, False, True]
        for view, expected in zip(source.read(11).views, in_order[11].views, strict=True):
            np.testing.assert_array_equal(view.luma, expected.luma)
            np.testing.assert_array_equal(view.depth_map, expected.depth_map)


def test_videos_of_unequal_length_are_named(tmp_path):
    for name, frames in (("a", 5), ("b", 4)):
        write_video(tmp_path / f"{name}.mp4", frames=frames)
        write_video(
            tmp_path / f"{name}-d.mkv", codec="ffv1", pixel_format="gray", tagged=False, frames=5
        )
    with pytest.raises(SceneError, match=r"view 'b', frame 4: .*b\.mp4: the file holds 4 frames"):
        open_scene(video_scene(tmp_path))


def test_a_truncated_mp4_in_a_scene_names_view_and_file(tmp_path):
    for name in "ab":
        write_video(tmp_path / f"{name}.mp4")
    (tmp_path / "b.mp4").write_bytes((tmp_path / "b.mp4").read_bytes()[:-100])
    views = [{"id": name, "color": f"{name}.mp4"} for name in "ab"]
    with pytest.raises(SceneError, match=r"view 'b', frame 0: .*b\.mp4: .*cut short"):
        open_scene(video_scene(tmp_path, views=views))


OPEN = "scenecut=0:open-gop=1:b-pyramid=normal"

GROUPS = {
    "closed.mp4": {"options": B_FRAMES},
    "open.mkv": {"options": B_FRAMES | {"x264-params": OPEN}},
    "open.ts": {"options": B_FRAMES | {"x264-params": OPEN}},
    "of-unequal-length.mkv": {"options": {"crf": "6", "g": "1000", "bf": "3", "forced-idr": "1"},
                              "keys": (2, 11, 13)},
    "one.mkv": {"options": {"crf": "6", "g": "1000", "bf": "3"}},
    "refreshed.mkv": {"options": {"crf": "6", "g": "7", "x264-params": "intra-refresh=1"}},
    "hevc.mkv": {"codec": "libx265", "options": {"x265-params":
                 "log-level=none:keyint=6:min-keyint=6:open-gop=1:bframes=3:scenecut=0"}},
    "mpeg2.mkv": {"codec": "mpeg2video", "options": {"g": "6", "bf": "2", "b:v": "3M"}},
    "vp9.webm": {"codec": "libvpx-vp9", "options": {"g": "6", "auto-alt-ref": "1", "b:v": "2M",
                                                    "lag-in-frames": "12"}},
    "ffv1.mkv": {"codec": "ffv1", "pixel_format": "gray"},
}  # fmt: skip


@pytest.mark.parametrize("name", GROUPS)
def test_a_video_that_was_let_go_is_taken_up_again_at_the_same_frames(tmp_path, name):
    path = write_video(tmp_path / name, **GROUPS[name])
    straight, skipping = VideoReader(path), VideoReader(path)
    expected = [straight.picture(index).luma for index in range(NUM_FRAMES)]
    rng = np.random.default_rng(len(name))
    for _ in range(6):
        index = 0
        while index < NUM_FRAMES:
            for soon in range(index, min(index + rng.integers(4), NUM_FRAMES)):
                skipping.approach(soon)
            np.testing.assert_array_equal(skipping.picture(index).luma, expected[index])
            index += rng.integers(1, 10)
    for reader in (straight, skipping):
        reader.close()


def test_a_video_is_approached_by_a_few_frames_at_a_time_or_from_its_next_key_frame(tmp_path):
    options = {"crf": "6", "g": "1000", "bf": "3"}
    one = VideoReader(write_video(tmp_path / "one.mkv", options=options, frames=40))
    assert one.approach(0)
    one.picture(0)
    assert [one.approach(index) for index in range(10, 25)] == [False] * 7 + [True] * 8
    keys = VideoReader(write_video(tmp_path / "keys.mkv", options=B_FRAMES, frames=40))
    keys.picture(0)
    assert [keys.approach(index) for index in (5, 6, 7, 8)] == [False, False, True, True]
    assert keys.approach(30)
    assert not keys.approach(20)
    every = VideoReader(write_video(tmp_path / "every.mkv", options={"g": "1"}))
    assert [every.approach(index) for index in (20, 3, 9)] == [True] * 3
    for reader in (one, keys, every):
        reader.close()


def test_what_is_passed_and_nothing_refers_to_is_not_decoded(tmp_path):
    options = {"crf": "6", "g": "1000", "bf": "1", "b_strategy": "0"}
    path = write_video(tmp_path / "a.mkv", options=options)
    sound = VideoReader(path)
    expected = [sound.picture(index).luma for index in range(NUM_FRAMES)]
    sound.close()
    with av.open(str(path)) as container:
        packets = [packet for packet in container.demux(video=0) if packet.size]
        times = sorted(packet.pts for packet in packets)
        damaged = packets[8]
        assert damaged.pts < packets[7].pts, "shown before what was decoded before it"
        place, count = times.index(damaged.pts), damaged.size
    content = bytearray(path.read_bytes())
    middle = content.index(bytes(damaged)) + count // 2
    content[middle : middle + count // 4] = bytes(count // 4)
    path.write_bytes(content)
    reader = VideoReader(path)
    reader.picture(0)
    before = av.logging.get_level()
    av.logging.set_level(av.logging.ERROR)
    try:
        with av.logging.Capture(local=False) as complaints:
            for index in range(1, place + 2):
                assert reader.approach(index)
            np.testing.assert_array_equal(reader.picture(place + 1).luma, expected[place + 1])
            assert not complaints
            # threads of the decoder now and then hand a frame out before they have seen the damage
            with contextlib.suppress(SceneError):
                reader.picture(place)
            assert complaints
    finally:
        av.logging.set_level(before)
    reader.close()


def test_a_frame_that_was_passed_may_be_asked_for(tmp_path):
    path = write_video(tmp_path / "a.mkv", options={"crf": "6", "g": "1000", "bf": "3"})
    reader, other = VideoReader(path), VideoReader(path)
    expected = [other.picture(index).luma for index in range(12)]
    reader.picture(0)
    for index in (4, 8, 10):
        reader.approach(index)
        for passed in (index - 2, index - 1):
            np.testing.assert_array_equal(reader.picture(passed).luma, expected[passed])
    for video in (reader, other):
        video.close()


def test_the_rate_of_raw_dv_is_not_the_ticks_of_its_clock(tmp_path):
    """FFmpeg 8 tells 60000 frames a second of it, and 25 when it guesses."""
    path = tmp_path / "tape.dv"
    with av.open(str(path), "w", format="dv") as output:
        stream = output.add_stream("dvvideo", rate=25)
        stream.width, stream.height, stream.pix_fmt = 720, 576, "yuv420p"
        for number in range(3):
            frame = av.VideoFrame.from_ndarray(np.full((864, 720), 128, np.uint8), "yuv420p")
            frame.pts = number
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    reader = VideoReader(path)
    assert (reader.fps, reader.num_frames) == (25, 3)
    reader.close()
