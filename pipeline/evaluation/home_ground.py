"""The degradation that other projects' networks were trained on: antialiased bicubic, halved.

Their LR pixel covers the HR pixels that it was made of (:attr:`pipeline.grid.Sampling.AREA`),
and their kernel is the cubic of a = −½ stretched by K, as MATLAB's ``imresize`` has it.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.degradation import Degradation, DegradedFrame
from pipeline.evaluation.subjects import Subject
from pipeline.reconstruction.psf import BicubicPsf

HALVING = BicubicPsf(magnification=2)
"""The kernel, as a point spread function on the HR grid."""

_FREQUENCIES = np.linspace(0, 0.5, 257)
"""Cycles per HR pixel."""


def halving_taps() -> npt.NDArray[np.float64]:
    """Return the 8 taps of the halving along one axis, unit sum, centred between HR pixels."""
    return HALVING.taps_at(0.5)[1:]


def halved(
    image: npt.NDArray[np.uint8], noise: float, stream: np.random.Generator
) -> npt.NDArray[np.float32]:
    """Return the picture (2·H, 2·W) halved, (H, W), noise added, whole grey levels."""
    taps = halving_taps()
    smooth = cv2.sepFilter2D(
        image.astype(np.float64), cv2.CV_64F, taps, taps, anchor=(3, 3),
        borderType=cv2.BORDER_REFLECT,
    )  # fmt: skip
    small = smooth[::2, ::2]
    if noise > 0:
        small = small + stream.normal(0.0, noise, small.shape)
    return np.clip(np.rint(small), 0, 255).astype(np.float32)


def home_frame(subject: Subject, noise: float, seed: int = 1) -> DegradedFrame:
    """Return the subject halved their way, with the depth that Set 1 gives it."""
    made = subject.degraded(Degradation(psf_sigma=1.0))
    views = []
    for number, view in enumerate(made.frame.views):
        stream = np.random.default_rng([seed, made.frame.frame_index, number])
        calibration = view.calibration
        if calibration is not None:  # an LR pixel sits half an HR pixel further in
            shift = np.array([[0, 0, -0.25], [0, 0, -0.25], [0, 0, 0]])
            calibration = replace(calibration, intrinsics=calibration.intrinsics + shift)
        luma = halved(made.truth[view.view_id], noise, stream)
        views.append(replace(view, luma=luma, calibration=calibration))
    return replace(made, frame=replace(made.frame, views=tuple(views)))


def home_settings(settings: Settings) -> Settings:
    """Return the settings for such a frame; the default is told the kernel, as SRMD is."""
    return replace(
        settings, magnification="2", sampling="area", psf="bicubic",
        psf_sigma=None, psf_support=None,
    )  # fmt: skip


def kernel_before_halving(sigma: float) -> float:
    """Return the σ that, followed by the halving, blurs most as a Gaussian of that σ, HR pixels."""
    return _nearest_sigma(_passed_by_halving(), _passed_by_gaussian(sigma))


def _passed_by_halving() -> npt.NDArray[np.float64]:
    offsets = np.arange(8) - 3.5
    waves = np.cos(2 * np.pi * offsets[:, None] * _FREQUENCIES)
    return np.asarray(halving_taps() @ waves)


def _passed_by_gaussian(sigma: float) -> npt.NDArray[np.float64]:
    return np.asarray(np.exp(-2 * (np.pi * sigma * _FREQUENCIES) ** 2))


def _nearest_sigma(first: npt.NDArray[np.float64], wanted: npt.NDArray[np.float64]) -> float:
    sigmas = np.arange(0.05, 3.0, 0.005)
    off = [np.sum((first * _passed_by_gaussian(sigma) - wanted) ** 2) for sigma in sigmas]
    return float(sigmas[int(np.argmin(off))])
