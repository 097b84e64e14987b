"""``python -m benchmarks.video``: what a stream costs, against so many stills.

Ratios of one run: warm and swift against cold frames on the rendered rig, warm ones on ``kitti``
(where ``DEPTHSR_SCENES`` names the folder of the real scenes), two eyes against one, the whole way
from sixteen video files to the side-by-side video, and what holding 15 frames a second leaves out.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.video.stream import VideoStream

from benchmarks.unit import BicubicUnit
from pipeline.config import Settings
from pipeline.degradation import Degradation
from pipeline.evaluate import degraded_input
from pipeline.evaluation.tables import Table, number, signed
from pipeline.frames import GreyImage, MultiViewFrame
from pipeline.job import Job, OutputOptions
from pipeline.machine import described, load_average, today
from pipeline.media.files import write_atomic
from pipeline.media.source import open_scene
from pipeline.metrics import psnr
from pipeline.realtime import account_of
from pipeline.registration.again import AGAIN
from pipeline.run import RunSummary, run_job
from pipeline.synthetic import SampleScene, write_scene
from pipeline.worker import Worker

NOISE = 2.0
"""Grey levels."""

BORDER = 24
"""HR pixels left out when measuring."""

RATE = 15.0
"""Frames a second of Breakdancers."""

Truth = Sequence[Sequence[GreyImage]]
"""By frame, then by target: HR luma."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How much is measured."""

    size: tuple[int, int] = (512, 384)
    """(width, height) of a view, LR pixels."""
    num_views: int = 8
    chain: int = 6
    """Frames of a warm chain; the first is cold and does not count."""
    swift: int = 12
    """Frames of a swift chain; only those that need not be registered count, and of the cold
    ones beside it the same."""
    stream: int = 48
    """Frames of the whole way."""
    rates: tuple[float, ...] = (RATE, 12.0, 10.0, 8.0, 6.0)
    """Frames a second to hold."""


