"""``python -m benchmarks.soak``: a long run, whose memory and quality must not drift.

A small rendered scene goes forth and back, so that the first and the last hundred frames of the
video show the same pictures: what differs is what the run has done to itself. The whole way is
run: stages, warm frames, segments, encoder, report.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline.config import Settings
from pipeline.events import Event, FrameFinished
from pipeline.frames import MultiViewFrame
from pipeline.job import Job, OutputOptions
from pipeline.media.source import MemorySource
from pipeline.metrics import psnr
from pipeline.results import FrameResult
from pipeline.run import Tools, run_job
from pipeline.superresolve import RegisteredFrame
from pipeline.synthetic import SampleScene
from pipeline.worker import Worker

NOISE = 2.0
"""Grey levels."""

HUNDRED = 100
"""Frames at either end that are compared; also those that are rendered."""

SETTLED = 200
"""Frames after which memory has to be flat."""

FLAT = 0.05
"""Share by which memory may differ from what it was then."""

DRIFT = 0.05
"""Largest loss of quality from the first hundred frames to the last, dB."""


class ForthAndBack(MemorySource):
    """Few frames as a long video: 0, 1 … n − 1, n − 1 … 0, and so on."""

    def __init__(self, frames: list[MultiViewFrame], count: int, fps: Fraction) -> None:
        super().__init__(frames, fps=fps, path="forth and back")
        self.info = replace(self.info, frame_indices=range(count))

    def read(self, frame_index: int, **what: Any) -> MultiViewFrame:
        """Return a frame; see :class:`pipeline.media.source.FrameSource`."""
        frame = super().read(place_of(frame_index, len(self._frames)), **what)
        return replace(frame, frame_index=frame_index)


def place_of(frame_index: int, count: int) -> int:
    """Return which rendered frame a frame of the video shows.

    >>> [place_of(index, 3) for index in range(8)]
    [0, 1, 2, 2, 1, 0, 0, 1]
    """
    place = frame_index % (2 * count)
    return place if place < count else 2 * count - 1 - place


@dataclass(frozen=True, kw_only=True)
class Soak:
    """What a long run came to."""

    frames: int
    size: tuple[int, int]
    """(width, height) of a view, LR pixels."""
    num_views: int
    seconds: float
    memory: tuple[tuple[int, float], ...]
    """(frames done, resident memory in MiB)."""
    quality: tuple[float, ...]
    """PSNR of the left eye, dB, frame by frame."""

    @property
    def growth(self) -> float:
        """Largest share by which memory differed from what it was when it had settled."""
        settled = [size for done, size in self.memory if done >= min(SETTLED, self.frames // 4)]
        return max(abs(size / settled[0] - 1) for size in settled)

    @property
    def ends(self) -> tuple[float, float]:
        """Mean PSNR of the first and of the last hundred frames, dB."""
        count = min(HUNDRED, self.frames // 2)
        return float(np.mean(self.quality[:count])), float(np.mean(self.quality[-count:]))

    @property
    def drift(self) -> float:
        """What the last hundred frames lost, dB."""
        first, last = self.ends
        return first - last

    @property
    def holds(self) -> bool:
        """Whether memory is flat and quality has not drifted."""
        return self.growth <= FLAT and self.drift <= DRIFT


def soak(frames: int, size: tuple[int, int], num_views: int, note: Any = None) -> Soak:
    """Run ``frames`` frames through a job; ``note`` is told how far it has come."""
    count = min(HUNDRED, frames // 2)
    scene = SampleScene(width=size[0], height=size[1], num_views=num_views)
    rendered = [scene.frame(number, noise_sigma=NOISE) for number in range(count)]
    left = scene.reference_views[0]
    truth = [
        cv2.cvtColor(scene.render_hr(left, number / scene.fps), cv2.COLOR_RGB2GRAY).astype(
            np.float32
        )
        for number in range(count)
    ]
    quality: list[float] = []
    memory: list[tuple[int, float]] = []

    class Measured(Worker):
        def reconstruct(self, registered: RegisteredFrame) -> FrameResult:
            result = super().reconstruct(registered)
            # warm-up frames are made twice: the second time counts
            del quality[result.frame_index :]
            picture = truth[place_of(result.frame_index, count)]
            quality.append(psnr(result.images[scene.view_ids[left]].luma, picture, border=8))
            return result

    def on_event(event: Event) -> None:
        if isinstance(event, FrameFinished) and (event.done % 50 == 0 or event.done == frames):
            memory.append((event.done, resident_mib()))
            if note is not None:
                note(event.done, memory[-1][1])

    with tempfile.TemporaryDirectory(prefix="depthsr-soak-") as name:
        folder = Path(name)
        scene_file = folder / "scene.json"
        scene_file.write_text("{}")
        job = Job(
            scene=scene_file,
            settings=Settings(psf_sigma=1.0, sampling="decimation", temporal="warm"),
            output=OutputOptions(output=folder / "out.mkv", report=folder / "report.json"),
        )
        tools = Tools(
            open_scene=lambda path, **_: ForthAndBack(rendered, frames, Fraction(scene.fps)),
            make_worker=Measured,
        )
        begin = time.perf_counter()
        run_job(job, on_event=on_event, tools=tools)
        seconds = time.perf_counter() - begin
    return Soak(
        frames=frames, size=size, num_views=num_views, seconds=seconds, memory=tuple(memory),
        quality=tuple(quality),
    )  # fmt: skip


def resident_mib() -> float:
    """Return the memory that this process has in use, MiB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / (1 << 20)


