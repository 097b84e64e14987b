"""A session over HTTP: what is asked, what is answered, what is refused."""

from __future__ import annotations

import csv
import io

import cv2
import numpy as np
import pytest

from dscqs.votes import parse_csv
from service.dscqs_client import DscqsClientError
from tests.service.dscqs.support import REFERENCE, colour_of, step, walk
from tests.support.assessor_client import AssessorClient

GRADES = {"quality": {"A": 71.3, "B": 40.0}}


def _at_presentation(client: AssessorClient) -> dict:
    return walk(client, until=lambda state: state["stage"] == "presentation")


def _colour(data: bytes) -> tuple[int, int, int]:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    return tuple(int(value) for value in picture[0, 0, ::-1])


def test_a_plan_of_stills_is_judged_from_link_to_table(operator, enter, plan):
    test = operator.make_test(plan)
    client = enter(test)
    seen, state = [], client.state()
    assert (state["stage"], state["display"], state["language"]) == (
        "instructions",
        "polarised",
        "en",
    )
    while state["stage"] != "thanks":
        seen.append(state["stage"])
        state = step(client, state)
    assert seen == [
        "instructions", "screening", "stereo_acuity", "fatigue_before", "training",
        "presentation", "presentation", "presentation", "break", "presentation", "presentation",
        "fatigue_after",
    ]  # fmt: skip
    table = parse_csv(operator.votes_csv(test))
    counted = [vote for vote in table.votes if vote.kind == "test"]
    assert {(vote.content, vote.condition) for vote in counted} == {
        (content, condition) for content in ("ballet", "street") for condition in ("bicubic", "sr")
    }
    assert [vote.kind for vote in table.votes] == ["training", "dummy", *["test"] * 4]
    progress = operator.progress(test)
    assert [(row["assessor"], row["stage"], row["failed"]) for row in progress] == [
        ("a1", "thanks", 0)
    ]


def test_each_side_is_what_the_stored_order_says_and_the_grade_goes_to_it(operator, enter, plan):
    test = operator.make_test(plan)
    client = enter(test)
    order = operator.document(test)["sessions"][0]["order"]
    state = walk(client, until=lambda state: state["stage"] == "training")
    given = []
    for item in order:
        while state["stage"] == "break":
            state = step(client, state)
        client.present()
        sides = {side: _colour(client.fetch(side)) for side in "AB"}
        reference, tested = ("A", "B") if item["reference_is_a"] else ("B", "A")
        assert sides[reference] == colour_of(item["content"], REFERENCE)
        assert sides[tested] == colour_of(item["content"], item["condition"])
        client.shown()
        grades = {reference: 80.0 + len(given), tested: 10.0 + len(given)}
        state = client.grade({"quality": grades})
        given.append((item["content"], item["condition"], grades[reference], grades[tested]))
    rows = list(
        csv.DictReader(line for line in io.StringIO(operator.votes_csv(test)) if line[0] != "#")
    )
    assert [
        (r["content"], r["condition"], float(r["grade_reference"]), float(r["grade_test"]))
        for r in rows
    ] == given  # fmt: skip
    assert [row["reference_side"] == "A" for row in rows] == [i["reference_is_a"] for i in order]


def test_a_link_works_once_and_a_new_one_takes_the_session_over(operator, enter, http, plan):
    test = operator.make_test(plan)
    link = operator.invite(test, "a1", "polarised")
    first = AssessorClient(http=http)
    first.enter(link)
    first.leave("instructions")
    with pytest.raises(DscqsClientError) as caught:
        AssessorClient(http=http).enter(link)
    assert (caught.value.status, caught.value.code) == (410, "used-up")
    first.enter(link)  # the same browser, as where the first answer was lost
    assert first.state()["stage"] == "screening"
    second = enter(test)
    assert second.state()["stage"] == "screening"
    with pytest.raises(DscqsClientError) as caught:
        first.state()
    assert (caught.value.status, caught.value.code) == (401, "not-logged-in")
    with pytest.raises(DscqsClientError) as caught:  # nor does its own link let it in again
        first.enter(link)
    assert caught.value.status == 410


