"""What displays are refused for, and the disparities of the test of stereo acuity."""

from __future__ import annotations

import base64
import math
from typing import Any

import numpy as np
import pytest

from dscqs.displays import shipped_profiles
from tests.support.stereo import light_of, shift_between

SEEN = {
    "webgl2": True, "largestTexture": 8192, "canvas": [1920, 1080], "ratio": 1, "zoom": 1,
    "fullscreen": True, "webxr": False, "refreshHz": 60.0,
}  # fmt: skip
REFUSALS = """async ([profile, seen]) => {
  const {refusals} = await import("/layout.js");
  return refusals(profile, seen).map((reason) => reason.code);
}"""


@pytest.mark.parametrize(
    ("name", "change", "codes"),
    [
        ("passive-monitor", {}, []),
        ("passive-monitor", {"ratio": 2}, []),  # pixels of the canvas are those of the screen
        ("passive-monitor", {"canvas": [1536, 864]}, ["wrong-size"]),
        ("passive-monitor", {"canvas": None, "ratio": 1.25}, ["no-device-pixels"]),
        ("passive-monitor", {"zoom": 1.5}, ["pinched"]),
        ("passive-monitor", {"fullscreen": False}, ["no-fullscreen"]),
        ("passive-monitor", {"webgl2": False}, ["no-webgl2"]),
        ("polarised", {}, ["wrong-size"]),
        ("polarised", {"canvas": [2048, 768]}, []),
        ("shutter-120", {"refreshHz": 119.9}, []),
        ("shutter-120", {}, ["slow-refresh"]),
        ("headset", {}, ["no-webxr"]),
        ("headset", {"webxr": True, "fullscreen": False, "canvas": [300, 150]}, []),
    ],
)
def test_what_a_display_is_refused_for(tab: Any, name, change, codes):
    profile = shipped_profiles()[name].as_dict()
    assert tab.evaluate(REFUSALS, [profile, {**SEEN, **change}]) == codes


def test_frames_in_turn_without_a_code_are_refused(tab: Any):
    profile = {**shipped_profiles()["shutter-120"].as_dict(), "eye_code": "none"}
    assert tab.evaluate(REFUSALS, [profile, {**SEEN, "refreshHz": 120}]) == ["no-eye-code"]


@pytest.mark.parametrize(
    ("name", "finest"),
    [("passive-monitor", 12.5), ("autostereoscopic", 26), ("polarised", None)],
)
def test_disparities_follow_from_pitch_and_distance(tab: Any, name, finest):
    profile = shipped_profiles()[name]
    levels = tab.evaluate(
        """async (profile) => {
          const {LEVELS, disparityOf} = await import("/stereogram.js");
          return LEVELS.map((level) => [level, disparityOf(level, profile)]);
        }""",
        profile.as_dict(),
    )
    assert [level for level, _ in levels] == [160, 100, 63, 50, 40, 32, 26, 20, 16, 12.5]
    if profile.pixel_pitch_mm is None:
        assert all(found is None for _, found in levels)
        return
    height_mm = profile.height_px * profile.pixel_pitch_mm
    for arcsec, found in levels:
        angle = math.radians(arcsec / 3600)
        on_screen = profile.distance_heights * height_mm * math.tan(angle)
        assert found["pixels"] == pytest.approx(on_screen / profile.pixel_pitch_mm, rel=1e-9)
    assert min(level for level, found in levels if found["isShown"]) == finest


@pytest.mark.parametrize("disparity", [0.1, 0.7, 2.6])
@pytest.mark.parametrize("front", [0, 1, 2])
def test_one_square_lies_in_front_by_parts_of_a_pixel(tab: Any, front, disparity):
    width, height = 600, 200
    made = tab.evaluate(
        """async (asked) => {
          const {makeStereogram, squareOf} = await import("/stereogram.js");
          const pixels = makeStereogram(asked);
          let text = "";
          for (let i = 0; i < pixels.length; i += 4) text += String.fromCharCode(pixels[i]);
          return {codes: btoa(text), squares: [0, 1, 2].map(
            (index) => squareOf(asked.width, asked.height, index))};
        }""",
        {"width": width, "height": height, "front": front, "disparity": disparity, "seed": 7},
    )
    codes = np.frombuffer(base64.b64decode(made["codes"]), np.uint8)
    light = light_of(codes.reshape(height, 2 * width))
    left, right = light[:, :width], light[:, width:]
    for index, square in enumerate(made["squares"]):
        inner = np.s_[
            square["top"] + 6 : square["top"] + square["side"] - 6,
            square["left"] + 6 : square["left"] + square["side"] - 6,
        ]
        if index != front:
            np.testing.assert_array_equal(left[inner], right[inner])
        else:
            assert shift_between(left[inner], right[inner]) == pytest.approx(disparity, abs=0.03)


@pytest.mark.parametrize("name", ["passive-uhd-tv", "polarised", "side-by-side-tv", "anaglyph"])
def test_a_click_on_a_square_is_an_answer_for_it(tab: Any, name: str):
    """Within either edge of each square, on a screen of any width."""
    found = tab.evaluate(
        """async (profile) => {
          const {pictureSize, squareAt, squareOf} = await import("/stereogram.js");
          const {placeEye, screenSize} = await import("/layout.js");
          const screen = screenSize(profile);
          const size = pictureSize(profile);
          const [first] = placeEye(screen, size);
          return [0, 1, 2].map((index) => {
            const {left, side} = squareOf(...size, index);
            return [1, side - 1].map((at) => squareAt((first + left + at) / screen[0], profile));
          });
        }""",
        shipped_profiles()[name].as_dict(),
    )
    assert found == [[0, 0], [1, 1], [2, 2]]
