"""Pictures of what happened inside a frame, for ``--debug-dir``: what was trusted, and why not.

Per reference view and frame: depth layers and patches of every view, registration
weights (thesis Figure 12), verification with the reason of each rejection, the
weight the solver gave, how much each HR pixel was told, and crops before and after.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from pipeline import drawing
from pipeline.baselines import bicubic, nearest
from pipeline.drawing import Canvas, Colour
from pipeline.frames import RegisteredView, Rejection
from pipeline.grid import Grid
from pipeline.results import FrameResult, SuperResolvedImage, TargetDebug

PANEL_WIDTH = 420
"""Of one view's picture, pixels at most."""

PANEL_HEIGHT = 420

COLUMNS = 4
"""Views in a row."""

WEIGHT_LIMIT = 24.0
"""Grey levels at the ends of the registration weights' colours."""

CROP_SIZE = 72
"""Side of a before/after crop, HR pixels."""

NUM_CROPS = 3

CROP_FACTOR = 4
"""Enlargement of the crops."""

TRUSTED: Colour = (46, 125, 80)

REASONS: tuple[tuple[Rejection, Colour, str], ...] = (
    (Rejection.NO_MOTION, (60, 60, 66), "no motion"),
    (Rejection.OUTSIDE, (176, 180, 188), "outside the reference"),
    (Rejection.OCCLUDED, (123, 63, 160), "occluded"),
    (Rejection.DEPTH, (38, 102, 190), "depth differs"),
    (Rejection.EDGE, (0, 160, 170), "beside a depth edge"),
    (Rejection.WEIGHT, (205, 52, 48), "registration weight"),
    (Rejection.RESIDUAL, (240, 150, 30), "residual"),
)
"""Colour and name of each reason; a pixel with several shows the first of this list."""


def write_debug_pictures(
    folder: Path, result: FrameResult, grid: Grid, *, check: Callable[[], None] = lambda: None
) -> list[Path]:
    """Write the pictures of a frame, and return their paths.

    Parameters
    ----------
    folder : Path
        An existing folder.
    result : FrameResult
        With intermediates.
    grid : Grid
        The HR grid of its images.
    check : callable
        Called before each picture is drawn; it raises what is to end the work.
    """
    written = []
    for view_id, debug in result.debug.items():
        safe = re.sub(r"[^\w.-]", "_", view_id)
        for name, draw in _pictures(result.images[view_id], grid).items():
            check()
            picture = draw(debug)
            if picture is not None:
                path = folder / f"frame-{result.frame_index:06d}-{safe}-{name}.png"
                drawing.save(path, drawing.framed(picture))
                written.append(path)
    return written


def _pictures(
    image: SuperResolvedImage, grid: Grid
) -> dict[str, Callable[[TargetDebug], Canvas | None]]:
    """Return what draws each picture, by its name."""
    return {
        "layers": layers_picture,
        "patches": patches_picture,
        "registration-weights": registration_weights_picture,
        "verification": verification_picture,
        "solver-weights": solver_weights_picture,
        "contributions": contribution_picture,
        "before-after": lambda debug: before_after_picture(debug, image, grid),
    }


def layers_picture(debug: TargetDebug) -> Canvas | None:
    """Return every view tinted by depth layer (thesis Eq. 1)."""
    return _labels_picture(debug, debug.layer_labels, "Depth layers", "layers")


def patches_picture(debug: TargetDebug) -> Canvas | None:
    """Return every view tinted by patch: a sub-region of a layer (thesis §2.2)."""
    return _labels_picture(debug, debug.patch_labels, "Patches", "patches")


