"""The ``depthsr dscqs`` commands: subjective tests, from the plan to the scores."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from service.cli_dscqs_tests import add_tests, read_export
from service.cli_simulate import add_simulate
from service.console import EXIT_DONE


def add_dscqs(commands: Any) -> None:
    """Add ``dscqs`` and its subcommands to the command line."""
    parser = commands.add_parser(
        "dscqs",
        help="subjective tests: stimuli, plan, sessions, votes, scores",
        description="Subjective tests after ITU-R BT.500: double-stimulus continuous "
        "quality scale (DSCQS).",
    )
    subcommands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    add_tests(subcommands)
    add_simulate(subcommands)
    _add_analyse(subcommands)
    _add_export(subcommands)


def _add_analyse(subcommands: Any) -> None:
    parser = subcommands.add_parser(
        "analyse",
        help="compute scores with intervals, and screen the assessors",
        description="Compute the scores of a test with their intervals, before and after the "
        "screening of assessors (ITU-R BT.500), from a table of votes.",
    )
    parser.add_argument(
        "votes", type=Path, metavar="VOTES", help="votes: tidy CSV, suJSON, or a sureal dataset"
    )
    parser.add_argument("--json", type=Path, metavar="FILE", help="JSON file to write")
    parser.add_argument(
        "--html", type=Path, metavar="FILE", help="report to write: one HTML file with its plots"
    )
    parser.add_argument("--pdf", type=Path, metavar="FILE", help="the same report as PDF")
    parser.add_argument(
        "--log", type=Path, metavar="FILE",
        help="JSON export of the test (operator's page, Everything): its session log goes into "
        "the report",
    )  # fmt: skip
    parser.add_argument("--title", help="title of the report (default: name of the votes)")
    parser.add_argument(
        "--screening", choices=("sample", "population"), default="sample",
        help="standard deviation of the screening: sample (n − 1, the Recommendation) or "
        "population (n, as sureal) (default: sample)",
    )  # fmt: skip
    parser.add_argument("-q", "--quiet", action="store_true", help="print nothing")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="tracebacks of unexpected failures"
    )
    parser.set_defaults(command=_run_analyse)


def _run_analyse(arguments: argparse.Namespace) -> int:
    from dscqs.exchange.files import read_scores
    from dscqs.record import session_log
    from dscqs.report import html_report, json_report, pdf_report
    from dscqs.statistics.analysis import analyse
    from dscqs.statistics.screening import Variant
    from dscqs.statistics.text import format_analysis
    from pipeline.media.files import check_writable, write_atomic
    from pipeline.report import versions

    for path in (arguments.json, arguments.html, arguments.pdf):
        if path is not None:
            check_writable(path)
    table = read_scores(arguments.votes)
    variant = Variant(arguments.screening)
    log = [] if arguments.log is None else session_log(read_export(arguments.log))
    head = {"title": arguments.title or arguments.votes.stem, "variant": variant, "log": log}
    if arguments.json is not None:
        found = json_report(table, variant=variant, more={"versions": versions()})
        write_atomic(arguments.json, found)
    if arguments.html is not None:
        write_atomic(arguments.html, html_report(table, **head))
    if arguments.pdf is not None:
        write_atomic(arguments.pdf, pdf_report(table, **head))
    if not arguments.quiet:
        print(format_analysis(analyse(table, variant)))  # noqa: T201
    return EXIT_DONE


def _add_export(subcommands: Any) -> None:
    parser = subcommands.add_parser(
        "export",
        help="write votes in another format",
        description="Write votes as tidy CSV, suJSON, or a sureal dataset (JSON), whatever "
        "format they are in.",
    )
    parser.add_argument(
        "votes", type=Path, metavar="VOTES", help="votes: tidy CSV, suJSON, or a sureal dataset"
    )
    parser.add_argument(
        "--to", choices=("csv", "sujson", "sureal"), default="csv",
        help="format to write (default: csv)",
    )  # fmt: skip
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="file to write (default: print it)"
    )
    parser.add_argument("--display", help="for sureal, which holds one display: which")
    parser.add_argument("--dimension", help="for sureal, which holds one dimension: which")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="tracebacks of unexpected failures"
    )
    parser.set_defaults(command=_run_export)


def _run_export(arguments: argparse.Namespace) -> int:
    from dscqs.exchange.files import Format, format_scores, read_scores
    from pipeline.media.files import check_writable, write_atomic

    if arguments.output is not None:
        check_writable(arguments.output)
    text = format_scores(
        read_scores(arguments.votes),
        Format(arguments.to),
        display=arguments.display,
        dimension=arguments.dimension,
    )
    if arguments.output is not None:
        write_atomic(arguments.output, text.encode())
    else:
        print(text, end="")  # noqa: T201
    return EXIT_DONE
