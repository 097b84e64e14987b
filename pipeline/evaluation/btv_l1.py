"""OpenCV's BTV-L1 (``superres``), run on the views as if they were frames of a video.

No Python package binds it: ``btv_l1.cpp`` is a program around it, which ``make peers`` builds
into the folder of the peers where there are a C++ compiler and the headers of such an OpenCV.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from pipeline.evaluation import programs
from pipeline.evaluation.fusing import Asked, Fuser
from pipeline.evaluation.methods import Accounted
from pipeline.evaluation.networks import packages_folder
from pipeline.evaluation.programs import ProgramFailed

MARGIN = 24
"""LR pixels around the region that it is given as well, where the picture has them."""


def _program() -> Path:
    return packages_folder().resolve() / "btv-l1"


def _missing() -> str:
    return "" if _program().is_file() else "not installed"


def _files() -> tuple[Path, ...]:
    return (_program(), Path(__file__), Path(programs.__file__))


def _fused(asked: Asked) -> Accounted[npt.NDArray[np.float32]]:
    x, y, width, height = asked.region
    left, top = max(x - MARGIN, 0), max(y - MARGIN, 0)
    views = np.stack(
        [
            view.luma[top : y + height + MARGIN, left : x + width + MARGIN]
            for view in asked.frame.views
        ]
    ).astype(np.uint8)
    count, rows, columns = views.shape
    made = programs.run(
        [
            str(_program()), str(columns), str(rows), str(count), str(asked.number),
            f"{asked.sigma:g}",
        ],
        views.tobytes(),
    )  # fmt: skip
    if len(made.result) != 4 * rows * columns:
        raise ProgramFailed(f"gave {len(made.result)} pixels, not {4 * rows * columns}")
    doubled = np.frombuffer(made.result, np.uint8).reshape(2 * rows, 2 * columns)
    inner = doubled[2 * (y - top) :, 2 * (x - left) :][: 2 * height, : 2 * width]
    return made.giving(inner.astype(np.float32))


BTV_L1 = Fuser(name="BTV-L1", run=_fused, missing=_missing, files=_files, on_pixels=True)
