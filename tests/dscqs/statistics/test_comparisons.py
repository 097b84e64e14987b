"""ANOVA, paired tests and power against pingouin, statsmodels and scipy."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # what they warn of on import is not ours
    import pandas as pd
    import pingouin
    from statsmodels.stats.multitest import multipletests
    from statsmodels.stats.power import TTestPower

from dscqs.statistics.anova import repeated_measures
from dscqs.statistics.comparisons import compare, holm
from dscqs.statistics.matrix import make_matrix
from dscqs.statistics.power import assessors_needed, detectable_difference, paired_power
from dscqs.votes import Vote


@pytest.fixture
def values():
    """Differences of 9 assessors × 3 conditions × 4 contents, not spherical."""
    rng = np.random.default_rng(7)
    own = rng.normal(1, 1, size=(9, 1, 1)) * np.array([0, 2, 7])[None, :, None]
    return rng.normal(0, 3, size=(9, 3, 4)) + rng.normal(0, 5, size=(9, 1, 1)) + own


def votes_of(values, skipped=()):
    return [
        Vote(assessor=f"a{a}", content=f"k{k}", condition=f"c{c}", difference=values[a, c, k])
        for a in range(values.shape[0])
        for c in range(values.shape[1])
        for k in range(values.shape[2])
        if (a, c, k) not in skipped
    ]


def frame_of(values):
    rows = [(a, c, k, value) for (a, c, k), value in np.ndenumerate(values)]
    return pd.DataFrame(rows, columns=["assessor", "condition", "content", "value"])


def reference(values, within):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return pingouin.rm_anova(
            frame_of(values), dv="value", within=within, subject="assessor",
            correction=True, effsize="np2", detailed=True,
        )  # fmt: skip


def test_two_factors_as_pingouin(values):
    table = reference(values, ["condition", "content"])
    effects = repeated_measures(values, ("condition", "content"))
    assert [effect.factors for effect in effects] == [
        ("condition",), ("content",), ("condition", "content"),
    ]  # fmt: skip
    for effect, (_, row) in zip(effects, table.iterrows(), strict=True):
        assert (effect.df_effect, effect.df_error) == (row["ddof1"], row["ddof2"])
        assert effect.f == pytest.approx(row["F"], rel=1e-9)
        assert effect.p == pytest.approx(row["p_unc"], rel=1e-9)
        assert effect.epsilon == pytest.approx(row["eps"], rel=1e-9)
        assert effect.p_corrected == pytest.approx(row["p_GG_corr"], rel=1e-9)
        assert effect.partial_eta_squared == pytest.approx(row["np2"], rel=1e-9)


def test_one_factor_as_pingouin(values):
    (effect,) = repeated_measures(values[:, :, :1], ("condition", "content"))
    (row,) = (row for _, row in reference(values[:, :, :1], "condition").iterrows()
              if row["Source"] == "condition")  # fmt: skip
    assert effect.epsilon < 0.99
    assert effect.f == pytest.approx(row["F"], rel=1e-9)
    assert effect.epsilon == pytest.approx(row["eps"], rel=1e-9)
    assert effect.p_corrected == pytest.approx(row["p_GG_corr"], rel=1e-9)


def test_two_levels_are_a_paired_t_test(values):
    found = compare(make_matrix(votes_of(values[:, :2])), differences=True)
    (pair,) = found.pairs
    assert found.anova[0].f == pytest.approx(pair.t**2, rel=1e-9)
    assert found.anova[0].epsilon == pytest.approx(1)
    assert found.friedman is None


def test_every_pair_as_pingouin_with_holm(values):
    found = compare(make_matrix(votes_of(values)), differences=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        table = pingouin.pairwise_tests(
            frame_of(values.mean(axis=2, keepdims=True)), dv="value", within="condition",
            subject="assessor", padjust="holm", effsize="none",
        )  # fmt: skip
    assert len(found.pairs) == len(table) == 3
    for pair, (_, row) in zip(found.pairs, table.iterrows(), strict=True):
        assert (pair.first, pair.second) == (f"c{row['A']}", f"c{row['B']}")
        assert pair.t == pytest.approx(row["T"], rel=1e-9)
        assert pair.p == pytest.approx(row["p_unc"], rel=1e-9)
        assert pair.p_holm == pytest.approx(row["p_corr"], rel=1e-9)


def test_friedman_as_pingouin(values):
    found = compare(make_matrix(votes_of(values)), differences=True).friedman
    means = frame_of(values.mean(axis=2, keepdims=True))
    row = pingouin.friedman(means, dv="value", within="condition", subject="assessor").iloc[0]
    assert found.chi_squared == pytest.approx(row["Q"], rel=1e-9)
    assert found.kendall_w == pytest.approx(row["W"], rel=1e-9)
    assert found.p == pytest.approx(row["p_unc"], rel=1e-9)


def test_whoever_lacks_a_vote_is_left_out_by_name_and_nothing_is_put_in_place(values):
    skipped = {(2, 1, 0)}
    found = compare(make_matrix(votes_of(values, skipped)), differences=True)
    without = compare(make_matrix(votes_of(np.delete(values, 2, axis=0))), differences=True)
    assert found.incomplete == ("a2",)
    assert len(found.complete) == 8
    assert found.anova[2].f == pytest.approx(without.anova[2].f, rel=1e-12)
    by_names = {(pair.first, pair.second): pair for pair in found.pairs}
    assert by_names["c0", "c1"].n == 8
    assert by_names["c0", "c2"].n == 9


def test_without_a_balanced_design_there_is_no_anova(values):
    gone = {(a, 1, 3) for a in range(9)}
    found = compare(make_matrix(votes_of(values, gone)), differences=True)
    assert not found.balanced
    assert found.anova == ()
    assert found.friedman is None
    assert found.incomplete == ()
    by_names = {(pair.first, pair.second): pair for pair in found.pairs}
    shared = (values[:, 0, :3] - values[:, 1, :3]).mean(axis=1)
    assert by_names["c0", "c1"].mean == pytest.approx(shared.mean(), rel=1e-12)


def test_without_spread_there_is_no_test():
    found = compare(make_matrix(votes_of(np.full((5, 3, 2), 4.0))), differences=True)
    assert all(pair.t is None and pair.p_holm is None for pair in found.pairs)
    assert all(effect.f is None for effect in found.anova)
    assert found.friedman is None


@pytest.mark.parametrize("seed", range(5))
def test_holm_as_statsmodels(seed):
    p_values = np.random.default_rng(seed).random(7) ** 3
    np.testing.assert_allclose(holm(p_values), multipletests(p_values, method="holm")[1])


def test_holm_passes_over_tests_that_were_not_made():
    assert holm([None, 0.01, None, 0.04]) == [None, 0.02, None, 0.04]


@pytest.mark.parametrize(
    ("effect", "n", "alpha"), [(0.5, 16, 0.05), (0.9, 8, 0.01), (0.1, 40, 0.05)]
)
def test_power_as_statsmodels(effect, n, alpha):
    reference_power = TTestPower().power(effect, n, alpha)
    assert paired_power(effect * 12, 12, n, alpha) == pytest.approx(reference_power, rel=1e-6)


def test_number_of_assessors_is_the_least_that_reaches_the_power():
    assert assessors_needed(5, 10) == 34
    assert paired_power(5, 10, 34) >= 0.8 > paired_power(5, 10, 33)
    assert assessors_needed(0.001, 30) is None
    assert paired_power(detectable_difference(16, 10), 10, 16) == pytest.approx(0.8, abs=1e-8)
    assert detectable_difference(2, 10) > detectable_difference(3, 10)


def test_signed_ranks_exact_without_ties_and_approximated_with():
    exact = compare(
        make_matrix(votes_of(np.arange(1.0, 7)[:, None, None])), differences=True
    ).against_reference[0]
    assert exact.p_wilcoxon == pytest.approx(2 / 2**6)
    tied = np.array([1.0, 1, 1, -1, 2, 2, 0])[:, None, None]
    found = compare(make_matrix(votes_of(tied)), differences=True).against_reference[0]
    assert 0.05 < found.p_wilcoxon < 0.2
