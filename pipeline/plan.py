"""What a job writes, now that the scene has said what it is; and whether it can be written."""

from __future__ import annotations

from dataclasses import replace

from pipeline.errors import ConfigurationError, OutputError
from pipeline.job import InputOptions, Job, OutputOptions
from pipeline.media.files import check_folder_writable, check_writable
from pipeline.media.info import SceneInfo
from pipeline.sink import OutputPlan
from pipeline.view_at import place_of


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
    return OutputPlan(
        options=replace(job.output, layout=layout),
        targets=targets,
        left=info.left,
        right=info.right,
        hr_shape=grid.hr_shape(info.lr_shape),
        fps=info.fps,
        bit_depth=info.bit_depth,
        is_color=info.is_color,
        grid=grid,
        between=place,
        is_realtime=job.settings.realtime,
    )


def with_magnification(job: Job, info: SceneInfo) -> Job:
    """Return the job with the magnification that halved eyes need, if none was asked for."""
    if not job.magnification_is_default or info.pixel_aspect == 1:
        return job
    magnification = "2x1" if info.pixel_aspect > 1 else "1x2"
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
        missing = " nor ".join(f"{eyes[eye]!r} ({eye})" for eye in wanted)
        neither = "neither " if len(wanted) > 1 else "not "
        raise ConfigurationError(
            f"--views: {neither}{missing} is among them, so there is no eye to write"
        )
    layout = output.layout if len(there) == 2 else there[0]
    return tuple(eyes[eye] for eye in there), layout


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
