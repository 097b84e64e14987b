"""suJSON: sources, circuits, stimuli, subjects, trials, scores in one JSON document.

The format is that of the example in LucjanJanowski/translator-to-suJSON (``sujson_version``
1.1.1). A trial is one presentation. Of double-stimulus votes, every grade is a score of its
own, told apart by its question, whose ``characteristics`` name dimension and figure; display,
repetition and kind are characteristics of the trial.

====================  ============================
suJSON                here
====================  ============================
``src``               content
``hrc``               condition
``pvs``               stimulus
``subjects``          assessor
``questions``         dimension and figure
====================  ============================
"""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from typing import Any

from dscqs.errors import VotesError
from dscqs.exchange.plain import Place
from dscqs.votes import (
    DEFAULT_DISPLAY,
    DIRECTIONS,
    GRADES,
    ORDERED,
    Order,
    Vote,
    VoteTable,
    make_table,
)

VERSION = "1.1.1"
FIGURES = {line.split(":")[0]: line.split(": ", 1)[1] for line in DIRECTIONS}
RANGES = {"grade_reference": (0, 100), "grade_test": (0, 100), "difference": (-100, 100)}


def to_sujson(table: VoteTable) -> dict[str, Any]:
    """Return the votes as suJSON, dummies and training included, nothing rounded."""
    figures = [name for name in _figures(table) if not _derived(name, table)]
    order = table.order
    contents = _numbered(order.arrange("contents", (vote.content for vote in table.votes)))
    conditions = _numbered(order.arrange("conditions", (vote.condition for vote in table.votes)))
    shown = order.arrange_shown((vote.content, vote.condition, 1) for vote in table.votes)
    stimuli = _numbered((content, condition) for content, condition, _ in shown)
    subjects = _numbered(vote.assessor for vote in table.votes)
    questions = _numbered(
        (dimension, figure)
        for dimension in order.arrange("dimensions", (vote.dimension for vote in table.votes))
        for figure in figures
    )
    trials: list[dict[str, Any]] = []
    scores: list[dict[str, Any]] = []
    for number, vote in enumerate(table.votes, start=1):
        pvs = stimuli[vote.content, vote.condition]
        own = []
        for figure in figures:
            value = getattr(vote, figure)
            if value is not None:
                own.append(len(scores) + 1)
                scores.append(
                    {"id": own[-1], "question_id": questions[vote.dimension, figure],
                     "score": value, "pvs_id": pvs}
                )  # fmt: skip
        trials.append(
            {
                "id": number,
                "subject_id": subjects[vote.assessor],
                "task_id": 1,
                "pvs_id": pvs,
                "score_id": own,
                "characteristics": {
                    "display": vote.display,
                    "repetition": vote.repetition,
                    "dimension": vote.dimension,
                    "kind": vote.kind,
                    **({"extra": dict(vote.extra)} if vote.extra else {}),
                },
            }
        )
    return {
        "dataset_name": table.name,
        "sujson_version": VERSION,
        "characteristics": {
            "per_subject_data": True,
            "method": table.method.value,
            **({} if order == Order() else {"order": dataclasses.asdict(order)}),
        },
        "tasks": [{"id": 1, "task": "Grade every presentation."}],
        "scales": [_scale(number, figure) for number, figure in enumerate(figures, start=1)],
        "questions": [
            {
                "id": number,
                "question": f"{dimension}: {figure}",
                "scale_id": figures.index(figure) + 1,
                "characteristics": {"dimension": dimension, "figure": figure},
            }
            for (dimension, figure), number in questions.items()
        ],
        "src": [{"id": number, "name": name} for name, number in contents.items()],
        "hrc": [{"id": number, "name": name} for name, number in conditions.items()],
        "pvs": [
            {"id": number, "src_id": contents[content], "hrc_id": conditions[condition]}
            for (content, condition), number in stimuli.items()
        ],
        "subjects": [{"id": number, "name": name} for name, number in subjects.items()],
        "trials": trials,
        "scores": scores,
    }


def _figures(table: VoteTable) -> list[str]:
    return [
        name for name in GRADES if any(getattr(vote, name) is not None for vote in table.votes)
    ] or ["score"]


def _derived(name: str, table: VoteTable) -> bool:
    """Tell whether a column follows from the grades, so that it need not be written."""
    return name == "difference" and all(
        vote.difference is None or None not in (vote.grade_reference, vote.grade_test)
        for vote in table.votes
    )


def _numbered(items: Any) -> dict[Any, int]:
    return {item: number for number, item in enumerate(dict.fromkeys(items), start=1)}


def _scale(number: int, figure: str) -> dict[str, Any]:
    limits = RANGES.get(figure)
    return {
        "id": number,
        "name": figure,
        "type": "continuous",
        "description": FIGURES[figure],
        "range": {"min": limits[0], "max": limits[1]} if limits else None,
        "labels": None,
    }


