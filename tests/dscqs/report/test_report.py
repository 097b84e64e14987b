"""Reports: what is in them, that nothing is fetched, that odd tests have one too."""

from __future__ import annotations

import dataclasses
import json
import re
from html.parser import HTMLParser

import numpy as np
import pytest

from dscqs.report import LogEntry, html_report, json_report, pdf_report
from dscqs.report.blocks import Heading, Paragraph, Plot, Table
from dscqs.report.content import content
from dscqs.report.numbers import decimal
from dscqs.statistics.analysis import analyse
from dscqs.statistics.screening import Variant
from dscqs.votes import Order, Vote, make_table

from .conftest import simulate


class Page(HTMLParser):
    """Cells of the tables by caption, ids, addresses, running text."""

    def __init__(self, text):
        super().__init__()
        self.tables, self.ids, self.addresses, self.text = {}, [], [], []
        self._cell = self._caption = None
        self._rows = []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.ids += [values["id"]] if "id" in values else []
        self.addresses += [
            values[name] for name in ("src", "href", "xlink:href") if name in values
        ]  # fmt: skip
        if tag == "table":
            self._rows = []
        elif tag == "tr":
            self._rows.append([])
        elif tag in ("td", "th"):
            self._cell = ""
        elif tag == "caption":
            self._caption = ""

    def handle_endtag(self, tag):
        if tag in ("td", "th"):
            self._rows[-1].append(self._cell)
            self._cell = None
        elif tag == "caption":
            self._name, self._caption = self._caption, None
        elif tag == "table":
            self.tables[self._name] = self._rows

    def handle_data(self, data):
        if self._cell is not None:
            self._cell += data
        elif self._caption is not None:
            self._caption += data
        self.text.append(data)


@pytest.fixture(scope="module")
def page(table):
    log = [LogEntry(time="2026-11-25 10:00:00", event="vote", assessor="a01", detail="<b>7</b>")]
    return html_report(table, title="Set 1 & more", log=log).decode()


@pytest.fixture(scope="module")
def parsed(page):
    return Page(page)


def find(tables, beginning):
    (found,) = [rows for caption, rows in tables.items() if caption.startswith(beginning)]
    return found


def test_the_page_fetches_nothing(page, parsed):
    assert all(address.startswith("#") for address in parsed.addresses)
    assert not re.findall(r"@import|url\((?!#)", page)
    assert "<script" not in page
    assert page.count("<svg") == 8  # test score, difference, content, votes, screening, assessors


def test_every_id_is_there_once_and_every_reference_has_its_target(page, parsed):
    assert len(set(parsed.ids)) == len(parsed.ids)
    assert set(re.findall(r'(?:xlink:href="|url\()#([\w-]+)', page)) <= set(parsed.ids)


def test_titles_and_details_are_text_not_markup(page, parsed):
    assert "<h1>Set 1 &amp; more</h1>" in page
    assert find(parsed.tables, "1 events")[1] == ["2026-11-25 10:00:00", "a01", "vote", "<b>7</b>"]


def test_the_table_of_test_scores_has_the_numbers_of_the_votes(table, parsed):
    rows = find(parsed.tables, "Test scores (100 − grade: 0 = excellent, 100 = bad, lower is "
                "better), before")  # fmt: skip
    assert [row[0] for row in rows[2:]] == ["reference", "bicubic", "super-resolved"]
    for row, condition in zip(rows[3:], ("bicubic", "super-resolved"), strict=True):
        for column, display in ((1, "polarised"), (5, "autostereoscopic")):
            grades = np.array(
                [vote.grade_test for vote in table.votes
                 if (vote.display, vote.condition) == (display, condition)]
            )  # fmt: skip
            assert row[column] == f"{100 - grades.mean():.1f}"
            assert row[column + 1] == f"{grades.std(ddof=1) / grades.size**0.5:.1f}"
            assert row[column + 3] == str(grades.size)


