"""Z-scores, bias removal and maximum likelihood against the numbers that others published."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from dscqs.statistics.likelihood import recover
from dscqs.statistics.matrix import make_matrix
from dscqs.statistics.normalise import remove_bias, to_percent, z_scores
from dscqs.statistics.screening import Variant, screen
from dscqs.votes import Vote


@pytest.fixture(scope="session")
def wanted(subjective_dir):
    entries = json.loads((subjective_dir / "expected.json").read_text())["unit_expectations"]

    def find(dataset, model):
        (found,) = [
            entry["expect"]
            for entry in entries
            if entry["dataset"].startswith(dataset) and entry["model"].startswith(model)
        ]
        return found

    return find


def load(folder, name):
    """Return the votes of a dataset as a matrix, and the rows of its hidden references."""
    data = json.loads((folder / f"{name}.json").read_text())
    return data, make_matrix(
        [
            Vote(
                assessor=assessor,
                content=str(presentation["content_id"]),
                condition=str(presentation["asset_id"]),
                score=score,
            )
            for presentation, scores in zip(data["presentations"], data["scores"], strict=True)
            for assessor, score in zip(data["observers"], scores, strict=True)
        ]
    )


@pytest.fixture
def folder_rows(subjective_dir):
    path = subjective_dir / "nflx_public_raw_testorder.csv"
    with path.open(encoding="utf-8", newline="") as stream:
        return list(csv.DictReader(stream))


@pytest.fixture
def in_test_order(folder_rows):
    keys = ("asset_id", "content_id", "label", "is_ref")
    matrix = make_matrix(
        [
            Vote(
                assessor=name,
                content=row["content_id"],
                condition=row["asset_id"],
                score=float(cell),
            )
            for row in folder_rows
            for name, cell in row.items()
            if name not in keys
        ]
    )
    references = {
        row["content_id"]: at for at, row in enumerate(folder_rows) if row["is_ref"] == "1"
    }
    return matrix, np.array([references[row["content_id"]] for row in folder_rows])


def test_difference_to_the_hidden_reference(wanted, in_test_order):
    matrix, reference_rows = in_test_order
    means = matrix.values.mean(axis=1)
    scores = means - means[reference_rows] + 5
    expect = wanted("nflx_public_raw_testorder", "DMOS")
    assert scores[[0, 10]] == pytest.approx([expect["score0"], expect["score10"]], abs=1e-9)
    assert scores.mean() == pytest.approx(expect["mean"], abs=1e-9)


def test_z_scores_on_the_scale_of_live(wanted, in_test_order):
    matrix, reference_rows = in_test_order
    means = matrix.values.mean(axis=1)
    differences = type(matrix)(
        presentations=matrix.presentations,
        assessors=matrix.assessors,
        values=matrix.values + 5 - means[reference_rows][:, None],
    )
    scores = to_percent(z_scores(differences).values.mean(axis=1))
    expect = wanted("nflx_public_raw_testorder", "LIVE")
    assert scores[[0, 10]] == pytest.approx([expect["score0"], expect["score10"]], abs=1e-9)
    assert scores.mean() == pytest.approx(expect["mean"], abs=1e-9)


def test_bias_removal_then_screening_by_the_population_deviation(wanted, subjective_dir):
    _, matrix = load(subjective_dir, "nflx_public_raw_last4outliers")
    free = remove_bias(matrix).matrix
    rejected = screen(free, Variant.POPULATION).rejected
    left = free.values[:, [name not in rejected for name in free.assessors]].mean(axis=1)
    expect = wanted("nflx_public_raw_last4outliers", "[0] BT500")
    # sureal lists the references first, so that its order of the others is that of the file.
    assert expect["p913_score0"] in [pytest.approx(value, abs=1e-9) for value in left]
    assert expect["p913_score_second_last"] in [pytest.approx(value, abs=1e-9) for value in left]


def demo(folder, name):
    """Return the votes of a file of the reference code: lone ',' separates repetitions."""
    blocks = [[]]
    with (folder / name).open(encoding="utf-8", newline="") as stream:
        for cells in csv.reader(stream):
            if cells == ["", ""]:
                blocks.append([])
            elif cells:
                blocks[-1].append([float(cell) for cell in cells])
    return make_matrix(
        [
            Vote(
                assessor=f"a{column}", content=f"c{row}", condition="x", repetition=repetition,
                score=None if np.isnan(vote) else vote,
            )
            for repetition, block in enumerate(blocks, start=1)
            for row, votes in enumerate(block)
            for column, vote in enumerate(votes)
        ]
    )  # fmt: skip


def test_alternating_projection_of_the_reference_code(wanted, subjective_dir):
    found = recover(demo(subjective_dir, "bt500_demo_sample_data.csv"))
    expect = wanted("bt500_demo_sample_data", "BT.500 alternating")
    assert found.converged
    assert found.dominated is None
    for value, key in (
        (found.quality[0], "mos_0"),
        (found.quality[9], "mos_9"),
        (found.bias[0], "bias_0"),
        (found.bias[9], "bias_9"),
        (found.inconsistency[0], "inconsistency_0"),
        (found.inconsistency[25], "inconsistency_25"),
        (found.se_residual[0], "sos_0"),
    ):
        assert value == pytest.approx(expect[key], abs=1e-9), key


def test_repeated_votes_share_the_quality_of_their_stimulus(subjective_dir):
    """The small sample repeats every vote once: same scores, intervals smaller by √2."""
    matrix = demo(subjective_dir, "bt500_demo_small_sample_data.csv")
    assert {repetition for _, _, repetition in matrix.presentations} == {1, 2}
    once = make_matrix(
        [
            Vote(assessor=name, content=content, condition=condition, score=None
                 if np.isnan(vote) else vote)
            for (content, condition, repetition), votes in zip(
                matrix.presentations, matrix.values, strict=True
            )
            for name, vote in zip(matrix.assessors, votes, strict=True)
            if repetition == 1
        ]
    )  # fmt: skip
    twice = make_matrix(
        [
            Vote(assessor=name, content=content, condition=condition, repetition=repetition,
                 score=None if np.isnan(vote) else vote)
            for repetition in (1, 2)
            for (content, condition, _), votes in zip(
                once.presentations, once.values, strict=True
            )
            for name, vote in zip(once.assessors, votes, strict=True)
        ]
    )  # fmt: skip
    one, two = recover(once), recover(twice)
    np.testing.assert_allclose(two.quality, one.quality, atol=1e-7)
    np.testing.assert_allclose(two.se_model * 2**0.5, one.se_model, atol=1e-7)
    np.testing.assert_allclose(two.inconsistency, one.inconsistency, atol=1e-7)
