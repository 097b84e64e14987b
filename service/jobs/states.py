"""The life of a job, as a machine without I/O.

::

    queued ──► running ──► succeeded
      ▲ │         │ │ └──► failed ───┐
      │ │         │ └────► cancelling ──► cancelled ──┐
      │ └─────────┼──────────────────────────▲        │
      └───────────┴──────── retry, recovery ◄─────────┘
"""

from __future__ import annotations

from enum import StrEnum


class State(StrEnum):
    """Where a job is in its life."""

    QUEUED = "queued"
    RUNNING = "running"
    CANCELLING = "cancelling"
    """A worker still holds it, and has been asked to stop."""
    SUCCEEDED = "succeeded"
    FAILED = "failed"
    CANCELLED = "cancelled"

    @property
    def is_final(self) -> bool:
        """True where nothing happens any more unless somebody asks for a retry."""
        return self in (State.SUCCEEDED, State.FAILED, State.CANCELLED)


class Action(StrEnum):
    """What can be done to a job."""

    START = "start"
    SUCCEED = "succeed"
    FAIL = "fail"
    CANCEL = "cancel"
    STOPPED = "stopped"
    LOSE = "lose"
    """The worker is gone: crashed, hung or ended together with the service."""
    RETRY = "retry"


class TransitionError(Exception):
    """A job in this state does not allow that."""

    def __init__(self, state: State, action: Action) -> None:
        super().__init__(f"a job that is {state} cannot {action}")
        self.state = state
        self.action = action


_TABLE = {
    (State.QUEUED, Action.START): State.RUNNING,
    (State.QUEUED, Action.CANCEL): State.CANCELLED,
    (State.QUEUED, Action.FAIL): State.FAILED,
    (State.RUNNING, Action.SUCCEED): State.SUCCEEDED,
    (State.RUNNING, Action.FAIL): State.FAILED,
    (State.RUNNING, Action.CANCEL): State.CANCELLING,
    (State.RUNNING, Action.LOSE): State.QUEUED,
    (State.CANCELLING, Action.CANCEL): State.CANCELLING,
    (State.CANCELLING, Action.STOPPED): State.CANCELLED,
    (State.CANCELLING, Action.LOSE): State.CANCELLED,
    (State.CANCELLING, Action.FAIL): State.CANCELLED,
    (State.CANCELLING, Action.SUCCEED): State.SUCCEEDED,
    (State.CANCELLED, Action.CANCEL): State.CANCELLED,
    (State.FAILED, Action.RETRY): State.QUEUED,
    (State.CANCELLED, Action.RETRY): State.QUEUED,
}


def after(state: State, action: Action) -> State:
    """Return the state that follows.

    >>> after(State.QUEUED, Action.START)
    <State.RUNNING: 'running'>
    """
    try:
        return _TABLE[state, action]
    except KeyError:
        raise TransitionError(state, action) from None
