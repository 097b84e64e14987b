from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dscqs.errors import DscqsError, GradesError, OrderError
from dscqs.order import make_order
from dscqs.plan import plan_from_dict
from dscqs.session import (
    FORMS,
    READ,
    SHOWN,
    Continued,
    Effect,
    Erased,
    Event,
    FormFilled,
    Graded,
    Joined,
    Noted,
    Offered,
    Paused,
    Resumed,
    Session,
    Shown,
    Skipped,
    Stage,
    Standing,
    Withdrawn,
    after,
    event_from_data,
    event_to_data,
    make_steps,
)

PLAN = plan_from_dict(
    {
        "name": "set 1", "contents": ["ballet", "street"], "conditions": ["bicubic", "sr"],
        "reference": "original", "dummies": 1, "break_every": 2, "training": ["lawn/sr"],
        "dimensions": ["quality", "depth"],
        "stimuli": {
            f"{content}/{condition}": f"{content}-{condition}.png"
            for content in ("ballet", "street") for condition in ("original", "bicubic", "sr")
        } | {"lawn/original": "l.png", "lawn/sr": "m.png"},
    }
)  # fmt: skip
GRADES = {"quality": {"A": 71.3, "B": 40}, "depth": {"A": 0, "B": 100}}


def replay(session: Session, events: Iterable[Event]) -> Session:
    """Return the state after all events."""
    for event in events:
        session, _ = after(session, event)
    return session


def check_invariants(session: Session) -> None:
    """Check that a state does not contradict itself."""
    assert 0 <= session.at < len(session.steps)
    assert session.num_shown == len(session.submissions) + session.skipped
    assert len({vote.ticket for vote in session.submissions.values()}) == len(session.submissions)
    assert session.ticket is None or session.step.stage in SHOWN
    assert not session.is_shown or session.ticket is not None
    assert session.standing is not Standing.WITHDRAWN or session.ticket is None


def _new(plan=PLAN) -> Session:
    steps = make_steps(plan, make_order(plan, 0))
    return Session(steps=steps, dimensions=plan.dimensions)


def _next_events(session: Session) -> list:
    """What a well-behaved page does to leave the present step."""
    stage = session.step.stage
    if stage in READ:
        return [Continued(stage=stage)]
    if stage in FORMS:
        return [FormFilled(stage=stage)]
    ticket = f"t{session.at}"
    return [
        Offered(ticket=ticket), Shown(ticket=ticket, outcome="ok"),
        Graded(ticket=ticket, submission=f"s{session.at}", grades=GRADES),
    ]  # fmt: skip


def _at(stage: Stage) -> Session:
    session = _new()
    while session.step.stage is not stage:
        session = replay(session, _next_events(session))
    return session


def test_a_session_goes_through_its_stages():
    session, seen, places = _new(), [], []
    while not session.is_finished:
        seen.append(session.step.stage.value)
        places.append(session.place)
        session = replay(session, _next_events(session))
        check_invariants(session)
    assert seen == [
        "instructions", "screening", "stereo_acuity", "fatigue_before", "training",
        "presentation", "presentation", "break", "presentation", "presentation", "break",
        "presentation", "fatigue_after",
    ]  # fmt: skip
    assert places[4:11] == [(0, 1), (0, 5), (1, 5), (2, 5), (2, 5), (3, 5), (4, 5)]
    assert len(session.submissions) == 6


def test_a_plan_may_leave_stages_out():
    plan = dataclasses.replace(PLAN, stages=(), training=(), break_every=0, stimuli={
        key: name for key, name in PLAN.stimuli.items() if "lawn" not in key
    })  # fmt: skip
    stages = [step.stage for step in make_steps(plan, make_order(plan, 0))]
    assert stages == [Stage.PRESENTATION] * 5 + [Stage.THANKS]


@pytest.mark.parametrize(
    ("stage", "event"),
    [
        (Stage.INSTRUCTIONS, Continued(stage="screening")),
        (Stage.INSTRUCTIONS, FormFilled(stage="instructions")),
        (Stage.SCREENING, Continued(stage="screening")),
        (Stage.SCREENING, Offered(ticket="t")),
        (Stage.PRESENTATION, Continued(stage="presentation")),
        (Stage.PRESENTATION, Shown(ticket="never", outcome="ok")),
        (Stage.PRESENTATION, Graded(ticket="never", submission="s", grades=GRADES)),
        (Stage.BREAK, Skipped()),
        (Stage.THANKS, Continued(stage="thanks")),
        (Stage.THANKS, Offered(ticket="t")),
    ],
)
def test_what_does_not_fit_is_refused(stage, event):
    with pytest.raises(OrderError):
        after(_at(stage), event)


def test_only_the_newest_ticket_counts():
    session = replay(_at(Stage.PRESENTATION), [Offered(ticket="old"), Offered(ticket="new")])
    with pytest.raises(OrderError):
        after(session, Shown(ticket="old", outcome="ok"))
    shown = replay(session, [Shown(ticket="new", outcome="ok")])
    with pytest.raises(OrderError):
        after(shown, Graded(ticket="old", submission="s", grades=GRADES))
    assert shown.is_shown


def test_nothing_is_graded_before_it_was_shown():
    session = replay(_at(Stage.PRESENTATION), [Offered(ticket="t")])
    with pytest.raises(OrderError, match="not been shown"):
        after(session, Graded(ticket="t", submission="s", grades=GRADES))


