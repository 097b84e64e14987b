"""What a scene is on disk: where the pictures and depth maps of each view lie, and what they mean.

A :class:`SceneDescription` is made from a manifest (``manifest``), or from a folder without one
(``layouts``). Nothing here opens a picture; that the files exist is checked by the reader.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from pathlib import Path

import numpy as np

from pipeline.errors import SceneError
from pipeline.frames import Calibration
from pipeline.media.ycbcr import YcbcrMatrix
from pipeline.media.yuv import Range

CONVERSION = re.compile(r"%(0[1-9][0-9]?)?d")
"""Where the name of an image file has its frame's number."""


class DepthKind(StrEnum):
    """What a depth value means."""

    DISPARITY = "disparity"
    """Proportional to inverse depth; the factor need not be known. Grows with nearness."""

    INVERSE_DEPTH = "inverse_depth"
    """1 / z, in the units of the calibration where there is one. Grows with nearness."""

    DEPTH = "depth"
    """z along the camera's axis; grows with distance."""


class PackedLayout(StrEnum):
    """How two views share one picture."""

    SIDE_BY_SIDE = "sbs"
    HALF_SIDE_BY_SIDE = "half-sbs"
    TOP_BOTTOM = "tab"
    HALF_TOP_BOTTOM = "half-tab"

    @property
    def is_horizontal(self) -> bool:
        """True where the views lie beside each other."""
        return self in (PackedLayout.SIDE_BY_SIDE, PackedLayout.HALF_SIDE_BY_SIDE)

    def pixel_aspect_of(self, said: Fraction) -> Fraction:
        """Return width over height of a view's pixel: 2 where it was halved along x, ½ along y.

        Parameters
        ----------
        said : Fraction
            What the file says of the pixels of the whole picture: nothing but what being halved
            means where it is that (of full views, too, as some muxers write them), else more.
        """
        squeezed = Fraction(2) if self.is_horizontal else Fraction(1, 2)
        aspect = squeezed if self.value.startswith("half") else Fraction(1)
        return aspect if said == squeezed else aspect * said


@dataclass(frozen=True, kw_only=True)
class ImageFiles:
    """Image files, one a frame; or one file, and so one frame."""

    pattern: str
    """Path below the scene's folder, with one printf conversion (``%d``, ``%04d``) or none."""

    @property
    def is_still(self) -> bool:
        """True where there is one file only."""
        return CONVERSION.search(self.pattern.replace("%%", "")) is None

    def path_of(self, frame_index: int) -> str:
        """Return the path below the scene's folder for that source frame number."""
        if self.is_still:
            return self.pattern.replace("%%", "%")
        return self.pattern % frame_index


@dataclass(frozen=True, kw_only=True)
class VideoFile:
    """A video file; its frames in presentation order."""

    path: str
    """Path below the scene's folder."""


@dataclass(frozen=True, kw_only=True)
class PackedEye:
    """One half of the pictures of a stereo video file."""

    path: str
    """Path below the scene's folder."""
    layout: PackedLayout
    second: bool
    """False for the left or upper half, True for the right or lower one."""


@dataclass(frozen=True, kw_only=True)
class RawVideo:
    """Raw planar YUV, frame after frame."""

    path: str
    """Path below the scene's folder."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""
    pixel_format: str
    """FFmpeg's name, ``yuv420p10le`` say."""
    matrix: YcbcrMatrix | None = None
    """None: BT.709 from 720 lines up, BT.601 below."""
    range: Range | None = None
    """None: limited for colour, full for depth."""


Locator = ImageFiles | VideoFile | RawVideo | PackedEye
"""Where the pictures of one view lie."""


