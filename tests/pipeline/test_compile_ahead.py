"""What is compiled ahead is all that a job, a stream or a view between will ask for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

KERNELS_LEFT_OUT = """
import gc
import importlib
import pkgutil

from numba.core.dispatcher import Dispatcher

import pipeline
from pipeline.compile_ahead import compile_kernels

for module in pkgutil.walk_packages(pipeline.__path__, "pipeline."):
    importlib.import_module(module.name)
kernels = [
    kernel
    for kernel in gc.get_objects()
    if isinstance(kernel, Dispatcher) and kernel.__module__.startswith("pipeline.")
]
called_by_kernels = {
    id(kernel.py_func.__globals__.get(name))
    for kernel in kernels
    for name in kernel.py_func.__code__.co_names
}
compile_kernels()
print(
    *(
        f"{kernel.__module__}.{kernel.__name__}"
        for kernel in kernels
        if not kernel.signatures and id(kernel) not in called_by_kernels
    )
)
assert sum(bool(kernel.signatures) for kernel in kernels) > 20
"""


def test_every_kernel_is_compiled_ahead():
    """In a process of its own: other tests have compiled them all."""
    done = subprocess.run(
        [sys.executable, "-c", KERNELS_LEFT_OUT], check=True, timeout=900, text=True,
        stdout=subprocess.PIPE, cwd=Path(__file__).parents[2],
    )  # fmt: skip
    assert done.stdout.split() == []
