"""The order of a session: a pure function of plan, assessor and seed."""

from __future__ import annotations

import random
from dataclasses import dataclass
from itertools import product

from dscqs.plan import Plan


@dataclass(frozen=True, kw_only=True)
class Presentation:
    """One pair to show; the reference is A or B."""

    content: str
    condition: str
    repetition: int
    reference_is_a: bool
    dummy: bool


def make_order(plan: Plan, assessor: int) -> tuple[Presentation, ...]:
    """Return the presentations of an assessor, dummies first.

    The reference is A in exactly half of the counted pairs (the odd one
    alternates), and two neighbouring assessors (2k, 2k+1) have opposite sides
    for every pair, so that sides are balanced over assessors too.

    Parameters
    ----------
    plan : Plan
        The test, with its seed.
    assessor : int
        Number of the assessor within the test, from 0.
    """
    sides = random.Random(f"sides {plan.seed} {assessor // 2}")
    mixed = random.Random(f"order {plan.seed} {assessor}")
    pairs = list(product(plan.contents, plan.conditions, range(plan.repetitions)))
    flags = _half(len(pairs), sides)
    chosen = [
        Presentation(
            content=content, condition=condition, repetition=repetition,
            reference_is_a=flag != bool(assessor % 2), dummy=False,
        )
        for (content, condition, repetition), flag in zip(pairs, flags, strict=True)
    ]  # fmt: skip
    dummies = [
        Presentation(
            content=content, condition=condition, repetition=0,
            reference_is_a=flag, dummy=True,
        )
        for (content, condition), flag in zip(
            _draw(plan, mixed),
            _half(plan.dummies, mixed),
            strict=True,
        )
    ]  # fmt: skip
    first = _spread(dummies, mixed, None)
    last = first[-1].content if first else None
    return (*first, *_spread(chosen, mixed, last))


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
