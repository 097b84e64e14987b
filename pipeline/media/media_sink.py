"""Super-resolved frames as files: video segments, lossless PNG, and the joined video."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from pipeline.colour import to_grey, to_rgb
from pipeline.fan_out import fan_out
from pipeline.job import Segment
from pipeline.media.encode import CodedEyes, Eyes, check_size, write_segment
from pipeline.media.files import check_writable, remove_leftovers
from pipeline.media.join import join_segments, takes_sound
from pipeline.media.png import png_path, write_png
from pipeline.media.video_format import VideoCodec, VideoFormat, video_paths
from pipeline.media.ycbcr import matrix_for
from pipeline.results import FrameResult, SuperResolvedImage
from pipeline.sink import OutputPlan
from pipeline.stereo import Picture, StereoLayout

Pictures = dict[str, Picture]
"""The pictures of one frame by view id."""

FileEyes = Mapping[str, Eyes | CodedEyes]
"""The eyes of one frame by the id of the file that they go into."""

UNCHANGED = (StereoLayout.SBS, StereoLayout.TAB, StereoLayout.LEFT, StereoLayout.RIGHT)
"""Layouts that take the pixels of an eye as they are."""


class MediaSink:
    """Writes what the plan asks for: see :class:`pipeline.sink.Sink`.

    Parameters
    ----------
    plan : OutputPlan
        What to write and where.
    clock : callable
        Seconds, for the account of the stages.

    Raises
    ------
    ConfigurationError
        If the video file cannot hold what is asked for, or a view id cannot be a file name.
    """

    def __init__(self, plan: OutputPlan, clock: Callable[[], float] = time.perf_counter) -> None:
        self.plan = plan
        self._clock = clock
        options = plan.options
        self._layout = StereoLayout(options.layout)
        self._format = None
        self._sound = None
        if options.output is not None:
            self._format = VideoFormat.for_path(
                options.output,
                layout=self._layout,
                fps=plan.fps,
                codec=None if options.codec is None else VideoCodec(options.codec),
                crf=options.quality,
                pixel_aspect=plan.pixel_aspect,
                colorimetry=plan.colorimetry,
                is_quick=plan.is_realtime,
            )
            eyes = 1 if self._layout is StereoLayout.VIEWS else len(plan.targets)
            check_size(options.output, self._format, plan.hr_shape, eyes)
            if plan.sound is not None and takes_sound(self._format.container, plan.sound.path):
                self._sound = plan.sound
        if options.frames_dir is not None:
            for name in plan.picture_names.values():
                png_path(options.frames_dir, name, 0)  # can it be a file name?

    def prepare(self) -> None:
        """Find out whether everything can be written, and clear away what killed runs left."""
        for path in self._outputs().values():
            check_writable(path)
            remove_leftovers(path)
        self._remove_half_pictures()

    def write_segment(
        self, segment: Segment, stem: Path, results: Iterable[FrameResult]
    ) -> dict[str, float]:
        """Write the frames of a segment; return the seconds by stage."""
        timings = {"pack": 0.0, "png": 0.0, "encode": 0.0}
        if self._is_coded:
            coded = ({"": eyes} for eyes in self._coded(results, timings))
            self._write_files(segment, stem, coded, timings)
            return timings
        pictures = self._pictures(results, timings)
        if self._format is None:
            for _ in pictures:
                pass
        elif self._layout is StereoLayout.VIEWS:
            by_view = (
                {view_id: (picture,) for view_id, picture in item.items()} for item in pictures
            )
            self._write_files(segment, stem, by_view, timings)
        else:
            self._write_files(segment, stem, ({"": self._eyes(item)} for item in pictures), timings)
        return timings

    def files_of(self, segment: Segment, stem: Path) -> Sequence[Path]:
        """Return the files that :meth:`write_segment` leaves."""
        files = [] if self._format is None else list(self._segment_files(stem).values())
        folder = self.plan.options.frames_dir
        if folder is not None:
            files += [
                png_path(folder, name, frame_index)
                for frame_index in range(segment.start, segment.stop)
                for name in self.plan.picture_names.values()
            ]
        return files

    def join(self, stems: Sequence[Path]) -> Sequence[Path]:
        """Put the segments together; return all files and folders written."""
        written = []
        for view_id, output in self._outputs().items():
            assert self._format is not None
            segments = [self._segment_files(stem)[view_id] for stem in stems]
            join_segments(
                segments, output, self._format, self._sound, timecode=self.plan.timecode
            )  # fmt: skip
            written.append(output)
        if self.plan.options.frames_dir is not None:
            self._remove_half_pictures()  # of a worker that was killed, whose segment another made
            written.append(self.plan.options.frames_dir)
        return written

    def _remove_half_pictures(self) -> None:
        folder = self.plan.options.frames_dir
        if folder is not None:
            for name in self.plan.picture_names.values():
                for leftover in folder.glob(f".{_literal(name)}-[0-9]*.png.*.tmp"):
                    leftover.unlink(missing_ok=True)

    def _outputs(self) -> dict[str, Path]:
        """Return the final video files by view id; one file of all views has the id ''."""
        output = self.plan.options.output
        return {} if output is None else video_paths(output, self._layout, self.plan.targets)

    def _segment_files(self, stem: Path) -> dict[str, Path]:
        """Return a segment's video files by view id, as :meth:`_outputs`."""
        return video_paths(_with_suffix(stem), self._layout, self.plan.targets)

    def _pictures(
        self, results: Iterable[FrameResult], timings: dict[str, float]
    ) -> Iterator[Pictures]:
        """Yield the frames as integers, writing PNG on the way and keeping the time."""
        folder = self.plan.options.frames_dir
        shown: Mapping[str, SuperResolvedImage] = {}
        pictures: Pictures = {}
        for result in results:
            begin = self._clock()
            # an image that is shown again is the same object
            pictures = {
                view_id: pictures[view_id]
                if shown.get(view_id) is result.images[view_id]
                else self._picture(result.images[view_id])
                for view_id in self.plan.targets
            }
            shown = result.images
            packed = self._clock()
            if folder is not None:
                for view_id, name in self.plan.picture_names.items():
                    path = png_path(folder, name, result.frame_index)
                    write_png(path, pictures[view_id], self.plan.colorimetry)
            written = self._clock()
            timings["pack"] += packed - begin
            timings["png"] += written - packed
            yield pictures

    @property
    def _is_coded(self) -> bool:
        """Whether nothing but a video is made of the pictures, at the pace of a live stream."""
        plan = self.plan
        return (
            plan.is_realtime
            and plan.is_color
            and plan.bit_depth == 8
            and plan.options.frames_dir is None
            and self._format is not None
            and not self._format.lossless
            and self._format.coded_bits(8) == 8
            and self._layout in UNCHANGED
        )

    def _coded(
        self, results: Iterable[FrameResult], timings: dict[str, float]
    ) -> Iterator[CodedEyes]:
        """Yield the frames as planes of the video, both eyes in one, and keep the time."""
        # numba, which a service need not load
        from pipeline.media.coded import chroma_to_code, coded_together

        targets = self.plan.targets
        eyes = targets if len(targets) == 1 else (self.plan.left, self.plan.right)
        is_on_top = self._layout is StereoLayout.TAB
        shown: Mapping[str, SuperResolvedImage] = {}
        planes = None
        for result in results:
            begin = self._clock()
            # an image that is shown again is the same object
            if planes is None or any(
                shown.get(view_id) is not result.images[view_id] for view_id in eyes
            ):
                images = [result.images[view_id] for view_id in eyes]
                height = images[0].luma.shape[0]
                height += height % 2  # as it is coded
                matrix = matrix_for(
                    (2 if is_on_top else 1) * height, self.plan.colorimetry.primaries
                )
                planes = coded_together(
                    [(image.luma, chroma_to_code(image)) for image in images], matrix,
                    side_by_side=not is_on_top,
                )  # fmt: skip
            shown = result.images
            timings["pack"] += self._clock() - begin
            yield (planes,)

    def _picture(self, image: SuperResolvedImage) -> Picture:
        if image.chroma is None:
            return to_grey(image.luma, self.plan.bit_depth)
        return to_rgb(image.luma, image.chroma, self.plan.bit_depth)

    def _eyes(self, pictures: Pictures) -> Eyes:
        if len(self.plan.targets) == 1:
            return (pictures[self.plan.targets[0]],)
        return pictures[self.plan.left], pictures[self.plan.right]

    def _write_files(
        self,
        segment: Segment,
        stem: Path,
        frames: Iterable[FileEyes],
        timings: dict[str, float],
    ) -> None:
        """Encode while the caller's thread packs: every file has a thread, and waits for no other.

        Parameters
        ----------
        frames : iterable
            The eyes of each frame by the id of the file, as of :meth:`_segment_files`.
        """
        assert self._format is not None
        video_format = self._format
        seconds: list[float] = []

        def writer(name: str, path: Path) -> Callable[[Iterator[FileEyes]], None]:
            def write(items: Iterator[FileEyes]) -> None:
                waited = 0.0

                def eyes() -> Iterator[Eyes | CodedEyes]:
                    nonlocal waited
                    while True:
                        begin = self._clock()
                        item = next(items, None)
                        waited += self._clock() - begin
                        if item is None:
                            return
                        yield item[name]

                begin = self._clock()
                try:
                    write_segment(path, video_format, eyes(), first_frame=segment.start)
                finally:
                    seconds.append(self._clock() - begin - waited)

            return write

        files = self._segment_files(stem)
        try:
            fan_out(
                frames,
                {name: writer(name, path) for name, path in files.items()},
                give_way_to_others=self.plan.is_realtime,
            )
        finally:
            timings["encode"] += sum(seconds)


def _with_suffix(stem: Path) -> Path:
    return stem.with_name(f"{stem.name}.mkv")


def _literal(name: str) -> str:
    """Return the name as a pattern of ``glob`` that means itself."""
    return "".join(f"[{mark}]" if mark in "[]*?" else mark for mark in name)
