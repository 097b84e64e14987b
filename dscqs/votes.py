"""The tidy table of votes: what one is, and how it is read from and written to CSV.

One vote is one row. Everything downstream (statistics, reports, other formats) knows votes in
this form only, whoever collected them.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from dscqs.errors import VotesError

KEYS = ("assessor", "display", "content", "condition", "repetition", "dimension")
"""The columns that tell one vote from every other."""

GRADES = ("grade_reference", "grade_test", "difference", "score")
"""The columns that hold what was voted."""

DEFAULT_DISPLAY = "display"
DEFAULT_DIMENSION = "quality"

TEST = "test"
"""The ``kind`` of a vote that counts; dummies and training are others, and are left out."""

DIRECTIONS = (
    "grade_reference: grade of the reference; 0 = bad ... 100 = excellent, higher is better",
    "grade_test: grade of the tested condition; 0 = bad ... 100 = excellent, higher is better",
    "difference: grade_reference - grade_test, -100 ... 100; positive = the test is worse",
    "score: single-stimulus score on the scale of its own test, higher is better",
)
"""The direction of every scale, as the header of an exported file says it."""


ORDERED = ("displays", "contents", "conditions", "dimensions")
"""What a plan puts into an order, as the header of an exported file says it."""

VoteKey = tuple[str, str, str, str, int, str]
"""Assessor, display, content, condition, repetition, dimension: see ``KEYS``."""


class Method(StrEnum):
    """What the votes of a table are."""

    GRADES = "grades"  # of the reference and of the test: DSCQS
    DIFFERENCE = "difference"  # reference - test, grades not known
    SCORE = "score"  # of one stimulus alone


@dataclass(frozen=True, kw_only=True)
class Vote:
    """One vote: who judged what, where, for which time, and how.

    Parameters
    ----------
    assessor, content, condition, display, dimension : str
        Who judged what, on what, and in which respect.
    repetition : int
        Which showing of the same stimulus, from 1.
    grade_reference, grade_test : float or None
        0 (bad) … 100 (excellent); None: no vote.
    difference : float or None
        Reference − test, −100 … 100, sign kept; made from the grades where they are given.
    score : float or None
        Of a single-stimulus test, on whatever scale that had; higher is better.
    kind : str
        ``test``, or what else the presentation was for (``dummy``, ``training``).
    extra : mapping
        Further columns by name, as text: order, side, times, dropped frames, …
    """

    assessor: str
    content: str
    condition: str
    display: str = DEFAULT_DISPLAY
    repetition: int = 1
    dimension: str = DEFAULT_DIMENSION
    grade_reference: float | None = None
    grade_test: float | None = None
    difference: float | None = None
    score: float | None = None
    kind: str = TEST
    extra: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("assessor", "content", "condition", "display", "dimension", "kind"):
            if not getattr(self, name):
                raise VotesError("is empty", column=name)
        for name, low, high in (
            ("grade_reference", 0.0, 100.0),
            ("grade_test", 0.0, 100.0),
            ("difference", -100.0, 100.0),
            ("score", -math.inf, math.inf),
        ):
            value = getattr(self, name)
            if value is None:
                continue
            if not math.isfinite(value):
                raise VotesError(f"{value} is not a finite number", column=name)
            if not low <= value <= high:
                raise VotesError(f"{value:g} is outside {low:g} … {high:g}", column=name)
        if self.grade_reference is None or self.grade_test is None:
            return
        # Rounded, so that equal differences of decimal grades are equal numbers.
        made = round(self.grade_reference - self.grade_test, 10)
        if self.difference is None:
            object.__setattr__(self, "difference", made)
        elif abs(self.difference - made) > 0.051:
            raise VotesError(
                f"{self.difference:g} is not grade_reference − grade_test = {made:g}",
                column="difference",
            )

    @property
    def key(self) -> VoteKey:
        """What tells this vote from every other of the test."""
        return (
            self.assessor,
            self.display,
            self.content,
            self.condition,
            self.repetition,
            self.dimension,
        )

    @property
    def primary(self) -> float | None:
        """The figure that is analysed: the difference where there is one, else the score."""
        return self.difference if self.score is None else self.score


PresentationKey = tuple[str, str, int]
"""Content, condition, repetition: what tells a presentation from every other of a test."""


@dataclass(frozen=True, kw_only=True)
class Order:
    """Names in the order of the test's plan, for tables, plots and files; empty: not known."""

    displays: tuple[str, ...] = ()
    contents: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ()
    dimensions: tuple[str, ...] = ()

    def arrange(self, column: str, names: Iterable[str]) -> tuple[str, ...]:
        """Return each name once: those of the plan in its order, then the others as they come."""
        found = dict.fromkeys(names)
        known = dict.fromkeys(name for name in getattr(self, column) if name in found)
        return tuple(known | found)

    def arrange_shown(self, shown: Iterable[PresentationKey]) -> tuple[PresentationKey, ...]:
        """Return each content, condition and repetition once, in the order of the plan."""
        found = tuple(dict.fromkeys(shown))
        if not (self.contents or self.conditions):
            return found
        contents = self.arrange("contents", (content for content, _, _ in found))
        conditions = self.arrange("conditions", (condition for _, condition, _ in found))
        return tuple(
            sorted(
                found, key=lambda one: (contents.index(one[0]), conditions.index(one[1]), one[2])
            )
        )


