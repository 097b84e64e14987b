"""A Dask cluster of processes on this machine."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from tests.support.waiting import until

ROOT = Path(__file__).parents[2]


class Cluster:
    """A scheduler that lacks our package, and workers: processes as an operator starts them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._file = folder / "scheduler.json"
        self._processes: list[subprocess.Popen[bytes]] = []
        self.without_package = folder / "without-package"
        self.without_package.mkdir()
        (self.without_package / "pipeline.py").write_text(
            "raise ModuleNotFoundError(\"No module named 'pipeline'\")"
        )
        self._start(
            "scheduler", "--port", "0", "--no-dashboard", "--host", "127.0.0.1",
            PYTHONPATH=str(self.without_package),
        )  # fmt: skip
        self.address = until(self._address)

    def _address(self) -> str:
        """Return where the scheduler is; "" while its file is not there, or half written."""
        try:
            return json.loads(self._file.read_text())["address"]
        except (FileNotFoundError, ValueError):
            return ""

    def worker(self, **environment: str) -> subprocess.Popen[bytes]:
        return self._start(
            "worker", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1",
            **environment,
        )  # fmt: skip

    def _start(self, what: str, *options: str, **environment: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", what, "--scheduler-file", str(self._file)]
        with (self.folder / f"{what}.log").open("ab") as log:
            process = subprocess.Popen(
                [*command, *options], cwd=self.folder, stdout=log, stderr=log,
                env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
            )  # fmt: skip
        self._processes.append(process)
        return process

    def lose_scheduler(self) -> None:
        self._processes[0].kill()
        self._processes[0].wait()

    def lose_workers(self) -> None:
        for process in self._processes[1:]:
            process.kill()
            process.wait()

    def close(self) -> None:
        self.lose_workers()
        self.lose_scheduler()
