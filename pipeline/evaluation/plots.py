"""Plots of reports as SVG, all in one hand; the only importer of matplotlib in the pipeline."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib import rcsetup
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5b5b5b", "#000000")
"""Of Okabe and Ito: told apart with any colour vision."""

STYLE: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e4e4e4",
    "grid.linewidth": 0.8,
    "axes.prop_cycle": rcsetup.cycler(color=COLOURS),
    "legend.frameon": False,
    "svg.fonttype": "none",
    "svg.hashsalt": "depthsr",
}
"""Text stays text; the same numbers give the same bytes."""


@contextmanager
def _axes(width: float, height: float, into: list[bytes]) -> Iterator[Axes]:
    """Give axes in the house's hand, and append their SVG when they are done."""
    with mpl.rc_context(STYLE):
        canvas = Canvas(figsize=(width, height), layout="constrained")
        yield canvas.add_subplot()
        stream = io.BytesIO()
        canvas.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
        into.append(stream.getvalue())


def lines(
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    *,
    x_label: str,
    y_label: str,
    marks: Mapping[str, float] | None = None,
    marks_of_curves: Sequence[float] = (),
    log_y: bool = False,
    size: tuple[float, float] = (7.2, 4.0),
) -> bytes:
    """Return curves through points, by name; upright lines at the marks.

    ``marks_of_curves`` are marks in the colours of the curves, one for each.
    """
    made: list[bytes] = []
    with _axes(*size, made) as axes:
        for name, (x, y) in curves.items():
            axes.plot(x, y, label=name, marker="o" if len(x) < 25 else None, markersize=4)
        for line, x_mark in zip(list(axes.lines), marks_of_curves, strict=False):
            axes.axvline(x_mark, color=line.get_color(), linestyle=(0, (4, 2)), linewidth=1.2)
        for number, (name, x_mark) in enumerate((marks or {}).items()):
            axes.axvline(x_mark, color="#444444", linestyle=(0, (4, 2 + 2 * number)), label=name)
        if log_y:
            axes.set_yscale("log")
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        axes.legend()
    return made[0]


def bars(
    groups: Sequence[str],
    values: Mapping[str, Sequence[float]],
    *,
    y_label: str,
    errors: Mapping[str, Sequence[float]] | None = None,
    size: tuple[float, float] | None = None,
) -> bytes:
    """Return bars beside each other: a group each, in it a bar for each name."""
    made: list[bytes] = []
    width = 0.8 / max(len(values), 1)
    size = size or (max(7.2, 1.2 + 0.9 * len(groups) * max(1.0, 0.35 * len(values))), 3.8)
    with _axes(*size, made) as axes:
        place = np.arange(len(groups), dtype=float)
        for number, (name, heights) in enumerate(values.items()):
            offset = (number - (len(values) - 1) / 2) * width
            spread: Any = None if errors is None else errors.get(name)
            axes.bar(place + offset, heights, width * 0.92, label=name, yerr=spread, capsize=2)
        axes.set_xticks(place, groups)
        axes.axhline(0, color="#444444", linewidth=0.8)
        axes.grid(axis="x", visible=False)
        axes.set_ylabel(y_label)
        if len(values) > 1:
            canvas = axes.get_figure()
            assert canvas is not None
            canvas.legend(loc="outside upper left", ncols=min(4, len(values)))
    return made[0]


def spread_bars(
    names: Sequence[str],
    values: Sequence[float],
    *,
    x_label: str,
    marked: Sequence[bool] = (),
    longest: float = float("inf"),
) -> bytes:
    """Return lying bars, one a name, from the top, with their values; marked ones stand out.

    Those longer than ``longest`` are cut off.
    """
    made: list[bytes] = []
    with _axes(7.2, 0.9 + 0.3 * len(names), made) as axes:
        place = np.arange(len(names))
        colours = [
            COLOURS[1] if number < len(marked) and marked[number] else COLOURS[0]
            for number in range(len(names))
        ]
        lengths = np.clip(values, -longest, longest)
        drawn = axes.barh(place, lengths, color=colours, height=0.7)
        axes.bar_label(drawn, [f"{value:.2f}" for value in values], padding=3, fontsize=9)
        axes.margins(x=0.12)
        axes.set_yticks(place, names)
        axes.invert_yaxis()
        axes.axvline(0, color="#444444", linewidth=0.8)
        axes.grid(axis="y", visible=False)
        axes.set_xlabel(x_label)
    return made[0]


def png(picture: npt.NDArray[np.uint8]) -> bytes:
    """Return a picture, (H, W) grey or (H, W, 3) RGB, as PNG."""
    stored = picture if picture.ndim == 2 else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR)
    done, content = cv2.imencode(".png", stored, [cv2.IMWRITE_PNG_COMPRESSION, 9])
    if not done:
        raise ValueError("the picture could not be encoded as PNG")
    return content.tobytes()