def test_a_presentation_that_failed_is_offered_again():
    session, effects = after(
        replay(_at(Stage.PRESENTATION), [Offered(ticket="t")]), Shown(ticket="t", outcome="failed")
    )
    assert session.failed == 1
    assert session.ticket is None
    assert effects == {Effect.END_ADDRESSES}
    again = replay(session, [Offered(ticket="u"), Shown(ticket="u", outcome="ok")])
    assert again.step == session.step
    assert again.is_shown


def test_a_vote_sent_twice_counts_once_and_under_its_name_no_other():
    session = replay(
        _at(Stage.PRESENTATION), [Offered(ticket="t"), Shown(ticket="t", outcome="ok")]
    )
    vote = Graded(ticket="t", submission="s", grades=GRADES)
    once, _ = after(session, vote)
    twice, effects = after(once, vote)
    assert twice == once
    assert effects == {Effect.FORGET_EVENT}
    other = {**GRADES, "quality": {"A": 1, "B": 2}}
    with pytest.raises(OrderError, match="another vote"):
        after(once, Graded(ticket="t", submission="s", grades=other))


@pytest.mark.parametrize(
    "grades",
    [
        {}, {"quality": {"A": 1, "B": 2}}, {**GRADES, "beauty": {"A": 1, "B": 2}},
        {**GRADES, "depth": {"A": 1}}, {**GRADES, "depth": {"A": 1, "B": 2, "C": 3}},
        {**GRADES, "depth": {"A": 1, "B": 100.1}}, {**GRADES, "depth": {"A": -0.1, "B": 1}},
        {**GRADES, "depth": {"A": float("nan"), "B": 1}}, {**GRADES, "depth": {"A": True, "B": 1}},
        {**GRADES, "depth": {"A": "50", "B": 1}}, {**GRADES, "depth": {"A": 1.25, "B": 1}},
        {**GRADES, "depth": [1, 2]}, {**GRADES, "depth": {"A": None, "B": 1}},
    ],
)  # fmt: skip
def test_malformed_grades_are_refused(grades):
    session = replay(
        _at(Stage.PRESENTATION), [Offered(ticket="t"), Shown(ticket="t", outcome="ok")]
    )
    with pytest.raises(GradesError):
        after(session, Graded(ticket="t", submission="s", grades=grades))


def test_every_tenth_is_a_grade():
    for tenth in range(1001):
        after(
            replay(_at(Stage.TRAINING), [Offered(ticket="t"), Shown(ticket="t", outcome="ok")]),
            Graded(ticket="t", submission="s", grades={
                "quality": {"A": tenth / 10, "B": round(tenth * 0.1, 1)},
                "depth": {"A": 0, "B": 100.0},
            }),
        )  # fmt: skip


def test_while_paused_a_vote_is_taken_but_nothing_new_is_shown():
    session = replay(
        _at(Stage.PRESENTATION), [Offered(ticket="t"), Shown(ticket="t", outcome="ok"), Paused()]
    )
    assert session.shown_as == "paused"
    voted = replay(session, [Graded(ticket="t", submission="s", grades=GRADES)])
    assert voted.at == session.at + 1
    with pytest.raises(OrderError, match="paused"):
        after(voted, Offered(ticket="u"))
    assert replay(voted, [Resumed()]).shown_as == voted.step.stage.value


def test_who_withdrew_stays_so_and_their_votes_stay():
    session = replay(_at(Stage.BREAK), [Withdrawn()])
    assert session.shown_as == "withdrawn"
    assert len(session.submissions) == 3
    for event in (Resumed(), Continued(stage="break"), Offered(ticket="t")):
        with pytest.raises(OrderError):
            after(session, event)
    assert after(session, Erased())[1] == {Effect.ERASE_FORMS}


EVENTS = st.one_of(
    st.builds(Continued, stage=st.sampled_from([*Stage])),
    st.builds(FormFilled, stage=st.sampled_from([*Stage])),
    st.builds(Offered, ticket=st.integers().map(str)),
    st.builds(Shown, ticket=st.just("?"), outcome=st.sampled_from(["ok", "ok", "failed", "?"])),
    st.builds(
        Graded, ticket=st.just("?"), submission=st.sampled_from("abcdefgh"),
        grades=st.sampled_from([GRADES, {}, {**GRADES, "depth": {"A": 3, "B": 4}}]),
    ),
    st.sampled_from([Joined(), Paused(), Resumed(), Skipped(), Erased(), Noted(kind="focus")]),
    st.just("go on"),
)  # fmt: skip


@given(st.lists(EVENTS, max_size=60), st.booleans())
def test_whatever_comes_the_state_is_sound_and_is_the_replay_of_what_was_taken(events, withdraws):
    session, taken = _new(), []
    for event in [*events, *([Withdrawn()] if withdraws else [])]:
        wanted = _next_events(session) if event == "go on" and not session.is_finished else [event]
        for one in wanted:
            if isinstance(one, (Shown, Graded)) and one.ticket == "?":
                one = dataclasses.replace(one, ticket=session.ticket or "none")
            if one == "go on":
                continue
            before = session
            try:
                session, effects = after(session, one)
            except DscqsError:
                assert session == before
                continue
            check_invariants(session)
            assert session.at - before.at in (0, 1)
            if Effect.FORGET_EVENT not in effects:
                taken.append(one)
    stored = [json.loads(json.dumps(event_to_data(event))) for event in taken]
    assert replay(_new(), [event_from_data(*data) for data in stored]) == session
    assert (session.standing is Standing.WITHDRAWN) == withdraws
