"""``python -m benchmarks.dscqs``: simulated assessors at once, and the round trip of their votes.

Starts a service, makes a test of pictures of 512×192 pixels for two eyes, lets every assessor go
through it at the same time, and compares what they voted with what was stored.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from service.http.dscqs_access import TOKEN_FILE


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.dscqs", description=__doc__)
    parser.add_argument("--assessors", type=int, default=200, help="at once (default: %(default)s)")
    parser.add_argument(
        "--speed", type=float, default=2.0, help="times faster than people (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        return _measure(Path(folder), options.assessors, options.speed)


def _measure(folder: Path, assessors: int, speed: float) -> int:
    depthsr = [sys.executable, "-m", "service"]
    plan = folder / "plan.yaml"
    _write_stimuli(folder / "stimuli")
    words = ["dscqs", "plan", str(folder / "stimuli"), "-o", str(plan), "--dummies", "1"]
    subprocess.run([*depthsr, *words], check=True)
    words = ["serve", "--port", "0", "--workers", "0", "--log-level", "warning"]
    words += ["--data", str(folder / "data"), "--roots", str(folder)]
    with subprocess.Popen([*depthsr, *words], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        found = re.search(r"http://\S+", process.stdout.readline())
        assert found
        try:
            token = (folder / "data" / TOKEN_FILE).read_text().strip()
            words = ["dscqs", "simulate", str(plan), "--server", found[0], "--token", token]
            words += ["--assessors", str(assessors), "--speed", str(speed)]
            return subprocess.run([*depthsr, *words]).returncode
        finally:
            process.terminate()


def _write_stimuli(folder: Path) -> None:
    from pipeline.media.png import encode_png

    folder.mkdir()
    chance = np.random.default_rng(1)
    for content in ("ballet", "street"):
        for condition in ("original", "bicubic", "sr"):
            picture = np.kron(chance.integers(0, 256, (48, 128, 3)), np.ones((4, 4, 1)))
            (folder / f"{content}--{condition}.png").write_bytes(
                encode_png(picture.astype(np.uint8))
            )


if __name__ == "__main__":
    sys.exit(main())
