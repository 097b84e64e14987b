"""A process that stops itself amid its work: no test has to be quick to find it there."""

from __future__ import annotations

import os
from pathlib import Path

HANGS = """
import os, signal, sys
from pathlib import Path

mark = Path(__file__).with_name("hung")
if {module!r} in sys.orig_argv and not mark.exists():
    flush, seen = os.fsync, []

    def hang(descriptor):
        flush(descriptor)
        path = Path(os.readlink(f"/proc/self/fd/{{descriptor}}")).name
        seen.extend([path] * (path.startswith(".segment-") and ".json." in path))
        if len(seen) > {finished} and not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGSTOP)

    os.fsync = hang
"""


def hanging(folder: Path, module: str, *, finished: int) -> dict[str, str]:
    """Return an environment in which the first process of a module stops itself (SIGSTOP).

    Parameters
    ----------
    folder : Path
        Is made, for what Python loads at its start.
    module : str
        As in ``python -m MODULE``.
    finished : int
        Segments of the job that are finished then; the next one is about to be.
    """
    folder.mkdir()
    program = HANGS.format(module=module, finished=finished)
    (folder / "sitecustomize.py").write_text(program, encoding="utf-8")
    others = os.environ.get("PYTHONPATH")
    return {"PYTHONPATH": os.pathsep.join([str(folder), *([others] if others else [])])}


def has_hung(environment: dict[str, str]) -> bool:
    """Whether the process has come to where it stops itself."""
    return Path(environment["PYTHONPATH"].split(os.pathsep)[0], "hung").exists()


def wait_until_stopped(pid: int) -> None:
    """Wait until a child stands still; fail where it ends before."""
    found = os.waitid(os.P_PID, pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT)
    assert found is not None
    assert found.si_code == os.CLD_STOPPED, "it has ended before"
