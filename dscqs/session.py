"""A session as a state machine without input and output: event in, new state and effects out.

The steps of a session are known beforehand (:func:`make_steps`); the state says at which of them
it is. Events are stored in the order in which they were taken, and the state is what
:func:`after` makes of them from the start: nothing else is kept. An event that does not fit is
refused with an :class:`OrderError`, and nothing changes.

========================  ===========================================================
stage                     left by
========================  ===========================================================
instructions, break       :class:`Continued`
screening, stereo_acuity  :class:`FormFilled`
fatigue_before, _after    :class:`FormFilled`
training, presentation    :class:`Offered`, :class:`Shown` with ``ok``, :class:`Graded`
thanks                    nothing: it is the end
========================  ===========================================================
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from dscqs.errors import GradesError, OrderError
from dscqs.order import Kind, Presentation
from dscqs.plan import STAGES, Plan

Grades = Mapping[str, Mapping[str, float]]
"""``{dimension: {"A": grade, "B": grade}}``, 0 (bad) … 100 (excellent)."""


class Stage(StrEnum):
    """What a step of a session is."""

    INSTRUCTIONS = "instructions"
    SCREENING = "screening"
    STEREO_ACUITY = "stereo_acuity"
    FATIGUE_BEFORE = "fatigue_before"
    TRAINING = "training"
    PRESENTATION = "presentation"
    BREAK = "break"
    FATIGUE_AFTER = "fatigue_after"
    THANKS = "thanks"


READ = frozenset({Stage.INSTRUCTIONS, Stage.BREAK})
FORMS = frozenset({Stage.SCREENING, Stage.STEREO_ACUITY, Stage.FATIGUE_BEFORE, Stage.FATIGUE_AFTER})
SHOWN = frozenset({Stage.TRAINING, Stage.PRESENTATION})


class Standing(StrEnum):
    """Whether a session goes on."""

    ACTIVE = "active"
    PAUSED = "paused"
    WITHDRAWN = "withdrawn"


class Effect(StrEnum):
    """What has to be done besides storing the event."""

    END_ADDRESSES = "end_addresses"  # those of the stimuli of every earlier ticket
    ERASE_FORMS = "erase_forms"
    FORGET_EVENT = "forget_event"  # it was counted before and is not stored again


@dataclass(frozen=True, kw_only=True)
class Step:
    """One step of a session; the presentation is there where one is shown."""

    stage: Stage
    presentation: Presentation | None = None


STAGES_OF_ROLE: Mapping[str, frozenset[str]] = {
    "station": frozenset(STAGES),
    "phone": frozenset(STAGES) - {"stereo_acuity"},
    "screen": frozenset(),
}
"""Which stages of a plan a role has; a telephone has no breaks either."""


def make_steps(
    plan: Plan, order: Iterable[Presentation], role: str = "station"
) -> tuple[Step, ...]:
    """Return what a session goes through, from instructions to thanks."""
    stages = STAGES_OF_ROLE[role] & set(plan.stages)
    before = ("instructions", "screening", "stereo_acuity", "fatigue_before")
    steps = [Step(stage=Stage(name)) for name in before if name in stages]
    break_every = 0 if role == "phone" else plan.break_every
    shown = 0
    for presentation in order:
        if presentation.kind is Kind.TRAINING:
            steps.append(Step(stage=Stage.TRAINING, presentation=presentation))
            continue
        if shown and break_every and shown % break_every == 0:
            steps.append(Step(stage=Stage.BREAK))
        steps.append(Step(stage=Stage.PRESENTATION, presentation=presentation))
        shown += 1
    if "fatigue_after" in stages:
        steps.append(Step(stage=Stage.FATIGUE_AFTER))
    return (*steps, Step(stage=Stage.THANKS))


# Events


@dataclass(frozen=True, kw_only=True)
class Joined:
    """A link was opened."""


@dataclass(frozen=True, kw_only=True)
class Continued:
    """A stage was left that asks for nothing more."""

    stage: str


@dataclass(frozen=True, kw_only=True)
class FormFilled:
    """A form was filled in; the answers lie elsewhere, since they can be erased."""

    stage: str


@dataclass(frozen=True, kw_only=True)
class Offered:
    """A presentation was given out under a new ticket; earlier tickets end."""

    ticket: str


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A presentation was shown (``ok``), or could not be (``failed``)."""

    ticket: str
    outcome: str
    log: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Graded:
    """A presentation was graded."""

    ticket: str
    submission: str
    grades: Grades


