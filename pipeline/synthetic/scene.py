"""The sample scene: a rig of cameras before a stage, its pictures and the truth about them.

Not in the thesis. Everything the estimators must find out is known here
exactly: calibration, depth, motion, visibility, and the HR picture itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.errors import ConfigurationError
from pipeline.frames import Calibration, GreyImage, MultiViewFrame, View, frozen
from pipeline.grid import Grid, Sampling
from pipeline.synthetic import raycast, stage
from pipeline.synthetic.observation import DEPTH_LEVELS, blur_and_sample, degraded_depth
from pipeline.synthetic.textures import painted
from pipeline.threads import map_threads

FOCAL = 1.12
"""Focal length over image width (of a 4 : 3 image), dimensionless."""

CAMERA_HEIGHT = 1.35
CAMERA_PITCH = np.deg2rad(-9.5)
"""The rig looks down a little, radians."""

ARC_RADIUS = 5.0
"""Of the arc on which the cameras stand, metres."""

TEXELS_PER_PIXEL = 1.6
"""Texture density at the nearest point of a body, texels an HR pixel."""

COARSE = 2
"""Spacing of the points at which moving shadows are looked for, HR pixels."""

LARGEST_FOCAL = 1400.0
"""Beyond this focal length, HR pixels, textures grow no finer: they would fill the memory."""

MARGIN = 2
"""HR pixels painted around the image for the filter."""

VISIBLE_TOLERANCE = 1e-6
"""Share of its depth by which a point may lie behind another surface and still be seen."""

STAGE = stage.bodies()


def _lens_taps() -> npt.NDArray[np.float32]:
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


@dataclass(frozen=True, kw_only=True, eq=False)
class TrueMotion:
    """Where every LR pixel of a source view really lands in a reference view."""

    position: npt.NDArray[np.float64]
    """(H, W, 2) as (x, y), LR pixels of the reference view; exact also where hidden."""

    visible: npt.NDArray[np.bool_]
    """(H, W): the surface point lands inside the reference image and nothing stands before it."""

    near_edge: npt.NDArray[np.bool_]
    """(H, W): the PSF reaches over the border between two surfaces, here or at the landing."""

    @property
    def displacement(self) -> npt.NDArray[np.float64]:
        """(H, W, 2) as (u, v), LR pixels."""
        height, width = self.visible.shape
        x, y = np.meshgrid(np.arange(width), np.arange(height))
        return self.position - np.stack((x, y), axis=-1)


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleTruth:
    """What is true of one frame of the sample scene."""

    frame_index: int
    grid: Grid
    hr_luma: tuple[GreyImage, ...]
    """Per view (K·H, K·W) float32, whole grey levels."""
    depth: tuple[npt.NDArray[np.float64], ...]
    """Per view (H, W), distance along the optical axis at LR pixel centres, metres."""
    calibration: tuple[Calibration, ...]
    """Per view, of the LR images."""
    scene: SampleScene

    @property
    def nearness(self) -> tuple[npt.NDArray[np.float64], ...]:
        """Per view (H, W), 1 / depth."""
        return tuple(1.0 / depth for depth in self.depth)

    def motion(
        self, source_view: int, reference_view: int, *, psf_support: int = 7
    ) -> TrueMotion:
        """Return the true motion between two views of this frame."""
        return self.scene.true_motion(
            source_view, reference_view, self.frame_index,
            sampling=self.grid.sampling, psf_support=psf_support,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class _Camera:
    """A pinhole camera on the HR grid."""

    intrinsics: npt.NDArray[np.float64]
    rotation: npt.NDArray[np.float64]
    """World to camera."""
    centre: npt.NDArray[np.float64]

    @property
    def rays(self) -> npt.NDArray[np.float64]:
        """From homogeneous HR pixels to world directions with unit camera z."""
        return self.rotation.T @ np.linalg.inv(self.intrinsics)

    def project(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return HR pixels (…, 3): x, y and depth of world points."""
        seen = (points - self.centre) @ (self.intrinsics @ self.rotation).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.concatenate((seen[..., :2] / seen[..., 2:], seen[..., 2:]), axis=-1)


