from __future__ import annotations

import json
import math
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1]))  # the benchmarks are not installed

from benchmarks import changes, floors, quality, soak
from benchmarks.__main__ import main
from benchmarks.floors import SpeedFigures
from benchmarks.memory import load_frame, save_frame
from benchmarks.unit import Measured, Timed, share_of_others
from pipeline.config import Settings
from pipeline.evaluation import beyond, rendered
from pipeline.evaluation import cells as set1
from pipeline.evaluation import floors as quality_floors
from pipeline.evaluation.floors import PsfEstimate, RenderedCase, Set1Cell
from pipeline.evaluation.methods import middle_views
from pipeline.evaluation.tables import Table, signed
from pipeline.report import to_plain
from pipeline.synthetic import SampleScene

GOOD = SpeedFigures(
    cold_frame=1500, solver_ratio=9, psnr_default=36, psnr_pocs=35, exponent_views=1.0,
    exponent_pixels=1.05, memory_mib=(800, 2500),
)  # fmt: skip


def _words(verdicts):
    return [verdict.word for verdict in verdicts]


def test_the_quick_benchmark_prints_one_table_and_the_floors(tmp_path, capsys):
    table, page = tmp_path / "bench.json", tmp_path / "docs" / "bench.md"
    assert main(["--quick", "--json", str(table), "--write", str(page)]) == 0
    printed = capsys.readouterr().out
    content = json.loads(table.read_text())
    sections = [row["section"] for row in content["rows"] if row["section"]]
    assert sections == [
        "unit", "cold frame", "reconstruction", "growth with pixels", "growth with views",
        "growth with K", "peak memory", "stream latency",
    ]  # fmt: skip
    for section in sections:
        assert f"\n{section}" in printed
        assert f"\n| {section} |" in page.read_text()
    timed = [row for row in content["rows"] if row["seconds"] is not None]
    assert len(timed) >= 20
    assert all(row["seconds"] > 0 and row["multiple"] > 0 and row["runs"] > 0 for row in timed)
    assert max(row["memory_mib"] or 0 for row in content["rows"]) > 50
    assert {floor["verdict"] for floor in content["floors"]} == {"not judged"}
    assert printed.count("not judged") == len(content["floors"]) == 6


def test_floors_of_speed():
    assert _words(floors.speed_floors(GOOD)) == ["met"] * 6
    for number, change in enumerate(
        (
            {"cold_frame": 2001}, {"solver_ratio": 7.9}, {"exponent_views": 1.11},
            {"exponent_pixels": 1.11}, {"memory_mib": (901, 1)}, {"memory_mib": (1, 2561)},
        )
    ):  # fmt: skip
        expected = ["met"] * 6
        expected[number] = "not met"
        assert _words(floors.speed_floors(replace(GOOD, **change))) == expected
    assert floors.speed_floors(replace(GOOD, psnr_pocs=36.1))[1].met is False
    assert _words(floors.speed_floors(SpeedFigures())) == ["not judged"] * 6


def test_exponents():
    assert floors.fitted_exponent([1, 2, 4, 8], [5, 10, 20, 40]) == pytest.approx(1)
    assert floors.fitted_exponent([10, 20], [3, 12]) == pytest.approx(2)
    assert math.isnan(floors.fitted_exponent([2], [3]))
    assert math.isnan(floors.fitted_exponent([2, 2], [3, 4]))


def _cell(scene="flower", sigma=1.0, noise=2.0, **psnr):
    values = {
        "bicubic": 30.0, "lanczos": 30.1, "single-view": 31.0, "pocs": 32.0,
        "pocs-simplified": 32.0, "default": 34.0,
    }  # fmt: skip
    values |= {name.replace("_", "-"): value for name, value in psnr.items()}
    return Set1Cell(scene=scene, psf_sigma=sigma, noise=noise, psnr=values, ssim=values)