@dataclass(frozen=True, kw_only=True)
class Skipped:
    """The operator went on without the grades of a presentation."""


@dataclass(frozen=True, kw_only=True)
class Advanced:
    """The telephones before a screen have voted, or the operator went on without them."""


@dataclass(frozen=True, kw_only=True)
class Paused:
    """No further presentation is given out for now."""


@dataclass(frozen=True, kw_only=True)
class Resumed:
    """The session goes on."""


@dataclass(frozen=True, kw_only=True)
class Withdrawn:
    """The assessor has left for good; what they graded is kept, and marked."""


@dataclass(frozen=True, kw_only=True)
class Erased:
    """The personal data were erased; the grades are kept."""


@dataclass(frozen=True, kw_only=True)
class Noted:
    """The page says something for the record: focus, full screen, …."""

    kind: str
    detail: Mapping[str, Any] = field(default_factory=dict)


Event = (
    Joined | Continued | FormFilled | Offered | Shown | Graded | Skipped | Advanced | Paused
    | Resumed | Withdrawn | Erased | Noted
)  # fmt: skip

_EVENTS: dict[str, type] = {
    kind.__name__.lower(): kind
    for kind in (
        Joined, Continued, FormFilled, Offered, Shown, Graded, Skipped, Advanced, Paused,
        Resumed, Withdrawn, Erased, Noted,
    )
}  # fmt: skip


def event_to_data(event: Event) -> tuple[str, dict[str, Any]]:
    """Return the name and the fields of an event, as they are stored."""
    return type(event).__name__.lower(), dataclasses.asdict(event)


def event_from_data(name: str, data: Mapping[str, Any]) -> Event:
    """Return the event that was stored."""
    return _EVENTS[name](**data)


# State


@dataclass(frozen=True, kw_only=True)
class Session:
    """Where a session stands."""

    steps: tuple[Step, ...]
    dimensions: tuple[str, ...]
    at: int = 0
    """Index of the present step."""
    standing: Standing = Standing.ACTIVE
    ticket: str | None = None
    """The newest ticket of the present step; the only one that counts."""
    is_shown: bool = False
    """The presentation of that ticket was shown, and may be graded."""
    failed: int = 0
    """Presentations that could not be shown as planned, so far."""
    submissions: Mapping[str, Graded] = field(default_factory=dict)
    """Every vote that counts, by the page's id of it."""
    skipped: int = 0
    """Presentations that were left without a vote here."""

    @property
    def step(self) -> Step:
        """The present step."""
        return self.steps[self.at]

    @property
    def shown_as(self) -> str:
        """The stage as the assessor sees it."""
        return self.step.stage.value if self.standing is Standing.ACTIVE else self.standing.value

    @property
    def is_finished(self) -> bool:
        """True at the thanks."""
        return self.step.stage is Stage.THANKS

    @property
    def num_shown(self) -> int:
        """Presentations that were left behind, training among them."""
        return sum(step.stage in SHOWN for step in self.steps[: self.at])

    @property
    def place(self) -> tuple[int, int]:
        """Index and number of the steps of the present kind: training, or presentations."""
        counted = Stage.TRAINING if self.step.stage is Stage.TRAINING else Stage.PRESENTATION
        stages = [step.stage for step in self.steps]
        return stages[: self.at].count(counted), stages.count(counted)


