"""The last line of defence of the command line: one line for the user, one exit status."""

from __future__ import annotations

import sys
import traceback
from typing import TextIO

from dscqs.errors import DscqsError
from pipeline.errors import Interrupted, PipelineError

EXIT_DONE = 0
EXIT_FAILURE = 1
EXIT_USAGE = 2
EXIT_INTERRUPTED = 130


def one_line(text: str) -> str:
    """Return the text on one line: line breaks and runs of blanks become one blank."""
    return " ".join(text.split())


def report_error(error: BaseException, *, verbose: bool, stream: TextIO | None = None) -> int:
    """Write what went wrong as one line to stderr, and return the exit status.

    The traceback follows only where it can be of use: of an unexpected error, with ``-v``.
    """
    stream = stream or sys.stderr
    if isinstance(error, (KeyboardInterrupt, Interrupted)):
        stream.write("depthsr: interrupted; a run with --resume goes on from what is finished\n")
        return EXIT_INTERRUPTED
    if isinstance(error, (PipelineError, DscqsError)):
        stream.write(f"depthsr: error: {one_line(str(error))}\n")
        return error.exit_status
    if isinstance(error, MemoryError):
        text = "not enough memory; use smaller images, fewer views or a smaller magnification"
    elif isinstance(error, OSError):
        text = str(error)
    else:
        text = f"unexpected {type(error).__name__}: {error}"
        if not verbose:
            text += " (run again with -v for the traceback)"
    stream.write(f"depthsr: error: {one_line(text)}\n")
    if verbose:
        traceback.print_exception(error, file=stream)
    return EXIT_FAILURE
