"""``depthsr dscqs stimuli|plan|create|invite``: from results to sessions."""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

from pipeline.config import Settings
from service.console import EXIT_DONE, EXIT_FAILURE
from service.options import add_options
from service.terminal import add_server, say, token_of

GRID_OPTIONS = ("magnification", "sampling")
"""Settings that say where the pixels of a result lie."""


def add_tests(subcommands: Any) -> None:
    """Add the subcommands to ``dscqs``."""
    _add_stimuli(subcommands)
    _add_plan(subcommands)
    _add_create(subcommands)
    _add_invite(subcommands)
    _add_verify(subcommands)


def add_verbose(parser: argparse.ArgumentParser) -> None:
    """Add the option that shows tracebacks."""
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="tracebacks of unexpected failures"
    )


def read_export(path: Path) -> Any:
    """Return the JSON export of a test.

    Raises
    ------
    VotesError
        If the file is no JSON.
    """
    from dscqs.errors import VotesError

    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise VotesError(f"cannot be read: {error}", path=path) from None


def _add_stimuli(subcommands: Any) -> None:
    parser = subcommands.add_parser(
        "stimuli",
        help="make PNG stills or lossless WebM clips of lossless results",
        description="Make the stimuli of a test of lossless results: PNG stills, or VP9 clips "
        "without any loss. Each is decoded again and compared.",
    )
    parser.add_argument(
        "sources", nargs="+", type=_source, metavar="CONTENT/CONDITION=SOURCE",
        help="a folder of left-*.png and right-*.png (run --frames-dir), lossless video "
        "(--codec ffv1), a side-by-side PNG, job:ID, or bicubic:SCENE (what was observed, "
        "enlarged)",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FOLDER", help="where they go"
    )
    _add_making(parser)
    parser.set_defaults(command=_run_stimuli)


def _add_making(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--kind", choices=("still", "video"), default="still",
        help="PNG stills, or lossless WebM clips (default: still)",
    )  # fmt: skip
    parser.add_argument(
        "--frame", type=int, default=0, metavar="N",
        help="frame of a still, from 0 within its source (default: 0)",
    )  # fmt: skip
    parser.add_argument(
        "--fps", type=Fraction, metavar="N", help="frames a second of clips made of pictures"
    )
    add_options(
        parser.add_argument_group("bicubic:SCENE, as its results were made"), Settings,
        leave_out=[
            item.name for item in dataclasses.fields(Settings) if item.name not in GRID_OPTIONS
        ],
    )  # fmt: skip
    add_server(parser, "bearer token, for job:ID")
    add_verbose(parser)


def _add_plan(subcommands: Any) -> None:
    from dscqs.plan import DIMENSIONS, Plan
    from dscqs.templates import TEMPLATES

    parser = subcommands.add_parser(
        "plan",
        help="write the plan of a test over a folder of stimuli",
        description="Write the plan of a test over a folder of stimuli, or over results, of "
        "which stimuli are made first. A session of more than 30 minutes is refused.",
    )
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="where the stimuli lie, or go")
    parser.add_argument(
        "sources", nargs="*", type=_source, metavar="CONTENT/CONDITION=SOURCE", help="as of stimuli"
    )
    parser.add_argument(
        "-o", "--output", type=Path, required=True, metavar="FILE", help="plan to write (YAML)"
    )
    parser.add_argument(
        "--template", choices=tuple(TEMPLATES), default="set1",
        help="reference and conditions: "
        + "; ".join(
            f"{name}: {', '.join(one.conditions)} against {one.reference}"
            for name, one in TEMPLATES.items()
        )
        + " (default: set1)",
    )  # fmt: skip
    parser.add_argument("--reference", metavar="NAME", help="in place of the template's")
    parser.add_argument(
        "--conditions", type=_names, metavar="NAME,...", help="in place of the template's"
    )
    parser.add_argument("--name", metavar="TEXT", help="name of the test (default: the template's)")
    defaults: dict[str, Any] = {item.name: item.default for item in dataclasses.fields(Plan)}
    parser.add_argument(
        "--displays", type=_names, metavar="NAME,...",
        help=f"profiles of displays (default: {', '.join(defaults['displays'])})",
    )  # fmt: skip
    parser.add_argument(
        "--dimensions", type=_names, metavar="NAME,...",
        help=f"of {', '.join(DIMENSIONS)} (default: {', '.join(defaults['dimensions'])})",
    )  # fmt: skip
    parser.add_argument(
        "--training", type=_names, default=(), metavar="CONTENT,...", help="shown for training only"
    )
    for name, said in (
        ("repetitions", "times each pair is shown"),
        ("dummies", "presentations at the start that do not count"),
        ("coherence", "pairs that come once more"),
        ("break-every", "presentations from break to break; 0: no breaks"),
        ("seed", "of the order"),
    ):
        default = defaults[name.replace("-", "_")]
        parser.add_argument(f"--{name}", type=int, metavar="N", help=f"{said} (default: {default})")
    parser.add_argument(
        "--variant", choices=("I", "II"),
        help="I: the assessor switches freely; II: A and B in turn, then the vote "
        f"(default: {defaults['variant']})",
    )  # fmt: skip
    parser.add_argument(
        "--long-session", action="store_true", default=None, help="more than 30 minutes are wanted"
    )
    _add_making(parser)
    parser.set_defaults(command=_run_plan)


def _add_create(subcommands: Any) -> None:
    parser = subcommands.add_parser(
        "create",
        help="make a test of a plan on a service",
        description="Make a test of a plan on a service; its stimuli must lie under one of the "
        "service's roots. Prints the test.",
    )
    parser.add_argument("plan", type=Path, metavar="PLAN", help="plan (YAML or JSON)")
    add_server(parser, "operator's token")
    add_verbose(parser)
    parser.set_defaults(command=_run_create)


