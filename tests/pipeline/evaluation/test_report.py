"""The report stands alone, holds what was measured, and works from disk in a browser."""

from __future__ import annotations

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from pipeline.evaluation.elements import Chapter, Comparison, Figure
from pipeline.evaluation.plan import Plan
from pipeline.evaluation.plots import bars, lines, png
from pipeline.evaluation.report import (
    LONG_TABLE,
    Origin,
    evaluate_all,
    report_page,
    write_page,
    write_report,
)
from pipeline.evaluation.tables import Table

ORIGIN = Origin(
    command="depthsr evaluate all sample", scenes=("sample",), machine="a", cpu_seconds=90
)


def _chapter() -> Chapter:
    grey = {
        name: np.full((40, 56), level, np.uint8)
        for name, level in (("bicubic", 60), ("default", 120), ("original", 200))
    }
    return Chapter(
        key="made", title="A <title>", question="Is it so?", answer=["It is & stays so."],
        tables=[("Numbers, a table", Table(head=("a", "b"), rows=(("x, y", "1.5"),)))],
        figures=[
            Figure(caption="One", content=lines({"c": ([0, 1], [2, 3])}, x_label="x", y_label="y")),
            Figure(caption="Two", content=bars(["g"], {"c": [1.0]}, y_label="y")),
            Figure(caption="Three", content=png(grey["default"]), kind="png"),
        ],
        comparisons=[
            Comparison(
                title="scene </script>",
                left={name: png(picture) for name, picture in grey.items()},
                right={name: png(picture) for name, picture in grey.items()},
            )
        ],
        data={"value": float("nan")},
    )  # fmt: skip


def test_the_page_needs_nothing_else():
    page = report_page([_chapter()], ORIGIN)
    assert "A &lt;title&gt;" in page
    assert "It is &amp; stays so." in page
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert page.count("</script>") == 2  # a title cannot end the script that holds it
    names = re.findall(r'\bid="([^"]+)"', page)
    assert len(names) == len(set(names))


def test_numbers_are_kept_as_json_and_csv(tmp_path):
    written = write_report(tmp_path / "report", [_chapter()], ORIGIN)
    names = [path.name for path in written]
    assert names == ["index.html", "report.md", "report.json", "made-1.csv"]
    text = written[1].read_text(encoding="utf-8")
    assert "- It is & stays so.\n" in text
    assert "## In short\n\n- [Is it so?](#a-title) It is & stays so.\n\n## A <title>\n" in text
    assert "\n| a | b |\n| --- | --: |\n| x, y | 1.5 |\n" in text
    record = json.loads(written[2].read_text(encoding="utf-8"))
    assert record["format"] == "depthsr-evaluation/1"
    assert record["chapters"]["made"] == {"answer": ["It is & stays so."], "value": None}
    with written[3].open(encoding="utf-8", newline="") as stream:
        assert list(csv.reader(stream)) == [["a", "b"], ["x, y", "1.5"]]


def test_a_page_shows_no_photograph(tmp_path):
    chapter = _chapter()
    shown = [
        replace(figure, scene=scene)
        for figure, scene in zip(chapter.figures, ("", "flower", "sample"), strict=True)
    ]
    long = Table(head=("a",), rows=(("x",),) * (LONG_TABLE + 1))
    chapter = replace(chapter, figures=shown, tables=[*chapter.tables, ("Long", long)])
    page, *pictures = write_page(tmp_path / "docs" / "measured.md", [chapter], ORIGIN)
    assert [path.name for path in pictures] == ["measured-made-1.svg", "measured-made-2.png"]
    assert pictures[1].read_bytes() == shown[2].content
    text = page.read_text(encoding="utf-8")
    assert re.findall(r"!\[(.*?)\]\((.*?)\)", text) == [
        ("One", "images/measured-made-1.svg"), ("Three", "images/measured-made-2.png")
    ]  # fmt: skip
    assert ORIGIN.command in text
    folded = text[text.index("<details>") : text.index("</details>")]
    assert folded.count("| x |") == LONG_TABLE + 1
    assert "Numbers, a table" not in folded


def test_plots_are_the_same_bytes_for_the_same_numbers():
    first, second = (
        lines({"c": ([0, 1], [2, 3])}, x_label="x", y_label="y", marks={"here": 0.5})
        for _ in range(2)
    )
    assert first == second
    assert b"here" in first


@pytest.fixture(scope="module")
def report(tmp_path_factory, subject):
    plan = Plan(
        psf_sigmas=(1.0,), noises=(2.0,), num_seeds=2, chapters=("fidelity", "spectra", "left-out")
    )
    folder = tmp_path_factory.mktemp("report")
    chapters = evaluate_all([("sample", subject)], plan)
    return write_report(folder, chapters, ORIGIN)[0], chapters


def test_chapters_come_in_order_and_each_answers(report):
    _, chapters = report
    assert [chapter.key for chapter in chapters] == ["fidelity", "spectra", "left-out"]
    assert all(chapter.answer and chapter.tables for chapter in chapters)


def test_a_view_between_two_cameras_is_better_of_super_resolved_ones(report):
    (free_view,) = report[1][2].data["free_views"]
    assert free_view.seen > 0.9
    assert free_view.of_default > free_view.of_bicubic


def test_the_gallery_works_from_disk(report, browser_page):
    page, troubles = browser_page
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(report[0].as_uri())
    pixel = "([x, y]) => [...document.getElementById('canvas').getContext('2d')\
        .getImageData(x, y, 1, 1).data]"
    page.wait_for_function(
        "() => document.getElementById('canvas').getContext('2d')"
        ".getImageData(640, 400, 1, 1).data[0] !== 48"
    )
    before = page.evaluate(pixel, [300, 400])
    page.locator("#first").select_option("original")
    assert page.evaluate(pixel, [300, 400]) != before
    value = "(name) => Number(document.getElementById(name).value)"
    page.locator("#canvas").focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate(value, "divider") == pytest.approx(0.52, abs=0.003)
    page.keyboard.press("+")
    assert page.evaluate(value, "zoom") == 1.5
    page.keyboard.press("ArrowLeft")  # moves the picture
    assert page.evaluate(value, "divider") == pytest.approx(0.52, abs=0.003)
    page.locator("#mode").select_option("anaglyph")
    page.wait_for_function(
        "() => { const c = document.getElementById('canvas').getContext('2d');"
        " const d = c.getImageData(0, 0, 1280, 800).data;"
        " for (let i = 0; i < d.length; i += 4) if (d[i] !== d[i + 1]) return true;"
        " return false; }"
    )
    rows = "(left) => [...document.getElementById('canvas').getContext('2d')\
        .getImageData(left, 400, 638, 1).data]"
    halves = {}
    for mode in ("side", "cross"):
        page.locator("#mode").select_option(mode)
        halves[mode] = [page.evaluate(rows, left) for left in (0, 642)]
    assert halves["side"][0] != halves["side"][1]
    assert halves["cross"] == halves["side"][::-1]  # each eye's picture before the other eye
    page.locator("#canvas").focus()
    page.keyboard.press("ArrowRight")
    assert troubles == []
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
