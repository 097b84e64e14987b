"""What pictures for people are put together from: text, panels, bars, curves, colours.

Pictures here are (H, W, 3) uint8 RGB. Nothing here knows of super-resolution.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from pipeline.media.png import write_png

Canvas = npt.NDArray[np.uint8]
"""(H, W, 3) uint8 RGB."""

Colour = tuple[int, int, int]
"""Red, green, blue, 0..255."""

PAPER: Colour = (255, 255, 255)
INK: Colour = (32, 36, 44)
FAINT: Colour = (206, 210, 216)
ACCENT: Colour = (0, 98, 155)

TEXT_SIZE = 15
"""Height of the letters, pixels."""

GAP = 12
"""Between panels, pixels."""

TEXT_WEIGHT = 500
"""Of all text. Without one, letters come out as fat as whoever drew the same letter last."""

TITLE_HEIGHT = 26
"""Of the line above a panel, pixels."""


@functools.cache
def _font() -> cv2.FontFace:
    return cv2.FontFace("sans")


def text_width(text: str, size: int = TEXT_SIZE) -> int:
    """Return the width of a line of text, pixels."""
    return int(cv2.getTextSize((0, 0), text, (0, 0), _font(), size, weight=TEXT_WEIGHT)[2])


def draw_text(
    canvas: Canvas, text: str, x: int, baseline: int, *, size: int = TEXT_SIZE, colour: Colour = INK
) -> None:
    """Write a line of text onto the canvas (modified in place)."""
    cv2.putText(canvas, text, (x, baseline), colour, _font(), size, weight=TEXT_WEIGHT)


def blank(height: int, width: int, colour: Colour = PAPER) -> Canvas:
    """Return an empty canvas."""
    canvas = np.empty((height, width, 3), np.uint8)
    canvas[:] = colour
    return canvas


def grey_canvas(image: npt.NDArray, lowest: float = 0.0, highest: float = 255.0) -> Canvas:
    """Return a grey image as a canvas, its values from lowest to highest as black to white."""
    scaled = (np.nan_to_num(image) - lowest) * (255.0 / max(highest - lowest, 1e-9))
    grey = np.clip(np.rint(scaled), 0, 255).astype(np.uint8)
    return np.repeat(grey[:, :, np.newaxis], 3, axis=2)


def enlarged(canvas: Canvas, factor: int) -> Canvas:
    """Return the canvas with every pixel made a square of that many."""
    return np.repeat(np.repeat(canvas, factor, axis=0), factor, axis=1)


def fitted(canvas: Canvas, largest_width: int, largest_height: int) -> Canvas:
    """Return the canvas made to fit: reduced smoothly, or enlarged by a whole factor."""
    height, width = canvas.shape[:2]
    scale = min(largest_width / width, largest_height / height)
    if scale >= 2:
        return enlarged(canvas, int(scale))
    if scale >= 1:
        return canvas
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return cv2.resize(canvas, size, interpolation=cv2.INTER_AREA)


def titled(canvas: Canvas, title: str, *, size: int = TEXT_SIZE, colour: Colour = INK) -> Canvas:
    """Return the canvas with a line of text above it, shortened to fit."""
    height, width = canvas.shape[:2]
    while len(title) > 1 and text_width(title, size) > width:
        title = title[:-2].rstrip() + "…"
    result = blank(height + TITLE_HEIGHT, width)
    draw_text(result, title, 0, TITLE_HEIGHT - 9, size=size, colour=colour)
    result[TITLE_HEIGHT:] = canvas
    return result


def beside(panels: Sequence[Canvas], gap: int = GAP) -> Canvas:
    """Return the panels side by side, aligned at the top."""
    height = max(panel.shape[0] for panel in panels)
    width = sum(panel.shape[1] for panel in panels) + gap * (len(panels) - 1)
    result, x = blank(height, width), 0
    for panel in panels:
        result[: panel.shape[0], x : x + panel.shape[1]] = panel
        x += panel.shape[1] + gap
    return result


def below(panels: Sequence[Canvas], gap: int = GAP) -> Canvas:
    """Return the panels one below another, aligned at the left."""
    height = sum(panel.shape[0] for panel in panels) + gap * (len(panels) - 1)
    result = blank(height, max(panel.shape[1] for panel in panels))
    y = 0
    for panel in panels:
        result[y : y + panel.shape[0], : panel.shape[1]] = panel
        y += panel.shape[0] + gap
    return result


def tiled(panels: Sequence[Canvas], columns: int) -> Canvas:
    """Return the panels in rows of so many."""
    rows = [beside(panels[start : start + columns]) for start in range(0, len(panels), columns)]
    return below(rows)


def framed(canvas: Canvas, margin: int = 16) -> Canvas:
    """Return the canvas with a margin of paper."""
    return cv2.copyMakeBorder(
        canvas, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=PAPER
    )


def heading(text: str, note: str = "") -> Canvas:
    """Return a heading, with a smaller line under it."""
    width = max(text_width(text, 21), text_width(note)) + 2
    result = blank(34 if not note else 58, width)
    draw_text(result, text, 0, 24, size=21)
    if note:
        draw_text(result, note, 0, 49, colour=(96, 102, 112))
    return result


def label_colours(count: int) -> npt.NDArray[np.uint8]:
    """Return colours that tell neighbours apart, (count, 3) uint8 RGB."""
    number = np.arange(count)
    hsv = np.empty((1, count, 3), np.uint8)
    hsv[0, :, 0] = np.round((number * 0.61803398875 % 1) * 179)  # hues by the golden ratio
    hsv[0, :, 1] = np.where(number // 7 % 2, 150, 225)
    hsv[0, :, 2] = np.where(number // 3 % 2, 190, 245)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0]


def tinted(image: npt.NDArray, labels: npt.NDArray[np.int32], strength: float = 0.55) -> Canvas:
    """Return a grey image tinted by label; where the label is below 0 it stays grey and dark."""
    canvas = grey_canvas(image).astype(np.float32)
    colours = label_colours(max(1, int(labels.max(initial=0)) + 1)).astype(np.float32)
    inside = labels >= 0
    tint = colours[np.clip(labels, 0, None)]
    shade = 0.45 + 0.55 * canvas / 255
    mixed = (1 - strength) * canvas + strength * tint * shade
    return np.where(inside[..., None], mixed, canvas * 0.35).astype(np.uint8)


def diverging(values: npt.NDArray, limit: float) -> Canvas:
    """Return signed values as blue (−limit) through white to red (+limit); NaN is grey."""
    share = np.clip(values / max(limit, 1e-9), -1, 1)
    anchors = np.linspace(-1, 1, 5)
    table = np.array([[5, 48, 97], [103, 169, 207], [250, 250, 250], [239, 138, 98], [128, 0, 32]])
    known = np.nan_to_num(share)
    canvas = np.stack([np.interp(known, anchors, table[:, c]) for c in range(3)], axis=-1)
    canvas[np.isnan(values)] = (150, 150, 150)
    return canvas.astype(np.uint8)


def heat(values: npt.NDArray, highest: float) -> Canvas:
    """Return values from 0 (dark) to the highest (bright), in colours of even brightness steps."""
    share = np.clip(np.nan_to_num(values) / max(highest, 1e-9), 0, 1)
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_VIRIDIS)
    return table.reshape(256, 3)[:, ::-1][np.rint(share * 255).astype(np.uint8)]


def colour_bar(strip: Canvas, low: str, high: str, *, width: int = 320) -> Canvas:
    """Return a bar of colours (any (1, N, 3) strip) with the values at its ends."""
    bar = cv2.resize(strip, (width, 14), interpolation=cv2.INTER_LINEAR)
    result = blank(38, width + text_width(high) // 2 + 2)
    result[:14, :width] = bar
    draw_text(result, low, 0, 32, size=13)
    draw_text(result, high, width - text_width(high, 13), 32, size=13)
    return result


def legend(entries: Sequence[tuple[Colour, str]], *, columns: int = 4) -> Canvas:
    """Return colours with their meanings."""
    cells = []
    for colour, meaning in entries:
        cell = blank(24, 30 + text_width(meaning))
        cell[4:20, 0:20] = colour
        cv2.rectangle(cell, (0, 4), (19, 19), FAINT, 1)
        draw_text(cell, meaning, 28, 18)
        cells.append(cell)
    widest = max(cell.shape[1] for cell in cells)
    padded = [
        cv2.copyMakeBorder(cell, 0, 0, 0, widest - cell.shape[1], cv2.BORDER_CONSTANT, value=PAPER)
        for cell in cells
    ]
    return tiled(padded, columns)


def curve_plot(
    x: Sequence[float],
    y: Sequence[float],
    *,
    title: str,
    x_label: str,
    y_label: str,
    marked: float | None = None,
    width: int = 720,
    height: int = 440,
) -> Canvas:
    """Return a curve through points, with axes; the point at ``marked`` stands out."""
    canvas = blank(height, width)
    left, right, top, bottom = 84, width - 24, 64, height - 60
    xs, ys = np.asarray(x, float), np.asarray(y, float)
    known = np.isfinite(ys)
    xs, ys = xs[known], ys[known]
    draw_text(canvas, title, 20, 32, size=19)
    if xs.size == 0:
        draw_text(canvas, "no values", left, (top + bottom) // 2)
        return canvas
    x_ticks, y_ticks = _ticks(xs.min(), xs.max()), _ticks(ys.min(), ys.max())
    x_low, x_high = min(xs.min(), x_ticks[0]), max(xs.max(), x_ticks[-1])
    y_low, y_high = min(ys.min(), y_ticks[0]), max(ys.max(), y_ticks[-1])

    def place(px: float, py: float) -> tuple[int, int]:
        return (
            round(left + (px - x_low) / max(x_high - x_low, 1e-12) * (right - left)),
            round(bottom - (py - y_low) / max(y_high - y_low, 1e-12) * (bottom - top)),
        )

    for tick in x_ticks:
        column = place(tick, y_low)[0]
        cv2.line(canvas, (column, top), (column, bottom), FAINT, 1)
        text = f"{tick:g}"
        draw_text(canvas, text, column - text_width(text, 13) // 2, bottom + 20, size=13)
    for tick in y_ticks:
        row = place(x_low, tick)[1]
        cv2.line(canvas, (left, row), (right, row), FAINT, 1)
        text = f"{tick:g}"
        draw_text(canvas, text, left - 8 - text_width(text, 13), row + 5, size=13)
    points = np.array([place(*point) for point in zip(xs, ys, strict=True)], np.int32)
    cv2.polylines(canvas, [points.reshape(-1, 1, 2)], False, ACCENT, 2, cv2.LINE_AA)
    for point in points:
        cv2.circle(canvas, tuple(int(v) for v in point), 3, ACCENT, -1, cv2.LINE_AA)
    if marked is not None:
        nearest = int(np.argmin(np.abs(xs - marked)))
        spot = tuple(int(v) for v in points[nearest])
        cv2.circle(canvas, spot, 7, (196, 30, 58), 2, cv2.LINE_AA)
        cv2.line(canvas, (spot[0], spot[1] + 8), (spot[0], bottom), (196, 30, 58), 1, cv2.LINE_AA)
    draw_text(canvas, y_label, 20, 54, size=13, colour=(96, 102, 112))
    draw_text(
        canvas, x_label, (left + right - text_width(x_label)) // 2, height - 14,
        colour=(96, 102, 112),
    )  # fmt: skip
    return canvas


def save(path: Path, canvas: Canvas) -> None:
    """Write the canvas as PNG, whole or not at all."""
    write_png(path, np.ascontiguousarray(canvas))


def _ticks(low: float, high: float, wanted: int = 6) -> list[float]:
    """Return round numbers that span the interval."""
    span = max(high - low, 1e-9 * max(1.0, abs(high)))
    raw = span / wanted
    power = 10.0 ** np.floor(np.log10(raw))
    step = next(m * power for m in (1, 2, 2.5, 5, 10) if m * power >= raw * 0.999)
    first, last = np.floor(low / step + 1e-9), np.ceil(high / step - 1e-9)
    return [round(float(n * step), 12) for n in np.arange(first, last + 1)]