def test_an_unused_link_ends_when_a_newer_is_made(operator, http, plan):
    test = operator.make_test(plan)
    old = operator.invite(test, "a1", "polarised")
    operator.invite(test, "a1", "polarised")
    for link, status in ((old, 410), (f"{old}x", 404)):
        with pytest.raises(DscqsClientError) as caught:
            AssessorClient(http=http).enter(link)
        assert caught.value.status == status


def test_a_link_that_is_looked_at_is_not_used_up(operator, http, plan):
    """Mail and chat programs fetch links before their readers do."""
    test = operator.make_test(plan)
    link = operator.invite(test, "a1", "polarised")
    for method in ("HEAD", "GET"):
        answer = http.request(method, link, follow_redirects=True)
        assert link.partition("#")[2] not in answer.text + str(answer.url.raw_path)
    assert operator.progress(test)[0]["joined"] is False
    client = AssessorClient(http=http)
    client.enter(link)
    assert client.state()["stage"] == "instructions"


def test_an_address_works_once(operator, enter, plan):
    client = enter(operator.make_test(plan))
    _at_presentation(client)
    client.present()
    client.fetch("A")
    with pytest.raises(DscqsClientError) as caught:
        client.fetch("A")
    assert (caught.value.status, caught.value.code) == (410, "used-up")


def test_the_newest_tab_wins(operator, enter, plan):
    client = enter(operator.make_test(plan))
    state = _at_presentation(client)
    other = AssessorClient(http=client.http)
    client.present()
    client.fetch("A")
    other.present()
    for refused in (lambda: client.fetch("B"), client.shown, lambda: client.grade(GRADES)):
        with pytest.raises(DscqsClientError) as caught:
            refused()
        assert caught.value.status in (409, 410)
    for side in "AB":
        other.fetch(side)
    other.shown()
    assert other.grade(GRADES)["index"] == state["index"] + 1


def test_a_vote_needs_both_sides_and_the_end_of_the_showing(operator, enter, plan):
    client = enter(operator.make_test(plan))
    state = _at_presentation(client)
    client.present()
    client.fetch("A")
    for refused in (client.shown, lambda: client.grade(GRADES)):
        with pytest.raises(DscqsClientError) as caught:
            refused()
        assert caught.value.status == 409
    client.fetch("B")
    client.shown()
    for grades, status in (
        ({"quality": {"A": 100.1, "B": 0}}, 400),
        ({"quality": {"A": 10}}, 400),
        ({"quality": {"A": 10.05, "B": 0}}, 400),
        ({}, 400),
    ):
        with pytest.raises(DscqsClientError) as caught:
            client.grade(grades)
        assert (caught.value.status, caught.value.code) == (status, "grades-error")
    assert client.state() == state
    assert client.grade(GRADES, "one")["index"] == state["index"] + 1
    assert client.grade(GRADES, "one")["index"] == state["index"] + 1  # sent twice, counts once
    with pytest.raises(DscqsClientError):
        client.grade({"quality": {"A": 1, "B": 2}}, "one")


def test_a_presentation_that_failed_is_offered_again(operator, enter, plan):
    test = operator.make_test(plan)
    client = enter(test)
    state = _at_presentation(client)
    first = client.present()
    after = client.shown(
        "failed", {"faults": [{"kind": "resized", "detail": "the window was resized"}]}
    )
    assert (after["stage"], after["index"]) == (state["stage"], state["index"])
    second = client.present()
    assert second["ticket"] != first["ticket"]
    row = operator.progress(test)[0]
    assert row["failed"] == 1
    assert row["notes"][-1]["reason"] == "resized: the window was resized"


