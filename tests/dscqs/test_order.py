from __future__ import annotations

import dataclasses
import json
from collections import Counter
from itertools import pairwise, product
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dscqs.order import Kind, make_order
from dscqs.plan import Plan
from dscqs.proof import unproved_orders


def _plan(contents=3, conditions=2, repetitions=2, dummies=5, seed=1) -> Plan:
    names = tuple(f"c{index}" for index in range(contents))
    tests = tuple(f"t{index}" for index in range(conditions))
    return Plan(
        name="test", contents=names, conditions=tests, reference="ref",
        stimuli={f"{c}/{t}": f"{c}{t}.png" for c, t in product(names, ("ref", *tests))},
        repetitions=repetitions, dummies=dummies, seed=seed, long_session=True,
    )  # fmt: skip


PLANS = st.builds(
    _plan,
    contents=st.integers(2, 6),
    conditions=st.integers(1, 4),
    repetitions=st.integers(1, 3),
    dummies=st.integers(0, 7),
    seed=st.integers(0, 2**32),
)
ASSESSORS = st.integers(0, 50)


@given(PLANS, ASSESSORS)
def test_every_pair_is_there_after_the_dummies(plan, assessor):
    order = make_order(plan, assessor)
    assert [item.kind is Kind.DUMMY for item in order] == [
        index < plan.dummies for index in range(plan.presentations)
    ]
    counted = sorted((i.content, i.condition, i.repetition) for i in order if i.kind is Kind.TEST)
    assert counted == sorted(product(plan.contents, plan.conditions, range(plan.repetitions)))


@given(PLANS, ASSESSORS)
def test_with_two_contents_or_more_none_comes_twice_running(plan, assessor):
    order = make_order(plan, assessor)
    assert all(one.content != other.content for one, other in pairwise(order))


@given(PLANS, ASSESSORS)
def test_half_of_the_pairs_have_the_reference_as_a(plan, assessor):
    sides = [item.reference_is_a for item in make_order(plan, assessor) if item.kind is Kind.TEST]
    assert abs(2 * sum(sides) - len(sides)) == len(sides) % 2


@given(PLANS, st.integers(0, 20))
def test_an_even_number_of_assessors_sees_every_pair_equally_often_on_each_side(plan, couples):
    seen = Counter(
        (item.content, item.condition, item.repetition)
        for assessor in range(2 * couples)
        for item in make_order(plan, assessor)
        if item.reference_is_a and item.kind is Kind.TEST
    )
    assert set(seen.values()) <= {couples}
    assert sum(seen.values()) == couples * (plan.presentations - plan.dummies)


@given(PLANS, ASSESSORS)
def test_the_order_follows_from_plan_and_assessor(plan, assessor):
    assert make_order(plan, assessor) == make_order(plan, assessor)


def test_assessors_and_seeds_differ():
    orders = {make_order(_plan(seed=seed), number) for seed in range(4) for number in range(10)}
    assert len(orders) == 40


def test_a_single_content_cannot_be_spread():
    order = make_order(_plan(contents=1, dummies=1), 0)
    assert len(order) == 5


@given(PLANS, ASSESSORS)
def test_repeats_for_coherence_are_the_same_pairs_for_everybody(plan, assessor):
    plan = dataclasses.replace(plan, coherence=1)
    extra = {
        (item.content, item.condition)
        for number in (0, assessor)
        for item in make_order(plan, number)
        if item.kind is Kind.TEST and item.repetition == plan.repetitions
    }
    assert len(extra) == 1


def test_another_display_has_another_order():
    plan = _plan()
    assert make_order(plan, 0, "polarised") != make_order(plan, 0, "autostereoscopic")


def test_orders_that_were_stored_come_out_for_ever():
    path = Path(__file__).parent / "golden" / "order.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    assert len(document["sessions"]) == 6
    assert unproved_orders(document) == []


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda one: one["order"].pop(), "17 presentations, not 18"),
        (lambda one: one["order"].reverse(), "presentation 1 is another"),
        (lambda one: one.update(order_version=0), "drawn by version 0"),
        (lambda one: one["order"][4].update(reference_is_a=2), "presentation 5 is another"),
    ],
)
def test_an_order_that_was_tampered_with_is_found(spoil, said):
    path = Path(__file__).parent / "golden" / "order.json"
    document = json.loads(path.read_text(encoding="utf-8"))
    spoil(document["sessions"][1])
    (line,) = unproved_orders(document)
    assert line.startswith("a2 on polarised: ")
    assert said in line
