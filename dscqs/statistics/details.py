"""What a report says beside the scores: models, coherence, comparisons, power, missing votes.

Everything here is computed from the votes that are left after the screening of the analysis,
except agreement, models and missing votes, which speak of every assessor.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from dscqs.statistics.analysis import Analysis, DisplayVotes, kept
from dscqs.statistics.anova import Effect, repeated_measures
from dscqs.statistics.coherence import Coherence, coherence
from dscqs.statistics.comparisons import Comparisons, compare, stimulus_cube
from dscqs.statistics.likelihood import Recovered, recover
from dscqs.statistics.matrix import Matrix
from dscqs.statistics.missing import Missing, missing_votes
from dscqs.statistics.normalise import BiasRemoval, remove_bias, z_scores
from dscqs.statistics.power import Power, plan_power
from dscqs.statistics.screening import Screening, Variant, screen
from dscqs.votes import Method

DIFFERENCES = (2.5, 5.0, 10.0)
"""True differences for which the number of assessors is told [units of a 100-point scale]."""


@dataclass(frozen=True, kw_only=True)
class Models:
    """The votes of one display by other models; options of the Recommendations, not the rule.

    Parameters
    ----------
    z_scores : Matrix
        See :func:`dscqs.statistics.normalise.z_scores`.
    unbiased : BiasRemoval
        See :func:`dscqs.statistics.normalise.remove_bias`.
    unbiased_screening : mapping
        The screening of the votes without bias, as P.913 12.4 does it, by variant.
    recovered : Recovered
        See :func:`dscqs.statistics.likelihood.recover`.
    """

    z_scores: Matrix
    unbiased: BiasRemoval
    unbiased_screening: dict[Variant, Screening]
    recovered: Recovered


@dataclass(frozen=True, kw_only=True)
class DisplayDetails:
    """What is known of one display beside its scores."""

    display: str
    missing: Missing
    coherence: Coherence
    models: Models
    comparisons: Comparisons
    power: Power | None


@dataclass(frozen=True, kw_only=True)
class Details:
    """What is known of one dimension beside its scores.

    Parameters
    ----------
    displays : tuple of DisplayDetails
    across : tuple of Effect
        ANOVA of display and condition over the assessors who judged every condition on every
        display; empty with one display, or fewer than two such assessors.
    across_assessors : tuple of str
        Those assessors.
    """

    displays: tuple[DisplayDetails, ...]
    across: tuple[Effect, ...]
    across_assessors: tuple[str, ...]


def details(analysis: Analysis) -> Details:
    """Return everything that a report says beside the scores."""
    across, names = _across(analysis)
    return Details(
        displays=tuple(
            _details(display, analysis.variant, analysis.method) for display in analysis.displays
        ),
        across=across,
        across_assessors=names,
    )


def screened(display: DisplayVotes, variant: Variant) -> Matrix:
    """Return the matrix of the primary figure without the rejected assessors."""
    columns = kept(display, variant)
    return dataclasses.replace(
        display.matrix,
        assessors=tuple(display.matrix.assessors[column] for column in columns),
        values=display.matrix.values[:, columns],
    )


def _details(display: DisplayVotes, variant: Variant, method: Method) -> DisplayDetails:
    left = screened(display, variant)
    comparisons = compare(left, differences=method is not Method.SCORE)
    unbiased = remove_bias(display.matrix)
    family = comparisons.pairs or comparisons.against_reference
    return DisplayDetails(
        display=display.display,
        missing=missing_votes(display.matrix),
        coherence=coherence(display.matrix),
        models=Models(
            z_scores=z_scores(display.matrix),
            unbiased=unbiased,
            unbiased_screening={which: screen(unbiased.matrix, which) for which in Variant},
            recovered=recover(display.matrix),
        ),
        comparisons=comparisons,
        power=plan_power(
            [pair.sd for pair in family if pair.sd],
            min((pair.n for pair in family), default=0),
            DIFFERENCES if method is not Method.SCORE else (),
        ),
    )


def _across(analysis: Analysis) -> tuple[tuple[Effect, ...], tuple[str, ...]]:
    """Return the ANOVA of display and condition, and the assessors in it."""
    if len(analysis.displays) < 2:
        return (), ()
    matrices = [screened(display, analysis.variant) for display in analysis.displays]
    shared = [set(matrix.stimuli) for matrix in matrices]
    if any(stimuli != shared[0] for stimuli in shared):
        return (), ()
    conditions = matrices[0].conditions
    complete: list[dict[str, list[float]]] = []
    for matrix in matrices:
        cube = stimulus_cube(matrix)
        order = [matrix.conditions.index(condition) for condition in conditions]
        means = cube.mean(axis=2)[:, order]
        complete.append(
            {
                name: row.tolist()
                for name, row in zip(matrix.assessors, means, strict=True)
                if not np.isnan(row).any()
            }
        )
    names = tuple(name for name in complete[0] if all(name in found for found in complete))
    if len(names) < 2:
        return (), names
    values = np.array([[found[name] for found in complete] for name in names])
    return repeated_measures(values, ("display", "condition")), names
