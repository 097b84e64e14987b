"""Peers that fuse views, as the default does: what they are asked for, and what they are."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pipeline.evaluation.methods import Accounted
from pipeline.frames import MultiViewFrame


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A region of one view, to be doubled."""

    frame: MultiViewFrame
    """Its views are taken for the frames of a video, left to right."""
    reference: str
    """View id."""
    sigma: float
    """Of the PSF, HR pixels."""
    region: tuple[int, int, int, int]
    """x, y, width, height, all even, LR pixels."""

    @property
    def number(self) -> int:
        """Of the reference among the views, 0-based."""
        return [view.view_id for view in self.frame.views].index(self.reference)


@dataclass(frozen=True, kw_only=True)
class Fuser:
    """Another project's way of doubling a view with the help of the others."""

    name: str
    run: Callable[[Asked], Accounted[npt.NDArray[np.float32]]]
    """Twice as many rows and columns as the region, grey levels.

    Raises :class:`pipeline.evaluation.programs.ProgramFailed`."""
    missing: Callable[[], str]
    """What is not there that it needs; empty where all is."""
    files: Callable[[], tuple[Path, ...]]
    """What it is made of, and the code here that runs it."""
    on_pixels: bool
    """Whether it takes LR pixel i to lie on HR pixel 2i; else pixel areas are aligned."""