def test_tables_and_plots_have_the_order_of_the_plan(table):
    """Whatever was shown first; what the plan does not name comes last."""
    order = Order(
        displays=("autostereoscopic", "polarised"), contents=("ballet", "breakdancing"),
        conditions=("super-resolved",), dimensions=("quality",),
    )  # fmt: skip
    (analysis,) = analyse(dataclasses.replace(table, order=order))
    shown = [(cell.display, cell.content, cell.condition) for cell in analysis.stimuli]
    assert shown == [
        (display, content, condition)
        for display in order.displays
        for content in order.contents
        for condition in ("super-resolved", "bicubic")
    ]
    before = {(c.display, c.content, c.condition): c.primary for c in analyse(table)[0].stimuli}
    for cell in analysis.stimuli:
        assert cell.primary == before[cell.display, cell.content, cell.condition]
    blocks = list(content(dataclasses.replace(table, order=order)))
    (scores,) = (b for b in blocks if isinstance(b, Table) and "before screening; all" in b.caption)
    assert [name for name, _ in scores.groups] == ["", *order.displays]
    assert [row[0] for row in scores.rows] == ["reference", "super-resolved", "bicubic"]
    plot = next(block for block in blocks if isinstance(block, Plot)).draw()
    assert [one.get_text() for one in plot.axes[0].get_xticklabels()] == [
        "reference", "super-resolved", "bicubic",
    ]  # fmt: skip
    (legend,) = plot.legends
    assert [one.get_text() for one in legend.get_texts()] == list(order.displays)


def test_every_assessor_is_in_the_screening_table_with_both_variants(table, parsed):
    (analysis,) = analyse(table)
    for display in analysis.displays:
        rows = find(parsed.tables, f"Screening on {display.display}:")
        assert [row[0] for row in rows[2:]] == list(display.matrix.assessors)
        for row in rows[2:]:
            for start, variant in ((1, Variant.SAMPLE), (6, Variant.POPULATION)):
                found = display.screenings[variant].assessors[row[0]]
                assert row[start : start + 5] == [
                    str(found.high), str(found.low), decimal(found.ratio_total, 3),
                    decimal(found.ratio_balance, 3), "yes" if found.rejected else "no",
                ]  # fmt: skip


def test_missing_votes_and_rules_are_said(parsed):
    text = " ".join("".join(parsed.text).split())
    assert "Missing votes: 2 of 128 on polarised (a12: 2). Nothing was put in their place" in text
    assert "sample standard deviation (n − 1), as the Recommendation writes it" in text
    assert "Informal" not in text


def test_a_small_panel_is_called_informal():
    blocks = list(content(simulate(assessors=8)))
    (warning,) = [b.text for b in blocks if isinstance(b, Paragraph) and b.warning
                  and "Informal" in b.text]  # fmt: skip
    assert "8 on polarised, 8 on autostereoscopic" in warning


def test_the_pdf_has_the_plots_and_the_pages():
    made = pdf_report(simulate(assessors=3), title="Set 1")
    assert made.startswith(b"%PDF-")
    assert made.rstrip().endswith(b"%%EOF")
    assert len(re.findall(rb"/Type /Page\b", made)) >= 4
    assert made.count(b"/Subtype /Image") >= 8


def test_html_is_the_same_for_the_same_votes():
    votes = scores(2)
    assert html_report(votes) == html_report(votes)


def test_json_is_the_contract(table):
    made = json.loads(json_report(table, more={"versions": {}}))
    assert {"stimuli", "screening", "versions", "missing", "models"} <= set(made)
    assert set(made["stimuli"][0]) >= {"display", "content", "condition", "before", "after"}


def scores(conditions, assessors=5):
    return make_table(
        Vote(
            assessor=f"a{a}", content=f"k{c % 3}", condition=f"condition {c}",
            score=float((a * 7 + c * 13) % 5 + 1),
        )
        for a in range(assessors)
        for c in range(conditions)
    )  # fmt: skip


def difference_of(vote):
    return dataclasses.replace(vote, grade_reference=None, grade_test=None)


@pytest.mark.parametrize(
    "votes",
    [
        pytest.param(scores(30), id="single stimulus, many conditions"),
        pytest.param(scores(1, assessors=1), id="one vote"),
        pytest.param(
            make_table([difference_of(vote) for vote in simulate(assessors=3).votes]),
            id="differences only",
        ),
        pytest.param(
            make_table([Vote(assessor="a", content="k", condition="c", score=None)]), id="no vote"
        ),
        pytest.param(
            make_table(
                Vote(assessor=f"a{a}", content="k", condition=c, grade_reference=50.0,
                     grade_test=50.0)
                for a in range(4) for c in ("a very long name of a condition", "b", "c" * 40)
            ),
            id="all votes the same",
        ),
        pytest.param(
            simulate(assessors=2, dimensions=("quality", "comfort")), id="two dimensions"
        ),
    ],
)  # fmt: skip
def test_odd_tests_have_a_report_too(votes):
    for block in content(votes):
        if isinstance(block, Plot):
            figure = block.draw()
            assert figure.axes
            figure.draw_without_rendering()
        elif isinstance(block, Table):
            assert block.rows
            assert all(len(row) == len(block.head) for row in block.rows)
            assert sum(span for _, span in block.groups) in (0, len(block.head))
        else:
            assert isinstance(block, (Heading, Paragraph))
            assert block.text
