"""Compile every kernel that a job may need, by doing very small jobs of every kind.

For installations whose users cannot write to the cache, and for containers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.config import REGISTRATION_PRESETS, Settings, Solver
from pipeline.effort import Effort
from pipeline.frames import MultiViewFrame, Place, View
from pipeline.media.coded import coded
from pipeline.media.ycbcr import YcbcrMatrix
from pipeline.media.yuv import Range, parse_pixel_format, picture_from_planes
from pipeline.registration.again import AGAIN
from pipeline.registration.inverse import inverted
from pipeline.registration.register import prepare_views, register_view
from pipeline.superresolve import superresolve, terms_of
from pipeline.synthetic import SampleScene
from pipeline.temporal.still import first_seen, seen_again
from pipeline.view_at import with_view_between
from pipeline.worker import Worker

WIDTH, HEIGHT, NUM_VIEWS = 96, 72, 3
"""Of the small frames, LR pixels: large enough for patches, pyramids and a PSF."""

NUM_FRAMES = 3
"""Of the small stream."""


def kinds_of_settings() -> dict[str, Settings]:
    """Return settings that between them reach every kernel, by what they are for."""
    kinds = {f"solver {solver.value}": Settings(solver=solver.value, sweeps=1) for solver in Solver}
    for preset in REGISTRATION_PRESETS:
        kinds[f"registration {preset}"] = Settings(registration=preset)
    kinds["magnification 2x1"] = Settings(magnification="2x1")
    kinds["magnification 3, decimation"] = Settings(magnification="3", sampling="decimation")
    kinds["colour"] = Settings(chroma="sr")
    return kinds


def compile_kernels(on_step: Callable[[str], None] = lambda _: None) -> int:
    """Do one small job of every kind; return their number.

    Parameters
    ----------
    on_step : callable
        Told what is being compiled for.
    """
    on_step("the sample scene")
    scene = SampleScene(width=WIDTH, height=HEIGHT, num_views=NUM_VIEWS)
    frame = scene.frame(0, calibration=True, color=True, noise_sigma=1.0)
    kinds = kinds_of_settings()
    for name, settings in kinds.items():
        on_step(name)
        superresolve(
            frame, settings, targets=(frame.left, frame.right), keep_intermediates=True
        )  # fmt: skip
    on_step("a single view")
    superresolve(frame, Settings(), targets=(frame.left,), observed_views=(frame.left,))
    on_step("a camera that moves")
    _invert_a_motion(frame)
    on_step("a film that is coded")
    luma = frame.view(frame.left).luma
    seen_again(luma, first_seen(luma), 1.0)
    _do_coded(scene)
    on_step("a stream, a view between")
    _do_stream(scene)
    on_step("a video in real time")
    view = frame.view(frame.left)
    assert view.chroma is not None  # it was asked for
    for colour in (view.chroma, np.ascontiguousarray(view.chroma[::2, ::2])):
        planes = coded(view.luma, colour, YcbcrMatrix.BT709).planes
    picture_from_planes(planes, parse_pixel_format("yuv420p"), YcbcrMatrix.BT601, Range.LIMITED)
    return len(kinds) + 6


def _invert_a_motion(frame: MultiViewFrame) -> None:
    """Register one eye onto the other, and that one by what was found."""
    prepared = prepare_views(frame.views, metric=True)
    source, reference = prepared[frame.left], prepared[frame.right]
    lead = register_view(source, reference, terms_of(Settings(), 1.0))
    inverted(lead, source.fine.nearness, reference.fine.nearness)


def _do_coded(scene: SampleScene) -> None:
    """Super-resolve two frames of a file, of which the second goes on from the first."""
    worker = Worker(Settings(temporal="warm", noise_sigma=1.0), targets=("cam0", "cam1"))
    for index in range(2):
        worker.take(scene.frame(0, noise_sigma=1.0, noise_seed=index))


def _do_stream(scene: SampleScene) -> None:
    """Super-resolve frames of a fixed rig and a stereo matcher, each from the last.

    In the last of them a part is another: that part alone is registered and solved again, there
    being so little noise from the reference alone first.
    """
    settings = Settings(temporal="warm", noise_sigma=0.5)
    _do_swift(scene)
    left, right = "cam0", "cam1"
    worker = Worker(settings, targets=(left, right), keep_intermediates=True)
    for index in range(NUM_FRAMES):
        frame = scene.frame(noise_sigma=1.0, noise_seed=index, depth="stereo")
        if index == NUM_FRAMES - 1:
            frame = _partly_negative(frame)
        result = worker.take(frame)
    with_view_between(
        result, frame, Place(left=left, right=right, at=0.5), "between", settings.grid
    )


def _do_swift(scene: SampleScene) -> None:
    """Super-resolve frames of a fixed rig until what changes lands by its depth maps.

    In the last one it is followed in each eye alone.
    """
    worker = Worker(Settings(temporal="swift", noise_sigma=1.0), targets=("cam0", "cam1"))
    for index in range(1, max(AGAIN) + 3):
        frame = scene.frame(noise_sigma=1.0, noise_seed=index)
        last = index == max(AGAIN) + 2
        worker.take(replace(_partly_negative(frame) if last else frame, frame_index=index))
    worker.take(replace(frame, frame_index=index + 1), effort=Effort(alone=True))


def _partly_negative(frame: MultiViewFrame) -> MultiViewFrame:
    """Return the frame with the left quarter of every view's luma turned round."""

    def turned(view: View) -> View:
        luma = view.luma.copy()
        luma[:, : WIDTH // 4] = 255 - luma[:, : WIDTH // 4]
        return replace(view, luma=luma)

    return replace(frame, views=tuple(map(turned, frame.views)))
