"""The demonstration: a scene of our own, super-resolved, with the truth beside it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from pipeline import drawing
from pipeline.baselines import bicubic, nearest
from pipeline.colour import to_rgb
from pipeline.compile_beside import compiling_beside
from pipeline.config import Settings
from pipeline.debug_pictures import choose_crops, crops_picture
from pipeline.events import Event
from pipeline.frames import MultiViewFrame
from pipeline.job import Job, OutputOptions
from pipeline.media.files import check_folder_writable
from pipeline.media.png import png_path, write_png
from pipeline.metrics import psnr
from pipeline.results import FrameResult, SuperResolvedImage, WholeColour
from pipeline.run import Tools, run_job
from pipeline.stop import StopFlag
from pipeline.superresolve import RegisteredFrame, superresolve
from pipeline.synthetic import SampleScene, write_scene
from pipeline.threads import set_threads
from pipeline.worker import Worker

WIDTH, HEIGHT, NUM_VIEWS = 256, 192, 8
"""LR pixels; cameras."""

NUM_FRAMES = 24

NOISE_SIGMA = 1.0
"""Of the cameras, grey levels."""

BORDER = 24
"""HR pixels left out when measuring."""

MEASURED_EVERY = 8
"""Frames from one that is measured to the next."""

METHODS = ("bicubic", "single view", "all views")

SET1 = {"original": "truth", "bicubic": "bicubic", "sr": "all views"}
"""What people can compare, after the thesis' Set 1: conditions, and what each is made of here."""


@dataclass(frozen=True, kw_only=True)
class DemoSize:
    """How large the demonstration is; smaller in tests."""

    width: int = WIDTH
    """LR pixels."""
    height: int = HEIGHT
    """LR pixels."""
    num_views: int = NUM_VIEWS
    num_frames: int = NUM_FRAMES


