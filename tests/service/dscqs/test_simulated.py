"""The whole chain: results, stimuli, plan, 16 simulated assessors on two displays, scores."""

from __future__ import annotations

import json
import statistics

import numpy as np
import pytest

from dscqs.errors import PlanError
from dscqs.simulated import AssessorModel, SimulatedAssessor, spread_quality
from dscqs.votes import parse_csv, read_text
from pipeline.media.png import write_png
from service.cli import main

QUALITY = {"original": 78.0, "bicubic": 45.0, "sr": 70.0}


def _results(folder):
    """Pictures as ``run --frames-dir`` leaves them."""
    chance = np.random.default_rng(5)
    pairs = []
    for content in ("ballet", "street"):
        for condition in QUALITY:
            out = folder / content / condition
            out.mkdir(parents=True)
            for eye in ("left", "right"):
                picture = chance.integers(0, 256, (24, 32, 3)).astype(np.uint8)
                write_png(out / f"{eye}-000000.png", picture)
            pairs.append(f"{content}/{condition}={out}")
    return pairs


def test_from_results_to_scores(served, tmp_path, capsys):
    stimuli, plan = served.root / "chain", tmp_path / "plan.yaml"
    words = ["dscqs", "plan", str(stimuli), *_results(tmp_path / "out"), "-o", str(plan)]
    words += ["--displays", "polarised,autostereoscopic", "--dummies", "1", "--repetitions", "2"]
    assert main(words) == 0
    votes, scores = tmp_path / "votes.csv", tmp_path / "scores.json"
    words = ["dscqs", "simulate", str(plan), "--server", served.url, "--token", served.token]
    words += ["--quality", ",".join(f"{name}={value}" for name, value in QUALITY.items())]
    words += ["--speed", "60", "--lapse", "0", "--noise-sd", "5", "-o", str(votes)]
    assert main(words) == 0
    assert "32 sessions, 288 votes" in capsys.readouterr().out
    table = parse_csv(read_text(votes))
    assert sum(vote.kind == "test" for vote in table.votes) == 2 * 16 * 8
    assert main(["dscqs", "analyse", str(votes), "--json", str(scores)]) == 0
    found = json.loads(scores.read_text())["stimuli"]
    assert len(found) == 2 * 2 * 2
    for stimulus in found:
        expected = QUALITY["original"] - QUALITY[stimulus["condition"]]
        said = stimulus["before"]
        assert said["n"] == 32
        # Grades have a deviation of 5, differences of 5√2; clipping at 100 takes a little.
        assert abs(said["mean"] - expected) < 5 * 5 * 2**0.5 / 32**0.5
        assert 4 < said["sd"] < 10


def test_a_token_is_a_word_that_no_command_takes_for_an_option(served):
    assert len(served.token) == 64
    assert served.token.isalnum()


def test_a_simulated_assessor_grades_as_the_model_says():
    model = AssessorModel(
        quality={"sr": 60.0}, content_sd=0, bias_sd=10, noise_sd=4, lapse=0, seed=3
    )
    means, spreads = [], []
    for number in range(200):
        assessor = SimulatedAssessor(model, f"a{number}")
        grades = [assessor.grade("ballet", "sr") for _ in range(50)]
        means.append(statistics.fmean(grades))
        spreads.append(statistics.stdev(grades))
    assert statistics.fmean(means) == pytest.approx(60, abs=2.5)
    assert statistics.stdev(means) == pytest.approx(10, abs=1.5)
    assert statistics.fmean(spreads) == pytest.approx(4, abs=0.3)


def test_lapses_are_any_number():
    model = AssessorModel(quality={"sr": 90.0}, noise_sd=0, bias_sd=0, content_sd=0, lapse=0.5)
    assessor = SimulatedAssessor(model, "a")
    grades = [assessor.grade("ballet", "sr") for _ in range(2000)]
    lapses = [grade for grade in grades if grade != 90.0]
    assert len(lapses) / 2000 == pytest.approx(0.5, abs=0.05)
    assert statistics.fmean(lapses) == pytest.approx(50, abs=4)


@pytest.mark.parametrize("change", [{"lapse": 1.1}, {"noise_sd": -1}, {"quality": {"sr": 101}}])
def test_a_model_that_is_none_is_refused(change):
    with pytest.raises(PlanError):
        AssessorModel(**{"quality": {"sr": 60.0}, **change})


def test_what_is_not_told_is_spread():
    assert spread_quality("original", ["bicubic", "sr"]) == {
        "original": 80.0, "bicubic": 40.0, "sr": 75.0,
    }  # fmt: skip
