"""What commands share: progress, an orderly end, options of talk and of the service asked."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pipeline.stop import StopFlag
    from service.progress import Progress

SERVER = "http://127.0.0.1:8000"


def add_server(parser: argparse.ArgumentParser, token: str) -> None:
    """Add the options that say which service is asked."""
    parser.add_argument(
        "--server", default=SERVER, metavar="URL",
        help=f"address of the service (default: {SERVER})",
    )  # fmt: skip
    parser.add_argument("--token", metavar="TOKEN", help=f"{token} (default: DEPTHSR_TOKEN's)")


def token_of(arguments: argparse.Namespace) -> str | None:
    """Return the token that was given, or that of the environment."""
    return arguments.token or os.environ.get("DEPTHSR_TOKEN")


def add_talk(parser: argparse.ArgumentParser) -> None:
    """Add ``--quiet`` and ``--verbose``."""
    parser.add_argument("-q", "--quiet", action="store_true", help="no progress, warnings only")
    parser.add_argument(
        "-v", "--verbose", action="store_true", help="tracebacks of unexpected failures"
    )


@contextmanager
def watching(
    arguments: argparse.Namespace,
) -> Iterator[tuple[StopFlag, Progress]]:
    """Show progress, and turn Ctrl-C and SIGTERM into an orderly end, while the body runs."""
    from pipeline.compile_notice import compile_notice
    from pipeline.events import Compiling
    from pipeline.stop import StopFlag
    from service.progress import Progress

    stop = StopFlag()
    progress = Progress(quiet=arguments.quiet)

    def ask(signum: int, frame: object) -> None:
        for number in previous:  # a second signal ends the process at once
            signal.signal(number, signal.SIG_DFL)
        stop.from_signal()

    previous = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with compile_notice(lambda: progress(Compiling())):
            yield stop, progress
    finally:
        progress.close()
        for number, handler in previous.items():
            signal.signal(number, handler)


def say(text: str) -> None:
    """Write a result to stdout at once, on a line of its own."""
    sys.stdout.write(text if text.endswith("\n") else text + "\n")
    sys.stdout.flush()
