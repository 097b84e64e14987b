"""``python -m benchmarks.changes``: frames of a chain against cold ones, where pictures change.

The four views of a rendered scene change from frame to frame as video does: things move, the focus
is pulled, a camera is nudged … They are observed with a camera's noise and go, or do not, through
H.264. Every frame is computed in a chain and by itself; both eyes are compared with the truth.
"""

from __future__ import annotations

import argparse
import contextlib
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.config import Settings
from pipeline.evaluation.tables import Table
from pipeline.frames import GreyImage, MultiViewFrame
from pipeline.machine import described, today
from pipeline.media.decode import VideoReader
from pipeline.media.encode import write_segment
from pipeline.media.files import write_atomic
from pipeline.media.video_format import VideoFormat
from pipeline.metrics import psnr
from pipeline.stereo import StereoLayout
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker

NOISE = 2.0
"""Grey levels."""

BELOW = 0.05
"""What a frame of a chain may lose to a cold one, dB (the aim of docs/performance.md)."""

BORDER = 8
"""HR pixels that are left out of PSNR."""

CHAINS = ("warm", "swift")
FPS = Fraction(15)
NUM_VIEWS = 4

Picture = Callable[[GreyImage, GreyImage, int], GreyImage]
"""A view in frame n, of what it was and of another picture; HR pixels, grey levels."""


def aside(picture: GreyImage, other: GreyImage, number: int, *, step: float) -> GreyImage:
    """Pan: ``step`` HR pixels a frame."""
    motion = np.array([[1, 0, -step * number], [0, 1, 0]], np.float32)
    return _warped(picture, motion)


def nudged(
    picture: GreyImage, other: GreyImage, number: int, *, step: float = 0.6, at: int = 6
) -> GreyImage:
    """Move the camera by ``step`` HR pixels in frame ``at``, where it stays."""
    return aside(picture, other, 1, step=step) if number >= at else picture


def zoomed(picture: GreyImage, other: GreyImage, number: int, *, factor: float) -> GreyImage:
    """Zoom about the centre, by ``factor`` a frame."""
    height, width = picture.shape
    scale = factor**number
    x, y = (width - 1) / 2 * (1 - scale), (height - 1) / 2 * (1 - scale)
    return _warped(picture, np.array([[scale, 0, x], [0, scale, y]], np.float32))


def softer(
    picture: GreyImage, other: GreyImage, number: int, *, step: float, begin: float = 0.5
) -> GreyImage:
    """Pull the focus: σ grows from ``begin`` by ``step`` HR pixels a frame."""
    return cv2.GaussianBlur(picture, (0, 0), begin + step * number)


def dissolving(picture: GreyImage, other: GreyImage, number: int, *, frames: int) -> GreyImage:
    """Dissolve into the other picture."""
    return picture + (other - picture) * np.float32(number / frames)


def half_dissolving(picture: GreyImage, other: GreyImage, number: int, *, frames: int) -> GreyImage:
    """Dissolve the left half."""
    half = np.arange(picture.shape[1]) < picture.shape[1] // 2
    return picture + (other - picture) * half * np.float32(number / frames)


def half_turning_over(
    picture: GreyImage, other: GreyImage, number: int, *, frames: int
) -> GreyImage:
    """Dissolve the left half into the same upside down, of which neither rig nor depth tells."""
    return half_dissolving(picture, picture[::-1], min(number, frames), frames=frames)


def fading(picture: GreyImage, other: GreyImage, number: int, *, frames: int) -> GreyImage:
    """Fade to black."""
    return picture * np.float32(1 - number / frames)


def flickering(picture: GreyImage, other: GreyImage, number: int, *, share: float) -> GreyImage:
    """Light by lamps of 50 Hz, seen by a shutter that rolls."""
    rows = np.arange(len(picture), dtype=np.float32)[:, None] / len(picture)
    light = 1 + share * np.sin(2 * np.pi * (1.5 * rows + 100 / 15 * number))
    return (picture * light).astype(np.float32)