def page(result: Soak, command: str) -> str:
    """Return the result as a page, Markdown."""
    from pipeline.machine import described, today

    first, last = result.ends
    step = max(1, len(result.memory) // 10)
    samples = [*result.memory[::step], result.memory[-1]]
    rows = "\n".join(f"| {done} | {size:.0f} |" for done, size in dict(samples).items())
    verdict = "It holds" if result.holds else "**It does not hold**"
    size = f"{result.size[0]}×{result.size[1]}"
    better = "worse" if result.drift > 0 else "better"
    return f"""# A long run

Measured on {today()} with `{command}` (`make soak`): {result.frames} frames, {result.num_views}
views {size}, both eyes, K = 2, noise {NOISE:g}, `--temporal warm`, H.264; {result.seconds:.0f} s.

Machine: {described()}.

The scene goes forth and back, so that the first and the last hundred frames show the same pictures.

{verdict}: after {min(SETTLED, result.frames // 4)} frames the resident memory stayed within
{100 * result.growth:.1f} % (allowed: {100 * FLAT:.0f} %), and the last hundred frames are
{abs(result.drift):.3f} dB {better} than the first ({last:.3f} after {first:.3f} dB, left eye;
allowed: {DRIFT:g} dB worse).

| frames done | resident memory, MiB |
|--:|--:|
{rows}
"""


def main(arguments: list[str] | None = None) -> int:
    """Run it, print what came of it; status 1 where it does not hold."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.soak", description=__doc__)
    parser.add_argument("--frames", type=int, default=2000, help="frames (default: %(default)s)")
    parser.add_argument("--width", type=int, default=96, help="LR pixels (default: %(default)s)")
    parser.add_argument("--height", type=int, default=72, help="LR pixels (default: %(default)s)")
    parser.add_argument("--views", type=int, default=3, help="views (default: %(default)s)")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the page as Markdown")
    options = parser.parse_args(arguments)
    if options.frames < 8:
        parser.error("--frames: must be 8 or more")

    def note(done: int, size: float) -> None:
        print(f"{done} of {options.frames} frames, {size:.0f} MiB", file=sys.stderr, flush=True)

    result = soak(options.frames, (options.width, options.height), options.views, note)
    command = "python -m benchmarks.soak" + (
        "" if options.frames == 2000 else f" --frames {options.frames}"
    )
    text = page(result, command)
    print(text)
    if options.write is not None:
        from pipeline.media.files import write_atomic

        write_atomic(options.write, text.encode())
    return 0 if result.holds else 1


if __name__ == "__main__":
    sys.exit(main())
