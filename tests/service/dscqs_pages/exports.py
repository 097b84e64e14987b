"""What a test of people has stored, as its exports tell it."""

from __future__ import annotations

import csv
import io
from typing import Any

from tests.service.dscqs.support import REFERENCE, colour_of

EXPORT = "/dscqs/api/operator/tests/{}/export?format={}"


def votes_of(operator: Any, test: str) -> list[dict[str, str]]:
    text = operator.http.get(EXPORT.format(test, "csv")).text
    lines = [line for line in text.splitlines() if not line.startswith("#")]
    return list(csv.DictReader(io.StringIO("\n".join(lines))))


def document_of(operator: Any, test: str) -> dict[str, Any]:
    return operator.http.get(EXPORT.format(test, "json")).json()


def logs_of(operator: Any, test: str) -> list[dict[str, Any]]:
    """What the page said of every showing."""
    (session,) = document_of(operator, test)["sessions"]
    return [event for event in session["events"] if event["name"] == "shown"]


def given(votes: list[dict[str, str]]) -> list[dict[str, float]]:
    """The grades of A and B, as they were given."""
    found = []
    for vote in votes:
        reference, tested = float(vote["grade_reference"]), float(vote["grade_test"])
        is_a = vote["reference_side"] == "A"
        found.append({"A": reference if is_a else tested, "B": tested if is_a else reference})
    return found


def sides_of(vote: dict[str, str]) -> list[list[int]]:
    """The colours of A and B."""
    tested, reference = (
        list(colour_of(vote["content"], name)) for name in (vote["condition"], REFERENCE)
    )
    return [reference, tested] if vote["reference_side"] == "A" else [tested, reference]
