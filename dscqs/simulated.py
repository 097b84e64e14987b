"""A model of assessors, for pilots and for tests.

The grade that assessor i gives to a picture of condition j of content k is ::

    g = clip(q_j + c_k + b_i + e, 0, 100)
    c ~ N(0, content_sd),  b ~ N(0, bias_sd),  e ~ N(0, noise_sd)

rounded to 0.1; with probability ``lapse`` it is a number without any thought, uniform in 0 … 100.
c is drawn once for each content, b once for each assessor, e for each grade. Since A and B of a
presentation share content and assessor, c and b cancel in the difference of the two, except
where a grade is clipped: the expected difference is q_reference − q_test, its deviation
√2 · noise_sd.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from dscqs.errors import PlanError


@dataclass(frozen=True, kw_only=True)
class AssessorModel:
    """What the simulated assessors have in common.

    Parameters
    ----------
    quality : mapping
        q: the true grade of every condition, the reference among them, 0 … 100.
    content_sd, bias_sd, noise_sd : float
        Standard deviations [points of the scale].
    lapse : float
        Probability of a grade without thought, 0 … 1.
    seed : int
    """

    quality: Mapping[str, float]
    content_sd: float = 4.0
    bias_sd: float = 6.0
    noise_sd: float = 8.0
    lapse: float = 0.02
    seed: int = 1

    def __post_init__(self) -> None:
        for name, value in self.quality.items():
            if not 0 <= value <= 100:
                raise PlanError(f"quality: {name} is {value}, not 0 to 100")
        for name in ("content_sd", "bias_sd", "noise_sd"):
            if not 0 <= getattr(self, name) <= 100:
                raise PlanError(f"{name}: must be 0 to 100, not {getattr(self, name)}")
        if not 0 <= self.lapse <= 1:
            raise PlanError(f"lapse: must be 0 to 1, not {self.lapse}")


class SimulatedAssessor:
    """One assessor of a model; the same name gives the same grades for the same pictures."""

    def __init__(self, model: AssessorModel, name: str) -> None:
        self._model = model
        self._chance = random.Random(f"{model.seed} {name}")
        self._bias = self._chance.gauss(0, model.bias_sd)

    def grade(self, content: str, condition: str) -> float:
        """Return the grade of a picture, 0 … 100 in steps of 0.1."""
        model = self._model
        if self._chance.random() < model.lapse:
            return round(self._chance.uniform(0, 100), 1)
        of_content = random.Random(f"{model.seed} content {content}").gauss(0, model.content_sd)
        noise = self._chance.gauss(0, model.noise_sd)
        grade = model.quality[condition] + of_content + self._bias + noise
        return round(min(max(grade, 0.0), 100.0), 1)


def spread_quality(reference: str, conditions: Sequence[str]) -> dict[str, float]:
    """Return true grades for conditions of which nothing is known: 80, then from 40 up to 75."""
    step = 35 / max(len(conditions) - 1, 1)
    return {reference: 80.0} | {name: 40 + step * at for at, name in enumerate(conditions)}
