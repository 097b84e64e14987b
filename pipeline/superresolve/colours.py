"""The colour of an image, enlarged when it is asked for, and no larger than it is wanted."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.colour import interleaved
from pipeline.frames import ChromaImage
from pipeline.grid import Grid
from pipeline.reconstruction.fused import filtered
from pipeline.reconstruction.restoration import (
    Restoration,
    bicubic_filter,
    halved_bicubic_filter,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class EnlargedColour:
    """Chroma of a view, enlarged by bicubic interpolation; see :class:`pipeline.results.Colour`."""

    chroma: ChromaImage
    """(H, W, 2) float32, of the view."""
    grid: Grid

    def whole(self) -> ChromaImage:
        """Return it on the HR grid, clipped to 0..255."""
        picture = self._filtered(bicubic_filter(self.grid), self.grid)
        return np.clip(picture, 0.0, 255.0, out=picture)

    def halved(self) -> ChromaImage | None:
        """Return what :func:`pipeline.media.coded.coded` makes of the whole; None where K is odd.

        Each plane is filtered once, by the taps of enlarging and halving together: values beyond
        0..255 are not clipped, and beyond a border lies what the view repeats there.
        """
        taps = halved_bicubic_filter(self.grid)
        if taps is None:
            return None
        if len(taps.along_x) == len(taps.along_y) == 1:  # no larger than the view
            made = cv2.sepFilter2D(
                self.chroma, cv2.CV_32F, _at_work(taps.along_x[0]), _at_work(taps.along_y[0]),
                borderType=cv2.BORDER_REPLICATE,
            )  # fmt: skip
            return np.asarray(made, np.float32).reshape(self.chroma.shape)
        return self._filtered(taps, self.grid.halved)

    def _filtered(self, taps: Restoration, grid: Grid) -> ChromaImage:
        planes = (np.ascontiguousarray(self.chroma[..., plane]) for plane in range(2))
        return interleaved([filtered(plane, taps, grid) for plane in planes])


def _at_work(taps: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return taps without those at both ends that are zero, which OpenCV would multiply by."""
    idle = 0
    while 2 * idle + 1 < len(taps) and not taps[idle] and not taps[-1 - idle]:
        idle += 1
    return taps[idle : len(taps) - idle]
