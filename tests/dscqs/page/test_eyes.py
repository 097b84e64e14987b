"""The patterns of the calibration, and the drawn tests of the eyes, by what is on the canvas."""

from __future__ import annotations

import base64
import math
from typing import Any

import cv2
import numpy as np
import pytest

PATTERN = """async ([name, size]) => {
  const {makePattern} = await import("/patterns.js");
  const canvas = makePattern(name, size);
  return [canvas.toDataURL("image/png"), canvas.width, canvas.height];
}"""
WIDTH, HEIGHT, LEVEL = 31, 8, 60


def pattern(tab: Any, name: str) -> list[np.ndarray]:
    """Return the codes of the left and the right eye."""
    size = {"width": WIDTH, "height": HEIGHT, "level": LEVEL}
    return np.split(decoded(tab.evaluate(PATTERN, [name, size])[0])[..., 1], 2, axis=1)


def decoded(url: str) -> np.ndarray:
    png = np.frombuffer(base64.b64decode(url.partition(",")[2]), np.uint8)
    return cv2.imdecode(png, cv2.IMREAD_UNCHANGED)


def test_what_leaks_of_the_right_eyes_white_is_matched_by_a_grey(tab: Any):
    left, right = pattern(tab, "crosstalk")
    half = WIDTH // 2
    assert (left[:, :half] == 0).all()
    assert (right[:, :half] == 255).all()
    assert (left[:, half:] == LEVEL).all()
    assert (right[:, half:] == 0).all()
    light = tab.evaluate(
        """async (level) => (await import("/patterns.js")).lightOf(level)""", LEVEL
    )
    assert light == pytest.approx(((LEVEL / 255 + 0.055) / 1.055) ** 2.4, abs=1e-3)


