"""What a chapter of a report is made of. Plain values; nothing here is drawn or written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pipeline.evaluation.tables import Table


@dataclass(frozen=True, kw_only=True)
class Figure:
    """A picture under a number of its own."""

    caption: str
    content: bytes
    """PNG, or SVG text as UTF-8."""
    kind: str = "svg"
    """``svg`` or ``png``."""
    scene: str = ""
    """The one scene that it shows; empty: all of them."""
    pixelated: bool = False
    """Whether a browser shall show the pixels when it enlarges."""


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """The same picture made in several ways, for a slider; and the other eye's, for stereo."""

    title: str
    left: Mapping[str, bytes]
    """PNG by method; the same size for all."""
    right: Mapping[str, bytes]
    """PNG by method, the right eye; empty where there is none."""


@dataclass(frozen=True, kw_only=True)
class Chapter:
    """One question, its answer, and what the answer rests on."""

    key: str
    """Name in the JSON file, and of the CSV files."""
    title: str
    question: str
    answer: Sequence[str]
    """Sentences made from the figures below."""
    tables: Sequence[tuple[str, Table]] = ()
    """Title and table."""
    figures: Sequence[Figure] = ()
    comparisons: Sequence[Comparison] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    """The numbers, unrounded, as plain records."""
