"""The sample scene: its frames as cameras deliver them, and the truth about them.

Not in the thesis. Everything the estimators must find out is known here
exactly: calibration, depth, motion, visibility, and the HR picture itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.colour import picture_from_grey, picture_from_rgb
from pipeline.errors import ConfigurationError
from pipeline.frames import Calibration, GreyImage, MultiViewFrame, View, frozen
from pipeline.grid import Grid, Sampling
from pipeline.synthetic import raycast, stage
from pipeline.synthetic.observation import DEPTH_LEVELS, blur_and_sample, degraded_depth
from pipeline.synthetic.rendering import Renderer
from pipeline.synthetic.rig import Camera, Rig
from pipeline.threads import map_threads

FOCAL = 1.12
"""Focal length over image width (of a 4 : 3 image), dimensionless."""

DISPARITY_STEP = 12 / 512
"""Default largest displacement between neighbouring views over image width."""

VISIBLE_TOLERANCE = 1e-6
"""Share of its depth by which a point may lie behind another surface and still be seen."""


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

    def motion(self, source_view: int, reference_view: int, *, psf_support: int = 7) -> TrueMotion:
        """Return the true motion between two views of this frame."""
        return self.scene.true_motion(
            source_view, reference_view, self.frame_index,
            sampling=self.grid.sampling, psf_support=psf_support,
        )  # fmt: skip


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
    """Of the textures, of the rig's errors and of the depth's."""
    bodies: tuple[stage.Body, ...] = field(default=stage.STAGE, repr=False)
    """What stands on the stage."""
    _kept: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or self.num_views < 1:
            raise ConfigurationError("the sample scene needs a size and views of 1 or more")
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
        """Names of the views: ``cam0``, ``cam1`` and so on."""
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
    def baseline(self) -> float:
        """Distance between neighbouring cameras, metres."""
        return float(self._rig[0])

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The cameras of the HR images, left to right."""
        return self._rig[1]

    @property
    def _rig(self) -> tuple[float, tuple[Camera, ...]]:
        if "rig" not in self._kept:
            grid = self.grid()
            focal = FOCAL * max(self.width, self.height * 4 / 3)
            rig = Rig(
                num_views=self.num_views,
                references=self.reference_views,
                hr_shape=self.hr_shape,
                focal=(focal * grid.magnification_x, focal * grid.magnification_y),
                rotation=float(np.deg2rad(self.rotation_degrees)),
                seed=self.seed,
            )
            wanted = self.max_disparity
            if wanted is None:
                left = self.reference_views[0]
                wanted = DISPARITY_STEP * self.width * max(left, self.num_views - 1 - left)
            baseline = rig.fitting_baseline(self.bodies, wanted * grid.magnification_x)
            self._kept["rig"] = (baseline, rig.cameras(baseline))
        return self._kept["rig"]

    def calibration(self, view_index: int, sampling: Sampling = Sampling.DECIMATION) -> Calibration:
        """Return the true calibration of a view's LR image, metres."""
        return self.cameras[view_index].calibration(self.grid(sampling))

    # --- pictures ----------------------------------------------------------------------

    @property
    def _renderer(self) -> Renderer:
        if "renderer" not in self._kept:
            self._kept["renderer"] = Renderer(self.bodies, self.cameras, self.hr_shape, self.seed)
        return self._kept["renderer"]

    def render_hr(self, view_index: int, time: float = 0.0) -> npt.NDArray[np.uint8]:
        """Return the HR picture of a view at a time, (K·H, K·W, 3) uint8 RGB, read-only."""
        return self._renderer.picture(view_index, time)

    def render_all(self, time: float = 0.0) -> list[npt.NDArray[np.uint8]]:
        """Return the HR pictures of all views, several painted at a time."""
        return self._renderer.all_pictures(time)

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
            as_read = picture_from_rgb(lr_image, 255) if color else picture_from_grey(lr_image, 255)
            depth_map = None
            if depth == "true":
                depth_map = 1 / self.true_depth(number, time_index, sampling=sampling)
            elif depth == "stereo":
                stored = self.stereo_depth(number, time_index, sampling=sampling)
                scale, offset = self.depth_scale
                depth_map = np.where(stored > 0, stored * scale + offset, np.nan)
            return View(
                view_id=self.view_ids[number],
                luma=as_read.luma,
                chroma=as_read.chroma,
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
            depth=tuple(self.true_depth(number, time_index, sampling=sampling) for number in views),
            calibration=tuple(self.calibration(number, sampling) for number in views),
            scene=self,
        )

    def true_depth(
        self, view_index: int, time_index: int = 0, *, sampling: Sampling = Sampling.DECIMATION
    ) -> npt.NDArray[np.float64]:
        """Return the distance along the optical axis at LR pixel centres, (H, W) metres."""
        return self._seen(view_index, time_index, sampling)[0]

    def surfaces(
        self, view_index: int, time_index: int = 0, *, sampling: Sampling = Sampling.DECIMATION
    ) -> npt.NDArray[np.int16]:
        """Return which surface is seen at LR pixel centres, (H, W); cube faces count singly."""
        return self._seen(view_index, time_index, sampling)[1]

    def _seen(
        self, view_index: int, time_index: int, sampling: Sampling
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int16]]:
        """Return depth and surface at LR pixel centres; the last ones of each view are kept."""
        key = ("seen", view_index, sampling)
        kept = self._kept.get(key)
        if kept is None or kept[0] != time_index:
            grid = self.grid(sampling)
            depth, found = self.cameras[view_index].trace(
                self.bodies, time_index / self.fps, (self.height, self.width),
                (grid.offset_x, grid.offset_y), (grid.magnification_x, grid.magnification_y),
            )  # fmt: skip
            kept = (time_index, (frozen(depth), frozen(found)))
            self._kept[key] = kept
        return kept[1]

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
        position, visible = self._landing(source_view, reference_view, time_index, sampling)
        x, y = np.meshgrid(np.arange(self.width), np.arange(self.height))
        near_edge = np.zeros(visible.shape, np.bool_)
        for view, column, row in (
            (source_view, x, y),
            (reference_view, position[..., 0], position[..., 1]),
        ):
            near_edge |= _looked_up(
                self._edges(view, time, psf_support),
                grid.offset_x + grid.magnification_x * column,
                grid.offset_y + grid.magnification_y * row,
            )
        return TrueMotion(position=position, visible=visible, near_edge=near_edge)

    def _landing(
        self, source_view: int, reference_view: int, time_index: int, sampling: Sampling
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Return where LR pixels land, (H, W, 2), and whether they are seen there, (H, W)."""
        time, grid = time_index / self.fps, self.grid(sampling)
        source, reference = self.cameras[source_view], self.cameras[reference_view]
        depth, found = self._seen(source_view, time_index, sampling)
        x, y = np.meshgrid(
            grid.offset_x + grid.magnification_x * np.arange(self.width),
            grid.offset_y + grid.magnification_y * np.arange(self.height),
        )
        points = source.back_project(x, y, depth)
        landing = np.ascontiguousarray(reference.project(points)[..., :2])
        table = stage.compiled(self.bodies, time)
        clear = np.empty(depth.size, np.bool_)
        raycast.unblocked(
            table, *stage.local_frames(table, reference.centre),
            reference.boxes(self.bodies, time), reference.centre, points.reshape(-1, 3),
            landing.reshape(-1, 2), VISIBLE_TOLERANCE, clear,
        )  # fmt: skip
        position = (landing - [grid.offset_x, grid.offset_y]) / [
            grid.magnification_x, grid.magnification_y,
        ]  # fmt: skip
        inside = (
            (position[..., 0] >= 0) & (position[..., 0] <= self.width - 1)
            & (position[..., 1] >= 0) & (position[..., 1] <= self.height - 1)
        )  # fmt: skip
        return position, clear.reshape(depth.shape) & inside & (found >= 0)

    def _edges(self, view_index: int, time: float, psf_support: int) -> npt.NDArray[np.bool_]:
        """Return the HR pixels from which a PSF reaches over the border of two surfaces."""
        key = ("edges", view_index, psf_support)
        kept = self._kept.get(key)
        if kept is None or kept[0] != time:
            _, found = self.cameras[view_index].trace(self.bodies, time, self.hr_shape)
            strips = [n for n, body in enumerate(self.bodies) if body.texture.startswith("floor")]
            found[np.isin(found, strips)] = -2  # one surface
            window = np.ones((psf_support + 2, psf_support + 2), np.uint8)
            kept = (time, cv2.dilate(found, window) != cv2.erode(found, window))
            self._kept[key] = kept
        return kept[1]

    # --- depth as delivered ------------------------------------------------------------

    @property
    def depth_range(self) -> tuple[float, float]:
        """Inverse depths of the stored levels 1 and 255, 1/metres."""
        if "range" not in self._kept:
            depth, found = self.cameras[self.reference_views[0]].trace(
                self.bodies, 0.0, self.hr_shape
            )
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
        _, visible = self._landing(view_index, other, time_index, sampling)
        depth = self.true_depth(view_index, time_index, sampling=sampling)
        return degraded_depth(
            1 / depth, ~visible, self.depth_range,
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


def _looked_up(
    mask: npt.NDArray[np.bool_], x: npt.NDArray, y: npt.NDArray
) -> npt.NDArray[np.bool_]:
    """Return the mask at the nearest HR pixels; False outside."""
    column, row = (np.rint(np.clip(place, -9.0, 1e6)).astype(int) for place in (x, y))
    inside = (column >= 0) & (column < mask.shape[1]) & (row >= 0) & (row < mask.shape[0])
    return inside & mask[np.where(inside, row, 0), np.where(inside, column, 0)]
