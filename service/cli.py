"""The ``depthsr`` command: its subcommands, their options, their exit status.

====  ==========================================
0     done
1     failure
2     bad input or usage
130   interrupted (Ctrl-C, SIGTERM)
====  ==========================================

Results go to stdout, everything else to stderr. Heavy packages are imported by
the subcommand that needs them, so that ``--help`` answers at once.
"""

from __future__ import annotations

import argparse
import atexit
import gc
import io
import os
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from pipeline.numba_cache import prepare_numba_cache
from service.cli_dscqs import add_dscqs
from service.cli_evaluate import add_evaluate
from service.cli_serve import add_serve
from service.cli_streams import add_streams
from service.console import EXIT_DONE, EXIT_FAILURE, EXIT_USAGE, one_line, report_error
from service.terminal import add_talk, say, watching

if TYPE_CHECKING:
    from pipeline.segments import Engine
    from pipeline.stop import StopFlag

DESCRIPTION = "Super-resolve multi-view 3D video into a stereo pair, guided by depth."


class Parser(argparse.ArgumentParser):
    """Says what is wrong with the usage in one line; knows options by their full name only."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **{"allow_abbrev": False, **options})

    def error(self, message: str) -> NoReturn:
        """Leave with status 2 and one line on stderr."""
        self.exit(EXIT_USAGE, f"depthsr: error: {one_line(message)} (see {self.prog} --help)\n")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status."""
    prepare_numba_cache()
    atexit.register(gc.freeze)  # a search for garbage at the very end would take most of a second
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a terminal may know no ×
    verbose = False
    try:
        arguments = make_parser().parse_args(argv)
        verbose = getattr(arguments, "verbose", False)
        status = int(arguments.command(arguments) or EXIT_DONE)
        sys.stdout.flush()
        return status
    except SystemExit as end:  # --help, --version and errors of usage
        return end.code if isinstance(end.code, int) else EXIT_DONE
    except BrokenPipeError:
        # Whoever read our results has gone; let the interpreter's last flush go nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_FAILURE
    except (Exception, KeyboardInterrupt) as error:
        return report_error(error, verbose=verbose)


