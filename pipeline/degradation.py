"""Set 1: make a low-resolution scene out of a real one, so that the truth is known.

METHOD §4 (thesis §5.1, "Set 1"): 8-bit luma, cut to multiples of K, blurred
with a known PSF under a reflecting border, decimated, noise added, rounded.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.colour import to_rgb
from pipeline.errors import ConfigurationError, SceneError
from pipeline.frames import Calibration, MultiViewFrame, View
from pipeline.grid import Grid, Sampling


@dataclass(frozen=True, kw_only=True)
class Degradation:
    """How Set 1 makes LR images: grid, PSF and noise."""

    magnification_x: int = 2
    magnification_y: int = 2
    psf_sigma: float = 1.7
    """HR pixels."""
    psf_support: int = 7
    """HR pixels, odd."""
    noise_sigma: float = 0.0
    """Grey levels."""
    seed: int = 1
    """Of the noise; every view and frame has its own stream."""

    def __post_init__(self) -> None:
        if self.magnification_x < 1 or self.magnification_y < 1:
            raise ConfigurationError("--magnification: must be 1 or more along x and y")
        if self.psf_sigma <= 0:
            raise ConfigurationError("--psf-sigma: must be above 0 HR pixels")
        if self.psf_support < 1 or self.psf_support % 2 == 0:
            raise ConfigurationError(
                f"--psf-support: must be an odd number of HR pixels, not {self.psf_support}"
            )
        if self.noise_sigma < 0:
            raise ConfigurationError("--noise: must be 0 grey levels or more")
        if self.seed < 0:
            raise ConfigurationError("--seed: must be 0 or more")

    @property
    def grid(self) -> Grid:
        """The HR grid of the truth: Set 1 decimates."""
        return Grid(
            magnification_x=self.magnification_x,
            magnification_y=self.magnification_y,
            sampling=Sampling.DECIMATION,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class DegradedFrame:
    """What Set 1 makes of a frame."""

    frame: MultiViewFrame
    """Grey LR views."""
    truth: dict[str, npt.NDArray[np.uint8]]
    """HR luma by view id, (K·H, K·W) uint8."""


def gaussian_taps(sigma: float, support: int) -> npt.NDArray[np.float64]:
    """Return the unit-sum samples of a Gaussian at whole offsets, (support,) float64."""
    offsets = np.arange(support) - support // 2
    taps = np.exp(-(offsets**2) / (2.0 * sigma * sigma))
    return np.asarray(taps / taps.sum())


def eight_bit_luma(view: View) -> npt.NDArray[np.uint8]:
    """Return the view's luma rounded to 8 bit, (H, W) uint8, exactly as OpenCV's BGR2GRAY has it.

    OpenCV weighs the 8-bit colours in fixed point, with weights of 14 bits.
    Rounding the frame's luma instead would differ by one grey level in one
    pixel of two thousand, those within 0.003 of a half; so the colours are
    taken back from luma and chroma, which is exact, and weighed by OpenCV.
    """
    if view.chroma is None:
        return np.clip(np.rint(view.luma), 0, 255).astype(np.uint8)
    colours = to_rgb(view.luma, view.chroma, 8)
    return np.asarray(cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY))


def degrade_image(
    hr_image: npt.NDArray[np.uint8],
    degradation: Degradation,
    noise: np.random.Generator | None = None,
) -> npt.NDArray[np.float32]:
    """Return the LR image of an HR image, whole grey levels 0..255 as float32.

    The HR image's sides must be multiples of K (the caller cuts).
    """
    taps = gaussian_taps(degradation.psf_sigma, degradation.psf_support)
    height, width = hr_image.shape
    if degradation.psf_support // 2 >= min(height, width):
        raise ConfigurationError(
            f"--psf-support: a PSF of {degradation.psf_support} HR pixels is too wide "
            f"for an image of {width}×{height}"
        )
    smooth = cv2.sepFilter2D(
        hr_image.astype(np.float64), cv2.CV_64F, taps, taps, borderType=cv2.BORDER_REFLECT_101
    )
    lr_image = smooth[:: degradation.magnification_y, :: degradation.magnification_x]
    if degradation.noise_sigma > 0:
        if noise is None:
            raise ValueError("noise asked for without a generator")
        lr_image = lr_image + noise.normal(0.0, degradation.noise_sigma, lr_image.shape)
    return np.clip(np.rint(lr_image), 0, 255).astype(np.float32)


def degrade_frame(frame: MultiViewFrame, degradation: Degradation) -> DegradedFrame:
    """Return the grey LR frame of Set 1, and the HR luma it was made of.

    Notes
    -----
    Depth maps are decimated as the images are; disparities shrink with the
    pixels (÷ K along x), metric nearness does not. Intrinsics follow the
    decimation phase: LR pixel (i, j) is HR pixel (K·i, K·j), so that the focal
    lengths and the principal point are divided by K.
    """
    step_x, step_y = degradation.magnification_x, degradation.magnification_y
    height, width = frame.lr_shape
    kept_height, kept_width = height - height % step_y, width - width % step_x
    if kept_height == 0 or kept_width == 0:
        raise SceneError(f"{width}×{height} pixels are too few to decimate")
    views, truth = [], {}
    for number, view in enumerate(frame.views):
        hr_luma = eight_bit_luma(view)[:kept_height, :kept_width]
        stream = np.random.default_rng([degradation.seed, frame.frame_index, number])
        # An estimated map is dropped: the LR scene has to find its own.
        depth_map = None if view.depth_is_estimated else view.depth_map
        if depth_map is not None:
            depth_map = depth_map[:kept_height:step_y, :kept_width:step_x]
            scale = 1 if frame.depth_is_metric else step_x
            depth_map = (depth_map / np.float32(scale)).astype(np.float32)
        views.append(
            replace(
                view,
                luma=degrade_image(hr_luma, degradation, stream),
                chroma=None,
                depth_map=depth_map,
                depth_is_estimated=False,
                calibration=_scaled(view.calibration, step_x, step_y),
            )
        )
        truth[view.view_id] = hr_luma
    return DegradedFrame(frame=replace(frame, views=tuple(views), bit_depth=8), truth=truth)


def _scaled(calibration: Calibration | None, step_x: int, step_y: int) -> Calibration | None:
    if calibration is None:
        return None
    scale = np.diag([1.0 / step_x, 1.0 / step_y, 1.0])
    return replace(calibration, intrinsics=scale @ calibration.intrinsics)