def _add_invite(subcommands: Any) -> None:
    parser = subcommands.add_parser(
        "invite",
        help="print a link for an assessor",
        description="Print a link into the session of each assessor. A link works once; again "
        "for the same assessor and display, it goes on with the same session.",
    )
    parser.add_argument("test", metavar="TEST", help="what create printed")
    parser.add_argument(
        "assessors", nargs="+", metavar="ASSESSOR", help="a code of letters and digits, no name"
    )
    parser.add_argument("--display", required=True, metavar="NAME", help="one of the plan's")
    parser.add_argument(
        "--language", default="en", metavar="CODE", help="of the page (default: en)"
    )
    add_server(parser, "operator's token")
    add_verbose(parser)
    parser.set_defaults(command=_run_invite)


def _add_verify(subcommands: Any) -> None:
    parser = subcommands.add_parser(
        "verify",
        help="prove that the orders of a test follow from plan, seed and assessor",
        description="Draw the orders of an exported test again, and compare.",
    )
    parser.add_argument("export", type=Path, metavar="FILE", help="JSON export of a test")
    add_verbose(parser)
    parser.set_defaults(command=_run_verify)


def _source(text: str) -> tuple[str, str]:
    key, equals, source = text.partition("=")
    if not equals or not source:
        raise argparse.ArgumentTypeError(f"{text!r} is not CONTENT/CONDITION=SOURCE")
    return key, source


def _names(text: str) -> tuple[str, ...]:
    return tuple(part.strip() for part in text.split(",") if part.strip())


def _make(arguments: argparse.Namespace, out: Path) -> None:
    from service.stimuli import make_stimuli

    make_stimuli(
        dict(arguments.sources), out, kind=arguments.kind, frame=arguments.frame,
        fps=arguments.fps, grid=_grid(arguments), fetch=_fetcher(arguments), say=say,
    )  # fmt: skip


def _grid(arguments: argparse.Namespace) -> Any:
    given = {name: value for name, value in vars(arguments).items() if name in GRID_OPTIONS}
    return Settings(**given).grid


def _fetcher(arguments: argparse.Namespace) -> Callable[[str, Path], Path]:
    def fetch(job: str, folder: Path) -> Path:
        from service.client import Client

        with Client(arguments.server, token=token_of(arguments)) as client:
            return fetch_lossless(client, job, folder)

    return fetch


def fetch_lossless(client: Any, job: str, folder: Path) -> Path:
    """Download the lossless result of a job, pictures before video; return where it lies."""
    from service.client import ServiceError

    results = client.results(job)
    pictures = [one for one in results if Path(one.name).match("left-*.png")]
    pictures += [one for one in results if Path(one.name).match("right-*.png")]
    videos = [one for one in results if one.media_type.startswith("video/")]
    if not pictures and not videos:
        raise ServiceError(f"job {job}: has no results (is it finished?)")
    for one in pictures or videos[:1]:
        client.download(one, folder / Path(one.name).name)
    return folder if pictures else folder / Path(videos[0].name).name


def _run_stimuli(arguments: argparse.Namespace) -> int:
    _make(arguments, arguments.output)
    return EXIT_DONE


def _run_plan(arguments: argparse.Namespace) -> int:
    from dscqs.templates import TEMPLATES, make_plan
    from service.plan_files import find_stimuli, write_plan

    if arguments.sources:
        _make(arguments, arguments.folder)
    kind, stimuli = find_stimuli(arguments.folder)
    template = TEMPLATES[arguments.template]
    given = {
        name: getattr(arguments, name)
        for name in (
            "displays", "dimensions", "repetitions", "dummies", "coherence", "break_every",
            "seed", "variant", "long_session",
        )
        if getattr(arguments, name) is not None
    }  # fmt: skip
    plan = make_plan(
        stimuli,
        name=arguments.name or template.title,
        reference=arguments.reference or template.reference,
        conditions=arguments.conditions or template.conditions,
        training=arguments.training,
        kind=kind,
        folder=_relative(arguments.folder, arguments.output.parent),
        **{
            name: list(value) if isinstance(value, tuple) else value
            for name, value in given.items()
        },
    )
    write_plan(arguments.output, plan)
    count = len(plan.contents)
    say(
        f"{arguments.output}: {count} content{'s' * (count != 1)}, "
        f"{plan.presentations} presentations, "
        f"{plan.session_s / 60:.1f} minutes a session"
    )
    return EXIT_DONE


def _relative(folder: Path, start: Path) -> str:
    return Path(os.path.relpath(folder.resolve(), start.resolve())).as_posix()


def _run_create(arguments: argparse.Namespace) -> int:
    from dscqs.plan import plan_to_dict
    from service.dscqs_client import operator_client
    from service.plan_files import read_plan

    plan = read_plan(arguments.plan)
    with operator_client(arguments.server, token_of(arguments)) as operator:
        say(operator.make_test(plan_to_dict(plan)))
    return EXIT_DONE


def _run_invite(arguments: argparse.Namespace) -> int:
    from service.dscqs_client import operator_client

    with operator_client(arguments.server, token_of(arguments)) as operator:
        for assessor in arguments.assessors:
            link = operator.invite(arguments.test, assessor, arguments.display, arguments.language)
            say(f"{assessor}  {arguments.server.rstrip('/')}{link}")
    return EXIT_DONE


def _run_verify(arguments: argparse.Namespace) -> int:
    from dscqs.proof import unproved_orders

    document = read_export(arguments.export)
    wrong = unproved_orders(document)
    for line in wrong:
        say(line)
    if not wrong:
        say(f"{len(document['sessions'])} orders follow from plan, seed and assessor")
    return EXIT_FAILURE if wrong else EXIT_DONE