def test_floors_of_set1():
    cells = [
        _cell(scene, sigma, noise) for scene in set1.SCENES for sigma, noise in set1.conditions()
    ]
    assert _words(quality_floors.set1_floors(cells)) == ["met"] * 10
    assert _words(quality_floors.set1_floors([])) == ["not judged"] * 10

    def missed(*changed):
        verdicts = quality_floors.set1_floors([*cells, *changed])
        return [number for number, verdict in enumerate(verdicts) if verdict.met is False]

    assert missed(_cell("x", bicubic=33.21)) == [0]
    assert missed(_cell("x", single_view=34.03)) == [1]
    assert missed(_cell("x", noise=0.0, bicubic=33.0, default=-90.0)) == [0, 1, 2, 7, 8]
    assert missed(_cell(single_view=33.3)) == [5, 9]
    assert missed(_cell("lytro_2067", 1.7, single_view=32.9)) == [4]
    assert missed(_cell("x", pocs=34.21)) == [7]
    assert missed(_cell("x", pocs_simplified=34.21)) == [8]
    worst = quality_floors.set1_floors([*cells, _cell("x", bicubic=33.5)])[0].measured
    assert worst == "worst +0.50 dB (x σ 1 noise 2); 1 of 21 cells miss it"


def _gains(eye, single_view):
    condition = beyond.Condition(scene="x", magnification=3, psf_sigma=1.8, eye=eye)
    return beyond.Gains(
        condition=condition, bicubic=(30.0,) * 5, single_view=single_view, default=(33.0,) * 5
    )


def test_another_view_that_does_harm_anywhere_is_named():
    fine, harmed = _gains("left", (32.0,) * 5), _gains("right", (32.0, 32.0, 32.0, 33.021, 32.0))
    assert _words(beyond.verdicts([fine])) == ["met"]
    (verdict,) = beyond.verdicts([fine, harmed])
    assert verdict.word == "not met"
    assert verdict.floor == "each of 10 cells: default ≥ single-view -0.02 dB"
    assert verdict.measured == "worst -0.021 dB (x K 3 σ 1.8 right noise 5); 1 of 10 cells miss it"
    assert beyond.table([harmed]).rows == (
        ("x", "3", "1.8", "right", "+1.00", "+1.00", "+1.00", "-0.02", "+1.00", "+3.00"),
    )
    assert beyond.from_json(json.loads(json.dumps(to_plain(harmed)))) == harmed


def test_both_eyes_are_measured_at_every_noise():
    frame = SampleScene(width=160, height=144, num_views=2).frame(0, depth="stereo")
    found = {
        condition.eye: beyond.measure(frame, condition, Settings())
        for condition in beyond.conditions("sample")
        if condition.magnification == 2 and condition.psf_sigma == 1
    }
    assert set(found) == {"left", "right"}
    for gains in found.values():
        assert len(gains.over_single) == len(beyond.NOISES)
        assert min(gains.over_single) > -0.02
        assert list(gains.bicubic) == sorted(gains.bicubic, reverse=True)  # noise only costs
    assert found["left"].bicubic != found["right"].bicubic


def test_floors_of_the_estimated_psf():
    near = PsfEstimate(
        scene="flower", true_sigma=1.0, noise=2.0, sigma=1.1, true_psnr=35.0, psnr=34.8, remark=""
    )
    far, dear = replace(near, scene="x", sigma=0.8), replace(near, scene="y", psnr=34.5)
    says = "PSF: one view alone cannot tell its PSF; σ 1 is assumed"
    assert _words(quality_floors.psf_floors([near], says)) == ["met"] * 3
    verdicts = quality_floors.psf_floors([near, far, dear], "")
    assert _words(verdicts) == ["not met"] * 3
    assert verdicts[0].measured == "worst -0.20 px (x σ 1 noise 2)"
    assert verdicts[1].measured == "worst 0.50 dB (y σ 1 noise 2)"


