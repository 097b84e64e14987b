"""The one coordinate file: low-resolution and high-resolution grids, points and arrays.

Conventions of the whole project (METHOD conventions, thesis §2.2 and §3.2):

* arrays are indexed (row, column) and shaped (height, width);
* points are (x, y), x to the right, y down, with pixel centres at whole numbers;
* a motion is a displacement (u, v) from a source low-resolution (LR) pixel to
  the reference view, in LR pixels;
* the high-resolution (HR) grid of a view is K times finer, K may differ along
  x and y (side-by-side material is halved along x only).

"Expanded by K" (thesis §2.2) does not say where a pixel's centre is; two
sampling phases exist and both are supported, see :class:`Sampling`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt


class Sampling(StrEnum):
    """Where the centre of an LR pixel lies on the HR grid."""

    DECIMATION = "decimation"
    """LR pixel i sits on HR pixel K·i (Set 1: blur, then keep every K-th pixel)."""

    AREA = "area"
    """LR pixel i covers K HR pixels; its centre i + ½ maps to K·(i + ½) − ½ (cameras)."""


@dataclass(frozen=True, kw_only=True)
class Grid:
    """The HR grid that belongs to an LR image: magnification and sampling phase.

    Examples
    --------
    >>> grid = Grid(magnification_x=2, magnification_y=2, sampling=Sampling.AREA)
    >>> grid.hr_shape((3, 5)), grid.offset_x
    ((6, 10), 0.5)
    """

    magnification_x: int
    """K along x, dimensionless, ≥ 1."""

    magnification_y: int
    """K along y, dimensionless, ≥ 1."""

    sampling: Sampling

    @property
    def offset_x(self) -> float:
        """HR x coordinate of the centre of LR column 0, HR pixels."""
        return 0.0 if self.sampling is Sampling.DECIMATION else (self.magnification_x - 1) / 2

    @property
    def offset_y(self) -> float:
        """HR y coordinate of the centre of LR row 0, HR pixels."""
        return 0.0 if self.sampling is Sampling.DECIMATION else (self.magnification_y - 1) / 2

    @property
    def largest(self) -> int:
        """The larger K of the two axes."""
        return max(self.magnification_x, self.magnification_y)

    @property
    def halved(self) -> Grid:
        """The grid of half as many HR pixels along each axis; both K are even."""
        return replace(
            self,
            magnification_x=self.magnification_x // 2,
            magnification_y=self.magnification_y // 2,
        )

    def hr_shape(self, lr_shape: tuple[int, int]) -> tuple[int, int]:
        """Return the (height, width) of the HR image of an LR image of that shape."""
        return lr_shape[0] * self.magnification_y, lr_shape[1] * self.magnification_x

    def to_hr(
        self, position: npt.NDArray[np.float32]
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Return x and y on the HR grid, (H, W) float32 each, of LR points (H, W, 2)."""
        x = position[..., 0] * self.magnification_x + self.offset_x
        y = position[..., 1] * self.magnification_y + self.offset_y
        return x, y
