"""The ``depthsr dscqs`` commands: subjective tests, from the plan to the scores."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from service.cli_dscqs_tests import add_tests
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
    _add_analyse(subcommands)


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
    from dscqs.statistics.analysis import analyse
    from dscqs.statistics.document import document
    from dscqs.statistics.screening import Variant
    from dscqs.statistics.text import format_analysis
    from dscqs.votes import read_csv
    from pipeline.media.files import check_writable, write_atomic
    from pipeline.report import strict_json, versions

    if arguments.json is not None:
        check_writable(arguments.json)
    table = read_csv(arguments.votes)
    analyses = analyse(table, Variant(arguments.screening))
    if arguments.json is not None:
        content = {**document(analyses), "versions": versions()}
        write_atomic(arguments.json, strict_json(content).encode())
    if not arguments.quiet:
        print(format_analysis(analyses))  # noqa: T201
    return EXIT_DONE