def after(session: Session, event: Event) -> tuple[Session, frozenset[Effect]]:
    """Return the state after an event, and what else has to be done.

    Raises
    ------
    OrderError
        If the event does not fit the state.
    GradesError
        If grades are malformed.
    """
    nothing: frozenset[Effect] = frozenset()
    match event:
        case Joined() | Noted():
            return session, nothing
        case Erased():
            return session, frozenset({Effect.ERASE_FORMS})
        case _ if session.standing is Standing.WITHDRAWN:
            raise OrderError("the session was ended; nothing more is taken")
        case Withdrawn():
            changed = dataclasses.replace(
                session, standing=Standing.WITHDRAWN, ticket=None, is_shown=False
            )
            return changed, frozenset({Effect.END_ADDRESSES})
        case Paused():
            return dataclasses.replace(session, standing=Standing.PAUSED), nothing
        case Resumed():
            return dataclasses.replace(session, standing=Standing.ACTIVE), nothing
        case Continued(stage=stage):
            _check_stage(session, stage, READ)
            return _forward(session), nothing
        case FormFilled(stage=stage):
            _check_stage(session, stage, FORMS)
            return _forward(session), nothing
        case Offered(ticket=ticket):
            _check_active(session)
            if session.step.stage not in SHOWN:
                raise OrderError(f"nothing is shown in the stage {session.step.stage.value}")
            changed = dataclasses.replace(session, ticket=ticket, is_shown=False)
            return changed, frozenset({Effect.END_ADDRESSES})
        case Shown():
            return _after_shown(session, event)
        case Graded():
            return _after_graded(session, event)
        case Advanced() if not session.is_shown:
            raise OrderError("the presentation has not been shown to its end yet")
        case Skipped() | Advanced():
            if session.step.stage not in SHOWN:
                raise OrderError("there is no presentation to skip")
            changed = dataclasses.replace(_forward(session), skipped=session.skipped + 1)
            return changed, frozenset({Effect.END_ADDRESSES})


def _after_shown(session: Session, event: Shown) -> tuple[Session, frozenset[Effect]]:
    _check_ticket(session, event.ticket)
    if event.outcome == "ok":
        return dataclasses.replace(session, is_shown=True), frozenset()
    if event.outcome != "failed":
        raise GradesError(f"outcome: {event.outcome!r} is neither 'ok' nor 'failed'")
    changed = dataclasses.replace(session, ticket=None, is_shown=False, failed=session.failed + 1)
    return changed, frozenset({Effect.END_ADDRESSES})


def _after_graded(session: Session, event: Graded) -> tuple[Session, frozenset[Effect]]:
    known = session.submissions.get(event.submission)
    if known is not None:
        if known != event:
            raise OrderError("another vote was sent under this submission before")
        return session, frozenset({Effect.FORGET_EVENT})
    _check_ticket(session, event.ticket)
    if not session.is_shown:
        raise OrderError("the presentation has not been shown to its end yet")
    check_grades(event.grades, session.dimensions)
    changed = dataclasses.replace(
        _forward(session), submissions={**session.submissions, event.submission: event}
    )
    return changed, frozenset({Effect.END_ADDRESSES})


def check_grades(grades: Grades, dimensions: Iterable[str]) -> None:
    """Refuse grades that are not one pair for each dimension, 0 … 100 in steps of 0.1."""
    wanted = set(dimensions)
    if not isinstance(grades, Mapping) or set(grades) != wanted:
        raise GradesError(f"grades: must have exactly {', '.join(sorted(wanted))}")
    for dimension, pair in grades.items():
        if not isinstance(pair, Mapping) or set(pair) != {"A", "B"}:
            raise GradesError(f"grades.{dimension}: must have exactly A and B")
        for side, grade in pair.items():
            where = f"grades.{dimension}.{side}"
            if isinstance(grade, bool) or not isinstance(grade, (int, float)):
                raise GradesError(f"{where}: {grade!r} is not a number")
            if not math.isfinite(grade) or not 0 <= grade <= 100:
                raise GradesError(f"{where}: {grade} is not within 0 … 100")
            if abs(grade * 10 - round(grade * 10)) > 1e-6:
                raise GradesError(f"{where}: {grade} is finer than 0.1")


def _forward(session: Session) -> Session:
    return dataclasses.replace(session, at=session.at + 1, ticket=None, is_shown=False)


def _check_active(session: Session) -> None:
    if session.standing is Standing.PAUSED:
        raise OrderError("the session is paused")


def _check_stage(session: Session, stage: str, kinds: frozenset[Stage]) -> None:
    present = session.step.stage
    if stage != present:
        raise OrderError(f"the session is at {present.value}, not at {stage}")
    if present not in kinds:
        raise OrderError(f"the stage {present.value} is not left this way")


def _check_ticket(session: Session, ticket: str) -> None:
    if session.ticket is None or ticket != session.ticket:
        raise OrderError(
            "the ticket is not the newest: the presentation was done, or another page showed it"
        )
