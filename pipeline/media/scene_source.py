"""A scene on disk as a source of frames."""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from types import TracebackType

import numpy as np

from pipeline.colour import CHROMA_CENTRE, Picture
from pipeline.errors import ConfigurationError, SceneError
from pipeline.frames import DepthMap, MultiViewFrame, View
from pipeline.media.colorimetry import Colorimetry
from pipeline.media.depth_estimation import estimate_missing_depth
from pipeline.media.depth_maps import camera_nearness, nearness_from_stored, resampled
from pipeline.media.eye_files import LAYOUT as EYE_FILES
from pipeline.media.info import SceneInfo
from pipeline.media.readers import OpenVideos, PictureReader, open_reader
from pipeline.media.scene import (
    DepthKind,
    ImageFiles,
    PackedEye,
    SceneDescription,
    VideoFile,
    ViewDescription,
    confined,
)
from pipeline.media.sound import sound_codec

UNTOLD_FPS = Fraction(25)
"""Rate of a scene of several frames that does not tell its own, frames a second."""


@dataclass(frozen=True, kw_only=True)
class _OpenView:
    description: ViewDescription
    color: PictureReader
    depth: PictureReader | None


class SceneSource:
    """A scene on disk: all files are seen to exist when it is opened, pictures are read as asked.

    Parameters
    ----------
    description : SceneDescription
        What lies where.
    left, right : str or None
        Ids of the references in place of the scene's.
    views : sequence of str or None
        Ids of the views to read; None: all. The references need not be among them.

    Raises
    ------
    SceneError
        If files are missing, views have unequal numbers of frames, or unequal sizes.
    ConfigurationError
        If ``left``, ``right`` or ``views`` name views that are not there, or the pair stands
        the wrong way round.
    """

    def __init__(
        self,
        description: SceneDescription,
        *,
        left: str | None = None,
        right: str | None = None,
        views: Sequence[str] | None = None,
    ) -> None:
        description = with_pair(description, left, right)
        chosen = _chosen(description, views)
        self._description = description
        self._lock = threading.Lock()
        self._videos = OpenVideos()
        try:
            self._views = tuple(self._open_view(view) for view in chosen)
            count = self._frame_count()
            self.info = self._describe(count)
        except BaseException:
            self.close()
            raise

    def _open_view(self, view: ViewDescription) -> _OpenView:
        readers: list[PictureReader | None] = []
        for locator in (view.color, view.depth):
            if locator is None:
                readers.append(None)
                continue
            try:
                readers.append(
                    open_reader(
                        self._description.root,
                        locator,
                        first_frame=self._description.first_frame,
                        frame_count=self._description.frame_count,
                        videos=self._videos,
                    )
                )
            except SceneError as error:
                raise SceneError(
                    str(error), view=view.view_id, frame=self._description.first_frame
                ) from error
        color, depth = readers
        assert color is not None
        return _OpenView(description=view, color=color, depth=depth)

    def _frame_count(self) -> int:
        first = self._description.first_frame
        readers = [
            (view.description.view_id, reader)
            for view in self._views
            for reader in (view.color, view.depth)
            if reader is not None
        ]
        wanted = self._description.frame_count
        if wanted is None and self._description.layout == EYE_FILES:
            return min(reader.num_frames for _, reader in readers)
        longest = max(reader.num_frames for _, reader in readers)
        for view_id, reader in readers:
            have = reader.num_frames
            if have >= (wanted if wanted is not None else longest):
                continue
            said = (
                f"frame_count is {wanted}"
                if wanted is not None
                else f"others of the scene go on to frame {first + longest - 1}"
            )
            frame = first + have
            raise SceneError(f"{reader.missing(frame)}; {said}", view=view_id, frame=frame)
        return wanted if wanted is not None else longest

    def _describe(self, count: int) -> SceneInfo:
        description = self._description
        notes = list(description.notes)
        forms = [view.color.form for view in self._views]
        for view, form in zip(self._views, forms, strict=True):
            if (form.width, form.height) != (forms[0].width, forms[0].height):
                raise SceneError(
                    f"{form.width}×{form.height} pixels, but view "
                    f"{self._views[0].description.view_id!r} has {forms[0].width}×"
                    f"{forms[0].height}; all views must be of one size",
                    path=_path_text(view.description.color, description.first_frame),
                    view=view.description.view_id,
                    frame=description.first_frame,
                )
        lengths = {view.description.view_id: view.color.num_frames for view in self._views}
        if description.layout == EYE_FILES and max(lengths.values()) > count:
            told = ", ".join(f"{view_id} {length}" for view_id, length in lengths.items())
            notes.append(f"frames: {told}; the first {count}, which both eyes have, are read")
        has_depth = tuple(view.depth is not None for view in self._views)
        calibrated = [view.description.calibration is not None for view in self._views]
        if any(calibrated) and not all(calibrated):
            missing = [
                view.description.view_id
                for view, has in zip(self._views, calibrated, strict=True)
                if not has
            ]
            notes.append(f"no calibration in: {', '.join(missing)}; the others' is not used")
        lacking = [
            view.description.view_id
            for view, has in zip(self._views, has_depth, strict=True)
            if not has
        ]
        if lacking and len(self._views) > 1:
            notes.append(f"no depth in: {', '.join(lacking)}; it is estimated from the neighbours")
        if len({form.is_color for form in forms}) > 1:
            notes.append("some views are grey and some in colour; grey ones get neutral colour")
        if any(view.color.repeats_line for view in self._views):
            notes.append("an odd number of lines for two eyes; the last one is repeated")
        given = description.depth if any(has_depth) else None
        packed = self._views[0].description.color
        layout = packed.layout if isinstance(packed, PackedEye) else None
        assert description.left is not None
        assert description.right is not None
        fps = self._rate(count, notes)
        uneven = [view.description.view_id for view in self._views if view.color.has_uneven_times]
        if uneven:
            notes.append(
                f"frames are shown for unequal times in: {', '.join(uneven)}; views are paired by "
                f"the number of the frame, and the result shows {fps} a second"
            )
        interlaced = [view.description.view_id for view in self._views if view.color.is_interlaced]
        if interlaced:
            notes.append(
                f"interlaced: {', '.join(interlaced)}; fields of two instants are taken for one "
                "picture: deinterlace before (ffmpeg -vf bwdif)"
            )
        layered = [view.description.view_id for view in self._views if view.color.holds_layers]
        if layered:
            notes.append(
                f"two views in layers of HEVC (MV-HEVC): {', '.join(layered)}; the base layer's is "
                "read"
            )
        return SceneInfo(
            path=str(description.source or description.root),
            layout=description.layout,
            view_ids=tuple(view.description.view_id for view in self._views),
            all_view_ids=description.view_ids,
            lr_shape=(forms[0].height, forms[0].width),
            frame_indices=range(description.first_frame, description.first_frame + count),
            fps=fps,
            left=description.left,
            right=description.right,
            bit_depth=max(form.bit_depth for form in forms),
            is_color=any(form.is_color for form in forms),
            has_depth=has_depth,
            depth_kind=given.kind.value if given is not None else None,
            depth_is_metric=all(calibrated)
            and (given is None or given.kind is not DepthKind.DISPARITY),
            has_calibration=all(calibrated),
            pixel_aspect=self._pixel_aspect(notes),
            input_layout=layout.value if layout is not None else None,
            colorimetry=self._colorimetry(notes),
            timecode=self._timecode(fps, notes),
            sound=self._sound(fps, notes),
            warnings=tuple(notes),
        )

    def _pixel_aspect(self, notes: list[str]) -> Fraction:
        """Return the shape of the left eye's pixels, or of the first view's."""
        told = {view.description.view_id: view.color.form.pixel_aspect for view in self._views}
        chosen = told.get(self._description.left or "", next(iter(told.values())))
        others = [view_id for view_id, said in told.items() if said != chosen]
        if others:
            notes.append(
                f"pixels of another shape in: {', '.join(others)}; all are taken to be {chosen} "
                "times as wide as high"
            )
        return chosen

    def _colorimetry(self, notes: list[str]) -> Colorimetry:
        """Return what is said of the left eye, or of the first view where that is not read."""
        told = {view.description.view_id: view.color.form.colorimetry for view in self._views}
        chosen = told.get(self._description.left or "", next(iter(told.values())))
        others = [view_id for view_id, said in told.items() if said.names != chosen.names]
        if others:
            notes.append(
                f"other primaries or another transfer in: {', '.join(others)}; the result is said "
                f"to be {' '.join(chosen.names)}"
            )
        return chosen

    def _timecode(self, fps: Fraction, notes: list[str]) -> str | None:
        """Return the time code of the first frame, if the rate is that of the files."""
        left = self._description.left
        views = sorted(self._views, key=lambda view: view.description.view_id != left)
        told = {
            view.description.view_id: view.color.timecode
            for view in views
            if view.color.timecode is not None and view.color.fps == fps
        }
        if len(set(told.values())) > 1:
            said = ", ".join(f"{view_id} {code}" for view_id, code in told.items())
            notes.append(f"time codes differ: {said}; views are paired by the number of the frame")
        return next(iter(told.values()), None)

    def _sound(self, fps: Fraction, notes: list[str]) -> Path | None:
        """Return the first video of a view that has sound, that of the left eye before others."""
        left = self._description.left
        for view in sorted(self._views, key=lambda view: view.description.view_id != left):
            place = view.description.color
            if not isinstance(place, VideoFile | PackedEye):
                continue
            path = confined(self._description.root, place.path)
            if sound_codec(path) is None:
                continue
            if view.color.fps in (None, fps):
                return path
            notes.append(
                f"{path}: the sound is not taken over, since {fps} frames are shown a second "
                f"in place of {view.color.fps}"
            )
        return None

    def _rate(self, count: int, notes: list[str]) -> Fraction:
        if self._description.fps is not None:
            return self._description.fps
        told = [view.color.fps for view in self._views if view.color.fps]
        if told:
            if len(set(told)) > 1:
                notes.append(f"videos differ in frame rate; {told[0]} a second is used")
            return told[0]
        if count == 1:
            return Fraction(1)
        notes.append(f"fps is not said; {UNTOLD_FPS} frames a second are assumed")
        return UNTOLD_FPS

    def read(
        self,
        frame_index: int,
        *,
        only: Collection[str] | None = None,
        depth: Collection[str] = (),
        colour: Collection[str] | None = None,
    ) -> MultiViewFrame:
        """Return all views at one instant; see :class:`pipeline.media.source.FrameSource`."""
        info = self.info
        if frame_index not in info.frame_indices:
            indices = info.frame_indices
            raise SceneError(
                f"no such frame; there are {indices.start} to {indices.stop - 1}",
                path=info.path,
                frame=frame_index,
            )
        with self._lock:
            if only is None:
                views = [self._read_view(view, frame_index, colour) for view in self._views]
            else:
                views = self._read_some(frame_index, only, depth, colour)
        if only is None:
            views = estimate_missing_depth(views, depth_is_metric=info.depth_is_metric)
        return MultiViewFrame(
            frame_index=frame_index,
            views=tuple(views),
            left=info.left,
            right=info.right,
            bit_depth=info.bit_depth,
            depth_is_metric=info.depth_is_metric,
        )

    def approach(self, frame_index: int, *, depth: Collection[str] | None = None) -> bool:
        """Draw near to a frame; see :class:`pipeline.media.source.FrameSource`."""
        with self._lock:
            return all(
                [
                    _approached(view, frame_index, depth=depth is not None)
                    for view in self._views
                    if depth is None or view.description.view_id in depth
                ]
            )

    def frames(self, start: int | None = None, stop: int | None = None) -> Iterator[MultiViewFrame]:
        """Yield frames ``start`` up to but without ``stop`` (source frame numbers), in order."""
        indices = self.info.frame_indices
        for frame_index in range(
            indices.start if start is None else start, indices.stop if stop is None else stop
        ):
            yield self.read(frame_index)

    def reads(self, path: Path) -> bool:
        """Tell whether a file is one of the scene's, by whatever name or link."""
        return _identity(path) in self._identities

    @cached_property
    def _identities(self) -> frozenset[tuple[int, int]]:
        files = self._description.files(self.info.frame_indices)
        return frozenset(known for known in map(_identity, files) if known is not None)

    def _read_some(
        self,
        frame_index: int,
        only: Collection[str],
        depth: Collection[str],
        colour: Collection[str] | None,
    ) -> list[View]:
        """Return these views, some of them with depth."""
        return [
            self._read_view(
                view if view.description.view_id in depth else replace(view, depth=None),
                frame_index,
                colour,
            )
            for view in self._views
            if view.description.view_id in only
        ]

    def _read_view(self, view: _OpenView, frame_index: int, colour: Collection[str] | None) -> View:
        view_id = view.description.view_id
        # what colour there should not be is found by reading it
        with_chroma = colour is None or view_id in colour or not self.info.is_color
        try:
            picture = view.color.picture(frame_index, with_chroma=with_chroma)
            if picture.luma.shape != self.info.lr_shape:
                height, width = self.info.lr_shape
                raise SceneError(
                    f"{picture.luma.shape[1]}×{picture.luma.shape[0]} pixels, but the scene has "
                    f"{width}×{height}",
                    path=_path_text(view.description.color, frame_index),
                )
            if with_chroma:
                picture = self._with_colour(picture, view, frame_index)
            depth_map = self._read_depth(view, frame_index)
        except SceneError as error:
            raise SceneError(str(error), view=view_id, frame=frame_index) from error
        return View(
            view_id=view_id,
            luma=picture.luma,
            chroma=picture.chroma if with_chroma else None,
            depth_map=depth_map,
            calibration=view.description.calibration,
        )

    def _with_colour(self, picture: Picture, view: _OpenView, frame_index: int) -> Picture:
        if (picture.chroma is not None) == self.info.is_color:
            return picture
        if picture.chroma is not None:
            raise SceneError(
                "in colour, but the scene began in grey",
                path=_path_text(view.description.color, frame_index),
            )
        neutral = np.full((*picture.luma.shape, 2), CHROMA_CENTRE, np.float32)
        return replace(picture, chroma=neutral)

    def _read_depth(self, view: _OpenView, frame_index: int) -> DepthMap | None:
        """Return the nearness map on the colour grid; None where nothing is known."""
        encoding = self._description.depth
        if view.depth is None or encoding is None:
            return None
        stored = view.depth.samples(frame_index)
        nearness = resampled(nearness_from_stored(stored, encoding), self.info.lr_shape)
        calibration = view.description.calibration
        if encoding.is_world_z and calibration is not None:
            nearness = camera_nearness(nearness, calibration)
        return nearness if np.isfinite(nearness).any() else None

    def close(self) -> None:
        """Let go of all files; may be called twice."""
        for view in getattr(self, "_views", ()):
            for reader in (view.color, view.depth):
                if reader is not None:
                    reader.close()
        self._videos.close()

    def __enter__(self) -> SceneSource:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _approached(view: _OpenView, frame_index: int, *, depth: bool) -> bool:
    reader = view.depth if depth else view.color
    try:
        return reader is None or reader.approach(frame_index)
    except SceneError as error:
        raise SceneError(str(error), view=view.description.view_id, frame=frame_index) from error


