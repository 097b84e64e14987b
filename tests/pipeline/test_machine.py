"""What is said of the machine."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.machine import available_memory


@pytest.mark.parametrize(
    ("said", "most", "expected"),
    [
        (None, None, math.inf),
        (2048, None, 2 << 20),
        (2048, "max", 2 << 20),
        (2048, "5000000", 1_300_000),
        (2048, "50000000", 2 << 20),
        (None, "5000000", 1_300_000),
    ],
)
def test_memory_is_that_of_the_machine_or_of_the_group(tmp_path, said, most, expected):
    if said is not None:
        (tmp_path / "proc").mkdir()
        (tmp_path / "proc" / "meminfo").write_text(
            f"MemTotal: 9000 kB\nMemAvailable:    {said} kB\n"
        )
    if most is not None:
        group = tmp_path / "sys" / "fs" / "cgroup"
        group.mkdir(parents=True)
        (group / "memory.max").write_text(f"{most}\n")
        (group / "memory.current").write_text("4000000\n")
        (group / "memory.stat").write_text("file 400000\ninactive_file 300000\n")
    assert available_memory(tmp_path) == expected


def test_some_memory_of_this_machine_may_still_be_taken():
    assert available_memory() > 1 << 20


FAULTS = """
import resource
import numpy as np
from pipeline.threads import set_threads

if {keeps}:
    set_threads(1)

def make():
    return [np.ones(size << 18, np.float32) for size in (3, 5, 1, 3)]

def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt

for _ in range(3):
    make()
before = faults()
for _ in range(10):
    make()
print(faults() - before)
"""


def test_memory_that_is_given_back_is_not_cleared_for_each_frame():
    """Twelve MiB ten times over, in a process that keeps them and in one that does not."""
    kept, returned = (
        int(
            subprocess.run(
                [sys.executable, "-c", FAULTS.format(keeps=keeps)],
                check=True, capture_output=True, cwd=Path(__file__).parents[2],
            ).stdout
        )
        for keeps in (True, False)
    )  # fmt: skip
    assert kept < 30
    assert returned > 1000
