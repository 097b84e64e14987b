"""The tables of a report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dscqs.report.blocks import Table
from dscqs.report.numbers import NOTHING, decimal, figure_of, p_value
from dscqs.statistics.analysis import Analysis, Cell, DisplayVotes
from dscqs.statistics.comparisons import Comparisons, Pair
from dscqs.statistics.descriptive import Summary
from dscqs.statistics.details import Details, DisplayDetails
from dscqs.statistics.screening import Variant

MOST_OPEN = 20
"""Rows of scores up to which a table is shown at once."""

SUMMARY = ("n", "mean", "SD", "SE", "±95 %", "±95 % t")


def _summary(summary: Summary) -> tuple[str, ...]:
    return (
        str(summary.n),
        *(
            decimal(value)
            for value in (
                summary.mean, summary.sd, summary.se, summary.ci95_normal, summary.ci95_t,
            )
        ),
    )  # fmt: skip


def scores_by_display(analysis: Analysis, variant: Variant | None) -> Table:
    """Return mean grades on the scale of the thesis' Tables 3 and 4: a row for each condition."""
    titles = ("score", "± SE", "±95 % t", "n")
    sources: list[tuple[str, str, str | None]] = [("reference", "reference_score", None)]
    sources += [(name, "test_score", name) for name in analysis.conditions]
    rows = []
    for name, figure, condition in sources:
        cells = [name]
        for display in analysis.displays:
            found = figure_of(display, figure, condition, variant)
            cells += [decimal(found.mean, 1), decimal(found.se, 1), decimal(found.ci95_t, 1),
                      str(found.n)]  # fmt: skip
        rows.append(tuple(cells))
    when = "before" if variant is None else "after"
    return Table(
        caption=f"Test scores (100 − grade: 0 = excellent, 100 = bad, lower is better), {when} "
        "screening; all contents and repetitions pooled",
        groups=(("", 1), *((display.display, len(titles)) for display in analysis.displays)),
        head=("condition", *titles * len(analysis.displays)),
        rows=tuple(rows),
    )


def pooled_scores(analysis: Analysis) -> tuple[Table, Table]:
    """Return the primary figure by display and condition, before and after screening."""
    return (
        _cells(analysis.pooled, "before screening, all contents pooled", after=False),
        _cells(analysis.pooled, "after screening, all contents pooled", after=True),
    )


def stimulus_scores(analysis: Analysis) -> tuple[Table, Table]:
    """Return the primary figure by stimulus, before and after screening."""
    return (
        _cells(analysis.stimuli, "by stimulus, before screening", after=False),
        _cells(analysis.stimuli, "by stimulus, after screening", after=True),
    )


def _cells(cells: Sequence[Cell], caption: str, *, after: bool) -> Table:
    contents = any(cell.content is not None for cell in cells)
    names = ("display", "content", "condition") if contents else ("display", "condition")
    return Table(
        caption=caption[0].upper() + caption[1:],
        head=(*names, *SUMMARY),
        rows=tuple(
            (
                *((getattr(cell, name) or "all") for name in names),
                *_summary(cell.primary.after if after else cell.primary.before),
            )
            for cell in cells
        ),
        names=len(names),
        folded=contents or len(cells) > MOST_OPEN,
    )


def screening_table(display: DisplayVotes) -> Table:
    """Return P, Q and both ratios of every assessor, by both standard deviations."""
    titles = ("P", "Q", "total", "balance", "rejected")
    rows, marked = [], set()
    for row, name in enumerate(display.matrix.assessors):
        cells = [name]
        for variant in Variant:
            found = display.screenings[variant].assessors[name]
            cells += [
                str(found.high), str(found.low), decimal(found.ratio_total, 3),
                decimal(found.ratio_balance, 3), "yes" if found.rejected else "no",
            ]  # fmt: skip
            if found.rejected:
                marked.add(row)
        rows.append(tuple(cells))
    return Table(
        caption=f"Screening on {display.display}: P votes far above, Q far below the others'; "
        "total = (P + Q) / presentations, balance = |P − Q| / (P + Q); rejected when total > 0.05 "
        "and balance < 0.3",
        groups=(("", 1), *((f"{variant.value} SD", len(titles)) for variant in Variant)),
        head=("assessor", *titles * len(Variant)),
        rows=tuple(rows),
        marked=frozenset(marked),
    )


