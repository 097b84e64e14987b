"""The life of a stream, as a machine without I/O.

::

    waiting ──► starting ──► live ◄──► idle
       ▲           ▲  │       │         │
       │           │  └───────┼─────────┤ worker lost
       │           │          ▼         ▼
       │           └───── restarting ◄──┘
       │                      │ too often
       └── new manifest ── failed         any ──► stopped
"""

from __future__ import annotations

from enum import StrEnum


class State(StrEnum):
    """Where a stream is in its life."""

    WAITING = "waiting"
    """It has been asked for, or has been silent for long; its source's manifest begins it."""
    STARTING = "starting"
    """Its worker starts, or has not finished its first frame."""
    LIVE = "live"
    IDLE = "idle"
    """Its worker lives, its source is silent."""
    RESTARTING = "restarting"
    """Its worker was lost; the next one will be started."""
    STOPPED = "stopped"
    """Somebody stopped it; its source is not listened to."""
    FAILED = "failed"
    """Its worker was lost too often, or refused its manifest."""

    @property
    def has_worker(self) -> bool:
        """True where a process works for it."""
        return self in (State.STARTING, State.LIVE, State.IDLE)


class Action(StrEnum):
    """What can happen to a stream."""

    BEGIN = "begin"
    """Its manifest is known: a worker is started."""
    HEAR = "hear"
    """The worker has published a frame."""
    SILENCE = "silence"
    """Nothing came from the source for a while."""
    LEAVE = "leave"
    """Nothing came for so long that the worker was ended."""
    LOSE = "lose"
    """The worker is gone and was not asked to."""
    GIVE_UP = "give-up"
    STOP = "stop"


class TransitionError(Exception):
    """A stream in this state does not allow that."""

    def __init__(self, state: State, action: Action) -> None:
        super().__init__(f"a stream that is {state} cannot {action}")
        self.state = state
        self.action = action


_WORKING = (State.STARTING, State.LIVE, State.IDLE)
_TABLE = {
    **{
        (state, Action.BEGIN): State.STARTING
        for state in (State.WAITING, State.RESTARTING, State.FAILED, State.STOPPED, *_WORKING)
    },
    **{(state, Action.HEAR): State.LIVE for state in _WORKING},
    **{(state, Action.SILENCE): State.IDLE for state in _WORKING},
    **{(state, Action.LEAVE): State.WAITING for state in _WORKING},
    **{(state, Action.LOSE): State.RESTARTING for state in _WORKING},
    **{(state, Action.GIVE_UP): State.FAILED for state in (State.RESTARTING, *_WORKING)},
    **{(state, Action.STOP): State.STOPPED for state in State},
}


def after(state: State, action: Action) -> State:
    """Return the state that follows.

    >>> after(State.WAITING, Action.BEGIN)
    <State.STARTING: 'starting'>
    """
    try:
        return _TABLE[state, action]
    except KeyError:
        raise TransitionError(state, action) from None
