"""The cameras before the stage: a row on a slight arc, with the small errors of a real rig.

All cameras here are those of the HR images; :meth:`Camera.calibration` gives
those of LR images.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from pipeline.frames import Calibration
from pipeline.grid import Grid
from pipeline.synthetic import raycast, stage

CAMERA_HEIGHT = 1.35
"""Above the floor, metres."""

CAMERA_PITCH = np.deg2rad(-9.5)
"""The rig looks down a little, radians."""

ARC_RADIUS = 5.0
"""Of the arc on which the cameras stand, metres."""

Points = npt.NDArray[np.float64]
"""(…, 3) float64, world, metres."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera of an HR image."""

    intrinsics: npt.NDArray[np.float64]
    """(3, 3), HR pixels."""

    rotation: npt.NDArray[np.float64]
    """(3, 3), world to camera."""

    centre: npt.NDArray[np.float64]
    """(3,), world, metres."""

    @property
    def rays(self) -> npt.NDArray[np.float64]:
        """(3, 3), from homogeneous HR pixels to world directions of unit camera z."""
        return self.rotation.T @ np.linalg.inv(self.intrinsics)

    def project(self, points: Points) -> npt.NDArray[np.float64]:
        """Return where world points are seen: (…, 3) as x, y in HR pixels and depth."""
        seen = (points - self.centre) @ (self.intrinsics @ self.rotation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.concatenate((seen[..., :2] / seen[..., 2:], seen[..., 2:]), axis=-1)

    def back_project(self, x: npt.NDArray, y: npt.NDArray, depth: npt.NDArray) -> Points:
        """Return the world points of HR pixels at a depth."""
        rays = np.stack((x, y, np.ones_like(depth)), axis=-1) @ self.rays.T
        return np.asarray(self.centre + rays * depth[..., None])

    def boxes(self, bodies: tuple[stage.Body, ...], time: float) -> npt.NDArray[np.float64]:
        """Return where every body may be seen, (M, 4) as x0, y0, x1, y1 in HR pixels."""
        seen = self.project(stage.all_corners(bodies, time))
        low, high = seen.min(axis=1), seen.max(axis=1)
        boxes = np.concatenate((low[:, :2] - 1, high[:, :2] + 1), axis=1)
        boxes[low[:, 2] < 0.05] = (-1e9, -1e9, 1e9, 1e9)
        return boxes

    def trace(
        self,
        bodies: tuple[stage.Body, ...],
        time: float,
        shape: tuple[int, int],
        offset: tuple[float, float] = (0.0, 0.0),
        step: tuple[float, float] = (1.0, 1.0),
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int16]]:
        """Return depth and number of the body seen at a lattice of HR positions, both (H, W).

        Element (i, j) sits at HR position ``offset + step·(i, j)``; −1 and a
        very large depth where nothing is seen.
        """
        table = stage.compiled(bodies, time)
        depth, found = np.empty(shape), np.empty(shape, np.int16)
        raycast.trace(
            table, *stage.local_frames(table, self.centre, self.rays), self.boxes(bodies, time),
            np.array(offset, float), np.array(step, float), np.ones(shape, np.uint8), depth, found,
        )  # fmt: skip
        return depth, found

    def calibration(self, grid: Grid) -> Calibration:
        """Return the calibration of this camera's LR image."""
        step_x, step_y = grid.magnification_x, grid.magnification_y
        to_lr = np.array(
            [
                [1 / step_x, 0, -grid.offset_x / step_x],
                [0, 1 / step_y, -grid.offset_y / step_y],
                [0, 0, 1],
            ]
        )
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = self.rotation
        world_to_camera[:3, 3] = -self.rotation @ self.centre
        return Calibration(intrinsics=to_lr @ self.intrinsics, world_to_camera=world_to_camera)


@dataclass(frozen=True, kw_only=True)
class Rig:
    """A row of cameras, by numbers."""

    num_views: int
    references: tuple[int, int]
    """Numbers of the left and the right reference view."""
    hr_shape: tuple[int, int]
    focal: tuple[float, float]
    """Along x and y, HR pixels."""
    rotation: float
    """Largest rotation between any view and either reference view, radians."""
    seed: int

    def cameras(self, baseline: float) -> tuple[Camera, ...]:
        """Return the cameras at that distance between neighbours, metres."""
        count = self.num_views
        noise = np.random.default_rng([self.seed, 1])
        place = (np.arange(count) - (count - 1) / 2) * baseline
        place = place + 0.06 * baseline * noise.uniform(-1, 1, count)
        lift = 0.05 * baseline * noise.uniform(-1, 1, count)
        side = np.linspace(-1, 1, count) if count > 1 else np.zeros(1)
        angles = np.stack(
            (-0.4 * side, 0.35 * noise.uniform(-1, 1, count), noise.uniform(-1, 1, count)), axis=-1
        )
        largest = max(
            np.linalg.norm(angles - angles[reference], axis=-1).max()
            for reference in self.references
        )
        angles *= self.rotation / largest if largest > 0 else 0.0
        height, width = self.hr_shape
        intrinsics = np.array(
            [
                [self.focal[0], 0.0, (width - 1) / 2],
                [0.0, self.focal[1], (height - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        level = stage.turn(pitch=CAMERA_PITCH)
        return tuple(
            Camera(
                intrinsics=intrinsics,
                rotation=(level @ stage.turn(yaw=yaw, pitch=pitch, roll=roll)).T,
                centre=np.array([x, y - CAMERA_HEIGHT, x * x / (2 * ARC_RADIUS)]),
            )
            for x, y, (yaw, pitch, roll) in zip(place, lift, angles, strict=True)
        )

    def fitting_baseline(self, bodies: tuple[stage.Body, ...], largest_wanted: float) -> float:
        """Return the baseline at which the largest displacement is the one wanted.

        Of what the left reference sees at time 0, horizontally, to the view
        farthest from it; HR pixels.
        """
        left = self.references[0]
        far = 0 if left >= self.num_views - 1 - left else self.num_views - 1
        if far == left:
            return 0.0
        shape = (24, 32)
        step = ((self.hr_shape[1] - 1) / (shape[1] - 1), (self.hr_shape[0] - 1) / (shape[0] - 1))
        x, y = np.meshgrid(np.arange(shape[1]) * step[0], np.arange(shape[0]) * step[1])

        def largest(baseline: float) -> float:
            cameras = self.cameras(baseline)
            depth, found = cameras[left].trace(bodies, 0.0, shape, step=step)
            points = cameras[left].back_project(x, y, depth)
            return float(np.abs(cameras[far].project(points)[..., 0] - x)[found >= 0].max())

        lower, upper = 0.0, 10 * largest_wanted / (abs(far - left) * self.focal[0])
        for _ in range(30):
            middle = (lower + upper) / 2
            if largest(middle) < largest_wanted:
                lower = middle
            else:
                upper = middle
        return (lower + upper) / 2