def registration_weights_picture(debug: TargetDebug) -> Canvas | None:
    """Return the signed registration weights of every view (thesis Eq. 3, Figure 12)."""

    def panel(view: RegisteredView) -> tuple[Canvas, str]:
        values = np.where(view.flags & Rejection.NO_MOTION, np.nan, view.registration_weights)
        known = np.abs(values[np.isfinite(values)])
        median = f"median {np.median(known):.1f}" if known.size else "none registered"
        return drawing.diverging(values, WEIGHT_LIMIT), f"{view.view_id}: {median}"

    strip = drawing.diverging(np.linspace(-1, 1, 256)[np.newaxis], 1.0)
    bar = drawing.colour_bar(strip, f"−{WEIGHT_LIMIT:g}", f"+{WEIGHT_LIMIT:g} grey levels")
    return _views_picture(
        _others(debug), panel, f"Registration weights onto {debug.view_id}",
        "reference minus view, after registration: white is a good match, grey has no motion", bar,
    )  # fmt: skip


def verification_picture(debug: TargetDebug) -> Canvas | None:
    """Return which pixels are trusted, and why the others are not (thesis Eq. 4)."""

    def panel(view: RegisteredView) -> tuple[Canvas, str]:
        share = 100 * float(np.mean(view.flags == 0))
        return verification_colours(view.flags, view.observed), f"{view.view_id}: {share:.0f} %"

    entries = [(TRUSTED, "trusted"), *((colour, name) for _, colour, name in REASONS)]
    return _views_picture(
        _others(debug), panel, f"Verification onto {debug.view_id}",
        "which pixels are trusted, and the first reason why others are not",
        drawing.legend(entries),
    )  # fmt: skip


def verification_colours(
    flags: npt.NDArray[np.uint8], image: npt.NDArray[np.float32] | None = None
) -> Canvas:
    """Return the colour of each pixel's verdict, (H, W, 3), shaded by the image."""
    canvas = np.empty((*flags.shape, 3), np.float32)
    canvas[:] = TRUSTED
    for reason, colour, _ in reversed(REASONS):
        canvas[(flags & reason.value) != 0] = colour
    if image is not None:
        canvas *= 0.6 + 0.5 * (image[..., np.newaxis] / 255)
    return np.clip(canvas, 0, 255).astype(np.uint8)


def solver_weights_picture(debug: TargetDebug) -> Canvas | None:
    """Return the weight the solver gave each LR pixel of each view, 0..1."""
    weight_of = dict(zip((v.view_id for v in debug.registered), debug.weights, strict=True))

    def panel(view: RegisteredView) -> tuple[Canvas, str]:
        weights = weight_of[view.view_id]
        return drawing.heat(weights, 1.0), f"{view.view_id}: mean {float(weights.mean()):.2f}"

    strip = drawing.heat(np.linspace(0, 1, 256)[np.newaxis], 1.0)
    return _views_picture(
        debug.registered, panel, f"Weights in the reconstruction of {debug.view_id}",
        "0: the pixel was left out; 1: it counts in full", drawing.colour_bar(strip, "0", "1"),
    )  # fmt: skip


def contribution_picture(debug: TargetDebug) -> Canvas:
    """Return how much observation each HR pixel received (thesis §3.2)."""
    count = debug.contribution_count
    highest = max(1.0, float(np.percentile(count, 99.5)))
    canvas = drawing.fitted(drawing.heat(count, highest), 1200, 900)
    strip = drawing.heat(np.linspace(0, 1, 256)[np.newaxis], 1.0)
    empty = 100 * float(np.mean(count <= 0))
    return drawing.below(
        [
            drawing.heading(
                f"Contributions to {debug.view_id}",
                f"weight of the observations at each HR pixel: mean {float(count.mean()):.2f}, "
                f"none at {empty:.1f} %",
            ),
            canvas,
            drawing.colour_bar(strip, "0", f"{highest:.1f} observations"),
        ]
    )


