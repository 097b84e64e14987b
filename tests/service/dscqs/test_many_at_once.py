"""The benchmark of many assessors at once: what it counts, and where it writes it."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))  # the benchmarks are not installed

from benchmarks import dscqs as bench
from dscqs.plan import plan_from_dict


@pytest.fixture
def measured(monkeypatch, operator, served, plan):
    monkeypatch.setattr(bench, "TWICE", 0.5)
    short = {**plan, "training": [], "break_every": 0, "dummies": 0}
    short["stimuli"] = {
        key: name for key, name in plan["stimuli"].items() if not key.startswith("meadow")
    }
    return bench.measure(
        operator, served.url, plan_from_dict(short), 4, speed=1000.0, service=os.getpid()
    )


def test_votes_are_counted_once_though_some_are_sent_twice(measured):
    assert len(measured.round_trips_ms) == 4 * 4
    assert measured.sent_twice > 0
    assert measured.is_same
    said = bench.as_text(measured, 1000.0)
    assert f"16 votes, {measured.sent_twice} of them sent twice, each stored once" in said


def test_what_does_not_hold_is_said():
    late = bench.Measured(round_trips_ms=[1.0] * 98 + [200.0] * 2, lags_ms=[0.0], is_same=True)
    late.requests, late.seconds, late.grades = 100, 1.0, {"a1": []}
    assert late.p99_ms == 200.0
    assert not late.holds
    assert "NOT MET" in bench.as_text(late, 1.0)
    lost = bench.Measured(round_trips_ms=[1.0], is_same=False)
    assert not lost.holds


@pytest.mark.parametrize("after", ["", "\n## More\n\nword\n"])
def test_a_page_has_one_section_of_it_wherever_it_stands(after):
    section = f"{bench.SECTION}\n\nnew\n"
    page = f"# Page\n\n{bench.SECTION}\n\nold\n{after}"
    assert bench.renewed(page, section) == f"# Page\n\n{section}{after}"
    assert bench.renewed(bench.renewed("# Page\n", section), section) == f"# Page\n\n{section}"