@lru_cache(maxsize=2)
def _atlas(
    hr_focal: float, seed: int
) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
    """Return all texels in one row, and (start, height, width) of every body's texture."""
    eye = np.array([0.0, -CAMERA_HEIGHT, 0.0])
    axis = stage.turn(pitch=CAMERA_PITCH)[:, 2]

    def paint_one(body: stage.Body) -> npt.NDArray[np.uint8]:
        nearest = max(0.5, float(((body.corners(0.0) - eye) @ axis).min()))
        if body.kind != raycast.RECTANGLE:
            nearest = max(0.5, float((body.pose(0.0)[1] - eye) @ axis - body.size[0]))
        density = TEXELS_PER_PIXEL * min(hr_focal, LARGEST_FOCAL) / nearest
        return painted(body.texture, body.texture_extent, density, seed)

    pictures = map_threads(paint_one, STAGE)
    layout, start = [], 0
    for picture in pictures:
        layout.append((start, picture.shape[0], picture.shape[1]))
        start += picture.size
    return np.concatenate([picture.ravel() for picture in pictures]), np.array(layout)


@dataclass(frozen=True, kw_only=True)
class SampleScene:
    """A stage before a row of cameras; everything about it follows from these numbers.

    Views are numbered from 0, left to right; frames from 0 at ``fps``. Times are seconds.

    Examples
    --------
    >>> scene = SampleScene(width=64, height=48, num_views=3)
    >>> scene.frame(0).lr_shape, scene.render_hr(0).shape
    ((48, 64), (96, 128, 3))
    """

    width: int = 512
    """LR pixels."""
    height: int = 384
    """LR pixels."""
    num_views: int = 8
    magnification: int = 2
    """K, along x and, unless said otherwise, along y."""
    magnification_y: int | None = None
    max_disparity: float | None = None
    """Largest horizontal displacement between the left reference and the view farthest
    from it, LR pixels; default: 12 for each step between neighbours at 512 columns."""
    rotation_degrees: float = 1.5
    """Largest rotation between any view and either reference view, degrees."""
    fps: int = 12
    seed: int = 0
    _kept: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or self.num_views < 1:
            raise ConfigurationError("the sample scene needs a size and a view of 1 or more")
        if self.magnification < 1 or (self.magnification_y or 1) < 1 or self.fps < 1:
            raise ConfigurationError("magnification and fps of the sample scene: 1 or more")

    # --- the rig -----------------------------------------------------------------------

    @property
    def reference_views(self) -> tuple[int, int]:
        """Numbers of the left and the right reference view."""
        left = (self.num_views - 1) // 2
        return left, min(left + 1, self.num_views - 1)

    @property
    def view_ids(self) -> tuple[str, ...]:
        """``cam0``, ``cam1`` …"""
        return tuple(f"cam{number}" for number in range(self.num_views))

    def grid(self, sampling: Sampling = Sampling.DECIMATION) -> Grid:
        """Return how the LR grid lies on the HR grid."""
        return Grid(
            magnification_x=self.magnification,
            magnification_y=self.magnification_y or self.magnification,
            sampling=sampling,
        )

    @property
    def hr_shape(self) -> tuple[int, int]:
        """(K·height, K·width)."""
        return self.grid().hr_shape((self.height, self.width))

    @property
    def _lr_focal(self) -> float:
        return FOCAL * max(self.width, self.height * 4 / 3)

    @property
    def baseline(self) -> float:
        """Distance between neighbouring cameras, metres."""
        return float(self._rig[0])

    @property
    def _rig(self) -> tuple[float, tuple[_Camera, ...]]:
        if "rig" not in self._kept:
            self._kept["rig"] = self._make_rig()
        return self._kept["rig"]

    def _make_rig(self) -> tuple[float, tuple[_Camera, ...]]:
        """Find the baseline at which the largest displacement is the one asked for."""
        left = self.reference_views[0]
        steps = max(left, self.num_views - 1 - left)
        if steps == 0:
            return 0.0, self._cameras(0.0)
        wanted = self.max_disparity
        if wanted is None:
            wanted = 12 * steps * self.width / 512
        wanted *= self.magnification
        far = 0 if left >= self.num_views - 1 - left else self.num_views - 1

        def largest(baseline: float) -> float:
            cameras = self._cameras(baseline)
            source = cameras[left]
            table = stage.compiled(STAGE, 0.0)
            shape = (24, 32)
            height, width = self.hr_shape
            step = np.array([(width - 1) / (shape[1] - 1), (height - 1) / (shape[0] - 1)])
            depth, found = np.empty(shape), np.empty(shape, np.int16)
            raycast.trace(
                table, *stage.local_frames(table, source.centre, source.rays),
                self._boxes(source, 0.0), np.zeros(2), step, np.ones(shape, np.uint8),
                depth, found,
            )  # fmt: skip
            x, y = np.meshgrid(np.arange(shape[1]) * step[0], np.arange(shape[0]) * step[1])
            points = _back_project(source, x, y, depth)
            return float(np.abs(cameras[far].project(points)[..., 0] - x)[found >= 0].max())

        baseline = wanted / (steps * self._lr_focal * self.magnification) * 2.6
        lower, upper = 0.0, 4 * baseline
        for _ in range(30):
            baseline = (lower + upper) / 2
            if largest(baseline) < wanted:
                lower = baseline
            else:
                upper = baseline
        return baseline, self._cameras(baseline)

    def _cameras(self, baseline: float) -> tuple[_Camera, ...]:
        """Return the cameras on their arc; small errors of position and angle as in a real rig."""
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
            for reference in self.reference_views
        )
        angles *= np.deg2rad(self.rotation_degrees) / max(largest, 1e-9)
        height, width = self.hr_shape
        step_x, step_y = self.magnification, self.magnification_y or self.magnification
        intrinsics = np.array(
            [
                [self._lr_focal * step_x, 0.0, (width - 1) / 2],
                [0.0, self._lr_focal * step_y, (height - 1) / 2],
                [0.0, 0.0, 1.0],
            ]
        )
        return tuple(
            _Camera(
                intrinsics=intrinsics,
                rotation=(
                    stage.turn(pitch=CAMERA_PITCH) @ stage.turn(yaw=yaw, pitch=pitch, roll=roll)
                ).T,
                centre=np.array([x, y - CAMERA_HEIGHT, x * x / (2 * ARC_RADIUS)]),
            )
            for x, y, (yaw, pitch, roll) in zip(place, lift, angles, strict=True)
        )

    def calibration(self, view_index: int, sampling: Sampling = Sampling.DECIMATION) -> Calibration:
        """Return the true calibration of a view's LR image, metres."""
        camera, grid = self._rig[1][view_index], self.grid(sampling)
        to_lr = np.array(
            [
                [1 / grid.magnification_x, 0, -grid.offset_x / grid.magnification_x],
                [0, 1 / grid.magnification_y, -grid.offset_y / grid.magnification_y],
                [0, 0, 1],
            ]
        )
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = camera.rotation
        world_to_camera[:3, 3] = -camera.rotation @ camera.centre
        return Calibration(
            intrinsics=to_lr @ camera.intrinsics, world_to_camera=world_to_camera
        )

    def _boxes(
        self, camera: _Camera, time: float, bodies: tuple[stage.Body, ...] = STAGE
    ) -> npt.NDArray[np.float64]:
        """Return where on the HR image every body may be seen, (M, 4) as x0, y0, x1, y1."""
        boxes = np.empty((len(bodies), 4))
        for box, body in zip(boxes, bodies, strict=True):
            seen = camera.project(body.corners(time))
            if seen[:, 2].min() < 0.05:
                box[:] = -1e9, -1e9, 1e9, 1e9
            else:
                box[:2] = seen[:, :2].min(axis=0) - 1
                box[2:] = seen[:, :2].max(axis=0) + 1
        return boxes

    # --- pictures ----------------------------------------------------------------------

    def render_hr(self, view_index: int, time: float = 0.0) -> npt.NDArray[np.uint8]:
        """Return the HR picture of a view at a time, (K·H, K·W, 3) uint8 RGB."""
        key = ("hr", view_index)
        kept = self._kept.get(key)
        if kept is None or kept[0] != time:
            kept = (time, frozen(self._render(view_index, time)))
            self._kept[key] = kept
        return kept[1]

    def _render(self, view_index: int, time: float) -> npt.NDArray[np.uint8]:
        """Paint what moves and its shadow over the empty stage, which is kept."""
        key = ("empty", view_index)
        if key not in self._kept:
            height, width = self.hr_shape
            everything = np.ones((height, width), np.uint8)
            empty = np.zeros((height, width, 3), np.uint8)
            self._paint(view_index, 0.0, everything, empty, empty_stage=True)
            self._kept[key] = empty
        picture = self._kept[key].copy()
        self._paint(view_index, time, self._touched(view_index, time), picture)
        return picture

    def _touched(self, view_index: int, time: float) -> npt.NDArray[np.uint8]:
        """Return 1 where a moving body or its shadow may be seen, on the HR image."""
        camera = self._rig[1][view_index]
        directions, reach = self._from_lamp(view_index)
        dark = np.zeros(reach.shape, np.bool_)
        touched = np.zeros(self.hr_shape, np.uint8)
        moving = [body for body in STAGE if body.moves]
        for group in sorted({body.group for body in moving}):
            casting = [body for body in moving if body.group == group and body.shadow]
            dark |= stage.shaded(directions, reach, casting, time)
        for body in moving:
            outline = camera.project(body.outline(time))
            hull = cv2.convexHull(np.clip(outline[:, :2], -1e6, 1e6).astype(np.float32))
            cv2.fillConvexPoly(touched, np.rint(hull).astype(np.int32), 1)
        fine = np.repeat(np.repeat(dark, COARSE, axis=0), COARSE, axis=1)
        touched |= fine[: touched.shape[0], : touched.shape[1]]
        return cv2.dilate(touched, np.ones((2 * COARSE + 3, 2 * COARSE + 3), np.uint8))

    def _from_lamp(
        self, view_index: int
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return directions and distances from the lamp of the empty stage's points.

        At every second HR pixel along x and y; (h, w, 3) and (h, w).
        """
        key = ("lamp", view_index)
        if key not in self._kept:
            camera = self._rig[1][view_index]
            still = tuple(body for body in STAGE if not body.moves)
            table = stage.compiled(still, 0.0)
            shape = tuple(-(-side // COARSE) for side in self.hr_shape)
            depth, found = np.empty(shape), np.empty(shape, np.int16)
            raycast.trace(
                table, *stage.local_frames(table, camera.centre, camera.rays),
                self._boxes(camera, 0.0, still), np.zeros(2), np.full(2, float(COARSE)),
                np.ones(shape, np.uint8), depth, found,
            )  # fmt: skip
            x, y = np.meshgrid(COARSE * np.arange(shape[1]), COARSE * np.arange(shape[0]))
            points = _back_project(camera, x, y, np.where(found < 0, 100.0, depth))
            away = points - stage.LAMP_POSITION
            reach = np.linalg.norm(away, axis=-1)
            self._kept[key] = (
                (away / reach[..., None]).astype(np.float32), reach.astype(np.float32)
            )  # fmt: skip
        return self._kept[key]

    def _paint(
        self,
        view_index: int,
        time: float,
        wanted: npt.NDArray[np.uint8],
        picture: npt.NDArray[np.uint8],
        *,
        empty_stage: bool = False,
    ) -> None:
        """Paint the wanted pixels of a picture, in place."""
        camera = self._rig[1][view_index]
        bodies = tuple(body for body in STAGE if not body.moves) if empty_stage else STAGE
        table = stage.compiled(bodies, time)
        boxes = self._boxes(camera, time, bodies) + MARGIN
        rays = camera.rays @ np.array([[1.0, 0, -MARGIN], [0, 1, -MARGIN], [0, 0, 1]])
        origins, axes = stage.local_frames(table, camera.centre, rays)
        textures, layout = self._textures(bodies)
        padded = cv2.copyMakeBorder(wanted, *(MARGIN,) * 4, cv2.BORDER_REPLICATE)
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
        raycast.gather(fine, wanted, _lens_taps(), picture)

    def _textures(
        self, bodies: tuple[stage.Body, ...] = STAGE
    ) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.int64]]:
        """Return all texels, and where each body's are."""
        texels, layout = _atlas(self._lr_focal * self.magnification, self.seed)
        kept = [number for number, body in enumerate(STAGE) if body in bodies]
        return texels, np.ascontiguousarray(layout[kept])

    def render_all(self, time: float = 0.0) -> list[npt.NDArray[np.uint8]]:
        """Return the HR pictures of all views, several painted at a time."""
        _ = self._rig, self._textures()
        return map_threads(lambda number: self.render_hr(number, time), range(self.num_views))

    def observe(
        self,
        hr_image: npt.NDArray,
        *,
        psf_sigma: float = 1.0,
        psf_support: int = 7,
        noise_sigma: float = 0.0,
        sampling: Sampling = Sampling.DECIMATION,
        noise: np.random.Generator | None = None,
    ) -> npt.NDArray[np.uint8]:
        """Return the LR picture of an HR picture, rounded to 8 bit.

        Noise of a colour picture is the same in its three channels, so that
        luma has that noise too.
        """
        lr_image = blur_and_sample(hr_image, self.grid(sampling), psf_sigma, psf_support)
        if noise_sigma > 0:
            noise = noise or np.random.default_rng(self.seed)
            grain = noise.normal(0.0, noise_sigma, lr_image.shape[:2])
            lr_image = lr_image + (grain if lr_image.ndim == 2 else grain[..., None])
        return np.clip(np.rint(lr_image), 0, 255).astype(np.uint8)

    # --- frames ------------------------------------------------------------------------

    def frame(
        self,
        time_index: int = 0,
        *,
        psf_sigma: float = 1.0,
        psf_support: int = 7,
        noise_sigma: float = 0.0,
        noise_seed: int = 1,
        sampling: Sampling = Sampling.DECIMATION,
        depth: str | None = "true",
        calibration: bool = False,
        color: bool = False,
    ) -> MultiViewFrame:
        """Return all views at one instant as LR cameras deliver them.

        Parameters
        ----------
        psf_sigma, psf_support : float, int
            Gaussian PSF, HR pixels; the support is odd.
        noise_sigma : float
            Grey levels; every view and frame has a stream of its own.
        depth : "true", "stereo" or None
            Exact inverse depth, what a stereo matcher delivers, or none at all.
        calibration : bool
            Whether the views carry their true calibration.
        color : bool
            False: 8-bit HR luma is observed (as Set 1 does). True: 8-bit RGB is
            observed, and luma and chroma are made of the result, as from a file.
        """
        if depth not in ("true", "stereo", None):
            raise ConfigurationError(f"depth of the sample scene: {depth!r} is not known")
        pictures = self.render_all(time_index / self.fps)

        def deliver(number: int) -> View:
            picture = pictures[number]
            lr_image = self.observe(
                picture if color else cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY),
                psf_sigma=psf_sigma, psf_support=psf_support, noise_sigma=noise_sigma,
                sampling=sampling, noise=np.random.default_rng([noise_seed, time_index, number]),
            )  # fmt: skip
            luma, chroma = lr_image, None
            if color:
                luma = cv2.cvtColor(lr_image, cv2.COLOR_RGB2GRAY)
                chroma = _chroma(lr_image)
            depth_map = None
            if depth == "true":
                depth_map = 1 / self.true_depth(number, time_index, sampling=sampling)
            elif depth == "stereo":
                stored = self.stereo_depth(number, time_index, sampling=sampling)
                scale, offset = self.depth_scale
                depth_map = np.where(stored > 0, stored * scale + offset, np.nan)
            return View(
                view_id=self.view_ids[number],
                luma=luma.astype(np.float32),
                chroma=chroma,
                depth_map=None if depth_map is None else depth_map.astype(np.float32),
                calibration=self.calibration(number, sampling) if calibration else None,
            )

        left, right = self.reference_views
        return MultiViewFrame(
            frame_index=time_index,
            views=tuple(map_threads(deliver, range(self.num_views))),
            left=self.view_ids[left],
            right=self.view_ids[right],
            depth_is_metric=calibration and depth is not None,
        )

    # --- truth -------------------------------------------------------------------------

    def truth(
        self, time_index: int = 0, *, sampling: Sampling = Sampling.DECIMATION
    ) -> SampleTruth:
        """Return what is true of a frame."""
        pictures = self.render_all(time_index / self.fps)
        views = range(self.num_views)
        return SampleTruth(
            frame_index=time_index,
            grid=self.grid(sampling),
            hr_luma=tuple(
                frozen(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).astype(np.float32))
                for picture in pictures
            ),
            depth=tuple(
                self.true_depth(number, time_index, sampling=sampling) for number in views
            ),
            calibration=tuple(self.calibration(number, sampling) for number in views),
            scene=self,
        )

    def true_depth(
        self, view_index: int, time_index: int = 0, *, sampling: Sampling = Sampling.DECIMATION
    ) -> npt.NDArray[np.float64]:
        """Return the distance along the optical axis at LR pixel centres, (H, W) metres."""
        return self._traced(view_index, time_index / self.fps, self.grid(sampling))[0]

    def _traced(
        self, view_index: int, time: float, grid: Grid | None
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int16]]:
        """Return depth and body number on the LR grid, or on the HR grid for None."""
        camera = self._rig[1][view_index]
        table = stage.compiled(STAGE, time)
        shape, offset, step = self.hr_shape, (0.0, 0.0), (1.0, 1.0)
        if grid is not None:
            shape = (self.height, self.width)
            offset = (grid.offset_x, grid.offset_y)
            step = (float(grid.magnification_x), float(grid.magnification_y))
        depth, found = np.empty(shape), np.empty(shape, np.int16)
        raycast.trace(
            table, *stage.local_frames(table, camera.centre, camera.rays),
            self._boxes(camera, time), np.array(offset), np.array(step),
            np.ones(shape, np.uint8), depth, found,
        )  # fmt: skip
        return depth, found

    def true_motion(
        self,
        source_view: int,
        reference_view: int,
        time_index: int = 0,
        *,
        sampling: Sampling = Sampling.DECIMATION,
        psf_support: int = 7,
    ) -> TrueMotion:
        """Return where every LR pixel of the source view lands in the reference view.

        The ray of the pixel is followed to the surface it meets, and the point
        is projected into the reference camera, all in float64. A point is
        visible if its own ray from the reference camera meets nothing before
        it. The borders between rows of floor boards are no edges.
        """
        time, grid = time_index / self.fps, self.grid(sampling)
        source, reference = self._rig[1][source_view], self._rig[1][reference_view]
        depth, found = self._traced(source_view, time, grid)
        x, y = np.meshgrid(
            grid.offset_x + grid.magnification_x * np.arange(self.width),
            grid.offset_y + grid.magnification_y * np.arange(self.height),
        )
        points = _back_project(source, x, y, depth)
        landing = np.ascontiguousarray(reference.project(points)[..., :2])
        table = stage.compiled(STAGE, time)
        clear = np.empty(depth.size, np.bool_)
        raycast.unblocked(
            table, *stage.local_frames(table, reference.centre), self._boxes(reference, time),
            reference.centre, points.reshape(-1, 3), landing.reshape(-1, 2),
            VISIBLE_TOLERANCE, clear,
        )  # fmt: skip
        position = (landing - [grid.offset_x, grid.offset_y]) / [
            grid.magnification_x, grid.magnification_y,
        ]  # fmt: skip
        inside = (
            (position[..., 0] >= 0) & (position[..., 0] <= self.width - 1)
            & (position[..., 1] >= 0) & (position[..., 1] <= self.height - 1)
        )  # fmt: skip
        visible = clear.reshape(depth.shape) & inside & (found >= 0)
        at_source = self._edges(source_view, time, psf_support)
        at_landing = self._edges(reference_view, time, psf_support)
        near_edge = _looked_up(at_source, x, y) | _looked_up(
            at_landing, landing[..., 0], landing[..., 1]
        )
        return TrueMotion(position=position, visible=visible, near_edge=near_edge)

    def _edges(self, view_index: int, time: float, psf_support: int) -> npt.NDArray[np.bool_]:
        """Return the HR pixels from which a PSF reaches over the border of two surfaces."""
        key = ("edges", view_index, psf_support)
        kept = self._kept.get(key)
        if kept is None or kept[0] != time:
            _, found = self._traced(view_index, time, None)
            first_strip = [body.texture for body in STAGE].index("floor0")
            strips = (found > first_strip) & (found < first_strip + len(stage.FLOOR_STRIPS))
            found[strips] = first_strip
            window = np.ones((psf_support + 2, psf_support + 2), np.uint8)
            kept = (time, cv2.dilate(found, window) != cv2.erode(found, window))
            self._kept[key] = kept
        return kept[1]

    # --- depth as delivered ------------------------------------------------------------

    @property
    def depth_range(self) -> tuple[float, float]:
        """Inverse depths of the stored levels 1 and 255, 1/metres."""
        if "range" not in self._kept:
            depth, found = self._traced(self.reference_views[0], 0.0, None)
            seen = depth[found >= 0]
            self._kept["range"] = (0.92 / float(seen.max()), 1.15 / float(seen.min()))
        return self._kept["range"]

    @property
    def depth_scale(self) -> tuple[float, float]:
        """(scale, offset): inverse depth is stored level × scale + offset, 1/metres."""
        low, high = self.depth_range
        scale = (high - low) / (DEPTH_LEVELS - 1)
        return scale, low - scale

    def stereo_depth(
        self, view_index: int, time_index: int = 0, *, sampling: Sampling = Sampling.DECIMATION
    ) -> npt.NDArray[np.uint8]:
        """Return a view's depth as a stereo matcher delivers it, 8-bit levels, 0 unknown."""
        other = view_index + 1 if view_index + 1 < self.num_views else max(0, view_index - 1)
        motion = self.true_motion(view_index, other, time_index, sampling=sampling)
        depth = self.true_depth(view_index, time_index, sampling=sampling)
        return degraded_depth(
            1 / depth, ~motion.visible, self.depth_range,
            np.random.default_rng([self.seed, 2, time_index, view_index]),
        )  # fmt: skip

    def exact_depth(
        self, view_index: int, time_index: int = 0, *, sampling: Sampling = Sampling.DECIMATION
    ) -> npt.NDArray[np.uint8]:
        """Return a view's true depth as 8-bit levels."""
        low, high = self.depth_range
        nearness = 1 / self.true_depth(view_index, time_index, sampling=sampling)
        levels = 1 + (nearness - low) / (high - low) * (DEPTH_LEVELS - 1)
        return np.clip(np.rint(levels), 1, DEPTH_LEVELS).astype(np.uint8)


def _back_project(
    camera: _Camera, x: npt.NDArray, y: npt.NDArray, depth: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the world points of HR pixels at a depth, (…, 3)."""
    rays = np.stack((x, y, np.ones_like(depth)), axis=-1) @ camera.rays.T
    return camera.centre + rays * depth[..., None]


def _looked_up(mask: npt.NDArray[np.bool_], x: npt.NDArray, y: npt.NDArray) -> npt.NDArray[np.bool_]:
    """Return the mask at the nearest HR pixels; False outside."""
    with np.errstate(invalid="ignore"):
        column, row = np.rint(x).astype(int), np.rint(y).astype(int)
    inside = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
    return inside & mask[np.where(inside, row, 0), np.where(inside, column, 0)]


def _chroma(rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
    """Return Cb and Cr of full-range BT.601, 128 for grey, (H, W, 2) float32."""
    red, green, blue = np.moveaxis(rgb.astype(np.float32), -1, 0)
    luma = 0.299 * red + 0.587 * green + 0.114 * blue
    chroma = np.stack((128 + (blue - luma) / 1.772, 128 + (red - luma) / 1.402), axis=-1)
    return chroma.astype(np.float32)
