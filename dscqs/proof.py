"""Proves from an export that the orders of a test are those that its plan and seed give."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

from dscqs.errors import VotesError
from dscqs.order import ORDER_VERSION, make_order
from dscqs.plan import plan_from_dict


def unproved_orders(document: Mapping[str, Any]) -> list[str]:
    """Return what does not follow from plan, seed and assessor: a line each, none if all does.

    Parameters
    ----------
    document : mapping
        The JSON export of a test (:func:`dscqs.record.test_document`).

    Raises
    ------
    VotesError
        If it is no such export.
    """
    try:
        plan = plan_from_dict(document["plan"])
        sessions = [
            (one["assessor"], one["display"], one["number"], one["order_version"], one["order"])
            for one in document["sessions"]
        ]
    except (KeyError, TypeError):
        raise VotesError("is no JSON export of a test") from None
    found = []
    for assessor, display, number, version, order in sessions:
        if version != ORDER_VERSION:
            found.append(f"{assessor} on {display}: drawn by version {version}, not known here")
            continue
        expected = [dataclasses.asdict(item) for item in make_order(plan, number, display)]
        wrong = [at for at, item in enumerate(expected) if item not in order[at : at + 1]]
        if len(order) != len(expected):
            found.append(
                f"{assessor} on {display}: {len(order)} presentations, not {len(expected)}"
            )
        elif wrong:
            found.append(f"{assessor} on {display}: presentation {wrong[0] + 1} is another")
    return found
