"""Reports of a test: votes in, bytes of HTML, PDF or JSON out; no files, no clock.

What a web page or a command calls::

    table = parse_csv(text)                        # or read_scores(path), or the store's votes
    page = html_report(table, title="Set 1", log=[LogEntry(time="…", event="vote", …)])

* :mod:`content`: the report as a sequence of :mod:`blocks`: :mod:`tables`, :mod:`plots` (their
  look is :mod:`style`), paragraphs of :mod:`methods`; :mod:`numbers` as they are printed;
* :mod:`html`, :mod:`pdf`: what writes the blocks down.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from dscqs.record import LogEntry
from dscqs.report.content import content
from dscqs.statistics.analysis import analyse
from dscqs.statistics.document import document
from dscqs.statistics.screening import Variant
from dscqs.votes import VoteTable

__all__ = ["LogEntry", "html_report", "json_report", "pdf_report"]


def html_report(
    table: VoteTable,
    *,
    title: str | None = None,
    subtitle: str = "",
    variant: Variant = Variant.SAMPLE,
    log: Sequence[LogEntry] = (),
) -> bytes:
    """Return the report as one HTML file that fetches nothing.

    Parameters
    ----------
    table : VoteTable
    title, subtitle : str
        Head of the report; the title is the table's name unless given. The time of making it,
        where wanted, belongs into the subtitle.
    variant : Variant
        Screening that decides the results "after".
    log : sequence of LogEntry
        Events of the sessions, in order.
    """
    from dscqs.report.html import html

    return html(*_head(table, title, subtitle), content(table, variant=variant, log=log))


def pdf_report(
    table: VoteTable,
    *,
    title: str | None = None,
    subtitle: str = "",
    variant: Variant = Variant.SAMPLE,
    log: Sequence[LogEntry] = (),
) -> bytes:
    """Return the report as PDF; parameters as :func:`html_report`."""
    from dscqs.report.pdf import pdf

    return pdf(*_head(table, title, subtitle), content(table, variant=variant, log=log))


def json_report(
    table: VoteTable,
    *,
    variant: Variant = Variant.SAMPLE,
    more: Mapping[str, Any] | None = None,
) -> bytes:
    """Return the analysis as JSON (docs/dscqs-statistics.md), never with NaN.

    Parameters
    ----------
    more : mapping
        Further keys at the top, such as versions.
    """
    made = {**document(analyse(table, variant)), **(more or {})}
    return (json.dumps(made, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def _head(table: VoteTable, title: str | None, subtitle: str) -> tuple[str, str]:
    votes = f"{len(table.votes)} votes"
    return title or table.name, f"{subtitle} · {votes}" if subtitle else votes
