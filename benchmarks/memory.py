"""Peak memory of super-resolving one frame, in a process that does nothing else.

    python -m benchmarks.memory FRAME.npz THREADS

prints the peak in MiB. The frame comes from a file, so that rendering it does not count;
interpreter, libraries and compiled kernels do.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.config import Settings
from pipeline.frames import MultiViewFrame, View

ROOT = Path(__file__).parents[1]

GO_BETWEEN = "import subprocess, sys; sys.exit(subprocess.call(sys.argv[1:]))"
"""A small process between this one and the measured one: on Linux a process begins with
the peak of the one that started it."""


def save_frame(path: Path, frame: MultiViewFrame) -> None:
    """Write luma, depth and ids of a frame."""
    arrays: dict[str, Any] = {
        "luma": np.stack([view.luma for view in frame.views]),
        "ids": np.array([view.view_id for view in frame.views]),
        "eyes": np.array([frame.left, frame.right]),
    }
    depths = [view.depth_map for view in frame.views if view.depth_map is not None]
    if len(depths) == len(frame.views):
        arrays["depth"] = np.stack(depths)
    np.savez(path, **arrays)


def load_frame(path: Path) -> MultiViewFrame:
    """Return what :func:`save_frame` wrote."""
    with np.load(path) as content:
        luma, ids, eyes = content["luma"], content["ids"], content["eyes"]
        depth = content["depth"] if "depth" in content else [None] * len(ids)
    return MultiViewFrame(
        frame_index=0,
        views=tuple(
            View(view_id=str(view_id), luma=image, depth_map=depth_map)
            for view_id, image, depth_map in zip(ids, luma, depth, strict=True)
        ),
        left=str(eyes[0]),
        right=str(eyes[1]),
    )


def peak_of(path: Path, threads: int) -> float:
    """Return the peak memory of a fresh process that super-resolves the frame, MiB."""
    measured = [sys.executable, "-m", "benchmarks.memory", str(path), str(threads)]
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    done = subprocess.run(
        [sys.executable, "-c", GO_BETWEEN, *measured],
        check=True, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
    )  # fmt: skip
    return float(done.stdout)


def bench_settings(threads: int, magnification: int = 2) -> Settings:
    """Return the default settings for what the benchmark renders: σ_psf K/2, decimation."""
    return Settings(
        magnification=str(magnification),
        sampling="decimation",
        psf_sigma=magnification / 2,
        threads=threads,
    )


def main(arguments: list[str]) -> int:
    from pipeline.numba_cache import prepare_numba_cache

    prepare_numba_cache()
    from pipeline.report import peak_memory_mib
    from pipeline.superresolve import superresolve

    path, threads = arguments
    frame = load_frame(Path(path))
    superresolve(frame, bench_settings(int(threads)), targets=(frame.left, frame.right))
    peak = peak_memory_mib()
    print("nan" if peak is None else peak)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