def pair_table(display: str, found: Comparisons) -> Table:
    """Return every comparison of two conditions, and of each with the reference."""
    return Table(
        caption=f"Paired comparisons on {display}, after screening: mean of first − second, "
        "Holm over each family",
        head=("first", "second", "n", "mean", "±95 % t", "t", "df", "p (Holm)", "d",
              "Wilcoxon p (Holm)"),
        rows=tuple(_pair(pair) for pair in (*found.against_reference, *found.pairs)),
        names=2,
    )  # fmt: skip


def _pair(pair: Pair) -> tuple[str, ...]:
    return (
        pair.first, pair.second, str(pair.n), decimal(pair.mean), decimal(pair.ci95_t),
        decimal(pair.t), NOTHING if pair.df is None else str(pair.df), p_value(pair.p_holm),
        decimal(pair.effect_size), p_value(pair.p_wilcoxon_holm),
    )  # fmt: skip


def anova_table(details: Details) -> Table | None:
    """Return the analyses of variance of every display and across displays; None without one."""
    sources = [(each.display, each.comparisons.anova) for each in details.displays]
    sources.append(("across displays", details.across))
    rows = tuple(
        (
            place, " × ".join(effect.factors), decimal(effect.f),
            str(effect.df_effect), str(effect.df_error), decimal(effect.epsilon, 3),
            p_value(effect.p), p_value(effect.p_corrected),
            decimal(effect.partial_eta_squared, 3),
        )
        for place, effects in sources
        for effect in effects
    )  # fmt: skip
    if not rows:
        return None
    return Table(
        caption="Repeated-measures analysis of variance; p (GG) is with both degrees of freedom "
        "times ε of Greenhouse and Geisser",
        head=("display", "effect", "F", "df", "df error", "ε", "p", "p (GG)", "partial η²"),
        rows=rows,
        names=2,
    )


def assessor_table(each: DisplayDetails) -> Table:
    """Return what is known of every assessor of a display."""
    unbiased, recovered = each.models.unbiased, each.models.recovered
    repeats = any(found.stimuli for found in each.coherence.repeats.values())
    rows = []
    for column, name in enumerate(recovered.assessors):
        agreement, own = each.coherence.agreement[name], each.coherence.repeats[name]
        rows.append(
            (
                name, str(each.missing.by_assessor.get(name, 0)),
                decimal(float(unbiased.bias[column])),
                decimal(float(recovered.inconsistency[column])),
                decimal(agreement.pearson) + (" !" if agreement.low else ""),
                *((decimal(own.within_sd), decimal(own.mean_change)) if repeats else ()),
            )
        )  # fmt: skip
    return Table(
        caption=f"Assessors on {each.display}: missing votes, bias, inconsistency of the "
        "maximum-likelihood model, correlation with the mean of all (! = low)"
        + (", SD within repeated items, mean change from first to last" if repeats else ""),
        head=("assessor", "missing", "bias", "inconsistency", "correlation",
              *(("within SD", "change") if repeats else ())),
        rows=tuple(rows),
    )  # fmt: skip


def model_table(analysis: Analysis, each: DisplayDetails) -> Table:
    """Return the scores of every stimulus by other models, beside the plain mean."""
    recovered = each.models.recovered
    means = {
        (cell.content, cell.condition): cell.primary.before
        for cell in analysis.stimuli
        if cell.display == each.display
    }
    z, free = each.models.z_scores, each.models.unbiased.matrix
    rows = []
    for row, (content, condition) in enumerate(recovered.stimuli):
        at = z.stimulus_of_row == row
        rows.append(
            (
                content, condition, decimal(means[content, condition].mean),
                decimal(_mean(z.values[at])), decimal(_mean(free.values[at])),
                decimal(float(recovered.quality[row])), decimal(float(recovered.se_residual[row])),
            )
        )  # fmt: skip
    return Table(
        caption=f"Stimuli on {each.display} by other models, no assessor rejected: mean z-score, "
        "mean without bias, quality of the maximum-likelihood model and its standard error",
        head=("content", "condition", "mean", "z", "without bias", "model", "model SE"),
        rows=tuple(rows),
        names=2,
        folded=True,
    )


def _mean(votes: NDArray[np.float64]) -> float | None:
    known = votes[~np.isnan(votes)]
    return float(known.mean()) if known.size else None
