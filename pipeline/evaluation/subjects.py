"""What is evaluated: a scene on disk, or the rendered one, where more is true.

A subject gives the same LR frame for the same degradation, so that every study sees the
same input; the studies do not know where it came from.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.degradation import Degradation, DegradedFrame
from pipeline.errors import ConfigurationError
from pipeline.evaluate import BORDER, degraded_input, settings_of
from pipeline.evaluation.methods import MethodRun, timed_run
from pipeline.frames import Mask, MultiViewFrame, Positions
from pipeline.grid import Grid
from pipeline.media.source import open_scene
from pipeline.metrics import SSIM_WINDOW
from pipeline.registration.register import prepare_views, register_views
from pipeline.superresolve import RegisteredFrame, register_frame, terms_of
from pipeline.synthetic import SampleScene, SampleTruth

SAMPLE = "sample"
"""Name of the rendered scene where scenes are named."""

SEAM = 0.5
"""Difference of neighbouring landing points from their regular step from which a depth edge
lies between them, LR pixels."""

SMALLEST = 2 * BORDER + SSIM_WINDOW
"""Least side of the HR picture, pixels."""


@dataclass(frozen=True, kw_only=True)
class Between:
    """Where each HR pixel of the left eye lies in the right eye."""

    position: Positions
    """(K·H, K·W, 2) as (x, y), HR pixels of the right eye."""
    seen: Mask
    """(K·H, K·W): the right eye sees it, too."""


@dataclass(eq=False, kw_only=True)
class Subject:
    """A scene at one instant, ready to be degraded."""

    name: str
    frame: MultiViewFrame | None
    """The HR frame; None for the rendered scene, which observes itself."""
    sample: SampleScene | None = None
    settings: Settings = field(default_factory=Settings)
    """Of all methods; grid and PSF follow the degradation."""
    _kept: dict[Degradation, DegradedFrame] = field(default_factory=dict, repr=False)
    _runs: dict[tuple[str, Degradation, str], MethodRun] = field(default_factory=dict, repr=False)

    @property
    def is_rendered(self) -> bool:
        """Whether true motion is known."""
        return self.sample is not None

    @property
    def eyes(self) -> tuple[str, str]:
        """View ids of the left and the right eye."""
        if self.sample is not None:
            left, right = (self.sample.view_ids[n] for n in self.sample.reference_views)
            return left, right
        assert self.frame is not None
        return self.frame.left, self.frame.right

    @property
    def view_ids(self) -> tuple[str, ...]:
        """All views, left to right."""
        if self.sample is not None:
            return self.sample.view_ids
        assert self.frame is not None
        return tuple(view.view_id for view in self.frame.views)

    @cached_property
    def sample_truth(self) -> SampleTruth:
        """What is true of the rendered scene."""
        if self.sample is None:
            raise LookupError(f"{self.name} is no rendered scene")
        return self.sample.truth(0)

    def degraded(self, degradation: Degradation) -> DegradedFrame:
        """Return the LR frame and the HR truth; the last few are kept."""
        if degradation not in self._kept:
            while len(self._kept) > 3:
                self._kept.pop(next(iter(self._kept)))
            self._kept[degradation] = self._degrade(degradation)
        return self._kept[degradation]

    def run(self, method: str, degradation: Degradation, eye: str) -> MethodRun:
        """Return what a method makes of one eye; it is run once, whoever asks."""
        key = (method, degradation, eye)
        if key not in self._runs:
            degraded = self.degraded(degradation)
            settings = settings_of(degradation, self.settings)
            self._runs[key] = timed_run(method, degraded, settings, eye)
        return self._runs[key]

    def registered(self, degradation: Degradation) -> RegisteredFrame:
        """Return all views registered onto the left eye, to be reconstructed in several ways."""
        settings = settings_of(degradation, self.settings)
        return register_frame(self.degraded(degradation).frame, settings, targets=(self.eyes[0],))

    def _degrade(self, degradation: Degradation) -> DegradedFrame:
        if self.frame is not None:
            return degraded_input(self.frame, degradation)
        assert self.sample is not None
        frame = self.sample.frame(
            0, psf_sigma=degradation.psf_sigma, psf_support=degradation.psf_support,
            noise_sigma=degradation.noise_sigma, noise_seed=degradation.seed, depth="stereo",
        )  # fmt: skip
        truth = {
            view_id: luma.astype(np.uint8)
            for view_id, luma in zip(self.view_ids, self.sample_truth.hr_luma, strict=True)
        }
        return DegradedFrame(frame=frame, truth=truth)

    @cached_property
    def between_eyes(self) -> Between:
        """Where the left eye's pixels lie in the right eye; found once, without noise.

        True for the rendered scene. Elsewhere the default registration of the clean LR
        frame: every method is then judged by the same correspondence.
        """
        degradation = Degradation(psf_sigma=1.0)
        frame = self.degraded(degradation).frame
        left, right = self.eyes
        if self.sample is not None:
            number = self.view_ids.index
            motion = self.sample_truth.motion(number(left), number(right))
            return _enlarged(motion.position, motion.visible, degradation.grid)
        prepared = prepare_views(
            [frame.view(left), frame.view(right)], metric=frame.depth_is_metric
        )
        found = register_views(prepared, [right], [left], terms_of(Settings(), 0.3))[right][
            0
        ].registered
        return _enlarged(found.position, found.verification_map, degradation.grid)


def _enlarged(position: npt.NDArray[Any], visible: Mask, grid: Grid) -> Between:
    """Return LR landing points on the HR grid: linear between neighbours on one surface."""
    lr_height, lr_width = visible.shape
    height, width = grid.hr_shape((lr_height, lr_width))
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    x, y = columns / grid.magnification_x, rows / grid.magnification_y
    lr_rows, lr_columns = np.mgrid[:lr_height, :lr_width].astype(np.float32)
    motion = position.astype(np.float32) - np.stack((lr_columns, lr_rows), axis=-1)
    good = visible & np.isfinite(motion).all(axis=-1)
    steps = [np.abs(np.diff(np.nan_to_num(motion), axis=axis)).max(axis=-1) for axis in (0, 1)]
    whole = good.copy()
    whole[:-1] &= steps[0] < SEAM
    whole[:, :-1] &= steps[1] < SEAM
    whole[:-1] &= good[1:]
    whole[:, :-1] &= good[:, 1:]
    moved = cv2.remap(
        np.nan_to_num(motion), x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    place = np.stack(
        (
            columns + moved[..., 0] * grid.magnification_x,
            rows + moved[..., 1] * grid.magnification_y,
        ),
        axis=-1,
    )
    cell = whole[np.floor(y).astype(int), np.floor(x).astype(int)]
    return Between(position=place, seen=cell)


def open_subject(name: str, settings: Settings, *, frame_number: int | None = None) -> Subject:
    """Return the scene at that path, or the rendered scene for the name ``sample``.

    Raises
    ------
    ConfigurationError
        If the pictures are too small to be halved and measured, or there is no such frame.
    """
    if name == SAMPLE:
        return Subject(name=SAMPLE, frame=None, sample=SampleScene(), settings=settings)
    path = Path(name)
    with open_scene(path) as source:
        available = source.info.frame_indices
        number = available.start if frame_number is None else frame_number
        if number not in available:
            raise ConfigurationError(
                f"{path}: frame {number} is not within {available.start}:{available.stop}"
            )
        frame = source.read(number)
    height, width = frame.lr_shape
    if min(height, width) < SMALLEST:
        raise ConfigurationError(
            f"{path}: pictures of {width}×{height} are too small to be halved and measured; "
            f"{SMALLEST} pixels is the least side"
        )
    return Subject(name=path.resolve().name, frame=frame, settings=settings)
