"""From the stage and a rig to HR pictures.

The empty stage is painted once a view and kept; at a given time only what
moves, and where its shadow falls, is painted again. That gives the same
picture as painting everything.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.frames import frozen
from pipeline.synthetic import raycast, stage
from pipeline.synthetic.rig import CAMERA_HEIGHT, CAMERA_PITCH, Camera
from pipeline.synthetic.textures import painted
from pipeline.threads import map_threads

TEXELS_PER_PIXEL = 1.6
"""Texture density at the nearest point of a body, texels an HR pixel."""

LARGEST_FOCAL = 1400.0
"""Beyond this focal length, HR pixels, textures grow no finer: they would fill the memory."""

COARSE = 2
"""Spacing of the points at which moving shadows are looked for, HR pixels."""

MARGIN = 2
"""HR pixels painted around the image for the filter."""


def lens_taps() -> npt.NDArray[np.float32]:
    """Return the pixel filter at −7/4, −5/4 … 7/4 HR pixels, unit sum.

    Of the family of Mitchell and Netravali (1988), with B = 1/2 and C = 1/4 a
    little softer than their choice: hardly any ringing or aliasing.
    """
    b, c = 0.5, 0.25
    x = np.abs((np.arange(8) - 3.5) / 2)
    near = (12 - 9 * b - 6 * c) * x**3 + (-18 + 12 * b + 6 * c) * x**2 + 6 - 2 * b
    far = (-b - 6 * c) * x**3 + (6 * b + 30 * c) * x**2 - (12 * b + 48 * c) * x + 8 * b + 24 * c
    taps = np.where(x < 1, near, far)
    return (taps / taps.sum()).astype(np.float32)


@lru_cache(maxsize=2)
def atlas(
    bodies: tuple[stage.Body, ...], hr_focal: float, seed: int
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Return all texels in one row, and (start, height, width) of every body's texture."""
    eye = np.array([0.0, -CAMERA_HEIGHT, 0.0])
    axis = stage.turn(pitch=CAMERA_PITCH)[:, 2]

    def paint_one(body: stage.Body) -> npt.NDArray[np.uint8]:
        if body.kind == raycast.RECTANGLE:
            nearest = float(((body.corners(0.0) - eye) @ axis).min())
        else:
            nearest = float((body.pose(0.0)[1] - eye) @ axis - body.size[0])
        density = TEXELS_PER_PIXEL * min(hr_focal, LARGEST_FOCAL) / max(nearest, 0.5)
        return painted(body.texture, body.texture_extent, density, seed)

    pictures = map_threads(paint_one, bodies)
    layout, start = [], 0
    for picture in pictures:
        layout.append((start, picture.shape[0], picture.shape[1]))
        start += picture.size
    return np.concatenate([picture.ravel() for picture in pictures]), np.array(layout)


