"""``depthsr evaluate``: Set 1, the bars, and the whole report."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from service.console import EXIT_DONE, EXIT_FAILURE
from service.terminal import add_talk, say, watching

if TYPE_CHECKING:  # a command that is not called loads nothing
    from pipeline.config import Settings
    from pipeline.degradation import Degradation
    from pipeline.evaluate import Set1Result


def add_evaluate(commands: Any) -> None:
    """Add the command and its protocols."""
    evaluate = commands.add_parser("evaluate", help="measure quality where the truth is known")
    protocols = evaluate.add_subparsers(title="protocols", metavar="PROTOCOL", required=True)
    _add_set1(protocols)
    _add_all(protocols)
    _add_bars(protocols)


def _add_set1(protocols: Any) -> None:
    from pipeline.config import MAGNIFICATIONS, Settings
    from pipeline.job import FrameRange
    from service.options import METHOD_WORDS, add_options

    parser = protocols.add_parser(
        "set1",
        help="degrade a real scene, super-resolve it, compare with the original",
        description="Set 1: degrade a real scene with a known PSF and noise, super-resolve it "
        "with every method, and compare the luma with the original.",
    )
    parser.add_argument("scene", type=Path, metavar="SCENE", help="as for run")
    parser.add_argument(
        "--magnification", choices=MAGNIFICATIONS, default="2",
        help="K of the degradation, or K along x then y [times] (default: 2)",
    )  # fmt: skip
    parser.add_argument(
        "--psf-sigma", type=float, default=1.7, metavar="N",
        help="σ of the Gaussian PSF [HR pixels] (default: 1.7)",
    )  # fmt: skip
    parser.add_argument(
        "--psf-support", type=int, default=7, metavar="N",
        help="width of the PSF, odd [HR pixels] (default: 7)",
    )  # fmt: skip
    parser.add_argument(
        "--noise", type=float, default=0.0, metavar="N",
        help="standard deviation of the noise added [grey levels] (default: 0)",
    )  # fmt: skip
    parser.add_argument(
        "--seed", type=int, default=1, metavar="N", help="seed of the noise (default: 1)"
    )
    parser.add_argument(
        "--frame", type=int, metavar="N", help="source frame number (default: the scene's first)"
    )
    parser.add_argument(
        "--frames", type=FrameRange.parse, metavar="A:B",
        help="half-open range of source frames, measured one after another, in place of --frame",
    )  # fmt: skip
    parser.add_argument(
        "--view", default="left", metavar="VIEW",
        help="reference view: left, right, both, or a view id (default: left)",
    )  # fmt: skip
    parser.add_argument(
        "--methods", type=lambda text: tuple(text.split(",")), metavar="NAME,...",
        help="methods to run (default: bicubic, lanczos, single-view, pocs, pocs-simplified, "
        "default)",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write as well")
    add_options(
        parser.add_argument_group("method", METHOD_WORDS), Settings,
        leave_out=("magnification", "sampling", "psf", "psf_sigma", "psf_support", "psf_per_layer"),
    )  # fmt: skip
    add_talk(parser)
    parser.set_defaults(command=_run_set1)


def _add_all(protocols: Any) -> None:
    from pipeline.evaluation.plan import CHAPTERS, Plan

    parser = protocols.add_parser(
        "all",
        help="measure everything on some scenes, and write a report",
        description="Measure everything on the scenes, each table and figure of the thesis among "
        "it, and write a report that stands alone (index.html), its text as Markdown, its numbers "
        "as JSON and CSV.",
    )
    parser.add_argument(
        "scenes", nargs="+", metavar="SCENE",
        help="a scene as for run, or the word sample: the scene that depthsr renders itself",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="folder of the report"
    )
    parser.add_argument(
        "--page", type=Path, metavar="FILE",
        help="Markdown page to write as well, its figures in images/ beside it: to be published, "
        "without pictures of the scenes but those of the rendered one",
    )  # fmt: skip
    parser.add_argument(
        "--psf-sigmas", type=_numbers, default=Plan.psf_sigmas, metavar="N,...",
        help="σ of the PSFs of the degradation [HR pixels] (default: 1,1.7)",
    )  # fmt: skip
    parser.add_argument(
        "--noises", type=_numbers, default=Plan.noises, metavar="N,...",
        help="noises added [grey levels] (default: 0,2)",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", type=int, default=Plan.num_seeds, metavar="N",
        help=f"seeds of the noise, for intervals (default: {Plan.num_seeds})",
    )  # fmt: skip
    parser.add_argument(
        "--chapters", type=lambda text: tuple(text.split(",")), default=CHAPTERS,
        metavar="NAME,...", help=f"chapters to measure (default: all: {', '.join(CHAPTERS)})",
    )  # fmt: skip
    parser.add_argument(
        "--threads", type=int, default=0, metavar="N",
        help="threads of the hot loops (0: one a core) [threads] (default: 0)",
    )  # fmt: skip
    add_talk(parser)
    parser.set_defaults(command=_run_all)


def _add_bars(protocols: Any) -> None:
    parser = protocols.add_parser(
        "bars",
        help="hold the project's own bars of quality",
        description="Measure the bars of quality on the real scenes and on the rendered one, and "
        "say which are met. Exit status 1 where one is not.",
    )
    parser.add_argument(
        "folder", nargs="?", type=Path, metavar="SCENES",
        help="folder of the real scenes (default: DEPTHSR_SCENES)",
    )  # fmt: skip
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write as well")
    parser.add_argument(
        "--threads", type=int, default=0, metavar="N",
        help="threads of the hot loops (0: one a core) [threads] (default: 0)",
    )  # fmt: skip
    add_talk(parser)
    parser.set_defaults(command=_run_bars)


def _numbers(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not a list of numbers like 1,1.7") from None


def _run_set1(arguments: argparse.Namespace) -> int:
    from pipeline.config import Settings
    from pipeline.degradation import Degradation
    from pipeline.evaluate import format_frames, format_table, settings_of
    from pipeline.media.files import check_writable, write_atomic
    from pipeline.report import strict_json, versions
    from pipeline.threads import set_threads
    from service.options import collect

    along_x, _, along_y = arguments.magnification.partition("x")
    degradation = Degradation(
        magnification_x=int(along_x),
        magnification_y=int(along_y or along_x),
        psf_sigma=arguments.psf_sigma,
        psf_support=arguments.psf_support,
        noise_sigma=arguments.noise,
        seed=arguments.seed,
    )
    given = collect(arguments, Settings)
    for fixed in ("magnification", "psf_sigma", "psf_support"):
        given.pop(fixed, None)
    settings = Settings(**given)
    set_threads(settings.threads)
    if arguments.json is not None:
        check_writable(arguments.json)
    results = _measured(arguments, degradation, settings)
    if arguments.json is not None:
        content = {
            "format": "depthsr-set1/1",
            "versions": versions(),
            "settings": settings_of(degradation, settings),
            **(
                results[0].as_json()
                if arguments.frames is None
                else {"frames": [result.as_json() for result in results]}
            ),
        }
        write_atomic(arguments.json, strict_json(content).encode())
    for result in results:
        say(format_table(result))
    if len(results) > 1:
        say(format_frames(results))
    return EXIT_DONE


def _measured(
    arguments: argparse.Namespace, degradation: Degradation, settings: Settings
) -> list[Set1Result]:
    """Return what Set 1 makes of each frame that is asked for."""
    from pipeline.evaluate import METHODS, evaluate_set1
    from pipeline.media.source import open_scene
    from pipeline.plan import check_scene_kept

    results = []
    with open_scene(arguments.scene) as source, watching(arguments) as (stop, progress):
        check_scene_kept(source, (arguments.json,))
        info, window = source.info, settings.temporal_window
        views = {"left": (info.left,), "right": (info.right,), "both": (info.left, info.right)}
        numbers = _frame_numbers(arguments, info.frame_indices)
        with stop.breakable():
            for number in numbers:
                around = range(number - window, number + window + 1)
                results.append(
                    evaluate_set1(
                        source.read(number),
                        degradation,
                        scene=arguments.scene.resolve().name,
                        views=views.get(arguments.view, (arguments.view,)),
                        methods=arguments.methods or METHODS,
                        settings=settings,
                        neighbours=tuple(
                            source.read(other)
                            for other in around
                            if other != number and other in info.frame_indices
                        ),
                        on_method=lambda view_id, method: progress.note(f"{view_id}: {method}"),
                    )
                )
    return results


def _frame_numbers(arguments: argparse.Namespace, available: range) -> range:
    """Return the source frames that are asked for; by default the first."""
    from pipeline.errors import ConfigurationError

    if arguments.frames is not None:
        if arguments.frame is not None:
            raise ConfigurationError("--frame, --frames: give one of them")
        return arguments.frames.within(available)
    number = available.start if arguments.frame is None else arguments.frame
    if number not in available:
        raise ConfigurationError(
            f"--frame: {number} is not within the scene's frames {available.start}:{available.stop}"
        )
    return range(number, number + 1)


def _run_all(arguments: argparse.Namespace) -> int:
    from pipeline.config import Settings
    from pipeline.errors import ConfigurationError
    from pipeline.evaluation.plan import CHAPTERS, Plan
    from pipeline.evaluation.report import (
        PAGE_PICTURES,
        Origin,
        evaluate_all,
        write_page,
        write_report,
    )
    from pipeline.evaluation.subjects import open_subject
    from pipeline.machine import described
    from pipeline.media.files import check_folder_writable, check_writable
    from pipeline.threads import set_threads

    for chapter in arguments.chapters:
        if chapter not in CHAPTERS:
            raise ConfigurationError(f"--chapters: {chapter!r} is not one of {', '.join(CHAPTERS)}")
    plan = Plan(
        psf_sigmas=arguments.psf_sigmas,
        noises=arguments.noises,
        num_seeds=arguments.seeds,
        chapters=arguments.chapters,
        peers_folder=arguments.output / "peers",
    )
    settings = Settings(threads=arguments.threads)
    set_threads(settings.threads)
    check_folder_writable(arguments.output)
    if arguments.page is not None:
        check_writable(arguments.page)
    with watching(arguments) as (stop, progress), stop.breakable():
        subjects = [(name, open_subject(name, settings)) for name in arguments.scenes]
        chapters = evaluate_all(subjects, plan, note=progress.note)
    origin = Origin(
        command=shlex.join(["depthsr", *sys.argv[1:]]),
        scenes=tuple(subject.name for _, subject in subjects),
        machine=described(),
        cpu_seconds=time.process_time(),
    )
    written = write_report(arguments.output, chapters, origin)
    num_tables = sum(path.suffix == ".csv" for path in written)
    for chapter in chapters:
        say(f"{chapter.title}")
        for sentence in chapter.answer:
            say(f"  {sentence}")
    say(f"wrote {', '.join(map(str, written[:3]))} and {num_tables} CSV files")
    if arguments.page is not None:
        page, *figures = write_page(arguments.page, chapters, origin)
        say(f"wrote {page}; figures in {PAGE_PICTURES}/ beside it: {len(figures)}")
    return EXIT_DONE


def _run_bars(arguments: argparse.Namespace) -> int:
    from pipeline.config import Settings
    from pipeline.errors import ConfigurationError
    from pipeline.evaluation.bars import bars_record, measure_bars
    from pipeline.evaluation.floors import verdict_table
    from pipeline.media.files import check_writable, write_atomic
    from pipeline.report import strict_json
    from pipeline.threads import set_threads

    named = os.environ.get("DEPTHSR_SCENES", "")
    folder = arguments.folder or (Path(named) if named else None)
    if folder is None:
        raise ConfigurationError("no real scenes: name their folder, or set DEPTHSR_SCENES to it")
    if arguments.json is not None:
        check_writable(arguments.json)
    settings = Settings(threads=arguments.threads)
    set_threads(settings.threads)
    with watching(arguments) as (stop, progress), stop.breakable():
        verdicts = measure_bars(folder, settings, note=progress.note)
    if arguments.json is not None:
        write_atomic(arguments.json, strict_json(bars_record(verdicts)).encode())
    say(verdict_table(verdicts).as_text())
    return EXIT_DONE if all(verdict.met for verdict in verdicts) else EXIT_FAILURE
