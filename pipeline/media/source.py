"""Where frames come from: one protocol, its in-memory twin, and the door to the disk."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from pipeline.errors import SceneError
from pipeline.frames import MultiViewFrame
from pipeline.media.info import SceneInfo
from pipeline.media.layouts import describe_path
from pipeline.media.scene_source import SceneSource


class FrameSource(Protocol):
    """A scene that is read frame by frame, in any order, from any one thread at a time or more.

    Frames are asked for by source frame number. Nothing but the last picture of a video file
    is kept between reads.
    """

    info: SceneInfo

    def read(
        self,
        frame_index: int,
        *,
        only: Collection[str] | None = None,
        depth: Collection[str] = (),
        colour: Collection[str] | None = None,
    ) -> MultiViewFrame:
        """Return all views at one instant.

        Parameters
        ----------
        frame_index : int
            Source frame number, one of ``info.frame_indices``.
        only : collection of view ids, optional
            Views whose pictures are wanted, and no others; default: all, with depth.
        depth : collection of view ids
            Those of them whose depth is wanted, too.
        colour : collection of view ids, optional
            Those whose chroma is wanted; default: all.

        Raises
        ------
        SceneError
            If there is no such frame, or it cannot be read; file, view and frame are named.
        """

    def approach(self, frame_index: int, *, depth: Collection[str] | None = None) -> bool:
        """Draw near to a frame, by little work, where not all of those before it were read.

        Asked of every frame, it comes to be there: a video that nobody has looked at for a while
        is taken up at its next key frame, or decoded two frames at a time.

        Parameters
        ----------
        depth : collection of view ids, optional
            To the depth maps of these views in place of all pictures.

        Returns
        -------
        bool
            Whether it can be read without anything before it being decoded first.

        Raises
        ------
        SceneError
            As of :meth:`read`.
        """

    def frames(self, start: int | None = None, stop: int | None = None) -> Iterator[MultiViewFrame]:
        """Yield frames ``start`` up to but without ``stop`` (source frame numbers), in order."""

    def reads(self, path: Path) -> bool:
        """Tell whether a file is one that the frames come from, by whatever name or link."""

    def close(self) -> None:
        """Let go of all files; may be called twice."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class MemorySource:
    """Frames that are already in memory: the twin for tests and rendered scenes.

    Parameters
    ----------
    frames : sequence of MultiViewFrame
        One or more, of consecutive frame numbers, views and shapes alike.
    fps : Fraction
        Frames a second.
    path : str
        What to call it in messages.
    depth_kind : str or None
        What the depth was before it became nearness, for reports.
    pixel_aspect : Fraction
        Width over height of a pixel.

    Raises
    ------
    SceneError
        If there is no frame, or frames are not alike.
    """

    def __init__(
        self,
        frames: Sequence[MultiViewFrame],
        *,
        fps: Fraction = Fraction(1),
        path: str = "memory",
        depth_kind: str | None = "disparity",
        pixel_aspect: Fraction = Fraction(1),
    ) -> None:
        if not frames:
            raise SceneError("no frames", path=path)
        first = frames[0]
        ids = tuple(view.view_id for view in first.views)
        for place, frame in enumerate(frames):
            if frame.frame_index != first.frame_index + place:
                raise SceneError("frame numbers must follow one another", path=path)
            if tuple(view.view_id for view in frame.views) != ids:
                raise SceneError("other views than before", path=path, frame=frame.frame_index)
            for view in frame.views:
                if view.luma.shape != first.lr_shape:
                    raise SceneError(
                        "of another size", path=path, view=view.view_id, frame=frame.frame_index
                    )
        self._frames = tuple(frames)
        has_depth = tuple(
            view.depth_map is not None and not view.depth_is_estimated for view in first.views
        )
        self.info = SceneInfo(
            path=path,
            layout="memory",
            view_ids=ids,
            all_view_ids=ids,
            lr_shape=first.lr_shape,
            frame_indices=range(first.frame_index, first.frame_index + len(frames)),
            fps=fps,
            left=first.left,
            right=first.right,
            bit_depth=first.bit_depth,
            is_color=first.views[0].chroma is not None,
            has_depth=has_depth,
            depth_kind=depth_kind if any(has_depth) else None,
            depth_is_metric=first.depth_is_metric,
            has_calibration=all(view.calibration is not None for view in first.views),
            pixel_aspect=pixel_aspect,
        )

    def read(
        self,
        frame_index: int,
        *,
        only: Collection[str] | None = None,
        depth: Collection[str] = (),
        colour: Collection[str] | None = None,
    ) -> MultiViewFrame:
        """Return all views at one instant; see :class:`FrameSource`."""
        indices = self.info.frame_indices
        if frame_index not in indices:
            raise SceneError(
                f"no such frame; there are {indices.start} to {indices.stop - 1}",
                path=self.info.path,
                frame=frame_index,
            )
        frame = self._frames[frame_index - indices.start]
        if colour is not None:
            frame = replace(
                frame,
                views=tuple(
                    view if view.view_id in colour else replace(view, chroma=None)
                    for view in frame.views
                ),
            )
        if only is None:
            return frame
        views = (view for view in frame.views if view.view_id in only)
        return replace(
            frame,
            views=tuple(
                view if view.view_id in depth else replace(view, depth_map=None) for view in views
            ),
        )

    def approach(self, frame_index: int, *, depth: Collection[str] | None = None) -> bool:
        """All frames are there."""
        return True

    def frames(self, start: int | None = None, stop: int | None = None) -> Iterator[MultiViewFrame]:
        """Yield frames ``start`` up to but without ``stop`` (source frame numbers), in order."""
        indices = self.info.frame_indices
        for frame_index in range(
            indices.start if start is None else start, indices.stop if stop is None else stop
        ):
            yield self.read(frame_index)

    def reads(self, path: Path) -> bool:
        """No file is read."""
        return False

    def close(self) -> None:
        """Nothing is kept open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open_scene(
    path: str | Path,
    *,
    input_layout: str | None = None,
    left: str | None = None,
    right: str | None = None,
    views: Sequence[str] | None = None,
) -> SceneSource:
    """Open a scene on disk.

    Parameters
    ----------
    path : str or Path
        A folder with a manifest, the manifest, a folder of a known layout (MSR 3D video,
        Middlebury stereo), or a side-by-side or top-bottom video file.
    input_layout : str or None
        For a video file that does not say how its views are packed: ``sbs``, ``half-sbs``,
        ``tab`` or ``half-tab``. Takes precedence over what the file says.
    left, right : str or None
        Ids of the references in place of the scene's.
    views : sequence of str or None
        Ids of the views to read, one or more; None: all. The references stay the scene's, and
        need not be among them.

    Returns
    -------
    SceneSource
        Open; a context manager that closes it.

    Raises
    ------
    SceneError
        If the scene cannot be read; the message names file, view and frame.
    ConfigurationError
        If an option names a view that is not there, or a layout for a scene that is none.
    """
    description = describe_path(Path(path), input_layout)
    return SceneSource(description, left=left, right=right, views=views)