@dataclass(frozen=True, kw_only=True)
class VoteTable:
    """All votes of a test, in the order of their file, and what they are."""

    votes: tuple[Vote, ...]
    method: Method
    name: str = "votes"
    order: Order = Order()


def make_table(votes: Iterable[Vote], *, name: str = "votes", order: Order = Order()) -> VoteTable:
    """Return a table of votes; refuse votes of two methods, or of the same thing twice."""
    kept = tuple(votes)
    if not kept:
        raise VotesError("there is no vote in it", path=name)
    seen: set[VoteKey] = set()
    for vote in kept:
        if vote.kind != TEST:
            continue
        if vote.key in seen:
            raise VotesError(f"two votes of {_said(vote)}", path=name)
        seen.add(vote.key)
    methods = {method for vote in kept if (method := _method(vote)) is not None}
    if methods == {Method.GRADES, Method.DIFFERENCE}:
        methods = {Method.DIFFERENCE}  # grades of a part of the votes only
    if len(methods) > 1:
        raise VotesError("has scores of single stimuli and differences in one table", path=name)
    method = methods.pop() if methods else Method.SCORE
    return VoteTable(votes=kept, method=method, name=name, order=order)


def _method(vote: Vote) -> Method | None:
    if vote.score is not None:
        return Method.SCORE
    if vote.grade_reference is not None and vote.grade_test is not None:
        return Method.GRADES
    return None if vote.difference is None else Method.DIFFERENCE


def _said(vote: Vote) -> str:
    return (
        f"assessor {vote.assessor!r}, display {vote.display!r}, content {vote.content!r}, "
        f"condition {vote.condition!r}, repetition {vote.repetition}"
        + (f", dimension {vote.dimension!r}" if vote.dimension != DEFAULT_DIMENSION else "")
    )


def read_text(path: Path) -> str:
    """Return the text of a UTF-8 file, its byte-order mark left out.

    Raises
    ------
    VotesError
        Naming file and line.
    """
    try:
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise VotesError(f"cannot be read: {error.strerror}", path=path) from error
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise VotesError("is not UTF-8 text; save it as UTF-8", path=path, line=line) from error


def parse_csv(text: str, *, name: str = "votes") -> VoteTable:
    """Return the votes of the text of a tidy CSV file.

    Comma, semicolon or tab separate the cells; lines of ``#`` before the header and empty lines
    are passed over. ``display``, ``repetition`` and ``dimension`` may be left out. With
    semicolons, a decimal comma is understood. Lines such as ``# conditions: ["bicubic", "sr"]``
    before the header say the order of tables and plots.

    Raises
    ------
    VotesError
        Naming file, line and column.
    """
    lines = list(io.StringIO(text, newline=""))  # \n, \r\n and \r end a line, nothing else
    skipped = 0
    while skipped < len(lines) and (not lines[skipped].strip() or lines[skipped][0] == "#"):
        skipped += 1
    if skipped == len(lines):
        raise VotesError("is empty: a header line and votes are wanted", path=name)
    separator = max(",;\t", key=lines[skipped].count)
    rows = csv.reader(lines[skipped:], delimiter=separator, strict=True, skipinitialspace=True)
    columns = _columns(next(rows), name=name, line=skipped + 1)
    votes: list[Vote] = []
    lines_of: dict[VoteKey, int] = {}
    before = skipped + rows.line_num
    try:
        for cells in rows:
            line, before = before + 1, skipped + rows.line_num
            if not any(cell.strip() for cell in cells):
                continue
            try:
                vote = _vote(columns, cells, decimal_comma=separator == ";")
            except VotesError as error:
                raise error.at(path=name, line=line) from None
            if vote.kind == TEST and vote.key in lines_of:
                raise VotesError(
                    f"a second vote of {_said(vote)}; the first is in line {lines_of[vote.key]}"
                    + (
                        "" if "repetition" in columns else " (a column repetition tells them apart)"
                    ),
                    path=name,
                    line=line,
                )
            if vote.kind == TEST:
                lines_of[vote.key] = line
            votes.append(vote)
    except csv.Error as error:
        raise VotesError(str(error), path=name, line=before + 1) from error
    return make_table(votes, name=name, order=_order(lines[:skipped]))