def make_parser() -> Parser:
    """Return the parser of the whole command line."""
    parser = Parser(prog="depthsr", description=DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"depthsr {_version()}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    _add_run(commands)
    _add_probe(commands)
    _add_psf(commands)
    add_evaluate(commands)
    _add_demo(commands)
    _add_compile(commands)
    add_serve(commands)
    add_streams(commands)
    add_dscqs(commands)
    version = commands.add_parser("version", help="print the versions of everything that matters")
    version.set_defaults(command=_run_version)
    return parser


def _add_run(commands: Any) -> None:
    from pipeline.config import Settings
    from pipeline.job import InputOptions, OutputOptions
    from service.options import ALIASES, METHOD_WORDS, add_options

    parser = commands.add_parser(
        "run",
        help="super-resolve a scene and write a stereo video or pictures",
        description="Super-resolve a scene and write a stereo video, pictures, or both.",
    )
    parser.add_argument(
        "scene",
        type=Path,
        metavar="SCENE",
        help="a scene.json, a folder with one or with pictures, a stereo video, or a video of one "
        "eye with the other's beside it (clip_left.mov, clip_right.mov)",
    )
    add_options(parser.add_argument_group("input"), InputOptions)
    output = parser.add_argument_group("output")
    add_options(output, OutputOptions, aliases={"output": ("-o",), **ALIASES})
    output.add_argument(
        "--resume",
        action="store_true",
        help="go on from what an interrupted run of the same job has finished",
    )
    add_options(parser.add_argument_group("method", METHOD_WORDS), Settings)
    parser.add_argument_group("where").add_argument(
        "--cluster",
        metavar="ADDRESS",
        help="scheduler of Dask distributed whose workers compute the segments "
        "(default: this machine alone)",
    )
    add_talk(parser)
    parser.set_defaults(command=_run_run)


def _add_probe(commands: Any) -> None:
    from pipeline.job import InputOptions
    from service.options import add_options

    parser = commands.add_parser(
        "probe",
        help="print what is understood of a scene, and what is not",
        description="Print what is understood of a scene: views, sizes, frames, depth, "
        "calibration, the stereo pair; and what is not.",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE", help="as for run")
    add_options(parser, InputOptions, leave_out=("frames",))
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    add_talk(parser)
    parser.set_defaults(command=_run_probe)


def _add_psf(commands: Any) -> None:
    from pipeline.config import Settings
    from pipeline.job import InputOptions
    from service.options import add_options

    parser = commands.add_parser(
        "psf",
        help="estimate the point spread function of a scene",
        description="Estimate the point spread function (PSF) of a scene from one frame, the "
        "first of the range, and print the curve it was read from.",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE", help="as for run")
    parser.add_argument(
        "-o",
        "--output",
        dest="picture",
        type=Path,
        metavar="FILE",
        help="picture of the curve to write (PNG)",
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write the curve to")
    add_options(parser, InputOptions)
    add_options(
        parser, Settings,
        leave_out=(
            "psf", "psf_sigma", "solver", "sweeps", "residual_bound", "residual_threshold",
            "filters", "chroma", "temporal", "temporal_window", "realtime", "rate",
        ),
    )  # fmt: skip
    add_talk(parser)
    parser.set_defaults(command=_run_psf)


def _add_demo(commands: Any) -> None:
    parser = commands.add_parser(
        "demo",
        help="render a small scene, super-resolve it, show what it brings",
        description="Render a small moving scene with eight cameras, super-resolve it, and write "
        "a side-by-side video and a picture of before and after.",
    )
    parser.add_argument(
        "-o", "--output", type=Path, default=Path("demo"), metavar="FOLDER",
        help="folder to write to (default: demo)",
    )  # fmt: skip
    parser.add_argument(
        "--threads", type=int, default=0, metavar="N",
        help="threads of the hot loops (0: one a core) [threads] (default: 0)",
    )  # fmt: skip
    add_talk(parser)
    parser.set_defaults(command=_run_demo)


def _add_compile(commands: Any) -> None:
    parser = commands.add_parser(
        "compile",
        help="compile the numeric kernels ahead, for a read-only installation",
        description="Compile the numeric kernels into the cache folder (DEPTHSR_CACHE, or the "
        "user's cache folder), so that no later run has to.",
    )
    add_talk(parser)
    parser.set_defaults(command=_run_compile)


def _run_run(arguments: argparse.Namespace) -> int:
    from pipeline.config import Settings
    from pipeline.job import InputOptions, Job, OutputOptions
    from service.options import collect

    given = collect(arguments, Settings)
    job = Job(
        scene=arguments.scene,
        settings=Settings(**given),
        magnification_is_default="magnification" not in given,
        input=InputOptions(**collect(arguments, InputOptions)),
        output=OutputOptions(**collect(arguments, OutputOptions)),
    )
    with watching(arguments) as (stop, progress):
        from pipeline.run import run_job

        with _engine(arguments.cluster, stop) as engine:
            summary = run_job(
                job, on_event=progress, stop=stop, resume=arguments.resume, engine=engine
            )
    if not arguments.quiet:
        from service.progress import duration

        where = ", ".join(str(path) for path in summary.written)
        frames = "1 frame" if summary.frames == 1 else f"{summary.frames} frames"
        say(f"wrote {where}: {frames} in {duration(summary.seconds)}")
        for remark in summary.report["remarks"]:
            say(f"  {remark}")
    return EXIT_DONE


def _engine(cluster: str | None, stop: StopFlag) -> AbstractContextManager[Engine | None]:
    """Return what computes the segments: the workers of a cluster, or None for this process."""
    if cluster is None:
        return nullcontext()
    from pipeline.cluster import ClusterEngine

    with stop.breakable():
        return ClusterEngine(cluster)


def _run_probe(arguments: argparse.Namespace) -> int:
    from pipeline.job import InputOptions
    from pipeline.media.probe import describe, format_description
    from pipeline.media.source import open_scene
    from pipeline.report import strict_json
    from service.options import collect

    options = InputOptions(**collect(arguments, InputOptions))
    with open_scene(
        arguments.scene,
        input_layout=options.input_layout,
        left=options.left,
        right=options.right,
        views=options.views,
    ) as source:
        description = describe(source)
    say(strict_json(description) if arguments.json else format_description(description))
    return EXIT_DONE


def _run_psf(arguments: argparse.Namespace) -> int:
    from pipeline import drawing
    from pipeline.config import Settings
    from pipeline.job import InputOptions
    from pipeline.media.files import check_writable, write_atomic
    from pipeline.media.source import open_scene
    from pipeline.plan import check_scene_kept
    from pipeline.psf_curve import format_psf, psf_picture
    from pipeline.psf_search import search_psf
    from pipeline.report import strict_json, versions
    from pipeline.threads import set_threads
    from service.options import collect

    options = InputOptions(**collect(arguments, InputOptions))
    settings = Settings(psf="auto", **collect(arguments, Settings))
    set_threads(settings.threads)
    picture, table = getattr(arguments, "picture", None), arguments.json
    for path in (picture, table):
        if path is not None:
            check_writable(path)
    with (
        open_scene(
            arguments.scene,
            input_layout=options.input_layout,
            left=options.left,
            right=options.right,
            views=options.views,
        ) as source,
        watching(arguments) as (stop, progress),
        stop.breakable(),
    ):
        check_scene_kept(source, (picture, table))
        frame = source.read(options.frames.within(source.info.frame_indices).start)
        progress.note(f"frame {frame.frame_index}: scanning")
        curves = search_psf(frame, settings)
    if picture is not None:
        drawing.save(picture, psf_picture(curves))
    if table is not None:
        content = {"format": "depthsr-psf/1", "versions": versions(), "curves": curves}
        write_atomic(table, strict_json(content).encode())
    say(format_psf(curves))
    return EXIT_DONE


def _run_demo(arguments: argparse.Namespace) -> int:
    from pipeline.config import Settings
    from service.progress import duration

    Settings(threads=arguments.threads)  # in range?
    with watching(arguments) as (stop, progress):
        from pipeline.demo import format_demo, run_demo

        result = run_demo(
            arguments.output,
            threads=arguments.threads,
            on_event=progress,
            on_note=progress.note,
            stop=stop,
        )
    say(format_demo(result))
    say(f"wrote {result.video}, {result.picture} and {result.set1} in {duration(result.seconds)}")
    say(f"the scene is in {result.scene}: try depthsr run {result.scene} -o out.mkv")
    return EXIT_DONE


def _run_compile(arguments: argparse.Namespace) -> int:
    from pipeline.compile_ahead import compile_kernels
    from pipeline.threads import set_threads

    set_threads(0)
    with watching(arguments) as (stop, progress), stop.breakable():
        compile_kernels(progress.note)
    say(f"compiled into {os.environ['NUMBA_CACHE_DIR']}")
    return EXIT_DONE


def _run_version(arguments: argparse.Namespace) -> int:
    from pipeline.report import versions

    for name, version in versions().items():
        say(f"{name} {version}")
    return EXIT_DONE


def _version() -> str:
    try:
        return metadata.version("depthsr")
    except metadata.PackageNotFoundError:
        return "unknown (not installed)"