def _identity(path: Path) -> tuple[int, int] | None:
    """Return what tells a file from all others, links followed; None where there is none."""
    try:
        found = path.stat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _path_text(locator: object, frame_index: int) -> str:
    if isinstance(locator, ImageFiles):
        return locator.path_of(frame_index)
    return str(getattr(locator, "path", locator))


def with_pair(
    description: SceneDescription, left: str | None, right: str | None
) -> SceneDescription:
    """Return the description with the references asked for."""
    ids = description.view_ids
    for option, view_id in (("--left", left), ("--right", right)):
        if view_id is not None and view_id not in ids:
            raise ConfigurationError(f"{option}: no view {view_id!r}; there are {', '.join(ids)}")
    if left is None and right is None:
        return description
    assert description.left is not None
    assert description.right is not None
    chosen_left = left if left is not None else description.left
    chosen_right = right if right is not None else description.right
    if ids.index(chosen_left) >= ids.index(chosen_right):
        if right is None and ids.index(chosen_left) + 1 < len(ids):
            chosen_right = ids[ids.index(chosen_left) + 1]
        elif left is None and ids.index(chosen_right) > 0:
            chosen_left = ids[ids.index(chosen_right) - 1]
        else:
            option = "--left" if left is not None else "--right"
            raise ConfigurationError(
                f"{option}: left {chosen_left!r} must stand left of right {chosen_right!r}; "
                f"left to right the views are {', '.join(ids)}"
            )
    return replace(description, left=chosen_left, right=chosen_right)


def _chosen(
    description: SceneDescription, views: Sequence[str] | None
) -> tuple[ViewDescription, ...]:
    if views is None:
        return description.views
    if not views:
        raise ConfigurationError("--views: name one view or more")
    for view_id in views:
        if view_id not in description.view_ids:
            raise ConfigurationError(
                f"--views: no view {view_id!r}; there are {', '.join(description.view_ids)}"
            )
        if list(views).count(view_id) > 1:
            raise ConfigurationError(f"--views: {view_id!r} occurs twice")
    return tuple(view for view in description.views if view.view_id in set(views))
