"""Look of the plots: colours that a colour-blind reader tells apart, marks, axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Of Okabe and Ito (2008), strongest contrast first."""

MARKS = ("o", "s", "D", "^", "v", "P", "X")
DASHES: tuple[Any, ...] = ("-", (0, (6, 2)), (0, (1, 1.2)), (0, (6, 2, 1, 2)), "-", "-", "-")

INK = "#1a1a1a"
PALE = "#d9d9d9"
WIDTH = 7.2
"""Width of a plot [inch]."""


def colour(index: int) -> str:
    """Return the colour of a series."""
    return COLOURS[index % len(COLOURS)]


def mark(index: int) -> str:
    """Return the mark of a series."""
    return MARKS[index % len(MARKS)]


def new_figure(columns: int = 1, height: float = 3.4) -> tuple[Figure, list[Axes]]:
    """Return a figure with its axes side by side, sharing the vertical one."""
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    axes = figure.subplots(1, columns, squeeze=False, sharey=True)[0]
    for one in axes:
        plain(one)
    return figure, list(axes)


def plain(axes: Axes) -> None:
    """Take away what says nothing."""
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color("#8c8c8c")
    axes.tick_params(colors=INK, labelsize=9, length=3, color="#8c8c8c")
    axes.grid(axis="y", color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)


def name_conditions(axes: Axes, names: Sequence[str]) -> None:
    """Write the names of conditions below the axis, turned where they are long or many."""
    longest = max(len(name) for name in names)
    turned = longest * len(names) > 70
    axes.set_xticks(
        range(len(names)),
        [_wrapped(name) for name in names],
        rotation=35 if turned else 0,
        ha="right" if turned else "center",
        rotation_mode="anchor" if turned else "default",
    )
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.grid(axis="x", visible=False)


def _wrapped(name: str, most: int = 16) -> str:
    """Break a long name once, at the space nearest its middle."""
    places = [index for index, letter in enumerate(name) if letter == " "]
    if len(name) <= most or not places:
        return name
    middle = min(places, key=lambda index: abs(index - len(name) / 2))
    return f"{name[:middle]}\n{name[middle + 1 :]}"
