"""From what cameras send to frames: the same as from the disk, and nothing that harms."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.errors import SceneError
from pipeline.media.layouts import describe_path
from pipeline.media.live_frames import (
    EncodedPicture,
    LiveFrames,
    PictureEncoding,
    decode_color,
    decode_samples,
)
from pipeline.media.live_manifest import live_manifest, read_live_manifest
from pipeline.media.live_source import LiveSource
from pipeline.media.source import open_scene
from pipeline.synthetic.scene import SampleScene
from pipeline.synthetic.writing import write_scene

SHAPE = (24, 40)
PIXELS = 1 << 20
CHANCE = np.random.default_rng(7)
RGB = CHANCE.integers(0, 256, (*SHAPE, 3), np.uint8)
GREY16 = CHANCE.integers(0, 65536, SHAPE).astype(np.uint16)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    folder = tmp_path_factory.mktemp("live") / "scene"
    write_scene(folder, SampleScene(width=48, height=36, num_views=3), num_frames=2)
    return folder


def raw(samples, name):
    return EncodedPicture(
        encoding=PictureEncoding.RAW, data=samples.tobytes(), width=samples.shape[1],
        height=samples.shape[0], pixel_format=name,
    )  # fmt: skip


def png(samples):
    return EncodedPicture(
        encoding=PictureEncoding.PNG, data=cv2.imencode(".png", samples)[1].tobytes()
    )


@pytest.mark.parametrize("encoding", [None, PictureEncoding.PNG, PictureEncoding.RAW])
def test_a_scene_that_is_sent_is_the_scene_number_for_number(scene, encoding):
    with LiveSource(describe_path(scene), encoding=encoding) as source, open_scene(scene) as disk:
        frames = LiveFrames(source.manifest)
        for index in source.frame_indices:
            sent = source.read(index)
            parts = [
                {view: item for (view, part), item in sent.items() if part == which}
                for which in ("color", "depth")
            ]
            decoded, refused = frames.decode(*parts)
            assert refused == []
            ours, theirs = frames.frame(index, decoded), disk.read(index)
            assert (ours.left, ours.right) == (theirs.left, theirs.right)
            assert ours.depth_is_metric == theirs.depth_is_metric
            for one, two in zip(ours.views, theirs.views, strict=True):
                assert one.view_id == two.view_id
                assert np.array_equal(one.luma, two.luma)
                assert np.array_equal(one.chroma, two.chroma)
                assert np.array_equal(one.depth_map, two.depth_map, equal_nan=True)


@pytest.mark.parametrize(
    ("item", "expected"),
    [
        (raw(RGB, "rgb24"), RGB), (raw(RGB[..., ::-1].copy(), "bgr24"), RGB),
        (raw(np.dstack([RGB, RGB[..., :1]]), "rgba"), RGB), (png(RGB[..., ::-1]), RGB),
    ],
)  # fmt: skip
def test_colour_by_any_way_is_the_same(item, expected):
    picture = decode_color(item, max_pixels=PIXELS)
    assert np.allclose(picture.luma, expected @ np.array([0.299, 0.587, 0.114]), atol=1e-3)


@pytest.mark.parametrize("item", [raw(GREY16, "gray16le"), png(GREY16)])
def test_depth_keeps_its_numbers(item):
    assert np.array_equal(decode_samples(item, max_pixels=PIXELS), GREY16)


def _bomb(width, height):
    """A small PNG file that says it is a large picture."""

    def chunk(name, data):
        check = zlib.crc32(name + data)
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", check)

    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    body = zlib.compress(bytes(1000))
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", body)
            + chunk(b"IEND", b""))  # fmt: skip


@pytest.mark.parametrize(
    ("item", "said"),
    [
        (EncodedPicture(encoding=PictureEncoding.PNG, data=_bomb(20000, 20000)), "up to"),
        (EncodedPicture(encoding=PictureEncoding.PNG, data=_bomb(1, 100_000)), "up to"),
        (EncodedPicture(encoding=PictureEncoding.PNG, data=_bomb(2000, 1000)), "too good"),
        (EncodedPicture(encoding=PictureEncoding.JPEG, data=_bomb(8, 8)), "is PNG"),
        (EncodedPicture(encoding=PictureEncoding.PNG, data=b"GIF89a"), "not an image"),
        (EncodedPicture(encoding=PictureEncoding.PNG, data=b""), "empty"),
        (EncodedPicture(encoding=PictureEncoding.PNG, data=b"P6\n1 1\n255\nabc"), "is PNM"),
        (raw(RGB[:-1], "gray16le"), "bytes"), (raw(RGB, "nv12"), "not supported"),
        (raw(GREY16[:, :0], "gray"), "pixels"), (raw(GREY16.astype("<f4"), "grayf32le"), "depth"),
    ],
)  # fmt: skip
def test_what_is_not_as_it_says_is_refused_before_decoding(item, said):
    with pytest.raises(SceneError, match=said):
        decode_color(item, max_pixels=2 << 20)


@given(
    data=st.binary(max_size=300), head=st.sampled_from([b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"])
)
def test_garbage_is_refused_and_nothing_else(data, head):
    for encoding in (PictureEncoding.PNG, PictureEncoding.JPEG):
        with pytest.raises(SceneError):
            decode_color(EncodedPicture(encoding=encoding, data=head + data), max_pixels=PIXELS)


def test_a_frame_goes_on_without_what_is_refused(scene):
    with LiveSource(describe_path(scene)) as source:
        sent = source.read(source.frame_indices.start)
        frames = LiveFrames(source.manifest)
    color = {view: item for (view, part), item in sent.items() if part == "color"}
    depth = {view: item for (view, part), item in sent.items() if part == "depth"}
    broken = EncodedPicture(encoding=PictureEncoding.PNG, data=b"x")
    decoded, refused = frames.decode(color, {**depth, "cam2": broken})
    assert [(item.view_id, item.part) for item in refused] == [("cam2", "depth")]
    frame = frames.frame(0, decoded)
    assert frame.view("cam2").depth_is_estimated
    unneeded = frames.frame(0, decoded, depth=("cam0", "cam1")).view("cam2")
    assert unneeded.depth_map is None
    assert np.array_equal(unneeded.luma, frame.view("cam2").luma)
    plain, _ = frames.decode(color, depth, colour=("cam0", "cam1"))
    assert [name for name, item in plain.color.items() if item.chroma is None] == ["cam2"]
    assert np.array_equal(plain.color["cam2"].luma, frame.view("cam2").luma)
    decoded, refused = frames.decode({**color, "cam0": png(RGB)}, depth)
    assert "40×24 pixels, others of the frame are 48×36" in refused[0].reason
    assert [view.view_id for view in frames.frame(0, decoded).views] == ["cam1", "cam2"]
    decoded, _ = frames.decode({**color, "cam1": broken}, depth)
    with pytest.raises(SceneError, match="needed, and missing"):
        frames.frame(0, decoded)


BARE = {"format": "depthsr-scene/1", "views": [{"id": "a"}, {"id": "b"}]}
DEPTH = {"kind": "disparity"}


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (BARE, set()),
        ({**BARE, "depth": DEPTH}, {"a", "b"}),
        ({**BARE, "depth": DEPTH, "views": [{"id": "a", "depth": True}, {"id": "b"}]}, {"a"}),
        ({**BARE, "depth": DEPTH,
          "views": [{"id": "a", "color": "a.png", "depth": "d.png"},
                    {"id": "b", "color": "/etc/passwd"}]}, {"a"}),
    ],
)  # fmt: skip
def test_which_views_send_depth(content, expected):
    manifest = live_manifest(content)
    assert manifest.depth_ids == expected
    assert live_manifest(manifest.content).content == manifest.content
    assert "color" not in str(manifest.content)


@pytest.mark.parametrize(
    ("raw_manifest", "said"),
    [
        (b"", "not JSON"), (b"[]", "JSON object"), (b'{"format": "x"}', "format"),
        (b'{"format": "depthsr-scene/1", "views": [1, 2]}', "JSON object"),
        (b'{"format": "depthsr-scene/1", "views": [{"id": "a"}, {"id": "a"}]}', "twice"),
        (b'{"format": "depthsr-scene/1", "views": [{"id": "a"}], "x": 1}', "unknown key 'x'"),
        (b'{"format": "depthsr-scene/1", "views": [{"id": "a", "depth": 3}, {"id": "b"}]}',
         "true or false"),
    ],
)  # fmt: skip
def test_manifests_that_are_none_say_why(raw_manifest, said):
    with pytest.raises(SceneError, match=said):
        read_live_manifest(raw_manifest)