def test_floors_of_the_rendered_scene():
    both = {"left": 0.0, "right": 0.5}
    psnr = {
        name: {eye: base + more for eye, more in both.items()}
        for name, base in {"1 view": 30, "2 views": 31, "4 views": 33, "true motion": 34.0}.items()
    }
    case = RenderedCase(
        name="made up", psnr=psnr, median_error=0.02, error_95=0.2, wrong_share=0.009
    )
    words = _words(quality_floors.rendered_floors(case, (1, 2, 4)))
    assert words == ["not met", "met", "met", "met", "met", "met"]
    psnr["true motion"] = psnr["4 views"]
    psnr["4 views"] = {"left": 33.0, "right": 31.4}  # the worse eye decides
    case = replace(case, median_error=0.021, error_95=0.26, wrong_share=0.011)
    assert _words(quality_floors.rendered_floors(case, (1, 2, 4))) == ["not met"] * 6


def test_end_point_errors_are_of_the_right_pixels():
    error = np.array([0.01, 0.02, 0.03, 0.6, np.nan, 5.0])
    visible = np.array([True, True, True, True, True, False])
    verified = np.array([True, True, False, True, False, True])
    errors = rendered.pooled_errors(error, visible, verified)
    assert (errors.registered, errors.verified) == (0.8, 0.6)
    assert errors.median_visible == pytest.approx(0.025)
    assert errors.median_verified == pytest.approx(0.31)
    assert (errors.wrong, errors.hidden) == (0.5, 0.25)
    nothing = rendered.pooled_errors(error, visible, np.zeros(6, bool))
    assert math.isnan(nothing.error_95)
    assert math.isnan(nothing.wrong)


def test_a_small_rendered_case_is_measured_kept_and_resumed(tmp_path):
    case = rendered.Case(width=96, height=72, num_views=3)
    path = tmp_path / "cells.json"
    cells = quality.kept_cells(path, "code", resume=True)
    part = quality.rendered_part(cells, Settings(), lambda _: None, [case])
    text = part.as_text()
    assert "3 views" in text
    assert "loss to true motion" in text
    values = rendered.case_from_json(json.loads(path.read_text())["cells"][f"rendered {case.name}"])
    assert set(values.psnr) == {"bicubic", "1 view", "2 views", "3 views", "true motion"}
    assert values.psnr["true motion"]["left"] > values.psnr["1 view"]["left"]
    assert values.errors.median_verified < 0.3

    def fail(*_):
        raise AssertionError("measured again")

    again = quality.kept_cells(path, "code", resume=True)
    assert quality.rendered_part(again, Settings(), fail, [case]).as_text() == text
    assert quality.kept_cells(path, "other code", resume=True).found == {}
    assert "| rotation 1.5°, no calibration |" in part.as_markdown()


def test_frames_survive_their_file(tmp_path):
    frame = SampleScene(width=64, height=48, num_views=5).frame(0, depth="stereo")
    save_frame(tmp_path / "frame.npz", frame)
    read = load_frame(tmp_path / "frame.npz")
    assert (read.left, read.right) == (frame.left, frame.right) == ("cam2", "cam3")
    for ours, theirs in zip(read.views, frame.views, strict=True):
        np.testing.assert_array_equal(ours.luma, theirs.luma)
        np.testing.assert_array_equal(ours.depth_map, theirs.depth_map)
    names = [view.view_id for view in middle_views(frame, 2).views]
    assert names == ["cam2", "cam3"]
    assert [view.view_id for view in middle_views(frame, 4).views] == [
        "cam1", "cam2", "cam3", "cam4",
    ]  # fmt: skip


def test_figures_are_medians_and_follow_the_unit():
    runs = tuple(
        Timed(seconds=seconds, cpu_seconds=1, unit=unit, stages={"a": seconds / 2})
        for seconds, unit in ((1.0, 0.1), (3.0, 0.3), (2.0, 0.1))
    )
    measured = Measured(all_runs=runs)
    assert measured.seconds() == 2
    assert measured.multiple() == pytest.approx(10)
    assert measured.multiple("a") == pytest.approx(5)


