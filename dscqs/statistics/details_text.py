"""Details of an analysis as lines of text, for the command line."""

from __future__ import annotations

from collections.abc import Iterator

from dscqs.statistics.anova import Effect
from dscqs.statistics.comparisons import Comparisons, Pair
from dscqs.statistics.details import Details, DisplayDetails


def details_lines(details: Details) -> Iterator[str]:
    """Yield what is missing, what differs, and what the number of assessors can show."""
    for each in details.displays:
        yield from _missing(each)
        yield from _repeats(each)
    for each in details.displays:
        yield from _comparisons(each.display, each.comparisons)
        if each.power is not None:
            needed = ", ".join(
                f"{number or 'more than 10 000'} for {difference:g}"
                for difference, number in each.power.needed.items()
            )
            yield (
                f"  power 0.8 with {each.power.n} assessors: a difference of "
                f"{each.power.detectable:.1f}" + (f"; assessors needed: {needed}" if needed else "")
            )
    if details.across:
        yield f"display and condition ({len(details.across_assessors)} assessors on every display)"
        yield from (f"  {effect_text(effect)}" for effect in details.across)


def _missing(each: DisplayDetails) -> Iterator[str]:
    if each.missing.count:
        who = ", ".join(f"{name} ({count})" for name, count in each.missing.by_assessor.items())
        yield (
            f"missing on {each.display!r}: {each.missing.count} of {each.missing.expected} votes "
            f"({who}); nothing was put in their place"
        )


def _repeats(each: DisplayDetails) -> Iterator[str]:
    found = each.coherence.all_repeats
    if found.within_sd is not None:
        yield (
            f"repeated items on {each.display!r}: within-assessor SD {found.within_sd:.2f} "
            f"({found.stimuli} repeated stimuli of all assessors)"
        )


def _comparisons(display: str, found: Comparisons) -> Iterator[str]:
    pairs = (*found.against_reference, *found.pairs)
    if not pairs and not found.anova:
        return
    yield f"conditions on {display!r}, after screening"
    yield from (f"  {effect_text(effect)}" for effect in found.anova)
    if found.incomplete:
        yield f"  left out of the ANOVA for missing votes: {', '.join(found.incomplete)}"
    if not found.balanced:
        yield "  no ANOVA: not every condition was shown with every content"
    if found.friedman is not None:
        yield (
            f"  Friedman: χ²({found.friedman.df}) = {found.friedman.chi_squared:.2f}, "
            f"p {p_text(found.friedman.p)}, W = {found.friedman.kendall_w:.2f}, "
            f"n = {found.friedman.n}"
        )
    yield from (f"  {_pair(pair)}" for pair in pairs)


def effect_text(effect: Effect) -> str:
    """Return one line of an ANOVA as text, after Greenhouse and Geisser."""
    name = " × ".join(effect.factors)
    if effect.f is None or effect.epsilon is None or effect.p_corrected is None:
        return f"ANOVA, {name}: no variation among the assessors"
    return (
        f"ANOVA, {name}: F({effect.df_effect * effect.epsilon:.2f}, "
        f"{effect.df_error * effect.epsilon:.2f}) = {effect.f:.2f}, "
        f"p {p_text(effect.p_corrected)} (Greenhouse–Geisser ε = {effect.epsilon:.3f}), "
        f"partial η² = {effect.partial_eta_squared:.3f}"
    )


def _pair(pair: Pair) -> str:
    names = f"{pair.first} − {pair.second}"
    if pair.mean is None:
        return f"{names}: nobody judged both"
    if pair.t is None or pair.p_holm is None:
        return f"{names}: {pair.mean:+.2f}, n = {pair.n}: no test without spread"
    return (
        f"{names}: {pair.mean:+.2f} ± {pair.ci95_t:.2f} (95 %, t), t({pair.df}) = {pair.t:.2f}, "
        f"p {p_text(pair.p_holm)} (Holm), n = {pair.n}"
    )


def p_text(p: float) -> str:
    """Return a p-value as one reads it: never 0."""
    return "< 0.001" if p < 0.001 else f"= {p:.3f}"