def test_steps_of_grey_are_alike_to_both_eyes_and_fill_the_screen(tab: Any):
    left, right = pattern(tab, "steps")
    np.testing.assert_array_equal(left, right)
    codes = np.unique(left)
    assert (codes[:3].tolist(), codes[-2:].tolist()) == ([0, 4, 8], [252, 255])
    assert (np.diff(left.astype(int), axis=1) >= 0).all()
    assert np.unique(left, return_counts=True)[1].min() >= HEIGHT * (WIDTH // len(codes))


def test_phase_and_pixels(tab: Any):
    left, right = pattern(tab, "phase")
    assert (left.min(), right.max()) == (255, 0)
    left, right = pattern(tab, "pixels")
    np.testing.assert_array_equal(left, right)
    rows, columns = np.indices(left.shape)
    np.testing.assert_array_equal(left, 255 * ((rows + columns) % 2))


PROFILE = {
    "mode": "mono-left", "width_px": 3840, "height_px": 2160, "distance_heights": 3,
    "pixel_pitch_mm": 0.25,
}  # fmt: skip
WORDS = {
    "ringQuestion": "gap?", "directions": {name: name for name in ("up", "right", "down", "left")},
    "unsure": "unsure", "plateQuestion": "number?", "nothing": "nothing",
}  # fmt: skip
RINGS = """async ({profile, words, finest}) => {
  const {askRings} = await import("/questions.js");
  const place = document.createElement("div");
  document.body.replaceChildren(place);
  const gaps = [];
  const found = askRings(place, profile, words);
  while (place.firstChild) {
    const canvas = place.querySelector("canvas");
    const gap = canvas.width / 9;
    gaps.push(gap);
    const context = canvas.getContext("2d");
    const middle = canvas.width / 2;
    const places = {up: [0, -2], right: [2, 0], down: [0, 2], left: [-2, 0]};
    const white = Object.entries(places).filter(([, [x, y]]) => context.getImageData(
      middle + x * gap, middle + y * gap, 1, 1).data[0] > 127);
    if (white.length !== 1) throw new Error(`${white.length} gaps`);
    const said = gap >= finest ? white[0][0] : "unsure";
    [...place.querySelectorAll("button")].find((one) => one.textContent === said).click();
  }
  return {found: await found, gaps};
}"""


def test_rings_have_one_gap_of_the_angle_and_the_finest_seen_is_recorded(tab: Any):
    """Decimal acuity 1 sees a gap of one minute of arc."""
    distance_px = PROFILE["distance_heights"] * PROFILE["height_px"]
    gap = distance_px * math.tan(math.radians(1 / 60))
    asked = {"profile": PROFILE, "words": WORDS, "finest": 2 * gap - 0.3}
    walked = tab.evaluate(RINGS, asked)
    assert walked["found"]["decimal"] == 0.5
    for shown, level in zip(walked["gaps"][::3], (0.25, 0.32, 0.4, 0.5, 0.63), strict=True):
        assert shown == pytest.approx(gap / level, abs=1 / 9)
    blind = tab.evaluate(RINGS, {**asked, "finest": math.inf})
    assert blind["found"]["decimal"] is None
    assert tab.evaluate(RINGS, {**asked, "profile": {**PROFILE, "pixel_pitch_mm": None}})[
        "found"
    ] is None  # fmt: skip


PLATES = """async ({words, sees, seed}) => {
  const {askPlates} = await import("/questions.js");
  const place = document.createElement("div");
  document.body.replaceChildren(place);
  const shapes = Array.from({length: 10}, (_, digit) => {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 480;
    const context = canvas.getContext("2d");
    context.font = "bold 345.6px sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(String(digit), 240, 254.4);
    return context.getImageData(0, 0, 480, 480).data;
  });
  const pictures = [];
  const found = askPlates(place, words, seed);
  while (place.firstChild) {
    const canvas = place.querySelector("canvas");
    pictures.push(canvas.toDataURL("image/png"));
    const {data} = canvas.getContext("2d").getImageData(0, 0, 480, 480);
    const contrast = sees === "nothing" ? [] : shapes.map((shape) => {
      const sums = [0, 0];
      const counts = [0, 0];
      for (let i = 0; i < data.length; i += 4) {
        if (data[i + 3] < 255) continue;
        const inside = shape[i + 3] > 127 ? 1 : 0;
        sums[inside] += data[i] - data[i + 1];
        counts[inside] += 1;
      }
      const count = counts[0] * counts[1] / (counts[0] + counts[1]);
      return Math.abs(sums[0] / counts[0] - sums[1] / counts[1]) * Math.sqrt(count);
    });
    const said = sees === "nothing" ? "nothing" : String(contrast.indexOf(Math.max(...contrast)));
    [...place.querySelectorAll("button")].find((one) => one.textContent === said).click();
  }
  return {found: await found, pictures};
}"""


@pytest.fixture(scope="module")
def read(tab: Any) -> dict[str, Any]:
    """The plates as somebody reads them who knows the shapes of digits and sees red and green."""
    return tab.evaluate(PLATES, {"words": WORDS, "sees": "hue", "seed": 5})


def test_plates_are_read_by_hue_and_not_without(tab: Any, read):
    assert read["found"] == {"shown": 6, "right": 6, "result": "normal"}
    unseen = tab.evaluate(PLATES, {"words": WORDS, "sees": "nothing"})
    assert unseen["found"] == {"shown": 6, "right": 0, "result": "deficient"}


def test_plates_differ_in_hue_alone_but_the_first(read):
    """Lightness of figure and ground, told apart by a* of CIE L*a*b*.

    That of the dots is drawn: means differ by 0.9 (standard deviation) from seed to seed.
    """
    differences = []
    for url in read["pictures"]:
        picture = decoded(url)
        inner = picture[picture[..., 3] == 255][:, :3].astype(np.float32) / 255
        lab = cv2.cvtColor(inner[None], cv2.COLOR_BGR2LAB)[0]
        is_red = lab[:, 1] > (lab[:, 1].min() + lab[:, 1].max()) / 2
        differences.append(abs(lab[is_red, 0].mean() - lab[~is_red, 0].mean()))
    assert differences[0] > 25
    assert max(differences[1:]) < 3
