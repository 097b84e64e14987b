"""A group before one screen: the screen leads, every telephone votes, nobody is waited for ever."""

from __future__ import annotations

import pytest

from dscqs.votes import parse_csv
from service.dscqs_client import DscqsClientError
from tests.service.dscqs.support import step, walk
from tests.support.assessor_client import AssessorClient


@pytest.fixture
def group(operator, make_http, plan):
    """A screen, three telephones, and the test."""
    test = operator.make_test({**plan, "break_every": 2})
    link, links = operator.invite_group(test, ["p1", "p2", "p3"], "polarised")
    screen = AssessorClient(http=make_http())
    screen.enter(link)
    phones = {name: AssessorClient(http=make_http()) for name in links}
    for name, client in phones.items():
        client.enter(links[name])
    return test, screen, phones


def _ready(client):
    return walk(client, until=lambda state: state["stage"] == "training")


def _show(screen):
    screen.present()
    for side in "AB":
        screen.fetch(side)
    return screen.shown()


def _vote(client, a=70.0, b=30.0):
    state = client.state()
    client.presentation = {"ticket": state["ticket"]}
    return client.grade({"quality": {"A": a, "B": b}})


def test_a_group_goes_through_a_test(group, operator):
    test, screen, phones = group
    seen = []
    for client in phones.values():
        _ready(client)
    state = screen.state()
    assert (state["role"], state["voting"], state["votes"]) == (
        "screen", False, {"given": 0, "of": 3},
    )  # fmt: skip
    shown = 0
    while state["stage"] != "thanks":
        seen.append(state["stage"])
        if state["stage"] == "break":
            state = step(screen, state)
            continue
        assert [client.state()["ticket"] for client in phones.values()] == [None] * 3
        state = _show(screen)
        assert state["voting"]
        for number, client in enumerate(phones.values()):
            assert screen.state()["votes"] == {"given": number, "of": 3}
            _vote(client, 50.0 + number, 10.0 + shown)
        shown += 1
        state = screen.state()
    assert seen.count("break") == 2
    assert {client.state()["stage"] for client in phones.values()} == {"fatigue_after"}
    votes = parse_csv(operator.votes_csv(test)).votes
    assert len(votes) == 3 * shown == 18
    sessions = operator.document(test)["sessions"]
    assert len({str(session["order"]) for session in sessions}) == 1
    for vote in votes:  # each telephone's grades went to the sides of the one order
        first = vote.grade_reference if vote.extra["reference_side"] == "A" else vote.grade_test
        assert first == 50.0 + int(vote.assessor[1]) - 1


def test_the_operator_goes_on_without_a_vote(group, operator):
    test, screen, phones = group
    for client in phones.values():
        _ready(client)
    _show(screen)
    _vote(phones["p1"])
    index = screen.state()
    assert screen.leave(index["stage"])["stage"] == "presentation"
    assert {client.state()["ticket"] for client in phones.values()} == {None}
    with pytest.raises(DscqsClientError):
        screen.leave("presentation")  # nothing is being voted on
    assert len(parse_csv(operator.votes_csv(test)).votes) == 1
    assert {client.state()["stage"] for client in phones.values()} == {"presentation"}


def test_who_withdraws_or_comes_late_is_not_waited_for(group, operator):
    test, screen, phones = group
    _ready(phones["p1"])
    _ready(phones["p2"])
    operator.act(test, "p2", "withdraw")
    _show(screen)
    _vote(phones["p1"])
    assert screen.state()["stage"] == "presentation"
    assert _ready_late(phones["p3"])["stage"] == "presentation"  # what it missed is skipped
    _show(screen)
    _vote(phones["p1"])
    assert screen.state()["voting"]
    _vote(phones["p3"])
    assert not screen.state()["voting"]


def _ready_late(client):
    return walk(client, until=lambda state: state["stage"] in ("training", "presentation"))


def test_a_screen_gives_no_grades_and_a_telephone_shows_nothing(group):
    _, screen, phones = group
    _ready(phones["p1"])
    with pytest.raises(DscqsClientError, match="the screen shows"):
        phones["p1"].present()
    _show(screen)
    with pytest.raises(DscqsClientError, match="telephones vote"):
        screen.grade({"quality": {"A": 1.0, "B": 2.0}})


def test_a_code_is_one_assessor(operator, plan):
    test = operator.make_test(plan)
    operator.invite(test, "p1", "polarised")
    for codes, status in ((["p1", "p2"], 409), (["p2", "p2"], 400), ([], 400)):
        with pytest.raises(DscqsClientError) as caught:
            operator.invite_group(test, codes, "polarised")
        assert caught.value.status == status
    assert len(operator.progress(test)) == 1
