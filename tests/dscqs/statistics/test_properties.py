"""What must hold for any votes: order, bias, permutation, repetition, missing votes."""

from __future__ import annotations

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from dscqs.statistics.analysis import analyse
from dscqs.statistics.coherence import coherence
from dscqs.statistics.comparisons import compare
from dscqs.statistics.details import details
from dscqs.statistics.document import document
from dscqs.statistics.likelihood import recover
from dscqs.statistics.matrix import make_matrix
from dscqs.statistics.missing import missing_votes
from dscqs.statistics.normalise import remove_bias, z_scores
from dscqs.statistics.screening import FEWEST_SCREENED, Variant, screen
from dscqs.statistics.text import format_analysis
from dscqs.votes import Vote, make_table

GRADE = st.integers(0, 1000).map(lambda tenths: tenths / 10)

UNSHRUNK = (Phase.explicit, Phase.reuse, Phase.generate)
"""A failure here is slow to shrink, and as good to read unshrunk."""


@st.composite
def tables(draw, fewest=2, missing=True):
    """Votes of 2 … 7 assessors on 2 … 3 conditions, 1 … 3 contents, 1 … 2 repetitions."""
    sizes = [draw(st.integers(fewest, 7)), draw(st.integers(2, 3)), draw(st.integers(1, 3)),
             draw(st.integers(1, 2))]  # fmt: skip
    cells = [
        (a, c, k, r)
        for a in range(sizes[0])
        for c in range(sizes[1])
        for k in range(sizes[2])
        for r in range(sizes[3])
    ]
    grade = st.one_of(st.none(), GRADE) if missing else GRADE
    grades = draw(
        st.lists(st.tuples(grade, grade), min_size=len(cells), max_size=len(cells))
    )  # fmt: skip
    return [
        Vote(
            assessor=f"a{a}", condition=f"c{c}", content=f"k{k}", repetition=r + 1,
            grade_reference=one, grade_test=two,
        )
        for (a, c, k, r), (one, two) in zip(cells, grades, strict=True)
    ]  # fmt: skip


def by_stimulus(votes):
    (analysis,) = analyse(make_table(votes))
    return {(cell.content, cell.condition): cell for cell in analysis.stimuli}


def same(one, two):
    for name, value in dataclasses.asdict(one).items():
        other = getattr(two, name)
        assert (value is None) == (other is None), name
        assert value is None or value == pytest.approx(other, abs=1e-9), name


@given(votes=tables(), chance=st.randoms(use_true_random=False))
@settings(max_examples=20, deadline=None)
def test_the_order_of_the_votes_changes_nothing(votes, chance):
    shuffled = votes.copy()
    chance.shuffle(shuffled)
    one, two = by_stimulus(votes), by_stimulus(shuffled)
    assert one.keys() == two.keys()
    for key, cell in one.items():
        for figure, score in cell.figures.items():
            same(score.before, two[key].figures[figure].before)
            same(score.after, two[key].figures[figure].after)
    for variant in Variant:
        first = screen(make_matrix(votes), variant).assessors
        second = screen(make_matrix(shuffled), variant).assessors
        assert {name: first[name] for name in sorted(first)} == {
            name: second[name] for name in sorted(second)
        }


def test_displays_have_one_order_of_names():
    def vote(display, content, condition):
        return Vote(
            assessor="a", display=display, content=content, condition=condition, repetition=1,
            score=1.0,
        )  # fmt: skip

    names = list(itertools.product(("street", "ballet", "hall"), ("sr", "bicubic")))
    votes = [vote("one", *pair) for pair in names]
    votes += [vote("two", *pair) for pair in reversed(names)]
    (analysis,) = analyse(make_table(votes))
    for display in analysis.displays:
        assert list(display.matrix.stimuli) == names


@given(votes=tables(missing=False), bias=st.lists(st.integers(-5, 5), min_size=7, max_size=7))
@settings(max_examples=20, deadline=None)
def test_an_assessor_who_grades_all_higher_changes_no_difference(votes, bias):
    """The bias is in the reference's grade as in the test's: differences do not know it."""

    def biased(vote):
        by = float(bias[int(vote.assessor[1:])])
        return Vote(
            assessor=vote.assessor, condition=vote.condition, content=vote.content,
            repetition=vote.repetition, grade_reference=vote.grade_reference * 0.9 + 5 + by,
            grade_test=vote.grade_test * 0.9 + 5 + by,
        )  # fmt: skip

    bias_free = [
        dataclasses.replace(
            vote,
            difference=round(vote.difference * 0.9, 10),
            grade_reference=None,
            grade_test=None,
        )
        for vote in votes
    ]
    one, two = by_stimulus([biased(vote) for vote in votes]), by_stimulus(bias_free)
    for key, cell in one.items():
        same(cell.primary.before, two[key].primary.before)


