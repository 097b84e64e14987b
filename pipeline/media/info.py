"""What is known of a scene once it is open: frozen records."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path

from pipeline.media.colorimetry import Colorimetry


@dataclass(frozen=True, kw_only=True)
class Sound:
    """A stretch of a video file's sound."""

    path: Path
    begin: Fraction
    """Where it begins, seconds from the file's first picture."""
    end: Fraction
    """Where it ends, likewise."""


@dataclass(frozen=True, kw_only=True)
class SceneInfo:
    """A scene as a whole; views are those that are read, left to right."""

    path: str
    """What was opened, for messages and reports."""
    layout: str
    """What it was recognised as: ``manifest``, ``msr-3d-video``, ``middlebury-2014``, …"""
    view_ids: tuple[str, ...]
    """Ids of the views that are read, left to right; one or more."""
    all_view_ids: tuple[str, ...]
    """Ids of all views of the scene, left to right."""
    lr_shape: tuple[int, int]
    """(height, width) of every view, LR pixels."""
    frame_indices: range
    """Source frame numbers, consecutive; those in file names where there are any."""
    fps: Fraction
    """Frames a second."""
    left: str
    """Id of the left reference; need not be among ``view_ids``."""
    right: str
    """Id of the right reference; need not be among ``view_ids``."""
    bit_depth: int
    """Bits per sample of the files: 8, 10 or 16."""
    is_color: bool
    """False: grey, and views have no chroma."""
    has_depth: tuple[bool, ...]
    """For each of ``view_ids``: whether the scene gives depth; where not, it is estimated."""
    depth_kind: str | None = None
    """``disparity``, ``inverse_depth`` or ``depth`` as stored; None: the scene gives none."""
    depth_is_metric: bool = False
    """True where nearness is 1 / depth in the units of the calibration."""
    has_calibration: bool = False
    """True where every view that is read has a calibration."""
    pixel_aspect: Fraction = Fraction(1)
    """Width over height of a view's pixel; 2 for halves of half-width side-by-side video,
    ½ for halves of half-height top-bottom video; other ones of anamorphic video."""
    input_layout: str | None = None
    """``sbs``, ``half-sbs``, ``tab`` or ``half-tab`` where two views share one picture."""
    colorimetry: Colorimetry = field(default_factory=Colorimetry)
    """What is said of the pictures' RGB: that of the left eye where views differ."""
    timecode: str | None = None
    """Time code of the first frame: that of the left eye's file, or of the first that has any."""
    sound: Path | None = None
    """The video file whose sound belongs to the scene, if any."""
    warnings: tuple[str, ...] = ()
    """What was guessed, ignored or looks suspicious, a sentence each."""

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.frame_indices)