def _order(head: Iterable[str]) -> Order:
    """Return the order that the lines before a header say; a line that is no such is a note."""
    found: dict[str, tuple[str, ...]] = {}
    for line in head:
        name, _, said = line.lstrip("# ").partition(":")
        if name not in ORDERED:
            continue
        with contextlib.suppress(ValueError):
            names = json.loads(said)
            if isinstance(names, list) and all(isinstance(one, str) for one in names):
                found[name] = tuple(names)
    return Order(**found)


def _columns(header: Sequence[str], *, name: str, line: int) -> tuple[str, ...]:
    columns = tuple(cell.strip().lower() for cell in header)
    for column in columns:
        if not column or columns.count(column) > 1:
            what = f"column {column!r} comes twice" if column else "a column has no name"
            raise VotesError(f"{what} in the header", path=name, line=line)
    for column in ("assessor", "content", "condition"):
        if column not in columns:
            raise VotesError(
                f"the header has no such column; it has {', '.join(columns)}",
                path=name,
                line=line,
                column=column,
            )
    has_grades = {"grade_reference", "grade_test"} <= set(columns)
    if not has_grades and not {"difference", "score"} & set(columns):
        raise VotesError(
            "the header has no votes: grade_reference and grade_test, difference, or score "
            "are wanted",
            path=name,
            line=line,
        )
    if "score" in columns and (has_grades or "difference" in columns):
        raise VotesError("score and difference in one table", path=name, line=line, column="score")
    return columns


def _vote(columns: tuple[str, ...], cells: Sequence[str], *, decimal_comma: bool) -> Vote:
    if len(cells) != len(columns):
        raise VotesError(f"{len(cells)} cells, but the header has {len(columns)} columns")
    row = {column: cell.strip() for column, cell in zip(columns, cells, strict=True)}
    named = {
        column: row.pop(column)
        for column in ("assessor", "content", "condition", "display", "dimension", "kind")
        if column in row
    }
    repetition = _repetition(row.pop("repetition", "1"))
    grades = {
        column: _number(row.pop(column), column, decimal_comma=decimal_comma)
        for column in GRADES
        if column in row
    }
    return Vote(
        **named,
        repetition=repetition,
        grade_reference=grades.get("grade_reference"),
        grade_test=grades.get("grade_test"),
        difference=grades.get("difference"),
        score=grades.get("score"),
        extra=row,
    )


def _repetition(cell: str) -> int:
    if not re.fullmatch(r"\d+(\.0*)?", cell):
        raise VotesError(f"{cell!r} is not a whole number from 0", column="repetition")
    return int(cell.split(".")[0])


def _number(cell: str, column: str, *, decimal_comma: bool) -> float | None:
    if not cell:
        return None
    try:
        value = float(cell.replace(",", ".") if decimal_comma else cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or "_" in cell:
        raise VotesError(
            f"{cell!r} is not a number (a missing vote is an empty cell)", column=column
        )
    return value


def format_csv(votes: Iterable[Vote], *, notes: Sequence[str] = (), order: Order = Order()) -> str:
    """Return votes as tidy CSV: the direction of every scale, the header, one vote a row.

    Parameters
    ----------
    votes : iterable of Vote
    notes : sequence of str
        Further lines of the header: name of the test, date, version.
    order : Order
        Said in the header, for whoever makes tables of the file.
    """
    kept = list(votes)
    used = [name for name in GRADES if any(getattr(vote, name) is not None for vote in kept)]
    optional = [
        name
        for name, default in (("dimension", DEFAULT_DIMENSION), ("kind", TEST))
        if any(getattr(vote, name) != default for vote in kept)
    ]
    extra = list(dict.fromkeys(name for vote in kept for name in vote.extra))
    stream = io.StringIO()
    for note in notes:
        stream.write(f"# {' '.join(note.split())}\n")
    for name in ORDERED:
        if getattr(order, name):
            stream.write(f"# {name}: {json.dumps(getattr(order, name), ensure_ascii=False)}\n")
    for direction in DIRECTIONS:
        if direction.split(":")[0] in used:
            stream.write(f"# {direction}\n")
    writer = csv.writer(stream, lineterminator="\n")
    names = [*KEYS[:5], *optional, *(used or ["score"])]
    writer.writerow([*names, *extra])
    for vote in kept:
        writer.writerow(
            [_cell(getattr(vote, name)) for name in names]
            + [vote.extra.get(name, "") for name in extra]
        )
    return stream.getvalue()


def _cell(value: str | float | None) -> str:
    return "" if value is None else repr(value) if isinstance(value, float) else str(value)