def test_grades_of_another_session_are_refused(operator, enter, plan):
    test = operator.make_test(plan)
    one, other = enter(test, "a1"), enter(test, "a2")
    for client in (one, other):
        _at_presentation(client)
        client.present()
        for side in "AB":
            client.fetch(side)
        client.shown()
    stranger = AssessorClient(http=one.http, presentation=other.presentation)
    with pytest.raises(DscqsClientError) as caught:
        stranger.grade(GRADES)
    assert caught.value.status == 409
    with pytest.raises(DscqsClientError) as caught:
        stranger.fetch("A")
    assert caught.value.status == 410


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("continue", {}), ("continue", {"stage": 3}), ("continue", {"stage": "x", "more": 1}),
        ("forms", {"stage": "screening"}), ("forms", {"stage": "screening", "answers": []}),
        ("shown", {"ticket": "t", "outcome": "perhaps"}), ("grades", {"ticket": "t"}),
        ("grades", []), ("events", {"kind": "x" * 100}), ("enter", {"link": "x"}),
        ("enter", {"link": "x", "browser": "short"}),
    ],
)  # fmt: skip
def test_malformed_requests_are_400_and_say_where(operator, enter, plan, path, body):
    client = enter(operator.make_test(plan))
    answer = client.http.post(f"/dscqs/api/assessor/{path}", json=body)
    assert answer.status_code == 400
    said = answer.json()
    assert said["code"] == "bad-request"
    assert said["message"].startswith("body")
    assert client.state()["stage"] == "instructions"


def test_nobody_without_a_cookie_gets_anything(http, operator, plan):
    test = operator.make_test(plan)
    for method, path in (
        ("GET", "assessor/state"), ("GET", "assessor/presentation"), ("GET", "assessor/stimulus/x"),
        ("GET", "operator/tests"), ("POST", "operator/tests"), ("GET", f"operator/tests/{test}"),
        ("GET", f"operator/tests/{test}/progress"), ("GET", f"operator/tests/{test}/export"),
        ("POST", f"operator/tests/{test}/links"),
    ):  # fmt: skip
        answer = http.request(method, f"/dscqs/api/{path}", json={} if method == "POST" else None)
        assert answer.status_code in (400, 401), path
        assert "original" not in answer.text
    assert http.post("/dscqs/api/operator/login", json={"token": "x" * 43}).status_code == 401


def test_an_assessor_is_no_operator(operator, enter, plan):
    client = enter(operator.make_test(plan))
    assert client.http.get("/dscqs/api/operator/tests").status_code == 401


def test_paused_resumed_withdrawn_erased(operator, enter, plan):
    test = operator.make_test(plan)
    client = enter(test)
    _at_presentation(client)
    session = operator.progress(test)[0]["session"]
    operator.act(test, session, "pause")
    assert client.state()["stage"] == "paused"
    with pytest.raises(DscqsClientError, match="paused"):
        client.present()
    operator.act(test, "a1", "resume")
    step(client, client.state())
    assert operator.document(test)["sessions"][0]["forms"]["screening"] == {"answer": "screening"}
    operator.act(test, session, "withdraw")
    operator.act(test, session, "erase")
    assert client.state()["stage"] == "withdrawn"
    recorded = operator.document(test)["sessions"][0]
    assert recorded["forms"] == {}
    assert [event["name"] for event in recorded["events"]][-2:] == ["withdrawn", "erased"]
    votes = parse_csv(operator.votes_csv(test)).votes
    assert [(vote.kind, vote.extra["was"]) for vote in votes] == [
        ("withdrawn", "training"), ("withdrawn", "dummy"),
    ]  # fmt: skip


def test_a_dry_run_stores_nothing(operator, http, plan):
    test = operator.make_test(plan)
    answer = operator.http.post(
        f"/dscqs/api/operator/tests/{test}/dry-run",
        json={"assessor": "me", "display": "autostereoscopic"},
    )
    client = AssessorClient(http=http)
    client.enter(answer.json()["link"])
    assert walk(client)["stage"] == "thanks"
    assert operator.progress(test) == []


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"folder": "elsewhere"}, "folder"),
        ({"folder": "../.."}, "folder"),
        ({"contents": []}, "contents"),
        ({"displays": ["polarized"]}, "displays: 'polarized' is none of polarised, "),
        ({"hashes": {"ballet/sr": "0" * 64}}, "ballet/sr"),
        ({"kind": "video"}, "ballet/original"),
    ],
)
def test_a_plan_that_cannot_be_shown_is_refused(operator, plan, change, said):
    before = operator.http.get("/dscqs/api/operator/tests").json()
    with pytest.raises(DscqsClientError) as caught:
        operator.make_test({**plan, **change})
    assert caught.value.status == 400
    assert said in str(caught.value)
    after = operator.http.get("/dscqs/api/operator/tests").json()
    assert after == before


