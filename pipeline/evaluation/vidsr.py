"""vidsr, a packaged program that fuses frames of a video, run on the views as if they were one.

It is made for a region of interest: one motion of it for each frame, chosen by itself; its
sharpening beyond back-projection is switched off. It runs as a program of its own, beside this
one, and needs ffmpeg and ffprobe.
"""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.evaluation.networks import package_path
from pipeline.frames import MultiViewFrame
from pipeline.media.lossless import write_lossless_webm

NAME = "vidsr"

LONGEST = 900
"""Seconds that it may take."""

PLAIN = (
    "--fusion", "trimmed", "--rl", "0", "--unsharp", "0", "--clahe", "0", "--denoise", "0",
    "--gray", "--bits", "16", "--no-variants", "--keep-duplicates", "--out-pad", "0",
)  # fmt: skip
"""Back-projection, and nothing for the look."""


def missing() -> str:
    """Return what is not there that it needs; empty where all is."""
    if package_path("vidsr") is None:
        return "not installed"
    tools = [tool for tool in ("ffmpeg", "ffprobe") if shutil.which(tool) is None]
    return f"needs {' and '.join(tools)}" if tools else ""


@dataclass(frozen=True, kw_only=True, eq=False)
class Fused:
    """A region of a view doubled."""

    picture: npt.NDArray[np.float32]
    """Twice as many rows and columns as the region, pixel areas aligned, grey levels."""
    cpu_seconds: float
    """Of all of its processes and threads."""


def fused(
    frame: MultiViewFrame, reference: str, sigma: float, region: tuple[int, int, int, int]
) -> Fused | str:
    """Return a region of the reference view doubled, or why not.

    Parameters
    ----------
    frame : MultiViewFrame
        Its views become the frames of a lossless clip, left to right.
    reference : str
        View id.
    sigma : float
        Of the PSF, HR pixels.
    region : (x, y, width, height)
        LR pixels, all even.
    """
    program = package_path("vidsr")
    assert program is not None
    width, height = region[2:]
    begin = _seconds_of_children()
    ids = [view.view_id for view in frame.views]
    with tempfile.TemporaryDirectory() as folder:
        clip, out = Path(folder) / "views.webm", Path(folder) / "out"
        write_lossless_webm(clip, [_even(view.luma) for view in frame.views], Fraction(25))
        command = [
            sys.executable, str(program), "sr", str(clip), "--out", str(out), "--start", "0",
            "--roi", ",".join(str(number) for number in region), "--scale", "2",
            "--ref", str(ids.index(reference)), "--psf", f"{sigma:g}", *PLAIN,
        ]  # fmt: skip
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=LONGEST, check=False
            )
        except subprocess.TimeoutExpired:
            return f"did not end within {LONGEST} s"
        made = sorted(out.glob("05_result*.png"))
        if done.returncode != 0 or not made:
            said = (done.stderr or done.stdout).strip().splitlines()
            return f"failed: {said[-1] if said else f'status {done.returncode}'}"
        picture = cv2.imread(str(made[0]), cv2.IMREAD_UNCHANGED)
    if picture.ndim == 3:
        picture = picture[..., 0]
    if picture.shape != (2 * height, 2 * width):
        return f"gave {picture.shape[1]}×{picture.shape[0]} pixels"
    grey = picture.astype(np.float32) * np.float32(255 / np.iinfo(picture.dtype).max)
    return Fused(picture=grey, cpu_seconds=_seconds_of_children() - begin)


def _seconds_of_children() -> float:
    """Return the processor time of all child processes that have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _even(luma: npt.NDArray[np.float32]) -> npt.NDArray[np.uint8]:
    """Return a grey picture as colours, its sides made even by repeating the last line."""
    height, width = luma.shape
    whole = np.pad(luma.astype(np.uint8), ((0, height % 2), (0, width % 2)), mode="edge")
    return np.repeat(whole[..., None], 3, axis=2)
