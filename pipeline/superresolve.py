"""One multi-view frame in, super-resolved reference views out: the order of the stages."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.config import Settings
from pipeline.frames import MultiViewFrame
from pipeline.results import FrameReport, FrameResult, SuperResolvedImage


def superresolve(
    frame: MultiViewFrame,
    settings: Settings,
    *,
    targets: tuple[str, ...],
    observed_views: tuple[str, ...] | None = None,
    keep_intermediates: bool = False,
) -> FrameResult:
    """Temporary bicubic skeleton of the contract (the real stages land next)."""
    grid = settings.grid
    images = {}
    for view_id in targets:
        view = frame.view(view_id)
        height, width = grid.hr_shape(view.luma.shape)
        matrix = np.array(
            [
                [1 / grid.magnification_x, 0, -grid.offset_x / grid.magnification_x],
                [0, 1 / grid.magnification_y, -grid.offset_y / grid.magnification_y],
            ]
        )

        def enlarge(image):
            return cv2.warpAffine(
                image, matrix, (width, height),
                flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE,
            )  # fmt: skip

        images[view_id] = SuperResolvedImage(
            view_id=view_id,
            luma=np.clip(enlarge(view.luma), 0, 255),
            chroma=None if view.chroma is None else enlarge(view.chroma),
        )
    report = FrameReport(
        frame_index=frame.frame_index, noise_sigma=0.0, noise_is_estimated=False, psf_sigma=1.0,
        psf_support=7, psf_is_estimated=False, targets=(), timings={},
    )  # fmt: skip
    return FrameResult(frame_index=frame.frame_index, images=images, report=report)
