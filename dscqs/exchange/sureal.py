"""Datasets of sureal, as JSON: stimuli with the opinion scores of every assessor.

sureal reads the same content from Python files; those would have to be executed and are refused.
A dataset holds one score for each vote, higher is better, on one display and in one dimension:

====================  =====================================================================
votes                 what is written
====================  =====================================================================
grades                ``os`` = grade of the test; the reference as a stimulus of its own, with
                      every grade it was given; ``ref_score`` 100
difference            ``os`` = 100 − difference (0 … 200), ``ref_score`` 100
score                 ``os`` = score, ``ref_score`` the highest
====================  =====================================================================
"""

from __future__ import annotations

from collections import defaultdict
from pathlib import PurePosixPath
from typing import Any

from dscqs.errors import VotesError
from dscqs.exchange.plain import Place
from dscqs.votes import TEST, Method, Vote, VoteTable, make_table

REFERENCE = "reference"

NOTES = {
    Method.GRADES: "os = grade of the stimulus, 0 = bad ... 100 = excellent, higher is better",
    Method.DIFFERENCE: "os = 100 - (reference - test), higher is better; 100 = as the reference",
    Method.SCORE: "os = score on the scale of its own test, higher is better",
}


def to_sureal(table: VoteTable, *, display: str, dimension: str) -> dict[str, Any]:
    """Return the votes of one display and dimension as a dataset; dummies are left out.

    Raises
    ------
    VotesError
        Where there is no such vote.
    """
    votes = [
        vote
        for vote in table.votes
        if (vote.kind, vote.display, vote.dimension) == (TEST, display, dimension)
    ]
    if not votes:
        raise VotesError(f"no vote on display {display!r} of {dimension!r}", path=table.name)
    contents = table.order.arrange("contents", (vote.content for vote in votes))
    stimuli: dict[tuple[str, str], dict[str, list[float]]] = {}
    if table.method is Method.GRADES:
        for content in contents:
            stimuli[content, REFERENCE] = _scores(
                [vote for vote in votes if vote.content == content], "grade_reference"
            )
    shown = table.order.arrange_shown((vote.content, vote.condition, 1) for vote in votes)
    for content, condition, _ in shown:
        if (content, condition) in stimuli:
            raise VotesError(f"condition {condition!r} has the name of the reference")
        own = [vote for vote in votes if (vote.content, vote.condition) == (content, condition)]
        figure = "grade_test" if table.method is Method.GRADES else "primary"
        stimuli[content, condition] = _scores(own, figure, table.method)
    top = max(
        (score for scores in stimuli.values() for own in scores.values() for score in own),
        default=0.0,
    )
    return {
        "dataset_name": table.name,
        "notes": f"{NOTES[table.method]}; display {display}; dimension {dimension}",
        "ref_score": top if table.method is Method.SCORE else 100.0,
        "ref_videos": [
            {"content_id": number, "content_name": name, "path": f"{name}/{REFERENCE}"}
            for number, name in enumerate(contents)
        ],
        "dis_videos": [
            {
                "content_id": contents.index(content),
                "asset_id": number,
                "condition": condition,
                "path": f"{content}/{condition}",
                "os": {name: own[0] if len(own) == 1 else own for name, own in scores.items()},
            }
            for number, ((content, condition), scores) in enumerate(stimuli.items())
        ],
    }


def _scores(
    votes: list[Vote], figure: str, method: Method = Method.GRADES
) -> dict[str, list[float]]:
    found: dict[str, list[float]] = defaultdict(list)
    for vote in votes:
        value = getattr(vote, figure)
        if value is not None:
            found[vote.assessor].append(
                100.0 - value if method is Method.DIFFERENCE else float(value)
            )
    return dict(found)


def from_sureal(document: Any, name: str) -> VoteTable:
    """Return the votes of a dataset, as scores of single stimuli.

    Of a list of scores, the assessors are numbered by their place in it. A list within it, or
    within an object, holds repetitions. The condition is the key ``condition``, else the name
    of the file without its folder, else the ``asset_id``.

    Raises
    ------
    VotesError
        Naming file, place and rule.
    """
    root = Place(document, "", name)
    contents = {}
    references = root.get("ref_videos")
    for video in [] if references is None else references.items():
        label = video.get("content_name")
        if label is not None:
            contents[video.need("content_id").key()] = label.key()
    votes = []
    stimuli: set[tuple[str, str]] = set()
    for video in root.need("dis_videos").items():
        content_id = video.need("content_id").key()
        content = contents.get(content_id, content_id)
        condition = _condition(video)
        if (content, condition) in stimuli:
            condition = f"{condition} ({video.need('asset_id').key()})"
        stimuli.add((content, condition))
        for assessor, places in _opinions(video.need("os")):
            votes += [
                Vote(
                    assessor=assessor, content=content, condition=condition,
                    repetition=repetition,
                    score=None if place.value is None else place.number(),
                )
                for repetition, place in enumerate(places, start=1)
            ]  # fmt: skip
    label = root.get("dataset_name")
    return make_table(votes, name=name if label is None else label.key())


def _condition(video: Place) -> str:
    own = video.get("condition")
    if own is not None:
        return own.key()
    path = video.get("path")
    if path is not None and (stem := PurePosixPath(path.key()).name):
        return stem
    return video.need("asset_id").key()


def _opinions(scores: Place) -> list[tuple[str, list[Place]]]:
    """Return, by assessor, the places of that assessor's scores."""
    if isinstance(scores.value, dict):
        named = [
            (name.strip() or scores.fail("an assessor has no name"), Place(
                value, f"{scores.way}[{name!r}]", scores.name))
            for name, value in scores.value.items()
        ]  # fmt: skip
    else:
        items = scores.items()
        width = max(2, len(str(len(items))))
        named = [(f"S{number:0{width}}", item) for number, item in enumerate(items, start=1)]
    return [
        (name, item.items() if isinstance(item.value, list) else [item]) for name, item in named
    ]
