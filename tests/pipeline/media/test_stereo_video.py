"""Video files whose pictures hold both eyes."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from pipeline.colour import to_rgb
from pipeline.errors import SceneError
from pipeline.media.layouts import describe_path
from pipeline.media.source import open_scene


def write_stereo(path: Path, size: tuple[int, int], *, split: str = "x", **settings) -> Path:
    """Write two frames whose left or upper half is reddish, the other one blueish."""
    height, width = size
    with av.open(str(path), "w") as output:
        stream = output.add_stream(settings.pop("codec", "libx264"), rate=Fraction(24))
        stream.height, stream.width, stream.pix_fmt = height, width, "yuv444p"
        if "aspect" in settings:
            stream.codec_context.sample_aspect_ratio = settings["aspect"]
        stream.options = settings.get("options", {})
        stream.metadata.update(settings.get("metadata", {}))
        for _ in range(2):
            rgb = np.full((height, width, 3), (200, 60, 40), np.uint8)
            if split == "x":
                rgb[:, width // 2 :] = (40, 60, 200)
            else:
                rgb[height // 2 :] = (40, 60, 200)
            output.mux(stream.encode(av.VideoFrame.from_ndarray(rgb, "rgb24")))
        output.mux(stream.encode())
    return path


def halves(source) -> list[str]:
    """Return which colour the left and the right view have."""
    names = []
    for view in source.read(1).views:
        red, _, blue = to_rgb(view.luma, view.chroma, 8).reshape(-1, 3).mean(axis=0)
        names.append("red" if red > blue + 60 else "blue" if blue > red + 60 else "mixed")
    return names


@pytest.mark.parametrize(
    ("layout", "size", "split", "eye", "aspect"),
    [
        ("sbs", (24, 80), "x", (24, 40), 1),
        ("half-sbs", (24, 40), "x", (24, 20), 2),
        ("tab", (48, 40), "y", (24, 40), 1),
        ("half-tab", (24, 40), "y", (12, 40), Fraction(1, 2)),
    ],
)
def test_an_untold_video_is_read_as_it_is_told(tmp_path, layout, size, split, eye, aspect):
    path = write_stereo(tmp_path / "clip.mkv", size, split=split)
    said = r"clip\.mkv: does not say .*: the input layout must \(--input-layout: sbs, half-sbs"
    with pytest.raises(SceneError, match=said):
        open_scene(path)
    with open_scene(path, input_layout=layout) as source:
        info = source.info
        assert info.layout == "stereo-video"
        assert (info.input_layout, info.pixel_aspect) == (layout, aspect)
        assert info.lr_shape == eye
        assert info.view_ids == (info.left, info.right) == ("left", "right")
        assert info.frame_indices == range(2)
        assert info.has_depth == (False, False)
        assert halves(source) == ["red", "blue"]


@pytest.mark.parametrize(
    ("name", "size", "settings", "layout", "order"),
    [
        ("a.mkv", (24, 80), {"metadata": {"stereo_mode": "left_right"}}, "sbs", "red blue"),
        ("a.mkv", (24, 80), {"metadata": {"stereo_mode": "right_left"}}, "sbs", "blue red"),
        ("a.mp4", (24, 80), {"options": {"x264-params": "frame-packing=3"}}, "sbs", "red blue"),
        ("a.mp4", (24, 40), {"options": {"x264-params": "frame-packing=3"}}, "half-sbs",
         "red blue"),
        ("a.mp4", (24, 64), {"options": {"x264-params": "frame-packing=3"}, "aspect": 2},
         "half-sbs", "red blue"),
        ("a_3D_HSBS_LR.mp4", (24, 64), {}, "half-sbs", "red blue"),
        ("a_3D_SBS_LR.mp4", (24, 64), {}, "sbs", "red blue"),
        ("a.half-sbs.mp4", (24, 64), {}, "half-sbs", "red blue"),
        ("a.3d.lr.mp4", (24, 64), {}, "sbs", "red blue"),
        ("Side by side.mp4", (24, 64), {}, "sbs", "red blue"),
    ],
)  # fmt: skip
def test_tags_and_names_tell_side_by_side(tmp_path, name, size, settings, layout, order):
    path = write_stereo(tmp_path / name, size, **settings)
    with open_scene(path) as source:
        assert source.info.input_layout == layout
        assert f"read as {layout}: sbs by the" in source.info.warnings[0]
        assert "if that is wrong, give the input layout" in source.info.warnings[0]
        assert halves(source) == order.split()


@pytest.mark.parametrize(
    ("name", "size", "layout"),
    [("a.3D.TAB.mkv", (48, 40), "tab"), ("a_3d_HTAB.mkv", (24, 40), "half-tab"),
     ("a_3D_OU.mkv", (24, 40), "half-tab")],
)  # fmt: skip
def test_names_tell_top_bottom(tmp_path, name, size, layout):
    with open_scene(write_stereo(tmp_path / name, size, split="y")) as source:
        assert source.info.input_layout == layout
        assert halves(source) == ["red", "blue"]


@pytest.mark.parametrize(
    ("layout", "size", "eye"),
    [
        ("sbs", (9, 31), (9, 16)), ("half-sbs", (9, 31), (9, 16)),
        ("tab", (31, 9), (16, 9)), ("half-tab", (31, 9), (16, 9)),
        ("sbs", (9, 32), (9, 16)), ("tab", (32, 9), (16, 9)),
    ],
)  # fmt: skip
def test_of_an_odd_number_of_lines_none_is_lost_and_the_last_is_repeated(
    tmp_path, layout, size, eye
):
    """As many as an encoder that cuts the last one off leaves of two eyes."""
    picture = np.random.default_rng(2).integers(0, 256, (*size, 3), np.uint8)
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("ffv1", rate=Fraction(24))
        stream.height, stream.width, stream.pix_fmt = *size, "bgr0"
        output.mux(
            stream.encode(av.VideoFrame.from_ndarray(picture, "rgb24").reformat(format="bgr0"))
        )
        output.mux(stream.encode())
    with open_scene(path, input_layout=layout) as source:
        assert source.info.lr_shape == eye
        seen = [to_rgb(view.luma, view.chroma, 8) for view in source.read(0).views]
        is_said = any("the last one is repeated" in note for note in source.info.warnings)
    axis = 1 if "sbs" in layout else 0
    whole = np.concatenate(seen, axis=axis)
    expected = np.pad(
        picture,
        [(0, large - small) for large, small in zip(whole.shape, picture.shape, strict=True)],
        mode="edge",
    )
    assert np.abs(whole.astype(int) - expected).max() <= 1
    assert is_said == (size[axis] % 2 == 1)


def write_spatial(path: Path, *boxes: bytes) -> Path:
    """Write video of HEVC, with more boxes in the entry of its track; its index stands last."""
    with av.open(str(path), "w", format="mov") as output:
        options = {"x265-params": "log-level=none:bframes=0"}
        stream = output.add_stream("libx265", rate=Fraction(24), options=options)
        stream.height, stream.width, stream.pix_fmt = 48, 64, "yuv420p"
        stream.codec_context.codec_tag = "hvc1"
        for number in range(2):
            grey = np.full((72, 64), 128, np.uint8)
            frame = av.VideoFrame.from_ndarray(grey, "yuv420p")
            frame.pts = number
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    data = bytearray(path.read_bytes())
    added = b"".join(boxes)
    at = data.rindex(b"moov")
    for kind in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"hvc1"):
        at = data.index(kind, at)
        size = int.from_bytes(data[at - 4 : at], "big")
        data[at - 4 : at] = (size + len(added)).to_bytes(4, "big")
    data[at - 4 + size : at - 4 + size] = added
    path.write_bytes(data)
    return path


def box(kind: bytes, *content: bytes) -> bytes:
    inside = b"".join(content)
    return (8 + len(inside)).to_bytes(4, "big") + kind + inside


SECOND_LAYER = box(
    b"lhvC", bytes([1, 0xF0, 0, 0xFC, 0xCF, 1]),  # as of ISO/IEC 14496-15, with one array
    bytes([0xA7, 0, 1, 0, 6, 0x4E, 0x09, 5, 1, 0, 0x80]),  # of one message (SEI) of layer 1
)  # fmt: skip


BOTH_EYES = box(
    b"vexu",
    box(
        b"eyes", box(b"stri", bytes([0, 0, 0, 0, 3])), box(b"hero", bytes([0, 0, 0, 0, 1])),
        box(b"cams", box(b"blin", bytes([0, 0, 0, 0, 0, 0, 0x4B, 0x28]))),
    ),
)  # fmt: skip
"""What a phone writes: both views are there, the left one first, 19.24 mm apart."""


def test_eyes_in_layers_of_hevc_are_not_read_as_one_view(tmp_path):
    """Boxes as spatial video has them, made by hand: no encoder that can be had writes any."""
    film = write_spatial(tmp_path / "take 3.mov", SECOND_LAYER, BOTH_EYES)
    for layout in (None, "sbs"):
        with pytest.raises(SceneError) as told:
            describe_path(film, layout)
        assert "MV-HEVC" in str(told.value)
        assert "vpos:left -c:v ffv1 'take 3_left.mkv'" in str(told.value)
    film.rename(tmp_path / "clip_left.mov")
    write_spatial(tmp_path / "clip_right.mov")
    with open_scene(tmp_path) as source:
        assert any("MV-HEVC): left; " in text for text in source.info.warnings)


@pytest.mark.parametrize("boxes", [(), (SECOND_LAYER,), (BOTH_EYES,)])
def test_one_layer_or_an_alpha_channel_is_no_spatial_video(tmp_path, boxes):
    film = write_spatial(tmp_path / "clip_SBS.mov", *boxes)
    assert describe_path(film).layout == "stereo-video"


@pytest.mark.parametrize(
    ("times", "is_uneven"),
    [([0, 42, 83, 125, 167], False), ([0, 42, 83, 125, 208, 250], True), ([0], False)],
)
def test_frames_at_uneven_times_are_said(tmp_path, times, is_uneven):
    """They are paired by number, and the result shows as many a second as the file says."""
    path = tmp_path / "a.mkv"
    with av.open(str(path), "w") as output:
        stream = output.add_stream("ffv1", rate=Fraction(24))
        stream.height, stream.width, stream.pix_fmt = 8, 16, "gray"
        stream.codec_context.time_base = Fraction(1, 1000)
        for time in times:
            frame = av.VideoFrame.from_ndarray(np.full((8, 16), 9, np.uint8), "gray")
            frame.pts, frame.time_base = time, Fraction(1, 1000)
            output.mux(stream.encode(frame))
        output.mux(stream.encode())
    with open_scene(path, input_layout="sbs") as source:
        said = [note for note in source.info.warnings if "unequal times in: left, right" in note]
        assert bool(said) == is_uneven
