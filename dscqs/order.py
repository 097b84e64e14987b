"""The order of a session: a pure function of plan, assessor and seed."""

from __future__ import annotations

import random
from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from itertools import product

from dscqs.plan import Plan

ORDER_VERSION = 1
"""Of the drawing below; an order that is stored says which one drew it."""


class Kind(StrEnum):
    """What a presentation is for."""

    TRAINING = "training"
    DUMMY = "dummy"
    TEST = "test"


@dataclass(frozen=True, kw_only=True)
class Presentation:
    """One pair to show; the reference is A or B."""

    content: str
    condition: str
    repetition: int
    """From 0."""
    reference_is_a: bool
    kind: Kind


def make_order(plan: Plan, assessor: int, display: str = "") -> tuple[Presentation, ...]:
    """Return the presentations of an assessor: training, dummies, then what counts.

    The reference is A in exactly half of the counted pairs (the odd one
    alternates), and two neighbouring assessors (2k, 2k+1) have opposite sides
    for every pair, so that sides are balanced over assessors too.

    Parameters
    ----------
    plan : Plan
        The test, with its seed.
    assessor : int
        Number of the assessor within the test and display, from 0.
    display : str
        What it is shown on; the same assessor has another order on another display.
    """
    sides = random.Random(f"sides {plan.seed} {display} {assessor // 2}")
    mixed = random.Random(f"order {plan.seed} {display} {assessor}")
    pairs = _pairs(plan)
    chosen = [
        Presentation(
            content=content, condition=condition, repetition=repetition,
            reference_is_a=flag != bool(assessor % 2), kind=Kind.TEST,
        )
        for (content, condition, repetition), flag in zip(
            pairs, _half(len(pairs), sides), strict=True
        )
    ]  # fmt: skip
    trained = [tuple(pair.split("/", 1)) for pair in plan.training]
    training = _uncounted(trained, Kind.TRAINING, mixed)
    dummies = _spread(_uncounted(_draw(plan, mixed), Kind.DUMMY, mixed), mixed, _last(training))
    counted = _spread(chosen, mixed, _last([*training, *dummies]))
    return (*training, *dummies, *counted)


def _pairs(plan: Plan) -> list[tuple[str, str, int]]:
    """Return content, condition and repetition of everything that counts."""
    pairs = list(product(plan.contents, plan.conditions, range(plan.repetitions)))
    once_more = random.Random(f"coherence {plan.seed}").sample(
        list(product(plan.contents, plan.conditions)), plan.coherence
    )
    return pairs + [(content, condition, plan.repetitions) for content, condition in once_more]


def _uncounted(
    pairs: Iterable[tuple[str, ...]], kind: Kind, chance: random.Random
) -> list[Presentation]:
    pairs = list(pairs)
    return [
        Presentation(
            content=content, condition=condition, repetition=0, reference_is_a=flag, kind=kind
        )
        for (content, condition), flag in zip(pairs, _half(len(pairs), chance), strict=True)
    ]


def _last(items: list[Presentation]) -> str | None:
    return items[-1].content if items else None


def _half(count: int, chance: random.Random) -> list[bool]:
    """Return flags of which half are true; of an odd number, the odd one is drawn."""
    flags = [index % 2 == 0 for index in range(count)]
    if count % 2:
        flags[-1] = chance.random() < 0.5
    chance.shuffle(flags)
    return flags


def _draw(plan: Plan, chance: random.Random) -> list[tuple[str, str]]:
    """Return content and condition of the dummies, each as evenly used as can be."""
    drawn = []
    for names in (plan.contents, plan.conditions):
        column: list[str] = []
        while len(column) < plan.dummies:
            column += chance.sample(names, len(names))
        drawn.append(column[: plan.dummies])
    return list(zip(*drawn, strict=True))


def _spread(
    items: list[Presentation], chance: random.Random, last: str | None
) -> list[Presentation]:
    """Shuffle; the same content comes twice running only where nothing else could be done."""
    left: dict[str, list[Presentation]] = {item.content: [] for item in items}
    for item in chance.sample(items, len(items)):
        left[item.content].append(item)
    ordered: list[Presentation] = []
    while len(ordered) < len(items):
        rest = len(items) - len(ordered)
        open_contents = [name for name, group in left.items() if group and name != last]
        if not open_contents:
            open_contents = [name for name, group in left.items() if group]
        urgent = [name for name in open_contents if 2 * len(left[name]) > rest]
        names = urgent or open_contents
        last = chance.choices(names, [len(left[name]) for name in names])[0]
        ordered.append(left[last].pop())
    return ordered
