"""``depthsr dscqs analyse`` and ``export``, as one calls them."""

from __future__ import annotations

import json

import pytest

from service.cli import main

ROWS = [
    (assessor, content, condition, 80 + 2 * a, 80 + 2 * a - lower - (a * 7 + k * 3) % 5)
    for a, assessor in enumerate(("ann", "bob", "cem", "dai"))
    for k, content in enumerate(("k1", "k2"))
    for condition, lower in (("bicubic", 40), ("sharp", 5))
]


@pytest.fixture
def votes(tmp_path):
    path = tmp_path / "votes.csv"
    lines = ["assessor,display,content,condition,repetition,grade_reference,grade_test"]
    lines += [f"{a},polarised,{k},{c},1,{one},{two}" for a, k, c, one, two in ROWS]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_the_contract_the_reports_and_what_is_printed(votes, tmp_path, capsys):
    made = [tmp_path / name for name in ("out.json", "out.html", "out.pdf")]
    options = [
        word for path in made for word in (f"--{path.suffix[1:]}", str(path))
    ]  # fmt: skip
    assert main(["dscqs", "analyse", str(votes), *options, "--title", "Set 1"]) == 0
    said = capsys.readouterr().out
    assert "informal: 4 assessors on 'polarised'" in said
    assert "bicubic − sharp" in said
    found = json.loads(made[0].read_text())
    first = found["stimuli"][0]
    differences = [one - two for _, k, c, one, two in ROWS if (k, c) == ("k1", "bicubic")]
    assert (first["content"], first["condition"]) == ("k1", "bicubic")
    assert first["before"]["mean"] == pytest.approx(sum(differences) / 4)
    assert set(found["screening"]["sample"]["polarised"]["assessors"]) == {
        "ann", "bob", "cem", "dai",
    }  # fmt: skip
    assert "<h1>Set 1</h1>" in made[1].read_text()
    assert made[2].read_bytes().startswith(b"%PDF-")


def test_export_and_analysis_of_what_was_exported_agree(votes, tmp_path):
    exported = tmp_path / "votes.json"
    assert main(["dscqs", "export", str(votes), "--to", "sujson", "-o", str(exported)]) == 0
    results = []
    for path in (votes, exported):
        out = tmp_path / "out.json"
        assert main(["dscqs", "analyse", str(path), "--json", str(out), "--quiet"]) == 0
        results.append({**json.loads(out.read_text()), "votes": ""})
    assert results[0] == results[1]


def test_the_log_of_the_sessions_goes_into_the_report(votes, tmp_path, capsys):
    export, page = tmp_path / "everything.json", tmp_path / "report.html"
    faults = [{"kind": "focus", "detail": "the window lost the focus"}]
    events = [
        {"sequence": 1, "at": "2026-01-31T10:00:00.000+00:00", "name": "joined"},
        {"sequence": 2, "at": "2026-01-31T10:01:00.000+00:00", "name": "shown", "ticket": "t",
         "outcome": "failed", "log": {"faults": faults}},
        {"sequence": 3, "at": "2026-01-31T10:02:00.000+00:00", "name": "shown", "ticket": "u",
         "outcome": "ok", "log": {"faults": []}},
        {"sequence": 4, "at": "2026-01-31T10:03:00.000+00:00", "name": "continued",
         "stage": "break"},
    ]  # fmt: skip
    session = {"assessor": "ann", "display": "polarised", "events": events}
    export.write_text(json.dumps({"sessions": [session]}))
    words = ["dscqs", "analyse", str(votes), "--html", str(page), "--log", str(export), "--quiet"]
    assert main(words) == 0
    said = page.read_text()
    assert "3 events" in said
    assert "failed (focus: the window lost the focus)" in said
    assert said.index("10:01:00") < said.index("10:03:00")
    for wrong in ("{", "{}", '{"sessions": [{"events": [{}]}]}', '{"sessions": 3}'):
        export.write_text(wrong)
        capsys.readouterr()
        assert main(words) == 2
        assert capsys.readouterr().err != ""


def test_export_is_printed_without_a_file(votes, capsys):
    assert main(["dscqs", "export", str(votes), "--to", "csv"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("# grade_reference: grade of the reference; 0 = bad")
    assert len([line for line in lines if not line.startswith("#")]) == 1 + len(ROWS)


def test_a_bad_cell_is_said_with_file_line_and_column_and_nothing_is_written(
    votes, tmp_path, capsys
):
    votes.write_text(votes.read_text().replace("80,36", "80,136", 1).replace("80,40", "80,140", 1))
    out = tmp_path / "out.json"
    assert main(["dscqs", "analyse", str(votes), "--json", str(out)]) == 2
    said = capsys.readouterr().err
    assert "votes.csv, line 2, column 'grade_test'" in said
    assert "outside 0 … 100" in said
    assert not out.exists()
