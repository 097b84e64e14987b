"""Compile every kernel that a job may need, by doing very small jobs of every kind.

For installations whose users cannot write to the cache, and for containers.
"""

from __future__ import annotations

from collections.abc import Callable

from pipeline.config import REGISTRATION_PRESETS, Settings, Solver
from pipeline.superresolve import superresolve
from pipeline.synthetic import SampleScene

WIDTH, HEIGHT, NUM_VIEWS = 96, 72, 3
"""Of the small frames, LR pixels: large enough for patches, pyramids and a PSF."""


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
    return len(kinds) + 2
