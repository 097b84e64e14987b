"""What a test is: conditions, contents, displays, timing; checked, and frozen."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from dscqs.errors import PlanError

DIMENSIONS = ("quality", "depth", "comfort", "naturalness")
"""What may be graded."""

LONGEST_SESSION_S = 1800.0
"""Longest session without a word from the operator [s] (BT.500: half an hour)."""

STAGES = ("instructions", "screening", "stereo_acuity", "fatigue_before", "fatigue_after")
"""Stages that a plan may leave out; training, presentations, breaks and thanks follow from it."""

RANGES: Mapping[str, tuple[float, float]] = {
    "repetitions": (1, 20),
    "dummies": (0, 20),
    "coherence": (0, 10_000),
    "break_every": (0, 10_000),
    "break_s": (0.0, 3600.0),
    "grey": (0, 255),
    "seed": (0, 2**63 - 1),
    "timing.show_s": (0.1, 3600.0),
    "timing.grey_s": (0.0, 3600.0),
    "timing.vote_s": (0.1, 3600.0),
    "timing.showings": (1, 100),
    "timing.tolerance_s": (0.0, 3600.0),
}
"""Least and most of every number of a plan; whole numbers where these are."""


@dataclass(frozen=True, kw_only=True)
class Timing:
    """Durations of one presentation: grey, A, grey, B, ``showings`` times, then the vote.

    A presentation of which an interval is off by more than ``tolerance_s`` has failed.
    """

    show_s: float = 3.0
    grey_s: float = 2.0
    vote_s: float = 8.0
    showings: int = 2
    tolerance_s: float = 0.1

    def __post_init__(self) -> None:
        for item in dataclasses.fields(self):
            _check_number(f"timing.{item.name}", getattr(self, item.name))

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
    coherence : int
        Pairs that come once more than the others, the same for every assessor: does an
        assessor agree with themself?
    training : tuple of str
        Pairs shown before everything else, as ``content/condition``; their votes are not
        counted. Best of contents that are not in the test, spanning the range of quality.
    break_every : int
        Presentations from one break to the next; 0: no break.
    break_s : float
        Length of a break [s].
    stages : tuple of str
        Which of :data:`STAGES` the session has.
    folder : str
        Where the files of the stimuli lie; relative to the plan, or on a service to a root.
    hashes : mapping
        SHA-256 of the files by ``content/condition``; what is named here is checked.
    pixels : mapping
        Hash of the decoded pixels by ``content/condition``
        (:func:`dscqs.pixel_hash.hash_frames`); a showing that reports another one has failed.
    long_session : bool
        A session of more than 30 minutes is wanted.
    """

    name: str
    contents: tuple[str, ...]
    conditions: tuple[str, ...]
    reference: str
    stimuli: Mapping[str, str]
    displays: tuple[str, ...] = ("polarised",)
    dimensions: tuple[str, ...] = ("quality",)
    timing: Timing = field(default_factory=Timing)
    kind: str = "still"
    layout: str = "sbs"
    variant: str = "II"
    grey: int = 128
    captions: bool = True
    repetitions: int = 1
    dummies: int = 5
    coherence: int = 0
    training: tuple[str, ...] = ()
    break_every: int = 0
    break_s: float = 60.0
    stages: tuple[str, ...] = STAGES
    folder: str = "."
    hashes: Mapping[str, str] = field(default_factory=dict)
    pixels: Mapping[str, str] = field(default_factory=dict)
    seed: int = 1
    long_session: bool = False

    def __post_init__(self) -> None:
        self._check_texts()
        self._check_numbers()
        self._check_stimuli()
        if self.session_s > LONGEST_SESSION_S and not self.long_session:
            raise PlanError(
                f"the session lasts {self.session_s / 60:.1f} min, more than 30: take fewer "
                "contents, conditions or repetitions, or set long_session: true"
            )

    def _check_texts(self) -> None:
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
        if not isinstance(self.stages, tuple):
            raise PlanError("stages: must be a list of names")
        for stage in self.stages:
            if stage not in STAGES:
                raise PlanError(f"stages: {stage!r} is none of {', '.join(STAGES)}")
        if not isinstance(self.folder, str) or not self.folder:
            raise PlanError(f"folder: {self.folder!r} is not a path")

    def _check_numbers(self) -> None:
        for name in RANGES:
            if not name.startswith("timing."):
                _check_number(name, getattr(self, name))
        pairs = len(self.contents) * len(self.conditions)
        if self.coherence > pairs:
            raise PlanError(f"coherence: {self.coherence} is more than the {pairs} pairs there are")
        for name in ("captions", "long_session"):
            if not isinstance(getattr(self, name), bool):
                raise PlanError(f"{name}: {getattr(self, name)!r} is neither true nor false")

    def _check_stimuli(self) -> None:
        for name in ("stimuli", "hashes", "pixels"):
            if not isinstance(getattr(self, name), Mapping):
                raise PlanError(f"{name}: must be a mapping of names to values")
        if not isinstance(self.training, tuple):
            raise PlanError("training: must be a list of content/condition")
        for pair in self.training:
            content, slash, condition = pair.partition("/") if isinstance(pair, str) else ("",) * 3
            if not (content and slash and condition) or condition == self.reference:
                raise PlanError(f"training: {pair!r} is not content/condition of a tested pair")
        for key in self.used:
            if not isinstance(self.stimuli.get(key), str):
                raise PlanError(f"stimuli: no file is named for {key}")
        for key in self.stimuli:
            if key not in self.used:
                raise PlanError(f"stimuli: {key} is not part of the test")
        for name, hashes in (("hashes", self.hashes), ("pixels", self.pixels)):
            for key, digest in hashes.items():
                if key not in self.used or not re.fullmatch(r"[0-9a-f]{64}", str(digest)):
                    raise PlanError(f"{name}: {key}: is no SHA-256 of a stimulus of the test")

    @property
    def used(self) -> tuple[str, ...]:
        """Every ``content/condition`` that is shown, each once."""
        pairs = [(content, name) for content in self.contents for name in self.conditions]
        pairs += [(content, name) for content, _, name in (x.partition("/") for x in self.training)]
        keys = (f"{c}/{name}" for c, tested in pairs for name in (self.reference, tested))
        return tuple(dict.fromkeys(keys))

    @property
    def presentations(self) -> int:
        """Presentations of one session, dummies among them."""
        pairs = len(self.contents) * len(self.conditions)
        return self.dummies + pairs * self.repetitions + self.coherence

    @property
    def breaks(self) -> int:
        """Breaks of one session; none comes after the last presentation."""
        return (self.presentations - 1) // self.break_every if self.break_every else 0

    @property
    def session_s(self) -> float:
        """Length of one session: training, presentations and breaks [s]."""
        shown = len(self.training) + self.presentations
        return shown * self.timing.presentation_s + self.breaks * self.break_s


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


def plan_to_dict(plan: Plan) -> dict[str, Any]:
    """Return the plan as JSON knows it; :func:`plan_from_dict` makes the same plan of it."""
    return json.loads(json.dumps(dataclasses.asdict(plan)))


def _check_number(name: str, value: object) -> None:
    least, most = RANGES[name]
    is_whole = isinstance(least, int)
    if (
        isinstance(value, bool)
        or not isinstance(value, int if is_whole else (int, float))
        or not least <= value <= most
    ):
        said = (
            f"whole number from {least} to {most}"
            if is_whole
            else f"number from {least:g} to {most:g}"
        )
        raise PlanError(f"{name}: {value!r} is not a {said}")


def _check_names(name: str, value: object) -> None:
    if not isinstance(value, tuple) or not value:
        raise PlanError(f"{name}: must be a list of at least one name")
    for item in value:
        if not isinstance(item, str) or not item or "/" in item:
            raise PlanError(f"{name}: {item!r} is not a name (a text without '/')")
    if len(set(value)) != len(value):
        raise PlanError(f"{name}: a name is there twice")