def from_sujson(document: Any, name: str) -> VoteTable:
    """Return the votes of a suJSON document.

    Scores that no trial names (means of all subjects) are passed over. A question with neither
    dimension nor figure in its characteristics is of single stimuli; where there are several,
    each is a dimension of its own.

    Raises
    ------
    VotesError
        Naming file, place and rule.
    """
    root = Place(document, "", name)
    tables = {key: root.need(key).by_id() for key in ("pvs", "subjects", "questions", "scores")}
    for key in ("src", "hrc", "scales"):
        found = root.get(key)
        tables[key] = {} if found is None else found.by_id()
    votes: list[Vote] = []
    seen: Counter[tuple[str, ...]] = Counter()
    for trial in root.need("trials").items():
        votes += _votes(trial, tables, seen)
    label = root.get("dataset_name")
    return make_table(
        votes,
        name=name if label is None else label.key(),
        order=_order(root.get("characteristics")),
    )


def _order(traits: Place | None) -> Order:
    """Return the order of the test's plan, as we write it."""
    found = None if traits is None else traits.get("order")
    if found is None:
        return Order()
    lists = {name: found.get(name) for name in ORDERED}
    return Order(
        **{
            name: tuple(item.key() for item in place.items())
            for name, place in lists.items()
            if place is not None
        }
    )


Tables = dict[str, dict[str, Place]]


def _votes(trial: Place, tables: Tables, seen: Counter[tuple[str, ...]]) -> Iterator[Vote]:
    """Yield the votes of a trial: one for each stimulus and dimension."""
    subject = _named(trial.need("subject_id"), tables, "subjects")
    traits = trial.get("characteristics")
    display = _trait(traits, "display") or DEFAULT_DISPLAY
    groups: dict[tuple[str, str], dict[str, float]] = {}
    for score in _scores(trial, tables):
        question = _find(score.need("question_id"), tables, "questions")
        dimension, figure = _meaning(question, tables)
        pvs = score.get("pvs_id") or trial.need("pvs_id")
        if isinstance(pvs.value, list):
            pvs.fail("compares stimuli; only scores of one stimulus can be read")
        group = groups.setdefault((pvs.key(), dimension), {})
        if figure in group:
            score.fail("is a second score of the same trial, stimulus and question")
        group[figure] = _checked(score.need("score"), question, tables)
    if not groups and traits is not None:  # a presentation without a vote, as we write it
        groups[trial.need("pvs_id").key(), _trait(traits, "dimension") or "quality"] = {}
    for (pvs_key, dimension), figures in groups.items():
        content, condition = _stimulus(trial, pvs_key, tables)
        kind = _trait(traits, "kind") or "test"
        repetition = traits.get("repetition") if traits is not None else None
        key = (subject, display, content, condition, dimension, kind)
        seen[key] += 1
        try:
            yield Vote(
                assessor=subject,
                display=display,
                content=content,
                condition=condition,
                dimension=dimension,
                kind=kind,
                repetition=seen[key] if repetition is None else int(repetition.number()),
                extra=_extra(traits),
                **figures,
            )
        except VotesError as error:
            trial.fail(f"{error.column}: {error.said}")


def _scores(trial: Place, tables: Tables) -> list[Place]:
    found = trial.get("score_id")
    if found is None:
        return []
    keys = found.items() if isinstance(found.value, list) else [found]
    return [_find(key, tables, "scores") for key in keys]


def _find(key: Place, tables: Tables, table: str) -> Place:
    found = tables[table].get(key.key())
    if found is None:
        key.fail(f"there is no {table}[id = {key.key()}]")
    return found


def _named(key: Place, tables: Tables, table: str) -> str:
    found = _find(key, tables, table).get("name")
    return key.key() if found is None else found.key()


def _stimulus(trial: Place, pvs_key: str, tables: Tables) -> tuple[str, str]:
    pvs = tables["pvs"].get(pvs_key)
    if pvs is None:
        trial.fail(f"pvs_id: there is no pvs[id = {pvs_key}]")
    own = next(
        (found.key() for key in ("name", "file_name", "path") if (found := pvs.get(key))), pvs_key
    )
    source, circuit = pvs.get("src_id"), pvs.get("hrc_id")
    return (
        "all" if source is None else _named(source, tables, "src"),
        own if circuit is None else _named(circuit, tables, "hrc"),
    )


def _meaning(question: Place, tables: Tables) -> tuple[str, str]:
    """Return dimension and figure of a question."""
    traits = question.get("characteristics")
    figure, dimension = _trait(traits, "figure"), _trait(traits, "dimension")
    if figure is not None and figure not in GRADES:
        question.fail(f"characteristics.figure {figure!r} is none of {', '.join(GRADES)}")
    if dimension is None:
        text = question.get("question")
        alone = len(tables["questions"]) == 1 or text is None
        dimension = "quality" if alone or text is None else text.key()
    return dimension, figure or "score"


def _checked(score: Place, question: Place, tables: Tables) -> float:
    value = score.number()
    scale_key = question.get("scale_id")
    scale = None if scale_key is None else _find(scale_key, tables, "scales")
    limits = None if scale is None else scale.get("range")
    if limits is not None:
        low, high = limits.need("min").number(), limits.need("max").number()
        if not low <= value <= high:
            score.fail(f"{value:g} is outside its scale, {low:g} … {high:g}")
    return value


def _trait(traits: Place | None, key: str) -> str | None:
    found = None if traits is None else traits.get(key)
    return None if found is None else found.key()


def _extra(traits: Place | None) -> dict[str, str]:
    found = None if traits is None else traits.get("extra")
    if found is None:
        return {}
    if not isinstance(found.value, dict):
        found.fail("must be an object")
    return {str(key): str(value) for key, value in found.value.items()}
