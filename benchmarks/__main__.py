"""``python -m benchmarks``: one table of speed and memory, and the floors."""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import Any


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="tiny sizes: does it work at all?")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write everything as JSON")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the page as Markdown")
    parser.add_argument("--threads", type=int, default=2, help="threads (default: %(default)s)")
    options = parser.parse_args(arguments)

    from pipeline.numba_cache import prepare_numba_cache

    prepare_numba_cache()  # before anything imports numba

    from dataclasses import replace

    from benchmarks.speed import QUICK, Plan, as_json, run_speed, stderr_note
    from pipeline.machine import described, machine, today
    from pipeline.media.files import check_writable
    from pipeline.report import strict_json

    for path in (options.json, options.write):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            check_writable(path)
    plan = replace(QUICK if options.quick else Plan(), threads=options.threads)
    result = run_speed(plan, stderr_note(time.perf_counter()))
    print(described())
    print(f"{plan.threads} threads, {today()}, {result.seconds:.0f} s in all; {load_of(result)}")
    if options.quick:
        print("--quick: the sizes are not those that the floors are about")
    print()
    print(result.table().as_text())
    print()
    from pipeline.evaluation.floors import verdict_table

    print(verdict_table(result.verdicts).as_text())
    if options.json is not None:
        _write(options.json, strict_json(as_json(result, machine(), today())))
    if options.write is not None:
        _write(options.write, page(result))
    return 0


def load_of(result: Any) -> str:
    """Return how busy the machine was."""
    before, after = result.load
    return f"load average {before:.1f} when it began, {after:.1f} (itself included) when it ended"


def page(result: Any) -> str:
    """Return the page of the result, Markdown."""
    from pipeline.evaluation.floors import verdict_table
    from pipeline.machine import described, today

    plan = result.plan
    command = "python -m benchmarks" + ("" if plan.threads == 2 else f" --threads {plan.threads}")
    return f"""# How fast

Measured on {today()} with `{command}` (`make bench`) in {result.seconds:.0f} s, all in one run.

Machine: {described()}; {plan.threads} threads; {load_of(result)}.

The unit is OpenCV's `INTER_CUBIC` of both eyes' 8-bit luma ({plan.size[0]}×{plan.size[1]} →
{2 * plan.size[0]}×{2 * plan.size[1]}) on one thread, median of 30, measured anew before and after
every run of a row; *× bicubic* is the time divided by the mean of the two. *CPU s* is the processor
time of all threads; *others* is what other programs took of the processor meanwhile. Figures are
medians over the runs that had nine tenths of it or more for themselves, or over all where there
was none; what rests on such rows is not judged. The input is the rendered scene: noise 1, depth as
a stereo matcher delivers it, no calibration; both eyes are reconstructed, kernels are compiled
before. Exponents p are fitted to time ∝ size^p, that of the cold frame being judged. Peak memory is
that of a fresh process that reads the frame from a file.
Stream latency is that of a real service and a source over zenoh on this machine, stage by stage
from the arrival of a frame's last view to the published result, in real-time mode.

{result.table().as_markdown()}

## Floors

{verdict_table(result.verdicts).as_markdown()}
"""


def _write(path: Path, text: str) -> None:
    from pipeline.media.files import write_atomic

    write_atomic(path, text.encode())


if __name__ == "__main__":
    sys.exit(main())