def test_other_pixels_than_those_of_the_stimulus_are_a_failed_showing(operator, enter, plan):
    pixels = {key: f"{number:064x}" for number, key in enumerate(plan["stimuli"])}
    test = operator.make_test({**plan, "pixels": pixels})
    client = enter(test)
    state = walk(client, until=lambda state: state["stage"] == "training")
    item = operator.document(test)["sessions"][0]["order"][0]
    keys = [f"meadow/{REFERENCE}", f"meadow/{item['condition']}"]
    right = dict(zip("AB" if item["reference_is_a"] else "BA", map(pixels.get, keys), strict=True))
    for reported, index in (({**right, "B": "0" * 63 + "f"}, 0), (right, 1)):
        client.present()
        for side in "AB":
            client.fetch(side)
        client.shown("ok", {"pixels": reported})
        if index:
            assert client.grade(GRADES)["stage"] == "presentation"
    assert operator.progress(test)[0]["notes"][0]["reason"] == "pixels: B: other pixels were shown"
    assert state["stage"] == "training"


def test_the_profile_of_a_display_is_that_of_the_day(operator, enter, plan):
    test = operator.make_test(plan)
    client = enter(test)
    assert client.http.get("/dscqs/api/assessor/display").json()["mode"] == "dual"
    url = "/dscqs/api/operator/displays"
    profile = {**operator.http.get(url).json()["polarised"], "swap": True}
    assert operator.http.put(f"{url}/polarised", json=profile).json() == profile
    assert operator.http.put(f"{url}/polarised", json={**profile, "swap": 1}).status_code == 400
    assert client.http.get("/dscqs/api/assessor/display").json()["swap"] is False
    other = enter(test, "a2")
    assert other.http.get("/dscqs/api/assessor/display").json() == profile
    operator.http.put(f"{url}/polarised", json={**profile, "swap": False})


def test_nobody_is_let_in_where_stimuli_are_larger_than_the_display(operator, plan):
    """Stimuli have 32 × 24 pixels for each eye, and are never scaled."""
    small = {"title": "small", "mode": "rows", "width_px": 31, "height_px": 24,
             "distance_heights": 3}  # fmt: skip
    operator.http.put("/dscqs/api/operator/displays/small", json=small)
    test = operator.make_test({**plan, "displays": ["small"]})
    way = f"/dscqs/api/operator/tests/{test}"
    for what, who in (("links", "assessor"), ("dry-run", "assessor"), ("groups", "assessors")):
        asked = {"display": "small", "language": "en", who: ["a1"] if who[-1] == "s" else "a1"}
        answer = operator.http.post(f"{way}/{what}", json=asked)
        assert (answer.status_code, answer.json()["code"]) == (400, "display-error")
        assert "32×24 pixels for each eye, and small 31×24" in answer.json()["message"]
    assert operator.progress(test) == []
    fitting = {**small, "width_px": 32}
    operator.http.put("/dscqs/api/operator/displays/small", json=fitting)
    operator.invite(test, "a1", "small")


def test_a_stimulus_that_was_changed_is_not_shown(operator, enter, plan, served):
    client = enter(operator.make_test(plan))
    state = _at_presentation(client)
    whole = {path: path.read_bytes() for path in (served.data / "stimuli").iterdir()}
    for path, data in whole.items():
        path.write_bytes(data[:-1] + b"x")
    try:
        with pytest.raises(DscqsClientError, match="was changed") as caught:
            client.present()
    finally:
        for path, data in whole.items():
            path.write_bytes(data)
    assert caught.value.status == 500
    assert client.state() == state
    client.present()
