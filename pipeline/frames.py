"""The values that cross the boundaries of the pipeline's rooms.

A *frame* is all views at one instant; a *view* is one camera; an *image* is a
2-D array. Arrays inside these records are made read-only when the record is
made. Intensities are float32 in 0..255 whatever the bit depth of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

import numpy as np
import numpy.typing as npt

from pipeline.errors import SceneError

GreyImage = npt.NDArray[np.float32]
"""(H, W) float32, grey levels 0..255."""

ChromaImage = npt.NDArray[np.float32]
"""(H, W, 2) float32, Cb and Cr of full-range BT.601 (JPEG) with 128 for grey, 0..255."""

DepthMap = npt.NDArray[np.float32]
"""(H, W) float32, *nearness*: proportional to inverse depth, NaN where unknown."""

Positions = npt.NDArray[np.float32]
"""(H, W, 2) float32, points (x, y) in LR pixels of the reference view, NaN where none."""

Mask = npt.NDArray[np.bool_]
"""(H, W) bool."""


def frozen(array: npt.NDArray) -> npt.NDArray:
    """Return the array as a read-only view of the same data."""
    view = array.view()
    view.flags.writeable = False
    return view


@dataclass(frozen=True, kw_only=True, eq=False)
class Calibration:
    """A pinhole camera.

    Frame of reference: x right, y down, z forward; pixel centres at whole numbers.
    """

    intrinsics: npt.NDArray[np.float64]
    """(3, 3), pixels of the colour image."""

    world_to_camera: npt.NDArray[np.float64]
    """(4, 4) rigid transform, scene units."""

    @property
    def projection(self) -> npt.NDArray[np.float64]:
        """(3, 4) matrix from homogeneous world points to homogeneous pixels."""
        return self.intrinsics @ self.world_to_camera[:3]

    @property
    def centre(self) -> npt.NDArray[np.float64]:
        """(3,) camera centre in world units."""
        rotation, translation = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -rotation.T @ translation


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """One camera's picture at one instant, with its depth map."""

    view_id: str
    """Unique in the frame."""

    luma: GreyImage
    """(H, W) float32, 0..255: BT.601 full-range luma of RGB input (OpenCV's BGR2GRAY), or grey."""

    chroma: ChromaImage | None = None
    """(H, W, 2) float32, or None for grey input."""

    depth_map: DepthMap | None = None
    """(H, W) float32 nearness on the luma's pixel grid, NaN where unknown; None: no depth."""

    depth_is_estimated: bool = False
    """True where depth came from neighbouring views and not from the scene."""

    calibration: Calibration | None = None

    def __post_init__(self) -> None:
        if self.luma.ndim != 2 or self.luma.dtype != np.float32:
            raise SceneError("luma must be a 2-D float32 image", view=self.view_id)
        for name in ("chroma", "depth_map"):
            array = getattr(self, name)
            if array is not None and array.shape[:2] != self.luma.shape:
                raise SceneError(
                    f"{name} is {array.shape[1]}×{array.shape[0]}, "
                    f"luma is {self.luma.shape[1]}×{self.luma.shape[0]}",
                    view=self.view_id,
                )
        for name in ("luma", "chroma", "depth_map"):
            array = getattr(self, name)
            if array is not None:
                object.__setattr__(self, name, frozen(array))


@dataclass(frozen=True, kw_only=True, eq=False)
class MultiViewFrame:
    """All views at one instant, left to right."""

    frame_index: int
    """Source frame number (the number in file names), ≥ 0."""

    views: tuple[View, ...]
    """One or more, left to right, all of one size."""

    left: str
    """``view_id`` of the left reference."""

    right: str
    """``view_id`` of the right reference."""

    bit_depth: int = 8
    """Bits per sample of the input files: 8, 10 or 16."""

    depth_is_metric: bool = False
    """True where nearness is 1 / depth in the units of ``world_to_camera``."""

    def view(self, view_id: str) -> View:
        """Return the view of that id; raise KeyError where there is none."""
        for view in self.views:
            if view.view_id == view_id:
                return view
        raise KeyError(view_id)

    @property
    def lr_shape(self) -> tuple[int, int]:
        """(height, width) of every view, LR pixels."""
        height, width = self.views[0].luma.shape
        return height, width


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where a view is that no camera took."""

    left: str
    """Id of the camera's view to the left of it."""
    right: str
    at: float
    """Share of the way from the left one to the right one, above 0 and below 1."""


class Rejection(IntFlag):
    """Why an LR pixel is not trusted as a constraint (thesis §2.2, Eq. 4); 0 is trusted."""

    NONE = 0
    NO_MOTION = 1
    """Its patch could not be registered."""
    OUTSIDE = 2
    """It lands outside the reference view."""
    WEIGHT = 4
    """|registration weight| > T_w (Eq. 3, Eq. 4)."""
    DEPTH = 8
    """|depth difference at its landing point| > T_D (Eq. 4)."""
    RESIDUAL = 16
    """|reconstruction residual| > T_R (thesis §3.2)."""
    EDGE = 32
    """The motion jumps beside it, so that it sees two surfaces (not in the thesis)."""
    OCCLUDED = 64
    """A nearer surface of the same view lands on the same place (not in the thesis)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RegisteredView:
    """Where every LR pixel of one view lands in a reference view, and whether to trust it.

    The whole contract between registration and reconstruction: reconstruction
    knows nothing of depth, layers or cameras.
    """

    view_id: str

    observed: GreyImage
    """(H, W) float32, grey levels, with the intensity term ζ already applied."""

    position: Positions
    """(H, W, 2) float32 as (x, y), LR pixels of the reference view; NaN where no motion."""

    registration_weights: GreyImage
    """(H, W) float32, *signed* grey-level difference reference − source + ζ (Eq. 3); 0 is best."""

    flags: npt.NDArray[np.uint8]
    """(H, W) uint8, :class:`Rejection` bits; 0 is trusted."""

    confidence: npt.NDArray[np.float32]
    """(H, W) float32 in 0..1, how far the position may be believed where flags are 0."""

    is_reference: bool = False
    """True for the reference view itself: its position is the identity."""

    @property
    def verification_map(self) -> Mask:
        """(H, W) bool, True where trusted: V of Eq. 4."""
        return self.flags == 0
