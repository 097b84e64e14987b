"""The examples of the description are what a service answers."""

from __future__ import annotations

import shutil

from service.http import dscqs_examples as examples
from tests.support.assessor_client import AssessorClient

OPERATOR = "/dscqs/api/operator"


def _shape(value):
    """Return a value with its names and lengths, and with types in place of what differs."""
    if isinstance(value, dict):
        return {key: _shape(item) for key, item in value.items()}
    return [_shape(item) for item in value] if isinstance(value, list) else type(value)


def test_a_test_is_answered_as_its_examples_say(served, stimuli, operator, make_http):
    folder = served.root / "small"
    folder.mkdir()
    for key in examples.DIGESTS:
        shutil.copy(served.root / "set1" / stimuli[key], folder / f"{key.replace('/', '--')}.png")
    http = operator.http
    found = http.get(f"{OPERATOR}/making").json()["folders"]
    assert {**examples.STIMULI, "folder": str(folder), "label": "roots/small"} in found
    wanted = {**examples.WANTED, "folder": "small"}
    planned = http.post(f"{OPERATOR}/plans", json=wanted).json()
    assert _shape(planned) == _shape({"plan": examples.PLAN, **examples.LENGTH})
    test = operator.make_test(planned["plan"])
    whole = http.get(f"{OPERATOR}/tests/{test}").json()
    assert _shape(whole) == _shape({**examples.SUMMARY, "plan": examples.PLAN})
    assert _shape(http.get(f"{OPERATOR}/tests").json()[0]) == _shape(examples.SUMMARY)

    first, second = (AssessorClient(http=make_http()) for _ in range(2))
    first.enter(operator.invite(test, "a1", "polarised"))
    assert first.state() == examples.STATE
    assert first.http.get("/dscqs/api/assessor/display").json() == examples.DISPLAY
    assert _shape(first.present()) == _shape(examples.PRESENTATION)
    for side in "AB":
        first.fetch(side)
    assert first.shown(log=examples.LOG) == examples.STATE
    assert first.grade(examples.GRADES)["stage"] == "thanks"

    votes = operator.votes_csv(test).splitlines()
    assert votes[1:-1] == examples.VOTES.splitlines()[1:-1]
    assert votes[-1].split(",")[:8] == examples.VOTES.splitlines()[-1].split(",")[:8]
    assert _shape(operator.document(test)) == _shape(examples.EVERYTHING)
    sureal = http.get(f"{OPERATOR}/tests/{test}/export?format=sureal").json()
    assert sureal == examples.SUREAL
    for format, example in (("sujson", examples.SUJSON), ("scores", examples.SCORES)):
        said = http.get(f"{OPERATOR}/tests/{test}/export", params={"format": format}).json()
        assert _shape(said) == _shape(example)

    second.enter(operator.invite(test, "a2", "polarised"))
    second.present()
    second.shown("failed", {"faults": [{"kind": "focus", "detail": "the window lost the focus"}]})
    assert _shape(operator.progress(test)[1]) == _shape(examples.PROGRESS)