@given(votes=tables(), chance=st.randoms(use_true_random=False))
@settings(max_examples=15, deadline=None)
def test_renaming_the_conditions_renames_the_results(votes, chance):
    names = sorted({vote.condition for vote in votes})
    mixed = names.copy()
    chance.shuffle(mixed)
    other = dict(zip(names, mixed, strict=True))
    renamed = [dataclasses.replace(vote, condition=other[vote.condition]) for vote in votes]
    one, two = by_stimulus(votes), by_stimulus(renamed)
    for (content, condition), cell in one.items():
        same(cell.primary.after, two[content, other[condition]].primary.after)


@given(votes=tables(fewest=4))
@settings(max_examples=20, deadline=None)
def test_the_screening_is_applied_once(votes):
    """Results "after" leave out whom the screening of all votes rejects, and nobody else."""
    (analysis,) = analyse(make_table(votes))
    (display,) = analysis.displays
    rejected = set(screen(make_matrix(votes)).rejected)
    left = [vote for vote in votes if vote.assessor not in rejected]
    assert left, "the screening cannot reject everybody"
    matrix = make_matrix(left)
    for cell in analysis.stimuli:
        values = matrix.values[matrix.rows(cell.content, cell.condition)]
        kept = values[~np.isnan(values)]
        assert cell.primary.after.n == kept.size
        if kept.size:
            assert cell.primary.after.mean == pytest.approx(kept.mean(), abs=1e-9)
    assert set(display.screenings[Variant.SAMPLE].rejected) == rejected


@given(seed=st.integers(0, 2**32 - 1), people=st.integers(2, FEWEST_SCREENED - 1))
@settings(max_examples=50, deadline=None)
def test_of_few_assessors_nobody_is_far_from_the_mean(seed, people):
    """The first vote of each stimulus is another one's than all others, the farthest it can be."""
    rng = np.random.default_rng(seed)
    votes = [
        Vote(assessor=f"a{number}", condition=f"c{item}", content="x",
             difference=float(rng.integers(1, 100)) * (number == item % people))
        for number in range(people) for item in range(20)
    ]  # fmt: skip
    for variant in Variant:
        found = screen(make_matrix(votes), variant).assessors
        assert {(one.high, one.low) for one in found.values()} == {(0, 0)}
        text = format_analysis(analyse(make_table(votes), variant))
        assert "the screening of" in text
        assert f"of {people} assessors nobody can be far from the mean" in text


def test_of_as_many_as_are_needed_one_can_be_far_from_the_mean():
    votes = [
        Vote(assessor=f"a{number}", condition="c", content="x", difference=9.0 * (number == 0))
        for number in range(FEWEST_SCREENED)
    ]
    assert screen(make_matrix(votes), Variant.POPULATION).assessors["a0"].high == 1
    assert "means nothing" not in format_analysis(analyse(make_table(votes), Variant.POPULATION))


@given(votes=tables(missing=False))
@settings(max_examples=20, deadline=None)
def test_scores_and_grades_say_the_same(votes):
    for cell in by_stimulus(votes).values():
        before = {name: score.before for name, score in cell.figures.items()}
        difference = before["grade_reference"].mean - before["grade_test"].mean
        assert before["primary"].mean == pytest.approx(difference, abs=1e-9)
        assert before["test_score"].mean == pytest.approx(100 - before["grade_test"].mean, abs=1e-9)
        assert before["test_score"].sd == pytest.approx(before["grade_test"].sd, abs=1e-9)
        assert (
            before["primary"].se == 0
            or before["primary"].ci95_normal == 1.96 * before["primary"].se
        )


@given(votes=tables(missing=False))
@settings(max_examples=20, deadline=None)
def test_bias_removal_leaves_means_and_takes_the_bias(votes):
    matrix = make_matrix(votes)
    found = remove_bias(matrix)
    np.testing.assert_allclose(
        found.matrix.values.mean(axis=1), matrix.values.mean(axis=1), atol=1e-9
    )
    np.testing.assert_allclose(remove_bias(found.matrix).bias, 0, atol=1e-9)
    z = z_scores(matrix).values
    known = ~np.isnan(z).all(axis=0)
    np.testing.assert_allclose(z[:, known].mean(axis=0), 0, atol=1e-9)
    np.testing.assert_allclose(z[:, known].std(axis=0, ddof=1), 1, atol=1e-9)


@given(votes=tables())
@settings(max_examples=15, deadline=None)
def test_missing_votes_are_counted_and_never_filled(votes):
    matrix = make_matrix(votes)
    absent = sum(vote.primary is None for vote in votes)
    found = missing_votes(matrix)
    assert found.count == sum(found.by_assessor.values()) == sum(found.stimuli.values()) == absent
    without = make_matrix([vote for vote in votes if vote.primary is not None] or votes)
    if absent < len(votes):
        for key, cell in by_stimulus(votes).items():
            rows = without.values[without.rows(*key)]
            assert cell.primary.before.n == (~np.isnan(rows)).sum()


