"""A report as a sequence of blocks, for whatever writes it down."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from functools import partial

from dscqs.record import LogEntry
from dscqs.report import plots, tables
from dscqs.report.blocks import Block, Heading, Paragraph, Plot, Table
from dscqs.report.methods import informal_text, methods, power_text
from dscqs.statistics.analysis import Analysis, analyse, voters
from dscqs.statistics.comparisons import MOST_CONDITIONS
from dscqs.statistics.details import Details, details
from dscqs.statistics.document import DIRECTIONS
from dscqs.statistics.screening import Variant
from dscqs.votes import TEST, Method, VoteTable

MOST_CONTENTS = 7
"""Contents up to which each has a line of its own: as many as there are colours."""

LABELS = {
    Method.GRADES: "reference − test  (> 0: test worse)",
    Method.DIFFERENCE: "reference − test  (> 0: test worse)",
    Method.SCORE: "score  (higher is better)",
}


def content(
    table: VoteTable, *, variant: Variant = Variant.SAMPLE, log: Sequence[LogEntry] = ()
) -> Iterator[Block]:
    """Yield the blocks of a report.

    Parameters
    ----------
    table : VoteTable
    variant : Variant
        Screening that decides the results "after".
    log : sequence of LogEntry
        Events of the sessions, in order.
    """
    analyses = analyse(table, variant)
    left_out = Counter(vote.kind for vote in table.votes if vote.kind != TEST)
    if left_out:
        kinds = ", ".join(f"{count} {kind}" for kind, count in left_out.items())
        yield Paragraph(text=f"Votes that do not count and are left out: {kinds}.")
    for analysis in analyses:
        if len(analyses) > 1:
            yield Heading(text=f"Dimension: {analysis.dimension}")
        yield from _dimension(analysis)
    if log:
        yield Heading(text="Session log")
        yield Table(
            caption=f"{len(log)} events",
            head=("time", "assessor", "event", "detail"),
            rows=tuple((entry.time, entry.assessor, entry.event, entry.detail) for entry in log),
            names=4,
            folded=True,
        )


def _dimension(analysis: Analysis) -> Iterator[Block]:
    found = details(analysis)
    yield from _summary(analysis)
    yield from _scores(analysis)
    yield from _assessors(analysis, found)
    yield from _tests(found)
    yield Heading(text="Other models")
    for each in found.displays:
        if each.models.recovered.dominated is not None:
            yield Paragraph(text=_dominated(each.display, each.models.recovered.dominated),
                            warning=True)  # fmt: skip
        yield tables.model_table(analysis, each)
    yield Heading(text="Methods")
    for text in methods(analysis, found):
        yield Paragraph(text=text)


def _dominated(display: str, assessor: str) -> str:
    return (
        f"On {display}, the maximum-likelihood model gives all weight to {assessor}: its "
        "likelihood has no maximum with so few assessors. Do not use its scores."
    )


def _summary(analysis: Analysis) -> Iterator[Block]:
    warning = informal_text(analysis)
    if warning is not None:
        yield Paragraph(text=warning, warning=True)
    panels = "; ".join(
        f"{display.display}: {voters(display)} assessor{'s' * (voters(display) != 1)}, "
        f"{len(display.screenings[analysis.variant].rejected)} rejected, "
        f"{len(display.matrix.presentations)} presentations"
        for display in analysis.displays
    )
    yield Paragraph(text=f"{panels}. {_sentence(DIRECTIONS[analysis.method])}")


def _sentence(text: str) -> str:
    return (
        text[0].upper()
        + text[1:].replace(" ... ", " … ").replace(" - ", " − ").replace(" -", " −")
        + "."
    )


def _scores(analysis: Analysis) -> Iterator[Block]:
    yield Heading(text="Scores")
    if "test_score" in analysis.displays[0].matrices:
        names, series = plots.condition_series(analysis, "test_score", reference="reference_score")
        yield Plot(
            caption="Test scores by condition, a line for each display; means after screening "
            "with 95 % intervals (Student's t). 0 = excellent, 100 = bad: lower is better.",
            text="Line plot of the mean test score by condition; the table below has the numbers.",
            draw=partial(plots.scores_by_condition, names, series,
                         "test score  (lower is better)"),
        )  # fmt: skip
        yield tables.scores_by_display(analysis, analysis.variant)
        if any(display.screenings[analysis.variant].rejected for display in analysis.displays):
            yield tables.scores_by_display(analysis, None)
    label = LABELS[analysis.method]
    names, series = plots.condition_series(analysis, "primary")
    yield Plot(
        caption=f"{_sentence(DIRECTIONS[analysis.method])} Means by condition after screening, "
        "with 95 % intervals (Student's t).",
        text="Plot of the mean by condition; the tables below have the numbers.",
        draw=partial(plots.scores_by_condition, names, series, label),
    )
    yield from tables.pooled_scores(analysis)
    for display in analysis.displays:
        if 1 < len(display.matrix.contents) <= MOST_CONTENTS:
            yield Plot(
                caption=f"By content, on {display.display}; means after screening with 95 % "
                "intervals (Student's t).",
                text="Plot of the mean by condition, a line for each content.",
                draw=partial(plots.contents_by_condition, display, analysis, label),
            )
    yield from tables.stimulus_scores(analysis)
    yield Plot(
        caption="All votes: box from first to third quartile, line at the median, whiskers to "
        "the last vote within 1.5 box heights"
        + (", a dot for every vote." if len(analysis.conditions) <= plots.MANY else "."),
        text="Box plots of the votes by condition and display.",
        draw=partial(plots.boxes_of_votes, analysis, label),
    )


def _assessors(analysis: Analysis, found: Details) -> Iterator[Block]:
    yield Heading(text="Assessors")
    yield Plot(
        caption=f"Screening ({analysis.variant.value} standard deviation): an assessor in the "
        "shaded corner is rejected. Assessors without an extreme vote have no balance and no dot.",
        text="Both ratios of the screening for every assessor; the tables below have the numbers.",
        draw=partial(plots.screening, analysis),
    )
    for display, each in zip(analysis.displays, found.displays, strict=True):
        yield Heading(text=display.display, level=2)
        yield tables.screening_table(display)
        yield Plot(
            caption=f"Bias and spread of every assessor on {display.display}; the rejected are "
            "hollow.",
            text="Bias and spread by assessor.",
            draw=partial(plots.assessors, display, analysis),
        )
        yield tables.assessor_table(each)


def _tests(found: Details) -> Iterator[Block]:
    yield Heading(text="Differences between conditions")
    anova = tables.anova_table(found)
    if anova is not None:
        yield anova
    for each in found.displays:
        comparisons = each.comparisons
        if comparisons.incomplete:
            yield Paragraph(
                text=f"Left out of the analysis of variance on {each.display} for missing votes: "
                f"{', '.join(comparisons.incomplete)}."
            )
        if not comparisons.balanced:
            yield Paragraph(
                text=f"No analysis of variance on {each.display}: not every condition was shown "
                "with every content."
            )
        if comparisons.friedman is not None:
            yield Paragraph(
                text=f"Friedman's test on {each.display}: "
                f"χ²({comparisons.friedman.df}) = {comparisons.friedman.chi_squared:.2f}, "
                f"p = {comparisons.friedman.p:.2g}, Kendall's W = "
                f"{comparisons.friedman.kendall_w:.2f}, n = {comparisons.friedman.n}."
            )
        if comparisons.pairs or comparisons.against_reference:
            yield tables.pair_table(each.display, comparisons)
        else:
            yield Paragraph(
                text=f"No comparison of pairs on {each.display}: there is one condition, or more "
                f"than {MOST_CONDITIONS}."
            )
    for text in power_text(found):
        yield Paragraph(text=text)
