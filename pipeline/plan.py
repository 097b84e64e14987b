"""What a job writes, now that the scene has said what it is; and whether it can be written."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

from pipeline.config import Settings
from pipeline.errors import ConfigurationError, OutputError
from pipeline.grid import Grid
from pipeline.job import InputOptions, Job, OutputOptions
from pipeline.media.eye_files import LAYOUT as EYE_FILES
from pipeline.media.files import check_folder_writable, check_writable
from pipeline.media.info import SceneInfo, Sound
from pipeline.media.join import takes_sound
from pipeline.media.png import png_path
from pipeline.media.sound import sound_codec
from pipeline.media.source import FrameSource
from pipeline.media.timecode import later
from pipeline.media.video_format import container_of, lost_of_hdr, video_paths
from pipeline.reconstruction.psf import GaussianPsf
from pipeline.sink import OutputPlan
from pipeline.stereo import StereoLayout
from pipeline.view_at import place_of

SQUEEZED = Fraction(3, 2)
"""From pixels of this shape on, or its inverse, a view counts as halved: the pixels of anamorphic
video, 64:45 or 4:3 say, are nearer to squares than what 2x1 would make of them."""


def make_plan(job: Job, info: SceneInfo) -> OutputPlan:
    """Return what is written, now that the scene has said what it is."""
    place = None
    if job.output.view_at is None:
        targets, layout = choose_targets(info, job.input, job.output)
    else:
        place = place_of(job.output.view_at, info, job.input.views)
        targets, layout = (f"view-{job.output.view_at:g}",), "left"
        if job.settings.realtime:
            raise ConfigurationError("--realtime: makes the two eyes; leave --view-at out")
    grid = job.settings.grid
    hr_shape = grid.hr_shape(info.lr_shape)
    _check_psf(job.settings, hr_shape)
    _check_folders(job, info, layout)
    sound, warnings = _sound(job, info)
    if info.colorimetry.is_hdr:
        warnings += lost_of_hdr(job.output.output, job.output.codec, layout)
    return OutputPlan(
        options=replace(job.output, layout=layout),
        targets=targets,
        left=info.left,
        right=info.right,
        hr_shape=hr_shape,
        fps=info.fps,
        bit_depth=info.bit_depth,
        is_color=info.is_color,
        grid=grid,
        pixel_aspect=_pixel_aspect(info, grid),
        between=place,
        is_realtime=job.settings.realtime,
        colorimetry=info.colorimetry,
        timecode=_timecode(job, info),
        sound=sound,
        warnings=warnings,
    )


def _timecode(job: Job, info: SceneInfo) -> str | None:
    """Return the time code of the first frame that is written, if the scene has any."""
    if info.timecode is None:
        return None
    frames = job.input.frames.within(info.frame_indices)
    return later(info.timecode, frames.start - info.frame_indices.start, info.fps)


def _sound(job: Job, info: SceneInfo) -> tuple[Sound | None, tuple[str, ...]]:
    """Return the sound of the frames that are written, and what is to be said of it."""
    if info.sound is None or job.output.sound == "none":
        return None, ()
    first, frames = info.frame_indices.start, job.input.frames.within(info.frame_indices)
    sound = Sound(
        path=info.sound,
        begin=(frames.start - first) / info.fps,
        end=(frames.stop - first) / info.fps,
    )
    if job.output.output is None:
        return sound, ()
    container = container_of(job.output.output)
    if takes_sound(container, info.sound):
        return sound, ()
    codec = sound_codec(info.sound)
    return sound, (f"{job.output.output}: a .{container} file takes no {codec} sound: it has none",)


def _check_folders(job: Job, info: SceneInfo, layout: str) -> None:
    """Refuse eyes in a folder whose own eyes are known by their names alone."""
    if info.layout != EYE_FILES or not job.scene.is_dir():
        return
    output = job.output.output
    for folder in (
        job.output.frames_dir,
        output.parent if output is not None and layout == StereoLayout.VIEWS else None,
    ):
        if folder is not None and folder.is_dir() and job.scene.samefile(folder):
            raise OutputError(
                f"{folder}: is the scene, whose eyes could not be told from what is written"
            )


def _pixel_aspect(info: SceneInfo, grid: Grid) -> Fraction:
    """Return width over height of a pixel of the targets.

    Where the scene knows of no squeezed pixels, 2x1 and 1x2 are taken to make square ones.
    """
    if info.pixel_aspect == 1:
        return Fraction(1)
    return info.pixel_aspect * grid.magnification_y / grid.magnification_x


def with_magnification(job: Job, info: SceneInfo) -> Job:
    """Return the job with the magnification that halved eyes need, if none was asked for."""
    aspect = info.pixel_aspect
    if not job.magnification_is_default or max(aspect, 1 / aspect) < SQUEEZED:
        return job
    magnification = "2x1" if aspect > 1 else "1x2"
    return replace(
        job,
        settings=replace(job.settings, magnification=magnification),
        magnification_is_default=False,
    )


def choose_targets(
    info: SceneInfo, options: InputOptions, output: OutputOptions
) -> tuple[tuple[str, ...], str]:
    """Return the views to super-resolve, left to right, and the layout they are written in.

    An eye whose own view is not observed is not written; the video is then that of one eye.
    """
    observed = set(options.views or info.view_ids)
    if output.layout == "views":
        return tuple(view for view in info.view_ids if view in observed), "views"
    eyes = {"left": info.left, "right": info.right}
    wanted = (output.layout,) if output.layout in eyes else ("left", "right")
    there = tuple(eye for eye in wanted if eyes[eye] in observed)
    if not there:
        missing = [f"{eyes[eye]!r} ({eye})" for eye in wanted]
        said = f"neither {' nor '.join(missing)} is" if len(missing) > 1 else f"{missing[0]} is not"
        raise ConfigurationError(f"--views: {said} among them, so there is no eye to write")
    layout = output.layout if len(there) == 2 else there[0]
    return tuple(eyes[eye] for eye in there), layout


def check_scene_kept(source: FrameSource, files: Iterable[Path | None]) -> None:
    """See to it that no file of the scene is written over.

    Raises
    ------
    OutputError
        If a file to be written has the place of one that is read.
    """
    for path in files:
        if path is not None and path.is_file() and source.reads(path):
            raise OutputError(f"{path}: would overwrite the scene")


def files_of(plan: OutputPlan, frames: range) -> Iterator[Path]:
    """Yield every file that is there in the end, without debug pictures."""
    options = plan.options
    if options.report is not None:
        yield options.report
    if options.output is not None:
        yield from video_paths(options.output, StereoLayout(options.layout), plan.targets).values()
    if options.frames_dir is not None:
        for name in plan.picture_names.values():
            yield from (png_path(options.frames_dir, name, number) for number in frames)


def _check_psf(settings: Settings, hr_shape: tuple[int, int]) -> None:
    """Refuse a PSF that was asked for and reaches across the whole picture.

    A side of one LR pixel does not count: every PSF is wider.
    """
    sigma, support = settings.psf_sigma, settings.psf_support
    if support is None and sigma is not None:
        support = GaussianPsf.of(sigma).support
    sides = [
        side
        for side, one in zip(hr_shape, settings.grid.hr_shape((1, 1)), strict=True)
        if side > one
    ]
    if support is not None and any(support // 2 >= side for side in sides):
        height, width = hr_shape
        raise ConfigurationError(
            f"{'--psf-sigma' if settings.psf_support is None else '--psf-support'}: a PSF of "
            f"{support} HR pixels is too wide for an image of {width}×{height}"
        )


def check_outputs(job: Job) -> None:
    """Find out before the work whether the outputs can be written; make the folders asked for.

    Raises
    ------
    OutputError
        If a file or folder cannot be written, or would overwrite the scene.
    """
    output = job.output
    files = [path for path in (output.output, output.report) if path is not None]
    for path in files:
        if path.is_file() and job.scene.exists() and path.samefile(job.scene):
            raise OutputError(f"{path}: would overwrite the scene")
        check_writable(path)
    if len({path.absolute() for path in files}) < len(files):
        raise OutputError(f"{output.output}: is named for the video and for the report")
    for folder in (output.frames_dir, output.debug_dir):
        if folder is not None:
            check_folder_writable(folder)