def as_it_is(picture: GreyImage, other: GreyImage, number: int) -> GreyImage:
    """Change nothing."""
    return picture


def _warped(picture: GreyImage, motion: npt.NDArray[np.float32]) -> GreyImage:
    return cv2.warpAffine(
        picture, motion, picture.shape[::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


@dataclass(frozen=True, kw_only=True)
class Change:
    """What happens in a chain of frames."""

    name: str
    frames: int
    picture: Picture | None
    """None: the scene's own things move."""


CHANGES = (
    Change(name="nothing", frames=12, picture=as_it_is),
    Change(name="the scene's things move", frames=20, picture=None),
    Change(name="pan, 0.03 LR pixels a frame", frames=20, picture=partial(aside, step=0.06)),
    Change(name="pan, 0.1", frames=14, picture=partial(aside, step=0.2)),
    Change(name="nudge by 0.3 LR pixels", frames=14, picture=nudged),
    Change(name="zoom, 0.1 % a frame", frames=16, picture=partial(zoomed, factor=1.001)),
    Change(
        name="focus, σ grows by 0.05 HR pixels a frame", frames=24,
        picture=partial(softer, step=0.05),
    ),
    Change(name="focus, by 0.1", frames=16, picture=partial(softer, step=0.1)),
    Change(name="focus, by 0.2", frames=14, picture=partial(softer, step=0.2)),
    Change(name="dissolve in 60 frames", frames=30, picture=partial(dissolving, frames=60)),
    Change(
        name="dissolve of the left half, in 24", frames=26,
        picture=partial(half_dissolving, frames=24),
    ),
    Change(
        name="the left half upside down, in 8", frames=11,
        picture=partial(half_turning_over, frames=8),
    ),
    Change(name="fade in 40 frames", frames=20, picture=partial(fading, frames=40)),
    Change(name="lamps flicker by 3 %", frames=12, picture=partial(flickering, share=0.03)),
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Case:
    """A chain that is measured."""

    change: Change
    width: int
    """Of a view, LR pixels; its height is three quarters of that."""
    crf: int | None = None
    """Of H.264; None: not coded."""
    is_told: bool = False
    """Whether the noise is given; else it is estimated."""
    seed: int = 0


def cases(seed: int, only: str = "") -> list[Case]:
    """Return the chains of the page."""
    kinds = (
        (256, None, False), (256, 18, False), (256, 23, False), (256, 23, True), (256, 28, False),
        (128, None, False), (128, 23, False),
    )  # fmt: skip
    return [
        Case(change=change, width=width, crf=crf, is_told=is_told, seed=seed)
        for width, crf, is_told in kinds
        for change in CHANGES
        if only in change.name
    ]


@dataclass(frozen=True, kw_only=True)
class Chain:
    """How a chain's frames, but the first, compare with cold ones."""

    gains: tuple[tuple[float, ...], ...]
    """By frame and eye, dB."""
    share: float
    """Its processor time, of that of cold frames."""

    @property
    def worst(self) -> float:
        """Of all frames and eyes, dB."""
        return min(min(frame) for frame in self.gains)

    @property
    def below(self) -> int:
        """How many frames lose more than they may in an eye."""
        return sum(min(frame) < -BELOW for frame in self.gains)

    @property
    def mean(self) -> float:
        """Of all frames and eyes, dB."""
        return float(np.mean(self.gains))


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What came of a case, by chain."""

    case: Case
    chains: dict[str, Chain]


def measured(case: Case) -> Outcome:
    """Compute the frames of a case, in chains and by themselves."""
    frames, truth = _rendered(case)
    cold, cold_seconds = _scores(case, frames, truth, "cold")
    chains = {}
    for temporal in CHAINS:
        scores, seconds = _scores(case, frames, truth, temporal)
        gains = tuple(
            tuple(float(ours - other) for ours, other in zip(*both, strict=True))
            for both in zip(scores[1:], cold[1:], strict=True)
        )
        chains[temporal] = Chain(gains=gains, share=seconds / cold_seconds)
    return Outcome(case=case, chains=chains)


def _rendered(case: Case) -> tuple[list[MultiViewFrame], list[list[GreyImage]]]:
    """Return the frames of a case, and what both eyes should be."""
    scene = SampleScene(
        width=case.width, height=case.width * 3 // 4, num_views=NUM_VIEWS, seed=case.seed
    )
    change, numbers = case.change, range(case.change.frames)
    if change.picture is None:
        shown = [_grey(scene, number / scene.fps) for number in numbers]
        frames = [scene.frame(number) for number in numbers]
    else:
        both = list(zip(_grey(scene), _grey(replace(scene, seed=case.seed + 1)), strict=True))
        shown = [[change.picture(*pair, number) for pair in both] for number in numbers]
        frames = [replace(scene.frame(0), frame_index=number) for number in numbers]
    chance = np.random.default_rng(3 + case.seed)
    taken = [[seen(scene.observe(picture), chance) for picture in views] for views in shown]
    films = [filmed(film, case.crf) for film in zip(*taken, strict=True)]
    observed = [
        replace(
            frame,
            views=tuple(
                replace(view, luma=film[number])
                for view, film in zip(frame.views, films, strict=True)
            ),
        )
        for number, frame in enumerate(frames)
    ]
    return observed, [[views[place] for place in scene.reference_views] for views in shown]


def _grey(scene: SampleScene, at: float = 0.0) -> list[GreyImage]:
    pictures = scene.render_all(at)
    return [cv2.cvtColor(one, cv2.COLOR_RGB2GRAY).astype(np.float32) for one in pictures]


def seen(picture: npt.NDArray[Any], chance: np.random.Generator) -> npt.NDArray[np.uint8]:
    """Return a picture of (H, W) grey levels with a camera's noise."""
    noisy = picture + chance.normal(0, NOISE, picture.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def filmed(film: Iterable[npt.NDArray[np.uint8]], crf: int | None) -> list[GreyImage]:
    """Return what is left of a view's pictures in H.264; with None the pictures as they are."""
    if crf is None:
        return [picture.astype(np.float32) for picture in film]
    with tempfile.TemporaryDirectory(prefix="depthsr-bench-") as folder:
        path = Path(folder) / "view.mkv"
        form = VideoFormat.for_path(path, layout=StereoLayout.LEFT, fps=FPS, crf=crf)
        write_segment(path, form, ((picture,) for picture in film), first_frame=0)
        with contextlib.closing(VideoReader(path)) as reader:
            return [reader.picture(number).luma for number in range(reader.num_frames)]


def _scores(
    case: Case,
    frames: Sequence[MultiViewFrame],
    truth: Sequence[Sequence[GreyImage]],
    temporal: str,
) -> tuple[list[list[float]], float]:
    """Return the PSNR of both eyes of each frame, dB, and the seconds of all but the first."""
    settings = Settings(
        psf_sigma=1.0, sampling="decimation", temporal=temporal, threads=1,
        noise_sigma=NOISE if case.is_told else None,
    )  # fmt: skip
    targets = (frames[0].left, frames[0].right)
    worker = Worker(settings, targets=targets)
    scores, seconds = [], 0.0
    for frame, pictures in zip(frames, truth, strict=True):
        begin = time.process_time()
        result = worker.take(frame)
        seconds += (time.process_time() - begin) * (frame.frame_index > 0)
        assert result is not None
        scores.append(
            [
                psnr(result.images[target].luma, picture, border=BORDER)
                for target, picture in zip(targets, pictures, strict=True)
            ]
        )
    return scores, seconds


def outcomes(chosen: Sequence[Case], processes: int) -> Iterator[Outcome]:
    """Measure cases, so many side by side, and yield them in order."""
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(processes, spawn, initializer=_prepare) as pool:
        yield from pool.map(measured, chosen)


def _prepare() -> None:
    """Load or compile what chains need, so that none of them is timed with it."""
    for change in CHANGES[:2]:
        measured(Case(change=replace(change, frames=8), width=96))


def table(found: Iterable[Outcome]) -> Table:
    """Return the rows of one size."""
    rows = []
    for one in found:
        cells = [one.case.change.name]
        cells.append("–" if one.case.crf is None else str(one.case.crf))
        cells.append("given" if one.case.is_told else "estimated")
        for temporal in CHAINS:
            chain = one.chains[temporal]
            below = f"{chain.below} of {len(chain.gains)}" if chain.below else "0"
            cells += [_decibels(chain.worst), below, _decibels(chain.mean), f"{chain.share:.2f}"]
        rows.append(tuple(cells))
    of_chains = [
        f"{temporal}: worst" if number == 0 else name
        for temporal in CHAINS
        for number, name in enumerate(("worst", "below", "mean", "time"))
    ]
    head = ("what changes", "`--crf`", "noise", *of_chains)
    return Table(head=head, rows=tuple(rows), left=("noise",))


def _decibels(gain: float) -> str:
    return f"{gain:+.2f}".replace("-", "−").replace("+0.00", "0.00").replace("−0.00", "0.00")


def page(found: Sequence[Outcome], command: str) -> str:
    """Return all of it, Markdown."""
    chains = [chain for one in found for chain in one.chains.values()]
    below = sum(chain.below for chain in chains)
    total = sum(len(chain.gains) for chain in chains)
    lost = f"more than {BELOW:g} dB below the cold one in an eye"
    verdict = f"**Of {total} frames {below} are {lost}**"
    if not below:
        verdict = f"Of {total} frames none is {lost}"
    worst = min(chain.worst for chain in chains)
    parts = []
    for width in dict.fromkeys(one.case.width for one in found):
        rows = table(one for one in found if one.case.width == width)
        parts.append(f"## {width}×{width * 3 // 4}\n\n{rows.as_markdown()}")
    tables = "\n\n".join(parts)
    return f"""# Where pictures change

Measured on {today()} with `{command}`: {NUM_VIEWS} views of a rendered scene, K = 2, decimation,
σ_psf 1, noise {NOISE:g}, raw (–) or through H.264 of a constant rate factor, the noise given or
estimated. Frames of a chain, but its first, against the same frames computed by themselves
(`--temporal cold`): the worst of either eye, in how many an eye is more than {BELOW:g} dB below,
and the mean, dB; and processor time, of that of cold frames (one thread, {os.cpu_count()} chains
side by side or fewer).

Machine: {described()}.

{verdict}; the worst {_decibels(worst)} dB.

{tables}
"""


def main(arguments: list[str] | None = None) -> int:
    """Measure and print; status 1 where a frame loses more than it may."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.changes", description=__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of scene and noise (default: 0)")
    parser.add_argument("--only", default="", metavar="TEXT", help="changes whose name has it")
    parser.add_argument(
        "--processes", type=int, default=os.cpu_count(), help="side by side (default: %(default)s)"
    )
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the page as Markdown")
    options = parser.parse_args(arguments)
    chosen = cases(options.seed, options.only)
    if not chosen:
        names = ", ".join(change.name for change in CHANGES)
        parser.error(f"--only {options.only}: none of {names}")
    found = []
    for one in outcomes(chosen, options.processes):
        found.append(one)
        worst = min(chain.worst for chain in one.chains.values())
        print(f"{len(found)} of {len(chosen)}: {one.case.change.name}, {_decibels(worst)} dB",
              file=sys.stderr, flush=True)  # fmt: skip
    command = "python -m benchmarks.changes" + (f" --seed {options.seed}" if options.seed else "")
    text = page(found, command)
    print(text)
    if options.write is not None:
        write_atomic(options.write, text.encode())
    return int(any(chain.below for one in found for chain in one.chains.values()))


if __name__ == "__main__":
    sys.exit(main())
