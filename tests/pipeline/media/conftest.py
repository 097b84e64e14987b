"""Scenes written to disk for the tests of the reading room."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.support.datasets import MIDDLEBURY_CALIBRATION, color, write_pfm, write_stills
from tests.support.needed import program

SceneWriter = Callable[..., Path]


def texture(shape: tuple[int, int], seed: int, channels: int = 1) -> np.ndarray:
    """Return a smooth random picture, (H, W) or (H, W, 3) uint8."""
    noise = np.random.default_rng(seed).normal(size=(*shape, channels)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2).reshape(*shape, channels)
    levels = 128 + 60 * smooth / max(float(smooth.std()), 1e-6)
    picture = np.clip(levels, 0, 255).astype(np.uint8)
    return picture[..., 0] if channels == 1 else picture


@pytest.fixture
def make_texture() -> Callable[..., np.ndarray]:
    return texture


@pytest.fixture
def write_scene(tmp_path: Path) -> SceneWriter:
    """Write a scene of PNG sequences; keywords change the manifest's top level."""

    def write(
        *,
        views: int = 2,
        frames: int = 3,
        first: int = 0,
        shape: tuple[int, int] = (18, 26),
        channels: int = 3,
        depth: bool = True,
        dtype: type = np.uint8,
        **changes: Any,
    ) -> Path:
        folder = tmp_path / "scene"
        shutil.rmtree(folder, ignore_errors=True)
        entries = []
        for view in range(views):
            name = f"v{view}"
            (folder / name).mkdir(parents=True, exist_ok=True)
            entry = {"id": name, "color": f"{name}/color-%03d.png"}
            if depth:
                entry["depth"] = f"{name}/depth-%03d.png"
            entries.append(entry)
            for frame in range(first, first + frames):
                picture = texture(shape, 1000 * view + frame, channels).astype(dtype)
                if dtype is np.uint16:
                    picture = picture * 257 + (frame % 7)
                cv2.imwrite(str(folder / name / f"color-{frame:03d}.png"), picture[..., ::-1]
                            if channels == 3 else picture)  # fmt: skip
                if depth:
                    levels = np.linspace(20, 200, shape[0] * shape[1]).reshape(shape)
                    cv2.imwrite(
                        str(folder / name / f"depth-{frame:03d}.png"), levels.astype(np.uint8)
                    )
        manifest: dict[str, Any] = {"format": "depthsr-scene/1", "views": entries}
        if frames > 1:
            manifest["fps"] = "15/1"
            manifest["first_frame"] = first
        if depth:
            manifest["depth"] = {"kind": "disparity", "scale": 0.25, "offset": 0, "unknown": 0}
        manifest.update(changes)
        manifest = {key: value for key, value in manifest.items() if value is not ...}
        (folder / "scene.json").write_text(json.dumps(manifest))
        return folder

    return write


@pytest.fixture
def middlebury_2014(tmp_path) -> Path:
    folder = write_stills(tmp_path / "Adirondack", {"im0.png": color(44), "im1.png": color(44)})
    (folder / "calib.txt").write_text(MIDDLEBURY_CALIBRATION)
    disparities = np.linspace(3, 30, 18 * 44).reshape(18, 44)
    disparities[2, 3] = np.inf
    write_pfm(folder / "disp0.pfm", disparities)
    write_pfm(folder / "disp1.pfm", disparities)
    return folder


@pytest.fixture(scope="session")
def ffprobe() -> Callable[[Path], dict]:
    """Gives what ffprobe says of a file's stream, its duration under ``format_duration``."""
    path = program("ffprobe")

    def probe(video: Path) -> dict:
        done = subprocess.run(
            [
                path,
                "-v",
                "error",
                "-count_frames",
                *["-show_streams", "-show_format", "-of", "json"],
                video,
            ],
            capture_output=True,
            text=True,
            check=True,
        )
        assert done.stderr == ""
        said = json.loads(done.stdout)
        (stream,) = said["streams"]
        return stream | {"format_duration": said["format"]["duration"]}

    return probe