def before_after_picture(
    debug: TargetDebug, image: SuperResolvedImage, grid: Grid
) -> Canvas | None:
    """Return crops of the LR picture, of bicubic and of super-resolution, side by side."""
    reference = next((view for view in debug.registered if view.is_reference), None)
    if reference is None:
        return None
    columns = {
        "low resolution": nearest(reference.observed, grid),
        "bicubic": bicubic(reference.observed, grid),
        "super-resolution": image.luma,
    }
    return drawing.below(
        [
            drawing.heading(
                f"Before and after: {debug.view_id}", "where the difference is largest"
            ),
            crops_picture(columns, choose_crops(columns["bicubic"], image.luma)),
        ]
    )


def choose_crops(
    before: npt.NDArray[np.float32],
    after: npt.NDArray[np.float32],
    *,
    size: int = CROP_SIZE,
    count: int = NUM_CROPS,
) -> list[tuple[int, int, int, int]]:
    """Return (top, left, height, width) of windows apart from each other that differ most."""
    height, width = before.shape[:2]
    tall, wide = min(size, height), min(size, width)
    difference = np.abs(after - before).astype(np.float64)
    total = np.zeros((height + 1, width + 1))
    total[1:, 1:] = difference.cumsum(0).cumsum(1)
    sums = total[tall:, wide:] - total[:-tall, wide:] - total[tall:, :-wide] + total[:-tall, :-wide]
    crops: list[tuple[int, int, int, int]] = []
    for _ in range(count):
        top, left = np.unravel_index(int(np.argmax(sums)), sums.shape)
        if sums[top, left] < 0:
            break
        crops.append((int(top), int(left), tall, wide))
        sums[max(0, top - tall) : top + tall, max(0, left - wide) : left + wide] = -1
    return crops


def crops_picture(
    columns: dict[str, npt.NDArray],
    crops: Sequence[tuple[int, int, int, int]],
    *,
    factor: int = CROP_FACTOR,
) -> Canvas:
    """Return the same crops of several pictures: a column a picture, a row a crop.

    Parameters
    ----------
    columns : dict
        By title: (H, W) grey or (H, W, 3) RGB, 0..255, all of one size.
    crops : sequence
        (top, left, height, width), pixels.
    factor : int
        Enlargement by repetition.
    """
    panels = []
    for row, (top, left, height, width) in enumerate(crops):
        for title, picture in columns.items():
            window = picture[top : top + height, left : left + width]
            if window.ndim == 2:
                canvas = drawing.grey_canvas(window)
            else:
                canvas = np.clip(np.rint(window), 0, 255).astype(np.uint8)
            canvas = drawing.enlarged(canvas, factor)
            panels.append(drawing.titled(canvas, title) if row == 0 else canvas)
    return drawing.tiled(panels, len(columns))


def _labels_picture(
    debug: TargetDebug, labels: Mapping[str, npt.NDArray[np.int32]], title: str, noun: str
) -> Canvas | None:
    views = [view for view in debug.registered if view.view_id in labels]

    def panel(view: RegisteredView) -> tuple[Canvas, str]:
        of_view = labels[view.view_id]
        count = len(np.unique(of_view[of_view >= 0]))
        return drawing.tinted(view.observed, of_view), f"{view.view_id}: {count} {noun}"

    return _views_picture(views, panel, title, "dark: in none", None)


def _others(debug: TargetDebug) -> list[RegisteredView]:
    return [view for view in debug.registered if not view.is_reference]


def _views_picture(
    views: Sequence[RegisteredView],
    panel: Callable[[RegisteredView], tuple[Canvas, str]],
    title: str,
    note: str,
    key: Canvas | None,
) -> Canvas | None:
    """Return one panel a view under a heading; None where there is no view."""
    if not views:
        return None
    panels = []
    for view in views:
        canvas, caption = panel(view)
        panels.append(drawing.titled(drawing.fitted(canvas, PANEL_WIDTH, PANEL_HEIGHT), caption))
    parts = [drawing.heading(title, note), drawing.tiled(panels, COLUMNS)]
    return drawing.below(parts if key is None else [*parts, key])