class Renderer:
    """The HR pictures of all views, the last one of each kept.

    Parameters
    ----------
    bodies : tuple of Body
        Everything on the stage.
    cameras : tuple of Camera
    hr_shape : (int, int)
        Height and width.
    seed : int
        Of the textures.
    """

    def __init__(
        self,
        bodies: tuple[stage.Body, ...],
        cameras: tuple[Camera, ...],
        hr_shape: tuple[int, int],
        seed: int,
    ) -> None:
        self._bodies = bodies
        self._still = tuple(body for body in bodies if not body.moves)
        self._moving = tuple(body for body in bodies if body.moves)
        self._cameras = cameras
        self._hr_shape = hr_shape
        self._seed = seed
        self._kept: dict[tuple[str, int], Any] = {}

    def all_pictures(self, time: float) -> list[npt.NDArray[np.uint8]]:
        """Return the pictures of all views, several painted at a time."""
        prepare = (raycast.compile_ahead, lambda: self._textures(self._bodies))
        map_threads(lambda step: step(), prepare)
        return map_threads(lambda number: self.picture(number, time), range(len(self._cameras)))

    def picture(self, view_index: int, time: float) -> npt.NDArray[np.uint8]:
        """Return the picture of a view at a time in seconds, (H, W, 3) uint8 RGB, read-only."""
        key = ("picture", view_index)
        kept = self._kept.get(key)
        if kept is None or kept[0] != time:
            picture = self._empty(view_index).copy()
            self.paint(view_index, time, self.touched(view_index, time), picture)
            kept = (time, frozen(picture))
            self._kept[key] = kept
        return kept[1]

    def _empty(self, view_index: int) -> npt.NDArray[np.uint8]:
        key = ("empty", view_index)
        if key not in self._kept:
            empty = np.zeros((*self._hr_shape, 3), np.uint8)
            self.paint(view_index, 0.0, np.ones(self._hr_shape, np.uint8), empty, self._still)
            self._kept[key] = empty
        return self._kept[key]

    def touched(self, view_index: int, time: float) -> npt.NDArray[np.uint8]:
        """Return 1 where a moving body or its shadow may be seen, (H, W)."""
        camera = self._cameras[view_index]
        directions, reach = self._from_lamp(view_index)
        dark = np.zeros(reach.shape, np.bool_)
        for group in sorted({body.group for body in self._moving}):
            casting = [body for body in self._moving if body.group == group and body.shadow]
            if casting:
                dark |= stage.may_shade(directions, reach, casting, time)
        touched = np.repeat(np.repeat(dark, COARSE, axis=0), COARSE, axis=1)
        touched = touched[: self._hr_shape[0], : self._hr_shape[1]].astype(np.uint8)
        for body in self._moving:
            outline = camera.project(body.outline(time))
            hull = cv2.convexHull(np.clip(outline[:, :2], -1e6, 1e6).astype(np.float32))
            cv2.fillConvexPoly(touched, np.rint(hull).astype(np.int32), 1)
        return cv2.dilate(touched, np.ones((2 * COARSE + 3, 2 * COARSE + 3), np.uint8))

    def _from_lamp(
        self, view_index: int
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return directions and distances from the lamp of what is seen on the empty stage.

        At every second HR pixel along x and y; (h, w, 3) and (h, w).
        """
        key = ("lamp", view_index)
        if key not in self._kept:
            camera = self._cameras[view_index]
            shape = (-(-self._hr_shape[0] // COARSE), -(-self._hr_shape[1] // COARSE))
            depth, found = camera.trace(self._still, 0.0, shape, step=(COARSE, COARSE))
            x, y = np.meshgrid(COARSE * np.arange(shape[1]), COARSE * np.arange(shape[0]))
            points = camera.back_project(x, y, np.where(found < 0, 100.0, depth))
            away = points - stage.LAMP_POSITION
            reach = np.linalg.norm(away, axis=-1)
            directions = (away / reach[..., None]).astype(np.float32)
            self._kept[key] = (directions, reach.astype(np.float32))
        return self._kept[key]

    def paint(
        self,
        view_index: int,
        time: float,
        wanted: npt.NDArray[np.uint8],
        picture: npt.NDArray[np.uint8],
        bodies: tuple[stage.Body, ...] | None = None,
    ) -> None:
        """Paint the wanted pixels of a picture, in place, with these bodies or all."""
        bodies = self._bodies if bodies is None else bodies
        camera = self._cameras[view_index]
        table = stage.compiled(bodies, time)
        boxes = camera.boxes(bodies, time) + MARGIN
        rays = camera.rays @ np.array([[1.0, 0, -MARGIN], [0, 1, -MARGIN], [0, 0, 1]])
        origins, axes = stage.local_frames(table, camera.centre, rays)
        textures, layout = self._textures(bodies)
        padded = cv2.copyMakeBorder(
            wanted, MARGIN, MARGIN, MARGIN, MARGIN, cv2.BORDER_REPLICATE
        )  # fmt: skip
        padded = cv2.dilate(padded, np.ones((2 * MARGIN + 1, 2 * MARGIN + 1), np.uint8))
        depth, middle = np.empty(padded.shape), np.empty(padded.shape, np.int16)
        raycast.trace(
            table, origins, axes, boxes, np.zeros(2), np.ones(2),
            cv2.dilate(padded, np.ones((3, 3), np.uint8)), depth, middle,
        )  # fmt: skip
        fine = np.empty((2 * padded.shape[0], 2 * padded.shape[1], 3), np.float32)
        raycast.paint(
            table, origins, axes, boxes, stage.blockers(bodies, time), stage.lamp(),
            textures, layout, padded, middle, fine,
        )  # fmt: skip
        raycast.gather(fine, wanted, lens_taps(), picture)

    def _textures(
        self, bodies: tuple[stage.Body, ...]
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
        """Return all texels, and where each body's are."""
        texels, layout = atlas(
            self._bodies, float(self._cameras[0].intrinsics[[0, 1], [0, 1]].max()), self._seed
        )
        kept = [number for number, body in enumerate(self._bodies) if body in bodies]
        return texels, np.ascontiguousarray(layout[kept])
