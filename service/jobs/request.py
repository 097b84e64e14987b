"""What a client asks for: the fields of ``depthsr run``, made into models for HTTP and back.

The models are made from the same dataclasses as the options of the command line, so that
both know the same settings. Paths to write are not the client's to choose.
"""

from __future__ import annotations

import dataclasses
import re
import types
import typing
import unicodedata
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, create_model

from pipeline.config import Settings
from pipeline.job import FrameRange, InputOptions, Job, OutputOptions
from pipeline.media.video_format import VideoCodec, VideoFormat
from pipeline.stereo import StereoLayout
from service.jobs.paths import NO_EXPORTS, NOT_OF_EXPORTS, OURS
from service.options import NOTHING

CONTAINERS = ("mkv", "mp4", "webm", "mov")
OURS_OF_OUTPUT = ("container", "video", "frames", "master")
"""Fields of the output that stand for those of :class:`pipeline.job.OutputOptions` left out."""

_LAYOUT_WORDS = re.compile(
    r"(?:[-_. ]+(?:3d|half|h|[fh]?sbs|[fh]?tab|lr|rl|h?ou|tb)(?![a-z0-9]))+", re.IGNORECASE
)
_TELLING_WORD = re.compile(r"3d|sbs|tab", re.IGNORECASE)

MAX_NAME = 200
"""Longest name of an uploaded file, characters."""

MAX_STEM = 120
"""Longest name of a job's files, bytes of UTF-8: file systems take 255 with all that is added."""


def fields_model(
    name: str,
    kind: type,
    *,
    leave_out: tuple[str, ...] = (),
    without: Mapping[str, tuple[str, ...]] = NOTHING,
    **more: Any,
) -> Any:
    """Return a pydantic model of the fields of a settings dataclass.

    Parameters
    ----------
    leave_out, without
        As for :func:`service.options.add_options`.
    """
    hints = typing.get_type_hints(kind)
    fields: dict[str, Any] = {}
    for item in dataclasses.fields(kind):
        if item.name in leave_out:
            continue
        unit = item.metadata["unit"]
        info = {
            "description": item.metadata["help"] + (f" [{unit}]" if unit else ""),
            **({"json_schema_extra": {"x-unit": unit}} if unit else {}),
        }
        hint, default = hints[item.name], item.default
        if item.metadata["choices"]:
            left_out = without.get(item.name, ())
            literal: Any = Literal[
                tuple(one for one in item.metadata["choices"] if one not in left_out)
            ]
            hint = literal | None if default is None else literal
        elif hint is FrameRange:
            hint, default = str, ":"
            info |= {"pattern": r"^\s*\d{0,9}\s*:\s*\d{0,9}\s*$", "examples": ["4:8"]}
        elif float in (typing.get_args(hint) or (hint,)):
            number = Annotated[float, Field(allow_inf_nan=False)]
            hint = number | None if isinstance(hint, types.UnionType) else number
        fields[item.name] = (hint, Field(default, **info))
    config = ConfigDict(extra="forbid")
    return create_model(name, __config__=config, __doc__=kind.__doc__, **fields, **more)


SettingsModel = fields_model("Settings", Settings)
InputModel = fields_model("Input", InputOptions)
OutputModel = fields_model(
    "Output",
    OutputOptions,
    leave_out=OURS,
    container=(Literal[CONTAINERS], Field("mkv", description="container of the video")),
    video=(bool, Field(True, description="write a video")),
    frames=(bool, Field(False, description="write lossless PNG of every frame")),
    master=(bool, Field(True, description="keep a lossless video that exports are made from")),
)


ExportForm = fields_model(
    "ExportForm",
    OutputOptions,
    leave_out=NOT_OF_EXPORTS,
    without=NO_EXPORTS,
    container=(Literal[CONTAINERS], Field("mkv", description="container of the video")),
    video=(bool, Field(True, description="write a video")),
    frames=(bool, Field(False, description="write lossless PNG of every frame")),
)


class JobRequest(BaseModel):
    """A job: a scene, how to read it, the settings, what to write."""

    model_config = ConfigDict(
        extra="forbid",
        json_schema_extra={
            "examples": [
                {
                    "scene": "/srv/scenes/teapot",
                    "settings": {"magnification": "2"},
                    "input": {"frames": "0:8"},
                    "output": {"container": "mkv", "layout": "sbs"},
                }
            ]
        },
    )

    scene: str | None = Field(
        None,
        max_length=4096,
        description="path under an allowed root; of uploaded files: the one among them to open",
    )
    name: str | None = Field(
        None,
        min_length=1,
        max_length=MAX_NAME,
        description="what the job and its files are called; as the scene unless it is said",
    )
    uploads: dict[str, str] | None = Field(
        None, description="finished uploads, by the relative name each file is to have"
    )
    settings: SettingsModel = Field(default_factory=SettingsModel)  # type: ignore[valid-type]
    input: InputModel = Field(default_factory=InputModel)  # type: ignore[valid-type]
    output: OutputModel = Field(default_factory=OutputModel)  # type: ignore[valid-type]
    exports: list[ExportForm] = Field(  # type: ignore[valid-type]
        default=[], max_length=8, description="further forms of the result, from the master"
    )
    priority: int = Field(0, ge=-10, le=10, description="larger is earlier")


