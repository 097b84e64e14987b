"""Every display mode in a real browser, pixel by pixel, against an independent computation."""

from __future__ import annotations

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

EYE_W, EYE_H = 37, 23
"""An eye's picture: odd and not square, so that nothing fits by accident."""

SURROUND = (90, 91, 92)

PREPARE = """async (profile) => {
  const {StereoDrawing} = await import("/drawing.js");
  window.drawing = new StereoDrawing(document.createElement("canvas"), profile);
  const bitmap = await createImageBitmap(await (await fetch("/made/pair.png")).blob(),
    {colorSpaceConversion: "none", premultiplyAlpha: "none"});
  window.pair = drawing.fromPicture(bitmap, {stereo: true});
}"""
DRAW = """({profile, surround, turn}) => {
  drawing.setProfile(profile);
  drawing.draw(pair, surround, turn);
  const text = Array.from(drawing.read(), (value) => String.fromCharCode(value)).join("");
  return {pixels: btoa(text), error: drawing.gl.getError()};
}"""


@pytest.fixture(scope="module")
def eyes(made: Path, tab: Any) -> tuple[np.ndarray, np.ndarray]:
    """Left and right, RGB noise, every corner of the codes in it; side by side in a PNG."""
    generator = np.random.default_rng(5)
    left, right = generator.integers(0, 256, (2, EYE_H, EYE_W, 3), np.uint8)
    left[0], right[-1] = 0, 255
    packed = np.concatenate([left, right], axis=1)
    assert cv2.imwrite(str(made / "pair.png"), packed[..., ::-1])
    tab.evaluate(PREPARE, profile("mono-left", 64, 40))
    return left, right


def profile(mode: str, width: int, height: int, **more: Any) -> dict[str, Any]:
    return {
        "mode": mode, "width_px": width, "height_px": height, "distance_heights": 3,
        "pixel_pitch_mm": None, "eye_code": "none", "swap": False, "phase": 0, **more,
    }  # fmt: skip


def draw(tab: Any, shown: dict[str, Any], turn: int = 0) -> np.ndarray:
    made = tab.evaluate(DRAW, {"profile": shown, "surround": list(SURROUND), "turn": turn})
    assert made["error"] == 0
    pixels = np.frombuffer(base64.b64decode(made["pixels"]), np.uint8)
    return pixels.reshape(shown["height_px"], shown["width_px"], 4)[..., :3]


def screens(eyes: Any, width: int, height: int) -> list[np.ndarray]:
    """What each eye should see: its picture in the middle of the surround."""
    made = []
    for eye in eyes:
        screen = np.empty((height, width, 3), np.uint8)
        screen[:] = SURROUND
        top, left = (height - EYE_H) // 2, (width - EYE_W) // 2
        screen[top : top + EYE_H, left : left + EYE_W] = eye
        made.append(screen)
    return made


