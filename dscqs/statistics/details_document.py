"""Details as plain data: the further keys of the JSON document of an analysis."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np

from dscqs.statistics.anova import Effect
from dscqs.statistics.details import Details, DisplayDetails, Models
from dscqs.statistics.normalise import to_percent
from dscqs.statistics.screening import Screening


def details_document(details: Details) -> dict[str, Any]:
    """Return the further keys of an analysis; NaN becomes null."""
    displays = details.displays
    return {
        "missing": {
            each.display: {
                "expected": each.missing.expected,
                "given": each.missing.given,
                "by_assessor": each.missing.by_assessor,
                "by_stimulus": [
                    {"content": content, "condition": condition, "votes": votes}
                    for (content, condition), votes in each.missing.stimuli.items()
                ],
            }
            for each in displays
        },
        "coherence": {each.display: dataclasses.asdict(each.coherence) for each in displays},
        "models": {each.display: _models(each.models) for each in displays},
        "comparisons": {each.display: _comparisons(each) for each in displays},
        "anova_across_displays": {
            "assessors": list(details.across_assessors),
            "effects": [_effect(effect) for effect in details.across],
        },
        "power": {
            each.display: None
            if each.power is None
            else {
                **dataclasses.asdict(each.power),
                "needed": [
                    {"difference": difference, "assessors": number}
                    for difference, number in each.power.needed.items()
                ],
            }
            for each in displays
        },
    }


def _comparisons(each: DisplayDetails) -> dict[str, Any]:
    found = each.comparisons
    return {
        "balanced": found.balanced,
        "complete": list(found.complete),
        "incomplete": list(found.incomplete),
        "anova": [_effect(effect) for effect in found.anova],
        "friedman": None if found.friedman is None else dataclasses.asdict(found.friedman),
        "against_reference": [dataclasses.asdict(pair) for pair in found.against_reference],
        "pairs": [dataclasses.asdict(pair) for pair in found.pairs],
    }


def _effect(effect: Effect) -> dict[str, Any]:
    return {**dataclasses.asdict(effect), "factors": " × ".join(effect.factors)}


def _models(models: Models) -> dict[str, Any]:
    recovered, unbiased = models.recovered, models.unbiased
    z = [_by_stimulus(models.z_scores.values, models.z_scores.stimulus_of_row, at)
         for at in range(len(recovered.stimuli))]  # fmt: skip
    free = [_by_stimulus(unbiased.matrix.values, unbiased.matrix.stimulus_of_row, at)
            for at in range(len(recovered.stimuli))]  # fmt: skip
    return {
        "z_scores": [
            {"content": content, "condition": condition, "z": number(value),
             "percent": number(to_percent(value))}
            for (content, condition), value in zip(recovered.stimuli, z, strict=True)
        ],
        "bias_removal": {
            "bias": _named(unbiased.matrix.assessors, unbiased.bias),
            "stimuli": [
                {"content": content, "condition": condition, "mean": number(value)}
                for (content, condition), value in zip(recovered.stimuli, free, strict=True)
            ],
            "rejected": {
                variant.value: list(screening.rejected)
                for variant, screening in models.unbiased_screening.items()
            },
            "after": {
                variant.value: _after(models, screening)
                for variant, screening in models.unbiased_screening.items()
            },
        },
        "maximum_likelihood": {
            "steps": recovered.steps,
            "converged": recovered.converged,
            "dominated_by": recovered.dominated,
            "bias": _named(recovered.assessors, recovered.bias),
            "inconsistency": _named(recovered.assessors, recovered.inconsistency),
            "stimuli": [
                {"content": content, "condition": condition, "quality": number(quality),
                 "se_residual": number(one), "se_model": number(two)}
                for (content, condition), quality, one, two in zip(
                    recovered.stimuli, recovered.quality, recovered.se_residual,
                    recovered.se_model, strict=True,
                )
            ],
        },
    }  # fmt: skip


def _after(models: Models, screening: Screening) -> list[float | None]:
    """Return the means without bias and without those whom the screening rejects, by stimulus."""
    matrix = models.unbiased.matrix
    columns = [name not in screening.rejected for name in matrix.assessors]
    values = matrix.values[:, columns]
    return [
        number(_by_stimulus(values, matrix.stimulus_of_row, at))
        for at in range(len(matrix.stimuli))
    ]


def _by_stimulus(values: np.ndarray, rows: np.ndarray, at: int) -> float:
    votes = values[rows == at]
    votes = votes[~np.isnan(votes)]
    return float(votes.mean()) if votes.size else math.nan


def _named(names: tuple[str, ...], values: np.ndarray) -> dict[str, float | None]:
    return {name: number(value) for name, value in zip(names, values, strict=True)}


def number(value: float) -> float | None:
    """Return a float, or None for NaN and infinity."""
    return float(value) if math.isfinite(value) else None
