"""What a test is: conditions, contents, displays, timing; checked, and frozen."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dscqs.errors import PlanError

DIMENSIONS = ("quality", "depth", "comfort", "naturalness")
"""What may be graded."""

LONGEST_SESSION_S = 1800.0
"""Longest session without a word from the operator [s] (BT.500: half an hour)."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Durations of one presentation: A, grey, B, grey, ``showings`` times, then the vote."""

    show_s: float = 3.0
    grey_s: float = 2.0
    vote_s: float = 8.0
    showings: int = 2

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            value = getattr(self, item.name)
            whole = item.name == "showings"
            if isinstance(value, bool) or not isinstance(value, int if whole else (int, float)):
                raise PlanError(f"timing.{item.name}: {value!r} is not a number")
            if not math.isfinite(value) or value < (0 if item.name == "grey_s" else 0.1):
                raise PlanError(f"timing.{item.name}: {value} is too small or not finite")

    @property
    def presentation_s(self) -> float:
        """Length of one presentation with its vote [s]."""
        return self.showings * 2 * (self.show_s + self.grey_s) + self.vote_s


@dataclass(frozen=True, kw_only=True)
class Plan:
    """One test.

    Parameters
    ----------
    name : str
        How the test is called.
    contents, conditions : tuple of str
        What is shown, and how it was made; the reference is not among the conditions.
    reference : str
        The condition that every other is compared with.
    stimuli : mapping
        File of the stimulus by ``content/condition``, relative to the plan.
    repetitions : int
        Times that every pair is shown.
    dummies : int
        Presentations at the start whose votes are not counted.
    long_session : bool
        A session of more than 30 minutes is wanted.
    """

    name: str
    contents: tuple[str, ...]
    conditions: tuple[str, ...]
    reference: str
    stimuli: Mapping[str, str]
    displays: tuple[str, ...] = ("display",)
    dimensions: tuple[str, ...] = ("quality",)
    timing: Timing = field(default_factory=Timing)
    kind: str = "still"
    layout: str = "sbs"
    variant: str = "II"
    grey: int = 128
    captions: bool = True
    repetitions: int = 1
    dummies: int = 5
    seed: int = 1
    long_session: bool = False

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise PlanError("name: must be a text that is not empty")
        for name in ("contents", "conditions", "displays", "dimensions"):
            _check_names(name, getattr(self, name))
        if self.reference in self.conditions or not isinstance(self.reference, str):
            raise PlanError(f"reference: {self.reference!r} must be a name not among conditions")
        for name in set(self.dimensions) - set(DIMENSIONS):
            raise PlanError(f"dimensions: {name!r} is none of {', '.join(DIMENSIONS)}")
        for name, known in (
            ("kind", ("still", "video")),
            ("variant", ("I", "II")),
            ("layout", ("sbs",)),
        ):
            if getattr(self, name) not in known:
                raise PlanError(f"{name}: {getattr(self, name)!r} is none of {', '.join(known)}")
        for name, least, most in (
            ("repetitions", 1, 20),
            ("dummies", 0, 20),
            ("grey", 0, 255),
            ("seed", 0, 2**63 - 1),
        ):
            value = getattr(self, name)
            if type(value) is not int or not least <= value <= most:
                raise PlanError(f"{name}: {value!r} is not a whole number from {least} to {most}")
        for name in ("captions", "long_session"):
            if not isinstance(getattr(self, name), bool):
                raise PlanError(f"{name}: {getattr(self, name)!r} is neither true nor false")
        if not isinstance(self.stimuli, Mapping):
            raise PlanError("stimuli: must name a file for every content/condition")
        for content in self.contents:
            for condition in (self.reference, *self.conditions):
                if not isinstance(self.stimuli.get(f"{content}/{condition}"), str):
                    raise PlanError(f"stimuli: no file is named for {content}/{condition}")
        if self.session_s > LONGEST_SESSION_S and not self.long_session:
            raise PlanError(
                f"the session lasts {self.session_s / 60:.1f} min, more than 30: take fewer "
                "contents, conditions or repetitions, or set long_session: true"
            )

    @property
    def presentations(self) -> int:
        """Presentations of one session, dummies among them."""
        return self.dummies + len(self.contents) * len(self.conditions) * self.repetitions

    @property
    def session_s(self) -> float:
        """Length of the presentations of one session [s]."""
        return self.presentations * self.timing.presentation_s


def plan_from_dict(data: object) -> Plan:
    """Return the plan that a YAML or JSON file says, or raise a :class:`PlanError`."""
    if not isinstance(data, Mapping):
        raise PlanError("the plan must be a mapping of field names to values")
    known = {item.name: item for item in dataclasses.fields(Plan)}
    for name in data:
        if name not in known:
            raise PlanError(f"{name}: no such field (known: {', '.join(known)})")
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in data.items()
    }
    timing = values.get("timing", {})
    if not isinstance(timing, Mapping):
        raise PlanError("timing: must be a mapping")
    try:
        values["timing"] = Timing(**timing)
    except TypeError as error:
        raise PlanError(f"timing: {error}") from None
    missing = [
        name for name in ("name", "contents", "conditions", "reference", "stimuli")
        if name not in values
    ]  # fmt: skip
    if missing:
        raise PlanError(f"{missing[0]}: is missing")
    return Plan(**values)


def _check_names(name: str, value: object) -> None:
    if not isinstance(value, tuple) or not value:
        raise PlanError(f"{name}: must be a list of at least one name")
    for item in value:
        if not isinstance(item, str) or not item or "/" in item:
            raise PlanError(f"{name}: {item!r} is not a name (a text without '/')")
    if len(set(value)) != len(value):
        raise PlanError(f"{name}: a name is there twice")
