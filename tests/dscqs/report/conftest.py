"""Votes for reports: simulated assessors on two displays, one of them erratic."""

from __future__ import annotations

import numpy as np
import pytest

from dscqs.votes import Vote, make_table

TRUE = {
    "polarised": {"bicubic": 72.0, "super-resolved": 27.0},
    "autostereoscopic": {"bicubic": 64.0, "super-resolved": 45.0},
}
"""Test score (100 − grade) by display and condition; the reference is at 29 and 44."""

REFERENCE = {"polarised": 29.0, "autostereoscopic": 44.0}


def simulate(assessors=16, erratic=6, skipped=(), dimensions=("quality",)):
    chance = np.random.default_rng(4)  # a07 is rejected on the first display
    votes = []
    for a in range(assessors):
        bias, noise = chance.normal(0, 6), 34.0 if a == erratic else 8 + 4 * chance.random()
        for display, conditions in TRUE.items():
            for dimension in dimensions:
                for condition, score in conditions.items():
                    for content in ("breakdancing", "ballet"):
                        for repetition in (1, 2):
                            reference, test = (
                                float(np.clip(round(100 - true + bias + noise * x, 1), 0, 100))
                                for true, x in zip(
                                    (REFERENCE[display], score), chance.normal(size=2), strict=True
                                )
                            )
                            if (a, display, content, repetition) in skipped:
                                continue
                            votes.append(
                                Vote(
                                    assessor=f"a{a + 1:02d}", display=display, content=content,
                                    condition=condition, repetition=repetition,
                                    dimension=dimension, grade_reference=reference,
                                    grade_test=test,
                                )
                            )  # fmt: skip
    return make_table(votes, name="set1.csv")


@pytest.fixture(scope="session")
def table():
    return simulate(skipped={(11, "polarised", "ballet", 2)})
