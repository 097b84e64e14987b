"""Write the sample scene as files, so that whatever reads scenes can read it."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.grid import Sampling
from pipeline.media.files import check_folder_writable
from pipeline.media.png import write_png
from pipeline.synthetic.scene import SampleScene
from pipeline.threads import map_threads


def write_scene(
    folder: Path,
    scene: SampleScene,
    *,
    num_frames: int = 1,
    psf_sigma: float = 1.0,
    psf_support: int = 7,
    noise_sigma: float = 0.0,
    noise_seed: int = 1,
    sampling: Sampling = Sampling.AREA,
    depth: str | None = "stereo",
    calibration: bool = False,
    color: bool = True,
    truth: bool = False,
) -> Path:
    """Write LR pictures, depth maps and the manifest; return the manifest's path.

    What is read back equals :meth:`SampleScene.frame` with the same settings,
    but for depth "true", which the files hold in 8 bit only.

    Parameters
    ----------
    folder : Path
        Made if it is not there; files in it are replaced.
    num_frames : int
        Frames from 0 on.
    depth : "stereo", "true" or None
        What a stereo matcher delivers, the truth in 8 bit, or no depth maps.
    calibration, color : bool
        Whether the manifest has the cameras; RGB or grey pictures.
    truth : bool
        Write the HR pictures too, as ``truth/cam0-000000.png`` and so on.
    others
        As in :meth:`SampleScene.frame`.
    """
    check_folder_writable(folder)
    for view_id in scene.view_ids:
        (folder / view_id).mkdir(exist_ok=True)
    if truth:
        (folder / "truth").mkdir(exist_ok=True)
    for frame_index in range(num_frames):
        pictures = scene.render_all(frame_index / scene.fps)

        def write_view(
            number: int, frame_index: int = frame_index, pictures: Any = pictures
        ) -> None:
            picture, place = pictures[number], folder / scene.view_ids[number]
            if not color:
                picture = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
            lr_image = scene.observe(
                picture, psf_sigma=psf_sigma, psf_support=psf_support, noise_sigma=noise_sigma,
                sampling=sampling, noise=np.random.default_rng([noise_seed, frame_index, number]),
            )  # fmt: skip
            write_png(place / f"color-{frame_index:04d}.png", lr_image)
            if depth is not None:
                stored = (scene.stereo_depth if depth == "stereo" else scene.exact_depth)(
                    number, frame_index, sampling=sampling
                )
                write_png(place / f"depth-{frame_index:04d}.png", stored)
            if truth:
                write_png(folder / "truth" / f"{place.name}-{frame_index:06d}.png", picture)

        map_threads(write_view, range(scene.num_views))
    path = folder / "scene.json"
    manifest = _manifest(scene, range(num_frames), sampling, depth is not None, calibration)
    path.write_text(json.dumps(manifest, indent=2) + "\n", encoding="utf-8")
    return path


def _manifest(
    scene: SampleScene,
    frame_indices: Iterable[int],
    sampling: Sampling,
    with_depth: bool,
    calibration: bool,
) -> dict[str, Any]:
    left, right = scene.reference_views
    views: list[dict[str, Any]] = []
    for number, view_id in enumerate(scene.view_ids):
        view: dict[str, Any] = {"id": view_id, "color": f"{view_id}/color-%04d.png"}
        if with_depth:
            view["depth"] = f"{view_id}/depth-%04d.png"
        if calibration:
            camera = scene.calibration(number, sampling)
            view["intrinsics"] = camera.intrinsics.tolist()
            view["world_to_camera"] = camera.world_to_camera.tolist()
        views.append(view)
    manifest: dict[str, Any] = {
        "format": "depthsr-scene/1",
        "fps": f"{scene.fps}/1",
        "first_frame": 0,
        "frame_count": len(list(frame_indices)),
        "views": views,
        "stereo": {"left": scene.view_ids[left], "right": scene.view_ids[right]},
    }
    if with_depth:
        scale, offset = scene.depth_scale
        manifest["depth"] = {
            "kind": "inverse_depth", "scale": scale, "offset": offset, "unknown": 0,
        }  # fmt: skip
    return manifest