@given(votes=tables())
@settings(max_examples=15, deadline=None, phases=UNSHRUNK)
def test_any_votes_give_a_document_without_nan(votes):
    def walk(value):
        if isinstance(value, dict):
            for item in value.values():
                walk(item)
        elif isinstance(value, (list, tuple)):
            for item in value:
                walk(item)
        elif isinstance(value, float):
            assert math.isfinite(value)

    walk(document(analyse(make_table(votes))))


def simulated(quality, bias, noise, seed):
    chance = np.random.default_rng(seed)
    return make_matrix(
        [
            Vote(
                assessor=f"a{a}", content=f"k{k}", condition="c",
                difference=float(np.clip(q + bias[a] + noise[a] * chance.normal(), -100, 100)),
            )
            for a in range(len(bias))
            for k, q in enumerate(quality)
        ]
    )  # fmt: skip


def test_the_model_finds_what_the_votes_were_made_of():
    quality = np.linspace(-10, 60, 60)
    bias = np.linspace(-8, 8, 16)
    noise = np.repeat([3.0, 4, 8, 15], 4)
    matrix = simulated(quality, bias, noise, seed=11)
    found = recover(matrix)
    assert found.converged
    assert found.dominated is None
    np.testing.assert_allclose(found.bias, bias - bias.mean(), atol=3)
    np.testing.assert_allclose(found.inconsistency, noise, rtol=0.4)
    error = np.std(found.quality - quality)
    plain = np.std(matrix.values.mean(axis=1) - quality)
    assert error < 0.7 * plain
    # Its own standard errors do not know that the weights are estimates: they are too small.
    assert 1 < error / np.sqrt((found.se_model**2).mean()) < 1.7


def test_an_assessor_who_takes_over_the_model_is_named():
    """With few assessors one residual can be made zero, and the likelihood has no maximum."""
    quality = np.linspace(-10, 60, 60)
    found = recover(simulated(quality, [-8.0, -3, 0, 1, 4, 6], [3.0, 3, 4, 6, 9, 15], seed=11))
    assert found.dominated == "a0"


def test_coherence_of_repeated_items():
    votes = [
        Vote(assessor=name, content=f"k{k}", condition="c", repetition=r, difference=10.0 * k + by)
        for name, by_repetition in (("steady", (0.0, 0.0)), ("drifts", (0.0, 4.0)))
        for k in range(4)
        for r, by in enumerate(by_repetition, start=1)
    ]
    found = coherence(make_matrix(votes))
    assert found.repeats["steady"].within_sd == 0
    assert found.repeats["drifts"].mean_change == pytest.approx(4)
    assert found.repeats["drifts"].within_sd == pytest.approx(4 / 2**0.5)
    assert found.repeats["drifts"].repeatability == pytest.approx(1.96 * 4)
    assert found.repeats["drifts"].correlation == pytest.approx(1)
    assert found.all_repeats.stimuli == 8
    assert found.agreement["steady"].pearson == pytest.approx(1)
    turned = [
        dataclasses.replace(vote, assessor="against", difference=50 - vote.difference)
        for vote in votes
        if vote.assessor == "steady"
    ]
    disagreement = coherence(make_matrix([*votes, *turned])).agreement
    assert disagreement["against"].low
    assert disagreement["against"].spearman == pytest.approx(-1)


def test_fewer_than_two_complete_assessors_give_no_anova():
    votes = [
        Vote(assessor="a", content="k", condition=condition, difference=value)
        for condition, value in (("c0", 1.0), ("c1", 2.0))
    ]
    found = compare(make_matrix(votes), differences=True)
    assert found.anova == ()
    assert found.pairs[0].n == 1
    assert found.pairs[0].p is None


def test_display_and_condition_over_those_who_judged_on_every_display():
    chance = np.random.default_rng(5)
    votes = [
        Vote(
            assessor=f"a{a}", display=display, content=f"k{k}", condition=condition,
            difference=float(20 * c + 5 * d * c + chance.normal(0, 4)),
        )
        for a in range(10)
        for d, display in enumerate(("one", "two"))
        for c, condition in enumerate(("bicubic", "sharp"))
        for k in range(2)
        if not (a == 9 and d == 1)
    ]  # fmt: skip
    (analysis,) = analyse(make_table(votes))
    found = details(analysis)
    assert found.across_assessors == tuple(f"a{a}" for a in range(9))
    assert [effect.factors for effect in found.across] == [
        ("display",), ("condition",), ("display", "condition"),
    ]  # fmt: skip
    assert found.across[1].p_corrected < 1e-6
