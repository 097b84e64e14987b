"""What is said of a scene."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from pipeline.media.probe import describe, format_description
from pipeline.media.source import MemorySource, open_scene


def test_a_good_scene_is_described_without_warnings(write_scene):
    with open_scene(write_scene(views=4, first=2)) as source:
        description = describe(source)
    assert json.loads(json.dumps(description)) == description
    assert [view["id"] for view in description["views"]] == ["v0", "v1", "v2", "v3"]
    assert (description["width"], description["height"]) == (26, 18)
    assert description["frames"] == {"first": 2, "last": 4, "count": 3}
    assert description["fps"] == "15/1"
    assert description["stereo"] == {"left": "v1", "right": "v2"}
    assert description["depth"] == {"kind": "disparity", "metric": False, "range": [5.0, 50.0]}
    assert description["views"][0]["nearness"] == [5.0, 50.0]
    assert description["warnings"] == []
    text = format_description(description)
    for words in ("4, left to right: v0, v1", "26×18, colour, 8 bits", "3: 2 to 4, 15 a second",
                  "nearness 5 to 50 in the unit of the depth maps, 0.0% unknown",
                  "left v1, right v2", "calibration  no"):  # fmt: skip
        assert words in text
    assert "sound" not in text
    assert "warning" not in text


@pytest.mark.parametrize(
    ("level", "said"),
    [
        (0, "view 'v1', frame 0: every depth value is unknown; it is estimated instead"),
        (80, "view 'v1', frame 0: constant depth, which is one layer"),
        (None, "view 'v1', frame 0: 98% of the depth is unknown"),
    ],
)
def test_suspicious_depth_is_warned_of(write_scene, level, said):
    folder = write_scene(frames=1)
    depth = np.full((18, 26), level or 0, np.uint8)
    if level is None:
        depth[3, :10] = np.arange(10) + 30
    cv2.imwrite(str(folder / "v1/depth-000.png"), depth)
    with open_scene(folder) as source:
        description = describe(source)
    assert said in description["warnings"]
    assert f"warning: {said}" in format_description(description)


def test_missing_depth_is_said(write_scene):
    with open_scene(write_scene(depth=False, shape=(9, 7))) as source:
        description = describe(source)
    assert description["depth"] == {"kind": None, "metric": False, "range": None}
    assert "no depth in: v0, v1; it is estimated from the neighbours" in description["warnings"]
    assert "view 'v0', frame 0: no depth could be estimated" in description["warnings"]
    assert "not given, nothing known" in format_description(description)
    with open_scene(write_scene(depth=False), views=["v1"]) as source:
        warnings = describe(source)["warnings"]
    assert warnings == ["view 'v1', frame 0: no depth, and no neighbour to estimate it from"]


def test_frames_in_memory_are_described_too(write_scene):
    frames = list(open_scene(write_scene()).frames())
    assert describe(MemorySource(frames))["layout"] == "memory"


def test_a_real_metric_scene_is_described_in_distances(scenes_dir):
    with open_scene(scenes_dir / "flower") as source:
        description = describe(source)
    low, high = description["depth"]["range"]
    assert 0 < low < high < 1000
    assert description["calibration"]
    assert "in units of the calibration" in format_description(description)


def test_an_eye_that_is_not_read_is_said(write_scene):
    with open_scene(write_scene(), views=["v0"]) as source:
        assert "left v0, right v1 (not among the views)" in format_description(describe(source))
