"""vidsr, a packaged program that fuses frames of a video, run on the views as if they were one.

It is made for a region of interest: one motion of it for each frame, chosen by itself; its
sharpening beyond back-projection is switched off. It runs as a program of its own, beside this
one, and needs ffmpeg and ffprobe.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.evaluation import programs
from pipeline.evaluation.fusing import Asked, Fuser
from pipeline.evaluation.methods import Accounted
from pipeline.evaluation.networks import package_path
from pipeline.evaluation.programs import ProgramFailed
from pipeline.media.lossless import write_lossless_webm

PLAIN = (
    "--fusion", "trimmed", "--rl", "0", "--unsharp", "0", "--clahe", "0", "--denoise", "0",
    "--gray", "--bits", "16", "--no-variants", "--keep-duplicates", "--out-pad", "0",
)  # fmt: skip
"""Back-projection, and nothing for the look."""


def _missing() -> str:
    if package_path("vidsr") is None:
        return "not installed"
    tools = [tool for tool in ("ffmpeg", "ffprobe") if shutil.which(tool) is None]
    return f"needs {' and '.join(tools)}" if tools else ""


def _program() -> Path:
    program = package_path("vidsr")
    assert program is not None
    return program


def _files() -> tuple[Path, ...]:
    return (_program(), Path(__file__), Path(programs.__file__))


def _fused(asked: Asked) -> Accounted[npt.NDArray[np.float32]]:
    width, height = asked.region[2:]
    with tempfile.TemporaryDirectory() as folder:
        clip, out = Path(folder) / "views.webm", Path(folder) / "out"
        write_lossless_webm(clip, [_even(view.luma) for view in asked.frame.views], Fraction(25))
        ended = programs.run(
            [
                sys.executable, str(_program()), "sr", str(clip), "--out", str(out),
                "--start", "0", "--roi", ",".join(str(number) for number in asked.region),
                "--scale", "2", "--ref", str(asked.number), "--psf", f"{asked.sigma:g}", *PLAIN,
            ]
        )  # fmt: skip
        made = sorted(out.glob("05_result*.png"))
        picture = cv2.imread(str(made[0]), cv2.IMREAD_UNCHANGED) if made else None
    if picture is None:
        raise ProgramFailed("failed: it left no picture")
    if picture.ndim == 3:
        picture = picture[..., 0]
    if picture.shape != (2 * height, 2 * width):
        raise ProgramFailed(f"gave {picture.shape[1]}×{picture.shape[0]} pixels")
    scale = np.float32(255 / np.iinfo(picture.dtype).max)
    return ended.giving(picture.astype(np.float32) * scale)


def _even(luma: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Return a grey picture as colours, its sides made even by repeating the last line."""
    height, width = luma.shape
    whole = np.pad(luma.astype(np.uint8), ((0, height % 2), (0, width % 2)), mode="edge")
    return np.repeat(whole[..., None], 3, axis=2)


VIDSR = Fuser(name="vidsr", run=_fused, missing=_missing, files=_files, on_pixels=False)
