"""An analysis as a JSON document, ``depthsr-dscqs-analysis/1``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

from dscqs.statistics.analysis import PRIMARY, Analysis, Cell, Score, voters
from dscqs.statistics.details import details
from dscqs.statistics.details_document import details_document
from dscqs.statistics.screening import Screening, Variant
from dscqs.votes import Method

FORMAT = "depthsr-dscqs-analysis/1"

DIRECTIONS = {
    Method.GRADES: "difference = reference - test, -100 ... 100; positive: the test is worse",
    Method.DIFFERENCE: "difference = reference - test, -100 ... 100; positive: the test is worse",
    Method.SCORE: "score on the scale of its own test; higher is better",
}


def document(analyses: Sequence[Analysis]) -> dict[str, Any]:
    """Return the analyses as one document; the first is at its top, others by dimension."""
    first, *others = analyses
    return {
        "format": FORMAT,
        "votes": first.name,
        **_analysis(first),
        **(
            {"dimensions": {other.dimension: _analysis(other) for other in others}}
            if others
            else {}
        ),
    }


def _analysis(analysis: Analysis) -> dict[str, Any]:
    return {
        "dimension": analysis.dimension,
        "method": analysis.method.value,
        "figure": "score" if analysis.method is Method.SCORE else "difference",
        "direction": DIRECTIONS[analysis.method],
        "informal": analysis.informal,
        "assessors": {display.display: voters(display) for display in analysis.displays},
        "stimuli": [
            {"display": cell.display, "content": cell.content, **_cell(cell)}
            for cell in analysis.stimuli
        ],
        "pooled": [
            {"display": cell.display, **_cell(cell), "by_assessor": _score(cell.by_assessor)}
            for cell in analysis.pooled
        ],
        "screening": {
            "variant_used": analysis.variant.value,
            **{
                variant.value: {
                    display.display: _screening(display.screenings[variant])
                    for display in analysis.displays
                }
                for variant in Variant
            },
        },
        **details_document(details(analysis)),
    }


def _cell(cell: Cell) -> dict[str, Any]:
    return {
        "condition": cell.condition,
        **_score(cell.primary),
        **{name: _score(score) for name, score in cell.figures.items() if name != PRIMARY},
    }


def _score(score: Score) -> dict[str, Any]:
    return {"before": dataclasses.asdict(score.before), "after": dataclasses.asdict(score.after)}


def _screening(screening: Screening) -> dict[str, Any]:
    return {
        "rejected": list(screening.rejected),
        "assessors": {
            name: {
                "P": found.high,
                "Q": found.low,
                "ratio_total": found.ratio_total,
                "ratio_balance": found.ratio_balance,
                "rejected": found.rejected,
            }
            for name, found in screening.assessors.items()
        },
    }
