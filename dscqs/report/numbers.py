"""Numbers as a report prints them."""

from __future__ import annotations

import numpy as np

from dscqs.statistics.analysis import DisplayVotes, kept
from dscqs.statistics.descriptive import Summary, summarise
from dscqs.statistics.screening import Variant

MINUS = "\N{MINUS SIGN}"
NOTHING = "–"


def decimal(value: float | None, places: int = 2) -> str:
    """Return a number with a true minus sign; a dash for None and NaN."""
    if value is None or not np.isfinite(value):
        return NOTHING
    text = f"{value:.{places}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", MINUS)


def p_value(p: float | None) -> str:
    """Return a p-value; never 0."""
    return NOTHING if p is None else "< 0.001" if p < 0.001 else f"{p:.3f}"


def figure_of(
    display: DisplayVotes, figure: str, condition: str | None, variant: Variant | None
) -> Summary:
    """Return the summary of one figure of a condition; None: of all conditions.

    Parameters
    ----------
    variant : Variant or None
        Without the assessors whom this screening rejects; None: with all.
    """
    matrix = display.matrices[figure]
    return summarise(matrix.values[matrix.rows(None, condition)][:, kept(display, variant)].ravel())