def test_runs_beside_other_programs_do_not_count():
    runs = tuple(
        Timed(seconds=seconds, cpu_seconds=1, unit=1, others=others)
        for seconds, others in ((5.0, 0.5), (2.0, 0.02), (9.0, 0.3))
    )
    measured = Measured(all_runs=runs)
    assert (measured.seconds(), measured.others, measured.crowded) == (2.0, 0.02, False)
    busy = Measured(all_runs=runs[::2])
    assert (busy.seconds(), busy.crowded) == (7.0, True)
    share = partial(share_of_others, own=2.0, seconds=1.0, threads=2)
    assert share(busy=2.0, cores=2) == 0
    assert share(busy=3.0, cores=2) == 0.5
    assert share(busy=3.0, cores=4) == 0  # there is room for all
    assert share(busy=4.5, cores=4) == 0.25
    assert share(busy=float("nan"), cores=2) == 0


def test_figures_of_a_busy_machine_are_not_judged():
    names = frozenset({"cold frame", "solver ratio", "growth with pixels", "growth with views"})
    words = _words(floors.speed_floors(replace(GOOD, crowded=names)))
    assert words == ["met", "not judged", "not judged", "not judged", "met", "met"]
    slow = floors.speed_floors(replace(GOOD, cold_frame=3000, crowded=names))[0]
    assert (slow.met, slow.measured) == (None, "3000 ×; the machine was busy")


def test_tables():
    table = Table(head=("a", "b", "say"), rows=(("x", "1.5", "σ"), ("yy", "10", "")), left=("say",))
    assert table.as_text().splitlines() == ["a     b  say", "x   1.5  σ", "yy   10"]
    assert table.as_markdown().splitlines()[1] == "| --- | --: | --- |"
    assert (signed(-0.001), signed(float("nan"))) == ("+0.00", "–")


def _soaked(memory, quality, frames=1000):
    return soak.Soak(
        frames=frames, size=(96, 72), num_views=3, seconds=1.0, memory=memory, quality=quality
    )


def test_a_long_run_is_judged_by_memory_after_it_has_settled_and_by_its_ends():
    steady = [30.0] * 1000
    grows_at_first = ((50, 100.0), (200, 200.0), (600, 205.0), (1000, 199.0))
    assert _soaked(grows_at_first, steady).holds
    assert not _soaked(((200, 200.0), (1000, 211.0)), steady).holds
    worse = _soaked(grows_at_first, [30.0] * 900 + [29.9] * 100)
    assert worse.drift == pytest.approx(0.1)
    assert not worse.holds
    assert "**It does not hold**" in soak.page(worse, "the command")


def test_a_short_soak_runs_the_whole_way(tmp_path):
    result = soak.soak(12, (64, 48), 2)
    assert len(result.quality) == 12
    assert result.memory[-1][0] == 12
    first, last = result.quality[1:5], result.quality[-5:-1]
    assert np.mean(first) == pytest.approx(np.mean(last), abs=1.0)


def test_a_change_is_measured_against_cold_frames(monkeypatch):
    still = replace(changes.CHANGES[0], frames=3)
    monkeypatch.setattr(changes, "CHANGES", (still,))
    chosen = changes.cases(seed=0, only="nothing")
    assert {(case.width, case.crf) for case in chosen} >= {(256, None), (256, 23), (128, 23)}
    small = [replace(case, width=64) for case in chosen if case.width == 128]
    found = [changes.measured(case) for case in small]
    for one in found:
        for chain in one.chains.values():
            assert len(chain.gains) == 2
            assert chain.worst <= chain.mean
            assert chain.below == sum(min(frame) < -changes.BELOW for frame in chain.gains)
            assert chain.share > 0
    text = changes.page(found, "python -m benchmarks.changes")
    assert "## 64×48" in text
    assert "| nothing | 23 | estimated |" in text
    assert "none is more than 0.05 dB below" in text
    lost = replace(found[0].chains["warm"], gains=((0.1, -0.06), (-0.2, 0.3)))
    worse = replace(found[0], chains={**found[0].chains, "warm": lost})
    assert lost.below == 2
    assert lost.worst == -0.2
    assert "| −0.20 | 2 of 2 |" in changes.table([worse]).as_markdown()
    assert "2 are more than" in changes.page([worse], "x")


def test_changes_of_a_name_that_is_not_there(capsys):
    with pytest.raises(SystemExit):
        changes.main(["--only", "earthquake"])
    assert "none of nothing, " in capsys.readouterr().err
