"""Raw scores that others published, and the numbers they must give."""

from __future__ import annotations

import csv
import json
import math

import numpy as np
import pytest

from dscqs.statistics.analysis import analyse
from dscqs.statistics.matrix import make_matrix
from dscqs.statistics.screening import Variant, kurtosis
from dscqs.votes import Vote, make_table

SETS = (
    "nflx_public_raw",
    "nflx_public_raw_testorder",
    "nflx_public_raw_last4outliers",
    "nflx_public_raw_partial",
    "vqeghd3_raw",
)
VARIANTS = {
    Variant.SAMPLE: "S_sample_N-1 (BT.500 text)",
    Variant.POPULATION: "S_population_N (what sureal 0.9.0 computes)",
}


def load(folder, name):
    with (folder / f"{name}.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    return make_table(
        Vote(
            assessor=assessor,
            content=row["content_id"],
            condition=row["asset_id"],
            score=float(cell) if cell else None,
        )
        for row in rows
        for assessor, cell in row.items()
        if assessor not in ("asset_id", "content_id", "label", "is_ref")
    )


@pytest.fixture(scope="session")
def expected(subjective_dir):
    return json.loads((subjective_dir / "expected.json").read_text())["datasets"]


@pytest.mark.parametrize("name", SETS)
def test_means_deviations_and_intervals(subjective_dir, expected, name):
    wanted = expected[name]
    (analysis,) = analyse(load(subjective_dir, name))
    found = [cell.primary.before for cell in analysis.stimuli]
    assert len(found) == wanted["presentations"]
    assert sum(cell.n for cell in found) == wanted["votes"]
    assert [cell.n for cell in found] == wanted["n"]
    # The figures by presentation are given to eight decimals, the others to ten.
    np.testing.assert_allclose([cell.mean for cell in found], wanted["mos"], atol=6e-9, rtol=0)
    np.testing.assert_allclose([cell.sd for cell in found], wanted["sd"], atol=6e-9, rtol=0)
    for figure, key in (
        ("mean", "mos_mean"),
        ("sd", "sd_mean"),
        ("se", "sem_mean"),
        ("ci95_normal", "ci95_z_mean"),
        ("ci95_t", "ci95_t_mean"),
    ):
        mean = np.mean([getattr(cell, figure) for cell in found])
        assert mean == pytest.approx(wanted[key], abs=1e-9)
    assert np.var([cell.mean for cell in found]) == pytest.approx(wanted["mos_var"], abs=1e-9)


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("variant", Variant)
def test_screening_and_what_it_leaves(subjective_dir, expected, name, variant):
    wanted = expected[name]["bt500_screening"][VARIANTS[variant]]
    (analysis,) = analyse(load(subjective_dir, name), variant)
    (display,) = analysis.displays
    screening = display.screenings[variant]
    assert [found.high for found in screening.assessors.values()] == wanted["P"]
    assert [found.low for found in screening.assessors.values()] == wanted["Q"]
    assert list(screening.rejected) == wanted["rejected"]
    after = [cell.primary.after.mean for cell in analysis.stimuli]
    assert np.mean(after) == pytest.approx(wanted["mos_mean_after"], abs=1e-9)
    assert np.var(after) == pytest.approx(wanted["mos_var_after"], abs=1e-9)
    assert after[0] == pytest.approx(wanted["mos_first_after"], abs=1e-9)


@pytest.mark.parametrize("name", SETS)
def test_kurtosis(subjective_dir, expected, name):
    values = make_matrix(load(subjective_dir, name).votes).values
    found = [kurtosis(row[~np.isnan(row)]) for row in values]
    np.testing.assert_allclose(found[:5], expected[name]["beta2_first5"], atol=6e-9, rtol=0)
    inside = [value for value in found if not math.isnan(value) and 2 <= value <= 4]
    assert len(inside) == expected[name]["beta2_in_2_4"]
