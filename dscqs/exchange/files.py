"""Votes from a file of any known format, and into text of one."""

from __future__ import annotations

import json
from collections.abc import Sequence
from enum import StrEnum
from pathlib import Path

from dscqs.errors import VotesError
from dscqs.exchange.plain import parse_json
from dscqs.exchange.sujson import from_sujson, to_sujson
from dscqs.exchange.sureal import from_sureal, to_sureal
from dscqs.votes import VoteTable, format_csv, parse_csv, read_text


class Format(StrEnum):
    """What votes can be written as."""

    CSV = "csv"  # tidy: one vote a row
    SUJSON = "sujson"
    SUREAL = "sureal"  # one display and one dimension


def read_scores(path: Path) -> VoteTable:
    """Read votes: tidy CSV, suJSON, or a dataset of sureal as JSON; told apart by content.

    Raises
    ------
    VotesError
        Naming file, line or place, and rule.
    """
    if path.suffix == ".py":
        raise VotesError(
            "a dataset in Python would have to be executed, and is not read; write it as JSON "
            "with the keys dataset_name, ref_score, ref_videos, dis_videos",
            path=path,
        )
    return parse_scores(read_text(path), name=str(path))


def parse_scores(text: str, *, name: str = "votes") -> VoteTable:
    """Return the votes of a text, as :func:`read_scores` does."""
    if not text.lstrip().startswith(("{", "[")):
        return parse_csv(text, name=name)
    document = parse_json(text, name)
    if isinstance(document, dict) and "trials" in document and "scores" in document:
        return from_sujson(document, name)
    if isinstance(document, dict) and "dis_videos" in document:
        return from_sureal(document, name)
    raise VotesError(
        "is JSON, but neither suJSON (trials, scores) nor a dataset of sureal (dis_videos)",
        path=name,
    )


def format_scores(
    table: VoteTable,
    kind: Format,
    *,
    display: str | None = None,
    dimension: str | None = None,
    notes: Sequence[str] = (),
) -> str:
    """Return the votes as text of a format.

    Parameters
    ----------
    display, dimension : str or None
        For sureal, which holds one of each: which. None: the only one.
    notes : sequence of str
        Lines at the head of a CSV file.

    Raises
    ------
    VotesError
        Where one display or dimension has to be named.
    """
    if kind is Format.CSV:
        return format_csv(table.votes, notes=notes, order=table.order)
    if kind is Format.SUJSON:
        made = to_sujson(table)
    else:
        made = to_sureal(
            table,
            display=display or _only(table, "display"),
            dimension=dimension or _only(table, "dimension"),
        )
    return json.dumps(made, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _only(table: VoteTable, column: str) -> str:
    names = table.order.arrange(f"{column}s", (getattr(vote, column) for vote in table.votes))
    if len(names) > 1:
        raise VotesError(
            f"has votes of several: {', '.join(names)}; a dataset of sureal holds one, name it",
            path=table.name,
            column=column,
        )
    return str(names[0])