def make_job(
    request: JobRequest, scene: Path, results: Path, *, name: str = "result", threads: int = 0
) -> Job:
    """Return the pipeline's job.

    Raises
    ------
    ConfigurationError
        If a value is out of range or contradicts another.
    """
    parts: Any = request  # the type checker cannot know models made at run time
    given = parts.settings.model_dump(exclude_unset=True)
    if threads:
        given["threads"] = threads
    read = parts.input.model_dump(exclude_unset=True)
    if "frames" in read:
        read["frames"] = FrameRange.parse(read["frames"])
    if read.get("views") is not None:
        read["views"] = tuple(read["views"])
    wanted = parts.output.model_dump()
    container, video, frames, _ = (wanted.pop(key) for key in OURS_OF_OUTPUT)
    file = results / file_name(name, wanted["layout"], container)
    return Job(
        scene=scene,
        settings=Settings(**given),
        magnification_is_default="magnification" not in given,
        input=InputOptions(**read),
        output=OutputOptions(
            **wanted,
            output=file if video else None,
            frames_dir=results / "frames" if frames else None,
            report=results / "report.json",
        ),
    )


def export_options(form: Any, results: Path, name: str) -> OutputOptions:
    """Return what an export writes; a form is an ``ExportForm``.

    Raises
    ------
    ConfigurationError
        If a value is out of range or contradicts another.
    """
    wanted = form.model_dump()
    container, video, frames = (wanted.pop(key) for key in ("container", "video", "frames"))
    file = results / file_name(name, wanted["layout"], container)
    options = OutputOptions(
        **wanted,
        output=file if video else None,
        frames_dir=results / "frames" if frames else None,
    )
    if video:
        VideoFormat.for_path(
            file,
            layout=StereoLayout(options.layout),
            fps=Fraction(1),
            codec=None if options.codec is None else VideoCodec(options.codec),
            crf=options.quality,
        )
    return options


def file_name(name: str, layout: str, container: str) -> str:
    """Return the name of a video, by which players recognise the layout.

    >>> file_name("clip", "half-sbs", "mp4")
    'clip_3D_HSBS_LR.mp4'
    """
    return f"{name}{layout_token(layout)}.{container}"


def without_layout(name: str) -> str:
    """Return a name without what players recognise a layout by: they would believe the first.

    >>> without_layout("clip_3D_SBS_LR"), without_layout("a.hsbs.final"), without_layout("a_LR")
    ('clip', 'a.final', 'a_LR')
    """
    return _LAYOUT_WORDS.sub(lambda words: "" if _TELLING_WORD.search(words[0]) else words[0], name)


def layout_token(layout: str) -> str:
    """Return the end of a file name that players recognise the layout by.

    >>> layout_token("half-sbs")
    '_3D_HSBS_LR'
    """
    tokens = {"sbs": "_3D_SBS_LR", "half-sbs": "_3D_HSBS_LR", "tab": "_3D_TAB"}
    return (tokens | {"half-tab": "_3D_HTAB"}).get(layout, f"_{layout}")


def plain_name(name: str) -> str:
    """Return a name in letters, digits and hyphens, of any script, that every file system takes.

    >>> plain_name("Łódź 2"), plain_name("café/clip.mov"), plain_name("休日")
    ('Łódź-2', 'café-clip-mov', '休日')
    """
    kept = ""
    for letter in unicodedata.normalize("NFKC", name):
        # of Thai or Hindi, say, vowels are marks
        is_mark = unicodedata.category(letter) in ("Mn", "Mc") and kept[-1:] not in ("", "-")
        kept += letter if letter.isalnum() or letter in "-_" or is_mark else "-"
    return kept.encode()[:MAX_STEM].decode(errors="ignore").strip("-")


def safe_name(name: str) -> str | None:
    """Return the relative name of an uploaded file; None where it is not one.

    >>> safe_name("cam0/color-0000.png"), safe_name("../up"), safe_name("/etc/passwd")
    ('cam0/color-0000.png', None, None)
    """
    parts = PurePosixPath(name).parts
    bad = not parts or len(name) > MAX_NAME or "\\" in name or ":" in name or name.startswith("/")
    if bad or re.search(r"[\x00-\x1f\x7f]", name) or len(parts) > 4:
        return None
    if any(part in (".", "..") or part.startswith(".") or len(part) > 120 for part in parts):
        return None
    return "/".join(parts)
