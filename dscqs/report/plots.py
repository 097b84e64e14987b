"""The plots of a report: scores by condition, boxes of the votes, assessors, screening."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from dscqs.report.numbers import figure_of
from dscqs.report.style import (
    DASHES,
    INK,
    PALE,
    WIDTH,
    colour,
    mark,
    name_conditions,
    new_figure,
    plain,
)  # fmt: skip
from dscqs.statistics.analysis import Analysis, DisplayVotes, kept
from dscqs.statistics.descriptive import Summary
from dscqs.statistics.normalise import remove_bias
from dscqs.statistics.screening import LEAST_BALANCE, MOST_EXTREME

MANY = 12
"""Conditions beyond which they are numbered by rank instead of named."""

Series = tuple[str, Sequence[Summary]]
"""Name of a line, and its summaries by condition."""


def scores_by_condition(names: Sequence[str], series: Sequence[Series], label: str) -> Figure:
    """Return means with 95 % intervals (Student's t) by condition, a line for each series."""
    figure, (axes,) = new_figure()
    if len(names) > MANY:
        _ranked(axes, series)
    else:
        spread = min(0.12, 0.5 / max(len(series), 1))
        for index, (name, summaries) in enumerate(series):
            shift = (index - (len(series) - 1) / 2) * spread
            _line(axes, np.arange(len(names)) + shift, summaries, index, name)
        name_conditions(axes, names)
    axes.set_ylabel(label, color=INK)
    if _crosses_zero(series):
        axes.axhline(0, color=INK, linewidth=0.8, zorder=1)
    if len(series) > 1:
        figure.legend(
            loc="outside upper left", ncols=min(len(series), 4), frameon=False, fontsize=9
        )
    return figure


def _crosses_zero(series: Sequence[Series]) -> bool:
    lowest = [
        _or_nan(summary.mean) - (summary.ci95_t or 0) for _, found in series for summary in found
    ]
    return bool(np.nanmin([*lowest, np.inf]) < 0)


def _line(
    axes: Axes, x: NDArray[np.floating], summaries: Sequence[Summary], index: int, name: str
) -> None:
    means = np.array([_or_nan(summary.mean) for summary in summaries])
    reach = np.array([summary.ci95_t or 0.0 for summary in summaries])
    axes.errorbar(
        x, means, yerr=reach, color=colour(index), marker=mark(index), markersize=6.5,
        linestyle=DASHES[index % len(DASHES)], linewidth=1.6, elinewidth=1.4, capsize=4,
        capthick=1.4, markeredgecolor="white", markeredgewidth=0.8, label=name,
    )  # fmt: skip


def _ranked(axes: Axes, series: Sequence[Series]) -> None:
    for index, (name, summaries) in enumerate(series):
        known = sorted(
            (summary for summary in summaries if summary.mean is not None),
            key=lambda summary: _or_nan(summary.mean),
        )
        axes.errorbar(
            np.arange(1, len(known) + 1), [_or_nan(summary.mean) for summary in known],
            yerr=[summary.ci95_t or 0.0 for summary in known], color=colour(index),
            marker=mark(index), markersize=3, linestyle="none", elinewidth=0.9, label=name,
        )  # fmt: skip
    axes.set_xlabel("conditions, by rank", color=INK)


def _or_nan(value: float | None) -> float:
    return np.nan if value is None else value


def boxes_of_votes(analysis: Analysis, label: str) -> Figure:
    """Return the votes by condition, a panel for each display: box, median, every vote."""
    displays = analysis.displays
    figure, panels = new_figure(len(displays), height=3.6)
    for index, (axes, display) in enumerate(zip(panels, displays, strict=True)):
        names = display.matrix.conditions
        groups = [_given(display, name) for name in names]
        many = len(names) > MANY
        if many:
            order = sorted(range(len(names)), key=lambda at: np.median(groups[at], axis=0)
                           if groups[at].size else np.inf)  # fmt: skip
            groups = [groups[at] for at in order]
        axes.boxplot(
            groups, positions=range(len(groups)), widths=0.5, showfliers=False,
            medianprops={"color": colour(index), "linewidth": 2},
            boxprops={"color": INK}, whiskerprops={"color": INK}, capprops={"color": INK},
        )  # fmt: skip
        if not many:
            for at, votes in enumerate(groups):
                axes.plot(
                    at + _jitter(votes.size), votes, ".", color=colour(index), alpha=0.35,
                    markersize=4, markeredgewidth=0, zorder=1,
                )  # fmt: skip
            name_conditions(axes, names)
        else:
            axes.set_xticks([])
            axes.set_xlabel("conditions, by median", color=INK)
        if len(displays) > 1:
            axes.set_title(display.display, fontsize=10, color=INK)
    panels[0].set_ylabel(label, color=INK)
    return figure


def _given(display: DisplayVotes, condition: str) -> NDArray[np.float64]:
    votes = display.matrix.values[display.matrix.rows(None, condition)].ravel()
    return np.asarray(votes[~np.isnan(votes)])


def _jitter(count: int) -> NDArray[np.float64]:
    """Return shifts of −0.18 … 0.18 that look irregular and are always the same."""
    golden = 0.618033988749895
    return np.asarray((np.arange(count) * golden) % 1 * 0.36 - 0.18)


def contents_by_condition(display: DisplayVotes, analysis: Analysis, label: str) -> Figure:
    """Return means by condition on one display, a line for each content."""
    cells = {
        (cell.content, cell.condition): cell.primary.after
        for cell in analysis.stimuli
        if cell.display == display.display
    }
    empty = Summary(n=0, mean=None, sd=None, se=None, ci95_normal=None, ci95_t=None)
    return scores_by_condition(
        display.matrix.conditions,
        [
            (content, [cells.get((content, one), empty) for one in display.matrix.conditions])
            for content in display.matrix.contents
        ],
        label,
    )


def assessors(display: DisplayVotes, analysis: Analysis) -> Figure:
    """Return bias and spread of every assessor; the rejected are hollow."""
    free = remove_bias(display.matrix)
    residuals = free.matrix.values - _row_means(free.matrix.values)[:, None]
    spread = np.array([_spread(column) for column in residuals.T])
    names = display.matrix.assessors
    rejected = display.screenings[analysis.variant].rejected
    figure = Figure(figsize=(WIDTH, max(2.2, 0.9 + 0.2 * len(names))), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    rows = np.arange(len(names))
    for axes, values, title in (
        (panels[0], free.bias, "bias: mean of vote − mean of stimulus"),
        (panels[1], spread, "spread: SD of what is left"),
    ):
        plain(axes)
        axes.grid(axis="y", visible=False)
        axes.grid(axis="x", color=PALE, linewidth=0.6)
        axes.hlines(rows, 0, values, color=colour(0), linewidth=1.2)
        for row, (name, value) in enumerate(zip(names, values, strict=True)):
            out = name in rejected
            axes.plot(
                value, row, "o", markersize=6, color=colour(1 if out else 0),
                markerfacecolor="white" if out else colour(0), markeredgewidth=1.6,
            )  # fmt: skip
        axes.axvline(0, color=INK, linewidth=0.8)
        axes.set_xlabel(title, color=INK, fontsize=9)
    panels[0].set_yticks(rows, names, fontsize=8)
    panels[0].set_ylim(len(names) - 0.4, -0.6)
    return figure


def _row_means(values: NDArray[np.float64]) -> NDArray[np.float64]:
    counts = (~np.isnan(values)).sum(axis=1)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.nansum(values, axis=1) / counts)


def _spread(column: NDArray[np.float64]) -> float:
    known = column[~np.isnan(column)]
    return float(known.std(ddof=1)) if known.size > 1 else np.nan


def screening(analysis: Analysis) -> Figure:
    """Return both ratios of every assessor, a panel for each display; who rejects is shaded."""
    figure, panels = new_figure(len(analysis.displays), height=3.2)
    for axes, display in zip(panels, analysis.displays, strict=True):
        found = display.screenings[analysis.variant].assessors
        top = max([0.12, *(each.ratio_total * 1.15 for each in found.values())])
        axes.fill_between([MOST_EXTREME, top], 0, LEAST_BALANCE, color="#f6d9c9", linewidth=0)
        for name, each in found.items():
            if each.ratio_balance is None:
                continue
            axes.plot(
                each.ratio_total, each.ratio_balance, "o", markersize=6, clip_on=False,
                color=colour(1 if each.rejected else 0), alpha=0.8,
            )  # fmt: skip
            if each.rejected:
                axes.annotate(
                    name, (each.ratio_total, each.ratio_balance), xytext=(6, 4),
                    textcoords="offset points", fontsize=9, color=INK,
                )  # fmt: skip
        axes.set_xlim(0, top)
        axes.set_ylim(0, 1.05)
        axes.xaxis.set_major_locator(MaxNLocator(5))
        axes.set_xlabel("(P + Q) / presentations", color=INK)
        axes.set_title(display.display if len(panels) > 1 else "", fontsize=10, color=INK)
    panels[0].set_ylabel("|P − Q| / (P + Q)", color=INK)
    return figure


def condition_series(
    analysis: Analysis, figure: str, *, reference: str | None = None
) -> tuple[tuple[str, ...], list[Series]]:
    """Return the names of the conditions and, by display, their summaries after screening.

    Parameters
    ----------
    figure : str
        Of :data:`dscqs.statistics.analysis.FIGURES`.
    reference : str or None
        Figure of the reference, set first as a condition of its own.
    """
    names = analysis.conditions
    series: list[Series] = []
    for display in analysis.displays:
        if not kept(display, analysis.variant):
            continue
        found = [figure_of(display, figure, name, analysis.variant) for name in names]
        if reference is not None:
            found.insert(0, figure_of(display, reference, None, analysis.variant))
        series.append((display.display, found))
    return (("reference", *names) if reference is not None else names), series
