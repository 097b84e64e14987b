"""What cameras say of themselves, and that all they see is sent."""

from __future__ import annotations

import json
from fractions import Fraction

import pytest

from pipeline.errors import ConfigurationError, SceneError
from pipeline.media.instants import Instant
from pipeline.media.live_frames import EncodedPicture, PictureEncoding
from service.bus import keys
from service.bus.keys import Part
from service.bus.memory import MemoryNetwork
from service.streams.feed import Feed
from service.streams.messages import read_input_header
from service.streams.relay import manifest_of_cameras, relay

RATE = Fraction(15)
PICTURE = EncodedPicture(encoding=PictureEncoding.JPEG, data=b"picture")


def test_two_cameras_are_a_pair_and_the_middle_of_more():
    assert manifest_of_cameras(["l", "r"], RATE).pair == ("l", "r")
    four = manifest_of_cameras("abcd", RATE)
    assert (four.view_ids, four.pair, four.fps) == (("a", "b", "c", "d"), ("b", "c"), RATE)
    assert four.depth_ids == frozenset()
    assert manifest_of_cameras("abcd", RATE, left="a").pair == ("a", "c")


def test_a_rig_gives_order_calibration_and_pair_but_no_depth(tiny_scene):
    rig = json.loads((tiny_scene / "scene.json").read_text())
    names = [view["id"] for view in rig["views"]]
    manifest = manifest_of_cameras(reversed(names), RATE, rig)
    assert list(manifest.view_ids) == names
    assert manifest.depth_ids == frozenset()
    assert (manifest.scene.views[0].calibration is None) == ("intrinsics" not in rig["views"][0])
    with pytest.raises(ConfigurationError, match="there are cameras x, y"):
        manifest_of_cameras(["x", "y"], RATE, rig)


@pytest.mark.parametrize("rig", [[], {}, {"views": 5}, {"format": "depthsr-scene/1", "views": [5]}])
def test_what_is_no_rig_is_told(rig):
    with pytest.raises(SceneError, match="manifest"):
        manifest_of_cameras("lr", RATE, rig)


def test_every_picture_is_sent_with_its_frame_and_time():
    network = MemoryNetwork()
    source, listener = network.connect(), network.connect()
    seen = []
    for view in "lr":
        listener.subscribe(keys.input_key("s", view, Part.COLOR), seen.append)
    instants = [
        Instant(taken=5, pictures={"l": PICTURE, "r": PICTURE}),
        Instant(taken=9, pictures={"l": PICTURE}),
    ]
    sent = relay(Feed(source, "s", manifest_of_cameras("lr", RATE)), instants, 2)
    assert (sent.frames, sent.pictures, sent.bytes, sent.incomplete) == (2, 3, 21, 1)
    headers = [read_input_header(message.attachment) for message in seen]
    assert [(item.frame_index, item.capture_time_ns) for item in headers] == [
        (0, 5),
        (0, 5),
        (1, 9),
    ]