QUICK = Plan(size=(96, 72), num_views=3, chain=3, swift=7, stream=10, rates=(RATE,))
"""Does it work at all?"""


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Frames of one stream, computed one after another."""

    seconds: tuple[float, ...]
    """Wall clock of the frames that count."""
    cpu_seconds: tuple[float, ...]
    psnr: tuple[float, ...]
    """Mean of the targets, dB; of the frames that count."""

    @property
    def middle(self) -> float:
        """Median seconds of a frame."""
        return statistics.median(self.seconds)

    @property
    def cpu(self) -> float:
        """Median processor seconds of a frame."""
        return statistics.median(self.cpu_seconds)


def run_chain(
    frames: Sequence[MultiViewFrame],
    truth: Truth,
    settings: Settings,
    targets: tuple[str, ...],
    first: int = 1,
) -> Chain:
    """Compute a chain of frames; those before the ``first`` do not count."""
    worker = Worker(settings, targets=targets)
    seconds, cpu, quality = [], [], []
    for frame, pictures in zip(frames, truth, strict=True):
        begin, begin_cpu = time.perf_counter(), time.process_time()
        result = worker.take(frame)
        seconds.append(time.perf_counter() - begin)
        cpu.append(time.process_time() - begin_cpu)
        quality.append(_mean_psnr([result.images[name].luma for name in targets], pictures))
    return Chain(
        seconds=tuple(seconds[first:]), cpu_seconds=tuple(cpu[first:]), psnr=tuple(quality[first:])
    )


def _mean_psnr(images: Sequence[GreyImage], truth: Sequence[GreyImage]) -> float:
    border = min(BORDER, min(truth[0].shape) // 4)
    return float(
        np.mean(
            [
                psnr(np.clip(np.rint(image), 0, 255), picture, border=border)
                for image, picture in zip(images, truth, strict=False)
            ]
        )
    )


class VideoBench:
    """Measures; ``rows`` fill on the way."""

    def __init__(self, plan: Plan, threads: int, note: Callable[[str], None]) -> None:
        self._plan, self._note = plan, note
        self._settings = Settings(psf_sigma=1.0, sampling="decimation", threads=threads)
        self._scene = SampleScene(width=plan.size[0], height=plan.size[1], num_views=plan.num_views)
        self._eyes = tuple(self._scene.view_ids[place] for place in self._scene.reference_views)
        self.rows: list[tuple[str, ...]] = []
        self._unit = 0.0

    def table(self) -> Table:
        """Return what was measured."""
        head = ("measured", "seconds", "CPU s", "× bicubic", "PSNR dB", "remark")
        return Table(head=head, rows=tuple(self.rows), left=("remark",))

    def run(self) -> None:
        """Measure everything."""
        self._note("rendering")
        frames = [
            self._scene.frame(number, noise_sigma=NOISE) for number in range(self._plan.swift)
        ]
        truth = [self._truth(number) for number in range(self._plan.swift)]
        first = frames[0]
        self._unit = BicubicUnit([first.view(eye).luma for eye in self._eyes]).seconds()
        self._note("compiling, or loading what is compiled")
        run_chain(frames[:4], truth[:4], replace(self._settings, temporal="warm"), self._eyes)
        chain = self._plan.chain
        both = self._chains("rig", frames[:chain], truth, self._eyes)
        one = self._chains("rig, one eye", frames[:chain], truth, self._eyes[:1])
        for name, two, alone in zip(("cold", "warm"), both, one, strict=True):
            self._row(
                f"two eyes / one eye, {name}", remark=f"{two.cpu / alone.cpu:.2f} × the CPU time"
            )
        self._chains("rig, later", frames, truth, self._eyes, "swift", max(AGAIN) + 1)
        self._kitti()
        with tempfile.TemporaryDirectory(prefix="depthsr-bench-") as folder:
            self._streams(Path(folder))

    def _truth(self, index: int) -> list[GreyImage]:
        return [
            cv2.cvtColor(
                self._scene.render_hr(place, index / self._scene.fps), cv2.COLOR_RGB2GRAY
            ).astype(np.float32)
            for place in self._scene.reference_views
        ]

    def _row(
        self,
        name: str,
        seconds: float = float("nan"),
        cpu: float = float("nan"),
        quality: float = float("nan"),
        remark: str = "",
    ) -> None:
        multiple = seconds / self._unit
        self.rows.append(
            (name, number(seconds, 3), number(cpu, 3), number(multiple, 0), number(quality), remark)
        )

    def _chains(
        self,
        name: str,
        frames: Sequence[MultiViewFrame],
        truth: Truth,
        targets: tuple[str, ...],
        other: str = "warm",
        first: int = 1,
    ) -> tuple[Chain, Chain]:
        """Measure the frames cold and otherwise; those from the ``first`` count."""
        found = []
        for kind in ("cold", other):
            self._note(f"{name}, {kind}")
            settings = replace(self._settings, temporal=kind)
            found.append(run_chain(frames, truth[: len(frames)], settings, targets, first))
        cold, warm = found
        losses = [there - here for here, there in zip(warm.psnr, cold.psnr, strict=True)]
        self._row(f"{name}: cold frame", cold.middle, cold.cpu, float(np.mean(cold.psnr)))
        self._row(
            f"{name}: {other} frame", warm.middle, warm.cpu, float(np.mean(warm.psnr)),
            f"1/{cold.cpu / warm.cpu:.1f} of the cold one's CPU time; the worst frame loses "
            f"{max(losses):.3f} dB",
        )  # fmt: skip
        return cold, warm

    def _kitti(self) -> None:
        scenes = os.environ.get("DEPTHSR_SCENES")
        if scenes is None or not (Path(scenes) / "kitti").is_dir():
            self._row("kitti", remark="not measured: DEPTHSR_SCENES is not set")
            return
        degradation = Degradation(psf_sigma=1.0, psf_support=7, noise_sigma=NOISE)
        with open_scene(Path(scenes) / "kitti") as source:
            numbers = source.info.frame_indices[: self._plan.chain]
            degraded = [degraded_input(source.read(place), degradation) for place in numbers]
            eyes = (source.info.left, source.info.right)
        frames = [item.frame for item in degraded]
        truth = [[item.truth[eye].astype(np.float32) for eye in eyes] for item in degraded]
        self._chains("kitti", frames, truth, eyes)

    # --- the whole way ------------------------------------------------------------------------

    def _streams(self, folder: Path) -> None:
        """Measure from two video files a view to the side-by-side video."""
        count = self._plan.stream
        self._note(f"writing {2 * self._plan.num_views} streams of {count} frames")
        pictures = write_scene(
            folder / "scene", self._scene, num_frames=count, noise_sigma=NOISE,
            sampling=self._settings.grid.sampling, truth=True,
        )  # fmt: skip
        manifest = as_videos(pictures)
        truth = [
            [
                cv2.imread(str(folder / "scene" / "truth" / f"{eye}-{index:06d}.png"), 0).astype(
                    np.float32
                )
                for eye in self._eyes
            ]
            for index in range(count)
        ]
        full = self._whole(
            folder, manifest, "full", truth, replace(self._settings, temporal="warm")
        )
        for rate in self._plan.rates:
            self._held(folder, manifest, truth, rate, full[0])

    def _held(self, folder: Path, manifest: Path, truth: Truth, rate: float, full: float) -> None:
        """Measure what holding a rate leaves of full quality, dB."""
        quality, summary = self._whole(
            folder, manifest, f"{rate:g} frames a second held", truth,
            replace(self._settings, temporal="warm", realtime=True, rate=rate),
        )  # fmt: skip
        account = summary.report["realtime"]
        said = account_of(
            rate,
            ((record["dropped"], record["rung"]) for record in _records(summary)),
            waited=account["waited"],
        )
        self._row(
            "loss to full quality", remark=f"{signed(quality - full)} dB in the mean of all "
            f"frames, {account['dropped']} dropped ones included. {said.sentence()}",
        )  # fmt: skip

    def _whole(
        self, folder: Path, manifest: Path, name: str, truth: Truth, settings: Settings
    ) -> tuple[float, RunSummary]:
        self._note(f"the whole way, {name}")
        place = folder / name.replace(" ", "-")
        place.mkdir()
        begin, begin_cpu = time.perf_counter(), time.process_time()
        job = Job(scene=manifest, settings=settings, output=OutputOptions(output=place / "o.mkv"))
        summary = run_job(job)
        seconds, cpu = time.perf_counter() - begin, time.process_time() - begin_cpu
        quality = _video_psnr(place / "o.mkv", truth)
        count = len(truth)
        self._row(
            f"the whole way, {name}", seconds / count, cpu / count, quality,
            f"{2 * self._plan.num_views} video files in, H.264 side by side out: "
            f"{count / seconds:.2f} frames a second",
        )  # fmt: skip
        return quality, summary


def _records(summary: RunSummary) -> list[dict[str, Any]]:
    return [frame["realtime"] for frame in summary.report["frames"]]


def as_videos(manifest: Path) -> Path:
    """Write the pictures of a scene as one colour and one depth video a view.

    Returns
    -------
    Path
        The new manifest, beside the old one.
    """
    content = json.loads(manifest.read_text(encoding="utf-8"))
    folder = manifest.parent
    for view in content["views"]:
        for kind, codec, layout in (("color", "libx264", "yuv420p"), ("depth", "ffv1", "gray")):
            name = f"{view['id']}-{kind}.mkv"
            with av.open(str(folder / name), "w") as container:
                options = {"crf": "8", "preset": "veryfast"} if codec == "libx264" else {}
                stream = container.add_stream(codec, rate=15, options=options)
                assert isinstance(stream, VideoStream)
                for index in range(content["frame_count"]):
                    picture = cv2.imread(str(folder / (view[kind] % index)), cv2.IMREAD_UNCHANGED)
                    if index == 0:
                        stream.height, stream.width = picture.shape[:2]
                        stream.pix_fmt = layout
                    form = "bgr24" if picture.ndim == 3 else "gray"
                    frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), form)
                    container.mux(stream.encode(frame.reformat(format=layout)))
                container.mux(stream.encode(None))
            view[kind] = name
    path = folder / "videos.json"
    path.write_text(json.dumps(content), encoding="utf-8")
    return path


def _video_psnr(path: Path, truth: Truth) -> float:
    """Return the mean PSNR of both eyes of a side-by-side video, dB, as a viewer gets it."""
    found = []
    with av.open(str(path)) as container:
        for frame, pictures in zip(container.decode(video=0), truth, strict=True):
            luma = cv2.cvtColor(frame.to_ndarray(format="bgr24"), cv2.COLOR_BGR2GRAY)
            found.append(_mean_psnr(np.split(luma.astype(np.float32), 2, axis=1), pictures))
    return float(np.mean(found))


def page(bench: VideoBench, plan: Plan, threads: int) -> str:
    """Return what was measured as Markdown."""
    width, height = plan.size
    return f"""Measured on {today()} with `python -m benchmarks.video` (`make bench`).

Machine: {described()}; {threads} threads; load average {load_average():.1f} at the end.

{plan.num_views} views {width}×{height} → {2 * width}×{2 * height}, noise {NOISE:g}, both eyes
unless said otherwise; medians over the {plan.chain - 1} frames after the first of a chain, of a
swift one over those that are not registered;
× bicubic is the unit of [benchmarks.md](benchmarks.md).

{bench.table().as_markdown()}
"""


def main(arguments: list[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.video", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="tiny sizes: does it work at all?")
    parser.add_argument("--threads", type=int, default=2, help="threads (default: %(default)s)")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the table as Markdown")
    options = parser.parse_args(arguments)
    begin = time.perf_counter()

    def note(what: str) -> None:
        print(f"[{time.perf_counter() - begin:5.0f} s] {what}", file=sys.stderr, flush=True)

    plan = QUICK if options.quick else Plan()
    bench = VideoBench(plan, options.threads, note)
    bench.run()
    print(described())
    print(bench.table().as_text())
    if options.write is not None:
        write_atomic(options.write, page(bench, plan, options.threads).encode())
    return 0


if __name__ == "__main__":
    sys.exit(main())
