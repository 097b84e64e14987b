"""Folders as public datasets have them, small."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

HEIGHT, WIDTH = 24, 36

MSR_INTRINSICS = np.array([[45.0, 0.3, 17.0], [0, 46.0, 9.0], [0, 0, 1]])
"""Of its cameras: 0 to 3 on an arc, numbered from right to left, y up, rows from the bottom."""

MIDDLEBURY_CALIBRATION = """cam0=[90.5 0 20.25; 0 90.5 9.5; 0 0 1]
cam1=[90.5 0 26.5; 0 90.5 9.5; 0 0 1]
doffs=6.25
baseline=160
width=44
height=18
ndisp=40
"""


def msr_motion(camera: int) -> np.ndarray:
    """Return MSR's 3×4 [R | t]: centre at x = −4 · camera, turned inwards."""
    angle = np.deg2rad(-3.0 * camera)
    rotation = np.array(
        [
            [np.cos(angle), 0.02, -np.sin(angle)],
            [-0.02, 1, 0],
            [np.sin(angle), 0, np.cos(angle)],
        ]
    )
    left, _, right = np.linalg.svd(rotation)
    rotation = left @ right
    centre = np.array([-4.0 * camera, 0.3 * camera, 0.5 * camera])
    return np.column_stack([rotation, -rotation @ centre])


def write_msr(folder: Path, *, frames=(0, 1, 2), cameras=4, calibration=True) -> Path:
    folder.mkdir(parents=True)
    for camera in range(cameras):
        (folder / f"cam{camera}").mkdir()
        for frame in frames:
            level = 40 * camera + 5 * frame
            name = f"cam{camera}/%s-cam{camera}-f{frame:03d}"
            color = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
            cv2.imwrite(str(folder / (name % "color" + ".jpg")), color)
            depth = np.full((HEIGHT, WIDTH, 3), 0, np.uint8)
            depth[:, WIDTH // 2 :] = 255
            cv2.imwrite(str(folder / (name % "depth" + ".png")), depth)
    if calibration:
        text = ""
        for camera in range(cameras):
            rows = [*MSR_INTRINSICS, [0.0], [0.0], *msr_motion(camera)]
            text += f"{camera}\n"
            text += "\n".join("\t".join(f"{value:.6f}" for value in row) for row in rows)
            text += "\n\n"
        (folder / "calibParams-breakdancers.txt").write_text(text)
    return folder


def write_stills(folder: Path, files: dict[str, np.ndarray]) -> Path:
    folder.mkdir()
    for name, samples in files.items():
        assert cv2.imwrite(str(folder / name), samples)
    return folder


def color(width: int, height: int = 18) -> np.ndarray:
    return np.random.default_rng(width).integers(0, 256, (height, width, 3), dtype=np.uint8)


def disparity(width: int, value: int, height: int = 18) -> np.ndarray:
    stored = np.full((height, width), value, np.uint8)
    stored[:, 0] = 0
    return stored


def write_pfm(path: Path, samples: np.ndarray) -> None:
    head = f"Pf\n{samples.shape[1]} {samples.shape[0]}\n-0.003922\n".encode()
    path.write_bytes(head + samples[::-1].astype("<f4").tobytes())
