"""What assessors and operators may see of a session, as plain data."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from dscqs.group import Group
from dscqs.live_session import LiveSession
from dscqs.session import Stage

LABELS = ("Excellent", "Good", "Fair", "Poor", "Bad")
"""Of the five fifths of the scale, best first."""


def state_view(live: LiveSession, group: Group | None = None) -> dict[str, Any]:
    """Return where the session stands; nothing in it depends on what is shown.

    ``group`` is given for a screen.
    """
    plan, state = live.plan, live.state
    index, total = state.place
    view: dict[str, Any] = {
        "stage": state.shown_as,
        "index": index,
        "total": total,
        "language": live.record.language,
        "display": live.record.display,
        "dimensions": list(plan.dimensions),
        "variant": plan.variant,
        "showings": plan.timing.showings,
        "role": live.record.role,
    }
    if state.step.stage is Stage.BREAK:
        view["break_s"] = plan.break_s
    if live.record.role == "phone":
        view["ticket"] = state.ticket if state.is_shown else None
    if group is not None:
        view["voting"] = state.is_shown
        view["votes"] = {"given": group.given, "of": len(group.active)}
    return view


def presentation_view(live: LiveSession, tokens: Mapping[str, str]) -> dict[str, Any]:
    """Return a presentation as it is given out; dummies and training look like every other."""
    plan = live.plan
    return {
        "ticket": live.state.ticket,
        "kind": plan.kind,
        "layout": plan.layout,
        "sides": dict(tokens),
        "variant": plan.variant,
        "grey": plan.grey,
        "captions": plan.captions,
        "timing": dataclasses.asdict(plan.timing),
        "dimensions": list(plan.dimensions),
        "labels": list(LABELS),
    }


def progress_view(live: LiveSession) -> dict[str, Any]:
    """Return what the operator sees of a session."""
    index, total = live.state.place
    record = live.record
    return {
        "session": record.id,
        "assessor": record.assessor,
        "display": record.display,
        "language": record.language,
        "role": record.role,
        "group": record.group,
        "stage": live.state.shown_as,
        "step": live.state.step.stage.value,
        "index": index,
        "total": total,
        "failed": live.state.failed,
        "joined": live.has_joined,
        "last": live.last,
        "notes": list(live.notes),
    }
