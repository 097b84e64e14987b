"""A headset emulated by another project (tests/vendor/iwer): what each eye gets, pixel by pixel."""

from __future__ import annotations

import base64
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.support.browser import opened_tab

IWER = Path(__file__).parents[2] / "vendor" / "iwer" / "iwer.min.js"
WIDTH, HEIGHT, EYE_W, EYE_H = 640, 360, 61, 33
SURROUND = (90, 91, 92)
DISTANCE = 2.0
"""From the eyes to the screen, metres: headset.js."""

PROFILE = {
    "mode": "webxr", "width_px": 96, "height_px": 54, "distance_heights": 2.0,
    "pixel_pitch_mm": None, "eye_code": "none", "swap": False, "phase": 0,
}  # fmt: skip

LOOK = """async ({profile, surround, width, height}) => {
  const {StereoDrawing} = await import("/drawing.js");
  const {Headset, hasHeadset} = await import("/headset.js");
  const canvas = document.createElement("canvas");
  document.body.append(canvas);
  const drawing = new StereoDrawing(canvas, profile);
  canvas.width = width;
  canvas.height = height;
  const bitmap = await createImageBitmap(await (await fetch("/made/headset.png")).blob(),
    {colorSpaceConversion: "none", premultiplyAlpha: "none"});
  const source = drawing.fromPicture(bitmap, {stereo: true});
  const has = await hasHeadset();
  const headset = new Headset(drawing);
  await headset.begin(() => {});
  const made = await new Promise((resolve) => headset.requestFrame(() => {
    headset.draw(source, surround);
    const {gl} = drawing;
    const size = [gl.drawingBufferWidth, gl.drawingBufferHeight];
    const pixels = new Uint8Array(size[0] * size[1] * 4);
    gl.readPixels(0, 0, ...size, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    const pose = headset.frame.getViewerPose(headset.space);
    const layer = headset.session.renderState.baseLayer;
    const views = pose.views.map((view) => {
      const port = layer.getViewport(view);
      return {eye: view.eye, projection: [...view.projectionMatrix],
        view: [...view.transform.inverse.matrix],
        port: [port.x, port.y, port.width, port.height]};
    });
    let text = "";
    for (const value of pixels) text += String.fromCharCode(value);
    resolve({has, size, views, pixels: btoa(text)});
  }));
  await headset.end();
  return made;
}"""


@pytest.fixture(scope="module")
def headset_tab(chromium: Any, files_url: str) -> Iterator[Any]:
    with opened_tab(chromium, f"{files_url}/made/empty.html") as page:
        page.add_init_script(path=str(IWER))
        page.reload()
        page.evaluate(
            "() => { const device = new IWER.XRDevice(IWER.metaQuest3);"
            " device.installRuntime({forceInstall: true});"
            " device.stereoEnabled = true; device.ipd = 0.063; }"
        )
        yield page


@pytest.fixture(scope="module")
def eyes(made: Path) -> tuple[np.ndarray, np.ndarray]:
    left, right = np.random.default_rng(6).integers(0, 256, (2, EYE_H, EYE_W, 3), np.uint8)
    assert cv2.imwrite(str(made / "headset.png"), np.concatenate([left, right], 1)[..., ::-1])
    return left, right


def seen_by(eye: np.ndarray, view: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """What an eye should see, by a ray through every pixel; and where that is sure.

    Rays that pass within a thousandth of a pixel's edge may be rounded either way.
    """
    projection, pose = (
        np.array(view[name], float).reshape(4, 4).T for name in ("projection", "view")
    )
    _, _, width, height = view["port"]
    x, y = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    near = np.stack([2 * x - 1, 1 - 2 * y, -np.ones_like(x), np.ones_like(x)], -1)
    far = near * [1, 1, -1, 1]
    to_space = np.linalg.inv(projection @ pose)
    ends = [(point @ to_space.T) for point in (near, far)]
    begin, end = (point[..., :3] / point[..., 3:] for point in ends)
    along = (-DISTANCE - begin[..., 2]) / (end[..., 2] - begin[..., 2])
    hit = begin + along[..., None] * (end - begin)
    half_h = DISTANCE / PROFILE["distance_heights"] / 2
    half_w = half_h * PROFILE["width_px"] / PROFILE["height_px"]
    u = (hit[..., 0] / half_w + 1) / 2 * PROFILE["width_px"]
    v = (1 - hit[..., 1] / half_h) / 2 * PROFILE["height_px"]
    screen = np.empty((PROFILE["height_px"], PROFILE["width_px"], 3), np.uint8)
    screen[:] = SURROUND
    top, left = (PROFILE["height_px"] - EYE_H) // 2, (PROFILE["width_px"] - EYE_W) // 2
    screen[top : top + EYE_H, left : left + EYE_W] = eye
    column, row = np.floor(u).astype(int), np.floor(v).astype(int)
    is_on = (u > 0) & (u < screen.shape[1]) & (v > 0) & (v < screen.shape[0])
    seen = np.empty((height, width, 3), np.uint8)
    seen[:] = SURROUND
    seen[is_on] = screen[row[is_on], column[is_on]]
    off = np.minimum(np.abs(u - np.round(u)), np.abs(v - np.round(v)))
    return seen, off > 1e-2


@pytest.mark.parametrize("swap", [False, True])
def test_each_eye_sees_its_picture_on_a_screen_in_space(headset_tab, eyes, swap):
    made = headset_tab.evaluate(
        LOOK,
        {
            "profile": {**PROFILE, "swap": swap}, "surround": list(SURROUND), "width": WIDTH,
            "height": HEIGHT,
        },
    )  # fmt: skip
    assert made["has"] is True
    across, down = made["size"]
    pixels = np.frombuffer(base64.b64decode(made["pixels"]), np.uint8)
    pixels = pixels.reshape(down, across, 4)[::-1, :, :3]
    assert [view["eye"] for view in made["views"]] == ["left", "right"]
    for view in made["views"]:
        x, y, width, height = (round(value) for value in view["port"])
        view["port"] = [x, y, width, height]
        found = pixels[down - y - height : down - y, x : x + width]
        eye = eyes[(view["eye"] == "right") != swap]
        expected, is_sure = seen_by(eye, view)
        assert is_sure.mean() > 0.8
        np.testing.assert_array_equal(found[is_sure], expected[is_sure])
        assert (expected != SURROUND).any(axis=-1).mean() > 0.02