def mean_of_pairs(picture: np.ndarray, axis: int) -> np.ndarray:
    first, second = (
        np.take(picture, range(start, picture.shape[axis], 2), axis).astype(int) for start in (0, 1)
    )
    return ((first + second + 1) // 2).astype(np.uint8)


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("mode", ["mono-left", "mono-right"])
def test_one_eye(tab, eyes, mode, swap):
    eye = (mode == "mono-right") != swap
    found = draw(tab, profile(mode, 64, 40, swap=swap))
    np.testing.assert_array_equal(found, screens(eyes, 64, 40)[eye])


@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize(
    ("mode", "signal", "axis"),
    [("sbs-full", (128, 40), 1), ("dual", (128, 40), 1), ("tab-full", (64, 80), 0)],
)
def test_whole_screens_beside_or_above_each_other(tab, eyes, mode, signal, axis, swap):
    left, right = screens(eyes[:: -1 if swap else 1], 64, 40)
    found = draw(tab, profile(mode, *signal, swap=swap))
    np.testing.assert_array_equal(found, np.concatenate([left, right], axis=axis))


@pytest.mark.parametrize(("mode", "axis"), [("sbs-half", 1), ("tab-half", 0)])
def test_squeezed_screens_are_means_of_two_pixels(tab, eyes, mode, axis):
    halves = [mean_of_pairs(screen, axis) for screen in screens(eyes, 64, 40)]
    found = draw(tab, profile(mode, 64, 40))
    np.testing.assert_array_equal(found, np.concatenate(halves, axis=axis))


@pytest.mark.parametrize("phase", [0, 1])
@pytest.mark.parametrize("swap", [False, True])
@pytest.mark.parametrize("mode", ["rows", "columns", "checkerboard"])
def test_interleaving_is_exact_to_the_pixel(tab, eyes, mode, swap, phase):
    left, right = screens(eyes[:: -1 if swap else 1], 61, 39)
    expected = np.empty_like(left)
    for y in range(39):
        for x in range(61):
            count = {"rows": y, "columns": x, "checkerboard": x + y}[mode] + phase
            expected[y, x] = (right if count % 2 else left)[y, x]
    found = draw(tab, profile(mode, 61, 39, swap=swap, phase=phase))
    np.testing.assert_array_equal(found, expected)


def test_anaglyph_equals_the_arithmetic_of_whole_numbers_and_follows_the_library(tab, eyes):
    from pipeline.stereo import DUBOIS_LEFT, DUBOIS_RIGHT, anaglyph

    left, right = screens(eyes, 64, 40)
    found = draw(tab, profile("anaglyph", 64, 40))
    white = 2**20 - 1
    codes = (np.arange(256) / 255.0, (np.arange(256) - 0.5) / 255.0)
    light, least = (
        white * np.where(v <= 0.04045, v / 12.92, ((np.maximum(v, 0) + 0.055) / 1.055) ** 2.4)
        for v in codes
    )
    light = np.floor(light + 0.5).astype(np.int64)
    total = np.zeros(left.shape, np.int64)
    for eye, matrix in ((left, DUBOIS_LEFT), (right, DUBOIS_RIGHT)):
        thousandths = np.round(matrix.astype(float) * 1000).astype(np.int64)
        total += np.clip(light[eye] @ thousandths.T, 0, 1000 * white)
    expected = np.searchsorted(least[1:], np.minimum(total // 1000, white), side="right")
    np.testing.assert_array_equal(found, expected)
    difference = np.abs(found.astype(int) - anaglyph(left, right))
    assert difference.max() <= 1  # where float32 rounds a tie the other way
    assert (difference > 0).mean() < 0.002


@pytest.mark.parametrize("turn", [0, 1])
def test_frames_in_turn_carry_the_blue_line(tab, eyes, turn):
    expected = screens(eyes, 64, 40)[turn].copy()
    expected[-1] = 0
    expected[-1, : (16, 48)[turn], 2] = 255
    shown = profile("frame-sequential", 64, 40, eye_code="blue-line")
    np.testing.assert_array_equal(draw(tab, shown, turn), expected)


def test_planes_of_video_are_drawn_as_the_picture_is(tab, eyes):
    same = tab.evaluate(
        """({profile, surround}) => {
          drawing.setProfile(profile);
          const rgba = drawing.readSource(pair);
          drawing.draw(pair, surround);
          const first = drawing.read();
          const [width, height] = [2 * pair.eye[0], pair.eye[1]];
          const count = width * height;
          const planes = new Uint8Array(3 * count);
          for (let i = 0; i < count; i++) {
            planes[i] = rgba[4 * i + 1];
            planes[count + i] = rgba[4 * i + 2];
            planes[2 * count + i] = rgba[4 * i];
          }
          const planar = drawing.forPlanes(width, height, {stereo: true});
          drawing.fill(planar, planes);
          drawing.draw(null, surround);
          const grey = drawing.read();
          drawing.draw(planar, surround);
          const second = drawing.read();
          return {same: first.every((v, i) => v === second[i]),
            grey: grey.every((v, i) => v === [...surround, 255][i % 4]),
            varied: first.some((v, i) => v !== grey[i])};
        }""",
        {"profile": profile("columns", 61, 39), "surround": list(SURROUND)},
    )
    assert same == {"same": True, "grey": True, "varied": True}