@dataclass(frozen=True, kw_only=True)
class DemoResult:
    """What the demonstration shows."""

    size: DemoSize
    psnr: dict[str, float]
    """Mean PSNR of the left eye's luma over the measured frames by method, dB."""
    measured: tuple[int, ...]
    """Frames measured."""
    seconds: float
    """Of everything."""
    scene: Path
    """Folder of the LR scene, for trying other settings on it."""
    video: Path
    picture: Path
    set1: Path
    """Folder of a folder for each condition of :data:`SET1`, with pictures of both eyes."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Measured:
    """One frame with its truth, RGB and 0..255."""

    frame_index: int
    pictures: dict[str, npt.NDArray[np.uint8]]
    """Of the left eye, by method, and ``low resolution`` and ``truth``."""
    right: dict[str, npt.NDArray[np.uint8]]
    """Of the right eye, what :data:`SET1` needs."""
    psnr: dict[str, float]


def run_demo(
    folder: Path,
    *,
    size: DemoSize | None = None,
    threads: int = 0,
    on_event: Callable[[Event], None] = lambda _: None,
    on_note: Callable[[str], None] = lambda _: None,
    stop: StopFlag | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> DemoResult:
    """Render the sample scene, super-resolve it, and measure what that brings.

    Parameters
    ----------
    folder : Path
        Where the video and the picture go; made if it is not there.
    size : DemoSize, optional
        How much of it.
    threads : int
        As in :class:`Settings`.
    on_event : callable
        Told of the job's events.
    on_note : callable
        Told what is being done otherwise.
    stop : StopFlag, optional
        Ends it soon when set.
    clock : callable
        Seconds.
    """
    begin = clock()
    size = size or DemoSize()
    stop = stop or StopFlag()
    check_folder_writable(folder)
    scene = SampleScene(width=size.width, height=size.height, num_views=size.num_views)
    settings = Settings(threads=threads)
    measured: list[_Measured] = []

    class Watched(Worker):
        def reconstruct(self, registered: RegisteredFrame) -> FrameResult:
            result = super().reconstruct(registered)
            if result.frame_index % MEASURED_EVERY == 0:
                measured.append(_measure(scene, registered.frame, result, settings))
            return result

    video = folder / "side-by-side.mkv"
    on_note(f"rendering {size.num_frames} frames of {size.num_views} views")
    set_threads(threads)
    with stop.breakable(), compiling_beside():
        manifest = write_scene(
            folder / "scene", scene, num_frames=size.num_frames, noise_sigma=NOISE_SIGMA,
            sampling=settings.grid.sampling,
        )  # fmt: skip
    run_job(
        Job(
            scene=manifest,
            settings=settings,
            output=OutputOptions(output=video, segment_length=size.num_frames),
        ),
        on_event=on_event,
        stop=stop,
        tools=Tools(make_worker=Watched),
    )
    means = {method: float(np.mean([item.psnr[method] for item in measured])) for method in METHODS}
    picture = folder / "before-after.png"
    best = max(measured, key=lambda item: item.psnr["all views"] - item.psnr["bicubic"])
    drawing.save(picture, demo_picture(best, size))
    return DemoResult(
        size=size,
        psnr=means,
        measured=tuple(item.frame_index for item in measured),
        seconds=clock() - begin,
        scene=manifest.parent,
        video=video,
        picture=picture,
        set1=_write_set1(folder / "set1", measured),
    )


def demo_picture(measured: _Measured, size: DemoSize) -> drawing.Canvas:
    """Return crops of the input, bicubic, super-resolution and the truth, with their PSNR."""
    pictures = measured.pictures
    columns = {
        f"input, {size.width}×{size.height}": pictures["low resolution"],
        f"bicubic, {measured.psnr['bicubic']:.1f} dB": pictures["bicubic"],
        f"super-resolution, {measured.psnr['all views']:.1f} dB": pictures["all views"],
        "truth": pictures["truth"],
    }
    grey = {
        name: cv2.cvtColor(pictures[name], cv2.COLOR_RGB2GRAY).astype(np.float32)
        for name in ("bicubic", "all views")
    }
    crops = choose_crops(grey["bicubic"], grey["all views"])
    note = (
        f"{size.num_views} noisy views of {size.width}×{size.height} → "
        f"{pictures['truth'].shape[1]}×{pictures['truth'].shape[0]}; one view alone gives "
        f"{measured.psnr['single view']:.1f} dB (left eye, frame {measured.frame_index})"
    )
    return drawing.framed(
        drawing.below(
            [drawing.heading("What the other views bring", note), crops_picture(columns, crops)]
        )
    )


def format_demo(result: DemoResult) -> str:
    """Return what the demonstration has shown, as text."""
    base = result.psnr["bicubic"]
    lines = [f"PSNR of the left eye's luma, mean of {len(result.measured)} frames:"]
    names = {
        "bicubic": "bicubic",
        "single view": "super-resolution of one view",
        "all views": f"super-resolution of {result.size.num_views} views",
    }
    width = max(map(len, names.values()))
    for method in METHODS:
        value = result.psnr[method]
        gain = "" if method == "bicubic" else f"  ({round(value - base, 2) + 0.0:+.2f} dB)"
        lines.append(f"  {names[method]:<{width}}  {value:6.2f} dB{gain}")
    return "\n".join(lines)


def _measure(
    scene: SampleScene, frame: MultiViewFrame, result: FrameResult, settings: Settings
) -> _Measured:
    """Compare the left eye with the truth."""
    view_id, grid = frame.left, settings.grid
    view, other = frame.view(view_id), frame.view(frame.right)
    rgb, other_rgb = (
        np.array(scene.render_hr(scene.view_ids.index(one), frame.frame_index / scene.fps))
        for one in (frame.left, frame.right)
    )
    truth = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    single = superresolve(frame, settings, targets=(view_id,), observed_views=(view_id,))
    images: dict[str, SuperResolvedImage] = {
        "bicubic": _enlarged(view_id, view.luma, view.chroma, grid, bicubic),
        "low resolution": _enlarged(view_id, view.luma, view.chroma, grid, nearest),
        "single view": single.images[view_id],
        "all views": result.images[view_id],
    }
    values = {
        method: psnr(np.clip(np.rint(images[method].luma), 0, 255), truth, border=_border(truth))
        for method in METHODS
    }
    right = {
        "bicubic": _enlarged(frame.right, other.luma, other.chroma, grid, bicubic),
        "all views": result.images[frame.right],
    }
    return _Measured(
        frame_index=frame.frame_index, pictures={**_rgb(images), "truth": rgb},
        right={**_rgb(right), "truth": other_rgb}, psnr=values,
    )  # fmt: skip


def _rgb(images: Mapping[str, SuperResolvedImage]) -> dict[str, npt.NDArray[np.uint8]]:
    return {name: to_rgb(image.luma, image.chroma, 8) for name, image in images.items()}


def _write_set1(folder: Path, measured: Iterable[_Measured]) -> Path:
    """Write both eyes of the measured frames, a folder for each condition; return the folder."""
    for condition, name in SET1.items():
        (folder / condition).mkdir(parents=True, exist_ok=True)
        for one in measured:
            for eye, pictures in (("left", one.pictures), ("right", one.right)):
                write_png(png_path(folder / condition, eye, one.frame_index), pictures[name])
    return folder


def _enlarged(
    view_id: str,
    luma: npt.NDArray[np.float32],
    chroma: npt.NDArray[np.float32] | None,
    grid: Any,
    method: Callable[..., npt.NDArray[np.float32]],
) -> SuperResolvedImage:
    return SuperResolvedImage(
        view_id=view_id,
        luma=method(luma, grid),
        colour=None if chroma is None else WholeColour(chroma=method(chroma, grid)),
    )


def _border(truth: npt.NDArray) -> int:
    return min(BORDER, min(truth.shape) // 4)
