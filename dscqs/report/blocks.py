"""What a report is made of, before it is HTML or PDF."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, kw_only=True)
class Heading:
    """The beginning of a section (level 1) or of a part of one (level 2)."""

    text: str
    level: int = 1


@dataclass(frozen=True, kw_only=True)
class Paragraph:
    """Running text; ``warning`` sets it apart."""

    text: str
    warning: bool = False


@dataclass(frozen=True, kw_only=True)
class Table:
    """Cells as they are printed.

    Parameters
    ----------
    caption : str
    head : tuple of str
    groups : tuple of (str, int)
        Titles over several columns, with their numbers of columns; empty: none.
    rows : tuple of tuple of str
        Each as long as ``head``.
    names : int
        Leading columns that hold names: set flush left, all others flush right.
    marked : frozenset of int
        Rows to stress (rejected assessors).
    folded : bool
        Long: HTML shows it when asked.
    """

    caption: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    names: int = 1
    marked: frozenset[int] = frozenset()
    folded: bool = False
    groups: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Plot:
    """A picture, drawn when it is asked for; the text says what it shows to who cannot see it."""

    caption: str
    text: str
    draw: Callable[[], Figure]


Block = Heading | Paragraph | Table | Plot
