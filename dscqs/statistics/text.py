"""An analysis as the text that the command line prints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dscqs.statistics.analysis import FEWEST_ASSESSORS, Analysis, Cell, voters
from dscqs.statistics.descriptive import Summary
from dscqs.statistics.details import details
from dscqs.statistics.details_text import details_lines
from dscqs.statistics.document import DIRECTIONS
from dscqs.statistics.screening import FEWEST_SCREENED, Variant


def format_analysis(analyses: Sequence[Analysis]) -> str:
    """Return the scores, the screening and what is to be kept in mind, as lines of text."""
    return "\n".join(line for analysis in analyses for line in _lines(analysis))


def _lines(analysis: Analysis) -> Iterator[str]:
    yield f"{analysis.dimension}: {DIRECTIONS[analysis.method]}"
    yield ""
    titles = ("display", "content", "condition")
    cells = [*analysis.stimuli, *analysis.pooled]
    widths = [
        max(len(title), *(len(getattr(cell, title) or "(all)") for cell in cells))
        for title in titles
    ]
    head = "  ".join(title.ljust(width) for title, width in zip(titles, widths, strict=True))
    figures = f"{'n':>5} {'mean':>8} {'SD':>7} {'SE':>7} {'±95%':>7} {'±95% t':>7}"
    yield f"{head}  {figures}   after screening: {figures}"
    for cell in cells:
        yield (
            "  ".join([*_names(cell, widths), _figures(cell.primary.before)])
            + " " * 20
            + _figures(cell.primary.after)
        )
    yield ""
    yield from _screening(analysis)
    yield from details_lines(details(analysis))
    for display in analysis.displays:
        people = voters(display)
        if people < FEWEST_ASSESSORS:
            yield (
                f"informal: {people} assessor{'s' * (people != 1)} on {display.display!r}, "
                f"fewer than {FEWEST_ASSESSORS} (ITU-R BT.500)"
            )


def _names(cell: Cell, widths: Sequence[int]) -> list[str]:
    names = (cell.display, cell.content, cell.condition)
    return [(name or "(all)").ljust(width) for name, width in zip(names, widths, strict=True)]


def _figures(summary: Summary) -> str:
    texts = (
        f"{summary.n:>5}",
        _number(summary.mean, 8),
        _number(summary.sd, 7),
        _number(summary.se, 7),
        _number(summary.ci95_normal, 7),
        _number(summary.ci95_t, 7),
    )
    return " ".join(texts)


def _number(value: float | None, width: int) -> str:
    return f"{'-':>{width}}" if value is None else f"{value:>{width}.2f}"


def _screening(analysis: Analysis) -> Iterator[str]:
    for display in analysis.displays:
        for variant in Variant:
            rejected = display.screenings[variant].rejected
            used = ", used" if variant is analysis.variant else ""
            names = ", ".join(rejected) if rejected else "nobody"
            yield f"screening of {display.display!r} ({variant.value} SD{used}): rejects {names}"
        people = voters(display)
        if people < FEWEST_SCREENED:
            yield (
                f"the screening of {display.display!r} means nothing: of "
                f"{people} assessor{'s' * (people != 1)} nobody can be far from the mean, and "
                "who is rejected is so for votes that are all equal (it needs "
                f"{FEWEST_SCREENED} at least, ITU-R BT.500 asks for {FEWEST_ASSESSORS})"
            )
