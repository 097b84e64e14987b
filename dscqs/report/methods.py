"""The methods paragraphs of a report: which rules were used, and where they are written.

Clause numbers are those of the editions named in docs/dscqs-statistics.md, which says what was
read in the original and what was not.
"""

from __future__ import annotations

from collections.abc import Iterator

from dscqs.statistics.analysis import FEWEST_ASSESSORS, Analysis, voters
from dscqs.statistics.details import Details
from dscqs.statistics.screening import Variant
from dscqs.votes import Method

PRESENTATION = {
    Method.GRADES: "Double stimulus: reference and test were graded on continuous scales of "
    "0 (bad) to 100 (excellent). The figure that is analysed is the difference reference − test, "
    "−100 to 100: positive when the test is worse, negative when it is better; negative "
    "differences are kept as they are (ITU-R BT.500, DSCQS). Differences are not absolute scores "
    "and are not to be read back as words of the grading scale.",
    Method.DIFFERENCE: "The figure that is analysed is the difference reference − test, −100 to "
    "100, as given: positive when the test is worse; negative differences are kept as they are "
    "(ITU-R BT.500, DSCQS). Differences are not absolute scores and are not to be read back as "
    "words of the grading scale.",
    Method.SCORE: "Single stimulus: the figure that is analysed is the score as given, on the "
    "scale of its own test; higher is better.",
}

TEST_SCORE = (
    "Test score = 100 − grade, 0 = excellent to 100 = bad: lower is better. It is an absolute "
    "grade and carries the quality of the display; the difference does not."
)

INTERVALS = (
    "Means are arithmetic, SD is the sample's (n − 1), SE = SD / √n. “±95 %” is 1.96 · SE "
    "(ITU-R BT.500, Annex on analysis), “±95 % t” uses Student's t with n − 1 degrees of freedom, "
    "which is wider and right for small n. n counts votes: every repetition is one. Pooled "
    "intervals take the votes as independent, which votes of one assessor are not; the tests "
    "below use one mean for each assessor instead."
)

MODELS = (
    "The models beside the mean are options, not part of the result: z-scores by assessor (n − 1); "
    "bias removal after ITU-T P.913, 12.4; and the maximum-likelihood model of ITU-T P.910, "
    "Annex E (quality + bias + inconsistency), solved by alternating projection (Li et al., HVEI "
    "2020). They use every assessor, none rejected."
)

TESTS = (
    "Tests use the votes after screening, averaged over repetitions for every assessor. "
    "Analysis of variance: repeated measures, condition × content, degrees of freedom corrected "
    "after Greenhouse and Geisser (1959). Two conditions: paired t-test, two-sided, p corrected "
    "after Holm (1979) over all pairs of a display; “reference” as second tests the difference "
    "against zero. Wilcoxon's signed-rank and Friedman's test assume no normal distribution and "
    "are the ones to trust with few assessors. BT.500 asks for none of these tests."
)


def methods(analysis: Analysis, details: Details) -> Iterator[str]:
    """Yield the paragraphs, one for each rule that was used."""
    yield PRESENTATION[analysis.method]
    if "test_score" in analysis.displays[0].matrices:
        yield TEST_SCORE
    yield INTERVALS
    yield screening_text(analysis.variant)
    yield TESTS
    yield MODELS
    yield missing_text(details)


def screening_text(variant: Variant) -> str:
    """Return what the screening did, by which standard deviation."""
    which = (
        "the sample standard deviation (n − 1), as the Recommendation writes it"
        if variant is Variant.SAMPLE
        else "the population standard deviation (n), as sureal 0.9.0 computes it and other than "
        "the Recommendation writes it"
    )
    return (
        "Screening of assessors: ITU-R BT.500, 2.3.1 of Annex 2 (editions 11 to 13; A1-2.3.1 "
        "in 14), on each display apart and once only. A vote is far off when it is at least 2 "
        "(kurtosis 2 to 4) or √20 (otherwise) standard deviations from the mean of its "
        f"presentation; used here: {which}. Results are given before and after."
    )


def missing_text(details: Details) -> str:
    """Return how many votes are missing, and what was done about them: nothing."""
    parts = [
        f"{each.missing.count} of {each.missing.expected} on {each.display} "
        f"({', '.join(f'{name}: {count}' for name, count in each.missing.by_assessor.items())})"
        for each in details.displays
        if each.missing.count
    ]
    if not parts:
        return "No vote is missing."
    return (
        f"Missing votes: {'; '.join(parts)}. Nothing was put in their place: means are of the "
        "votes that there are, the denominator of the screening is the number of all "
        "presentations, and tests leave out an assessor who lacks every vote of a stimulus."
    )


def informal_text(analysis: Analysis) -> str | None:
    """Return the warning of a small panel; None when it is large enough."""
    few = {
        display.display: voters(display)
        for display in analysis.displays
        if voters(display) < FEWEST_ASSESSORS
    }
    if not few:
        return None
    who = ", ".join(f"{count} on {display}" for display, count in few.items())
    return (
        f"Informal: fewer than {FEWEST_ASSESSORS} assessors ({who}). ITU-R BT.500 wants at least "
        f"{FEWEST_ASSESSORS}; with fewer, the study must be called informal."
    )


def power_text(details: Details) -> Iterator[str]:
    """Yield, by display, what the number of assessors can show."""
    for each in details.displays:
        power = each.power
        if power is None:
            continue
        needed = "; ".join(
            f"{difference:g} needs {number or 'more than 10 000'}"
            for difference, number in power.needed.items()
        )
        yield (
            f"Power on {each.display}: with {power.n} assessors and a standard deviation of the "
            f"paired differences of {power.sd:.1f}, a true difference of {power.detectable:.1f} is "
            "found with a probability of 0.8 (paired t-test, α = 0.05"
            + (f" divided by {power.comparisons} comparisons" if power.comparisons > 1 else "")
            + ")."
            + (f" Assessors needed for a true difference: {needed}." if needed else "")
        )
