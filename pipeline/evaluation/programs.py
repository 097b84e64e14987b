"""Other projects' programs: run for a bounded time, with what they cost."""

from __future__ import annotations

import math
import os
import resource
import signal
import subprocess
import tempfile
import time
from collections.abc import Sequence

from pipeline.evaluation.methods import Accounted, peak_mib

LONGEST = 900
"""Seconds that a program may take."""

LOOK = 0.05
"""Seconds between two looks at its memory."""


class ProgramFailed(Exception):
    """A program of another project did not do what it was asked for; the message says why."""


def run(command: Sequence[str], given: bytes = b"") -> Accounted[bytes]:
    """Return a program's standard output, with its processor time and its own peak of memory.

    Parameters
    ----------
    command : sequence of str
        The program and its arguments.
    given : bytes
        Its standard input.

    Raises
    ------
    ProgramFailed
        If it does not start, takes longer than :data:`LONGEST`, or ends with another status
        than 0; it and its children are gone then.
    """
    begin, cpu = time.perf_counter(), _seconds_of_children()
    with tempfile.TemporaryFile() as held:  # `communicate` forgets its input when it is asked again
        held.write(given)
        held.seek(0)
        try:
            process = subprocess.Popen(
                command, stdin=held, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                process_group=0,
            )  # fmt: skip
        except OSError as error:
            raise ProgramFailed(f"does not start: {error.strerror}") from error
    try:
        output, errors, memory_mib = _watched(process, begin + LONGEST)
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        process.communicate()
        raise
    if process.returncode != 0:
        said = (errors or output).decode(errors="replace").strip().splitlines()
        raise ProgramFailed(f"failed: {said[-1] if said else f'status {process.returncode}'}")
    return Accounted(
        result=output, seconds=time.perf_counter() - begin,
        cpu_seconds=_seconds_of_children() - cpu, memory_mib=memory_mib,
    )  # fmt: skip


def _watched(process: subprocess.Popen[bytes], until: float) -> tuple[bytes, bytes, float]:
    """Return both outputs and the peak of memory, MiB, once the process has ended."""
    memory_mib = math.nan
    while True:
        try:
            output, errors = process.communicate(timeout=LOOK)
        except subprocess.TimeoutExpired as error:
            if time.perf_counter() > until:
                raise ProgramFailed(f"did not end within {LONGEST} s") from error
            now = peak_mib(process.pid)
            memory_mib = memory_mib if math.isnan(now) else now
        else:
            return output, errors, memory_mib


def _seconds_of_children() -> float:
    """Return the processor time of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
