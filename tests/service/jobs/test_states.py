import pytest

from service.jobs.states import Action, State, TransitionError, after


def _reachable(state: State, *, without: tuple[Action, ...] = ()) -> set[State]:
    found = {state}
    while True:
        more = set()
        for place in found:
            for action in Action:
                if action not in without:
                    try:
                        more.add(after(place, action))
                    except TransitionError:
                        continue
        if more <= found:
            return found
        found |= more


def test_every_state_is_reached_and_none_is_a_trap():
    assert _reachable(State.QUEUED) == set(State)
    for state in State:
        assert State.SUCCEEDED in _reachable(state)


def test_final_states_are_left_by_a_retry_only():
    for state in State:
        if state.is_final:
            assert _reachable(state, without=(Action.RETRY,)) == {state}


def test_success_is_for_ever():
    for action in Action:
        with pytest.raises(TransitionError, match="succeeded cannot"):
            after(State.SUCCEEDED, action)


def test_a_lost_worker_queues_a_job_and_ends_one_that_was_to_stop():
    assert after(State.RUNNING, Action.LOSE) is State.QUEUED
    assert after(State.CANCELLING, Action.LOSE) is State.CANCELLED