@dataclass(frozen=True, kw_only=True)
class DepthEncoding:
    """What the numbers of the depth maps mean: value = stored × scale + offset."""

    kind: DepthKind
    scale: float = 1.0
    offset: float = 0.0
    unknown: float | None = None
    """The stored value that means "no depth"; None: none does."""
    is_world_z: bool = False
    """True where the depth of every view runs along the *world's* z axis and not its camera's
    (MSR's 3D video); needs calibration. A manifest cannot say so."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewDescription:
    """Where one view's pictures lie."""

    view_id: str
    """Unique in the scene."""
    color: Locator
    depth: Locator | None = None
    """None: no depth was given."""
    calibration: Calibration | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class SceneDescription:
    """A scene on disk, views left to right.

    Where all views are calibrated, they are put in order by their centres along the mean
    x axis of the cameras, whatever order they were given in.

    Raises
    ------
    SceneError
        If there are fewer than two views, ids twice, or a stereo pair that is no pair or
        stands the wrong way round.
    """

    root: Path
    """Absolute path of the folder that all files lie in."""
    views: tuple[ViewDescription, ...]
    """Two or more, left to right."""
    depth: DepthEncoding | None = None
    """None only where no view has depth."""
    fps: Fraction | None = None
    """Frames a second; None: not said."""
    first_frame: int = 0
    """Source frame number of the first frame."""
    frame_count: int | None = None
    """None: as many as there are files."""
    left: str | None = None
    """``view_id`` of the left reference; None: view (N − 1) // 2."""
    right: str | None = None
    """``view_id`` of the right reference; None: the one after the left."""
    layout: str = "manifest"
    """What the scene was recognised as."""
    notes: tuple[str, ...] = ()
    """What was guessed, ignored or put right while reading, a sentence each."""
    source: Path | None = None
    """The manifest or file that said so, for messages."""
    beside: tuple[str, ...] = ()
    """Paths below the folder of what else was looked at: files of calibration."""

    def __post_init__(self) -> None:
        where = self.source or self.root
        if len(self.views) < 2:
            raise SceneError(
                f"views: two or more are needed, there is {len(self.views) or 'none'}", path=where
            )
        seen: set[str] = set()
        for view in self.views:
            if view.view_id in seen:
                raise SceneError("views: this id occurs twice", path=where, view=view.view_id)
            seen.add(view.view_id)
        if self.depth is None and any(view.depth is not None for view in self.views):
            raise SceneError(
                "depth: missing, but views have depth maps; say their kind", path=where
            )
        self._order_views()
        self._choose_pair(where)

    @property
    def view_ids(self) -> tuple[str, ...]:
        """Ids of the views, left to right."""
        return tuple(view.view_id for view in self.views)

    def view(self, view_id: str) -> ViewDescription:
        """Return the view of that id; raise KeyError where there is none."""
        for view in self.views:
            if view.view_id == view_id:
                return view
        raise KeyError(view_id)

    def files(self, frame_indices: range) -> Iterator[Path]:
        """Yield every file of these frames, and the manifest, whether it is there or not."""
        if self.source is not None:
            yield self.source
        for view in self.views:
            for locator in (view.color, view.depth):
                if isinstance(locator, ImageFiles):
                    numbers = frame_indices[:1] if locator.is_still else frame_indices
                    yield from (self.root / locator.path_of(number) for number in numbers)
                elif locator is not None:
                    yield self.root / locator.path

    def present_files(self) -> Iterator[Path]:
        """Yield the files that are there of all frames: what another place needs of the scene."""
        last = self.first_frame + (self.frame_count or 0)
        if self.frame_count is None:
            rows = [
                locator
                for view in self.views
                for locator in (view.color, view.depth)
                if isinstance(locator, ImageFiles) and not locator.is_still
            ]
            while any((self.root / row.path_of(last)).is_file() for row in rows):
                last += 1
        files = self.files(range(self.first_frame, max(last, self.first_frame + 1)))
        yield from (path for path in files if path.is_file())
        yield from (self.root / name for name in self.beside)

    def _order_views(self) -> None:
        cameras = [view.calibration for view in self.views if view.calibration is not None]
        if len(cameras) < len(self.views):
            return
        axis = np.mean([camera.world_to_camera[0, :3] for camera in cameras], axis=0)
        along = np.array([camera.centre @ axis for camera in cameras])
        spread = float(np.ptp(along))
        if not spread > 0:
            return
        order = np.argsort(np.round(along / spread, 6), kind="stable")
        if np.array_equal(order, np.arange(len(order))):
            return
        object.__setattr__(self, "views", tuple(self.views[index] for index in order))
        note = f"views are put left to right by their calibration: {', '.join(self.view_ids)}"
        object.__setattr__(self, "notes", (*self.notes, note))

    def _choose_pair(self, where: Path) -> None:
        ids = self.view_ids
        left = self.left if self.left is not None else ids[(len(ids) - 1) // 2]
        for role, view_id in (("left", left), ("right", self.right)):
            if view_id is not None and view_id not in ids:
                raise SceneError(
                    f"stereo: {role} is {view_id!r}, which is no view; there are {', '.join(ids)}",
                    path=where,
                )
        if self.right is None and ids.index(left) + 1 == len(ids):
            raise SceneError(f"stereo: no view stands right of the left one, {left!r}", path=where)
        right = self.right if self.right is not None else ids[ids.index(left) + 1]
        if ids.index(left) >= ids.index(right):
            raise SceneError(
                f"stereo: left {left!r} must stand left of right {right!r}; "
                f"left to right the views are {', '.join(ids)}",
                path=where,
            )
        object.__setattr__(self, "left", left)
        object.__setattr__(self, "right", right)


def confined(root: Path, relative: str) -> Path:
    """Return the file of that relative path, having seen that it lies inside the folder.

    Parameters
    ----------
    root : Path
        The scene's folder, absolute and with its own links resolved.
    relative : str
        Path below it; links are followed.

    Raises
    ------
    SceneError
        If the path is absolute, or leads out of the folder.
    """
    if os.path.isabs(relative):
        raise SceneError(f"must be relative to the scene's folder: {relative}")
    path = root / relative
    real = Path(os.path.realpath(path))
    if real != path and (not real.is_relative_to(root) or _climbs_out(relative)):
        raise SceneError(f"leads out of the scene's folder: {relative}")
    return path


def _climbs_out(relative: str) -> bool:
    """Tell whether a path stands above its start after any of its steps, as written."""
    level = 0
    for part in relative.split("/"):
        level += {"..": -1, ".": 0, "": 0}.get(part, 1)
        if level < 0:
            return True
    return False
