"""``kill -9`` at every step and in the middle of votes: nothing lost, nothing counted twice."""

from __future__ import annotations

import random
import threading
import time
from contextlib import suppress

import httpx
import pytest

from dscqs.votes import parse_csv
from service.dscqs_client import DscqsClientError, OperatorClient
from service.http.dscqs_access import TOKEN_FILE
from tests.service.dscqs.support import KillableService, walk, write_stimuli
from tests.support.assessor_client import AssessorClient
from tests.support.waiting import PATIENCE


@pytest.fixture
def killable(tmp_path):
    service = KillableService(data=tmp_path / "data", roots=tmp_path / "roots")
    stimuli = write_stimuli(service.roots / "set1")
    service.start()
    yield service, {
        "name": "kills", "folder": "set1", "contents": ["ballet"], "conditions": ["bicubic", "sr"],
        "reference": "original", "dummies": 0, "stages": ["instructions", "screening"],
        "stimuli": {
            key: name for key, name in stimuli.items() if key.startswith("ballet")
        },
    }  # fmt: skip
    service.kill()


@pytest.fixture
def clients(killable):
    service, plan = killable
    with (
        httpx.Client(base_url=service.url, timeout=PATIENCE) as for_operator,
        httpx.Client(base_url=service.url, timeout=PATIENCE) as for_assessor,
    ):
        operator = OperatorClient(http=for_operator)
        operator.login((service.data / TOKEN_FILE).read_text().strip())
        yield operator, AssessorClient(http=for_assessor), operator.make_test(plan)


def _grades(number):
    return {"quality": {"A": 60.5 + number, "B": 40.0 + number}}


def test_a_kill_after_every_answer(killable, clients):
    service, _ = killable
    operator, assessor, test = clients
    kills = 0

    def survives() -> None:
        """The state after a kill and a start is the state before."""
        nonlocal kills
        state, events = assessor.state(), operator.document(test)["sessions"][0]["events"]
        service.kill()
        service.start()
        kills += 1
        assert assessor.state() == state
        assert operator.document(test)["sessions"][0]["events"] == events

    assessor.enter(operator.invite(test, "a1", "polarised"))
    survives()
    assessor.leave("instructions")
    survives()
    assessor.leave("screening", {"acuity": "6/6"})
    survives()
    for number in range(2):
        assessor.present()
        survives()
        with pytest.raises(DscqsClientError) as caught:  # one-time addresses do not outlive it
            assessor.fetch("A")
        assert caught.value.status == 410
        assessor.present()
        assessor.fetch("A")
        survives()
        assessor.present()
        for side in "AB":
            assessor.fetch(side)
        survives()
        assessor.shown()
        survives()
        assert assessor.grade(_grades(number), f"vote {number}")["index"] == number + 1
        survives()
        assert assessor.grade(_grades(number), f"vote {number}")["index"] == number + 1
    assert assessor.state()["stage"] == "thanks"
    assert kills == 13
    votes = parse_csv(operator.votes_csv(test)).votes
    assert [{vote.grade_reference, vote.grade_test} for vote in votes] == [
        {60.5, 40.0}, {61.5, 41.0},
    ]  # fmt: skip


def test_a_kill_in_the_middle_of_a_vote(killable, clients):
    """Whether the vote was stored or not: sent again, it is there once."""
    service, _ = killable
    operator, _, test = clients
    chance = random.Random(7)
    for number in range(5):
        with httpx.Client(base_url=service.url, timeout=PATIENCE) as http:
            assessor = AssessorClient(http=http)
            assessor.enter(operator.invite(test, f"a{number}", "polarised"))
            walk(assessor, until=lambda state: state["stage"] == "presentation")
            assessor.present()
            for side in "AB":
                assessor.fetch(side)
            assessor.shown()

            def vote(client=assessor, number=number):
                with suppress(DscqsClientError):
                    client.grade(_grades(number), "the vote")

            sending = threading.Thread(target=vote)
            sending.start()
            time.sleep(chance.uniform(0, 0.012))
            service.kill()
            sending.join(PATIENCE)
            service.start()
            assert assessor.grade(_grades(number), "the vote")["index"] == 1
    votes = parse_csv(operator.votes_csv(test)).votes
    assert [vote.assessor for vote in votes] == [f"a{number}" for number in range(5)]
    assert [{v.grade_reference, v.grade_test} for v in votes] == [
        {60.5 + number, 40.0 + number} for number in range(5)
    ]  # fmt: skip
