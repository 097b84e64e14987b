from __future__ import annotations

import dataclasses

import pytest

from dscqs.errors import PlanError
from dscqs.plan import RANGES, Plan, Timing, plan_from_dict

STIMULI = {
    f"{content}/{condition}": f"{content}-{condition}.png"
    for content in ("ballet", "street")
    for condition in ("original", "bicubic", "sr")
}
GOOD = {
    "name": "set 1",
    "contents": ["ballet", "street"],
    "conditions": ["bicubic", "sr"],
    "reference": "original",
    "stimuli": STIMULI,
}


def test_a_session_lasts_as_long_as_its_presentations():
    plan = plan_from_dict(
        {
            **GOOD,
            "timing": {"show_s": 10, "grey_s": 3, "vote_s": 8, "showings": 2},
            "repetitions": 3,
            "dummies": 4,
        }
    )
    assert plan.timing.presentation_s == 2 * (10 + 3 + 10 + 3) + 8
    assert plan.presentations == 4 + 2 * 2 * 3
    assert plan.session_s == 16 * 60


def test_more_than_half_an_hour_is_refused_unless_wanted():
    long = {**GOOD, "repetitions": 20}  # 85 presentations of 28 s
    with pytest.raises(PlanError, match=r"39\.7 min.*long_session: true"):
        plan_from_dict(long)
    assert plan_from_dict({**long, "long_session": True}).session_s == 85 * 28


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": ""}, "name: "),
        ({"contents": []}, "contents: "),
        ({"contents": ["ballet", "ballet"]}, "contents: a name is there twice"),
        ({"contents": ["a/b"]}, "contents: 'a/b'"),
        ({"contents": "ballet"}, "contents: "),
        ({"conditions": ["sr", 3]}, "conditions: 3"),
        ({"reference": "sr"}, "reference: 'sr'"),
        ({"stimuli": {}}, "stimuli: no file is named for ballet/original"),
        ({"stimuli": 3}, "stimuli: "),
        ({"dimensions": ["beauty"]}, "dimensions: 'beauty'"),
        ({"repetitions": 0}, "repetitions: 0"),
        ({"repetitions": True}, "repetitions: True"),
        ({"dummies": 2.5}, "dummies: 2.5"),
        ({"grey": 256}, "grey: 256"),
        ({"kind": "film"}, "kind: 'film'"),
        ({"kind": ["still"]}, "kind: "),
        ({"timing": {"show_s": float("nan")}}, "timing.show_s"),
        ({"timing": {"showings": 1.5}}, "timing.showings: 1.5 is not a whole number from 1 to 100"),
        ({"timing": {"tolerance_s": -0.1}}, "timing.tolerance_s: -0.1 is not a number from 0 to"),
        ({"timing": {"show_s": 1e9}}, "timing.show_s: 1000000000.0 is not a number from 0.1 to"),
        ({"break_s": "60"}, "break_s: '60' is not a number from 0 to 3600"),
        ({"coherence": 5}, "coherence: 5 is more than the 4 pairs"),
        ({"timing": {"pause": 1}}, "timing: "),
        ({"timing": 3}, "timing: "),
        ({"colour": "red"}, "colour: no such field"),
        ({"long_session": "no"}, "long_session: "),
        ({"captions": 1}, "captions: "),
    ],
)
def test_a_malformed_plan_is_refused_by_the_name_of_its_field(change, said):
    with pytest.raises(PlanError) as caught:
        plan_from_dict({**GOOD, **change})
    assert str(caught.value).startswith(said)


@pytest.mark.parametrize("data", [None, [], "plan", 3])
def test_a_plan_is_a_mapping(data):
    with pytest.raises(PlanError, match="mapping"):
        plan_from_dict(data)


@pytest.mark.parametrize("name", ["name", "contents", "conditions", "reference", "stimuli"])
def test_what_is_missing_is_named(name):
    with pytest.raises(PlanError, match=f"^{name}: is missing"):
        plan_from_dict({key: value for key, value in GOOD.items() if key != name})


def test_no_grey_between_is_allowed():
    assert Timing(grey_s=0).presentation_s == 2 * 2 * 3 + 8


def test_every_number_of_a_plan_has_a_range_that_holds_its_default():
    numbers = {item.name: item.default for item in dataclasses.fields(Plan)}
    numbers |= {f"timing.{item.name}": item.default for item in dataclasses.fields(Timing)}
    numbers = {name: value for name, value in numbers.items() if type(value) in (int, float)}
    assert set(RANGES) == set(numbers)
    for name, (least, most) in RANGES.items():
        assert least <= numbers[name] <= most
