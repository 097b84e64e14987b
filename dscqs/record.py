"""What a test has recorded: its votes as a tidy table, and everything as one JSON document."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from dscqs.errors import VotesError
from dscqs.live_session import reason_of
from dscqs.order import Kind
from dscqs.plan import plan_from_dict
from dscqs.store import SessionRecord, SessionStore, StoredEvent, TestRecord
from dscqs.votes import ORDERED, Order, Vote, VoteTable, format_csv, make_table

WITHDRAWN = "withdrawn"
"""The ``kind`` of the votes of an assessor who left: kept, and not counted."""


@dataclass(frozen=True, kw_only=True)
class LogEntry:
    """One event of a session, for the log at the end of a report.

    Parameters
    ----------
    time : str
        As it is to be printed.
    assessor, event, detail : str
        Empty where not known.
    """

    time: str
    event: str
    assessor: str = ""
    detail: str = ""


def votes_csv(store: SessionStore, test: str) -> str:
    """Return the votes of a test as tidy CSV, dummies and training among them."""
    record = store.test(test)
    notes = [f"test: {record.name} ({record.id})", f"reference: {record.plan['reference']}"]
    return format_csv(votes(store, record), notes=notes, order=_order(record))


def vote_table(store: SessionStore, record: TestRecord) -> VoteTable:
    """Return the votes of a test as a table, in the order of its plan."""
    return make_table(votes(store, record), name=record.name, order=_order(record))


def _order(record: TestRecord) -> Order:
    plan = plan_from_dict(record.plan)
    return Order(**{name: getattr(plan, name) for name in ORDERED})


def votes(store: SessionStore, test: TestRecord) -> list[Vote]:
    """Return the votes of a test, session by session, in the order in which they were given."""
    return [
        vote
        for session in store.sessions(test.id)
        for vote in _votes_of(session, store.events(session.id))
    ]


def test_document(store: SessionStore, test: str) -> dict[str, Any]:
    """Return plan, hashes, orders, forms and the audit trail of a test."""
    record = store.test(test)
    return {
        "test": record.id,
        "name": record.name,
        "created": _time(record.created),
        "plan": dict(record.plan),
        "files": {
            key: {name: file[name] for name in ("sha256", "media_type", "width", "height")}
            for key, file in record.files.items()
        },
        "sessions": [
            {
                "session": session.id,
                "assessor": session.assessor,
                "number": session.number,
                "display": session.display,
                "language": session.language,
                "role": session.role,
                "group": session.group,
                "created": _time(session.created),
                "order_version": session.order_version,
                "order": [dict(item) for item in session.order],
                "forms": store.forms(session.id),
                "events": [
                    {
                        "sequence": event.sequence, "at": _time(event.at), "name": event.name,
                        **event.data,
                    }
                    for event in store.events(session.id)
                ],
            }
            for session in store.sessions(test)
        ],
    }  # fmt: skip


def session_log(document: Mapping[str, Any]) -> list[LogEntry]:
    """Return what happened in the sessions of a test, in the order of time, for the report.

    Parameters
    ----------
    document : mapping
        The JSON export of the test (:func:`test_document`).

    Raises
    ------
    VotesError
        If it is no such export.
    """
    try:
        entries = [
            LogEntry(
                time=event["at"], event=event["name"],
                assessor=f"{session['assessor']} ({session['display']})",
                detail=_detail(event),
            )
            for session in document["sessions"]
            for event in session["events"]
            # What went as planned is in the votes.
            if event["name"] not in ("offered", "shown") or event.get("outcome") == "failed"
        ]  # fmt: skip
        return sorted(entries, key=lambda entry: entry.time)
    except (KeyError, TypeError, AttributeError):
        raise VotesError("is no JSON export of a test") from None


def _detail(event: Mapping[str, Any]) -> str:
    said = [str(event[name]) for name in ("kind", "outcome", "stage") if name in event]
    return ", ".join(said) + (f" ({reason_of(event['log'])})" if event.get("log") else "")


def _votes_of(session: SessionRecord, events: Iterable[StoredEvent]) -> list[Vote]:
    """Return the votes that the events of a session hold.

    Votes come in the order of the presentations, one after the other: that is what the state
    machine lets through.
    """
    found: list[Vote] = []
    is_withdrawn = False
    at = failed = 0
    log: Mapping[str, Any] = {}
    for event in events:
        match event.name:
            case "withdrawn":
                is_withdrawn = True
            case "shown":
                log = event.data["log"]
                failed += event.data["outcome"] == "failed"
            case "skipped":
                at, failed = at + 1, 0
            case "graded":
                item = session.order[at]
                extra = {
                    "position": str(at + 1),
                    "reference_side": "A" if item["reference_is_a"] else "B",
                    "graded_at": _time(event.at),
                    "failed_showings": str(failed),
                    "late_frames": _sum(log, "late"),
                    "dropped_frames": _sum(log, "dropped"),
                }
                found += _votes_of_one(session, item, event.data["grades"], extra)
                at, failed = at + 1, 0
    if is_withdrawn:
        return [_marked(vote) for vote in found]
    return found


def _votes_of_one(
    session: SessionRecord,
    item: Mapping[str, Any],
    grades: Mapping[str, Mapping[str, float]],
    extra: Mapping[str, str],
) -> list[Vote]:
    reference, test = ("A", "B") if item["reference_is_a"] else ("B", "A")
    return [
        Vote(
            assessor=session.assessor, display=session.display, content=item["content"],
            condition=item["condition"], repetition=item["repetition"] + 1, dimension=dimension,
            grade_reference=float(pair[reference]), grade_test=float(pair[test]),
            kind=Kind(item["kind"]).value, extra=dict(extra),
        )
        for dimension, pair in grades.items()
    ]  # fmt: skip


def _sum(log: Mapping[str, Any], name: str) -> str:
    """Return a sum over the intervals that a page reported, where it reported any."""
    intervals = log.get("intervals")
    if not isinstance(intervals, list):
        return ""
    values = [item.get(name) for item in intervals if isinstance(item, Mapping)]
    return str(sum(value for value in values if isinstance(value, int)))


def _marked(vote: Vote) -> Vote:
    return dataclasses.replace(vote, kind=WITHDRAWN, extra={**vote.extra, "was": vote.kind})


def _time(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")
